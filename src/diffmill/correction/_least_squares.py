"""Bounded nonlinear least squares: Levenberg-Marquardt with products only.

    minimise |r(x)|^2 / 2   subject to  lower <= x <= upper,  linear limits
                            and bounds of further rows that come with r

Each outer step linearises the residual once, minimises the damped linear model within
the bounds with products only, and accepts the trial point by the ratio of
the true to the predicted decrease, which also sets the damping (Nielsen's rule, see
Madsen, Nielsen and Tingleff, Methods for Non-Linear Least Squares Problems, 2004).
A refused step is tried again with more damping, in the span of what it has multiplied;
if that is refused too, the next one keeps its linearisation.
"""

import functools
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, PyTree

from .._result import RESULTS
from ._held_rows import HeldRows, held_step
from ._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
    LevenbergMarquardt,
)
from ._least_squares_state import (
    Bound,
    Box,
    State,
    first_damping,
    largest_slope,
    linearised,
    memory_of,
    model_at,
    normal,
    solution_at,
    state_at,
    state_of,
    take_spent,
    unit_box,
)
from ._limited_quadratic import LimitedQuadratic, QuadraticNotSolved, Spring
from ._products import Residual, evaluate
from ._quadratic import QuadraticSolution
from ._spline.command_limits import AbstractLimits, AbstractRows

# Smallest ratio of true to predicted decrease with which a step is accepted.
_ACCEPT = 1e-4
# Shorter trials of a refused step, from what it has multiplied already: a run each.
_SHORTER = 3
# Steps that may be taken besides to bring held rows within their bounds, and how little
# of the cost one of them may gain. What cannot be held gains nothing long before.
_RETURN_STEPS = 40
_RETURN_RTOL = 1e-3


class _Trial(NamedTuple):
    """A trial point: its cost, true over predicted decrease, and the damping used."""

    cost: float
    gain: float
    damping: float


