"""Regression rows of a force record with its cut."""

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ...numerics import lowpass
from .._alignment.axis_proposal import in_work_axes
from .._alignment.record_registration import RecordRegistration
from .._cut.cut_model import (
    Cut,
    EngagementColumns,
    at_times,
    cut_of,
)
from .._record.saturation import find_measured_saturated, without_saturated
from .._statistics.robust_regression import Rows, solve

Times: TypeAlias = Float[Array, "..."] | Float[np.ndarray, "..."] | Sequence
# For each axis of the work the recorded one, with its sign.
Axes: TypeAlias = tuple[str, str, str]

# What was cut; a registration has simulated it already.
Source: TypeAlias = Cut | Job | RecordRegistration

# Candidates of the time shift per revolution, and rows on which they are compared.
_CANDIDATES, _COMPARED = 180, 2000
# Squared residuals that differ by this share are alike.
_ALIKE = 0.1


class RegisteredRecord(eqx.Module):
    """One record with its cut, in the axes of the work.

    Attributes:
        cut: The cut.
        engagement: Its force per coefficient.
        time: Instants on the record's clock [s], shape (row,).
        force: On the tool in `work` [N], shape (row, 3); NaN where not measured.
        shift: Time of the cut minus time of the record [s].
        saturated: How many samples were left out as saturated.
        lowpass: Cut-off that `force` has passed [Hz], and what is modelled
            passes too; None for none.
        has_offset: Whether every channel may have a constant of its own.
        has_drift: Whether it may have a slope of its own; without an offset it is
            zero at the first instant.
    """

    cut: Cut
    engagement: EngagementColumns
    time: Float[np.ndarray, " row"]
    force: Float[np.ndarray, "row 3"]
    shift: float
    saturated: int = 0
    lowpass: float | None = None
    has_offset: bool = False
    has_drift: bool = False

    @property
    def revolution(self) -> float:
        """Time of one turn of the spindle [s]."""
        return self.cut.tooth_period * self.cut.cutter.flute_count

    def baseline(self) -> Float[np.ndarray, "row term"]:
        """Terms of a channel's offset and drift, shape (row, term); of size 1 each."""
        first, last = self.time[0], self.time[-1]
        terms = np.ones((len(self.time), int(self.has_offset)))
        if not self.has_drift:
            return terms
        since = (self.time - first) / (last - first)
        line = 2 * since - 1 if self.has_offset else since
        return np.column_stack([terms, line])


def equations(one: RegisteredRecord, extra: Sequence[np.ndarray]) -> Rows:
    """Equations of a record for the six coefficients and more.

    Args:
        one: The record.
        extra: Columns of further unknowns, shape (row, 3, unknown) each.

    Returns:
        The equations; instants outside the cut count as not measured.
    """
    engagement, when = one.engagement, one.time + one.shift
    start, spacing = engagement.start, engagement.spacing
    columns = at_times(engagement.columns, start, spacing, when)
    constant = at_times(engagement.constant, start, spacing, when)
    # What lies outside the cut reaches as far into it as the filter is long.
    edge = 0.0 if one.lowpass is None else 1.0 / one.lowpass
    is_inside = (when >= edge) & (when <= one.cut.duration - edge)
    step = float(np.median(np.diff(one.time)))
    lag = max(1, round(one.revolution / step))
    cutter = one.cut.cutter
    period = one.cut.tooth_period if cutter.has_even_pitch else one.revolution
    columns = np.concatenate([columns, *extra], axis=2)
    if one.lowpass is not None:
        both = np.concatenate([columns, constant[:, :, None]], axis=2)
        both = filtered(one.time, one.force, both, one.lowpass)
        columns, constant = both[:, :, :-1], both[:, :, -1]
    force = np.where(is_inside[:, None], one.force - constant, np.nan)
    return Rows(columns, force, lag, np.mod(when / period, 1.0))


def refinement_force(
    one: RegisteredRecord, K: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, "row 3"]:
    """Change of the modelled force by half as many angles and rays [N].

    Args:
        one: The record.
        K: Coefficients, shape (6,).

    Returns:
        The change, shape (row, 3).
    """
    engagement, when = one.engagement, one.time + one.shift
    change = engagement.refinement @ K
    change = at_times(change, engagement.start, engagement.spacing, when)
    if one.lowpass is None:
        return change
    return filtered(one.time, one.force, change[:, :, None], one.lowpass)[:, :, 0]


