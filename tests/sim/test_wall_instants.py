"""The instants at which a wall is made, and what the tool does there."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import slides_job
from references import wall_cut

import diffmill as dm
from diffmill import cutter as ct, process as pr, workpiece as wp
from small_job import write_job

ROWS, SUBSTEPS, FEED = 12, 40, 0.1e-3


def path(degrees):
    """Return a straight path at an angle to work x."""
    way = FEED * np.arange(ROWS)
    angle = math.radians(degrees)
    return np.stack([way * math.cos(angle), way * math.sin(angle), 0 * way - 1e-3], 1)


def looks_at(shares, mill):
    """Return the angles of the teeth at the shares of their periods, (row, tooth)."""
    turn = 2 * math.pi / mill.flute_count * (np.arange(ROWS) - 1 + np.asarray(shares))
    return turn[:, None] + np.asarray(mill.pitch_angles)[None]


@pytest.mark.parametrize("teeth", [2, 3, 4])
@pytest.mark.parametrize("degrees", [0, 33, 90, 215])
def test_a_tooth_looks_to_the_left_of_the_feed(teeth, degrees):
    mill = ct.flat_end_mill(10e-3, teeth)
    shares = pr.wall_shares(jnp.asarray(path(degrees)), None, mill)
    assert (np.asarray(shares) > 0).all() and (np.asarray(shares) <= 1).all()
    # Immersion angles count from +y clockwise: the left of the feed is at -degrees.
    off = looks_at(shares, mill) + math.radians(degrees)
    nearest = np.abs(np.mod(off + math.pi, 2 * math.pi) - math.pi).min(axis=1)
    np.testing.assert_allclose(nearest[1:], 0, atol=1e-5)


@pytest.mark.parametrize("pitch", [(120, 120, 120), (149, 211)])
def test_odd_or_uneven_teeth_look_to_the_side_where_material_stays(pitch):
    mill = ct.flat_end_mill(10e-3, len(pitch), pitch=np.radians(pitch))
    stock = wp.box([-2e-3, -9e-3, -2e-3], [4e-3, -5e-3, 0], 0.25e-3)
    shares = pr.wall_shares(jnp.asarray(path(0)), None, mill, stock)
    off = looks_at(shares, mill) - math.pi
    nearest = np.abs(np.mod(off + math.pi, 2 * math.pi) - math.pi).min(axis=1)
    np.testing.assert_allclose(nearest[1:], 0, atol=1e-5)


def test_a_shaking_tool_is_seen_as_it_stands_when_the_wall_is_made():
    mill = ct.flat_end_mill(10e-3, 2)
    desired = path(33)
    shares = pr.wall_shares(jnp.asarray(desired), None, mill)
    time = np.arange(ROWS)[:, None] - 1 + (np.arange(SUBSTEPS) + 1) / SUBSTEPS
    shake = lambda t: 20e-6 * np.sin(2 * math.pi * 1.7 * t + 0.3)
    along = np.interp(time, np.arange(ROWS), FEED * np.arange(ROWS))
    ends = along[..., None] * (desired[-1] - desired[0]) / (FEED * (ROWS - 1))
    ends = ends + desired[0] + shake(time)[..., None] * np.array([0.0, 1.0, 0.0])
    found = pr.wall_deviation(jnp.asarray(ends), jnp.asarray(desired), shares)
    wanted = shake(np.arange(ROWS) - 1 + np.asarray(shares))
    np.testing.assert_allclose(found[1:, 1], wanted[1:], atol=0.3e-6)
    np.testing.assert_allclose(found[1:, [0, 2]], 0, atol=1e-12)
    # At the tooth instants it stands elsewhere.
    assert np.abs(shake(np.arange(ROWS)) - wanted).max() > 10e-6


def cuts(speed):
    """Return straight cuts along x and y, up and down."""
    return [wall_cut.Cut(feed, up, speed) for feed in "xy" for up in (True, False)]


@pytest.mark.slow
@pytest.mark.parametrize("speed", wall_cut.SPEEDS)
def test_a_shaking_tool_leaves_the_wall_of_theory(speed):
    for cut in cuts(speed):
        made = wall_cut.wall(cut)
        wanted = made.expected.mean()
        assert made.error.mean() == pytest.approx(wanted, rel=0.05)
        # Teeth that pass just before and after cut up to slope^2 / 2 R deeper.
        assert made.deviation == pytest.approx(wanted, rel=0.1)
        assert made.deviation == pytest.approx(wanted, abs=0.04 * made.peak)


@pytest.mark.slow
@pytest.mark.parametrize("speed", wall_cut.NEAR_ZERO)
def test_a_wall_is_right_where_the_vibration_crosses_zero(speed):
    for cut in cuts(speed):
        made = wall_cut.wall(cut)
        wanted = made.expected.mean()
        assert made.error.mean() == pytest.approx(wanted, abs=0.05 * made.peak)
        assert made.deviation == pytest.approx(wanted, abs=0.05 * made.peak)


@pytest.mark.slow
@pytest.mark.parametrize("cut", wall_cut.HELICES, ids=str)
def test_a_helix_leaves_the_profile_of_theory(cut):
    made = wall_cut.wall(cut)
    assert np.ptp(made.expected) > 0.2 * made.peak
    np.testing.assert_allclose(made.error, made.expected, atol=0.05 * made.peak)


TURNED = {
    "cutter.helix_angle": "30 deg",
    "force.K_te": "3.0 N/mm",
    "force.K_re": "15.4 N/mm",
    "stock.spacing": "0.25 mm",
    "program.acceleration": "20 m/s^2",
    "robot": slides_job.ROBOT | {"bending_tool": {"overhang": "40 mm"}},
}
# Two ways to cut 6 mm off a side by up-milling, turned by 90 degrees about z.
WAYS = {
    "x": (["0 mm", "-1 mm", "-3 mm"], ["12 mm", "8 mm", "0 mm"], "X-7", "X9"),
    "y": (["-8 mm", "0 mm", "-3 mm"], ["1 mm", "12 mm", "0 mm"], "Y-7", "Y9"),
}


def turned(folder, way):
    """Return the mean wall error and the mean deviation across the feed [m]."""
    lower, upper, start, stop = WAYS[way]
    (folder / "arm.toml").write_text(
        slides_job.ARM.replace("1.0e6 N/m", "1.0e7 N/m").replace("2 kN", "20 kN")
    )
    program = f"G21 G90 G94\nG0 {start} Z-2\nG1 {stop} F3000\nM2\n"
    stock = {"stock.lower": lower, "stock.upper": upper}
    done = dm.simulate(dm.load_job(write_job(folder, TURNED, stock, program=program)))
    along, across = (0, 1) if way == "x" else (1, 0)
    left = 1.0 if way == "x" else -1.0
    found = wp.SurfaceError.of_stock(done.stock, done.rigid.stock, leaves_out_raw=True)
    is_wall = np.abs(found.normal[:, across]) > 0.99
    is_wall &= np.abs(found.points[:, along] - 2e-3) < 2e-3
    is_row = np.abs(np.asarray(done.desired)[:, along] - 2e-3) < 2e-3
    is_row &= np.asarray(done.is_cutting)
    deviation = left * np.asarray(done.surface_deviation)[is_row, across]
    return found.error[is_wall].mean(), deviation.mean()


@pytest.mark.slow
def test_a_turned_job_with_a_tool_that_bends_leaves_the_same_wall(tmp_path):
    x, y = (turned(tmp_path, way) for way in WAYS)
    assert min(np.abs([*x, *y])) > 5e-6
    np.testing.assert_allclose(y, x, rtol=0.02)
