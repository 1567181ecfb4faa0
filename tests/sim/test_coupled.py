import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, assert_adjoints_agree, relative

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp
from diffmill.io import parse_gcode
from diffmill.toolpath import sample_program
from machines import home_frame, motors_of, one_mode

MILL = ct.flat_end_mill(10e-3, 2)
PERIOD = 3.75e-3
STOCK = wp.box([0, 0, -2e-3], [14e-3, 12e-3, 0], 0.25e-3, interval_counts=(6, 6, 1))
ROBOT = rb.load("reis_rv130_like")


FRAME = home_frame(ROBOT)
PLAN = pr.choose_engagement(STOCK, MILL, axial_depth=1.5e-3)
ARM = sim.ElasticArm(ROBOT, FRAME)


def process(engagement, derivative, stock=STOCK, mill=MILL, period=PERIOD):
    """Return a process with two teeth."""
    speed = math.pi / period
    return pr.Process(stock, mill, PAPER_LAW, speed, engagement, derivative=derivative)


@functools.cache
def path():
    """Return a cut with a rounded corner, at rest at both ends."""
    program = parse_gcode(
        "G21 G17 G90 G94 F3000\nG0 X-7.5 Y1.3 Z-1.03\nG1 X5.5\nG1 Y5\nM2\n"
    )
    found = sample_program(
        program, PERIOD, acceleration=0.5, rapid_feed=0.1, corner_tolerance=0.1e-3
    )
    return np.asarray(found.positions)


def motors(tips):
    return motors_of(ROBOT, tips, FRAME)


def run(tips, adjoint, stock=STOCK):
    return ARM.run(process(PLAN, adjoint, stock), motors(tips))


@functools.cache
def compiled():
    """Return a run along as many tips as the path has; it refuses to compile twice."""
    traced = lambda tips: run(tips, pr.ThroughPoses())
    return jax.jit(eqx.debug.assert_max_traces(traced, max_traces=1))


@functools.cache
def solution():
    return compiled()(jnp.asarray(path()))


@pytest.mark.slow
def test_the_process_alone_on_the_actual_path_gives_the_same_force():
    alone = sim.simulate_process(
        solution().actual,
        STOCK,
        MILL,
        PAPER_LAW,
        2 * math.pi / (2 * PERIOD),
        engagement=PLAN,
    )
    # Up to the corner; in it the tool nearly stands and shakes within the periods.
    rows = slice(0, 75)
    assert relative(alone.force[rows], solution().force[rows]) < 1.2e-2


def test_the_arm_yields_to_the_force():
    # In the cut the mean deviation is the compliance times the mean force.
    rows = slice(55, 80)
    C = rb.cartesian_compliance(ROBOT, ROBOT.home)[:3, :3]
    F = np.asarray(solution().force)[rows].mean(axis=0)
    deviation = (np.asarray(solution().actual) - path())[rows].mean(axis=0)
    pushed = np.asarray(C) @ F
    cosine = pushed @ deviation / np.linalg.norm(pushed) / np.linalg.norm(deviation)
    assert np.linalg.norm(F) > 40
    assert cosine > 0.8


def test_a_robot_at_rest_in_the_air_stays_where_it_is_told():
    tips = jnp.asarray(np.tile([5e-3, 5e-3, 3e-3], (len(path()), 1)))
    still = compiled()(tips)
    np.testing.assert_allclose(still.actual, tips, atol=1e-9)
    np.testing.assert_array_equal(still.force, 0)


def test_a_robot_moving_from_the_start_does_not_ring():
    # Constant speed from row 0: without the loaded, moving start it would swing.
    tips = np.tile([0.0, 0.0, 10e-3], (len(path()), 1))
    tips[:, 0] += 50e-3 * PERIOD * np.arange(len(tips))
    moving = compiled()(jnp.asarray(tips))
    assert np.abs(np.asarray(moving.actual) - tips).max() < 2e-6


@jax.jit
def in_air(robot, theta):
    """Return the tip along x of a robot that cuts nothing."""
    air = eqx.tree_at(lambda s: s.origin, STOCK, STOCK.origin + 1.0)
    cut = process(PLAN, pr.ThroughPoses(), air)
    return sim.ElasticArm(robot, np.eye(4)).run(cut, theta).actual[:, 0]


AIR_ROWS = 320


@pytest.mark.parametrize("frequency", [10.0, 40.0])
def test_a_mode_keeps_its_frequency_and_damping(frequency):
    # The midpoint rule lowers a frequency by (omega h)^2 / 12 and adds no damping.
    count = round(12 / frequency / PERIOD)
    theta = np.full((AIR_ROWS, 1), 1e-3)
    theta[0] = 0.0
    x = np.asarray(in_air(one_mode(frequency, 0.02), theta))[:count] - 1e-3
    # Fit a decaying oscillation by linear prediction, exact for one mode.
    x = x[2:]
    (a, b), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    pole = np.log(np.roots([1, -a, -b])[0]) / PERIOD
    found = abs(pole) / (2 * math.pi), -pole.real / abs(pole)
    np.testing.assert_allclose(found[0], frequency, rtol=5e-3)
    np.testing.assert_allclose(found[1], 0.02, rtol=5e-2)


def test_an_arm_that_starts_from_rest_starts_at_rest():
    # Under a constant acceleration the arm lags by a (1 - cos(omega t)) / omega^2.
    omega, acceleration = 2 * math.pi * 10.0, 2.0
    t = PERIOD * np.arange(AIR_ROWS)
    theta = 0.5 * acceleration * t[:, None] ** 2
    lag = theta[:, 0] - np.asarray(in_air(one_mode(10.0, 0.0), theta))
    expected = acceleration / omega**2 * (1 - np.cos(omega * t))
    # Up to 1 mm; the mean speed of the first period would add 60 um.
    np.testing.assert_allclose(lag[:30], expected[:30], atol=6e-6)


