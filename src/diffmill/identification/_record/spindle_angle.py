"""The spindle's angle in a record: from a tacho, or from the force itself."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from .record import Record
from .spindle_harmonics import harmonics, series_of_turn


class Alignment(NamedTuple):
    """Alignment of a record with a simulated turn.

    Attributes:
        shift: measured(t) is nearest to simulated(t - shift) [s], 0 <= shift < a turn.
        quality: Correlation of both at that shift, without the mean, -1 to 1.
        runner_up: Correlation at the best other maximum: near `quality` if the teeth
            look alike, so that the turn is known but for a tooth.
    """

    shift: float
    quality: float
    runner_up: float


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

    Differentiability: none.
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


def align(
    record: Record,
    simulated: Float[np.ndarray, "sample 3"],
    spindle_speed: float,
    *,
    harmonic_count: int = 20,
) -> Alignment:
    """Return the time by which a steady cut lags behind its simulation.

    Both are Fourier series over one turn, so that their circular cross-correlation is
    known between samples, too:

        r(s) = 2 Re sum_k sum_axis c_k conj(m_k) exp(i k omega s)

    with the coefficients c of the record and m of the simulation, and no mean. Its
    maximum is looked for on a grid and refined. Axes must agree before.

    Args:
        record: A steady cut of at least one turn; see `find_cuts`.
        simulated: Force over one turn at equal steps, in the record's axes [N], its
            first sample at angle zero, shape (sample, 3).
        spindle_speed: Speed omega [rad/s]; see `refine_spindle_speed`.
        harmonic_count: Number of harmonics of the turn; fewer if rate or simulation
            have fewer.

    Returns:
        The shift and how well both agree there.

    Raises:
        ValueError: If the record is shorter than a turn or either does not vary.

    Differentiability: none.
    """
    nyquist = int(0.45 * record.rate * 2 * np.pi / spindle_speed)
    count = max(1, min(harmonic_count, nyquist, (len(simulated) - 1) // 2))
    seen = np.array(record.is_measured)
    measured = harmonics(record.time, record.force[:, seen], spindle_speed, count)[1:]
    model = series_of_turn(np.asarray(simulated[:, seen], np.float64), count)[1:]
    scale = np.linalg.norm(measured) * np.linalg.norm(model)
    if not scale > 0:
        raise ValueError("Record and simulation must vary over a turn, but one rests.")
    products = np.sum(measured * np.conj(model), axis=1) / scale
    angle, quality, runner_up = best_angle(products)
    return Alignment(angle / spindle_speed, quality, runner_up)


def best_angle(
    products: Complex[np.ndarray, " harmonic"],
) -> tuple[float, float, float]:
    """Return where Re sum_k p_k exp(i k a) is largest, and its two largest maxima."""
    from scipy.optimize import minimize

    order = np.arange(1, products.size + 1)

    def correlation(angle: float) -> float:
        return float(np.real(np.sum(products * np.exp(1j * order * angle))))

    step = 2 * np.pi / (16 * products.size)
    grid = np.arange(16 * products.size) * step
    values = np.real(np.exp(1j * np.outer(grid, order)) @ products)
    is_peak = (values >= np.roll(values, 1)) & (values > np.roll(values, -1))
    peaks = np.flatnonzero(is_peak)
    peaks = peaks[np.argsort(values[peaks])[::-1]][:2]
    found = [
        float(minimum[0])
        for minimum in (
            minimize(lambda angle: -correlation(angle[0]), grid[peak], tol=1e-12).x
            for peak in peaks
        )
    ]
    found.sort(key=correlation, reverse=True)
    runner_up = correlation(found[1]) if len(found) > 1 else -1.0
    return found[0] % (2 * np.pi), correlation(found[0]), runner_up
