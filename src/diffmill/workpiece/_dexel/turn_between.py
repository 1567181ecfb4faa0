"""The angle of a vector, cheap enough for every ray of every step."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

# Abramowitz and Stegun, Handbook of Mathematical Functions, 1964, 4.4.49: arctan x / x
# for |x| <= 1 to 1e-5.
_ARCTAN = (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351)
_TINY = 1e-30


def turn_between(
    ahead: Float[Array, "..."], aside: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Return the angle from a direction to a vector, to 2e-5 rad.

    Args:
        ahead: Part of the vector along the direction, any unit, shape (...).
        aside: Part across it, the same unit, shape (...).

    Returns:
        arctan2(aside, ahead) [rad], shape (...), from -pi to pi; finite at zero.

    **Differentiability**: smooth but straight behind and at zero, where it is zero; the
    slope is off by 1e-3 at most.
    """
    x, y = jnp.abs(ahead), jnp.abs(aside)
    greater = jnp.maximum(x, y)
    is_zero = greater < _TINY
    t = jnp.minimum(x, y) / jnp.where(is_zero, 1.0, greater)
    square = t * t
    angle = jnp.zeros_like(t)
    for coefficient in reversed(_ARCTAN):
        angle = angle * square + coefficient
    angle = angle * t
    angle = jnp.where(y > x, math.pi / 2 - angle, angle)
    angle = jnp.where(ahead < 0, math.pi - angle, angle)
    return jnp.where(is_zero, 0.0, jnp.where(aside < 0, -angle, angle))
