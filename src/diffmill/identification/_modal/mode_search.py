"""Search for the modes of a frequency response, one after the other.

The mode that explains most of what is left is added, then all are refined, and so on
(orthogonal matching pursuit). Noise has as many peaks as lines, but none of them looks
like a mode over many lines; and a damped mode beside a sharp one has no peak at all.
"""

import numpy as np
from jaxtyping import Float

from .mode_model import ModeModel

# Damping ratios of the modes that are tried, as sharp as their neighbours are apart.
_RATIOS = (0.01, 0.03, 0.1)
# Modes that are tried at once.
_BLOCK = 100
# A mode is there if it explains so many times the scatter of a line. The best of a few
# thousand that are not there explains less than 20.
_LEAST_GAIN = 40.0
# What is left is rounding.
_ROUNDING = 1e-12


def search_modes(model: ModeModel, count: int) -> Float[np.ndarray, " both"]:
    """Frequencies and ratios of the modes that explain most.

    Args:
        model: The response.
        count: How many modes are sought.

    Returns:
        Frequencies [Hz], then damping ratios, shape (2 found,): fewer than sought where
        nothing else is left to be seen.
    """
    x = np.zeros(0)
    for _ in range(count):
        added = _next(model, x)
        if added is None:
            break
        frequencies, ratios = np.split(x, 2)
        x = model.refined(np.append(frequencies, added[0]), np.append(ratios, added[1]))
    return x


def _next(
    model: ModeModel, x: Float[np.ndarray, " both"]
) -> tuple[float, float] | None:
    """Frequency [Hz] and damping ratio of the mode that explains most of the residual.

    Args:
        model: The response.
        x: Frequencies and ratios of the modes that were found before.

    Returns:
        The mode, or None if none stands out of the scatter.
    """
    basis = model.basis(x)
    left = model.rows - basis @ (basis.T @ model.rows)
    square = float(left @ left)
    if square <= _ROUNDING * float(model.rows @ model.rows):
        return None
    best, mode = 0.0, None
    for ratio in _RATIOS:
        # Lines that are no nearer than half the width of a mode.
        f = model.omega / (2 * np.pi)
        steps = np.floor(np.log(f / f[0]) / ratio)
        tried = f[np.concatenate([[True], np.diff(steps) > 0])]
        for first in range(0, tried.size, _BLOCK):
            block = tried[first : first + _BLOCK]
            waves = model.waves(block, np.full(block.size, ratio))
            waves /= np.linalg.norm(waves, axis=0)[None]
            own = 1.0 - np.sum((basis.T @ waves) ** 2, axis=0)
            gain = (left @ waves) ** 2 / np.maximum(own, 1e-6)
            j = int(np.argmax(gain))
            if gain[j] > best:
                best, mode = float(gain[j]), (float(block[j]), ratio)
    return mode if best > _LEAST_GAIN * square / left.size else None
