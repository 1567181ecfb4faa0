"""Functions with a kink, or with the kink rounded off, whose derivative is cheap."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import RealScalarLike


def clamp(
    lower: RealScalarLike | Float[Array, "..."],
    x: Float[Array, "..."],
    upper: RealScalarLike | Float[Array, "..."],
) -> Float[Array, "..."]:
    """`x`, or the bound that it has passed, in the type of `x`.

    `jnp.clip` divides its derivative by the number of ties, in a reduction that XLA
    runs slowly; `jax.lax.clamp` does not, but wants bounds of the type of `x`.

    Args:
        lower: Scalar, or of the shape of `x`.
        x: Values, any shape.
        upper: Scalar, or of the shape of `x`.

    Returns:
        Values of the shape and type of `x`.

    Differentiability: 1 inside; outside that of the bound, 0 for a constant one. JAX
    differentiates only bounds of the shape of `x`.
    """
    bound = lambda value: jnp.asarray(value, x.dtype)
    return jax.lax.clamp(bound(lower), x, bound(upper))


@jax.custom_jvp
def hat_integral(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Integral of a hat of half-width 1: a smooth step from 0 to 1.

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
    # The hat itself: a fraction of the work of differentiating the clamp.
    (x,), (tangent,) = primals, tangents
    return hat_integral(x), jnp.maximum(1 - jnp.abs(x), 0) * tangent


def ramp(x: Float[Array, "*n"], width: float | Float[Array, ""]) -> Float[Array, "*n"]:
    """Ramp max(x, 0) with its corner rounded off, in the unit of x.

    Args:
        x: Values, any shape.
        width: The corner is rounded from -width to width; above 0, in the unit of x.

    Returns:
        0 below -width, x above width; width / 6 at zero, with a slope of a half.

    Differentiability: twice continuously differentiable.
    """
    return width * _integrated_twice(x / width)


@jax.custom_jvp
def _integrated_twice(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Integral of `hat_integral` from below -1 up to x."""
    c = clamp(-1.0, x, 1.0)
    return 1 / 6 + 0.5 * c + 0.5 * c**2 - jnp.abs(c) ** 3 / 6 + jnp.maximum(x - 1, 0)


@_integrated_twice.defjvp
def _integrated_twice_jvp(primals, tangents):
    (x,), (tangent,) = primals, tangents
    return _integrated_twice(x), hat_integral(x) * tangent