def test_gradient_along_a_smooth_direction_matches_differences():
    t = np.linspace(0, 1, len(path()))[:, None]
    rng = np.random.default_rng(5)
    direction = jnp.asarray(
        sum(np.sin(math.pi * k * t) * rng.normal(size=3) for k in range(1, 5))
    )
    weights = jnp.asarray(rng.normal(size=path().shape))

    def total(p):
        return jnp.sum(weights * run(p, pr.ThroughPoses()).actual)

    value = lambda tips: jnp.sum(weights * compiled()(tips).actual)
    tips = jnp.asarray(path())
    slope = float(jnp.sum(jax.jit(jax.grad(total))(tips) * direction))
    # Kinks are some 1e-9 m apart.
    step = 5e-10
    difference = float(value(tips + step * direction) - value(tips - step * direction))
    np.testing.assert_allclose(slope, difference / (2 * step), rtol=1e-4)


@pytest.mark.slow
def test_all_adjoints_give_the_same_coupled_gradient():
    weights = jnp.asarray(np.random.default_rng(6).normal(size=path().shape))
    stock = wp.box([0, 0, -2e-3], [14e-3, 12e-3, 0], 0.25e-3, interval_counts=(6, 6, 1))

    def gradient(adjoint):
        total = lambda p: jnp.sum(weights * run(p, adjoint, stock).actual)
        return jax.jit(jax.grad(total))(jnp.asarray(path()))

    assert_adjoints_agree(gradient, rtol=1e-7)


# Cutters and poses besides the flat one that stands upright.
OTHERS = ("ball", "leaning", "uneven")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flat", *OTHERS])
def test_forward_and_reverse_mode_are_one_derivative(kind):
    mill = MILL
    if kind in ("ball", "leaning"):
        mill = ct.ball_end_mill(10e-3, 2)
    if kind == "uneven":
        mill = ct.flat_end_mill(10e-3, 2, pitch=(3.0, 2 * math.pi - 3.0))
    plan = pr.choose_engagement(
        STOCK, mill, axial_depth=1.5e-3, is_upright=kind != "leaning", plunges=True
    )
    rng = np.random.default_rng(7)
    theta = jax.jit(motors)(jnp.asarray(path()))
    along = jnp.asarray(rng.normal(size=theta.shape))
    weights = jnp.asarray(rng.normal(size=path().shape))

    cut = process(plan, pr.ThroughPoses(), mill=mill)

    @jax.jit
    def both(theta, along, weights):
        _, push = jax.linearize(lambda x: ARM.run(cut, x).actual, theta)
        return push(along), jax.linear_transpose(push, theta)(weights)[0]

    pushed, pulled = both(theta, along, weights)
    np.testing.assert_allclose(
        jnp.sum(pulled * along), jnp.sum(weights * pushed), rtol=1e-9
    )


def test_new_numbers_do_not_compile_again():
    shifted = compiled()(jnp.asarray(path() + 1e-5))
    assert np.any(shifted.actual != solution().actual)


@pytest.mark.slow
def test_a_long_period_looks_up_the_stock_on_its_way():
    """At 1500 rpm the arm swings once in a tooth period, and chips change with it."""
    period = 20e-3
    program = parse_gcode("G21 G17 G90 G94 F300\nG0 X-5.9 Y-3.5 Z-1.5\nG1 X-0.5\nM2\n")
    path = sample_program(
        program, period, acceleration=0.05, rapid_feed=0.1, corner_tolerance=0.1e-3
    )
    tips = jnp.asarray(path.positions)
    stock = wp.box(
        [-5.5e-3, 0, -4e-3], [4e-3, 8e-3, 0], 0.25e-3, interval_counts=(6, 6, 1)
    )

    def force(updates_per_period):
        plan = pr.choose_engagement(
            stock,
            MILL,
            axial_depth=3.5e-3,
            substeps=40,
            updates_per_period=updates_per_period,
        )
        cut = process(plan, pr.ThroughPoses(), stock, period=period)
        return jax.jit(lambda p: ARM.run(cut, motors(p)).force)

    rows = slice(tips.shape[0] // 4, -8)
    one, ten, twenty = (np.asarray(force(n)(tips))[rows] for n in (1, 10, 20))
    off = lambda F: np.sqrt(np.sum((F - twenty) ** 2) / np.sum(twenty**2))
    assert off(ten) < 0.03 and off(one) > 0.1
    # Derivatives go through each look.
    push = jnp.sin(jnp.linspace(0, 3, tips.shape[0]))[:, None] * jnp.array(
        [[0, 1.0, 0]]
    )
    run, h = force(10), 1e-9
    slope = np.asarray(jax.jvp(run, (tips,), (push,))[1])
    sides = [np.asarray(run(tips + s * h * push)) for s in (1, -1)]
    wanted = (sides[0] - sides[1]) / (2 * h)
    assert np.abs(slope - wanted).max() < 1e-3 * np.abs(wanted).max()


@pytest.mark.parametrize(("substeps", "looks"), [(8, 3), (4, 3), (4, 4)])
def test_looks_that_do_not_divide_a_period_or_are_single_are_refused(substeps, looks):
    with pytest.raises(ValueError, match="updates_per_period"):
        pr.choose_engagement(
            STOCK, MILL, axial_depth=1e-3, substeps=substeps, updates_per_period=looks
        )
