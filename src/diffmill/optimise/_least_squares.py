"""Minimisation of an expensive function of few unknowns by its quadratic models.

At a point a problem gives gradient and curvature of its cost, for a sum of squares
those of Gauss and Newton. The curvature is damped in proportion to its diagonal
(Marquardt), bounds of the step and linear rows included, until a trial lowers the cost:
a good step lessens the damping, a refused one raises it until the next is half as long.
A value that a problem computes at a point may be a whole simulation; each is computed
once.

Reference: Nocedal and Wright, Numerical Optimization, 2006, chapter 10.3.
"""

import abc
import dataclasses
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ._quadratic_program import solve_quadratic_program

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Length of a trial over that of a refused one, in the metric of the curvature. The
# least of a parabola through the refused one is nearer than need be: the next one has
# another direction.
_RETRY_LENGTH = 0.5
# How often the damping is raised beside the trials, until a step is short enough.
_MAX_RAISES = 20
# Damping after a trial at least: below it matters no more, but a refused step would
# not raise it back before the trials end, and a curvature without full rank would be
# singular to rounding.
_LEAST_DAMPING = 1e-10
# Share of the cost that a step must be foreseen to take away for its point to be taken
# for the next one before it is tried. What its model costs beside its value is lost
# only where the point is refused, which is rare.
_LARGE_DECREASE = 0.1
# A step so near to a bound, as a share of its range, is at the bound.
_AT_BOUND_SHARE = 1e-7

Vector: TypeAlias = Float[np.ndarray, " unknown"]
# Whatever a problem computes at a point.
Value: TypeAlias = Any


class LinearRows(eqx.Module):
    """Linear constraints of a step p: lower <= matrix @ p <= upper.

    Attributes:
        matrix: An array or sparse, of `scipy.sparse`, shape (row, unknown).
        lower: Least values, or minus infinity, shape (row,).
        upper: Largest values, or infinity, shape (row,).
        weight: Stiffness of the springs that act outside; infinite for constraints.
    """

    matrix: "Float[np.ndarray, 'row unknown'] | csr_array"
    lower: Float[np.ndarray, " row"]
    upper: Float[np.ndarray, " row"]
    weight: float = np.inf

    def energy(self, p: Vector) -> float:
        """Energy of the springs after a step, 0 for constraints."""
        if np.isinf(self.weight):
            return 0.0
        values = self.matrix @ p
        outside = values - np.clip(values, self.lower, self.upper)
        return 0.5 * self.weight**2 * float(outside @ outside)


def _in_units(
    rows: LinearRows,
    is_free: Bool[np.ndarray, " unknown"],
    unit: Float[np.ndarray, " free"],
) -> LinearRows:
    """Constraints of the free unknowns in their units."""
    from scipy import sparse

    matrix = sparse.csr_array(rows.matrix)[:, is_free] @ sparse.diags_array(unit)
    is_there = np.diff(matrix.indptr) > 0
    return LinearRows(
        matrix[is_there], rows.lower[is_there], rows.upper[is_there], rows.weight
    )


class QuadraticModel(eqx.Module):
    """Quadratic model of a cost around a point.

    Attributes:
        cost: Returns the cost of the value at a point, which the model approximates;
            infinite where the point is not allowed.
        gradient: Of the cost, shape (unknown,).
        curvature: Positive semidefinite, shape (unknown, unknown).
        rows: Constraints of the step, of any number of kinds.
    """

    cost: Callable[[Vector, Value], float]
    gradient: Vector
    curvature: Float[np.ndarray, "unknown unknown"]
    rows: tuple[LinearRows, ...] = ()

    def decrease(self, p: Vector) -> float:
        """Decrease of the cost by a step, as the model foresees it."""
        change = float(self.gradient @ p + 0.5 * p @ self.curvature @ p)
        for rows in self.rows:
            change += rows.energy(p) - rows.energy(np.zeros_like(p))
        return -change

    def damped_step(self, damping: float, box: LinearRows) -> Vector | None:
        """Step of the least cost with a damped curvature.

        Unknowns without effect on the cost stay.

        Args:
            damping: Share of the curvature's diagonal that is added to it.
            box: Bounds of the step.

        Returns:
            The step within `box` and the constraints, shape (unknown,); None if there
            is none.
        """
        own = np.diagonal(self.curvature)
        is_free = (own > 0) & (box.upper > box.lower)
        # In units in which the curvature is one: the unknowns differ by many digits.
        unit = 1.0 / np.sqrt(own[is_free])
        H = self.curvature[np.ix_(is_free, is_free)] * unit[:, None] * unit[None]
        H = H + damping * np.eye(len(H))
        rows = tuple(_in_units(rows, is_free, unit) for rows in (box, *self.rows))
        gradient = self.gradient[is_free] * unit
        least = QuadraticModel(self.cost, gradient, H, rows).minimum()
        if least is None:
            return None
        p = np.zeros(len(own))
        p[is_free] = least * unit
        # The solver stops just short of a bound.
        width = box.upper - box.lower
        near = np.where(np.isfinite(width), _AT_BOUND_SHARE * width, 0.0)
        p = np.where(p <= box.lower + near, box.lower, p)
        return np.where(p >= box.upper - near, box.upper, p)

    def minimum(self) -> Vector | None:
        """Step of the least cost in the model within its constraints.

        Of many constraints few bind, so those are left out that the minimum of the
        others keeps by itself: what it leaves is added until it leaves none. The last
        minimum is that of all.

        Returns:
            The step, to about eight digits, shape (unknown,); None if there is none.
            The curvature must be positive definite.
        """
        from scipy import linalg, sparse

        H, g, rows = self.curvature, self.gradient, self.rows
        x = linalg.solve(H, -g, assume_a="pos")
        if not rows:
            return x
        matrix = sparse.csr_array(sparse.vstack([part.matrix for part in rows]))
        lower = np.concatenate([part.lower for part in rows])
        upper = np.concatenate([part.upper for part in rows])
        weight = np.concatenate(
            [np.full(len(part.lower), part.weight) for part in rows]
        )
        is_held = np.zeros(len(lower), bool)
        while True:
            values = matrix @ x
            is_new = ((values < lower) | (values > upper)) & ~is_held
            if not is_new.any():
                return x
            is_held |= is_new
            x = solve_quadratic_program(
                H, g, matrix[is_held], lower[is_held], upper[is_held], weight[is_held]
            )
            if x is None:
                return None


