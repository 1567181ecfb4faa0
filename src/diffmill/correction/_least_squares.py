"""Bounded nonlinear least squares: Levenberg-Marquardt with products only.

    minimise |r(x)|^2 / 2   subject to  lower <= x <= upper  and linear limits

Each outer step linearises the residual once, minimises the damped linear model within
the bounds by projected conjugate gradients, and accepts the trial point by the ratio of
the true to the predicted decrease, which also sets the damping (Nielsen's rule, see
Madsen, Nielsen and Tingleff, Methods for Non-Linear Least Squares Problems, 2004).
A refused step keeps its linearisation.
"""

import time
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._result import RESULTS
from .._types import RealScalarLike
from ._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
    LevenbergMarquardt,
)
from ._limited_quadratic import solve_limited_quadratic
from ._limits import LinearLimits
from ._products import Residual, evaluate
from ._quadratic import (
    QuadraticSolution,
    projected_gradient,
)

# Smallest ratio of true to predicted decrease with which a step is accepted.
_ACCEPT = 1e-4

# A bound of all unknowns: one number, or one per unknown.
Bound = RealScalarLike | Float[Array, "*unknown"] | Float[np.ndarray, "*unknown"]


class _Box(eqx.Module):
    """Bounds and scale of the unknowns x, in NumPy; inside, z = x / scale."""

    least: np.ndarray
    most: np.ndarray
    scale: np.ndarray
    dtype: np.dtype

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of z."""
        return self.least / self.scale

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of z."""
        return self.most / self.scale

    def point(self, z: np.ndarray) -> Array:
        """Return x on the device for a z, within the bounds to the last bit."""
        x = np.clip(z * self.scale, self.least, self.most)
        return jnp.asarray(x, self.dtype)

    def vector(self, p: np.ndarray) -> Array:
        """Return the difference of two x on the device for one of two z."""
        return jnp.asarray(p * self.scale, self.dtype)


class _State(eqx.Module):
    """The iteration between two outer steps, in units of the scale."""

    z: np.ndarray
    cost: float
    gradient: np.ndarray
    linear: PyTree
    damping: float
    growth: float
    products: int
    forward_runs: int


