"""The inverse of a small matrix: against LAPACK, in batches, and its derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from diffmill.numerics import small_inverse


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_it_is_the_inverse(rng, count):
    batch = rng.normal(size=(50, count, count))
    # Nothing on the diagonal: only a pivot from elsewhere helps.
    batch[0] = np.roll(np.diag(np.arange(1.0, count + 1)), 1, axis=0)
    batch[1:10] *= 10.0 ** rng.uniform(-8, 8, (9, count, 1))
    found = jax.jit(jax.vmap(small_inverse))(batch)
    expected = np.linalg.inv(batch)
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    worst = np.linalg.cond(batch / np.abs(batch).max(axis=2, keepdims=True)).max()
    assert_allclose(found / size, expected / size, atol=1e-14 * worst)


def test_its_derivative(rng):
    A, way = rng.normal(size=(2, 4, 4))
    along = lambda x: small_inverse(jnp.asarray(A) + x * way)
    step = 1e-5
    expected = (along(step) - along(-step)) / (2 * step)
    assert_allclose(jax.jit(jax.jacfwd(along))(0.0), expected, rtol=1e-6, atol=1e-8)
    assert_allclose(jax.jit(jax.jacrev(along))(0.0), expected, rtol=1e-6, atol=1e-8)


def test_a_singular_matrix_has_none():
    assert not np.isfinite(small_inverse(jnp.ones((3, 3)))).all()
