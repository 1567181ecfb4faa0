"""Error against time: the best override of a plant whose answer is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from diffmill.correction import FeedPoint, FeedProblem, Motion
from diffmill.toolpath import Path, PathFeed

PERIOD, STEP, ROWS, KNOTS = 4e-3, 0.2e-3, 200, 4
# Slope of the best override over the share of the path.
FALL = 0.75


class SoftAcross(eqx.Module):
    """Pushed aside in proportion to the chip, by c(x) times the step."""

    length: jax.Array
    power: float = -1.5

    def __call__(self, desired, axes):
        del axes
        step = jnp.diff(desired[:, 0], prepend=desired[:1, 0])
        aside = self.softness(desired[:, 0]) * step
        return Motion(desired.at[:, 1].add(aside), jnp.zeros_like(desired))

    def softness(self, x):
        return 0.5 * (1 - FALL * x / self.length) ** self.power


def cutting(end):
    """Return which rows cut: all but the first ten, up to an end."""
    return np.where((np.arange(ROWS) >= 10) & (np.arange(ROWS) < end), 1.0, 0.0)


@pytest.fixture(scope="module")
def problem():
    """Return a straight path without ramps that cuts nearly everywhere."""
    tips = np.zeros((ROWS, 3))
    tips[:, 0] = STEP * np.arange(ROWS)
    path = Path.upright(PERIOD * np.arange(ROWS), tips)
    # The acceleration is far from binding.
    feed = PathFeed.of_path(path, acceleration=1e3)
    plant = SoftAcross(jnp.asarray(tips[-1, 0]))
    return FeedProblem(plant, feed, FeedProblem.smoothed(cutting(ROWS - 10)), 0.2, 4.0)


@pytest.fixture(scope="module")
def points(problem):
    return FeedPoint.curve(problem, time_weights=(0.6, 0.1), count=KNOTS, max_steps=12)


def best_of_integrals(problem, weight):
    """Minimise the same objective, written as integrals over the path, by SciPy."""
    rows, share = np.arange(ROWS), np.linspace(0, 1, KNOTS)
    fine = np.linspace(0, 1, 4001)
    cut = np.interp(fine * (ROWS - 1), rows, problem.weights)
    softness = (1 - FALL * fine) ** -1.5
    first = np.sum(cut * softness**2)

    def objective(x):
        override = np.interp(fine, share, np.exp(x))
        error = np.sum(cut * (softness * override) ** 2) / first
        return error / 2 + weight * np.mean(1 / override)

    return np.exp(scipy.optimize.minimize(objective, np.zeros(KNOTS), tol=1e-9).x)


def test_the_override_is_that_of_an_independent_search(problem, points):
    for point in points[1:]:
        assert point.is_settled
        wanted = best_of_integrals(problem, point.weight)
        np.testing.assert_allclose(point.override, wanted, rtol=5e-2)
        # Where all is cut: o^3 = w / c^2, whose root falls linearly by the choice of c.
        inner = point.override[1:3]
        assert inner[1] / inner[0] == pytest.approx(
            (1 - FALL * 2 / 3) / (1 - FALL / 3), rel=8e-2
        )


def test_each_point_is_better_than_an_even_override_of_the_same_time(points):
    first, *best = points
    assert np.isnan(first.weight) and first.override.tolist() == [1.0] * KNOTS
    assert first.cycle_time == pytest.approx(PERIOD * (ROWS - 1))
    for point in best:
        even = first.rms * first.cycle_time / point.cycle_time
        assert point.rms < 0.9 * even
    # Less weight on time: slower and more accurate.
    assert best[1].cycle_time > 1.2 * best[0].cycle_time
    assert best[1].rms < best[0].rms


def test_derivatives_of_the_error_against_differences(problem):
    x = jnp.log(jnp.asarray([0.9, 0.7, 1.2, 0.8]))

    @jax.jit
    def square(x):
        found = problem.prediction(jnp.exp(x), 400)
        share = found.lengths
        return share @ jnp.sum(found.vectors**2, axis=1) / jnp.sum(share)

    gradient = jax.jit(jax.grad(square))(x)
    h = 1e-5
    for k in range(KNOTS):
        e = h * np.eye(KNOTS)[k]
        wanted = (float(square(x + e)) - float(square(x - e))) / (2 * h)
        assert float(gradient[k]) == pytest.approx(wanted, rel=2e-3)


def test_bounds_are_held_and_rows_that_do_not_cut_are_passed_fast(problem):
    weights = FeedProblem.smoothed(cutting(ROWS // 2))
    half = FeedProblem(problem.plant, problem.feed, weights, 0.2, 4.0)
    found = FeedPoint.curve(half, time_weights=(0.6,), count=KNOTS, max_steps=12)[1]
    assert found.override.max() <= 4.0 * (1 + 1e-12)
    assert found.override[-1] == pytest.approx(4.0)
    assert found.override[0] < 2.0


def test_faults_are_named(problem):
    with pytest.raises(ValueError, match="`time_weights`"):
        FeedPoint.curve(problem, time_weights=(0.0,))
    with pytest.raises(ValueError, match="`lowest`"):
        FeedProblem(problem.plant, problem.feed, problem.weights, 1.5, 0.5)
    stiff = eqx.tree_at(
        lambda p: p.plant, problem, lambda tips, axes: Motion(tips, tips)
    )
    with pytest.raises(ValueError, match="`problem`"):
        FeedPoint.curve(stiff, time_weights=(1.0,), count=KNOTS)
