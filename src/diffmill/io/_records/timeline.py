"""Time columns as they are found: unordered, with few digits, with gaps."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

# Rates that differ by less are the same, one of them rounded.
_SAME_RATE = 0.01
# A part that begins again is a measurement of its own only from this length on.
_SHORTEST_PART = 100
# Stamps of one clock are this share of a usual step apart at least.
_LEAST_STEP_SHARE = 0.6
# Time between parts that each begin at zero [s]: longer than a pause within a cut.
_PART_PAUSE = 1.0
_DOUBTFUL_ROW_SHARE = 0.01
# Steps that scatter by more of themselves are said to be uneven.
_UNEVEN_STEP_SHARE = 0.05
# A clock that steps back by more has passed midnight [s].
_HALF_DAY, _DAY = 43200.0, 86400.0


class Timeline(NamedTuple):
    """Instants that increase, and the rows from which they come.

    Attributes:
        time: Instants [s], shape (kept,).
        rows: Row of each instant among those given, shape (kept,).
        is_after_gap: Whether samples are missing just before, shape (kept,).
        rate: Sampling rate [Hz].
    """

    time: Float[np.ndarray, " kept"]
    rows: Int[np.ndarray, " kept"]
    is_after_gap: Bool[np.ndarray, " kept"]
    rate: float


def timeline(
    time: Float[np.ndarray, " row"] | None,
    is_valid: Bool[np.ndarray, " row"],
    rate: float | None,
    faults: list[str],
    notes: list[str],
) -> Timeline | None:
    """Return increasing instants for the rows of a record, or None with a fault.

    Args:
        time: The time column [s], NaN where it has none, or None without a column.
        is_valid: Whether a row has all of its forces.
        rate: Sampling rate that the user or the header gives [Hz], or None.
        faults: Receives faults.
        notes: Receives repairs.
    """
    has_time = np.ones_like(is_valid) if time is None else np.isfinite(time)
    is_valid = is_valid & has_time
    complete = np.flatnonzero(is_valid).astype(np.int32)
    lost = is_valid.size - complete.size
    if lost:
        notes.append(f"{lost} rows have an empty cell and were left out, as gaps.")
    if complete.size < 2:
        faults.append(f"found {complete.size} complete rows; needed are 2.")
        return None
    if time is None or np.ptp(time[complete]) == 0:
        return _counted(time, complete, rate, faults, notes)
    # Rows without a force have a stamp, which the clock needs if it has few digits;
    # but forces may stand in every second row only, beside a faster channel.
    is_slower = np.median(np.diff(complete)) > 1
    rows = complete if is_slower else np.flatnonzero(has_time).astype(np.int32)
    instants, rows = _ordered(past_midnight(time[rows]), rows, faults, notes)
    step, resolution = _stamps(instants)
    if not step > 0:
        faults.append("the time does not increase; name another column or none.")
        return None
    if rate is not None and abs(rate * step - 1.0) > _SAME_RATE:
        notes.append(
            f"The rate is given as {rate:g} Hz, but the time column has "
            f"{1 / step:g} Hz, which was used."
        )
        rate = None
    gaps = _gaps(instants, step + max(0.5 * step, 1.5 * resolution))
    is_after_gap = np.concatenate([[False], gaps])
    if gaps.any():
        notes.append(
            f"{np.count_nonzero(gaps)} gaps in the time, the longest of "
            f"{np.diff(instants).max():g} s, were kept and marked."
        )
    has_few_digits = resolution > 0.1 * step or np.any(np.diff(instants) == 0)
    if has_few_digits:
        rate = rate or _roundest(instants, is_after_gap, 1 / step, resolution)
        if rate is None:
            faults.append(
                "the time has too few digits to show the sampling rate; give the rate "
                "and set the channel time to None, or name another column."
            )
            return None
        instants = _rebuilt(instants, is_after_gap, rate, notes)
    if not np.all(np.diff(instants) > 0):
        faults.append(
            "stamps of the time are out of place, so that rows cannot be put in order; "
            "give the rate and set the channel time to None, or name another column."
        )
        return None
    uneven = float(np.std(np.diff(instants)[~is_after_gap[1:]])) / step
    if uneven > _UNEVEN_STEP_SHARE:
        notes.append(
            f"The samples are not evenly spaced ({uneven:.0%} of a step rms); their "
            "own instants were used."
        )
    # Nine digits: the difference of two stamps has no more.
    whole = Timeline(instants, rows, is_after_gap, rate or float(f"{1 / step:.9g}"))
    return _part(whole, np.flatnonzero(is_valid[rows]))


def _part(whole: Timeline, kept: Int[np.ndarray, " kept"]) -> Timeline:
    """Return some instants of a time line, those that are left out as gaps."""
    gaps = np.cumsum(whole.is_after_gap)
    is_apart = (np.diff(kept) > 1) | (np.diff(gaps[kept]) > 0)
    return Timeline(
        whole.time[kept],
        whole.rows[kept],
        np.concatenate([[False], is_apart]),
        whole.rate,
    )


def _counted(
    time: Float[np.ndarray, " row"] | None,
    rows: Int[np.ndarray, " kept"],
    rate: float | None,
    faults: list[str],
    notes: list[str],
) -> Timeline | None:
    """Return instants from the row numbers and the rate."""
    cause = "no time column" if time is None else "one instant in the whole time column"
    if rate is None:
        faults.append(
            f"found {cause} and no sampling rate in the header, or one such as 10,000 "
            "Hz, which may be ten or ten thousand; give the rate, or name the column "
            "of the time with `channels`."
        )
        return None
    notes.append(f"There is {cause}: the time was counted from the rate {rate:g} Hz.")
    is_after_gap = np.concatenate([[False], np.diff(rows) > 1])
    return Timeline(rows / rate, rows, is_after_gap, rate)


def past_midnight(time: Float[np.ndarray, " row"]) -> Float[np.ndarray, " row"]:
    """Return a time of day that goes on after midnight."""
    steps = np.diff(time)
    is_next = (steps < -_HALF_DAY) & (steps > -_DAY)
    # Two such steps are a table in wrong order.
    if np.count_nonzero(is_next) != 1:
        return time
    return time + _DAY * np.concatenate([[0.0], np.cumsum(is_next)])


def _ordered(
    time: Float[np.ndarray, " row"],
    rows: Int[np.ndarray, " row"],
    faults: list[str],
    notes: list[str],
) -> tuple[Float[np.ndarray, " kept"], Int[np.ndarray, " kept"]]:
    """Instants [s] in order and their rows; parts that begin again follow each other.

    Args:
        time: Stamps of the rows [s], shape (row,).
        rows: Their numbers in the file, shape (row,).
        faults: Receives faults.
        notes: Receives repairs.
    """
    steps = np.diff(time)
    # Rows without any order step back as often as forward.
    if np.count_nonzero(steps < 0) > 9 * np.count_nonzero(steps > 0):
        time, rows, steps = time[::-1], rows[::-1], -steps[::-1]
        notes.append("The time column runs backward; the rows were reversed.")
    back = np.flatnonzero(steps < 0) + 1
    if back.size:
        joined = _joined(time, back)
        if joined is None:
            order = _in_order(time, back)
            alike = np.diff(time[order]) == 0
            # Of rows with the same stamp nobody knows which comes first, unless they
            # stand together; blocks in wrong order part few of them.
            is_open = alike & (np.abs(np.diff(order)) != 1)
            if np.count_nonzero(is_open) > _DOUBTFUL_ROW_SHARE * time.size:
                faults.append(
                    "the rows are in wrong order, and the time has too few digits to "
                    "show which of several rows with the same stamp comes first."
                )
            time, rows = time[order], rows[order]
            notes.append(
                f"The time steps back at {back.size} rows; the rows were sorted."
            )
        else:
            time = joined
            notes.append(
                f"The time begins again {back.size} times; the parts were set one "
                f"after another, {_PART_PAUSE:g} s between them."
            )
    steps = np.diff(time)
    # A row that was written twice is followed by a usual step, coarse stamps by a long
    # one.
    is_repeat = np.concatenate([[False], steps == 0])
    usual = 1.5 * np.median(steps)
    is_short = np.concatenate([steps, [0.0]]) <= usual
    count = np.count_nonzero(is_repeat)
    if 0 < count < 0.01 * time.size and np.all(is_short[is_repeat]):
        time, rows = time[~is_repeat], rows[~is_repeat]
        notes.append(f"{count} rows repeat the instant before and were left out.")
    return time, rows


def _in_order(
    time: Float[np.ndarray, " row"], back: Int[np.ndarray, " part"]
) -> Int[np.ndarray, " row"]:
    """Return the order of the rows by their stamps, equal ones as the parts tell.

    Of a stamp that two parts share, the rows of the part that begins with it come last.
    """
    starts = np.concatenate([[0], back])
    lengths = np.diff(np.concatenate([starts, [time.size]]))
    begins = time == np.repeat(time[starts], lengths)
    return np.lexsort((begins, time))


def _joined(
    time: Float[np.ndarray, " row"], back: Int[np.ndarray, " part"]
) -> Float[np.ndarray, " row"] | None:
    """Return parts that overlap in time one after another; None if none overlap."""
    starts = np.concatenate([[0], back])
    stops = np.concatenate([back, [time.size]])
    if np.min(stops - starts) < min(_SHORTEST_PART, time.size // 4):
        return None
    order = np.argsort(time[starts])
    ends, begins = time[stops - 1][order], time[starts][order]
    if np.all(begins[1:] >= ends[:-1]) or _interlock(time):
        return None
    out = np.array(time)
    for start, stop in zip(starts[1:], stops[1:], strict=True):
        out[start:stop] += out[start - 1] + _PART_PAUSE - time[start]
    return out


def _interlock(time: Float[np.ndarray, " row"]) -> bool:
    """True if rows out of order fill each other's gaps: one clock, shuffled."""
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0]))
    return bool(np.diff(np.sort(time)).min() > _LEAST_STEP_SHARE * usual)


