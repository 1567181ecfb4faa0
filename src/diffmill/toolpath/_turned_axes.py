"""Tool axes that turn evenly, which is along a great circle."""

import numpy as np
from jaxtyping import Float

# Nearer to opposite axes than this, nothing says which way round the tool turns.
LEAST_SUM = 1e-6
# Axes that miss +z by less stand upright: the rim of a tool of 20 mm by 1 um.
_UPRIGHT = 1e-4


def stand_upright(axes: Float[np.ndarray, "row 3"]) -> bool:
    """Return whether unit tool axes are all +z, to 1e-4."""
    return bool(np.all(np.abs(axes - np.array([0.0, 0.0, 1.0])) < _UPRIGHT))


def turned_axes(
    first: Float[np.ndarray, "#row 3"],
    last: Float[np.ndarray, "#row 3"],
    share: Float[np.ndarray, " row"],
) -> Float[np.ndarray, "row 3"]:
    """Return unit tool axes on the way from one axis to another.

        a(s) = cos(s phi) a_0 + sin(s phi) / sin(phi) (a_1 - cos(phi) a_0)

    Args:
        first: Axis before the turn a_0, unit or nearly, shape (row, 3) or (1, 3).
        last: Axis behind it a_1, as `first`.
        share: How much of the angle phi is turned s, shape (row,).

    Raises:
        ValueError: If an axis turns to the opposite one.
    """
    first, last = (a / np.linalg.norm(a, axis=1, keepdims=True) for a in (first, last))
    gap, total = (np.linalg.norm(a, axis=1) for a in (last - first, last + first))
    if np.any(total < LEAST_SUM):
        raise ValueError(
            "The tool must not turn to the opposite axis at once: nothing says which "
            "way round."
        )
    phi = 2 * np.arctan2(gap, total)
    # Exactly zero where the axis stays.
    across = last - first + (0.5 * gap**2)[:, None] * first
    # np.sinc(x) is sin(pi x) / (pi x), smooth at zero.
    along = share * np.sinc(share * phi / np.pi) / np.sinc(phi / np.pi)
    axes = np.cos(share * phi)[:, None] * first + along[:, None] * across
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)
