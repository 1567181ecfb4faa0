"""Offsets of a command over time as a cubic B-spline with few coefficients."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._types import RealScalarLike

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Coefficients held at zero at either end: three, so that the curve, its slope and
# its second derivative all start and end at zero.
CLAMPED = 3


class SplineOffsets(eqx.Module):
    """A uniform cubic B-spline over a whole program, at rest at both ends.

    The knots divide the program into equal intervals no shorter than the spacing
    asked for, which is the bandwidth that the controller can follow. The first and
    last three coefficients are zero, so that the offset, its velocity and its
    acceleration vanish at both ends. A cubic B-spline lies in the convex hull of its
    coefficients: a bound on every coefficient bounds the curve everywhere.

    Attributes:
        step_count: Rows of the program.
        interval_count: Number of equal intervals between knots.
        time_step: Time between two rows [s].
    """

    step_count: int = eqx.field(static=True)
    interval_count: int = eqx.field(static=True)
    time_step: RealScalarLike

    def __init__(self, step_count: int, time_step: RealScalarLike, knot_spacing: float):
        """Choose the knots; `knot_spacing` is the smallest spacing [s]."""
        if not (float(time_step) > 0 and knot_spacing > 0):
            raise ValueError(
                "Arguments `time_step` and `knot_spacing` must be positive, but are "
                f"{time_step} s and {knot_spacing} s."
            )
        # A Python number would be static in compiled functions.
        self.step_count, self.time_step = step_count, np.asarray(time_step, np.float64)
        # The slack keeps a spacing that divides the duration from losing an interval.
        intervals = self.duration / knot_spacing * (1 + 1e-9)
        self.interval_count = int(np.floor(intervals))
        if self.interval_count < CLAMPED + 1:
            raise ValueError(
                "Argument `knot_spacing` must leave at least four intervals in the "
                f"program of {self.duration:.4g} s, but is {knot_spacing:.4g} s."
            )

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return (self.step_count - 1) * float(self.time_step)

    @property
    def actual_spacing(self) -> float:
        """Spacing of the knots as used [s], at least the one asked for."""
        return self.duration / self.interval_count

    @property
    def coefficient_count(self) -> int:
        """Number of free coefficients per axis."""
        return self.interval_count + 3 - 2 * CLAMPED

    @eqx.filter_jit
    def offsets(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, "step axis"]:
        """Curve at every row, shape (step, axis).

        Args:
            coefficients: Free coefficients [unit of the command],
                shape (coefficient, axis).

        Returns:
            Offsets, shape (step, axis), in the coefficients' unit.

        **Differentiability**: linear; its transpose costs the same.
        """
        start, weights = _basis(self)
        padded = jnp.pad(coefficients, ((CLAMPED, CLAMPED), (0, 0)))
        # Four gathers of contiguous rows: no dense basis matrix is ever formed.
        weights = jnp.asarray(weights, coefficients.dtype)
        terms = [weights[:, r, None] * padded[start + r] for r in range(4)]
        return terms[0] + terms[1] + terms[2] + terms[3]

    def roughness(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, "interval axis"]:
        """Second differences of all coefficients, the clamped included.

        Divided by the square of the knot spacing they are the second derivative of
        the curve at the knots.

        Args:
            coefficients: Free coefficients, shape (coefficient, axis).

        Returns:
            Second differences, shape (interval, axis), in the coefficients' unit.

        **Differentiability**: linear.
        """
        padded = jnp.pad(coefficients, ((2, 2), (0, 0)))
        return padded[2:] - 2 * padded[1:-1] + padded[:-2]

    def normal_band(self) -> Float[np.ndarray, "4 coefficient"]:
        """Upper band of B^T B, in the layout of `scipy.linalg`."""
        start, weights = _basis(self)
        count = self.coefficient_count
        full = np.zeros((4, count + 2 * CLAMPED))
        for r in range(4):
            for s in range(r, 4):
                np.add.at(full[3 - (s - r)], start + s, weights[:, r] * weights[:, s])
        return full[:, CLAMPED:-CLAMPED]

    def fit(
        self, signal: Float[np.ndarray, "step axis"] | Float[Array, "step axis"]
    ) -> Float[np.ndarray, "coefficient axis"]:
        """Coefficients closest to a signal in least squares, (coefficient, axis).

        Args:
            signal: Offsets at every row, shape (step, axis).

        Returns:
            Coefficients, shape (coefficient, axis), in the signal's unit.

        **Differentiability**: runs on the host, not traceable.
        """
        from scipy.linalg import solveh_banded

        band = self.normal_band()
        # Knots closer than the rows would leave coefficients that no row sees.
        band[3] += 1e-12 * band[3].max()
        return solveh_banded(band, adjoint_offsets(self, np.asarray(signal)))

    def window(
        self, first_row: int, row_count: int, *, preview_rows: int = 0
    ) -> "SplineWindow":
        """Part of the spline that acts on some rows.

        Args:
            first_row: First row of the window.
            row_count: Rows of the window but for those ahead; may reach beyond the
                program.
            preview_rows: Further rows that the plant looks at, so that it has done at
                the first row what as many behind it say.

        Returns:
            The window, in NumPy.

        **Differentiability**: runs on the host, not traceable.
        """
        start, weights = _basis(self)
        last = self.step_count - 1
        total = row_count + preview_rows
        rows = np.minimum(np.arange(first_row, first_row + total), last)
        first = int(start[first_row])
        # A window sees as many intervals as its length, and parts of two more.
        per_row = self.interval_count / last
        count = int(np.ceil((total - 1) * per_row)) + 5
        place = first + np.arange(count)
        # The weight of the fourth coefficient is zero on a knot.
        held = rows[preview_rows]
        untouched = int(start[held]) + (4 if weights[held, 3] > 0 else 3)
        has_end = first_row + row_count > last
        least = max(untouched, CLAMPED)
        end = rows[row_count - 1]
        # The last one acts behind the end too, on rows that the next window corrects.
        # Held, it bends the end towards what lies behind, and costs accuracy there.
        most = self.interval_count + 2 - CLAMPED if has_end else int(start[end])
        return SplineWindow(
            start=(start[rows] - first).astype(np.int32),
            weights=weights[rows],
            first=np.asarray(first, np.int32),
            is_free=(place >= least) & (place <= most),
        )


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
            to the first, nor on as many behind it as there are rows ahead. Of those
            that may, the last alone acts on rows behind the window, up to the next
            knot. Shape (coefficient,).
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
        """Curve at the rows of the window, shape (step, axis)."""
        weights = jnp.asarray(self.weights, coefficients.dtype)
        start = jnp.asarray(self.start)
        terms = [weights[:, r, None] * coefficients[start + r] for r in range(4)]
        return terms[0] + terms[1] + terms[2] + terms[3]

    def roughness(
        self, coefficients: Float[Array, "coefficient axis"]
    ) -> Float[Array, "interval axis"]:
        """Second differences of the coefficients, shape (interval, axis)."""
        return coefficients[2:] - 2 * coefficients[1:-1] + coefficients[:-2]

    def place(self) -> Int[np.ndarray, " coefficient"]:
        """Places of the coefficients among those of the program, (coefficient,)."""
        return int(self.first) + np.arange(self.is_free.shape[0])

    def padded(self, reach: int) -> "SplineWindow":
        """Window with more rows at either end, copies of its first and last."""
        start = np.pad(np.asarray(self.start), reach, mode="edge")
        weights = np.pad(np.asarray(self.weights), ((reach,) * 2, (0, 0)), mode="edge")
        return SplineWindow(start, weights, self.first, self.is_free)


def basis_matrix(spline: SplineOffsets) -> "csr_array":
    """Basis as a sparse matrix of `scipy.sparse`, shape (step, coefficient).

    Args:
        spline: The basis B.

    Returns:
        B, shape (step, coefficient), in compressed rows.

    **Differentiability**: on the host, not traceable.
    """
    from scipy.sparse import csr_array

    start, weights = _basis(spline)
    columns = (start[:, None] + np.arange(4)[None]).reshape(-1)
    rows = np.repeat(np.arange(spline.step_count), 4)
    shape = (spline.step_count, spline.coefficient_count + 2 * CLAMPED)
    full = csr_array((weights.reshape(-1), (rows, columns)), shape=shape)
    return full[:, CLAMPED:-CLAMPED]


def adjoint_offsets(
    spline: SplineOffsets, signal: Float[np.ndarray, "step axis"]
) -> Float[np.ndarray, "coefficient axis"]:
    """Transposed basis times a signal, B^T signal, shape (coefficient, axis).

    Args:
        spline: The basis B.
        signal: One value per row, shape (step, axis).

    **Differentiability**: linear; on the host, not traceable.
    """
    start, weights = _basis(spline)
    rows = spline.coefficient_count + 2 * CLAMPED
    full = np.zeros((rows, signal.shape[1]))
    for r in range(4):
        np.add.at(full, start + r, weights[:, r, None] * signal)
    return full[CLAMPED:-CLAMPED]


def _basis(
    spline: SplineOffsets,
) -> tuple[Int[np.ndarray, " step"], Float[np.ndarray, "step 4"]]:
    """First of the four coefficients of each row, and the values of their functions."""
    count = spline.interval_count
    # From the row count and not from time_step, so that the last row is the last knot.
    place = np.arange(spline.step_count) * (count / (spline.step_count - 1))
    start = np.minimum(np.floor(place).astype(np.int64), count - 1)
    u = place - start
    weights = np.stack(
        [
            (1 - u) ** 3 / 6,
            (3 * u**3 - 6 * u**2 + 4) / 6,
            (-3 * u**3 + 3 * u**2 + 3 * u + 1) / 6,
            u**3 / 6,
        ],
        axis=1,
    )
    return start, weights