def _gaps(
    time: Float[np.ndarray, " sample"], longest: float
) -> Bool[np.ndarray, " step"]:
    """Gaps: steps that are too long for two neighbouring samples, shape (step,).

    Stamps of a fixed number of digits grow coarse as the time grows: beside equal
    stamps a step is a gap only if it is longer than the coarse steps around it, too.
    """
    steps = np.diff(time)
    gaps = steps > longest
    padded = np.concatenate([[1.0], steps, [1.0]])
    for index in np.flatnonzero(gaps & ((padded[:-2] == 0) | (padded[2:] == 0))):
        before, after = steps[:index], steps[index + 1 : index + 1000]
        before = before[-1000:]
        around = [*before[before > 0][-1:], *after[after > 0][:1]]
        gaps[index] = steps[index] > 1.5 * max(around, default=0.0)
    return gaps


def _stamps(time: Float[np.ndarray, " sample"]) -> tuple[float, float]:
    """Time between samples, and resolution of their stamps [s].

    The resolution is 0 for stamps that are equally spaced but for gaps.
    """
    steps = np.diff(time)
    moves = steps[steps > 0]
    if moves.size == 0:
        return 0.0, 0.0
    typical = float(np.median(moves))
    # Gaps are longer than ten of the steps that stamps with few digits make.
    step = float(steps[steps <= 10 * typical].mean())
    is_typical = np.abs(steps - typical) <= 1e-3 * typical
    if np.mean(is_typical) >= 0.95:
        return typical, 0.0
    distinct = np.unique(np.round(steps / typical, 3))
    differences = np.diff(distinct)
    return step, min(1.0, float(differences.min(initial=1.0))) * typical


