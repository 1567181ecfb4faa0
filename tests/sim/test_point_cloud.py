import functools
import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, relative
from references import halfspaces, marching

from diffmill import (
    RESULTS,
    cutter as ct,
    process as pr,
    robot as rb,
    sim,
    workpiece as wp,
)
from machines import home_frame, motors_of

R = 5e-3
MILL = ct.flat_end_mill(2 * R, 2)
D = 0.2e-3
LOWER, UPPER = [0, 0, -3e-3], [16e-3, 12e-3, 0]
STOCK = wp.box(LOWER, UPPER, D, interval_counts=(4, 4, 1))
SPEED = 8000 * 2 * math.pi / 60
FEED = 0.1875e-3
STEPS = 110
LAW = marching.LinearLaw(989.8e6, 337.3e6, 66.9e6, 3.0e3, 15.4e3, 4.5e3)


@functools.cache
def compiled(chip: str = "point_cloud", helix_deg=0, keeps=False):
    mill = ct.flat_end_mill(2 * R, 2, math.radians(helix_deg)) if helix_deg else MILL
    return jax.jit(
        lambda positions, stock: sim.simulate_process(
            positions,
            stock,
            mill,
            PAPER_LAW,
            SPEED,
            axial_depth=1.6e-3,
            chip=chip,
            keeps_instantaneous=keeps,
        )
    )


def straight(y, depth=1.0e-3, steps=STEPS):
    x = -6e-3 + FEED * np.arange(steps)
    return np.column_stack([x, np.full(steps, y), np.full(steps, -depth)])


def shifted(shift):
    """Return the block with its rays moved across the feed against its faces."""
    lower = np.array(LOWER) + np.array([0, shift, 0])
    return wp.box(lower, UPPER, D, interval_counts=(4, 4, 1)), lower[1]


def reference(radial_depth, is_up_milling=True, depth=1.0e-3):
    tool = marching.Tool(R, marching.even_teeth(2), 3e-3)
    stock = halfspaces.slot(depth)
    if radial_depth < 2 * R:
        stock = halfspaces.shoulder(depth, radial_depth, R, is_up_milling=is_up_milling)
    return marching.mean_force(
        tool, LAW, stock, np.array([FEED, 0, 0]), np.array([0, 0, 1.0]), elements=60
    )


def error(radial_depth, shift, is_up_milling=True):
    stock, face = shifted(shift)
    if is_up_milling:
        y = face - R + radial_depth
    else:
        y = UPPER[1] + R - radial_depth
    if radial_depth == 2 * R:
        y = 6e-3 + shift
    solution = compiled()(straight(y), stock)
    assert bool(solution.result == RESULTS.successful)
    steady = np.asarray(solution.force)[70:90].mean(axis=0)
    return relative(steady, reference(radial_depth, is_up_milling))


# What the model reaches here, the largest over the shifts: slot 0.06 %, half immersion
# 0.2 % and 0.4 %, a quarter of the diameter 1.8 %. An arc ends at the last ray inside.
@pytest.mark.parametrize(
    ("radial_depth", "is_up_milling", "bound"),
    [(2 * R, True, 0.001), (R, True, 0.003), (R, False, 0.005), (R / 2, True, 0.02)],
)
def test_mean_force_is_that_of_marching(radial_depth, is_up_milling, bound):
    errors = [error(radial_depth, s * D, is_up_milling) for s in (-0.2, 0.0, 0.2)]
    assert max(errors) < bound


@eqx.filter_jit
def compiled_arcs(process, stock, before, tip):
    return process.engagement.chip_arcs(process, stock, before, tip)


def arcs_after(path, stock=STOCK):
    """Return the arcs of the last pose of a path that has cut the stock before."""
    plan = pr.choose_engagement(stock, MILL, axial_depth=1.6e-3, chip="point_cloud")
    cut = compiled("near_far")(path[:-1], stock).stock
    tips = jnp.asarray(path[-2:])
    process = pr.Process(stock, MILL, PAPER_LAW, 837.0, plan)
    return compiled_arcs(process, cut, tips[0], tips[1])


def turned(path, angle):
    middle = np.array([8e-3, 6e-3])
    cos, sin = math.cos(angle), math.sin(angle)
    xy = (path[:, :2] - middle) @ np.array([[cos, sin], [-sin, cos]]) + middle
    return np.column_stack([xy, path[:, 2]])


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2, 2.5, -2.0])
def test_a_slot_is_cut_from_side_to_side_whatever_its_direction(angle):
    x = 6e-3 + FEED * np.arange(12)
    path = np.column_stack([x, np.full(12, 6e-3), np.full(12, -1e-3)])
    block = wp.box([-10e-3, -10e-3, -3e-3], [26e-3, 22e-3, 0], D)
    arcs = arcs_after(turned(path, angle), block)
    np.testing.assert_allclose(
        math.remainder(arcs.heading - (math.pi / 2 - angle), 2 * math.pi), 0, atol=1e-9
    )
    # Rays that meet the rim are at most sqrt(2) spacings of arc apart; before the
    # leading half the circles cross at half a feed.
    cut = np.asarray(arcs.share) > 0
    for found in (-np.asarray(arcs.entry)[cut], np.asarray(arcs.exit)[cut]):
        assert np.all(found > math.pi / 2 - 1.5 * D / R)
        assert np.all(found < math.pi / 2 + 1.01 * FEED / 2 / R)