def least_squares(
    residual: Residual,
    start: Float[Array, "*unknown"],
    args: PyTree = None,
    *,
    lower: Bound = -np.inf,
    upper: Bound = np.inf,
    scale: Bound = 1.0,
    limits: Sequence[AbstractLimits] = (),
    held: HeldRows | None = None,
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
        limits: Limits of the unknowns, which `start` keeps.
        held: Bounds of the last entries of the residual, which do not count in the
            square. Where `start` does not keep them they are gone for first, in up to
            40 steps that do not count as those of the solver.
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
        it, rounding leaves no step within the limits, or held rows stay out of their
        bounds, `.result` is `not_converged`.

    **Differentiability**: runs on the host, not traceable.
    """
    solver = LevenbergMarquardt() if solver is None else solver
    box = unit_box(start, lower, upper, scale)
    held = HeldRows() if held is None else held
    history = [] if resume is None else list(resume.history)
    began = clock() - (history[-1].seconds if history else 0.0)
    state = state_at(box, start) if resume is None else state_of(resume)
    state = linearised(solver, residual, args, box, held, state)
    if not (np.isfinite(state.cost) and np.all(np.isfinite(state.gradient))):
        return solution_at(box, held, state, history, RESULTS.non_finite)
    if resume is None:
        state = first_damping(solver, held, state)
    first = largest_slope(state, box) if resume is None else resume.first_kkt
    is_done = first == 0 if resume is None else resume.is_done
    while not is_done and _has_steps(solver, state, history):
        before, kkt = state.cost, largest_slope(state, box)
        weight, damping = state.weight, state.damping
        small = before * (_RETURN_RTOL if weight else solver.cost_rtol)
        model_of = functools.partial(_model, solver, box, limits, held, precondition)
        try:
            state, tried, inner, promised = _step(
                residual, args, box, held, state, model_of, small
            )
        except QuadraticNotSolved:
            # Rounding is all that is left; the best point so far is not converged.
            break
        if tried.gain > _ACCEPT:
            state = linearised(solver, residual, args, box, held, state)
        step, seconds = len(history) + 1, clock() - began
        record = _recorded(step, state, tried, kkt, inner, seconds, weight)
        history.append(record)
        # What counts is another cost once all held rows are within their bounds.
        if state.weight == weight:
            gained = before - record.cost
            is_done = _is_converged(record, damping, gained, promised, small)
            is_done |= largest_slope(state, box) <= solver.kkt_rtol * first
        if on_memory is not None:
            on_memory(memory_of(state, first, is_done, history))
        if on_progress is not None and on_progress(record) and not is_done:
            break
    is_good = is_done and state.weight == 0
    result = RESULTS.successful if is_good else RESULTS.not_converged
    return solution_at(box, held, state, history, result)


def _recorded(
    step: int,
    state: State,
    tried: _Trial,
    kkt: float,
    inner: QuadraticSolution,
    seconds: float,
    weight: float,
) -> LeastSquaresStep:
    """Return what a step did and what has been spent."""
    return LeastSquaresStep(
        step=step,
        cost=state.cost,
        trial_cost=tried.cost,
        is_accepted=tried.gain > _ACCEPT,
        gain_ratio=tried.gain,
        damping=tried.damping,
        kkt=kkt,
        bound_count=int(inner.is_bound.sum()),
        products=state.products,
        forward_runs=state.forward_runs,
        seconds=seconds,
        weight=weight,
    )


def _has_steps(
    solver: LevenbergMarquardt, state: State, history: list[LeastSquaresStep]
) -> bool:
    """Tell whether steps are left, of those within the bounds or of those outside."""
    outside = sum(step.weight > 0 for step in history)
    if state.weight:
        return outside < _RETURN_STEPS
    return len(history) - outside < solver.max_steps


def _step(
    residual: Residual,
    args: PyTree,
    box: Box,
    held: HeldRows,
    state: State,
    model_of: Callable[[State], LimitedQuadratic],
    small: float,
) -> tuple[State, _Trial, QuadraticSolution, float]:
    """Try the step of the damped linear model, and shorter ones if it is refused.

    Returns:
        The state, the last trial, its solution of the model, and the decrease that the
        first one promised: where that is small no more is tried.

    Raises:
        QuadraticNotSolved: The model has no solution to working precision.
    """
    model = model_of(state)
    inner = model.solve(state.damping)
    promised = inner.decrease
    state, tried = _try(residual, args, box, held, state, inner)
    for _ in range(_SHORTER):
        if tried.gain > _ACCEPT or promised <= small:
            break
        shorter = model.solve_again(state.damping)
        if shorter is None:
            break
        inner = shorter
        state, tried = _try(residual, args, box, held, state, inner)
    return state, tried, inner, promised


def _model(
    solver: LevenbergMarquardt,
    box: Box,
    limits: Sequence[AbstractLimits],
    held: HeldRows,
    precondition: Callable[[np.ndarray], np.ndarray] | None,
    state: State,
) -> LimitedQuadratic:
    """Return the linear model within the bounds and limits, damping left open."""
    if precondition is not None:
        outer = precondition
        precondition = lambda g: outer(g / box.scale) / box.scale
    unit = box.scale.flat[0]
    bounds: list[AbstractRows] = [limit.about(state.z * unit, unit) for limit in limits]
    gradient, springs = state.gradient, []
    if held.count:
        model, r = model_at(state)
        rows = held_step(held, model, r)
        if state.weight:
            springs.append(Spring(rows, state.weight))
            gradient = model.gradient(held.without(r))
        else:
            bounds.append(rows)
    return LimitedQuadratic(
        lambda p: normal(held, state, p),
        gradient,
        box.lower - state.z,
        box.upper - state.z,
        bounds,
        springs=springs,
        rtol=solver.inner_rtol,
        max_products=(solver.max_products - 1) // 2,
        precondition=precondition,
        rounding=float(np.finfo(box.dtype).eps),
    )


def _try(
    residual: Residual,
    args: PyTree,
    box: Box,
    held: HeldRows,
    state: State,
    inner: QuadraticSolution,
) -> tuple[State, _Trial]:
    """Evaluate the trial point; return the state after it, and what it was."""
    model = inner.decrease + 0.5 * state.damping * float(np.sum(inner.p**2))
    slope = float(np.sum(inner.p * state.gradient))
    trial = np.clip(state.z + inner.p, box.lower, box.upper)
    cost = held.cost(evaluate(residual, box.point(trial), args), state.weight)
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
    new = State(
        z=trial if is_accepted else state.z,
        cost=state.cost,
        gradient=state.gradient,
        # The linear program may be large: an accepted step lets the old one go
        # before the new one is made.
        linear=None if is_accepted else state.linear,
        residual=None if is_accepted else state.residual,
        weight=state.weight,
        damping=damping,
        growth=growth,
        products=state.products + take_spent(state),
        forward_runs=state.forward_runs + 1,
    )
    return new, _Trial(cost, gain, state.damping)


def _is_converged(
    record: LeastSquaresStep,
    damping: float,
    gained: float,
    promised: float,
    small: float,
) -> bool:
    """Tell whether the step, or what the model promised of it, has become small."""
    if promised <= small:
        return True
    # A shorter trial, with more damping than the step began with, gains little because
    # it is short.
    return record.is_accepted and record.damping == damping and gained <= small
