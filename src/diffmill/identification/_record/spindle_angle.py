"""The spindle's angle in a record, from a tacho."""

import numpy as np
from jaxtyping import Float

from .record import Record


def angle_from_tacho(
    record: Record,
    *,
    pulses_per_turn: int = 1,
    first_angle: float = 0.0,
    smoothing: int = 1,
) -> Float[np.ndarray, " sample"]:
    """Return the spindle's angle from the pulses of a tacho.

    A pulse is where the signal rises through the middle of its range, to a part of a
    sample; it counts again only after falling below 40 % of the range. The angle is
    linear between pulses and goes on at the last speed outside of them. Pulses nearer
    than half the median distance are bounces and left out; a distance of about
    several medians counts as that many pulses.

    Args:
        record: A record with a tacho.
        pulses_per_turn: Number of pulses in a turn.
        first_angle: Angle at the first pulse [rad].
        smoothing: Pulses through whose instants a parabola is laid, around each of
            them: a steep edge is known to a sample only, while a spindle turns evenly.

    Returns:
        The angle at each sample [rad], increasing, shape (sample,).

    Raises:
        ValueError: If the record has no tacho or fewer than two pulses.
    """
    if record.tacho is None:
        raise ValueError("The record must have a tacho channel, but has none.")
    signal, time = record.tacho, record.time
    low, high = float(signal.min()), float(signal.max())
    middle, rearm = 0.5 * (low + high), low + 0.4 * (high - low)
    rises = np.flatnonzero((signal[1:] >= middle) & (signal[:-1] < middle))
    falls = np.flatnonzero(signal < rearm)
    # A rise counts if the signal was below the lower level since the rise before.
    last_fall = np.searchsorted(falls, rises, side="right")
    is_new = np.diff(last_fall, prepend=0) > 0
    rises = rises[is_new]
    part = (middle - signal[rises]) / (signal[rises + 1] - signal[rises])
    pulses = time[rises] + part * (time[rises + 1] - time[rises])
    if pulses.size >= 3:
        typical = float(np.median(np.diff(pulses)))
        pulses = pulses[np.diff(pulses, prepend=-np.inf) > 0.5 * typical]
    if pulses.size < 2:
        raise ValueError(
            f"The tacho must have at least 2 pulses, but has {pulses.size}."
        )
    steps = np.diff(pulses)
    counts = np.maximum(1.0, np.round(steps / np.median(steps)))
    numbers = np.concatenate([[0.0], np.cumsum(counts)])
    if smoothing > 3:
        pulses, numbers = _smoothed(pulses, numbers, smoothing)
    angles = numbers * 2 * np.pi / pulses_per_turn
    speeds = np.diff(angles) / np.diff(pulses)
    inside = np.interp(time, pulses, angles)
    before = np.minimum(time - pulses[0], 0.0) * speeds[0]
    after = np.maximum(time - pulses[-1], 0.0) * speeds[-1]
    return first_angle + inside + before + after


def _smoothed(
    pulses: Float[np.ndarray, " pulse"],
    numbers: Float[np.ndarray, " pulse"],
    width: int,
) -> tuple[Float[np.ndarray, " turn"], Float[np.ndarray, " turn"]]:
    """Return smooth instants of all pulses, lost ones too, and their numbers."""
    from scipy.signal import savgol_filter

    every = np.arange(numbers[-1] + 1)
    instants = np.interp(every, numbers, pulses)
    width = min(width, every.size)
    width -= 1 - width % 2
    if width > 3:
        instants = np.asarray(savgol_filter(instants, width, 2))
    return instants, every
