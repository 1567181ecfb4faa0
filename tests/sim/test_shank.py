"""The shank above the flutes must not take material without being noticed."""

import jax
import numpy as np
import pytest
from helpers import PAPER_LAW

import diffmill.cutter as ct
import diffmill.sim as sim
import diffmill.workpiece as wp

SPEED = 800.0
DEPTH, LENGTH = 3e-3, 12e-3


def deep_slot(flute_length, axes=None):
    """Cut a slot of 3 mm from outside with a tool of 4 mm."""
    mill = ct.flat_end_mill(4e-3, 2, flute_length=flute_length)
    stock = wp.box([0, 0, -5e-3], [20e-3, 10e-3, 0], 0.25e-3, interval_counts=(8, 8, 4))
    path = np.zeros((80, 3))
    path[:, 0] = np.linspace(-3e-3, LENGTH, 80)
    path[:, 1], path[:, 2] = 5.03e-3, -DEPTH
    run = jax.jit(
        lambda p: sim.simulate_process(
            p, stock, mill, PAPER_LAW, SPEED, axes, axial_depth=3.6e-3
        )
    )
    return run(path)


@pytest.mark.slow
@pytest.mark.parametrize("flute_length", [2e-3, 1e-3, 6e-3])
def test_what_the_shank_takes_is_the_slot_above_the_flutes(flute_length):
    solution = deep_slot(flute_length)
    share = max(DEPTH - flute_length, 0) / DEPTH
    taken = float(solution.shank_volume.sum())
    whole = float(solution.removed_volume.sum())
    np.testing.assert_allclose(taken, share * whole, rtol=1e-6, atol=1e-15)


@pytest.mark.slow
def test_only_the_flutes_push():
    short, long = deep_slot(1e-3).force, deep_slot(6e-3).force
    np.testing.assert_allclose(short[50], long[50] / 3, rtol=5e-3)


@pytest.mark.slow
def test_a_leaning_shank_is_seen_too():
    lean = np.radians(20)
    axes = np.tile([0, np.sin(lean), np.cos(lean)], (80, 1))
    assert float(deep_slot(1e-3, axes).shank_volume.sum()) > 0
    assert float(deep_slot(9e-3, axes).shank_volume.sum()) == 0
