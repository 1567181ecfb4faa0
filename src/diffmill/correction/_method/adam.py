"""First-order correction, for objectives that Gauss-Newton does not suit.

Gauss-Newton wants residuals that are nearly linear near the solution. Where they are
not (kinks close together, an error that hardly depends on the command), a method that
only follows the gradient is slower and more patient.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import CorrectionSettings
from ..._result import RESULTS
from ..._types import FloatRows
from .._core.method import AbstractMethod, MethodResult, OnProgress, corrected
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Problem
from .._spline.command_limits import LinearLimits, feasible_share
from .._spline.projection import project
from .._spline.spline_offsets import SplineOffsets
from .checkpoint import Arrays, OnCheckpoint, below, pack_tree, under, unpack_tree
from .offset_fit import ContourResidual
from .offset_residual import OffsetResidual, offset_residual

Coefficients = Float[Array, "coefficient axis"]


class _Descent(NamedTuple):
    """Course of the steps.

    Attributes:
        best: Best point, shape (coefficient, axis).
        lowest: Its cost [-]; infinite where none was finite.
        spent: Gradients that it took.
    """

    best: Coefficients
    lowest: float
    spent: int


class Adam(AbstractMethod):
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
        on_memory: OnCheckpoint | None = None,
        resume: Arrays | None = None,
    ) -> MethodResult:
        """Return the best command of all steps, from `start`.

        `on_memory` is called after every step with all that is needed to go on from
        there, `resume` is what it was called with.
        """
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
        descent = self._search(
            x, args, on_progress=on_progress, on_memory=on_memory, resume=resume
        )
        best, is_finite = descent.best, bool(np.isfinite(descent.lowest))
        return corrected(
            problem,
            fit.command(best, args),
            linearisations=descent.spent,
            detail={
                "knot_spacing": spline.actual_spacing,
                "unknowns": float(x.size),
                "bound_count": float(jnp.sum(jnp.abs(best) >= 1)),
            },
            result=RESULTS.successful if is_finite else RESULTS.non_finite,
        )

    def _search(
        self,
        x: Coefficients,
        args: ContourResidual,
        *,
        on_progress: OnProgress | None,
        on_memory: OnCheckpoint | None,
        resume: Arrays | None,
    ) -> _Descent:
        """Take the steps."""
        import optax

        rate = optax.cosine_decay_schedule(self.step_size, self.steps)
        optimiser = optax.adam(rate)
        best, lowest, spent = x, np.inf, 0
        state = optimiser.init(x)
        if resume is not None:
            x, best = jnp.asarray(resume["x"]), jnp.asarray(resume["best"])
            lowest, spent = float(resume["lowest"]), int(resume["spent"])
            state = unpack_tree(below("state", resume), state)
        while spent < self.steps:
            cost, gradient = _slope(x, args)
            spent += 1
            if not np.isfinite(float(cost)):
                break
            if float(cost) < lowest:
                best, lowest = x, float(cost)
            # Inside, optax multiplies its floats by the integer count of steps.
            with jax.numpy_dtype_promotion("standard"):
                update, state = optimiser.update(gradient, state)
            x = jnp.clip(optax.apply_updates(x, update), -1, 1)  # pyright: ignore[reportArgumentType]
            x = self._within(x, args)
            if on_memory is not None:
                kept = {"x": x, "best": best, "lowest": lowest, "spent": spent}
                arrays = {name: np.asarray(value) for name, value in kept.items()}
                on_memory({**arrays, **under("state", pack_tree(state))})
            # In the unit of the residuals, 0.1 mm; the roughness makes it a bound.
            error = 1e-4 * float(np.sqrt(2 * lowest))
            if on_progress is not None and on_progress(f"Adam step {spent}", error):
                break
        return _Descent(best, lowest, spent)

    def _within(self, x: Coefficients, args: ContourResidual) -> Coefficients:
        """Return the point within the limits whose offsets are nearest."""
        bound = float(args.problem.max_offset)
        if feasible_share(np.asarray(x, np.float64) * bound, self.limits) >= 1:
            return x
        offset = np.asarray(args.spline.offsets(x * bound))
        held = project(args.spline, offset, bound, limits=self.limits)  # pyright: ignore[reportArgumentType]
        return jnp.asarray(held / bound, x.dtype)


_slope = eqx.filter_jit(jax.value_and_grad(OffsetResidual.cost))
