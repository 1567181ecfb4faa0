"""The mean of a smooth step over a length."""

from jaxtyping import Array, Float

from ...numerics import ramp


def mean_step(
    x: Float[Array, "*n"], width: Float[Array, "*n"], length: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Return the mean of `hat_integral(. / width)` over a length around x.

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
