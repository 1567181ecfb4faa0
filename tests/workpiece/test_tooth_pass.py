"""What a tooth takes as it goes around with a tool that shakes, in closed form."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import cutter as ct, workpiece as wp

R, D, TEETH, SUBSTEPS = 4e-3, 0.25e-3, 2, 64
SHAKE, FEED = 60e-6, 0.1e-3
STOCK = wp.box([-6e-3, -6e-3, -3e-3], [6e-3, 6e-3, 0], D, interval_counts=(4, 4, 4))


def tip(time):
    """Return where the tool stands at times in tooth periods [m], shape (..., 3)."""
    return np.stack(
        [
            FEED * (time - 2),
            SHAKE * np.sin(2 * math.pi * 0.7 * time + 0.4),
            -2e-3 + 0.5 * SHAKE * np.cos(2 * math.pi * 0.7 * time),
        ],
        axis=-1,
    )


@pytest.fixture(scope="module", params=[0.0, math.radians(40)])
def cut(request):
    """Return cutter and stock after one tooth has gone around, forward at time 2.5."""
    mill = ct.flat_end_mill(2 * R, TEETH, request.param)
    window = wp.RemovalWindow.upright(STOCK, mill, 2.3e-3, D)
    time = np.arange(5 * SUBSTEPS + 1) / SUBSTEPS
    # Feed along x: the tooth points along it, phi = pi / 2, in the middle of a period.
    tooth = wp.ToothPass(
        nodes=wp.Pose(jnp.asarray(tip(time))),
        first=jnp.zeros((), jnp.int32),
        feed_direction=jnp.array([1.0, 0.0]),
        passing_node=jnp.asarray(2.5 * SUBSTEPS),
        last=jnp.asarray(5.0 * SUBSTEPS),
        substeps=SUBSTEPS,
    )
    remove = jax.jit(
        lambda stock: window.remove_passes(stock, mill, [tooth], jnp.ones(1, bool))
    )
    return mill, remove(STOCK)


def looks_at(mill, x, y, height):
    """Return when the tooth looks along a place from the tip, in tooth periods."""
    turn = np.arctan2(x, y) - math.pi / 2
    turn = np.mod(turn + math.pi, 2 * math.pi) - math.pi
    turn = turn + height * math.tan(mill.helix_angle) / R
    return 2.5 + turn * TEETH / (2 * math.pi)


def cut_ends(stock, family):
    """Ends that the tooth made, and the times that they remember."""
    ends = stock.ray_ends(family)
    return ends.points[ends.is_cut], ends.poses[ends.is_cut] / wp.Rays.TICKS


@pytest.mark.parametrize("family", [0, 1])
def test_a_wall_point_lies_on_the_tool_as_it_stood_when_the_tooth_looked_at_it(
    cut, family
):
    mill, done = cut
    points, _ = cut_ends(done.stock, family)
    assert len(points) > 100
    time = np.full(len(points), 2.5)
    for _ in range(40):
        away = points - tip(time)
        time = looks_at(mill, away[:, 0], away[:, 1], away[:, 2])
    away = points - tip(np.clip(time, 0, 5))
    off = np.hypot(away[:, 0], away[:, 1]) - R
    # A circle at one pose would be off by the whole shake.
    np.testing.assert_allclose(off, 0, atol=0.01 * SHAKE)


def test_a_floor_point_has_the_height_of_the_tooth_that_passed_it(cut):
    mill, done = cut
    points, _ = cut_ends(done.stock, 2)
    assert len(points) > 500
    middle = tip(np.array(2.5))
    time = looks_at(mill, points[:, 0] - middle[0], points[:, 1] - middle[1], 0)
    is_sure = np.abs(time - 2.5) < 0.95
    height = tip(time[is_sure])[:, 2]
    np.testing.assert_allclose(points[is_sure, 2], height, atol=0.06 * SHAKE)


def test_ends_remember_when_they_were_cut(cut):
    mill, done = cut
    for family in (0, 1):
        points, time = cut_ends(done.stock, family)
        away = points - tip(time)
        wanted = looks_at(mill, away[:, 0], away[:, 1], away[:, 2])
        is_sure = np.abs(wanted - 2.5) < 0.95
        # Least sure where a ray grazes the wall.
        np.testing.assert_allclose(time[is_sure], wanted[is_sure], atol=5e-3)
        track = wp.PoseTrack(
            wp.Pose(jnp.asarray(tip(np.arange(5 * SUBSTEPS + 1) / SUBSTEPS))), SUBSTEPS
        )
        found = track.cut_by(jnp.round(time * wp.Rays.TICKS).astype(jnp.int32)).tip
        np.testing.assert_allclose(found, tip(time), atol=1e-3 * SHAKE)


def test_a_pass_that_begins_between_two_ticks_begins_with_its_first_pose():
    mill, steps = ct.flat_end_mill(2 * R, TEETH), 300
    # Later the tool stands deeper; what the tooth looked at before is cut as it begins.
    heights = np.append(np.full(10, -1e-3), -2.9e-3)
    tips = np.stack([np.zeros(11), np.zeros(11), heights], axis=-1)
    tooth = wp.ToothPass(
        nodes=wp.Pose(jnp.asarray(tips)),
        # Half a tick behind node 0, which is more than half a part of a step.
        first=jnp.asarray(3, jnp.int32),
        feed_direction=jnp.array([1.0, 0.0]),
        passing_node=jnp.zeros(()),
        last=jnp.asarray(10.0),
        substeps=steps,
    )
    window = wp.RemovalWindow.upright(STOCK, mill, 3e-3, D)
    done = window.remove_passes(STOCK, mill, [tooth], jnp.ones(1, bool))
    points, _ = cut_ends(done.stock, 2)
    before = points[:, 1] > D
    assert before.sum() > 100
    np.testing.assert_allclose(points[before, 2], -1e-3)
    assert points[:, 2].min() < -2.8e-3
