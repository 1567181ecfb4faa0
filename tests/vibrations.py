"""Vibrations of modes with closed forms; a mode is a frequency, a ratio and a size."""

import numpy as np


def ring_down(time, modes, phases=None):
    """Return a sum of decaying cosines of frequencies [Hz] and damping ratios."""
    phases = np.zeros(len(modes)) if phases is None else phases
    signal = np.zeros_like(time)
    for (frequency, zeta, size), phase in zip(modes, phases, strict=True):
        own = 2 * np.pi * frequency
        wave = np.cos(own * np.sqrt(1 - zeta**2) * time + phase)
        signal += size * np.exp(-zeta * own * time) * wave
    return signal


def receptance(frequency, modes):
    """Return the response [m/N] of modes with a stiffness [N/m] as their size."""
    omega, total = 2 * np.pi * frequency, 0.0
    for place, zeta, stiffness in modes:
        own = 2 * np.pi * place
        below = own**2 - omega**2 + 2j * zeta * own * omega
        total = total + own**2 / stiffness / below
    return total


def with_noise(response, share, seed=0):
    """Return a response with noise of a share of its root mean square per part."""
    draw = np.random.default_rng(seed)
    size = share * np.sqrt(np.mean(np.abs(response) ** 2))
    count = response.size
    return response + size * (draw.normal(size=count) + 1j * draw.normal(size=count))
