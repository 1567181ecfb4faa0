"""Line at the spindle's frequency in the residual: run-out or uneven teeth.

Forces of teeth that are all alike repeat with the teeth and have no such line.
"""

import math

import numpy as np
from jaxtyping import Bool, Complex, Float

from .diagnosis import Diagnosis

# Revolutions of a record at least, and at most of those that are looked at.
_FEWEST, _MOST = 4, 400
# The square of the line over the median square of its neighbours: of noise in three
# forces it is above that once in many thousand records.
_ABOVE = 12.0
# Least amplitude that is told, over the root mean square of the force.
_LEAST = 0.01


def check_spindle_line(
    time: Float[np.ndarray, " row"],
    residual: Float[np.ndarray, "row 3"],
    revolution: float,
    force_rms: float,
) -> tuple[Diagnosis, ...]:
    """Line at the spindle's frequency, if it stands out of the residual.

        c(f) = 2 / n sum_i r(t_i) exp(-2 pi i f t_i)   over whole revolutions

    The line is compared with its neighbours from half to one and a half times the
    spindle's frequency, which lie one whole period of the record apart.

    Args:
        time: Instants [s], shape (row,).
        residual: Measured minus modelled force [N], shape (row, 3); NaN where it does
            not count.
        revolution: Time of a turn of the spindle [s].
        force_rms: Root mean square of the measured force [N].

    Returns:
        A diagnosis "spindle_line", or none.
    """
    is_known = np.isfinite(residual)
    rows = np.flatnonzero(is_known.any(axis=1))
    if rows.size < 2:
        return ()
    first = time[rows[0]]
    step = float(np.median(np.diff(time)))
    turns = min(int((time[rows[-1]] - first + step) / revolution + 1e-6), _MOST)
    if turns < _FEWEST:
        return ()
    part = (time >= first) & (time < first + turns * revolution - 0.5 * step)
    orders = np.arange(math.ceil(turns / 2), turns + turns // 2 + 1)
    c = _amplitudes(
        time[part] - first,
        np.where(is_known, residual, 0.0)[part],
        is_known[part],
        orders / (turns * revolution),
    )
    square = np.sum(np.abs(c) ** 2, axis=1)
    is_line = orders == turns
    line = float(square[is_line][0])
    if line <= _ABOVE * float(np.median(square[~is_line])):
        return ()
    size = np.abs(c[is_line][0])
    if size.max() < _LEAST * force_rms:
        return ()
    values = {"frequency": 1 / revolution}
    values |= {axis: float(a) for axis, a in zip("xyz", size, strict=True)}
    return (Diagnosis("spindle_line", 0, values),)


def _amplitudes(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
    is_known: Bool[np.ndarray, "row 3"],
    frequencies: Float[np.ndarray, " frequency"],
) -> Complex[np.ndarray, "frequency 3"]:
    """Complex amplitudes at some frequencies [N]; 0 where nothing is known.

    Args:
        time: Instants [s], shape (row,).
        force: [N], shape (row, 3); 0 where not known.
        is_known: Which of them are known, shape (row, 3).
        frequencies: [Hz], shape (frequency,).
    """
    count = np.maximum(is_known.sum(axis=0), 1)
    force = (force - force.sum(axis=0)[None] / count[None]) * is_known
    waves = (np.exp(-2j * np.pi * f * time) for f in frequencies)
    return np.stack([2 * (wave @ force) / count for wave in waves])
