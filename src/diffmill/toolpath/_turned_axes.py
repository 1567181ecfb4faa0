"""Tools that turn evenly: the axis along a great circle, and evenly about it."""

import numpy as np
from jaxtyping import Float

# Nearer to opposite axes than this, nothing says which way round the tool turns.
LEAST_SUM = 1e-6
# Axes that miss +z by less stand upright: the rim of a tool of 20 mm by 1 um.
_UPRIGHT = 1e-4


def stand_upright(axes: Float[np.ndarray, "row 3"]) -> bool:
    """True if unit tool axes are all +z, to 1e-4."""
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


def turned_tool_x(
    first: Float[np.ndarray, "#row 6"],
    last: Float[np.ndarray, "#row 6"],
    share: Float[np.ndarray, " row"],
    axes: Float[np.ndarray, "row 3"],
) -> Float[np.ndarray, "row 3"]:
    """Unit x of the tool on the way from one orientation to another.

    The tool turns with its axis, without a turn about it, and evenly by the rest psi:

        t(x, a, b) = x - (x . b) / (1 + a . b) (a + b)
        x(s) = cos(s psi) t(x_0, a_0, a(s)) + sin(s psi) a(s) x t(x_0, a_0, a(s))

    Args:
        first: Tool axis a_0 and tool x x_0 before the turn, unit and perpendicular,
            shape (row, 6) or (1, 6).
        last: The same behind it, as `first`.
        share: How much of the way is gone s, shape (row,).
        axes: Tool axis there a(s) as `turned_axes` has it, shape (row, 3).
    """
    (a_0, x_0), (a_1, x_1) = (np.hsplit(one, 2) for one in (first, last))

    def carried(axis: np.ndarray) -> np.ndarray:
        along = np.sum(x_0 * axis, axis=1) / (1 + np.sum(a_0 * axis, axis=1))
        return x_0 - along[:, None] * (a_0 + axis)

    end = carried(a_1)
    psi = np.arctan2(np.sum(np.cross(a_1, end) * x_1, 1), np.sum(end * x_1, axis=1))
    x, angle = carried(axes), (share * psi)[:, None]
    x = np.cos(angle) * x + np.sin(angle) * np.cross(axes, x)
    return x / np.linalg.norm(x, axis=1, keepdims=True)