def filtered(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
    values: Float[np.ndarray, "row 3 column"],
    cutoff: float,
) -> Float[np.ndarray, "row 3 column"]:
    """Values after a low-pass over the runs in which a force was measured.

    Whatever passes it over the same runs loses the same, their ends included, so that
    measured and modelled forces stay comparable.

    Args:
        time: Instants [s], shape (row,).
        force: Whose NaN end the runs, as gaps in the time do, shape (row, 3).
        values: What is filtered, shape (row, 3, column).
        cutoff: Cut-off frequency [Hz]; see `numerics.lowpass`.

    Returns:
        Filtered values, shape (row, 3, column); a run of one sample stays.

    Raises:
        ValueError: The cut-off is not below half the sampling rate.
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    if not 0 < cutoff < 0.5 / usual:
        raise ValueError(
            "Argument `lowpass` must lie between 0 and half the sampling rate, "
            f"{0.5 / usual:g} Hz, but is {cutoff:g} Hz."
        )
    is_gap = np.concatenate([[True], steps > 1.5 * usual])
    result = np.array(values)
    for axis in range(3):
        known = np.isfinite(force[:, axis])
        edges = is_gap | np.concatenate([[True], known[1:] != known[:-1]])
        starts = np.flatnonzero(edges)
        for a, b in zip(starts, [*starts[1:], len(time)], strict=True):
            if known[a] and b - a > 1:
                part = result[a:b, axis]
                result[a:b, axis] = lowpass(part, 1.0 / usual, cutoff)
    return result


def force_slope(one: RegisteredRecord, K: np.ndarray) -> Float[np.ndarray, "row 3"]:
    """Rate dF/dt of the modelled force at the record's instants [N/s].

    Args:
        one: The record.
        K: Coefficients, shape (6,).

    Returns:
        dF/dt [N/s], shape (row, 3).
    """
    engagement = one.engagement
    modelled = engagement.columns @ K + engagement.constant
    when, half = one.time + one.shift, engagement.spacing / 2
    after, before = (
        at_times(modelled, engagement.start, engagement.spacing, when + side)
        for side in (half, -half)
    )
    return (after - before) / (2 * half)


def shift_part(
    records: Sequence[RegisteredRecord], index: int, K: np.ndarray, is_sought: bool
) -> tuple[np.ndarray, ...]:
    """Columns of the time shifts in the equations of one record.

    Args:
        records: All records.
        index: The one.
        K: Coefficients, shape (6,).
        is_sought: Whether the shifts are fitted.

    Returns:
        One array of shape (row, 3, record), or nothing.
    """
    if not is_sought:
        return ()
    one = records[index]
    part = np.zeros((len(one.time), 3, len(records)))
    part[:, :, index] = force_slope(one, K)
    return (part,)


def baseline_part(
    records: Sequence[RegisteredRecord], index: int
) -> tuple[np.ndarray, ...]:
    """Columns of offsets and drifts in the equations of one record.

    Args:
        records: All records.
        index: The one.

    Returns:
        One array of shape (row, 3, unknown), channel by channel of each record, or
        nothing.
    """
    counts = [3 * one.baseline().shape[1] for one in records]
    if not sum(counts):
        return ()
    terms = records[index].baseline()
    part = np.zeros((len(terms), 3, sum(counts)))
    first, size = sum(counts[:index]), terms.shape[1]
    for axis in range(3):
        part[:, axis, first + axis * size : first + (axis + 1) * size] = terms
    return (part,)


def with_baselines(records: Sequence[RegisteredRecord]) -> list[Rows]:
    """Equations of records for the six coefficients, offsets and drifts."""
    return [equations(one, baseline_part(records, i)) for i, one in enumerate(records)]


def find_shift(one: RegisteredRecord, shift_range: float | None) -> RegisteredRecord:
    """Record with the time shift that suits its cut best.

    Args:
        one: The record.
        shift_range: Largest shift either way [s]; a revolution if None.

    Returns:
        The record with its shift.

    Raises:
        ValueError: The record does not overlap the cut for all shifts in the range.
    """
    from scipy.optimize import minimize_scalar

    reach = one.revolution if shift_range is None else float(shift_range)
    is_inside = (one.time >= reach) & (one.time <= one.cut.duration - reach)
    rows = np.flatnonzero(is_inside & np.isfinite(one.force).any(axis=1))
    if rows.size < 12:
        raise ValueError(
            f"Argument `time`, from {one.time[0]:g} to {one.time[-1]:g} s, must "
            f"overlap the cut, from 0 to {one.cut.duration:g} s, for shifts up to "
            f"{reach:g} s; {rows.size} samples do. Give `time_shift` or a smaller "
            "`shift_range`."
        )
    if rows.size > _COMPARED:
        rows = np.sort(np.random.default_rng(0).choice(rows, _COMPARED, replace=False))
    few = dataclasses.replace(
        one, time=one.time[rows], force=one.force[rows], lowpass=None
    )
    if one.lowpass is not None:
        # Single rows have no neighbours to filter with: the simulation has.
        engagement = one.engagement
        rate, count = 1.0 / engagement.spacing, len(engagement.columns)
        columns = lowpass(engagement.columns.reshape(count, -1), rate, one.lowpass)
        columns = columns.reshape(count, 3, 6)
        constant = lowpass(engagement.constant, rate, one.lowpass)
        few = dataclasses.replace(
            few,
            engagement=dataclasses.replace(
                engagement, columns=columns, constant=constant
            ),
        )

    def cost(shift: float) -> float:
        moved = dataclasses.replace(few, shift=float(shift))
        (row,) = with_baselines([moved])
        known = np.isfinite(row.force)
        x = solve([row], [known.astype(np.float64)])
        return float(np.nansum((row.force - row.columns @ x) ** 2))

    step = one.revolution / _CANDIDATES
    count = max(1, round(reach / step))
    shifts = one.shift + step * np.arange(-count, count + 1)
    costs = np.array([cost(shift) for shift in shifts])
    # A steady cut repeats itself: of shifts that suit alike, the smallest.
    good = shifts[costs <= (1 + _ALIKE) * costs.min()]
    near = np.abs(shifts - good[np.argmin(np.abs(good))]) <= 4 * step
    best = float(shifts[near][np.argmin(costs[near])])
    best_shift: Any = minimize_scalar(
        cost, bounds=(best - step, best + step), options={"xatol": 1e-3 * step}
    )
    return dataclasses.replace(one, shift=float(best_shift.x))


def measured_records(
    process_or_job: Source | Sequence[Source],
    time: Times | Sequence[Times],
    force: Times | Sequence[Times],
    axes: Axes,
    time_shift: float | Sequence[float] | None,
    cutoff: float | None = None,
    *,
    has_offset: bool | Sequence[bool] = False,
    has_drift: bool | Sequence[bool] = False,
) -> list[RegisteredRecord]:
    """Records with their cuts, each cut simulated.

    Args:
        process_or_job: A cut, a job or a registration, or a list of them.
        time: Instants of the record [s], shape (row,), or a list.
        force: [N], shape (row, 3), or a list.
        axes: For each axis of the work the recorded one.
        time_shift: [s], one or one per record, or None for 0.
        cutoff: Of a low-pass for both sides [Hz], or None.
        has_offset: Whether channels may have an offset, one or one per record.
        has_drift: Whether they may drift, likewise.

    Returns:
        The records.

    Raises:
        ValueError: Wrong shapes, counts or times.
    """
    cuts: list[Source]
    if isinstance(process_or_job, Sequence):
        cuts, times, forces = list(process_or_job), list(time), list(force)
    else:
        cuts, times, forces = [process_or_job], [time], [force]
    if time_shift is None or isinstance(time_shift, float | int):
        shifts = [float(time_shift or 0.0)] * len(cuts)
    else:
        shifts = [float(shift) for shift in time_shift]
    offsets, drifts = (
        [has] * len(cuts) if isinstance(has, bool) else list(has)
        for has in (has_offset, has_drift)
    )
    lists = (cuts, times, forces, shifts, offsets, drifts)
    if len({len(one) for one in lists}) > 1 or not cuts:
        raise ValueError(
            "Lists of cuts, times, forces, shifts, offsets and drifts must have the "
            f"same length, but have {', '.join(str(len(one)) for one in lists)}."
        )
    return [
        dataclasses.replace(
            _measured(cut, t, f, axes, shift, cutoff),
            has_offset=offset,
            has_drift=drift,
        )
        for cut, t, f, shift, offset, drift in zip(*lists, strict=True)
    ]


def _measured(
    cut: Source,
    time: Times,
    force: Times,
    axes: Axes,
    shift: float,
    cutoff: float | None,
) -> RegisteredRecord:
    """One record, its axes those of the work."""
    when, seen = np.array(time, np.float64), np.array(force, np.float64)
    if when.ndim != 1 or seen.shape != (when.size, 3) or when.size < 12:
        raise ValueError(
            "Arguments `time` and `force` must have shapes (row,) and (row, 3), with "
            f"at least 12 rows, but have {when.shape} and {seen.shape}."
        )
    if not (np.all(np.diff(when) > 0) and np.all(np.isfinite(when))):
        raise ValueError("Argument `time` must ascend and be finite, but does not.")
    if np.any(np.isinf(seen)):
        raise ValueError("Argument `force` must have no infinite values, but has.")
    is_saturated = find_measured_saturated(seen)
    saturated = int(is_saturated.any(axis=1).sum())
    seen = without_saturated(seen, is_saturated)
    turned = in_work_axes(seen, axes)
    if cutoff is not None:
        turned = filtered(when, turned, turned[:, :, None], cutoff)[:, :, 0]
    if isinstance(cut, RecordRegistration):
        whole, columns = cut.cut, cut.engagement
    else:
        whole = cut_of(cut)
        columns = EngagementColumns.of_cut(whole)
    return RegisteredRecord(whole, columns, when, turned, shift, saturated, cutoff)
