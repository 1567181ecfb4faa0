"""What a rigid tool cuts where it turns, comes to rest, or turns back."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, workpiece as wp

R, DEPTH, LENGTH, BLOCK = 5e-3, 0.5e-3, 0.4e-3, 8e-3
# Way per tooth period, and what it gains in one: slow to a stop, as a control does it.
FEED, GAIN = 13e-6, 0.6e-6
REST = 8
SPACING = 0.25e-3


@functools.cache
def remover():
    """Return a program of the stock that a path leaves."""
    low, high = [-BLOCK, -BLOCK, -1e-3], [BLOCK, BLOCK, 0.0]
    stock = wp.box(low, high, SPACING, interval_counts=(6, 6, 3))
    mill = ct.flat_end_mill(2 * R, 2)
    plan = pr.choose_engagement(stock, mill, axial_depth=DEPTH + 0.1e-3)
    process = pr.Process(stock, mill, PAPER_LAW, 1000.0, plan)

    def run(path):
        path, history = wp.Pose(path), process.removal
        within = process.poses_within(path)

        def step(state, row):
            index, pose, middles, ends = row
            state, _ = history.advance(state, index, pose)
            return state.ended(middles, ends), None

        count = path.tip.shape[0]
        rows = jnp.arange(count - 1, dtype=jnp.int32)
        state = process.begin(path[0], count)
        state, _ = jax.lax.scan(step, state, (rows, path[:-1], *within))
        return history.finish(state, rows[-1] + 1, path[-1], count)[0].stock

    return jax.jit(run)


def cut(arrival, departure, rest):
    """Return the stock after a way to a stop at the origin, and another from there."""
    ramp, rise = FEED**2 / (2 * GAIN), FEED / GAIN
    even = (LENGTH - 2 * ramp) / FEED
    time = np.arange(0, 2 * rise + even)
    left = 2 * rise + even - time
    ends = [GAIN * time**2 / 2, LENGTH - GAIN * left**2 / 2]
    way = np.select([time < rise, left < rise], ends, ramp + FEED * (time - rise))
    there, on = (np.outer(x, d) for x, d in ((way - LENGTH, arrival), (way, departure)))
    stop, end = np.zeros((rest, 3)), np.repeat(on[-1:], REST - rest, axis=0)
    path = np.concatenate([there, stop, on, end]) - [0, 0, DEPTH]
    return remover()(jnp.asarray(path))


@pytest.mark.parametrize(("degrees", "rest"), [(90, 0), (-90, REST), (150, 0)])
def test_a_corner_with_a_stop_is_the_swept_shape(degrees, rest):
    turn = math.radians(degrees)
    legs = np.array([[1.0, 0, 0], [math.cos(turn), math.sin(turn), 0]])
    stock = cut(*legs, rest)
    legs[0] *= -1
    for family in (0, 1):
        points = stock.ray_ends(family).points * [1, 1, 0]
        points = points[np.abs(points).max(axis=1) < BLOCK - 1e-6]
        along = np.clip(points @ legs.T, 0, LENGTH)
        away = points[:, None] - along[..., None] * legs[None]
        error = np.linalg.norm(away, axis=-1).min(axis=1) - R
        # Between the legs all stands on the arc that the corner's pose alone cuts.
        assert error.size > 100
        np.testing.assert_allclose(error, 0, atol=1e-6)


@pytest.mark.parametrize("rest", [0, REST])
def test_a_stop_at_the_lowest_place_is_cut_to_the_floor(rest):
    down = np.array([math.sqrt(0.75), 0.0, -0.5])
    stock = cut(down, down * [1, 0, -1], rest)
    middle = round(BLOCK / SPACING)
    column = np.asarray(stock.families[2].ends)[middle, middle, 1]
    assert column.max() == pytest.approx(-DEPTH, abs=1e-6)
