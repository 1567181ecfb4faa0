"""Records made ready: tare, drift, filter, new rate. Each returns a new record."""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float

from .record import Record

# Samples of a tare section that are further off its median do not count, in standard
# deviations.
_GROSS = 6.0


def remove_offset(record: Record, start: float, stop: float) -> Record:
    """Return a record less the mean force of a section without cut.

    Gross errors, six standard deviations off the section's median, do not count.

    Args:
        record: The record.
        start: Where the tare section begins [s].
        stop: Where it ends [s].

    Raises:
        ValueError: If fewer than 2 samples lie in the section.

    Differentiability: linear in the force; on the host.
    """
    _, level = _mean(record, start, stop)
    return _with_force(record, record.force - level[None])


def remove_drift(
    record: Record, before: tuple[float, float], after: tuple[float, float]
) -> Record:
    """Return a record less the line through two sections without cut.

    The line goes through the mean time and mean force of both sections: charge
    amplifiers drift by a constant current. Gross errors do not count.

    Args:
        record: The record.
        before: Where the tare section before the cut begins and ends [s].
        after: The same of the one after it.

    Raises:
        ValueError: If fewer than 2 samples lie in a section or both are the same.

    Differentiability: linear in the force; on the host.
    """
    (time_1, level_1), (time_2, level_2) = _mean(record, *before), _mean(record, *after)
    if time_1 == time_2:
        raise ValueError("Arguments `before` and `after` must be two sections.")
    slope = (level_2 - level_1) / (time_2 - time_1)
    drift = level_1[None] + slope[None] * (record.time - time_1)[:, None]
    return _with_force(record, record.force - drift)


def section(record: Record, start: float, stop: float) -> Record:
    """Return the samples of a record from `start` to `stop` [s], both included.

    Raises:
        ValueError: Fewer than two samples are left.
    """
    keep = (record.time >= start) & (record.time <= stop)
    if np.count_nonzero(keep) < 2:
        raise ValueError(
            f"The section {start:g} s to {stop:g} s must hold 2 samples of the record "
            f"({record.time[0]:g} s to {record.time[-1]:g} s), but holds "
            f"{np.count_nonzero(keep)}."
        )
    names = ("time", "force", "is_saturated", "is_after_gap", "tacho", "angle")
    values = {name: getattr(record, name) for name in names}
    kept = {name: None if v is None else v[keep] for name, v in values.items()}
    return dataclasses.replace(record, **kept)


def parts_between_gaps(record: Record, *, longest: float = 0.0) -> list[slice]:
    """Return the samples of a record between its gaps, one slice for each part.

    Args:
        record: The record.
        longest: A gap that lasts no longer parts nothing [s].
    """
    is_apart = record.is_after_gap[1:] & (np.diff(record.time) > longest)
    starts = [0, *np.flatnonzero(is_apart) + 1, record.time.size]
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(starts)]


def _mean(
    record: Record, start: float, stop: float
) -> tuple[float, Float[np.ndarray, " axis"]]:
    """Return mean time and mean force of a section, gross errors left out."""
    part = section(record, start, stop)
    off = np.abs(part.force - np.median(part.force, axis=0)[None])
    # The median deviation is 0.67 standard deviations; none tells of few digits.
    limit = _GROSS / 0.67 * np.median(off, axis=0)
    is_good = (off <= limit[None]) | (limit[None] == 0)
    return float(part.time.mean()), np.mean(part.force, axis=0, where=is_good)


def _with_force(record: Record, force: Float[np.ndarray, "sample 3"]) -> Record:
    return dataclasses.replace(record, force=force)