@pytest.mark.parametrize("radial_depth", [1.03e-3, 2.5e-3, 4.2e-3])
@pytest.mark.parametrize("is_up_milling", [True, False])
def test_the_raw_face_bounds_the_arc(radial_depth, is_up_milling):
    y = -R + radial_depth if is_up_milling else UPPER[1] + R - radial_depth
    arcs = arcs_after(straight(y)[:70])
    width = math.acos(1 - radial_depth / R)
    cut = np.asarray(arcs.share) > 0
    # From the heading: the wall is at -90 degrees in up-milling, at 90 in down-milling.
    face = width - math.pi / 2 if is_up_milling else math.pi / 2 - width
    found = np.asarray(arcs.exit if is_up_milling else arcs.entry)[cut]
    inside = (face - found) * (1 if is_up_milling else -1)
    assert np.all(inside > -1e-9)
    assert np.all(inside < D / (R * math.sin(width)))


@pytest.mark.slow
def test_the_shares_of_the_discs_add_up_to_the_depth():
    for depth in (0.93e-3, 1.0e-3, 1.07e-3, 1.31e-3):
        arcs = arcs_after(straight(6e-3, depth)[:50])
        np.testing.assert_allclose(np.sum(np.asarray(arcs.share)) * D, depth, rtol=1e-9)
        is_cut = np.asarray(arcs.exit) > np.asarray(arcs.entry)
        np.testing.assert_array_equal(is_cut[np.asarray(arcs.share) > 0], True)


@pytest.mark.slow
def test_a_gap_within_an_arc_counts_as_material():
    # A narrow slot lies ahead of a wide one: both sides of it are cut, and a disc has
    # one arc. The paper's limitation; the other model sees the gap.
    x = np.arange(-3e-3, 20e-3, D)
    groove = np.column_stack([x, np.full(x.size, 6e-3), np.full(x.size, -1e-3)])
    thin = ct.flat_end_mill(4e-3, 2)
    stock = sim.simulate_process(
        groove, STOCK, thin, PAPER_LAW, SPEED, axial_depth=1.6e-3
    ).stock
    mean = lambda chip, block: np.asarray(compiled(chip)(straight(6e-3), block).force)[
        70:90
    ].mean(axis=0)
    whole = mean("point_cloud", STOCK)
    assert relative(mean("point_cloud", stock), whole) < 5e-3
    assert relative(mean("near_far", stock), whole) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("y", [6e-3, -2.3e-3])
def test_both_models_leave_the_same_stock_but_for_the_bow_of_a_tooth_mark(y):
    """The cloud takes whole circles; a tooth that moves on as it turns bows by r w."""
    path = straight(y, 1.07e-3, steps=STEPS)
    cloud, circles = (compiled(c)(path, STOCK) for c in ("point_cloud", "near_far"))
    total = [np.sum(s.removed_volume) for s in (cloud, circles)]
    np.testing.assert_allclose(*total, rtol=1e-12)
    np.testing.assert_allclose(
        total[0], STOCK.volume() - cloud.stock.volume(), rtol=1e-12
    )
    ends = [[np.asarray(f.ends) for f in s.stock.families] for s in (cloud, circles)]
    np.testing.assert_array_equal(ends[0][2], ends[1][2])
    # Mark x^2 / (2 R) of a circle; a trochoid's is flatter or steeper by feed over rim.
    mark = FEED**2 / (8 * R) * 2 * (2 * FEED / (2 * math.pi * R))
    apart = [np.abs(found - wanted).max() for found, wanted in zip(*ends, strict=True)]
    assert 0.8 * mark < max(apart) < 1.1 * mark


@pytest.mark.slow
def test_force_within_a_period_follows_the_other_model():
    path = straight(6e-3)
    cloud, circles = (
        np.asarray(compiled(c, keeps=True)(path, STOCK).instantaneous_force)[80]
        for c in ("point_cloud", "near_far")
    )
    # Samples at the ends of the arc count in part or not.
    largest = np.abs(circles).max()
    assert np.quantile(np.abs(cloud - circles), 0.95) < 0.02 * largest


@pytest.mark.slow
def test_a_helix_keeps_the_mean():
    with_helix, without = (
        np.asarray(compiled(helix_deg=angle)(straight(-1e-3), STOCK).force)[70:90]
        for angle in (30, 0)
    )
    with_helix, without = with_helix.mean(axis=0), without.mean(axis=0)
    assert relative(with_helix, without) < 2e-3


def test_in_the_air_and_at_rest_nothing_acts():
    air = straight(6e-3, -0.1e-3)
    np.testing.assert_array_equal(compiled()(air, STOCK).force, 0)
    still = np.tile([8e-3, 6e-3, -1e-3], (STEPS, 1))
    solution = compiled()(still, STOCK)
    np.testing.assert_array_equal(solution.force, 0)
    np.testing.assert_allclose(
        solution.initial_overlap_volume, math.pi * R**2 * 1e-3, rtol=1e-2
    )


