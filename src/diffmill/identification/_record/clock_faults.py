"""Faults of a record's clock and tooth count, from the phase of the teeth."""

import math

import numpy as np
from jaxtyping import Complex, Float

from .diagnosis import Diagnosis
from .spindle_harmonics import harmonics

# Turns of a window, and windows that a phase needs at least.
_TURNS, _WINDOWS = 2, 8
# Phases [rad] of the tooth passing that a step and a wander must reach, and how far a
# step must stand out from what it leaves.
_STEP, _WANDER, _STANDS_OUT = 0.15, 0.3, 5.0
# A phase that runs away by so much over a record, and the share of the largest product
# of waves below which a window is out of the cut.
_RUNS_AWAY, _CUTTING_SHARE = 0.5, 0.1
# Harmonics of the turn that are looked at, share of the square of all of them that
# belongs to the teeth, and what is too little for those that are given.
_HARMONICS, _OF_TEETH, _TOO_LITTLE = 24, 0.97, 0.8


def check_clock(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row axis"],
    spindle_speed: float,
    flute_count: int,
) -> tuple[Diagnosis, ...]:
    """Faults of the clock by the phase of the tooth passing.

    An even clock and an even spindle keep the phase on a straight line. Where samples
    were lost unseen it steps; a step of whole tooth periods shows nothing and does no
    harm.

    Args:
        time: Instants of a steady cut [s], shape (row,).
        force: Forces in any unit, shape (row, axis), finite.
        spindle_speed: [rad/s], to some percent.
        flute_count: Number of teeth.

    Returns:
        At most one diagnosis.
    """
    omega = spindle_speed * flute_count
    length = _TURNS * 2 * math.pi / spindle_speed
    middle, waves = _windows(time, force, omega, length)
    if middle.size < _WINDOWS:
        return ()
    turns = np.sum(waves[1:] * np.conj(waves[:-1]), axis=1)
    # Each step is nearest to the usual one.
    usual = np.angle(np.median(turns.real) + 1j * np.median(turns.imag))
    steps = np.angle(turns * np.exp(-1j * usual))
    phase = np.concatenate([[0.0], np.cumsum(steps)])
    straight_rms, _ = _line(middle, phase, None)
    places = range(2, middle.size - 3)
    broken = [_line(middle, phase, k) for k in places]
    best = int(np.argmin([rms for rms, _ in broken]))
    rms, step = broken[best]
    if abs(step) > max(_STEP, _STANDS_OUT * rms) and rms < 0.5 * straight_rms:
        values = {"time": float(middle[places[best]]), "shift": step / omega}
        return (Diagnosis("samples_lost", 0, values),)
    if straight_rms > _WANDER:
        values = {"spread": straight_rms / omega}
        return (Diagnosis("clock_wanders", 0, values),)
    return ()


def check_rate(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row axis"],
    predicted: Float[np.ndarray, "row axis"],
    spindle_speed: float,
    flute_count: int,
) -> tuple[Diagnosis, ...]:
    """Diagnosis of teeth that pass at another rate than those of the prediction.

    Rows that are lost here and there of a record without instants make its clock fast:
    the phase of the tooth passing then runs away from that of any prediction, whose
    coefficients shift it, but alike all the time.

    Args:
        time: Instants [s], shape (row,).
        force: Forces, 0 where not measured [N], shape (row, axis).
        predicted: Those of the fit, 0 there too [N], shape (row, axis).
        spindle_speed: [rad/s].
        flute_count: Number of teeth.

    Returns:
        At most one diagnosis.
    """
    omega, length = spindle_speed * flute_count, 2 * math.pi / spindle_speed
    middle, waves = _windows(time, force, omega, length)
    _, others = _windows(time, predicted, omega, length)
    cross = np.sum(waves * np.conj(others), axis=1)
    # Out of the cut there is no phase.
    cuts = np.abs(cross) > _CUTTING_SHARE * np.max(np.abs(cross), initial=0.0)
    middle, cross = middle[cuts], cross[cuts]
    if middle.size < _WINDOWS:
        return ()
    phase = np.unwrap(np.angle(cross))
    slope = float(np.polyfit(middle, phase, 1)[0])
    off = abs(slope) * (middle[-1] - middle[0])
    if off < _RUNS_AWAY or off < _STANDS_OUT * _line(middle, phase, None)[0]:
        return ()
    return (Diagnosis("clock_rate", 0, {"ratio": 1 + slope / omega}),)


def _windows(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row axis"],
    omega: float,
    length: float,
) -> tuple[Float[np.ndarray, " window"], Complex[np.ndarray, "window axis"]]:
    """Waves at a frequency in windows without overlap.

    Returns:
        Middles of the windows [s], shape (window,), and complex amplitudes [N], shape
        (window, axis).
    """
    place = np.floor((time - time[0]) / length).astype(np.int64)
    middles, waves = [], []
    for window in range(int(place[-1])):
        rows = place == window
        if np.count_nonzero(rows) < 8:
            continue
        t, F = time[rows], force[rows] - force[rows].mean(axis=0)
        hann = np.sin(math.pi * ((t - time[0]) / length - window)) ** 2
        wave = np.sum((hann * np.exp(-1j * omega * t))[:, None] * F, axis=0)
        middles.append(time[0] + (window + 0.5) * length)
        waves.append(wave / hann.sum())
    count = force.shape[1]
    return np.array(middles), np.array(waves, np.complex128).reshape(-1, count)


def _line(time: np.ndarray, phase: np.ndarray, at: int | None) -> tuple[float, float]:
    """Residual rms [rad] and step [rad] of a line through a phase.

    Args:
        time: Middles of the windows [s].
        phase: [rad].
        at: Window of the step, or None for a line without one.
    """
    place = np.arange(time.size)
    columns = [np.ones_like(time), time - time.mean()]
    if at is not None:
        # The window in which the phase steps has neither phase.
        columns.append((place > at).astype(float))
    rows = place != at
    A, phase = np.stack(columns, axis=1)[rows], phase[rows]
    x = np.linalg.lstsq(A, phase, rcond=None)[0]
    rms = float(np.sqrt(np.mean((phase - A @ x) ** 2)))
    return rms, float(x[-1]) if at is not None else 0.0


def check_teeth(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row axis"],
    spindle_speed: float,
    flute_count: int,
) -> tuple[Diagnosis, ...]:
    """Diagnosis of forces that repeat another number of times a turn than teeth do.

    Args:
        time: Instants of a steady cut [s], shape (row,).
        force: Forces in any unit, shape (row, axis), finite.
        spindle_speed: As the forces repeat [rad/s].
        flute_count: Number of teeth that is given.

    Returns:
        At most one diagnosis.
    """
    turn = 2 * math.pi / spindle_speed
    step = float(np.median(np.diff(time)))
    count = min(_HARMONICS, int(0.45 * turn / step))
    try:
        waves = harmonics(time, force, spindle_speed, count)[1:]
    except ValueError:
        return ()
    power = np.sum(np.abs(waves) ** 2, axis=1)
    order = np.arange(1, count + 1)
    share = {
        n: float(power[order % n == 0].sum() / max(power.sum(), 1e-300))
        for n in range(1, count // 2 + 1)
    }
    likely = max((n for n, part in share.items() if part > _OF_TEETH), default=1)
    is_other = likely % flute_count == 0 or share.get(flute_count, 1.0) < _TOO_LITTLE
    if likely in (1, flute_count) or not is_other:
        return ()
    values = {"found": float(likely), "given": float(flute_count)}
    return (Diagnosis("tooth_count", 0, values),)
