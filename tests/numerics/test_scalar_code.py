"""A function of scalars as one stretch of machine code, alone and in batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from diffmill.numerics import as_scalar_code


def norms(scales, x, y):
    """Two lengths of a scaled plane vector, an entry each, whatever is behind."""
    return jnp.stack([jnp.hypot(scales[0] * x[0], y), scales[1] * x[1]])


SCALES = jnp.asarray([2.0, -3.0])


@pytest.mark.parametrize("count", [1, 7, 256, 600])
def test_a_batch_of_any_length_is_one_element_after_the_other(count):
    x, y = map(jnp.asarray, np.random.default_rng(1).normal(size=(2, count, 2)))
    batch = jax.vmap(as_scalar_code(norms), (None, 0, 0))
    expected = jax.vmap(norms, (None, 0, 0))(SCALES, x, y[:, 0])
    for run in (batch, jax.jit(batch)):
        assert_allclose(run(SCALES, x, y[:, 0]), expected, rtol=1e-14)


def test_arguments_outside_a_batch_and_batches_of_models():
    x = np.random.default_rng(2).normal(size=(5, 2))
    models = SCALES[None] * jnp.arange(1.0, 6.0)[:, None]
    for axes in ((None, 0, None), (0, 0, None), (0, None, None)):
        args = (SCALES if axes[0] is None else models, x if axes[1] == 0 else x[0], 0.5)
        args = tuple(map(jnp.asarray, args))
        run = jax.jit(jax.vmap(as_scalar_code(norms), axes))
        assert_allclose(run(*args), jax.vmap(norms, axes)(*args), rtol=1e-14)
