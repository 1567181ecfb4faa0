"""Samples at which an amplifier was at the end of its range."""

import numpy as np
from jaxtyping import Bool, Float

# A smooth maximum, too, may repeat a value; a clipped one is entered or left steeply.
_STEEP = 5.0
# Noise that the converter adds to a clipped signal, as part of the range.
_NOISE = 1e-3
# Share of the samples that may be spikes beyond an end of the range.
_SPIKES = 0.005
# Fewer samples, or a smaller share, are chance where values are not equal.
_FEW, _RARE = 10, 1e-4
# An end of the range that is this part of it from zero is no end: the tool is out.
_ZERO = 0.02


def find_saturated(
    force: Float[np.ndarray, "sample axis"], *, shortest: int = 3
) -> Bool[np.ndarray, "sample axis"]:
    """True where a channel stays at the end of its range.

    The end is the largest or smallest value at which `shortest` or more samples in
    succession are equal, or alike to a thousandth of the range, and beyond which lie
    single spikes at most. Such a run counts if it is entered or left by a jump of at
    least five times as much, and five times the resolution (the smallest difference
    between any two values that are not equal): a smooth maximum that the converter
    repeats is not clipped. With one such run all samples at the end or beyond count. An
    end near zero does not count, and no run during which
    the other channels rest too: there the tool is out of the cut.

    Args:
        force: Samples of each channel in any unit, shape (sample, axis).
        shortest: Number of values from which on a run counts.

    Returns:
        Whether a sample is saturated, shape (sample, axis).
    """
    values = np.asarray(force, dtype=np.float64)
    out = np.zeros(values.shape, dtype=bool)
    steps = np.abs(np.diff(values, axis=0))
    is_alive = steps.max(axis=0, initial=0.0) > 0
    for axis in np.flatnonzero(is_alive):
        others = is_alive & (np.arange(is_alive.size) != axis)
        # One other channel may be a slow one that repeats its values.
        others = others if np.count_nonzero(others) > 1 else np.zeros_like(others)
        is_rest = np.append(others.any() & ~steps[:, others].any(axis=1), False)
        for sign in (1.0, -1.0):
            out[:, axis] |= _at_the_end(sign * values[:, axis], is_rest, shortest)
    return out


def find_measured_saturated(
    force: Float[np.ndarray, "sample axis"],
) -> Bool[np.ndarray, "sample axis"]:
    """True where forces that were not measured all the time are saturated.

    Args:
        force: Samples of each channel [N], NaN where not measured, shape
            (sample, axis).
    """
    known = np.isfinite(force)
    seen = np.flatnonzero(known.any(axis=0))
    rows = np.flatnonzero(known[:, seen].all(axis=1))
    is_end = np.zeros(force.shape, dtype=bool)
    if rows.size > 1:
        is_end[np.ix_(rows, seen)] = find_saturated(force[np.ix_(rows, seen)])
    return is_end


def without_saturated(
    force: Float[np.ndarray, "sample axis"],
    is_saturated: Bool[np.ndarray, "sample axis"],
) -> Float[np.ndarray, "sample axis"]:
    """Forces with NaN in the place of saturated samples and their neighbours.

    Of samples near the end of the range those would remain that noise has made smaller.
    """
    is_lost = is_saturated.copy()
    is_lost[1:] |= is_saturated[:-1]
    is_lost[:-1] |= is_saturated[1:]
    return np.where(is_lost, np.nan, force)


def _at_the_end(
    column: Float[np.ndarray, " sample"],
    is_rest: Bool[np.ndarray, " sample"],
    least: int,
) -> Bool[np.ndarray, " sample"]:
    """True where one channel is at the upper end of its range."""
    out = np.zeros(column.shape, dtype=bool)
    low, high = np.quantile(column, [_SPIKES, 1 - _SPIKES])
    # A channel that moves for less time than spikes do has no other range.
    span = float(high - low) or float(np.ptp(column))
    steps = np.abs(np.diff(column))
    resolution = float(np.diff(np.unique(column)).min())
    for room in (0.0, _NOISE * span):
        flat = [(a, b + 1) for a, b in _runs(steps <= room) if b + 1 - a >= least]
        end = max((float(column[a:b].max()) for a, b in flat), default=0.0)
        if abs(end) < _ZERO * span or np.mean(column > end + room) > _SPIKES:
            continue
        is_end = np.zeros_like(out)
        for start, stop in _runs(np.abs(column - end) <= room):
            jump = steps[max(start - 1, 0) : stop].max(initial=0.0)
            is_steep = jump >= _STEEP * max(room, resolution)
            is_cut = not is_rest[start : stop - 1].all()
            is_end[start:stop] = stop - start >= least and is_steep and is_cut
        # Three values that are nearly equal happen by chance.
        if is_end.any() and (
            room == 0 or np.count_nonzero(is_end) >= max(_FEW, _RARE * is_end.size)
        ):
            # Single samples at an end that is known, too.
            out |= is_end | (column >= end - room)
    return out


def _runs(is_inside: Bool[np.ndarray, " sample"]) -> list[tuple[int, int]]:
    """First index and index after the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_inside.astype(int), [0]])))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
