"""A value from one place and its derivative from another."""

import jax
from jaxtyping import Array, Float


@jax.custom_jvp
def with_derivative_of(
    value: Float[Array, "*n"], other: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Return `value`, with the derivative of `other`.

    Args:
        value: What is returned, any shape.
        other: What is differentiated, same shape; not computed where nobody asks.

    Returns:
        `value`.

    Differentiability: that of `other`, in forward and reverse mode.
    """
    del other
    return value


@with_derivative_of.defjvp
def _jvp(primals, tangents):
    # Not the bare value: what is built on it may be differentiated once more.
    return with_derivative_of(*primals), tangents[1]