class AbstractProblem(eqx.Module):
    """Function of few unknowns that becomes small."""

    @abc.abstractmethod
    def evaluate(self, x: Vector) -> Value | None:
        """Value at a point; None where it does not exist."""

    def evaluate_for_model(self, x: Vector) -> Value | None:
        """Value at a point whose model is likely to be wanted next.

        For problems where the model needs a computation that gives the value too.

        Args:
            x: The point, shape (unknown,).
        """
        return self.evaluate(x)

    def has_model(self, value: Value) -> bool:
        """True if a value came with all that its model needs, which is then not made.

        Args:
            value: What the problem has computed.
        """
        del value
        return False

    def without_model(self, value: Value) -> Value:
        """Value without what only its model needed, once that is made.

        Args:
            value: What the problem has computed.
        """
        return value

    @abc.abstractmethod
    def model(self, x: Vector, value: Value) -> QuadraticModel:
        """Quadratic model around a point.

        Args:
            x: The point, shape (unknown,).
            value: What the problem has computed there.
        """


class LevenbergMarquardt(eqx.Module):
    """Settings of the method.

    Attributes:
        max_steps: Steps at most.
        attempts: Trials for a step before the point counts as the best.
        max_step: Largest change of each unknown in a step, a number or shape
            (unknown,).
        damping: First damping, over the diagonal of the curvature.
        damping_decrease: Factor of the damping after a good trial, down to 1e-10.
        damping_increase: Factor after a refused one, as often as the next step needs to
            be shorter.
        step_rtol: Stop after an accepted step p with p^T H p < step_rtol.
        rejected_step_rtol: The same for a refused step: further ones would be refused
            too.
        step_atol: Stop after a step that changes each unknown by less than this.
        cost_rtol: A step is worth a trial if its decrease over the cost, as the model
            foresees it, is more than this.
    """

    max_steps: int = 25
    attempts: int = 10
    max_step: float | Vector = np.inf
    damping: float = 1e-3
    damping_decrease: float = 0.1
    damping_increase: float = 10.0
    step_rtol: float = 0.0
    rejected_step_rtol: float = 0.0
    step_atol: float | Vector = 0.0
    cost_rtol: float = 0.0


class LeastSquaresStep(eqx.Module):
    """A step of the search, with its costs so far.

    Attributes:
        cost: That of the best point, as the model of this step counts it.
        damping: Of the last trial.
        evaluations: How often the problem was evaluated so far, without a model.
        models: How often its quadratic model was made so far.
        seconds: Wall time since the start [s].
        is_accepted: Whether a trial lowered the cost.
    """

    cost: float
    damping: float
    evaluations: int
    models: int
    seconds: float
    is_accepted: bool


class LeastSquaresState(eqx.Module):
    """State of the method, from which it goes on; the last one is the solution.

    Attributes:
        x: The best point, shape (unknown,).
        value: What the problem has computed there.
        damping: Of the next step.
        steps: Steps that lowered the cost.
        evaluations: How often the problem was evaluated, without a model.
        models: How often its quadratic model was made.
        has_converged: Whether no further step is worth while.
        history: The steps, those without an accepted trial too.
    """

    x: Vector
    value: Value
    damping: float
    steps: int = 0
    evaluations: int = 1
    models: int = 0
    has_converged: bool = False
    history: tuple[LeastSquaresStep, ...] = ()

    @classmethod
    def begin(
        cls, problem: AbstractProblem, x: Vector, value: Value, damping: float
    ) -> "LeastSquaresState":
        """State in which a search begins.

        Args:
            problem: The problem.
            x: Where it begins, shape (unknown,).
            value: What the problem has computed there.
            damping: Of the first step.
        """
        models = int(problem.has_model(value))
        return cls(x, value, damping, evaluations=1 - models, models=models)


