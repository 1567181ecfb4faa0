"""Minimisation of an expensive function of few unknowns by its quadratic models.

At a point a problem gives gradient and curvature of its cost, for a sum of squares
those of Gauss and Newton. The curvature is damped in proportion to its diagonal
(Marquardt), bounds of the step and linear rows included, until a trial lowers the cost:
a good step lessens the damping, a refused one raises it. A value that a problem
computes at a point may be a whole simulation; each is computed once.

Reference: Nocedal and Wright, Numerical Optimization, 2006, chapter 10.3.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ._quadratic_program import solve_quadratic_program

Vector: TypeAlias = Float[np.ndarray, " unknown"]
# Whatever a problem computes at a point.
Value: TypeAlias = Any


class LinearRows(eqx.Module):
    """Linear constraints of a step p: lower <= matrix @ p <= upper.

    Attributes:
        matrix: Shape (row, unknown).
        lower: Least values, or minus infinity, shape (row,).
        upper: Largest values, or infinity, shape (row,).
        weight: Stiffness of the springs that act outside; infinite for constraints.
    """

    matrix: Float[np.ndarray, "row unknown"]
    lower: Float[np.ndarray, " row"]
    upper: Float[np.ndarray, " row"]
    weight: float = np.inf

    def energy(self, p: Vector) -> float:
        """Return that of the springs after a step, 0 for constraints."""
        if np.isinf(self.weight):
            return 0.0
        values = self.matrix @ p
        outside = values - np.clip(values, self.lower, self.upper)
        return 0.5 * self.weight**2 * float(outside @ outside)


class QuadraticModel(eqx.Module):
    """Quadratic model of a cost around a point.

    Attributes:
        cost: Returns the cost of the value at a point, which the model approximates;
            infinite where the point is not allowed.
        gradient: Of the cost, shape (unknown,).
        curvature: Positive semidefinite, shape (unknown, unknown).
        rows: Constraints of the step, or None.
    """

    cost: Callable[[Vector, Value], float]
    gradient: Vector
    curvature: Float[np.ndarray, "unknown unknown"]
    rows: LinearRows | None = None

    def decrease(self, p: Vector) -> float:
        """Return by how much a step lowers the cost in the model."""
        change = float(self.gradient @ p + 0.5 * p @ self.curvature @ p)
        if self.rows is not None:
            change += self.rows.energy(p) - self.rows.energy(np.zeros_like(p))
        return -change


class AbstractProblem(eqx.Module):
    """Function of few unknowns that becomes small."""

    @abc.abstractmethod
    def evaluate(self, x: Vector) -> Value | None:
        """Return what is to be known at a point; None where it does not exist."""

    @abc.abstractmethod
    def model(self, x: Vector, value: Value) -> QuadraticModel:
        """Return the quadratic model around a point.

        Args:
            x: The point, shape (unknown,).
            value: What `evaluate` has returned there.
        """


class LevenbergMarquardt(eqx.Module):
    """Settings of the method.

    Attributes:
        max_steps: Steps at most.
        attempts: Trials for a step before the point counts as the best.
        longest: Largest change of each unknown in a step, a number or shape (unknown,).
        damping: First damping, over the diagonal of the curvature.
        less: Factor of the damping after a good trial.
        more: Factor after a refused one.
        rest: Squared length of a step in the metric of the curvature at which a good
            step is the last.
        kink: The same for a refused step: further ones would be refused too.
        still: Largest change of each unknown that counts as none, likewise.
        share: Smallest decrease over the cost that is worth a trial.
    """

    max_steps: int = 25
    attempts: int = 10
    longest: float | Vector = np.inf
    damping: float = 1e-3
    less: float = 0.1
    more: float = 10.0
    rest: float = 0.0
    kink: float = 0.0
    still: float | Vector = 0.0
    share: float = 0.0


class LeastSquaresState(eqx.Module):
    """State of the method, from which it goes on; the last one is the solution.

    Attributes:
        x: The best point, shape (unknown,).
        value: What the problem has computed there.
        damping: Of the next step.
        steps: Steps that lowered the cost.
        evaluations: How often the problem was evaluated.
        models: How often its quadratic model was made.
        has_converged: Whether no further step is worth while.
    """

    x: Vector
    value: Value
    damping: float
    steps: int = 0
    evaluations: int = 1
    models: int = 0
    has_converged: bool = False


def least_squares(
    problem: AbstractProblem,
    x0: Vector,
    solver: LevenbergMarquardt,
    *,
    lower: float | Vector = -np.inf,
    upper: float | Vector = np.inf,
    state: LeastSquaresState | None = None,
    callback: Callable[[LeastSquaresState], None] | None = None,
) -> LeastSquaresState:
    """Minimise the cost of a problem.

    Args:
        problem: The problem.
        x0: Where to start, within the bounds, shape (unknown,).
        solver: Settings.
        lower: Least values of the unknowns, a number or shape (unknown,).
        upper: Largest values, likewise.
        state: An earlier state to go on from, or its value at `x0`, which then is not
            computed again.
        callback: Called with the state after each step.

    Returns:
        The last state.

    Raises:
        ValueError: The problem has no value at `x0`.
    """
    if state is None:
        value = problem.evaluate(x0)
        if value is None:
            raise ValueError(
                "Argument `x0` must be a point of the problem, but is not."
            )
        state = LeastSquaresState(x0, value, solver.damping)
    for _ in range(solver.max_steps - state.steps):
        if state.has_converged:
            break
        before = state.steps
        box = LinearRows(
            np.eye(len(x0)),
            np.minimum(np.maximum(lower - state.x, -1.0 * solver.longest), 0.0),
            np.maximum(np.minimum(upper - state.x, solver.longest), 0.0),
        )
        state = _stepped(problem, state, solver, box)
        if callback is not None and state.steps > before:
            callback(state)
    return state


def _stepped(
    problem: AbstractProblem,
    state: LeastSquaresState,
    solver: LevenbergMarquardt,
    box: LinearRows,
) -> LeastSquaresState:
    """Return the state after one step, or where none is worth while."""
    model = problem.model(state.x, state.value)
    now, damping = model.cost(state.x, state.value), state.damping
    state = dataclasses.replace(state, models=state.models + 1)
    for _ in range(solver.attempts):
        p = _damped_step(model, damping, box)
        if p is None:
            damping *= solver.more
            continue
        if model.decrease(p) < solver.share * now:
            break
        curved = float(p @ model.curvature @ p)
        value = problem.evaluate(state.x + p)
        cost = np.inf if value is None else model.cost(state.x + p, value)
        state = dataclasses.replace(state, evaluations=state.evaluations + 1)
        is_better = value is not None and cost <= now and np.isfinite(cost)
        damping *= solver.less if is_better else solver.more
        is_still = bool(np.all(np.abs(p) < solver.still))
        if is_better:
            return dataclasses.replace(
                state,
                x=state.x + p,
                value=value,
                damping=damping,
                steps=state.steps + 1,
                has_converged=is_still
                or curved < solver.rest
                or now - cost < solver.share * now,
            )
        if is_still or curved < solver.kink:
            break
    return dataclasses.replace(state, damping=damping, has_converged=True)


def _damped_step(
    model: QuadraticModel, damping: float, box: LinearRows
) -> Vector | None:
    """Return the step of the damped model within its constraints, None for none.

    Unknowns without effect on the cost stay.
    """
    own = np.diagonal(model.curvature)
    is_free = (own > 0) & (box.upper > box.lower)
    # In units in which the curvature is one: the unknowns differ by many digits.
    unit = 1.0 / np.sqrt(own[is_free])
    H = model.curvature[np.ix_(is_free, is_free)] * unit[:, None] * unit[None]
    H = H + damping * np.eye(len(H))
    g = model.gradient[is_free] * unit
    p = np.zeros(len(own))
    if model.rows is None:
        p[is_free] = np.linalg.solve(H, -g) * unit
        if np.all((p >= box.lower) & (p <= box.upper)):
            return p
    parts = [box] if model.rows is None else [box, model.rows]
    found = solve_quadratic_program(
        H,
        g,
        np.vstack([one.matrix[:, is_free] for one in parts]) * unit[None],
        np.concatenate([one.lower for one in parts]),
        np.concatenate([one.upper for one in parts]),
        np.concatenate([np.full(len(one.lower), one.weight) for one in parts]),
    )
    if found is None:
        return None
    p[is_free] = found.x * unit
    return np.clip(p, box.lower, box.upper)
