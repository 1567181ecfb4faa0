"""Correction by least squares on the contour error, with exact derivatives."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows, RealScalarLike
from .._core.method import AbstractMethod, Corrected, OnProgress, corrected
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Motion, Problem
from .._held_rows import HeldRows
from .._least_squares import least_squares
from .._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
    LevenbergMarquardt,
)
from .._products import evaluate
from .._response import TipResponse, spline_preconditioner
from .._spline.command_limits import (
    AbstractLimits,
    LinearLimits,
    MixedLimits,
    command_limits,
)
from .._spline.projection import project
from .._spline.spline_offsets import SplineOffsets
from .._spline.spline_window import SplineWindow
from .._surface.surface_limits import SurfaceBounds, refusal
from .ensemble import Ensemble
from .minimax import WorstCaseMemory, worst_case

# Contour error that counts as one in the residual [m]; sets no result, only the size
# of the numbers and what `smoothness` is relative to.
_UNIT = 1e-4


class ContourResidual(eqx.Module):
    """Everything that the residual of Gauss-Newton needs besides the unknowns.

    Attributes:
        problem: The problem.
        spline: Basis of the offsets.
        smoothness: Weight of the roughness, see `GaussNewton`.
        lag_weight: Weight of the deviation along the path, see `GaussNewton`.
        objective: The error that is to become small.
        ensemble: Plants over which the square is a mean; None for that of the problem.
        bounds: Bounds of the machined surface, whose errors follow as held rows.
    """

    problem: Problem
    spline: SplineOffsets | SplineWindow
    smoothness: RealScalarLike
    lag_weight: RealScalarLike
    objective: AbstractObjective = PathObjective()
    ensemble: Ensemble | None = None
    bounds: SurfaceBounds | None = None


def contour_residual(
    coefficients: Float[Array, "coefficient axis"], args: ContourResidual
) -> Float[Array, " residual"]:
    """Return the weighted errors and the roughness as one vector.

    With `PathObjective` its square is (rms contour error / 0.1 mm)^2 over the rows
    that cut, plus (lag_weight x rms deviation along the path / 0.1 mm)^2 there, plus
    (smoothness x rms second difference of the coefficients / max_offset)^2. With an
    ensemble the first two are weighted means over its members. Errors of the surface
    that are to be held within bounds, in units of 0.1 mm, come last, of all members.

    Args:
        coefficients: Spline coefficients of the offset, in the command's unit.
        args: The problem, the basis and the weight.

    Returns:
        Dimensionless residuals, the error first.

    **Differentiability**: that of the plant; kinks where the nearest segment changes.
    """
    nominal = jnp.asarray(args.problem.nominal, coefficients.dtype)
    command = nominal + args.spline.offsets(coefficients)
    if args.ensemble is None:
        return terms(coefficients, args, args.problem.plant(command))
    return terms(coefficients, args, args.ensemble.motions(command))


def terms(
    coefficients: Float[Array, "coefficient axis"],
    args: ContourResidual,
    motion: Motion,
) -> Float[Array, " residual"]:
    """Return the residual of a motion that is known, see `contour_residual`.

    Args:
        coefficients: Spline coefficients of the offset, in the command's unit.
        args: The problem, the basis and the weight.
        motion: What the plant does; of an ensemble the motions of all members, stacked.

    **Differentiability**: kinks where the nearest segment changes.
    """
    problem, dtype = args.problem, coefficients.dtype
    errors = lambda motion: args.objective.errors(problem, motion, args.lag_weight)
    none = lambda motion: jnp.zeros((0,), dtype)
    bounded = none if args.bounds is None else args.bounds.errors
    if args.ensemble is None:
        error, held = errors(motion), bounded(motion)
    else:
        each = jax.vmap(errors)(motion) * args.ensemble.roots(dtype)[:, None]
        error, held = each.reshape(-1), jax.vmap(bounded)(motion).reshape(-1)
    rough = args.spline.roughness(coefficients)
    price = jnp.asarray(args.smoothness, dtype) / np.sqrt(rough.shape[0])
    rough = rough * (price / jnp.asarray(problem.max_offset, dtype))
    return jnp.concatenate([error / _UNIT, rough.reshape(-1), held / _UNIT])


class GaussNewton(AbstractMethod):
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
        response: The arm's inverse response, which preconditions the inner problem;
            for tip commands only.
        objective: The error that is to become small.
        ensemble: Draws of an uncertain plant, over which the mean square error is to
            become small instead of that of the problem's plant alone.
        is_worst_case: Whether the largest mean square error of all members is to become
            small instead of their mean.
        bounds: Bounds of the machined surface, which the result keeps in every member.
        limits: Further limits of the coefficients, of the joints for example.
        max_velocity: Largest velocity of the whole command per axis [its unit / s].
        max_acceleration: Largest acceleration of it per axis [its unit / s^2].
    """

    knot_spacing: float = 30e-3
    smoothness: float = 1e-2
    lag_weight: float = 0.03
    solver: LevenbergMarquardt = LevenbergMarquardt(max_steps=6, cost_rtol=1e-2)
    response: TipResponse | None = None
    objective: AbstractObjective = PathObjective()
    ensemble: Ensemble | None = None
    is_worst_case: bool = eqx.field(static=True, default=False)
    bounds: SurfaceBounds | None = None
    limits: tuple[LinearLimits | MixedLimits, ...] = ()
    max_velocity: float = np.inf
    max_acceleration: float = np.inf

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_memory: Callable[[Any], object] | None = None,
        resume: LeastSquaresMemory | WorstCaseMemory | None = None,
    ) -> Corrected:
        """Return the best command within knots and bounds, from `start`.

        `on_memory` and `resume` are those of `least_squares`, or of `worst_case`.

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
            self.ensemble,
            self.bounds,
        )
        solve = functools.partial(self._solve, limits, on_progress)
        begin = jnp.asarray(first, nominal.dtype)
        if self.is_worst_case:
            assert not isinstance(resume, LeastSquaresMemory)
            solution = worst_case(
                *(solve, _member_errors, begin, args),
                is_held=lambda found: self._held().is_within(found.held),
                on_memory=on_memory,
                resume=resume,
            )
        else:
            assert not isinstance(resume, WorstCaseMemory)
            solution = solve(begin, args, on_memory=on_memory, resume=resume)
        if self.bounds is not None:
            check_held(self.bounds, self._held(), solution, bound, limits)
        offset = spline.offsets(solution.x)
        return corrected(
            problem,
            jnp.asarray(nominal) + offset,
            forward_runs=solution.forward_runs,
            products=solution.products,
            history=solution.history,
            detail=self._detail(spline, np.asarray(solution.x), bound),
            result=solution.result,
        )

    def _solve(
        self,
        limits: tuple[AbstractLimits, ...],
        on_progress: OnProgress | None,
        first: Float[Array, "coefficient axis"],
        args: ContourResidual,
        *,
        on_memory: Callable[[LeastSquaresMemory], object] | None = None,
        resume: LeastSquaresMemory | None = None,
    ) -> LeastSquaresSolution:
        """Return the least squares within all that is to be held."""
        problem = args.problem
        bound = float(problem.max_offset)
        precondition = None
        if self.response is not None:
            precondition = spline_preconditioner(
                self.response,
                args.spline,  # pyright: ignore[reportArgumentType]
                problem.time_step,
            )
        return least_squares(
            contour_residual,
            first,
            args,
            lower=-bound,
            upper=bound,
            scale=bound,
            limits=limits,
            held=self._held(),
            solver=self.solver,
            precondition=precondition,
            on_progress=None
            if on_progress is None
            else _Told(on_progress, self.bounds is not None),
            on_memory=on_memory,
            resume=resume,
        )

    def begin(self, problem: Problem, start: FloatRows) -> FloatRows:
        """Return the command at which the iteration begins, within knots and limits.

        Args:
            problem: The problem.
            start: Any command, shape (step, axis).

        Returns:
            The closest one that the method may return.

        **Differentiability**: none, a host function.
        """
        nominal = np.asarray(problem.nominal)
        spline = SplineOffsets(len(nominal), problem.time_step, self.knot_spacing)
        limits, bound = self.all_limits(spline, nominal), float(problem.max_offset)
        first = project(spline, np.asarray(start) - nominal, bound, limits=limits)
        return nominal + np.asarray(spline.offsets(jnp.asarray(first)))

    def all_limits(
        self, spline: SplineOffsets, nominal: FloatRows
    ) -> tuple[LinearLimits | MixedLimits, ...]:
        """Return the limits of the command and those given."""
        return self.limits + command_limits(
            spline,
            nominal,
            max_velocity=self.max_velocity,
            max_acceleration=self.max_acceleration,
        )

    def _held(self) -> HeldRows:
        """Return the bounds of the rows that the residual holds."""
        members = 1 if self.ensemble is None else len(self.ensemble.draws)
        return held_rows(self.bounds, members)

    def _detail(
        self, spline: SplineOffsets, x: np.ndarray, bound: float
    ) -> dict[str, float]:
        """Return what the report says of the method."""
        return {
            "knot_spacing": spline.actual_spacing,
            "unknowns": float(x.size),
            "bound_count": float(np.sum(np.abs(x) >= bound)),
            "smoothness": self.smoothness,
            "lag_weight": self.lag_weight,
        }


def held_rows(bounds: SurfaceBounds | None, members: int = 1) -> HeldRows:
    """Return bounds of the surface as those of the last entries of the residual.

    Args:
        bounds: The bounds, or None.
        members: Members of the ensemble, each with rows of its own.

    Returns:
        The rows, in the unit of the residual.

    **Differentiability**: none, a host function.
    """
    if bounds is None:
        return HeldRows()
    return HeldRows(
        np.tile(bounds.lower / _UNIT, members), np.tile(bounds.upper / _UNIT, members)
    )


def check_held(
    bounds: SurfaceBounds,
    held: HeldRows,
    solution: LeastSquaresSolution,
    max_offset: float,
    limits: Sequence[AbstractLimits],
) -> None:
    """Raise if a solution leaves bounds of the surface.

    Args:
        bounds: The bounds.
        held: Their rows, see `held_rows`.
        solution: The solution.
        max_offset: Bound of its coefficients.
        limits: Their limits.

    Raises:
        InfeasibleLimit: It leaves them.

    **Differentiability**: none, a host function.
    """
    if held.is_within(solution.held) or not np.all(np.isfinite(solution.held)):
        return
    x, errors = np.asarray(solution.x), _UNIT * solution.held
    raise refusal(bounds, errors, x, max_offset, limits)


def _member_errors(
    coefficients: Float[Array, "coefficient axis"], args: ContourResidual
) -> Float[np.ndarray, " member"]:
    """Return the root mean square error of each member, in units of 0.1 mm."""
    assert args.ensemble is not None
    count = len(args.ensemble.draws)
    args = eqx.tree_at(
        lambda a: a.ensemble.weights,
        args,
        np.full(count, 1 / count),
        is_leaf=lambda x: x is None,
    )
    residual = np.asarray(evaluate(contour_residual, coefficients, args), np.float64)
    rough = jax.eval_shape(args.spline.roughness, coefficients).size
    held = 0 if args.bounds is None else count * len(args.bounds.lower)
    each = residual[: residual.size - rough - held].reshape(count, -1)
    return np.sqrt(count * np.sum(each**2, axis=1))


class _Told(eqx.Module):
    """Turn a step of the least squares into a message."""

    on_progress: OnProgress
    has_bounds: bool

    def __call__(self, step: LeastSquaresStep) -> bool | None:
        """Report the step; the roughness makes the error an upper bound."""
        error = _UNIT * float(np.sqrt(2 * step.cost))
        message = f"Gauss-Newton step {step.step}: {step.products} products"
        if self.has_bounds:
            message += ", what is out of bounds counted in"
        return self.on_progress(message, error)