def least_squares(
    residual: Residual,
    start: Float[Array, "*unknown"],
    args: PyTree = None,
    *,
    lower: Bound = -np.inf,
    upper: Bound = np.inf,
    scale: Bound = 1.0,
    limits: Sequence[LinearLimits] = (),
    solver: LevenbergMarquardt | None = None,
    precondition: Callable[[np.ndarray], np.ndarray] | None = None,
    on_progress: Callable[[LeastSquaresStep], bool | None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
    on_memory: Callable[[LeastSquaresMemory], object] | None = None,
    resume: LeastSquaresMemory | None = None,
) -> LeastSquaresSolution:
    """Minimise half the squared residual within bounds.

    Args:
        residual: r(x, args), traceable, one array.
        start: First point, any shape; moved into the bounds.
        args: Everything else that the residual needs; a pytree.
        lower: Lower bounds, a number or of the shape of `start`.
        upper: Upper bounds, likewise.
        scale: Typical size of an unknown, likewise: a diagonal preconditioner. With
            limits it must be the same for all.
        limits: Limits of differences of the unknowns, which `start` keeps.
        solver: Settings.
        precondition: Roughly the inverse of J^T J, on NumPy arrays of the shape of
            `start`; symmetric and positive semidefinite.
        on_progress: Called after every outer step; True ends the iteration with the
            best point so far.
        clock: Returns the time [s].
        on_memory: Called after every outer step with all that is needed to go on.
        resume: What it was called with, to go on from there as if nothing had been.

    Returns:
        The solution with its history. Where `on_progress` or the limit of steps ends
        it, `.result` is `not_converged`.

    **Differentiability**: runs on the host, not traceable.
    """
    solver = LevenbergMarquardt() if solver is None else solver
    box = _box(start, lower, upper, scale)
    z = np.clip(np.asarray(start, np.float64) / box.scale, box.lower, box.upper)
    history = [] if resume is None else list(resume.history)
    began = clock() - (history[-1].seconds if history else 0.0)
    if resume is None:
        state = _State(z, np.inf, z, None, 0.0, 2.0, 0, 0)
    else:
        state = _remembered(resume)
    state = _linearised(solver, residual, args, box, state)
    if not (np.isfinite(state.cost) and np.all(np.isfinite(state.gradient))):
        return _solution(box, state, history, RESULTS.non_finite)
    if resume is None:
        state = _first_damping(solver, box, state)
    first = _kkt(state, box) if resume is None else resume.first_kkt
    is_done = first == 0 if resume is None else resume.is_done
    while not is_done and len(history) < solver.max_steps:
        before, kkt = state.cost, _kkt(state, box)
        inner = _inner(solver, state, box, limits, precondition)
        state, trial_cost, gain, damping = _try(residual, args, box, state, inner)
        if gain > _ACCEPT:
            state = _linearised(solver, residual, args, box, state)
        record = LeastSquaresStep(
            step=len(history) + 1,
            cost=state.cost,
            trial_cost=trial_cost,
            is_accepted=gain > _ACCEPT,
            gain_ratio=gain,
            damping=damping,
            kkt=kkt,
            bound_count=int(inner.is_bound.sum()),
            products=state.products,
            forward_runs=state.forward_runs,
            seconds=clock() - began,
        )
        history.append(record)
        is_done = _is_converged(solver, record, before, inner)
        is_done |= _kkt(state, box) <= solver.kkt_rtol * first
        if on_memory is not None:
            on_memory(_memory(state, first, is_done, history))
        if on_progress is not None and on_progress(record) and not is_done:
            break
    result = RESULTS.successful if is_done else RESULTS.not_converged
    return _solution(box, state, history, result)


def _box(start: Array, lower: Bound, upper: Bound, scale: Bound) -> _Box:
    """Return the bounds in units of the scale."""
    full = [
        np.broadcast_to(np.asarray(value, np.float64), start.shape)
        for value in (lower, upper, scale)
    ]
    if not np.all(full[0] <= full[1]):
        raise ValueError("Argument `lower` must not exceed `upper`, but does.")
    if not np.all((full[2] > 0) & np.isfinite(full[2])):
        raise ValueError("Argument `scale` must be positive and finite, but is not.")
    return _Box(full[0], full[1], full[2], np.dtype(start.dtype))


def _remembered(memory: LeastSquaresMemory) -> _State:
    """Return the state of which only the linearisation is missing."""
    return _State(
        z=memory.z,
        cost=np.inf,
        gradient=memory.z,
        linear=None,
        damping=memory.damping,
        growth=memory.growth,
        # The linearisation has been counted.
        products=memory.products - 1,
        forward_runs=memory.forward_runs - 1,
    )


def _memory(
    state: _State, first_kkt: float, is_done: bool, history: list[LeastSquaresStep]
) -> LeastSquaresMemory:
    return LeastSquaresMemory(
        z=state.z,
        damping=state.damping,
        growth=state.growth,
        first_kkt=first_kkt,
        is_done=bool(is_done),
        products=state.products,
        forward_runs=state.forward_runs,
        history=tuple(history),
    )


def _half_square(residual: Array) -> float:
    return 0.5 * float(jnp.sum(residual**2))


def _linearised(
    solver: LevenbergMarquardt,
    residual: Residual,
    args: PyTree,
    box: _Box,
    state: _State,
) -> _State:
    """Return the state with residual, gradient and linear program at its z."""
    x = box.point(state.z)
    r, linear = solver.products.linearise(residual, x, args)
    gradient = np.asarray(solver.products.transpose(linear, x, r), np.float64)
    return _State(
        z=state.z,
        cost=_half_square(r),
        gradient=gradient * box.scale,
        linear=linear,
        damping=state.damping,
        growth=state.growth,
        products=state.products + 1,
        forward_runs=state.forward_runs + 1,
    )


def _normal(
    solver: LevenbergMarquardt, box: _Box, state: _State, p: np.ndarray
) -> np.ndarray:
    """Return J^T J p in units of the scale."""
    v = box.vector(p)
    w = solver.products.forward(state.linear, v)
    back = solver.products.transpose(state.linear, v, w)
    return np.asarray(back, np.float64) * box.scale


def _first_damping(solver: LevenbergMarquardt, box: _Box, state: _State) -> _State:
    """Set the damping relative to the curvature along the gradient."""
    g = state.gradient
    curvature = np.sum(g * _normal(solver, box, state, g)) / max(np.sum(g**2), 1e-300)
    return eqx.tree_at(
        lambda s: (s.damping, s.products),
        state,
        (solver.damping * float(curvature), state.products + 2),
    )


def _inner(
    solver: LevenbergMarquardt,
    state: _State,
    box: _Box,
    limits: Sequence[LinearLimits],
    precondition: Callable[[np.ndarray], np.ndarray] | None,
) -> QuadraticSolution:
    """Minimise the damped linear model within the bounds and limits."""
    if precondition is not None:
        outer = precondition
        precondition = lambda g: outer(g / box.scale) / box.scale
    unit = box.scale.flat[0]
    return solve_limited_quadratic(
        lambda p: _normal(solver, box, state, p) + state.damping * p,
        state.gradient,
        box.lower - state.z,
        box.upper - state.z,
        [limit.about(state.z * unit, unit) for limit in limits],
        rtol=solver.inner_rtol,
        max_products=(solver.max_products - 1) // 2,
        precondition=precondition,
    )


def _try(
    residual: Residual,
    args: PyTree,
    box: _Box,
    state: _State,
    inner: QuadraticSolution,
) -> tuple[_State, float, float, float]:
    """Evaluate the trial point; return state, trial cost, gain and damping used."""
    model = inner.decrease + 0.5 * state.damping * float(np.sum(inner.p**2))
    slope = float(np.sum(inner.p * state.gradient))
    trial = np.clip(state.z + inner.p, box.lower, box.upper)
    cost = _half_square(evaluate(residual, box.point(trial), args))
    gain = (state.cost - cost) / model if model > 0 else 0.0
    gain = float(gain) if np.isfinite(cost) else -np.inf
    is_accepted = gain > _ACCEPT
    if is_accepted:
        factor = max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3)
        damping, growth = state.damping * factor, 2.0
    else:
        # Without the curvature along the step, a damping that was far too small to
        # matter would be raised, and the same step refused, many times over.
        square = float(np.sum(inner.p**2))
        along = (-2 * inner.decrease - 2 * slope) / square if square > 0 else 0.0
        damping = max(state.damping * state.growth, along)
        growth = 2 * state.growth
    new = _State(
        z=trial if is_accepted else state.z,
        cost=state.cost,
        gradient=state.gradient,
        # The linear program may be large: an accepted step lets the old one go
        # before the new one is made.
        linear=None if is_accepted else state.linear,
        damping=damping,
        growth=growth,
        products=state.products + 2 * inner.products,
        forward_runs=state.forward_runs + 1,
    )
    return new, cost, gain, state.damping


def _is_converged(
    solver: LevenbergMarquardt,
    record: LeastSquaresStep,
    before: float,
    inner: QuadraticSolution,
) -> bool:
    """Tell whether the step, or what the model promises, has become small."""
    small = solver.cost_rtol * before
    if inner.decrease <= small:
        return True
    return record.is_accepted and before - record.cost <= small


def _kkt(state: _State, box: _Box) -> float:
    """Return the largest entry of the projected gradient."""
    entries = projected_gradient(state.z, state.gradient, box.lower, box.upper)
    return float(np.max(np.abs(entries)))


def _solution(
    box: _Box, state: _State, history: list[LeastSquaresStep], result: RESULTS
) -> LeastSquaresSolution:
    return LeastSquaresSolution(
        x=box.point(state.z), cost=state.cost, history=tuple(history), result=result
    )
