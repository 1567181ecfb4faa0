"""Offsets of a command as a least-squares problem with a Jacobian that is written down.

The unknowns are the coefficients of a spline, some hundred. Each is carried through the
linear system of the plant, many at once, which gives the whole Jacobian; every limit is
then a row of the one quadratic program of a step.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._result import SimulationFailed
from ..._types import RealScalarLike
from ...numerics import CachedJit
from ...optimise import (
    AbstractProblem,
    LeastSquaresState,
    LevenbergMarquardt,
    OutputConstraints,
    QuadraticModel,
    least_squares,
)
from .._core.linear_motion import LinearMotion, linear_motion
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Motion, Plant, Problem, motion_of
from .._spline.command_limits import LinearLimits
from .._spline.spline_offsets import SplineOffsets, SplineWindow
from .._surface.surface_limits import SurfaceBounds
from .minimax import CostModel, MinimaxModel, Unknowns

# Contour error that counts as one in the residual [m]; sets no result, only the size
# of the numbers and what `smoothness` is relative to.
UNIT = 1e-4
# Unknowns that are carried through the run at once: what bounds its memory.
_UNKNOWNS_AT_ONCE = 96
# Steps that may be taken besides to bring outputs within their bounds, and how little
# of the cost one of them may gain. What cannot be held gains nothing long before.
_RETURN_STEPS = 40
_NO_SLOPES = (
    "A small change of the command grows beyond all numbers within the run, as in a "
    "cut that chatters, where the motion is bounded all the same: Gauss-Newton has no "
    "slopes there. A stable cut has them: less depth, another speed of the spindle "
    "(`diffmill stability`), or more damping of the joints."
)
_RETURN_COST_RTOL = 1e-3


class ContourResidual(eqx.Module):
    """Residual of a correction as a function of the coefficients.

    Attributes:
        problem: The problem.
        spline: Basis of the offsets.
        smoothness: Weight of the roughness, see `GaussNewton`.
        lag_weight: Weight of the deviation along the path, see `GaussNewton`.
        objective: The error that is to become small.
        bounds: Bounds of the machined surface, whose errors follow as outputs.
    """

    problem: Problem
    spline: SplineOffsets | SplineWindow
    smoothness: RealScalarLike
    lag_weight: RealScalarLike
    objective: AbstractObjective = PathObjective()
    bounds: SurfaceBounds | None = None

    def __call__(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, " residual"]:
        """Weighted errors and the roughness as one vector [-], shape (residual,).

        With `PathObjective` its square is (rms contour error / 0.1 mm)^2 over the rows
        that cut, where one in the air counts a hundredth, plus (lag_weight x rms
        deviation along the path / 0.1 mm)^2 there, plus (smoothness x rms second
        difference of the coefficients / max_offset)^2.

        Args:
            coefficients: Spline coefficients of the offset, in the command's unit.

        Returns:
            Dimensionless residuals, the error first.

        **Differentiability**: that of the plant; kinks where the nearest segment
        changes.
        """
        motion = self.problem.plant(command_of(coefficients, self))
        residual = errors_of(motion, coefficients, self)
        return jnp.concatenate([residual.error, residual.rough])


class Errors(eqx.Module):
    """Residual of one motion in units of 0.1 mm, or its derivatives.

    Attributes:
        error: Errors that become small, shape (*direction, error).
        rough: Weighted second differences of the coefficients, shape (*direction,
            rough).
        output: Errors of the surface that have bounds, shape (*direction, output).
    """

    error: Float[Array, "*direction error"]
    rough: Float[Array, "*direction rough"]
    output: Float[Array, "*direction output"]


def errors_of(
    motion: Motion,
    coefficients: Float[Array, "coefficient axis"],
    args: ContourResidual,
) -> Errors:
    """Residual of a motion, see `ContourResidual`.

    **Differentiability**: kinks where the nearest segment changes.
    """
    problem, dtype = args.problem, coefficients.dtype
    error = args.objective.errors(problem, motion, args.lag_weight)
    if error.ndim != 1:
        raise ValueError(
            f"`{type(args.objective).__name__}.errors` must return shape (error,), but "
            f"returns {error.shape}."
        )
    rough = args.spline.roughness(coefficients)
    price = jnp.asarray(args.smoothness, dtype) / np.sqrt(rough.shape[0])
    rough = rough * (price / jnp.asarray(problem.max_offset, dtype))
    none = jnp.zeros((0,), dtype)
    output = none if args.bounds is None else args.bounds.errors(motion)
    return Errors(error / UNIT, rough.reshape(-1), output / UNIT)


class FitValue(eqx.Module):
    """Residual at a point, on the host.

    Attributes:
        errors: Of every member, shape (member, error).
        rough: Roughness, shape (rough,).
        outputs: Outputs that have bounds, of every member, shape (member, output).
        motion: What the only member does there, if it was run; None of several.
        linear: The linear system around the point, if it is known already.
    """

    errors: Float[np.ndarray, "member error"]
    rough: Float[np.ndarray, " rough"]
    outputs: Float[np.ndarray, "member output"]
    motion: Motion | None = None
    linear: LinearMotion | None = None


class _MemberModel(eqx.Module):
    """Linear model of the residual of one member, on the host.

    Attributes:
        errors: The errors, shape (error,).
        slopes: Derivative of the errors, shape (error, unknown).
        rough_slopes: Of the roughness, shape (rough, unknown).
        output_slopes: Of the outputs that have bounds, shape (output, unknown).
    """

    errors: Float[np.ndarray, " error"]
    slopes: Float[np.ndarray, "error unknown"]
    rough_slopes: Float[np.ndarray, "rough unknown"]
    output_slopes: Float[np.ndarray, "output unknown"]


class OffsetFit(AbstractProblem):
    """Offsets of a command whose errors become small, in all members of an ensemble.

    Attributes:
        args: What the residual needs.
        plants: The members' plants; one for a certain model.
        weights: Shares of the members in the mean square, shape (member,).
        limits: Limits of the coefficients.
        constraints: Bounds of the outputs, of one member after the other.
        is_worst_case: Whether the largest mean square of a member counts instead.
        on_slopes: Called with the share of a model's slopes that is computed.
    """

    args: ContourResidual
    plants: Sequence[Plant]
    weights: Float[np.ndarray, " member"]
    limits: Sequence[LinearLimits] = ()
    constraints: OutputConstraints = OutputConstraints()
    is_worst_case: bool = eqx.field(static=True, default=False)
    on_slopes: Callable[[float], None] | None = eqx.field(static=True, default=None)

    def coefficients(self, x: Unknowns) -> Float[Array, "coefficient axis"]:
        """Unknowns as coefficients, shape (coefficient, axis)."""
        nominal = np.asarray(self.args.problem.nominal)
        return jnp.asarray(x.reshape(-1, nominal.shape[1]), nominal.dtype)

    def command(self, x: Unknowns) -> Float[Array, "step axis"]:
        """Whole command of the unknowns, shape (step, axis)."""
        return _host_command(self.coefficients(x), self.args)

    def is_within(self, value: FitValue) -> bool:
        """True if all outputs are within their bounds."""
        return self.constraints.is_within(value.outputs.reshape(-1))

    def evaluate_for_model(self, x: Unknowns) -> FitValue | None:
        """Residual at a point whose model is likely to be wanted next.

        The linear system that the model needs has the motion too, so that none is run
        for it. Of several members only one system is held at a time.
        """
        if len(self.plants) > 1:
            return self.evaluate(x)
        linear = linear_motion(self.plants[0], self.command(x))
        return self._value(x, [linear.motion], linear=linear)

    def has_model(self, value: FitValue) -> bool:
        """True if a value came with the linear system of its model."""
        return value.linear is not None

    def without_model(self, value: FitValue) -> FitValue:
        """Value without its linear system."""
        return dataclasses.replace(value, linear=None)

    def evaluate(self, x: Unknowns) -> FitValue | None:
        """Residual at a point; None where it is not finite."""
        command = self.command(x)
        motions = [motion_of(plant, command) for plant in self.plants]
        return self._value(x, motions, motion=motions[0] if len(motions) == 1 else None)

    def _value(
        self,
        x: Unknowns,
        motions: Sequence[Motion],
        *,
        motion: Motion | None = None,
        linear: LinearMotion | None = None,
    ) -> FitValue | None:
        """Residual of the members' motions; None if it is not finite."""
        at = self.coefficients(x)
        # A motion with its solution would be another program.
        plain = [Motion(one.actual, one.force) for one in motions]
        residuals = [_host_errors(one, at, self.args) for one in plain]
        stack = lambda rows: np.stack([np.asarray(row, np.float64) for row in rows])
        value = FitValue(
            stack([one.error for one in residuals]),
            np.asarray(residuals[0].rough, np.float64),
            stack([one.output for one in residuals]),
            motion,
            linear,
        )
        square = self._cost(value) + np.sum(value.outputs**2)
        return value if np.isfinite(square) else None

    def _cost(self, value: FitValue) -> float:
        """Half the square of the residual, outputs left out."""
        squares = np.sum(value.errors**2, axis=1)
        members = squares.max() if self.is_worst_case else self.weights @ squares
        return 0.5 * float(members + value.rough @ value.rough)

    def model(self, x: Unknowns, value: FitValue) -> QuadraticModel:
        """Model of half the square of the residual, by Gauss and Newton.

        Raises:
            SimulationFailed: The motion answers a change of the command by one that
                grows without end, as in a cut that chatters.
        """
        zero = CostModel(0.0, np.zeros(x.size), np.zeros((x.size, x.size)))
        mean, members, slopes, rough = zero, [], [], np.zeros((0, x.size))
        for plant, weight, error in zip(
            self.plants, self.weights, value.errors, strict=True
        ):
            done = len(slopes)
            linear = value.linear
            if linear is None:
                linear = linear_motion(plant, self.command(x))
            member = self._member_model(linear, x, done)
            with np.errstate(over="ignore", invalid="ignore"):
                g, H = member.slopes.T @ member.errors, member.slopes.T @ member.slopes
            if not (np.isfinite(g).all() and np.isfinite(H).all()):
                raise SimulationFailed(_NO_SLOPES)
            cost = CostModel(0.5 * float(error @ error), g, H)
            # The largest is looked for among all; of a mean the sum does.
            if self.is_worst_case:
                members.append(cost)
            else:
                mean = mean.plus(float(weight), cost)
            slopes.append(member.output_slopes)
            rough = member.rough_slopes
        shared = CostModel.of(value.rough, rough)
        point = np.asarray(self.coefficients(x), np.float64)
        rows = [limit.about(point) for limit in self.limits]
        outputs, is_hard = value.outputs.reshape(-1), self.is_within(value)
        if outputs.size:
            rows.append(self.constraints.rows(outputs, np.concatenate(slopes)))
        cost_at = lambda x, at: (
            self._cost(at)
            + self.constraints.cost(at.outputs.reshape(-1), is_hard=is_hard)
        )
        if self.is_worst_case:
            return MinimaxModel.of(cost_at, members, shared, rows)
        mean = mean.plus(1.0, shared)
        return QuadraticModel(cost_at, mean.gradient, mean.curvature, tuple(rows))

    def _member_model(
        self, linear: LinearMotion, x: Unknowns, done: int
    ) -> _MemberModel:
        """Linear model of the residual of a member in all unknowns, block by block.

        Args:
            linear: Its linear system.
            x: The point.
            done: How many members are done.
        """
        at = self.coefficients(x)
        # Its solution would make another program.
        motion = Motion(linear.motion.actual, linear.motion.force)
        objective = self.args.objective.for_step(
            self.args.problem, motion, self.args.lag_weight
        )
        args = dataclasses.replace(self.args, objective=objective)
        # Blocks of one length, the last one filled up.
        size = min(_UNKNOWNS_AT_ONCE, x.size)
        errors, blocks = None, []
        for first in range(0, x.size, size):
            block = np.minimum(np.arange(first, first + size), x.size - 1)
            errors, slopes = _slopes(linear, at, args, jnp.asarray(block))
            blocks.append(slopes)
            if self.on_slopes is not None:
                part = min(first + size, x.size) / x.size
                self.on_slopes((done + part) / len(self.plants))
        joined = lambda rows: np.concatenate([np.asarray(row) for row in rows])[
            : x.size
        ].T.astype(np.float64)
        return _MemberModel(
            np.asarray(errors, np.float64),
            joined([block.error for block in blocks]),
            joined([block.rough for block in blocks]),
            joined([block.output for block in blocks]),
        )


