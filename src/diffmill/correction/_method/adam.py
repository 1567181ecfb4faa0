"""First-order correction, for objectives that Gauss-Newton does not suit.

Gauss-Newton wants residuals that are nearly linear near the solution. Where they are
not (kinks close together, an error that hardly depends on the command), a method that
only follows the gradient is slower and more patient.
"""

import dataclasses
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._result import RESULTS
from ..._types import FloatRows
from ...settings.correction import CorrectionSettings
from .._core.method import MethodResult, OnProgress, corrected
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Problem
from .._spline.command_limits import LinearLimits, feasible_share
from .._spline.projection import project
from .._spline.spline_offsets import SplineOffsets
from .checkpoint import Arrays, OnCheckpoint, pack, unpack
from .offset_fit import ContourResidual
from .offset_residual import OffsetResidual, offset_residual
from .optimiser import AbstractOptimiser

if TYPE_CHECKING:
    import optax

Coefficients = Float[Array, "coefficient axis"]


class _AdamState(eqx.Module):
    """State of the descent after some steps.

    Attributes:
        x: Point of the next gradient, shape (coefficient, axis).
        moments: State of optax: means of the gradient and of its square.
        best: Best point, shape (coefficient, axis).
        lowest_cost: Its cost [-]; infinite where none was finite.
        gradients: Number of gradients so far.
    """

    x: Coefficients
    moments: PyTree
    best: Coefficients
    lowest_cost: float
    gradients: int


class Adam(AbstractOptimiser):
    """Adam on the spline offsets of a command, brought within bounds after every step.

    A step that leaves the limits goes on from the nearest command within them. The step
    falls from its first value to nothing along half a cosine. The best point
    of all is the result. Kingma, Ba, Adam: a method for stochastic optimization, 2015;
    the implementation is that of optax.

    Attributes:
        knot_spacing: Smallest spacing of the knots [s].
        steps: Gradient steps; each costs a simulation forward and back.
        step_size: First step, in units of the problem's `max_offset`.
        smoothness: As `GaussNewton`.
        lag_weight: As `GaussNewton`.
        objective: The error that is to become small.
        limits: Limits of the coefficients, of the joints for example.
    """

    knot_spacing: float = CorrectionSettings.knot_spacing
    steps: int = 100
    step_size: float = 0.03
    smoothness: float = 1e-2
    lag_weight: float = 0.03
    objective: AbstractObjective = PathObjective()
    limits: tuple[LinearLimits, ...] = ()

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_checkpoint: OnCheckpoint | None = None,
        resume: Arrays | None = None,
    ) -> MethodResult:
        """Outcome of the best command of all steps, from `start`.

        `on_checkpoint` is called after every step with the state of the descent,
        `resume` is the one from which to go on.
        """
        import optax

        fit = offset_residual(
            problem,
            knot_spacing=self.knot_spacing,
            objective=self.objective,
            smoothness=self.smoothness,
            lag_weight=self.lag_weight,
        )
        args, x, spline = fit.args, fit.start, fit.args.spline
        assert isinstance(spline, SplineOffsets)
        if start is not None:
            away = np.asarray(start) - np.asarray(problem.nominal)
            bound = float(problem.max_offset)
            first = project(spline, away, bound, limits=self.limits) / bound
            x = jnp.asarray(first, x.dtype)
        optimiser = optax.adam(optax.cosine_decay_schedule(self.step_size, self.steps))
        state = _AdamState(x, optimiser.init(x), x, np.inf, 0)
        if resume is not None:
            state = unpack(resume, state)
        while state.gradients < self.steps:
            state, is_finite = self._stepped(state, args, optimiser)
            if not is_finite:
                break
            if on_checkpoint is not None:
                on_checkpoint(pack(state))
            # In the unit of the residuals, 0.1 mm; the roughness makes it a bound.
            error = 1e-4 * float(np.sqrt(2 * state.lowest_cost))
            message = f"Adam step {state.gradients}"
            if on_progress is not None and on_progress(message, error):
                break
        is_found = bool(np.isfinite(state.lowest_cost))
        return corrected(
            problem,
            fit.command(state.best, args),
            linearisations=state.gradients,
            detail={
                "knot_spacing": spline.actual_spacing,
                "unknowns": float(x.size),
                "bound_count": float(jnp.sum(jnp.abs(state.best) >= 1)),
            },
            result=RESULTS.successful if is_found else RESULTS.non_finite,
        )

    def _stepped(
        self,
        state: _AdamState,
        args: ContourResidual,
        optimiser: "optax.GradientTransformation",
    ) -> tuple[_AdamState, bool]:
        """State after one step, and False if its cost was not finite."""
        import optax

        x, gradients = state.x, state.gradients + 1
        cost, gradient = _slope(x, args)
        if not np.isfinite(float(cost)):
            return dataclasses.replace(state, gradients=gradients), False
        best, lowest_cost = state.best, state.lowest_cost
        if float(cost) < lowest_cost:
            best, lowest_cost = x, float(cost)
        # Inside, optax multiplies its floats by the integer count of steps.
        with jax.numpy_dtype_promotion("standard"):
            update, moments = optimiser.update(gradient, state.moments)
        x = jnp.clip(optax.apply_updates(x, update), -1, 1)  # pyright: ignore[reportArgumentType]
        bound = float(args.problem.max_offset)
        if feasible_share(np.asarray(x, np.float64) * bound, self.limits) < 1:
            offset = np.asarray(args.spline.offsets(x * bound))
            nearest = project(args.spline, offset, bound, limits=self.limits)  # pyright: ignore[reportArgumentType]
            x = jnp.asarray(nearest / bound, x.dtype)
        return _AdamState(x, moments, best, lowest_cost, gradients), True


_slope = eqx.filter_jit(jax.value_and_grad(OffsetResidual.cost))
