"""The mean of a smooth step over a length, and the moment of the hat behind it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...numerics import clamp, ramp


def mean_step(
    x: Float[Array, "*n"], width: Float[Array, "*n"], length: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Mean of `hat_integral(. / width)` over a length around x [-].

    Pieces in a row tile a line.

    Args:
        x: Middle of the length, any shape.
        width: Half-width of the hat, above 0, same shape.
        length: Above 0, not far below the width, or rounding shows; same shape.

    Returns:
        0 to 1, same shape.

    Differentiability: twice continuously differentiable.
    """
    x, half = x / width, 0.5 * length / width
    return (ramp(x + half, 1.0) - ramp(x - half, 1.0)) / (2 * half)


def hat_moment(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Moment of that part of a hat of half-width 1 which lies above x [-].

    Args:
        x: Lower end of the part, any shape.

    Returns:
        Integral of v (1 - |v|) from x to 1: 1/6 at zero, 0 below -1 and above 1.

    Differentiability: continuously differentiable.
    """
    u = 1 - jnp.abs(clamp(-1.0, x, 1.0))
    return u**2 * (3 - 2 * u) / 6
