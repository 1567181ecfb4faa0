"""A step whose slope is a hat, so that equal steps side by side sum to a line."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._clamp import clamp


@jax.custom_jvp
def hat_integral(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Integrate a hat of half-width 1.

    Summed over samples at spacing 1, it grows by 1 per sample at any phase of them.

    Args:
        x: Upper end of the integral, any shape.

    Returns:
        0 below -1, 1 above 1, same shape.

    Differentiability: continuously differentiable.
    """
    x = clamp(-1.0, x, 1.0)
    return 0.5 + x - 0.5 * x * jnp.abs(x)


@hat_integral.defjvp
def _hat_integral_jvp(primals, tangents):
    # The hat itself: a fraction of what the derivative of clamping would compute.
    (x,), (tangent,) = primals, tangents
    return hat_integral(x), jnp.maximum(1 - jnp.abs(x), 0) * tangent
