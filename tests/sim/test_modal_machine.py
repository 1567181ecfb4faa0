"""A machine of modes: one mode in closed form, convergence, and an arm as its modes."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

import machines
from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp

PERIOD = 2.5e-3
STOCK = wp.box([0, 0, -1e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 2))
MILL = ct.flat_end_mill(10e-3, 2)


def process(substeps):
    engagement = pr.choose_engagement(
        STOCK, MILL, axial_depth=1e-3, angles=12 * substeps, substeps=substeps
    )
    return pr.Process(
        STOCK,
        MILL,
        PAPER_LAW,
        math.pi / PERIOD,
        engagement,
        derivative=pr.FrozenStock(),
    )


def one_mode(frequency=40.0, ratio=0.05, mass=20.0, axis=0, participation=None):
    shapes = np.zeros((1, 3))
    shapes[0, axis] = mass**-0.5
    return rb.TipModes(np.array([frequency]), np.array([ratio]), shapes, participation)


def pushed(modes, force, tips=None, substeps=8, periods=40):
    """Return tips at the ends of sub-steps of a machine under a force(t) in the air."""
    machine, known = sim.ModalMachine(modes), process(substeps)
    tips = jnp.zeros((periods + 1, 3)) if tips is None else jnp.asarray(tips)
    h = PERIOD / substeps
    middles = h * (jnp.arange(substeps, dtype=float) + 0.5)
    rows = machine.rows(known, tips, None)

    def period(state, x):
        start, row = x
        span = machine.dynamics(known, state, row)

        def substep(state, time):
            end = span.step(state, time, force(start + time))
            return end, span.tip(end)

        return jax.lax.scan(substep, state, middles)

    starts = PERIOD * jnp.arange(len(tips) - 1, dtype=float)
    _, found = jax.lax.scan(period, machine.begin(known, tips), (starts, rows))
    found = np.asarray(found).reshape(-1, 3)
    return h * np.arange(1, len(found) + 1), found


def test_a_step_of_force_rings_as_the_closed_form_says():
    f, zeta, m = 40.0, 0.05, 20.0
    t, tips = pushed(one_mode(f, zeta, m), lambda t: jnp.array([100.0, 7.0, 0.0]))
    w = 2 * np.pi * f
    w_d = w * np.sqrt(1 - zeta**2)
    ringing = np.cos(w_d * t) + zeta * w / w_d * np.sin(w_d * t)
    expected = 100.0 / (m * w**2) * (1 - np.exp(-zeta * w * t) * ringing)
    np.testing.assert_allclose(tips[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(tips[:, 1:], 0)


def test_an_oscillating_force_meets_the_receptance_with_second_order():
    modes = rb.TipModes(
        np.array([40.0, 55.0]),
        np.array([0.05, 0.1]),
        np.array([[0.2, 0.1, 0.0], [-0.05, 0.25, 0.1]]),
    )
    hertz, F = 50.0, np.array([100.0, -30.0, 20.0])
    G = np.asarray(modes.receptance(np.array([hertz])))[0]

    def off(substeps):
        force = lambda t: jnp.asarray(F) * jnp.cos(2 * jnp.pi * hertz * t)
        t, tips = pushed(modes, force, substeps=substeps, periods=600)
        phase = np.exp(2j * np.pi * hertz * t)[:, None]
        steady = np.real((G @ F)[None] * phase)
        late = t > 1.2
        return np.abs(tips - steady)[late].max() / np.abs(G @ F).max()

    coarse, fine = off(2), off(4)
    assert fine < 0.01
    assert 3.6 < coarse / fine < 4.4


def test_what_the_machine_carries_swings_when_it_starts():
    # An oscillator on a base that starts to move at once: its own closed form.
    f, zeta, speed, first = 40.0, 0.05, 0.02, 5
    at = PERIOD * np.arange(60)
    tips = np.zeros((60, 3))
    tips[:, 0] = 0.1 + speed * np.maximum(at - at[first], 0)
    none = lambda t: jnp.zeros(3)
    t, found = pushed(one_mode(f, zeta), none, tips, substeps=2)
    commanded = 0.1 + speed * np.maximum(t - at[first], 0)
    w = 2 * np.pi * f
    w_d = w * np.sqrt(1 - zeta**2)
    s = np.maximum(t - at[first], 0)
    expected = -speed / w_d * np.exp(-zeta * w * s) * np.sin(w_d * s)
    np.testing.assert_allclose(found[:, 0] - commanded, expected, atol=1e-14)
    still = one_mode(f, zeta, participation=np.zeros((1, 3)))
    _, found = pushed(still, none, tips, substeps=2)
    np.testing.assert_allclose(found[:, 0], commanded, atol=1e-15)


@functools.cache
def gantry():
    """Return soft slides and a swivel about y, which turns the tool as it yields.

    Dampers are as their springs, so that none couples modes, and nothing has weight.
    """
    K = 80.0 * (2 * np.pi * 30.0) ** 2
    robot = machines.gantry(2e-4 * K, swivel_damping=8.0)
    return eqx.tree_at(lambda r: r.gravity, robot, jnp.zeros(3))


def cut(rows=40):
    """Return tips that enter the block, speed up on the way, and leave it sideways."""
    t = np.linspace(0, 1, rows)
    x = -5.5e-3 + 6e-3 * t**1.5
    y = 1.0e-3 + 2e-3 * t**2
    return np.stack([x, y, np.full(rows, -0.6e-3)], axis=1)


def compare(robot, T_base_work, substeps):
    """Return deviations of an arm and of its modes in the same cut."""
    tips, known = cut(), process(substeps)
    motors = machines.motors_of(robot, tips, T_base_work)
    q = np.asarray(motors[len(tips) // 2])
    arm = sim.ElasticArm(robot=robot, T_base_work=T_base_work)
    ran = jax.jit(lambda m: arm.run(known, m))(motors)
    modes = rb.TipModes.of_robot(robot, q, T_base_work)
    machine = sim.ModalMachine(modes)
    modal = jax.jit(lambda c: machine.run(known, c))(jnp.asarray(tips))
    return np.asarray(ran.actual) - tips, np.asarray(modal.actual) - tips


@pytest.mark.slow
def test_the_modes_of_slides_cut_as_the_slides_do():
    arm, modal = compare(gantry(), np.eye(4), substeps=8)
    assert np.abs(arm).max() > 20e-6
    assert np.abs(modal - arm).max() < 0.01 * np.abs(arm).max()


@pytest.mark.slow
def test_the_modes_of_an_arm_at_one_pose_cut_as_the_arm_does():
    robot = rb.load("reis_rv130_like")
    frame = np.asarray(rb.forward_kinematics(robot, robot.home))
    arm, modal = compare(robot, frame, substeps=8)
    assert np.abs(arm).max() > 20e-6
    assert np.abs(modal - arm).max() < 0.01 * np.abs(arm).max()


def test_the_receptance_of_tip_modes_is_that_of_their_robot():
    robot = gantry()
    hertz = np.array([0.0, 20.0, 30.0, 80.0])
    turned = np.eye(4)
    turned[:3, :3] = rb.rpy_matrix(0.3, -0.2, 0.5)
    R = turned[:3, :3]
    G = np.asarray(rb.receptance(robot, robot.home, hertz))
    found = rb.TipModes.of_robot(robot, robot.home, turned).receptance(hertz)
    np.testing.assert_allclose(found, R.T @ G @ R, atol=1e-9 * np.abs(G).max())


def scaled_modes(log_scale):
    """Return two modes with scaled frequencies, damping ratios and shapes."""
    return rb.TipModes(
        jnp.array([40.0, 55.0]) * jnp.exp(log_scale[0]),
        jnp.array([0.05, 0.08]) * jnp.exp(log_scale[1]),
        jnp.array([[0.1, 0.02, 0.0], [-0.02, 0.12, 0.05]]) * jnp.exp(log_scale[2]),
    )


@pytest.mark.slow
def test_the_deviation_follows_the_modes_as_its_derivative_says():
    tips, known = jnp.asarray(cut(24)), process(4)

    def deviation(log_scale):
        return sim.ModalMachine(scaled_modes(log_scale)).run(known, tips).actual - tips

    deviation = jax.jit(deviation)
    start = jnp.zeros(3)
    slopes = np.asarray(jax.jit(jax.jacfwd(deviation))(start))
    for k in range(3):
        h = 1e-5 * np.eye(3)[k]
        rise = np.asarray(deviation(start + h) - deviation(start - h)) / 2e-5
        size = np.abs(rise).max()
        assert size > 1e-7
        np.testing.assert_allclose(slopes[..., k], rise, atol=2e-3 * size)


@pytest.mark.slow
def test_a_slope_may_be_differentiated_once_more():
    tips, known = jnp.asarray(cut(16)), process(4)
    weights = jnp.asarray(np.random.default_rng(2).normal(size=tips.shape))

    def total(log_scale):
        actual = sim.ModalMachine(scaled_modes(log_scale)).run(known, tips).actual
        return 1e6 * jnp.sum(weights * (actual - tips))

    slope = jax.jit(jax.grad(total))
    start = jnp.zeros(3)
    curvature = np.asarray(jax.jit(jax.hessian(total))(start))
    np.testing.assert_allclose(curvature, curvature.T, rtol=1e-9)
    h = 1e-5
    rises = [slope(start + h * e) - slope(start - h * e) for e in np.eye(3)]
    rise = np.stack(rises) / (2 * h)
    np.testing.assert_allclose(curvature, rise, atol=1e-4 * np.abs(rise).max())
