"""Correction by least squares on the contour error, with exact derivatives."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._result import RESULTS
from ..._types import FloatRows
from ...optimise import LeastSquaresState, LevenbergMarquardt
from ...settings.correction import CorrectionSettings
from .._core.method import MethodResult, OnProgress, corrected
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Motion, Problem
from .._spline.command_limits import LinearLimits
from .._spline.projection import project
from .._spline.spline_offsets import SplineOffsets
from .._surface.surface_limits import SurfaceBounds, refusal
from .checkpoint import Arrays, OnCheckpoint, pack, unpack
from .ensemble import Ensemble
from .offset_fit import (
    UNIT,
    ContourResidual,
    FitValue,
    OffsetFit,
    fit_offsets,
    offset_fit,
)
from .optimiser import AbstractOptimiser

# Steps towards the path at most: further ones improve what the surface does not see.
_STEPS_TOWARDS_PATH = 2
# Stands for a state of any shapes, which a checkpoint fills in.
_ANY_STATE = LeastSquaresState(
    np.zeros(0), FitValue(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0))), 0.0
)


class GaussNewton(AbstractOptimiser):
    """Least squares on the spline offsets of a command, within bounds.

    The unknowns are the coefficients of `SplineOffsets`, each within `max_offset` of
    the problem, so that the whole curve is. A start is first projected onto them.

    Attributes:
        knot_spacing: Smallest spacing of the knots [s]: the controller's bandwidth.
        smoothness: Weight of the roughness: contour error, in units of 0.1 mm, that is
            as bad as second differences of the coefficients of rms `max_offset`.
        lag_weight: Weight of the deviation along the path in the residual. The contour
            error does not see it; without a little of it the command drifts along the
            path as far as the bound where that gains anything.
        solver: Settings of the least-squares method.
        objective: The error that is to become small.
        ensemble: Draws of an uncertain plant, over which the mean square error is to
            become small instead of that of the problem's plant alone.
        is_worst_case: Whether the largest mean square error of all members is to become
            small instead of their mean.
        bounds: Bounds of the machined surface, which the result keeps in every member.
        limits: Further limits of the coefficients, of the joints for example.
        max_velocity: Largest velocity of the whole command per axis [its unit / s].
        max_acceleration: Largest acceleration of it per axis [its unit / s^2].
        on_step: Called with a message and the share of the present step, while its
            slopes are computed.
    """

    knot_spacing: float = CorrectionSettings.knot_spacing
    smoothness: float = 1e-2
    lag_weight: float = 0.03
    solver: LevenbergMarquardt = LevenbergMarquardt(
        max_steps=6, damping=1e-4, cost_rtol=1e-2
    )
    objective: AbstractObjective = PathObjective()
    ensemble: Ensemble | None = None
    is_worst_case: bool = eqx.field(static=True, default=False)
    bounds: SurfaceBounds | None = None
    limits: tuple[LinearLimits, ...] = ()
    max_velocity: float = np.inf
    max_acceleration: float = np.inf
    on_step: Callable[[str, float], None] | None = eqx.field(static=True, default=None)

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_checkpoint: OnCheckpoint | None = None,
        resume: Arrays | None = None,
    ) -> MethodResult:
        """Outcome of the best command within knots and bounds, from `start`.

        `on_checkpoint` is called after every step with the state of the search,
        `resume` is the one from which to go on.

        Raises:
            InfeasibleLimit: The nominal command breaks a limit, or no correction keeps
                the bounds of the surface.
        """
        rows, axes = problem.nominal.shape
        spline = SplineOffsets(rows, problem.time_step, self.knot_spacing)
        bound = float(problem.max_offset)
        nominal = np.asarray(problem.nominal)
        limits = self.all_limits(spline, nominal)
        first = np.zeros((spline.coefficient_count, axes))
        if start is not None:
            first = project(spline, np.asarray(start) - nominal, bound, limits=limits)
        args = ContourResidual(
            problem,
            spline,
            jnp.asarray(self.smoothness, nominal.dtype),
            jnp.asarray(self.lag_weight, nominal.dtype),
            self.objective,
            self.bounds,
        )
        plants, weights = (problem.plant,), None
        if self.ensemble is not None:
            plants, weights = self.ensemble.plants(), self.ensemble.weights
        fit = offset_fit(
            args, plants, weights, limits, is_worst_case=self.is_worst_case
        )
        begun = None if resume is None else unpack(resume, _ANY_STATE)
        done = 0 if begun is None else len(begun.history)
        if self.on_step is not None:
            tell = self.on_step

            def tell_slopes(share: float) -> None:
                tell(f"Gauss-Newton step {done + 1} over {rows} tooth periods", share)

            fit = dataclasses.replace(fit, on_slopes=tell_slopes)

        def report(state: LeastSquaresState) -> bool:
            nonlocal done
            done = len(state.history)
            if on_checkpoint is not None:
                value = state.value
                # A run gives the motion again.
                value = FitValue(value.errors, value.rough, value.outputs)
                on_checkpoint(pack(dataclasses.replace(state, value=value)))
            if on_progress is None or not state.history:
                return False
            message = f"Gauss-Newton step {len(state.history)}"
            if self.bounds is not None:
                message += ", what is out of bounds counted in"
            # The roughness makes the error an upper bound.
            error = UNIT * float(np.sqrt(2 * state.history[-1].cost))
            return bool(on_progress(message, error))

        last = fit_offsets(
            fit,
            first,
            self.solver,
            lower=-bound,
            upper=bound,
            state=begun,
            callback=report,
        )
        if last is None:
            offset, result = spline.offsets(fit.coefficients(first)), RESULTS.non_finite
            return corrected(problem, jnp.asarray(nominal) + offset, result=result)
        if self.bounds is not None:
            check_bounds(self.bounds, fit, last, bound)
        is_settled = last.has_converged and fit.is_within(last.value)
        return corrected(
            problem,
            fit.command(last.x),
            motion=last.value.motion if self.ensemble is None else None,
            forward_runs=last.evaluations * len(plants),
            linearisations=last.models * len(plants),
            history=last.history,
            detail=self._detail(fit, last, spline),
            result=RESULTS.successful if is_settled else RESULTS.not_converged,
        )

    def towards_path(self) -> "GaussNewton | None":
        """Method that first brings the rows near the surface onto the path, or None.

        The certain model is enough for a start, and it may leave the bounds of the
        surface: on the path it is close to them, while the way to them from afar, with
        a spring at every point that is out of bounds, takes many steps.
        """
        if not self.objective.starts_from_path and self.bounds is None:
            return None
        steps = min(_STEPS_TOWARDS_PATH, self.solver.max_steps)
        return dataclasses.replace(
            self,
            solver=dataclasses.replace(self.solver, max_steps=steps),
            objective=PathObjective(),
            ensemble=None,
            is_worst_case=False,
            bounds=None,
        )

    def excess(self, motion: Motion) -> float:
        """Distance of the surface to its bounds [m]; 0 within, or without any."""
        return 0.0 if self.bounds is None else self.bounds.excess(motion)

    def all_limits(
        self, spline: SplineOffsets, nominal: FloatRows
    ) -> tuple[LinearLimits, ...]:
        """Limits of the coefficients: those given, and those of the whole command."""
        return self.limits + LinearLimits.of_command(
            spline,
            nominal,
            max_velocity=self.max_velocity,
            max_acceleration=self.max_acceleration,
        )

    def _detail(
        self, fit: OffsetFit, last: LeastSquaresState, spline: SplineOffsets
    ) -> dict[str, float]:
        """Settings and figures of a solution, for the report."""
        x = np.abs(np.asarray(fit.coefficients(last.x)))
        detail = {
            "knot_spacing": spline.actual_spacing,
            "unknowns": float(x.size),
            "bound_count": float(np.sum(x >= float(fit.args.problem.max_offset))),
            "smoothness": self.smoothness,
            "lag_weight": self.lag_weight,
        }
        if len(fit.plants) > 1:
            rms = UNIT * np.sqrt(np.sum(last.value.errors**2, axis=1))
            detail["draws"] = float(len(fit.plants))
            detail["draw_rms_least"] = float(rms.min())
            detail["draw_rms_largest"] = float(rms.max())
        return detail


def check_bounds(
    bounds: SurfaceBounds,
    fit: OffsetFit,
    solution: LeastSquaresState,
    max_offset: float,
) -> None:
    """Raise if a solution leaves bounds of the surface.

    Args:
        bounds: The bounds.
        fit: What was solved.
        solution: The solution.
        max_offset: Bound of its coefficients.

    Raises:
        InfeasibleLimit: It leaves them.

    **Differentiability**: none, a host function.
    """
    if fit.is_within(solution.value):
        return
    x = np.asarray(fit.coefficients(solution.x), np.float64)
    errors = UNIT * solution.value.outputs.reshape(-1)
    raise refusal(bounds, errors, x, max_offset, fit.limits)
