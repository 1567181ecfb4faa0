"""Least squares of few unknowns: against SciPy, closed forms and its own state."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

from diffmill.optimise import (
    AbstractProblem,
    LeastSquaresState,
    LevenbergMarquardt,
    LinearRows,
    OutputConstraints,
    QuadraticModel,
    least_squares,
)

TIME = np.linspace(0.0, 3.0, 40)
TRUTH = np.array([2.0, 1.3])
SOLVER = LevenbergMarquardt(max_steps=60, step_atol=1e-12)


def decay(x):
    return x[0] * np.exp(-x[1] * TIME)


SEEN = decay(TRUTH) + 0.05 * np.sin(7 * TIME)


class Decay(AbstractProblem):
    """A decaying signal, which has no value for growing ones."""

    calls: list = eqx.field(default_factory=list)

    def evaluate(self, x):
        self.calls.append(x)
        return decay(x) - SEEN if x[1] >= 0 else None

    def model(self, x, value):
        wave = np.exp(-x[1] * TIME)
        J = np.column_stack([wave, -x[0] * TIME * wave])
        cost = lambda there, r: 0.5 * float(r @ r)
        return QuadraticModel(cost, J.T @ value, J.T @ J)


class WithJacobian(Decay):
    """The decay, of which a Jacobian comes with the signal."""

    made: list = eqx.field(default_factory=list)

    def evaluate(self, x):
        found = super().evaluate(x)
        return None if found is None else (found, None)

    def evaluate_for_model(self, x):
        self.made.append(x)
        wave = np.exp(-x[1] * TIME)
        return decay(x) - SEEN, np.column_stack([wave, -x[0] * TIME * wave])

    def has_model(self, value):
        return value[1] is not None

    def without_model(self, value):
        return value[0], None

    def model(self, x, value):
        if value[1] is None:
            value = self.evaluate_for_model(x)
        cost = lambda there, at: 0.5 * float(at[0] @ at[0])
        return QuadraticModel(cost, value[1].T @ value[0], value[1].T @ value[1])


class BehindWall(AbstractProblem):
    """The distance to a point behind the wall n . x = 1, which must not be passed."""

    target: np.ndarray
    normal: np.ndarray

    def evaluate(self, x):
        return x

    def model(self, x, value):
        beyond = float(self.normal @ x) - 1.0
        is_within = beyond <= 0
        # From behind a spring draws it a little before the wall.
        room = -beyond if is_within else -beyond - 0.05
        rows = LinearRows(
            self.normal[None],
            np.array([-np.inf]),
            np.array([room]),
            np.inf if is_within else 30.0,
        )

        def cost(there, at):
            beyond = float(self.normal @ there) - 1.0
            if is_within and beyond > 1e-6:
                return np.inf
            spring = 0.0 if is_within else (30.0 * max(beyond + 0.05, 0.0)) ** 2
            return 0.5 * (float(np.sum((there - self.target) ** 2)) + spring)

        return QuadraticModel(cost, x - self.target, np.eye(2), (rows,))


@pytest.mark.parametrize("upper", [np.inf, 1.0])
@pytest.mark.parametrize("start", [[0.1, 5.0], [30.0, 0.3]])
def test_the_minimum_is_scipys(start, upper):
    start = np.minimum(start, upper)
    found = least_squares(Decay(), start, SOLVER, lower=0.0, upper=upper)
    wanted = scipy.optimize.least_squares(
        lambda x: decay(x) - SEEN,
        0.9 * start,
        bounds=(0, upper),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert found.has_converged
    assert_allclose(found.x, wanted.x, rtol=1e-5)


@pytest.mark.parametrize("start", [[5.0, 0.5], [0.5, -1e-9], [0.5, np.nan]])
def test_a_start_out_of_the_bounds_is_refused(start):
    start, problem = np.array(start), Decay()
    search = functools.partial(least_squares, problem, start, SOLVER)
    with pytest.raises(ValueError, match="`x0` must be within `lower` and `upper`"):
        search(lower=0.0, upper=1.0)
    assert not problem.calls
    state = LeastSquaresState(start, None, SOLVER.damping)
    with pytest.raises(ValueError, match="`state` must be within"):
        search(lower=0.0, upper=1.0, state=state)


def test_a_search_that_ends_at_a_bound_goes_on_from_there():
    start, lower, upper = np.array([-7.1, 0.5]), -8.0, 0.7
    # In floating point the step to the bound leads beyond it.
    assert start[0] + (upper - start[0]) > upper
    found = least_squares(Decay(), start, SOLVER, lower=lower, upper=upper)
    assert found.x[0] == upper
    again = least_squares(Decay(), found.x, SOLVER, lower=lower, upper=upper)
    assert_allclose(again.x, found.x, rtol=1e-6)


def test_a_step_to_where_there_is_nothing_is_shortened():
    problem = Decay()
    # From here the step of Gauss and Newton leads to a signal that grows.
    found = least_squares(problem, np.array([0.1, 5.0]), SOLVER)
    assert any(x[1] < 0 for x in problem.calls)
    assert_allclose(found.x, least_squares(Decay(), TRUTH, SOLVER).x, rtol=1e-6)


def test_damping_that_is_much_too_small_is_found_in_few_trials():
    problem = Decay()
    start = np.array([0.1, 4.0])
    solver = dataclasses.replace(SOLVER, damping=1e-12, max_steps=1)
    found = least_squares(problem, start, solver)
    # Ten trials tenfold apart would end at 1e-3, where the step is still far too long.
    assert solver.attempts == 10
    assert found.steps == 1


class Ramp(AbstractProblem):
    """The distance to 5, and a slope that begins at 0 within a tenth of a step."""

    def evaluate(self, x):
        return np.array([x[0] - 5, 0.3 * np.logaddexp(0, x[0] / 0.01)])

    def model(self, x, value):
        J = np.array([[1.0], [30 * scipy.special.expit(x[0] / 0.01)]])
        cost = lambda there, r: 0.5 * float(r @ r)
        return QuadraticModel(cost, J.T @ value, J.T @ J)


class SumOfTwo(AbstractProblem):
    """The distance of a sum to 7: no model tells its unknowns apart."""

    def evaluate(self, x):
        return x[0] + x[1] - 7

    def model(self, x, value):
        cost = lambda there, r: 0.5 * float(r) ** 2
        return QuadraticModel(cost, np.full(2, value), np.ones((2, 2)))


@pytest.mark.parametrize("far", [1, 28, 60])
def test_damping_after_many_good_steps_is_not_too_small_for_a_refused_one(far):
    solver = LevenbergMarquardt(
        max_steps=100, max_step=0.1, damping=1e-4, cost_rtol=1e-3
    )
    found = least_squares(Ramp(), np.array([-0.1 * far - 0.03]), solver)
    least: Any = scipy.optimize.minimize_scalar(
        lambda x: 0.5 * np.sum(Ramp().evaluate(np.array([x])) ** 2), bounds=(-1, 1)
    )
    assert found.has_converged
    assert found.history[-1].cost < (1 + 2e-3) * least.fun


def test_unknowns_of_one_effect_share_it_after_many_good_steps():
    solver = LevenbergMarquardt(
        max_steps=100, max_step=0.1, damping=1e-4, cost_rtol=1e-9
    )
    found = least_squares(SumOfTwo(), np.zeros(2), solver)
    assert_allclose(found.x, 3.5, rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 1e-3])
def test_a_search_ends_at_an_exact_solution(share):
    solver = LevenbergMarquardt(max_steps=100, cost_rtol=share)
    found = least_squares(SumOfTwo(), np.zeros(2), solver)
    assert found.has_converged and found.history[-1].cost == 0
    assert found.steps < 10
    # At the solution from the start on there is nothing to try.
    again = least_squares(SumOfTwo(), np.array([3.0, 4.0]), solver)
    assert again.has_converged and (again.steps, again.evaluations) == (0, 1)


def test_steps_are_no_longer_than_allowed():
    problem = Decay()
    solver = LevenbergMarquardt(
        max_steps=60, step_atol=1e-12, max_step=np.array([0.5, 0.2])
    )
    found = least_squares(problem, np.array([8.0, 4.0]), solver)
    assert_allclose(found.x, least_squares(Decay(), TRUTH, SOLVER).x, rtol=1e-6)
    moves = np.abs(np.diff(problem.calls, axis=0))
    assert np.all(moves.max(axis=0) <= 2 * np.array([0.5, 0.2]))


@pytest.mark.parametrize("start", [[0.0, 0.2], [5.0, 4.0]])
def test_linear_rows_hold_a_point_before_a_wall_or_bring_it_back(start):
    target, normal = np.array([3.0, 1.0]), np.array([0.6, 0.8])
    found = least_squares(BehindWall(target, normal), np.array(start), SOLVER)
    # The foot of the perpendicular.
    wanted = target - (normal @ target - 1.0) * normal
    assert normal @ found.x <= 1.0 + 1e-6
    assert_allclose(found.x, wanted, atol=1e-5)


def test_a_state_goes_on_where_it_ended():
    start = np.array([0.1, 5.0])
    whole, told = Decay(), []
    wanted = least_squares(whole, start, SOLVER, callback=told.append)
    assert [state.steps for state in told] == list(range(1, wanted.steps + 1))
    few = LevenbergMarquardt(max_steps=3, step_atol=1e-12)
    first = least_squares(Decay(), start, few)
    assert first.steps == 3 and not first.has_converged
    rest = Decay()
    found = least_squares(rest, start, SOLVER, state=first)
    np.testing.assert_array_equal(found.x, wanted.x)
    assert found.evaluations == wanted.evaluations == len(whole.calls)
    # Nothing is computed twice.
    assert len(rest.calls) == wanted.evaluations - first.evaluations
    done = least_squares(Decay(), start, SOLVER, state=found)
    assert isinstance(done, LeastSquaresState) and done.steps == found.steps


def test_a_value_that_comes_with_its_model_is_not_computed_again():
    problem, told = WithJacobian(), []
    # A good first step, behind which hardly anything is left to gain.
    start = TRUTH + np.array([0.3, 0.2])
    found = least_squares(problem, start, SOLVER, callback=told.append)
    assert_allclose(found.x, least_squares(Decay(), start, SOLVER).x, rtol=1e-9)
    assert found.models == len(problem.made)
    assert found.evaluations == len(problem.calls)
    # The start, and the point that took most of the cost away.
    assert problem.has_model(told[0].value)
    assert (told[0].evaluations, told[0].models) == (0, 2)
    assert found.models == len(found.history)
    assert not problem.has_model(found.value)


def test_a_start_without_a_value_is_refused():
    with pytest.raises(ValueError, match="x0"):
        least_squares(Decay(), np.array([1.0, -1.0]), SOLVER)


class Useless(AbstractProblem):
    """The decay, with a third unknown of no effect and a first one of many digits."""

    def evaluate(self, x):
        return decay(np.array([1e-9 * x[0], x[1]])) - SEEN if x[1] >= 0 else None

    def model(self, x, value):
        wave = np.exp(-x[1] * TIME)
        J = np.column_stack([1e-9 * wave, -1e-9 * x[0] * TIME * wave, 0.0 * TIME])
        cost = lambda there, r: 0.5 * float(r @ r)
        return QuadraticModel(cost, J.T @ value, J.T @ J)


def test_an_unknown_without_effect_stays():
    solver = LevenbergMarquardt(max_steps=60, step_atol=np.array([1e-3, 1e-12, 0.1]))
    found = least_squares(Useless(), np.array([1e8, 5.0, 7.0]), solver)
    wanted = least_squares(Decay(), TRUTH, SOLVER).x
    assert found.has_converged and found.x[2] == 7.0
    assert_allclose(found.x[:2], wanted * [1e9, 1.0], rtol=1e-6)


class Constrained(AbstractProblem):
    """A curved residual, some of whose functions of x are held within bounds."""

    A: np.ndarray
    b: np.ndarray
    C: np.ndarray
    shift: float
    held: OutputConstraints

    def evaluate(self, x):
        r = np.sin(self.A @ x) + 0.1 * (self.A @ x) - self.b
        return r, self.C @ x + 0.2 * np.sin(self.C @ x) - self.shift

    def model(self, x, value):
        r, y = value
        J = (np.cos(self.A @ x) + 0.1)[:, None] * self.A
        slopes = (1 + 0.2 * np.cos(self.C @ x))[:, None] * self.C
        is_hard = self.held.is_within(y)
        cost = lambda x, at: (
            0.5 * float(at[0] @ at[0]) + self.held.cost(at[1], is_hard=is_hard)
        )
        rows = self.held.rows(y, slopes)
        return QuadraticModel(cost, J.T @ r, J.T @ J, (rows,))


@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_bounds_of_outputs_are_those_of_a_dense_solver(shift):
    """Once from a start that keeps them, once from one that does not."""
    rng = np.random.default_rng(0)
    held = OutputConstraints(np.full(5, -0.5), np.full(5, 0.5))
    problem = Constrained(
        rng.normal(size=(20, 6)) * 0.4,
        rng.normal(size=20),
        rng.normal(size=(5, 6)),
        shift,
        held,
    )
    solver = LevenbergMarquardt(max_steps=80, cost_rtol=1e-9)
    assert held.is_within(problem.evaluate(np.zeros(6))[1]) == (shift == 0.0)
    found = least_squares(problem, np.zeros(6), solver)
    assert held.is_within(found.value[1])
    # Drawn in as the linear model is: the true optimum lies a little lower.
    drawn = 0.95 * 0.5
    dense = scipy.optimize.minimize(
        lambda x: 0.5 * np.sum(problem.evaluate(x)[0] ** 2),
        found.x,
        constraints=[
            {"type": "ineq", "fun": lambda x: drawn - problem.evaluate(x)[1]},
            {"type": "ineq", "fun": lambda x: drawn + problem.evaluate(x)[1]},
        ],
        options={"maxiter": 300, "ftol": 1e-12},
    )
    assert 0.5 * np.sum(found.value[0] ** 2) < 1.03 * dense.fun


def test_bounds_that_exclude_zero_are_refused():
    with pytest.raises(ValueError, match="`lower`"):
        OutputConstraints(np.array([0.1]), np.array([0.5]))


@pytest.mark.parametrize("count", [3, 40])
def test_few_of_many_constraints_bind_and_all_hold(count):
    """The minimum with those that bind is that with all, soft ones included."""
    rng = np.random.default_rng(count)
    root = rng.normal(size=(30, 12))
    H, g = root.T @ root, 20 * rng.normal(size=12)
    L = rng.normal(size=(count, 12))
    hard = LinearRows(L, np.full(count, -0.5), np.full(count, 0.3))
    soft = LinearRows(np.eye(12), np.full(12, -0.1), np.full(12, 0.1), 3.0)
    cost = lambda x: 0.5 * x @ H @ x + g @ x + soft.energy(x)
    model = QuadraticModel(lambda x, _: cost(x), g, H, (hard, soft))
    found = model.minimum()
    assert found is not None
    dense = scipy.optimize.minimize(
        cost,
        np.zeros(12),
        constraints=[
            {"type": "ineq", "fun": lambda x: 0.3 - L @ x},
            {"type": "ineq", "fun": lambda x: L @ x + 0.5},
        ],
        options={"maxiter": 1000, "ftol": 1e-14},
    )
    assert np.all(L @ found <= 0.3 + 1e-8) and np.all(L @ found >= -0.5 - 1e-8)
    assert cost(found) == pytest.approx(dense.fun, rel=1e-6)
