"""An input shaper against a mode in closed form."""

import math

import numpy as np
import pytest
from scipy import signal

from diffmill import correction as co

PERIOD, FREQUENCY = 1e-3, 10.0


def ringing(path, ratio):
    """Return the amplitude [m] at which a mode rings after its base has moved."""
    omega = 2 * math.pi * FREQUENCY / math.sqrt(1 - ratio**2)
    A = np.array([[0.0, 1.0], [-(omega**2), -2 * ratio * omega]])
    mode = signal.StateSpace(A, [[0.0], [1.0]], [[omega**2, 2 * ratio * omega]], 0.0)
    time = PERIOD * np.arange(len(path))
    _, tip, _ = signal.lsim(mode, path, time)
    rest = slice(round(0.5 / PERIOD), round(0.6 / PERIOD))
    return np.ptp(tip[rest]) / 2


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.3])
def test_a_mode_is_left_at_rest(ratio):
    way = np.clip((np.arange(1000) * PERIOD - 0.2) / 0.23, 0, 1) * 10e-3
    path = np.stack([way, 0 * way, -way], axis=1)
    found = co.shaped(path, PERIOD, frequency=FREQUENCY, damping_ratio=ratio)
    assert ringing(path[:, 0], ratio) > 0.1e-3
    assert ringing(found[:, 0], ratio) < 0.01 * ringing(path[:, 0], ratio)
    np.testing.assert_allclose(found[[0, -1]], path[[0, -1]], atol=1e-15)


def test_a_straight_line_is_not_delayed_and_a_circle_shrinks():
    line = np.outer(np.arange(1000) * PERIOD, [0.05, 0.0, 0.0])
    found = co.shaped(line, PERIOD, frequency=FREQUENCY, damping_ratio=0.1)
    np.testing.assert_allclose(found[100:-100], line[100:-100], atol=1e-12)
    r, v = 5e-3, 0.03
    turn = v / r * np.arange(1000) * PERIOD
    circle = r * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    found = co.shaped(circle, PERIOD, frequency=FREQUENCY, damping_ratio=0.0)
    off = r - np.linalg.norm(found[100:-100], axis=1)
    np.testing.assert_allclose(off, (v / FREQUENCY) ** 2 / (32 * r), rtol=0.01)
