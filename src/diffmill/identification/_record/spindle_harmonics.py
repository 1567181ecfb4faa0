"""Forces of a steady cut as a Fourier series over one revolution of the spindle."""

import numpy as np
from jaxtyping import Complex, Float

# Rows of the least-squares problem that are held at once.
_BLOCK = 8192


def harmonics(
    time: Float[np.ndarray, " sample"],
    force: Float[np.ndarray, "sample axis"],
    spindle_speed: float,
    count: int,
) -> Complex[np.ndarray, "harmonic axis"]:
    """Fourier coefficients of forces, by least squares.

        force(t) = c_0 + 2 Re sum_k c_k exp(i k omega t),   k = 1 ... count

    Least squares, because a record has gaps and no whole number of samples per turn.

    Args:
        time: Instants [s], in any spacing, shape (sample,).
        force: Forces in any unit, shape (sample, axis).
        spindle_speed: Speed omega [rad/s].
        count: Number of harmonics besides the mean.

    Returns:
        The coefficients c_0 to c_count in the unit of `force`.

    Raises:
        ValueError: If the record is shorter than one turn or has fewer than two
            samples per period of the highest harmonic.
    """
    duration = float(time[-1] - time[0])
    if not spindle_speed > 0 or duration * spindle_speed < 2 * np.pi * (1 - 1e-2):
        raise ValueError(
            f"The record must last one turn of the spindle ({spindle_speed:g} rad/s), "
            f"but lasts {duration:g} s."
        )
    size = 2 * count + 1
    gram, right = np.zeros((size, size)), np.zeros((size, force.shape[1]))
    for start in range(0, time.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        angles = np.outer(time[part] - time[0], spindle_speed * np.arange(count + 1))
        rows = np.concatenate([np.cos(angles), -np.sin(angles[:, 1:])], axis=1)
        gram += rows.T @ rows
        right += rows.T @ force[part]
    if np.linalg.cond(gram) > 1e8:
        raise ValueError(
            f"The record has too few samples for {count} harmonics of the spindle; "
            "take fewer, or a longer part."
        )
    solution = np.linalg.solve(gram, right)
    cosine = solution[: count + 1]
    sine = np.concatenate([np.zeros_like(right[:1]), solution[count + 1 :]])
    out = (cosine + 1j * sine) / np.where(np.arange(count + 1) == 0, 1.0, 2.0)[:, None]
    # The sum above begins at the first sample; the series at time zero.
    turns = np.exp(-1j * spindle_speed * time[0] * np.arange(count + 1))
    return out * turns[:, None]


def refine_spindle_speed(
    time: Float[np.ndarray, " sample"],
    force: Float[np.ndarray, "sample axis"],
    spindle_speed: float,
    *,
    flute_count: int = 1,
) -> float:
    """Speed at which the forces repeat, near a nominal one [rad/s].

    The phase of the strongest multiple of the tooth-passing frequency is compared
    between the two halves of ever longer parts of the record, from eight turns on. A
    nominal speed that is off by less than 5 % of the tooth-passing frequency divided
    by the number of that multiple is found.

    Args:
        time: Instants [s], shape (sample,).
        force: Forces of a steady cut in any unit, shape (sample, axis).
        spindle_speed: Nominal speed [rad/s].
        flute_count: Number of teeth.

    Returns:
        The speed [rad/s]; the nominal one if the record has fewer than eight turns.
    """
    turn = 2 * np.pi / spindle_speed
    omega, length = float(spindle_speed), 8.0
    total = float(time[-1] - time[0]) / turn
    if total < length:
        return omega
    while True:
        length = min(length, total)
        middle, end = np.searchsorted(
            time - time[0], np.array([0.5, 1.0]) * length * turn
        )
        # Multiples of the teeth alone: the turn's own harmonics come from run-out.
        halves = [
            harmonics(time[part], force[part], omega * flute_count, 2)[1:]
            for part in (slice(0, middle), slice(middle, end))
        ]
        products = np.sum(halves[1] * np.conj(halves[0]), axis=1)
        strongest = int(np.argmax(np.abs(products)))
        between = np.mean(time[middle:end]) - np.mean(time[:middle])
        change = np.angle(products[strongest]) / between
        omega += float(change) / (flute_count * (strongest + 1))
        if length >= total:
            return omega
        length *= 2