def offset_fit(
    args: ContourResidual,
    plants: Sequence[Plant],
    weights: Float[np.ndarray, " member"] | None = None,
    limits: Sequence[LinearLimits] = (),
    *,
    is_worst_case: bool = False,
) -> OffsetFit:
    """Problem of some plants, with the bounds of the surface of `args`.

    Args:
        args: What the residual needs; its own plant is left out.
        plants: The members' plants.
        weights: Shares of the members in the mean square; equal if None.
        limits: Limits of the coefficients.
        is_worst_case: Whether the largest mean square of a member counts instead.
    """
    count = len(plants)
    equal = np.full(count, 1 / count)
    constraints = OutputConstraints()
    if (bounds := args.bounds) is not None:
        constraints = OutputConstraints(
            np.tile(bounds.lower / UNIT, count), np.tile(bounds.upper / UNIT, count)
        )
    return OffsetFit(
        dataclasses.replace(args, problem=args.problem.without_plant),
        tuple(plants),
        equal if weights is None else np.asarray(weights, np.float64),
        tuple(limits),
        constraints,
        is_worst_case,
    )


def fit_offsets(
    fit: OffsetFit,
    start: Float[np.ndarray, "coefficient axis"],
    solver: LevenbergMarquardt,
    *,
    lower: float | Unknowns,
    upper: float | Unknowns,
    state: LeastSquaresState | None = None,
    callback: Callable[[LeastSquaresState], bool | None] | None = None,
) -> LeastSquaresState | None:
    """State of the search for the offsets whose errors are least, at its end.

    Where outputs begin out of their bounds they are brought back first, in up to 40
    steps that do not count as those of the solver.

    Args:
        fit: The problem.
        start: Coefficients, shape (coefficient, axis), within the bounds and limits.
        solver: Settings.
        lower: Least values of the unknowns.
        upper: Largest values.
        state: An earlier state to go on from.
        callback: Called with the state after each step; True ends the search.

    Returns:
        The last state; None where the start has no finite residual.

    **Differentiability**: none, a host function.
    """
    if state is None:
        x = np.clip(np.asarray(start, np.float64).reshape(-1), lower, upper)
        value = fit.evaluate_for_model(x)
        if value is None:
            return None
        state = LeastSquaresState.begin(fit, x, value, solver.damping)
        del value
    is_stopped = False

    def report_return(latest: LeastSquaresState) -> bool:
        nonlocal state, is_stopped
        # One linear system is held at a time: by what goes on.
        state = _without_model(fit, latest)
        if fit.is_within(latest.value):
            state = dataclasses.replace(
                latest, steps=0, has_converged=False, damping=solver.damping
            )
        is_stopped = callback is not None and bool(callback(state))
        return is_stopped or fit.is_within(latest.value)

    search = functools.partial(least_squares, fit, lower=lower, upper=upper)
    if not fit.is_within(state.value):
        back = dataclasses.replace(
            solver, max_steps=_RETURN_STEPS, cost_rtol=_RETURN_COST_RTOL
        )
        x, begun, state = state.x, [state], _without_model(fit, state)
        search(x, back, state=begun.pop(), callback=report_return)
        if is_stopped or not fit.is_within(state.value):
            return state
    x, begun, state = state.x, [state], None
    last = search(x, solver, state=begun.pop(), callback=callback)
    return _without_model(fit, last)


