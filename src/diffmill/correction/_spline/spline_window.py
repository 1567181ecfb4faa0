"""The part of a spline over a program that the rows of a window see."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .command_limits import LinearLimits, MixedLimits
from .spline_offsets import CLAMPED, SplineOffsets, basis


class SplineWindow(eqx.Module):
    """Rows of a program and the coefficients of its spline that reach them.

    Windows of as many rows have the same shapes, so that one compiled program serves
    them all; beyond the last row of the program the offset stays zero.

    Attributes:
        start: First of the four coefficients of every row, counted within the
            window, shape (step,).
        weights: Their weights, shape (step, 4).
        first: Place of the first coefficient of the window among all coefficients of
            the program, the clamped included.
        is_free: Whether a coefficient of the window may change: it acts on no row up
            to the first, nor on as many behind it as there are rows ahead, and on the
            last rows only if the whole of it does, shape (coefficient,).
    """

    start: Int[np.ndarray, " step"] | Int[Array, " step"]
    weights: Float[np.ndarray, "step 4"] | Float[Array, "step 4"]
    first: Int[np.ndarray, ""] | Int[Array, ""]
    is_free: Bool[np.ndarray, " coefficient"] | Bool[Array, " coefficient"]

    @property
    def step_count(self) -> int:
        """Number of rows."""
        return self.start.shape[0]

    def offsets(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, "step axis"]:
        """Return the curve at the rows of the window, shape (step, axis)."""
        weights = jnp.asarray(self.weights, coefficients.dtype)
        start = jnp.asarray(self.start)
        terms = [weights[:, r, None] * coefficients[start + r] for r in range(4)]
        return terms[0] + terms[1] + terms[2] + terms[3]

    def roughness(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, "interval axis"]:
        """Return the second differences of the coefficients, (interval, axis)."""
        return coefficients[2:] - 2 * coefficients[1:-1] + coefficients[:-2]

    def place(self) -> Int[np.ndarray, " coefficient"]:
        """Return the places of the coefficients among those of the program."""
        return int(self.first) + np.arange(self.is_free.shape[0])

    def padded(self, reach: int) -> "SplineWindow":
        """Return the window with more rows at either end, as the last there are."""
        start = np.pad(np.asarray(self.start), reach, mode="edge")
        weights = np.pad(np.asarray(self.weights), ((reach,) * 2, (0, 0)), mode="edge")
        return SplineWindow(start, weights, self.first, self.is_free)


def spline_window(
    spline: SplineOffsets, first_row: int, row_count: int, *, rows_ahead: int = 0
) -> SplineWindow:
    """Return the window of some rows.

    Args:
        spline: The spline over the whole program.
        first_row: First row of the window.
        row_count: Rows of the window but for those ahead; may reach beyond the program.
        rows_ahead: Further rows that the plant looks at, so that it has done at the
            first row what as many behind it say.

    Returns:
        The window, in NumPy.

    **Differentiability**: runs on the host, not traceable.
    """
    start, weights = basis(spline)
    last = spline.step_count - 1
    total = row_count + rows_ahead
    rows = np.minimum(np.arange(first_row, first_row + total), last)
    first = int(start[first_row])
    # A window sees as many intervals as its length, and parts of two more.
    per_row = spline.interval_count / last
    count = int(np.ceil((total - 1) * per_row)) + 5
    place = first + np.arange(count)
    # The weight of the fourth coefficient is zero on a knot.
    held = rows[rows_ahead]
    untouched = int(start[held]) + (4 if weights[held, 3] > 0 else 3)
    has_end = first_row + row_count > last
    least = max(untouched, CLAMPED)
    end = rows[row_count - 1]
    most = spline.interval_count + 2 - CLAMPED if has_end else int(start[end])
    return SplineWindow(
        start=(start[rows] - first).astype(np.int32),
        weights=weights[rows],
        first=np.asarray(first, np.int32),
        is_free=(place >= least) & (place <= most),
    )


def window_limits(
    limits: Sequence[LinearLimits | MixedLimits],
    coefficients: Float[np.ndarray, "all axis"],
    window: SplineWindow,
) -> tuple[MixedLimits, ...]:
    """Return limits of a whole command as those of the coefficients of a window.

    Args:
        limits: Limits of the free coefficients of the program.
        coefficients: All coefficients of the program, the clamped included; those
            that may not change count as they are.
        window: The window.

    Returns:
        The same limits, for the rows that what may change acts on.

    **Differentiability**: runs on the host, not traceable.
    """
    from scipy import sparse

    axes = coefficients.shape[1]
    is_free = np.asarray(window.is_free)
    inside = _flat(np.flatnonzero(is_free), axes)
    columns = _flat(window.place()[is_free] - CLAMPED, axes)
    entries = np.ones(inside.size), (np.arange(inside.size), inside)
    spread = sparse.csr_array(entries, shape=(inside.size, is_free.size * axes))
    whole = coefficients[CLAMPED:-CLAMPED].reshape(-1)
    found = []
    for limit in limits:
        flat = limit.flat(axes)
        own = sparse.csc_array(flat)[:, columns]
        rows = np.unique(own.nonzero()[0])
        matrix = sparse.csr_array(own)[rows] @ spread
        others = (flat @ whole)[rows] - (own @ whole[columns])[rows]
        lower, upper = (end.reshape(-1)[rows] for end in (limit.lower, limit.upper))
        found.append(
            MixedLimits(matrix, lower - others, upper - others, axes, limit.name)
        )
    return tuple(found)


def _flat(
    places: Int[np.ndarray, " place"], axes: int
) -> Int[np.ndarray, " coefficient"]:
    """Return the places of all axes of coefficients, row by row."""
    return (places[:, None] * axes + np.arange(axes)[None]).reshape(-1)