@pytest.mark.slow
def test_between_the_jumps_the_derivative_is_exact():
    # No pose stands symmetrically to rays, where two points would share the extreme.
    path = jnp.asarray(straight(-2.513e-3, 1.03e-3))
    path = path + jnp.asarray([[0.0137e-3, 0, 0]])
    rng = np.random.default_rng(5)
    # Sideways and along, in steps that no ray notices.
    directions = jnp.asarray(rng.normal(size=(2, STEPS, 3)) * [1, 1, 0])

    @jax.jit
    def force(s):
        moved = path + s[0] * directions[0] + s[1] * directions[1]
        return compiled()(moved, STOCK).force[70:90]

    zero, step = jnp.zeros(2), 1e-9
    for one in jnp.eye(2):
        slope = jax.jvp(force, (zero,), (one,))[1]
        differences = (force(step * one) - force(-step * one)) / (2 * step)
        largest = float(jnp.abs(slope).max())
        assert largest > 1e3
        np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-5 * largest)


@pytest.mark.slow
@pytest.mark.parametrize("adjoint", [pr.ThroughRays(), pr.ThroughPoses()])
def test_gradients_are_finite_in_the_air_and_in_the_cut(adjoint):
    path = straight(6e-3)
    path[:40, 0] = -6e-3 - 3e-3 * np.arange(40)[::-1]
    path[60:] += [0, 0, 4e-3]

    def total(p):
        solution = sim.simulate_process(
            p,
            STOCK,
            MILL,
            PAPER_LAW,
            SPEED,
            axial_depth=1.6e-3,
            adjoint=adjoint,
            chip="point_cloud",
        )
        return jnp.sum(solution.force**2)

    gradient = jax.jit(jax.grad(total))(jnp.asarray(path))
    assert np.isfinite(gradient).all()
    assert np.abs(gradient[40:60]).max() > 0
    np.testing.assert_array_equal(gradient[64:], 0)


@pytest.mark.slow
def test_no_step_copies_the_stock():
    path = straight(6e-3)
    sizes = {rays.ends.size for rays in STOCK.families}
    copies = {}
    for chip in ("point_cloud", "near_far"):
        text = compiled(chip).lower(path, STOCK).compile().as_text() or ""
        shapes = re.findall(r"= f64\[([\d,]+)\]\S* copy\(", text)
        found = [math.prod(int(n) for n in shape.split(",")) for shape in shapes]
        copies[chip] = sum(size in sizes for size in found)
    # Before the loop, where the caller's stock must stay whole.
    assert copies["point_cloud"] <= copies["near_far"]


@pytest.mark.slow
def test_a_robot_that_cuts_meets_the_force_of_its_own_path():
    # Stiff enough to stay in the cut: an arm that shakes itself out of it meets forces
    # that jump with every ray.
    robot = rb.load("reis_rv130_like")
    robot = eqx.tree_at(
        lambda r: (r.joint_stiffness, r.joint_damping),
        robot,
        (30 * robot.joint_stiffness, 30 * robot.joint_damping),
    )
    frame, tips = home_frame(robot), straight(1e-3)[20:]
    motors = motors_of(robot, tips, frame)
    plan = pr.choose_engagement(STOCK, MILL, axial_depth=1.6e-3, chip="point_cloud")
    process = pr.Process(STOCK, MILL, PAPER_LAW, math.pi / 3.75e-3, plan)
    machine = sim.ElasticArm(robot, frame)
    arm = jax.jit(lambda m: machine.run(process, m))(motors)
    alone = compiled()(np.asarray(arm.actual), STOCK)
    deviation = np.linalg.norm(np.asarray(arm.actual) - tips, axis=1)
    assert deviation.max() > 2e-6
    error = np.linalg.norm(np.asarray(arm.force - alone.force), axis=1)
    largest = np.linalg.norm(np.asarray(alone.force), axis=1).max()
    # A tooth period whose predicted end is off by a micrometre may see another ray.
    assert np.median(error) < 0.01 * largest
    assert relative(arm.force.mean(axis=0), alone.force.mean(axis=0)) < 0.03


def test_other_cutters_and_directions_are_refused():
    path = straight(6e-3)
    for mill, axes in (
        (ct.ball_end_mill(2 * R, 2), None),
        (MILL, np.tile([0.0, 0.6, 0.8], (STEPS, 1))),
    ):
        with pytest.raises(ValueError, match="chip"):
            sim.simulate_process(
                path, STOCK, mill, PAPER_LAW, SPEED, axes, chip="point_cloud"
            )


def test_trouble_is_flagged():
    thin = wp.box(LOWER, UPPER, D, interval_counts=(1, 1, 1))
    assert bool(compiled()(straight(6e-3), thin).result == RESULTS.interval_overflow)
    assert bool(
        compiled()(straight(6e-3, 2.9e-3), STOCK).result == RESULTS.window_overflow
    )
