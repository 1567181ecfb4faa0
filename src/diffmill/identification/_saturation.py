"""Samples at which an amplifier was at the end of its range."""

import numpy as np
from jaxtyping import Bool, Float

# A smooth maximum, too, may repeat a value; a clipped one is entered or left steeply.
_STEEP = 5.0


def find_saturated(
    force: Float[np.ndarray, "sample axis"], *, shortest: int = 3
) -> Bool[np.ndarray, "sample axis"]:
    """Return where a channel stays at its largest or smallest value.

    A run of `shortest` or more equal values at the extreme of the whole record counts
    if it is entered or left by a jump of at least five times the resolution, which is
    the smallest difference between any two values that are not equal: a smooth maximum
    that the converter repeats is not clipped.

    Args:
        force: Samples of each channel in any unit, shape (sample, axis).
        shortest: Number of equal values from which on a run counts.

    Returns:
        Whether a sample is saturated, shape (sample, axis).

    Differentiability: none.
    """
    values = np.asarray(force, dtype=np.float64)
    out = np.zeros(values.shape, dtype=bool)
    for axis in range(values.shape[1]):
        column = values[:, axis]
        steps = np.abs(np.diff(column))
        levels = np.unique(column)
        if levels.size < 2:
            continue
        resolution = np.diff(levels).min()
        for extreme in (column.max(), column.min()):
            for start, stop in _runs(column == extreme):
                edges = steps[max(start - 1, 0) : stop]
                is_steep = edges.max(initial=0.0) >= _STEEP * resolution
                out[start:stop, axis] |= stop - start >= shortest and is_steep
    return out


def _runs(is_inside: Bool[np.ndarray, " sample"]) -> list[tuple[int, int]]:
    """Return first index and index after the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_inside.astype(int), [0]])))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
