"""Settings, steps and solution of the least-squares method.

Also what it must remember to go on after an interruption.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._result import RESULTS
from ._products import AbstractProducts, StoredProducts


class LeastSquaresStep(eqx.Module):
    """Outer step with the cost up to its end.

    Where a refused trial was followed by shorter ones, what is told is that of the
    last.

    Attributes:
        step: Number of the outer step, from 1.
        cost: |r|^2 / 2 at the best point so far.
        trial_cost: |r|^2 / 2 at the point tried.
        is_accepted: Whether the trial became the best point.
        gain_ratio: True over predicted decrease.
        damping: Damping with which the step was computed.
        kkt: Largest entry of the projected gradient, in units of `scale`, at the
            point from which the step was taken.
        bound_count: Unknowns of the trial that stand at a bound.
        products: Products J v and J^T w in total so far.
        forward_runs: Evaluations of the residual in total so far, linearisations
            included.
        seconds: Wall time since the start [s].
        weight: Weight of the held rows out of their bounds where the step began; 0
            where all were within.
    """

    step: int
    cost: float
    trial_cost: float
    is_accepted: bool
    gain_ratio: float
    damping: float
    kkt: float
    bound_count: int
    products: int
    forward_runs: int
    seconds: float
    weight: float = 0.0


class LeastSquaresSolution(eqx.Module):
    """A bounded least-squares solution.

    Attributes:
        x: The best point, exactly within the bounds.
        cost: |r(x)|^2 / 2.
        history: One entry per outer step.
        result: `successful`, `not_converged` or `non_finite`.
        held: Values of the rows that are held, shape (row,).
    """

    x: Float[Array, "*unknown"]
    cost: float
    history: tuple[LeastSquaresStep, ...]
    result: RESULTS
    held: Float[np.ndarray, " row"] = eqx.field(default_factory=lambda: np.zeros(0))

    @property
    def products(self) -> int:
        """Products J v and J^T w in total."""
        return self.history[-1].products if self.history else 0

    @property
    def forward_runs(self) -> int:
        """Evaluations of the residual in total."""
        return self.history[-1].forward_runs if self.history else 1


def following(
    before: tuple[LeastSquaresStep, ...], steps: tuple[LeastSquaresStep, ...]
) -> tuple[LeastSquaresStep, ...]:
    """Return steps with those before them, what these have cost added.

    Args:
        before: Steps of earlier solutions.
        steps: Steps of a solution, which count from its own start.

    Returns:
        All of them.

    **Differentiability**: none, a host function.
    """
    if not before:
        return steps
    last = before[-1]
    return before + tuple(
        dataclasses.replace(
            step,
            step=last.step + step.step,
            products=last.products + step.products,
            forward_runs=last.forward_runs + step.forward_runs,
            seconds=last.seconds + step.seconds,
        )
        for step in steps
    )


class LeastSquaresMemory(eqx.Module):
    """State of the iteration after an outer step.

    Attributes:
        z: The best point in units of `scale`, of the shape of the unknowns.
        damping: Damping of the next step.
        growth: Factor by which a refused step would raise it.
        first_kkt: Largest entry of the first projected gradient.
        is_done: Whether the iteration has converged.
        products: Products J v and J^T w so far.
        forward_runs: Evaluations of the residual so far.
        history: The steps so far.
    """

    z: Float[np.ndarray, "*unknown"]
    damping: float
    growth: float
    first_kkt: float
    is_done: bool
    products: int
    forward_runs: int
    history: tuple[LeastSquaresStep, ...]


class LevenbergMarquardt(eqx.Module):
    """Settings of the bounded Levenberg-Marquardt method.

    Attributes:
        max_steps: Outer steps at most, refused ones included.
        max_products: Products J v and J^T w at most per outer step; about three times
            as many where limits or held rows are in the way.
        cost_rtol: Stop when a step lowers the cost by less than this fraction.
        kkt_rtol: Stop when the projected gradient has fallen by this factor.
        inner_rtol: Accuracy of the inner problem, relative.
        damping: First damping, relative to the curvature along the gradient.
        products: How the products with the Jacobian are formed.
    """

    max_steps: int = 20
    max_products: int = 40
    cost_rtol: float = 1e-4
    kkt_rtol: float = 1e-8
    inner_rtol: float = 1e-2
    damping: float = 1e-6
    products: AbstractProducts = StoredProducts()

    def __check_init__(self):
        if self.max_products < 4:
            raise ValueError(
                "Argument `max_products` must be at least 4 (a gradient and one inner "
                f"step), but is {self.max_products}."
            )
