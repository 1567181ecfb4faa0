"""Choice of the tooth in records without a spindle angle: one run-out for all of them.

Teeth that are alike place a record to a whole number of teeth only. Run-out tells them
apart, but one run-out for all records can be fitted only if the same tooth is tooth 0
in each: where this is left to chance, the run-outs of the records cancel. Every record
may be moved by whole tooth periods; of N^(records - 1) choices those are taken for
which coefficients and run-out, common to all, leave the least square.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._cut.cut_model import at_times
from .._statistics.robust_regression import (
    Rows,
    fit_rows,
    inverse_normal,
    normal_equations,
)
from .regression_rows import (
    RegisteredRecord,
    baseline_part,
    equations,
    force_slope,
)

# Another tooth must leave less than this share of the square: teeth that are alike
# leave the same, but for the rays of the stock.
_LESS = 0.999


@dataclasses.dataclass(frozen=True)
class LinearisedRecord:
    """A record with the change of its force per length of the cutter.

    Attributes:
        record: The record.
        slopes: At the instants of its engagement [N/m], shape (sample, 3, length).
    """

    record: RegisteredRecord
    slopes: Float[np.ndarray, "sample 3 length"]

    def columns(self) -> Float[np.ndarray, "row 3 length"]:
        """Change of the force per length at the record's instants [N/m]."""
        engagement = self.record.engagement
        when = self.record.time + self.record.shift
        return at_times(self.slopes, engagement.start, engagement.spacing, when)

    def later(self, shift: float) -> "LinearisedRecord":
        """Record with a larger time shift [s]."""
        moved = dataclasses.replace(self.record, shift=self.record.shift + shift)
        return dataclasses.replace(self, record=moved)


@dataclasses.dataclass(frozen=True)
class _Square:
    """Weighted square y^T W y - 2 g^T x + x^T G x that coefficients and lengths leave.

    Attributes:
        matrix: G, shape (unknown, unknown).
        right: g, shape (unknown,).
        whole: y^T W y.
    """

    matrix: Float[np.ndarray, "unknown unknown"]
    right: Float[np.ndarray, " unknown"]
    whole: float

    @classmethod
    def of_rows(
        cls, rows: Rows, weight: Float[np.ndarray, "row 3"], shared: int
    ) -> "_Square":
        """Square of a record at its best offset, drift and small shift.

        Args:
            rows: Its equations, these unknowns behind the coefficients and lengths.
            weight: [1/N^2]; zero where nothing was measured.
            shared: How many coefficients and lengths there are.
        """
        G, g = normal_equations([rows], [weight])
        whole = float(np.sum(weight * np.nan_to_num(rows.force) ** 2))
        own, _ = inverse_normal(G[shared:, shared:])
        U = G[:shared, shared:] @ own
        matrix = G[:shared, :shared] - U @ G[shared:, :shared]
        right = g[:shared] - U @ g[shared:]
        return cls(matrix, right, whole - float(g[shared:] @ own @ g[shared:]))

    def without_lengths(self) -> "_Square":
        """Square that the six coefficients alone leave."""
        return dataclasses.replace(
            self, matrix=self.matrix[:6, :6], right=self.right[:6]
        )

    def plus(self, other: "_Square") -> "_Square":
        """Square of two records with common unknowns."""
        return _Square(
            self.matrix + other.matrix,
            self.right + other.right,
            self.whole + other.whole,
        )

    def least(self) -> float:
        """Square that the best unknowns leave."""
        g = self.right
        return self.whole - float(g @ inverse_normal(self.matrix)[0] @ g)


def with_common_teeth(
    records: Sequence[LinearisedRecord],
    K: Float[np.ndarray, " 6"],
    shift_range: float | None,
    *,
    is_runout_known: bool,
) -> list[LinearisedRecord]:
    """Records, moved by whole teeth so that one run-out suits all.

    The record whose run-out explains most keeps its tooth: that only says which one is
    called 0, unless the run-out is known. The others join one after the other, and each
    is tried again until none changes its tooth.

    Args:
        records: The records, linearised at one cutter.
        K: Coefficients at which the force's slope in time is taken, shape (6,).
        shift_range: Largest time shift either way [s]; any if None.
        is_runout_known: Whether the direction of the cutter's run-out is known.
    """
    shifts = [_shifts(one.record, shift_range) for one in records]
    squares = [_squares(one, own, K) for one, own in zip(records, shifts, strict=True)]
    # What the lengths explain of a record alone, over what they leave of it.
    gains = [own[0].without_lengths().least() / own[0].least() for own in squares]
    order = np.argsort(gains)[::-1].tolist()
    chosen: dict[int, int] = {} if is_runout_known else {order.pop(0): 0}
    for _ in records:
        before = dict(chosen)
        for i in order:
            others = [squares[j][k] for j, k in chosen.items() if j != i]
            costs = [
                functools.reduce(_Square.plus, others, own).least()
                for own in squares[i]
            ]
            best, last = int(np.argmin(costs)), chosen.get(i, 0)
            chosen[i] = best if costs[best] < _LESS * costs[last] else last
        if chosen == before:
            break
    return [
        one.later(shifts[i][chosen[i]] - one.record.shift)
        for i, one in enumerate(records)
    ]


def _shifts(one: RegisteredRecord, shift_range: float | None) -> list[float]:
    """Time shifts that differ by whole teeth [s], that of the record first.

    The others are those nearest to zero: a record has a revolution of room.
    """
    turn, period = one.revolution, one.cut.tooth_period
    teeth = range(1, one.cut.cutter.flute_count)
    others = [math.remainder(one.shift + k * period, turn) for k in teeth]
    most = math.inf if shift_range is None else shift_range
    return [one.shift, *(shift for shift in others if abs(shift) <= most)]


def _squares(
    one: LinearisedRecord, shifts: Sequence[float], K: Float[np.ndarray, " 6"]
) -> list[_Square]:
    """Square of a record at each time shift, over the same samples."""
    moved = [one.later(shift - one.record.shift) for shift in shifts]
    rows = [
        equations(
            m.record,
            (
                m.columns(),
                *baseline_part([m.record], 0),
                force_slope(m.record, K)[:, :, None],
            ),
        )
        for m in moved
    ]
    known = np.all([np.isfinite(row.force) for row in rows], axis=0)
    spread = fit_rows(rows[:1], "huber").spread[0]
    weight = known / spread[None] ** 2
    shared = 6 + one.slopes.shape[2]
    return [_Square.of_rows(row, weight, shared) for row in rows]
