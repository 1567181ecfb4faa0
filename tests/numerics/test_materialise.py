"""What is held stays itself, in every derivative, and the compiler does keep it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from diffmill.numerics import materialise

X = jnp.asarray(np.random.default_rng(3).normal(size=(3, 5)))


def held(x, y):
    x, z = materialise((jnp.sin(x), x * y))
    first, second, third = materialise(jnp.unstack(x), backward_only=True)
    return first * second + jnp.cos(third) * jnp.sum(z, axis=0)


def plain(x, y):
    x, z = jnp.sin(x), x * y
    return x[0] * x[1] + jnp.cos(x[2]) * jnp.sum(z, axis=0)


def test_held_values_and_their_derivatives_are_those_of_the_values():
    np.testing.assert_array_equal(held(X, 2.0), plain(X, 2.0))
    np.testing.assert_array_equal(
        jax.jacrev(held)(X, 2.0), jax.jit(jax.jacrev(plain))(X, 2.0)
    )
    np.testing.assert_allclose(jax.jacfwd(held)(X, 2.0), jax.jacrev(plain)(X, 2.0))
    rows = jnp.stack([X, 2 * X])
    found = jax.vmap(held, (0, None))(rows, 2.0)
    np.testing.assert_array_equal(found[1], plain(2 * X, 2.0))
    check_grads(held, (X, 2.0), order=2)


def test_what_is_known_is_held_too_where_a_loop_is_differentiated():
    # JAX looks through a call that returns its arguments.
    def total(x):
        def step(x, _):
            slope = materialise(jax.lax.stop_gradient(jnp.sin(x)))
            return slope * x, None

        return jnp.sum(jax.lax.scan(step, x, length=3)[0])

    if jax.default_backend() != "cpu":
        pytest.skip("calls are held on the CPU")
    text = jax.jit(jax.grad(total)).lower(X).as_text()
    assert 'inlineable = "false"' in text


def test_what_nobody_uses_of_held_values_is_not_computed():
    def total(x):
        def step(x, _):
            sine, _ = materialise((jnp.sin(x), jnp.tan(x)))
            return sine * x, None

        return jnp.sum(jax.lax.scan(step, x, length=3)[0])

    text = jax.jit(jax.grad(total)).lower(X).as_text()
    assert "stablehlo.sine" in text and "stablehlo.tan" not in text


def test_trees_of_anything_are_held():
    whole, none, rows = jax.jit(lambda x: materialise((jnp.arange(3), None, [x])))(X)
    assert none is None and whole.dtype == int
    np.testing.assert_array_equal(rows[0], X)
    assert materialise(()) == ()
    assert isinstance(materialise(np.ones(3)), jax.Array)
