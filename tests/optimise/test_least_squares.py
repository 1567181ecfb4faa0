"""Least squares of few unknowns: against SciPy, closed forms and its own state."""

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
    QuadraticModel,
    least_squares,
)

TIME = np.linspace(0.0, 3.0, 40)
TRUTH = np.array([2.0, 1.3])
SOLVER = LevenbergMarquardt(max_steps=60, still=1e-12)


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

        return QuadraticModel(cost, x - self.target, np.eye(2), rows)


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


def test_a_step_to_where_there_is_nothing_is_shortened():
    problem = Decay()
    # From here the step of Gauss and Newton leads to a signal that grows.
    found = least_squares(problem, np.array([0.1, 5.0]), SOLVER)
    assert any(x[1] < 0 for x in problem.calls)
    assert_allclose(found.x, least_squares(Decay(), TRUTH, SOLVER).x, rtol=1e-6)


def test_steps_are_no_longer_than_allowed():
    problem = Decay()
    solver = LevenbergMarquardt(max_steps=60, still=1e-12, longest=np.array([0.5, 0.2]))
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
    few = LevenbergMarquardt(max_steps=3, still=1e-12)
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
    solver = LevenbergMarquardt(max_steps=60, still=np.array([1e-3, 1e-12, 0.1]))
    found = least_squares(Useless(), np.array([1e8, 5.0, 7.0]), solver)
    wanted = least_squares(Decay(), TRUTH, SOLVER).x
    assert found.has_converged and found.x[2] == 7.0
    assert_allclose(found.x[:2], wanted * [1e9, 1.0], rtol=1e-6)