def least_squares(
    problem: AbstractProblem,
    x0: Vector,
    solver: LevenbergMarquardt,
    *,
    lower: float | Vector = -np.inf,
    upper: float | Vector = np.inf,
    state: LeastSquaresState | None = None,
    callback: Callable[[LeastSquaresState], bool | None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> LeastSquaresState:
    """Minimise the cost of a problem.

    Args:
        problem: The problem.
        x0: Where to start, within the bounds, shape (unknown,).
        solver: Settings.
        lower: Least values of the unknowns, a number or shape (unknown,).
        upper: Largest values, likewise.
        state: An earlier state to go on from, or its value at `x0`, which then is not
            computed again; within the bounds too.
        callback: Called with the state after each step, without an accepted trial too;
            True ends the search.
        clock: Returns the time [s].

    Returns:
        The last state.

    Raises:
        ValueError: The problem has no value at `x0`, or it is out of the bounds.
    """
    from scipy import sparse

    start = x0 if state is None else state.x
    if not np.all((lower <= start) & (start <= upper)):
        raise ValueError(
            f"Argument `{'x0' if state is None else 'state'}` must be within `lower` "
            f"and `upper`, but is at {start}."
        )
    if state is None:
        value = problem.evaluate_for_model(x0)
        if value is None:
            raise ValueError(
                "Argument `x0` must be a point of the problem, but is not."
            )
        state = LeastSquaresState.begin(problem, x0, value, solver.damping)
    bounds = LinearRows(
        sparse.csr_array(sparse.eye_array(len(start))),
        np.broadcast_to(lower, start.shape),
        np.broadcast_to(upper, start.shape),
    )
    began = clock() - (state.history[-1].seconds if state.history else 0.0)
    seconds = lambda: clock() - began
    for _ in range(solver.max_steps - state.steps):
        if state.has_converged:
            break
        model = problem.model(state.x, state.value)
        # What the model is made of may be large, and is not held through the trials.
        state = dataclasses.replace(
            state,
            value=problem.without_model(state.value),
            models=state.models + (not problem.has_model(state.value)),
        )
        state = _stepped(problem, model, state, solver, bounds, seconds)
        if callback is not None and callback(state):
            break
    return state


def _stepped(
    problem: AbstractProblem,
    model: QuadraticModel,
    state: LeastSquaresState,
    solver: LevenbergMarquardt,
    bounds: LinearRows,
    seconds: Callable[[], float],
) -> LeastSquaresState:
    """State after one step; converged where none is worth while."""
    now, damping = model.cost(state.x, state.value), state.damping
    cost, used, is_better, has_converged = now, damping, False, True
    box = LinearRows(
        bounds.matrix,
        np.maximum(bounds.lower - state.x, np.negative(solver.max_step)),
        np.minimum(bounds.upper - state.x, solver.max_step),
    )
    # Largest squared length of a trial, in the metric of the curvature.
    longest, trials = np.inf, 0
    for _ in range(solver.attempts + _MAX_RAISES):
        p = model.damped_step(damping, box)
        if p is None:
            damping *= solver.damping_increase
            continue
        # Equal too: at an exact solution, and for no share, nothing is to be gained.
        if model.decrease(p) <= solver.cost_rtol * now:
            break
        curved = float(p @ model.curvature @ p)
        if curved > longest:
            damping *= solver.damping_increase
            continue
        used = damping
        is_last = state.steps + 1 >= solver.max_steps
        is_next = (
            trials == 0 and not is_last and model.decrease(p) > _LARGE_DECREASE * now
        )
        evaluate = problem.evaluate_for_model if is_next else problem.evaluate
        # A step to a bound, added to the point, may be beyond it by rounding.
        trial = np.clip(state.x + p, bounds.lower, bounds.upper)
        value = evaluate(trial)
        cost = np.inf if value is None else model.cost(trial, value)
        has_model = value is not None and problem.has_model(value)
        state = dataclasses.replace(
            state,
            evaluations=state.evaluations + (not has_model),
            models=state.models + has_model,
        )
        trials += 1
        is_better = value is not None and bool(cost <= now and np.isfinite(cost))
        damping *= solver.damping_decrease if is_better else solver.damping_increase
        damping = max(damping, _LEAST_DAMPING)
        is_tiny = bool(np.all(np.abs(p) < solver.step_atol))
        if is_better:
            state = dataclasses.replace(
                state, x=trial, value=value, steps=state.steps + 1
            )
            has_converged = is_tiny or curved < solver.step_rtol
            has_converged |= now - cost <= solver.cost_rtol * now
            break
        is_tiny |= curved < solver.rejected_step_rtol
        if is_tiny or trials == solver.attempts:
            break
        # A step that hardly differs from one that was refused is refused too.
        longest = min(longest, curved) * _RETRY_LENGTH**2
    cost = cost if is_better else now
    step = LeastSquaresStep(
        cost, used, state.evaluations, state.models, seconds(), is_better
    )
    return dataclasses.replace(
        state,
        damping=damping,
        has_converged=has_converged,
        history=(*state.history, step),
    )
