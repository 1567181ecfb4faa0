"""Detection of cuts in a record."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .record import Record

# Cutting must be this many times as loud as the rest to be told from it.
_LOUDER = 4.0
# Windows in a stretch that tells the level of a section shorter than a twentieth: the
# median of fewer would be at the mercy of chance where nothing but noise is recorded.
_STRETCH = 9


class CutSpan(NamedTuple):
    """A part of a record in which the tool cuts.

    Attributes:
        start: First instant [s].
        stop: Last instant [s].
    """

    start: float
    stop: float

    @staticmethod
    def find(
        record: Record,
        *,
        tooth_frequency: float | None = None,
        window: float | None = None,
        shortest: float | None = None,
    ) -> "list[CutSpan]":
        """Cuts in a record, in their order.

        The force's variation within a moving window is compared with its level in the
        quietest and the loudest twentieth of the record; if these are alike, in its
        quietest and its loudest stretch of nine windows. On a logarithmic scale a cut
        begins above the middle between them and ends below a quarter; its ends are then
        drawn in, by a window at most, to where the window is half full of the cut.
        Offset and slow drift do not matter. A pause or a gap shorter than the window
        does not end a cut, a longer one does.

        Args:
            record: The record.
            tooth_frequency: Tooth-passing frequency [Hz]; with it, the variation at
                this frequency alone is used, so that a spindle that idles is quiet.
            window: Length of the window [s]; by default four tooth periods, else 20 ms.
            shortest: Shortest cut [s]; by default twice the window.

        Returns:
            The cuts; their ends are found to a part of the window. If loud and quiet
            differ by less than a factor of four, the parts between such gaps: there is
            no tare section in the record, or no cut.
        """
        if window is None:
            window = 4.0 / tooth_frequency if tooth_frequency else 0.02
        shortest = 2.0 * window if shortest is None else shortest
        width = max(3, round(window * record.rate))
        parts = record.parts_between_gaps(longest=window)
        loud = [_loudness(record, part, width, tooth_frequency) for part in parts]
        quiet_level, loud_level = _levels(loud, width)
        # A channel that rests exactly at zero has no logarithm.
        quiet_level = max(quiet_level, 1e-6 * loud_level)
        if loud_level < _LOUDER * quiet_level or loud_level == 0:
            return [
                CutSpan(float(record.time[p.start]), float(record.time[p.stop - 1]))
                for p in parts
            ]
        begin = float(np.sqrt(quiet_level * loud_level))
        end = float(np.sqrt(quiet_level * begin))
        cuts: list[CutSpan] = []
        for part, level in zip(parts, loud, strict=True):
            time = record.time[part]
            # Half the window in the cut: half the amplitude, or half the variance.
            full = 0.5 if tooth_frequency is not None else np.sqrt(0.5)
            for run in _hysteresis(level, begin, end, width):
                first, last = _drawn_in(level, *run, width, float(full))
                if time[last] - time[first] >= shortest:
                    cuts.append(CutSpan(float(time[first]), float(time[last])))
        return cuts


def _levels(
    loud: list[Float[np.ndarray, " sample"]], width: int
) -> tuple[float, float]:
    """Levels of the record where it is quiet and where it is loud [N]."""
    from scipy.ndimage import median_filter

    quiet, high = np.quantile(np.concatenate(loud), [0.05, 0.95]).tolist()
    if high >= _LOUDER * quiet:
        return quiet, high
    # Half a window apart; the median passes over spikes and dropouts. Whole stretches
    # only: beyond the ends there is nothing.
    steady = [
        median_filter(part[:: width // 2], 2 * _STRETCH + 1)[_STRETCH:-_STRETCH]
        for part in loud
        if part.size > _STRETCH * width
    ]
    if not steady:
        return quiet, high
    everything = np.concatenate(steady)
    return float(everything.min()), float(everything.max())


def _loudness(
    record: Record, part: slice, width: int, tooth_frequency: float | None
) -> Float[np.ndarray, " sample"]:
    """Variation of the force in a moving window [N], all axes together."""
    from scipy.ndimage import uniform_filter1d

    force = record.force[part] - record.force[part].mean(axis=0)[None]
    width = min(width, force.shape[0])

    def smooth(values: np.ndarray) -> np.ndarray:
        return uniform_filter1d(values, width, axis=0, mode="nearest")

    if tooth_frequency is not None:
        turns = 2 * np.pi * tooth_frequency * record.time[part][:, None]
        quiet = force - smooth(force)
        sine, cosine = smooth(quiet * np.sin(turns)), smooth(quiet * np.cos(turns))
        return np.sqrt(2 * (sine**2 + cosine**2).sum(axis=1))
    variance = smooth(force**2) - smooth(force) ** 2
    return np.sqrt(np.maximum(variance, 0.0).sum(axis=1))


def _hysteresis(
    level: Float[np.ndarray, " sample"], begin: float, end: float, width: int
) -> list[tuple[int, int]]:
    """Runs above `end` that reach `begin`, short pauses between them closed."""
    is_above = np.concatenate([[0], (level > end).astype(int), [0]])
    edges = np.flatnonzero(np.diff(is_above)).reshape(-1, 2)
    runs: list[tuple[int, int]] = []
    for first, stop in edges.tolist():
        if level[first:stop].max() < begin:
            continue
        if runs and first - runs[-1][1] < width:
            runs[-1] = (runs[-1][0], stop - 1)
        else:
            runs.append((first, stop - 1))
    return runs


def _drawn_in(
    level: Float[np.ndarray, " sample"], first: int, last: int, width: int, full: float
) -> tuple[int, int]:
    """Ends of a run where it reaches a share of its usual level."""
    inside = level[first : last + 1]
    reached = np.flatnonzero(inside >= full * np.median(inside))
    begin = 0 if first == 0 else min(int(reached[0]), width)
    end = inside.size - 1 - int(reached[-1])
    end = 0 if last == level.size - 1 else min(end, width)
    return first + begin, last - end
