"""Correction by least squares on the contour error, with exact derivatives."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import RealScalarLike
from ._bspline import SplineOffsets
from ._ensemble import Ensemble
from ._least_squares import least_squares
from ._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresStep,
    LevenbergMarquardt,
)
from ._limits import command_limits
from ._method import AbstractMethod, Corrected, OnProgress, corrected
from ._objective import AbstractObjective, PathObjective
from ._problem import FloatRows, Problem
from ._projection import project
from ._response import TipResponse, spline_preconditioner
from ._spline_window import SplineWindow

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
    """

    problem: Problem
    spline: SplineOffsets | SplineWindow
    smoothness: RealScalarLike
    lag_weight: RealScalarLike
    objective: AbstractObjective = PathObjective()
    ensemble: Ensemble | None = None


def contour_residual(
    coefficients: Float[Array, "coefficient axis"], args: ContourResidual
) -> Float[Array, " residual"]:
    """Return the weighted errors and the roughness as one vector.

    With `PathObjective` its square is (rms contour error / 0.1 mm)^2 over the rows
    that cut, plus (lag_weight x rms deviation along the path / 0.1 mm)^2 there, plus
    (smoothness x rms second difference of the coefficients / max_offset)^2. With an
    ensemble the first two are means over its members.

    Args:
        coefficients: Spline coefficients of the offset, in the command's unit.
        args: The problem, the basis and the weight.

    Returns:
        Dimensionless residuals, the error first.

    **Differentiability**: that of the plant; kinks where the nearest segment changes.
    """
    problem = args.problem
    dtype = coefficients.dtype
    nominal = jnp.asarray(problem.nominal, dtype)
    command = nominal + args.spline.offsets(coefficients)
    errors = lambda motion: args.objective.errors(problem, motion, args.lag_weight)
    if args.ensemble is None:
        error = errors(problem.plant(command)) / _UNIT
    else:
        each = jax.vmap(errors)(args.ensemble.motions(command))
        error = each.reshape(-1) / (_UNIT * np.sqrt(each.shape[0]))
    rough = args.spline.roughness(coefficients)
    price = jnp.asarray(args.smoothness, dtype) / np.sqrt(rough.shape[0])
    rough = rough * (price / jnp.asarray(problem.max_offset, dtype))
    return jnp.concatenate([error, rough.reshape(-1)])


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
    max_velocity: float = np.inf
    max_acceleration: float = np.inf

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_memory: Callable[[LeastSquaresMemory], object] | None = None,
        resume: LeastSquaresMemory | None = None,
    ) -> Corrected:
        """Return the best command within knots and bounds, from `start`.

        `on_memory` and `resume` are those of `least_squares`.

        Raises:
            InfeasibleLimit: The nominal command breaks a limit.
        """
        rows, axes = problem.nominal.shape
        spline = SplineOffsets(rows, problem.time_step, self.knot_spacing)
        bound = float(problem.max_offset)
        nominal = np.asarray(problem.nominal)
        limits = command_limits(
            spline,
            nominal,
            max_velocity=self.max_velocity,
            max_acceleration=self.max_acceleration,
        )
        first = np.zeros((spline.coefficient_count, axes))
        if start is not None:
            first = project(spline, np.asarray(start) - nominal, bound, limits=limits)
        solution = least_squares(
            contour_residual,
            jnp.asarray(first, nominal.dtype),
            ContourResidual(
                problem,
                spline,
                jnp.asarray(self.smoothness, nominal.dtype),
                jnp.asarray(self.lag_weight, nominal.dtype),
                self.objective,
                self.ensemble,
            ),
            lower=-bound,
            upper=bound,
            scale=bound,
            limits=limits,
            solver=self.solver,
            precondition=None
            if self.response is None
            else spline_preconditioner(self.response, spline, problem.time_step),
            on_progress=None if on_progress is None else _Told(on_progress),
            on_memory=on_memory,
            resume=resume,
        )
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


class _Told(eqx.Module):
    """Turn a step of the least squares into a message."""

    on_progress: OnProgress

    def __call__(self, step: LeastSquaresStep) -> bool | None:
        """Report the step; the roughness makes the error an upper bound."""
        error = _UNIT * float(np.sqrt(2 * step.cost))
        return self.on_progress(
            f"Gauss-Newton step {step.step}: {step.products} products", error
        )
