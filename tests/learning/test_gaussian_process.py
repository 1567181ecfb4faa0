"""The process along a path by a filter, against dense Gaussian regression."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.learning import Observations, PathProcess

LENGTH, SIZE = np.array([0.02, 0.05, 0.1]), np.array([3.0, 1.0, 2.0])
PROCESS = PathProcess(jnp.asarray(LENGTH), jnp.asarray(SIZE))


def seen(count=40, *, repeats=True):
    """Observations in many directions, some at the same time."""
    stream = np.random.default_rng(2)
    time = np.sort(stream.uniform(0, 0.5, count))
    if repeats:
        time[5:8] = time[5]
    direction = stream.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Observations(time, direction, stream.uniform(0.1, 1.0, count))


def kernel(t, other):
    """Matern's kernel of order 3/2, per axis, (axis, t, other)."""
    r = (
        np.sqrt(3)
        * np.abs(t[None, :, None] - other[None, None])
        / LENGTH[:, None, None]
    )
    return SIZE[:, None, None] ** 2 * (1 + r) * np.exp(-r)


def covariance(seen):
    K = kernel(seen.time, seen.time)
    return np.einsum("ia,aij,ja->ij", seen.direction, K, seen.direction) + np.diag(
        seen.variance
    )


def test_whitened_rows_have_the_inverse_covariance():
    at = seen()
    rows = np.random.default_rng(3).normal(size=(40, 3))
    found = PROCESS.whiten(at, jnp.asarray(rows))
    V = covariance(at)
    wanted = rows.T @ np.linalg.solve(V, rows)
    np.testing.assert_allclose(found.rows.T @ found.rows, wanted, rtol=1e-10)
    np.testing.assert_allclose(
        found.log_determinant, np.linalg.slogdet(V)[1], rtol=1e-10
    )


def test_the_smoother_is_gaussian_regression():
    at, times = seen(), np.linspace(-0.05, 0.55, 31)
    values = np.random.default_rng(4).normal(size=40)
    mean, deviation = PROCESS.smoothed(at, values, times)
    V = covariance(at)
    cross = np.einsum("atj,ja->taj", kernel(times, at.time), at.direction)
    wanted = cross @ np.linalg.solve(V, values)
    left = SIZE[None] ** 2 - np.einsum("taj,jk,tak->ta", cross, np.linalg.inv(V), cross)
    np.testing.assert_allclose(mean, wanted, atol=1e-6 * np.abs(wanted).max())
    np.testing.assert_allclose(deviation, np.sqrt(left), rtol=1e-5)


def test_the_likelihood_has_derivatives():
    at, values = seen(), np.random.default_rng(5).normal(size=40)

    def loglikelihood(length):
        process = PathProcess(length, jnp.asarray(SIZE))
        white = process.whiten(at, jnp.asarray(values)[:, None])
        return -0.5 * (jnp.sum(white.rows**2) + white.log_determinant)

    slope = jax.grad(loglikelihood)(jnp.asarray(LENGTH))
    for k in range(3):
        d = 1e-6 * np.eye(3)[k]
        numeric = (
            loglikelihood(jnp.asarray(LENGTH + d))
            - loglikelihood(jnp.asarray(LENGTH - d))
        ) / 2e-6
        np.testing.assert_allclose(slope[k], numeric, rtol=1e-5)


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_is_not_seen_stays_at_its_prior(axis):
    at = seen(repeats=False)
    direction = np.eye(3)[(axis + 1) % 3][None].repeat(40, 0)
    at = at._replace(direction=direction)
    mean, deviation = PROCESS.smoothed(at, np.ones(40), np.asarray(at.time))
    np.testing.assert_allclose(mean[:, axis], 0.0, atol=1e-9)
    np.testing.assert_allclose(deviation[:, axis], SIZE[axis], rtol=1e-6)
    none = PathProcess(PROCESS.length, PROCESS.size.at[axis].set(0.0))
    means, spread = none.smoothed(at, np.ones(40), np.asarray(at.time))
    np.testing.assert_allclose(means, np.where(np.arange(3) == axis, 0, mean))
    np.testing.assert_array_equal(spread[:, axis], 0.0)
