"""Limits of a command that are linear in its spline, above all of its derivatives.

A command is a row per tooth period, and its controller gets no more: with B the rows of
the spline and D_m the m-th differences over the m-th power of the time step,

    -v <= D_m nominal + D_m B c <= v

is exact for these rows and linear in the coefficients c, with a sparse matrix.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ..._types import FloatRows
from ...optimise import LinearRows
from .spline_offsets import CLAMPED, SplineOffsets, SplineWindow, basis_matrix

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Share of a limit that the steps to it leave, and by which a program may be beyond it:
# differences of rows are rounded.
_RESERVE_SHARE = 1e-6

Coefficients = Float[np.ndarray, "coefficient axis"]
Rows = Float[np.ndarray, "row axis"]


class InfeasibleLimit(ValueError):
    """Raise when a limit cannot be held, by the program itself or by any correction."""


class LinearLimits(eqx.Module):
    """Bounds of linear functions of the coefficients of a spline that 0 keeps.

    Attributes:
        matrix: Sparse, of `scipy.sparse`, shape (row, coefficient x axis): the axes of
            a coefficient follow one another.
        lower: Least values, shape (row,); at most 0.
        upper: Largest values, shape (row,); at least 0.
        name: What the limit is called in messages.
    """

    matrix: "csr_array"
    lower: Float[np.ndarray, " row"]
    upper: Float[np.ndarray, " row"]
    name: str = eqx.field(static=True, default="limits")

    def apply(self, coefficients: Coefficients) -> Float[np.ndarray, " row"]:
        """Values for coefficients, shape (row,)."""
        return self.matrix @ coefficients.reshape(-1)

    def about(self, point: Coefficients) -> LinearRows:
        """Limits as constraints of a step from a point that keeps them.

        Args:
            point: Coefficients, shape (coefficient, axis).
        """
        rows = self.apply(point)
        # A point on a limit may be beyond it by rounding, and a step beyond its own
        # limits by the tolerance of the solver.
        share = 1 - _RESERVE_SHARE
        lower = np.minimum(share * self.lower - rows, 0.0)
        upper = np.maximum(share * self.upper - rows, 0.0)
        return LinearRows(self.matrix, lower, upper)

    @classmethod
    def by_axis(
        cls, matrix: "csr_array", lower: Rows, upper: Rows, name: str = "limits"
    ) -> "LinearLimits":
        """Limits of the same functions of the coefficients of each axis.

        Args:
            matrix: Sparse, shape (row, coefficient).
            lower: Least values, shape (row, axis); at most 0.
            upper: Largest values, shape (row, axis); at least 0.
            name: What the limit is called in messages.
        """
        from scipy import sparse

        each = sparse.eye_array(lower.shape[1])
        spread = sparse.csr_array(sparse.kron(matrix, each))
        return cls(spread, lower.reshape(-1), upper.reshape(-1), name)

    @classmethod
    def of_command(
        cls,
        spline: SplineOffsets,
        nominal: FloatRows,
        *,
        max_velocity: float = np.inf,
        max_acceleration: float = np.inf,
        unit: str = "",
    ) -> "tuple[LinearLimits, ...]":
        """Limits that keep a whole command within its derivatives' bounds.

        Args:
            spline: Basis of the offset.
            nominal: The uncorrected command, shape (step, axis).
            max_velocity: Largest velocity per axis [unit of the command / s].
            max_acceleration: Largest acceleration per axis [unit of the command / s^2].
            unit: Unit of the command, for messages.

        Returns:
            One entry for each limit that is finite.

        Raises:
            InfeasibleLimit: The nominal command breaks a limit; the message says which,
                when, on which axis and by how much.

        **Differentiability**: none, a host function.
        """
        nominal = np.asarray(nominal, np.float64)
        limits = []
        for order, name, limit in (
            (1, "max_velocity", max_velocity),
            (2, "max_acceleration", max_acceleration),
        ):
            if not np.isfinite(limit):
                continue
            time_step = float(spline.time_step)
            rate = np.diff(nominal, order, axis=0) / time_step**order
            per_time = unit + ("/s" if order == 1 else "/s^2")
            _check_nominal(name, order, float(limit), rate, time_step, per_time)
            matrix = basis_matrix(spline)
            for _ in range(order):
                matrix = matrix[1:] - matrix[:-1]
            # In the coefficients' unit, so that rows of both kinds are alike in size.
            step = time_step**order
            scale = spline.actual_spacing**order
            limits.append(
                LinearLimits.by_axis(
                    matrix * (scale / step),
                    np.minimum(scale * (-limit - rate), 0.0),
                    np.maximum(scale * (limit - rate), 0.0),
                    name,
                )
            )
        return tuple(limits)


def _check_nominal(
    name: str,
    order: int,
    limit: float,
    rate: Float[np.ndarray, "row axis"],
    time_step: float,
    unit: str,
) -> None:
    """Raise if the nominal command alone is above the limit."""
    row, axis = np.unravel_index(np.argmax(np.abs(rate)), rate.shape)
    worst = float(np.abs(rate[row, axis]))
    if worst <= limit * (1 + _RESERVE_SHARE):
        return
    raise InfeasibleLimit(
        f"Argument `{name}` must be at least what the program itself needs, "
        f"{worst:.4g} {unit} on axis {axis} at {(row + order / 2) * time_step:.4g} s, "
        f"but is {limit:.4g} {unit}: {worst - limit:.4g} {unit} too low."
    )


def feasible_share(p: Coefficients, limits: Sequence[LinearLimits]) -> float:
    """Largest a with a p within the limits; above 1 where there is room.

    **Differentiability**: none, a host function.
    """
    share = np.inf
    for limit in limits:
        rows = limit.apply(p)
        moves = np.abs(rows) > 0
        bound = np.where(rows > 0, limit.upper, limit.lower)[moves]
        # A bound that is met by rounding only leaves a share of 0, not below.
        shares = np.maximum(bound / rows[moves], 0)
        share = min(share, float(shares.min(initial=np.inf)))
    # One rounding less, so that the product itself stays within.
    return share * (1 - 1e-12)


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