def _without_model(fit: OffsetFit, state: LeastSquaresState) -> LeastSquaresState:
    """State without the linear system around its point."""
    return dataclasses.replace(state, value=fit.without_model(state.value))


def command_of(
    coefficients: Float[Array, "coefficient axis"], args: ContourResidual
) -> Float[Array, "step axis"]:
    """Whole command from the coefficients of its offset, shape (step, axis)."""
    nominal = jnp.asarray(args.problem.nominal, coefficients.dtype)
    return nominal + args.spline.offsets(coefficients)


_host_command = eqx.filter_jit(command_of)
_host_errors = eqx.filter_jit(errors_of)


@CachedJit
def _slopes(
    linear: LinearMotion,
    coefficients: Float[Array, "coefficient axis"],
    args: ContourResidual,
    block: Int[Array, " direction"],
) -> tuple[Float[Array, " error"], Errors]:
    """Errors at a point, and slopes of the residual in some unknowns, a row each."""
    count, axes = coefficients.shape
    dtype = coefficients.dtype
    # The basis is the same for every axis: its columns are offsets of unit vectors.
    basis = args.spline.offsets(jnp.eye(count, dtype=dtype))
    column, axis = block // axes, block % axes
    along = jax.nn.one_hot(axis, axes, dtype=dtype)
    moves = linear.move(basis[:, column][:, None] * along.T[None])
    units = along[:, None] * jax.nn.one_hot(column, count, dtype=dtype)[..., None]
    residual = lambda motion, x: errors_of(motion, x, args)
    value, jvp = jax.linearize(residual, linear.motion, coefficients)
    return value.error, jax.vmap(jvp)(moves, units)
