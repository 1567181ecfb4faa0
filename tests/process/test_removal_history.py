"""What a rigid tool cuts: corners, stops, and walls of teeth with run-out."""

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


def box(width):
    """Return a block around the origin, as wide across y as given."""
    low, high = [-BLOCK, -width / 2, -1e-3], [BLOCK, width / 2, 0.0]
    return wp.box(low, high, SPACING, interval_counts=(6, 6, 3))


def remover(stock, mill, depth, axis=None):
    """Return a program of the stock that a path of the tip leaves."""
    axes = None if axis is None else np.asarray(axis)[None]
    plan = pr.choose_engagement(
        stock,
        mill,
        axial_depth=depth + 0.1e-3,
        axes=axes,
        is_upright=axes is None,
    )
    process = pr.Process(stock, mill, PAPER_LAW, 1000.0, plan)

    def run(tips):
        path = wp.Pose(tips)
        if axis is not None:
            path = wp.Pose(tips, jnp.broadcast_to(jnp.asarray(axis), tips.shape))
        history, within = process.removal, process.poses_within(path)

        def step(state, row):
            index, pose, middles, ends = row
            state, _ = history.advance(state, index, pose)
            return state.ended(middles, ends), None

        count = tips.shape[0]
        rows = jnp.arange(count - 1, dtype=jnp.int32)
        state = process.begin(path[0], count)
        state, _ = jax.lax.scan(step, state, (rows, path[:-1], *within))
        return history.finish(state, rows[-1] + 1, path[-1], count)[0].stock

    return jax.jit(run)


@functools.cache
def corner_remover():
    return remover(box(2 * BLOCK), ct.flat_end_mill(2 * R, 2), DEPTH)


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
    return corner_remover()(jnp.asarray(path))


@pytest.mark.parametrize(("degrees", "rest"), [(90, 0), (-90, REST), (150, 0)])
def test_a_corner_with_a_stop_is_the_swept_shape(degrees, rest):
    turn = math.radians(degrees)
    legs = np.array([[1.0, 0, 0], [math.cos(turn), math.sin(turn), 0]])
    stock = cut(legs[0], legs[1], rest)
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


def scallops(mill, feed, height):
    """Return by how much a wall stands back, mean and least along the feed [m].

    Tooth k passes the wall where the tool is at k feeds, and cuts an arc of its own
    radius; of all arcs the farthest is the wall.
    """
    lag = height * math.tan(mill.helix_angle) / R
    angle = mill.runout_angle - np.asarray(mill.pitch_angles) + lag
    radius = R + mill.runout * np.cos(angle)
    passed = np.arange(-8 * mill.flute_count, 9 * mill.flute_count)
    # The tooth that comes next stands before the one that has passed.
    radius = radius[-passed % mill.flute_count]
    at = np.linspace(0, mill.flute_count * feed, 400)
    arcs = np.sqrt(radius**2 - (at[:, None] - feed * passed) ** 2).max(axis=1) - R
    return arcs.mean(), arcs.min()


RUNOUT = 15e-6


MILLS = {
    "straight": ct.flat_end_mill(2 * R, 2, runout=RUNOUT),
    "helical": ct.flat_end_mill(
        2 * R, 3, math.radians(45), runout=RUNOUT, runout_angle=1.0
    ),
}


@functools.cache
def slot_remover(name):
    return remover(box(12e-3), MILLS[name], DEPTH)


@pytest.mark.parametrize(
    ("name", "feed"),
    # Of slow teeth fewer poses come in: each stands for the teeth before, too.
    [("straight", 0.15e-3), ("straight", 0.02e-3), ("helical", 0.15e-3)],
)
def test_the_tooth_that_stands_out_most_makes_the_wall(name, feed):
    mill = MILLS[name]
    path = np.outer(np.arange(-40, 41), [feed, 0, 0]) - [0, 0, DEPTH]
    stock = slot_remover(name)(jnp.asarray(path))
    points = stock.ray_ends(1).points
    points = points[(np.abs(points[:, 0]) < 0.6e-3) & (np.abs(points[:, 1]) < 5.9e-3)]
    for z in np.unique(points[:, 2])[[0, -1]]:
        mean, least = scallops(mill, feed, z + DEPTH)
        assert mean > 0.3 * RUNOUT
        for side in (-1, 1):
            wall = points[(points[:, 2] == z) & (side * points[:, 1] > 0), 1]
            stands_back = np.abs(wall) - R
            assert stands_back.mean() == pytest.approx(mean, abs=0.05 * RUNOUT)
            assert stands_back.min() > least - 0.02 * RUNOUT


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 1.0)], ids=["upright", "space"])
def test_run_out_reaches_the_bed_of_a_ball(axis):
    feed, mill = 0.05e-3, ct.ball_end_mill(2 * R, 2, runout=RUNOUT)
    start = np.array([-1.5e-3, 0, -DEPTH])
    path = start + np.outer(np.arange(60), [feed, 0, 0])
    stock = remover(box(8e-3), mill, DEPTH, axis)(jnp.asarray(path))
    points = stock.ray_ends(1).points
    points = points[(np.abs(points[:, 0]) < 0.5e-3) & (np.abs(points[:, 1]) < 3.9e-3)]
    height = points[:, 2] + DEPTH
    stands_back = np.abs(points[:, 1]) - np.sqrt(height * (2 * R - height))
    assert points.shape[0] > 10
    np.testing.assert_allclose(stands_back, RUNOUT, atol=0.05 * RUNOUT)
