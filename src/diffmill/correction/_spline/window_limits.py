"""Limits of a whole command as those of a window of its spline."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from .command_limits import LinearLimits
from .spline_offsets import CLAMPED, SplineWindow


def window_limits(
    limits: Sequence[LinearLimits],
    coefficients: Float[np.ndarray, "all axis"],
    window: SplineWindow,
) -> tuple[LinearLimits, ...]:
    """Limits of a whole command as those of the coefficients of a window.

    Args:
        limits: Limits of the free coefficients of the program.
        coefficients: All coefficients of the program, the clamped included; those
            that may not change count as they are.
        window: The window.

    Returns:
        The same limits, of the rows on which the free coefficients act.

    **Differentiability**: runs on the host, not traceable.
    """
    from scipy import sparse

    axes = coefficients.shape[1]
    is_free = np.asarray(window.is_free)
    inside = _flat(np.flatnonzero(is_free), axes)
    columns = _flat(window.place()[is_free] - CLAMPED, axes)
    entries = np.ones(inside.size), (np.arange(inside.size), inside)
    spread = sparse.csr_array(entries, shape=(inside.size, is_free.size * axes))
    fixed = coefficients[CLAMPED:-CLAMPED].copy()
    fixed.reshape(-1)[columns] = 0.0
    window_rows = []
    for limit in limits:
        own = sparse.csc_array(limit.matrix)[:, columns]
        rows = np.unique(own.nonzero()[0])
        matrix = sparse.csr_array(own)[rows] @ spread
        moved = limit.apply(fixed)[rows]
        lower, upper = limit.lower[rows] - moved, limit.upper[rows] - moved
        window_rows.append(LinearLimits(matrix, lower, upper, limit.name))
    return tuple(window_rows)


def _flat(
    places: Int[np.ndarray, " place"], axes: int
) -> Int[np.ndarray, " coefficient"]:
    """Places of all axes of coefficients, row by row."""
    return (places[:, None] * axes + np.arange(axes)[None]).reshape(-1)
