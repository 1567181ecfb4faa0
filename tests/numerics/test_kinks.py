"""Clamping: values and derivatives, those of the bounds among them."""

import jax
import jax.numpy as jnp
import numpy as np

from diffmill.numerics import clamp


def test_outside_the_derivative_is_that_of_the_bound():
    x = jnp.array([-3.0, 0.5, 3.0])

    def held(x, reach):
        return clamp(-reach, x, 2 * reach)

    reach = jnp.ones(3)
    np.testing.assert_array_equal(held(x, reach), [-1.0, 0.5, 2.0])
    by_x, by_reach = jax.jacrev(held, (0, 1))(x, reach)
    np.testing.assert_array_equal(by_x, np.diag([0.0, 1.0, 0.0]))
    np.testing.assert_array_equal(by_reach, np.diag([-1.0, 0.0, 2.0]))
