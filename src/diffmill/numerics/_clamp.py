"""A clamp whose derivative is cheap."""

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