def _roundest(
    time: Float[np.ndarray, " sample"],
    is_after_gap: Bool[np.ndarray, " sample"],
    rate: float,
    resolution: float,
) -> float | None:
    """Return the rate with the fewest digits that the rounded stamps allow [Hz].

    None if the longest part has one stamp only.
    """
    edges = np.concatenate([[0], np.flatnonzero(is_after_gap), [time.size]])
    longest = int(np.argmax(np.diff(edges)))
    part = time[edges[longest] : edges[longest + 1]]
    if part.size < 3:
        return rate
    slope = float(np.polyfit(np.arange(part.size), part - part[0], 1)[0])
    if not slope > 0:
        return None
    doubt = resolution / max(float(part[-1] - part[0]), resolution)
    for digits in range(1, 10):
        candidate = float(f"{1 / slope:.{digits}g}")
        if abs(candidate * slope - 1) <= doubt:
            return candidate
    return 1 / slope


def _rebuilt(
    time: Float[np.ndarray, " sample"],
    is_after_gap: Bool[np.ndarray, " sample"],
    rate: float,
    notes: list[str],
) -> Float[np.ndarray, " sample"]:
    """Return equally spaced instants between gaps, each part placed by its mean."""
    notes.append(
        f"The time column has too few digits; it was rebuilt from {rate:g} Hz."
    )
    out = np.array(time)
    starts = np.concatenate([[0], np.flatnonzero(is_after_gap)])
    stops = np.concatenate([starts[1:], [time.size]])
    previous = -np.inf
    for start, stop in zip(starts, stops, strict=True):
        count = np.arange(stop - start) / rate
        begin = max(float(np.mean(time[start:stop] - count)), previous + 1.0 / rate)
        out[start:stop] = begin + count
        previous = out[stop - 1]
    return out
