"""What the integrators do to an arm that swings freely."""

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp
from machines import one_mode, planar_arm

PERIOD, SUBSTEPS = 3.75e-3, 8
STEP = PERIOD / SUBSTEPS
REFERENCE = sim.RungeKutta4()


@functools.cache
def swing(rule, count, held=1):
    """Return where the planar arm is 0.3 s after a wide deflection."""
    start = sim.ArmState(jnp.array([0.9, -0.4]), jnp.array([1.0, -2.0]))
    theta = jnp.array([0.3, 0.2])
    run = jax.jit(
        lambda h: sim.free_motion(
            planar_arm(), start, theta, h, count // held, rule, held=held
        )
    )
    motion = run(0.3 / count)
    return np.concatenate([motion.joint_positions[-1], motion.joint_velocities[-1]])


@pytest.mark.parametrize(
    ("rule", "held", "order"),
    [(sim.Midpoint(), 1, 2), (sim.Midpoint(), SUBSTEPS, 2), (REFERENCE, 1, 4)],
)
def test_order_of_convergence_on_a_swinging_arm(rule, held, order):
    # The two rules have only the equations of motion in common. Held terms keep the
    # order because they are those of the middle of what they are held for.
    exact = swing(REFERENCE, 3000)
    steps = 400 if held == 1 else 800 * held
    coarse, fine = (
        np.linalg.norm(swing(rule, n, held) - exact) for n in (steps, 2 * steps)
    )
    assert coarse < 0.01
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.1)


def test_one_mode_at_the_default_substeps():
    motion = sim.free_motion(
        one_mode(), sim.ArmState(jnp.array([1e-3]), jnp.zeros(1)), jnp.zeros(1), STEP,
        3000,
    )  # fmt: skip
    x = np.asarray(motion.joint_positions)[:, 0]
    (a, b), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    pole = np.log(np.roots([1, -a, -b])[0]) / STEP
    frequency, ratio = abs(pole) / (2 * math.pi), -pole.real / abs(pole)
    # The midpoint rule lowers a frequency by (omega h)^2 / 12 and adds no damping.
    shift = (2 * math.pi * 10 * STEP) ** 2 / 12
    np.testing.assert_allclose(1 - frequency / 10, shift, rtol=2e-2)
    np.testing.assert_allclose(ratio, 0.02, rtol=3e-4)


@pytest.mark.parametrize("held", [1, SUBSTEPS])
def test_energy_of_the_undamped_arm_over_ten_seconds(held):
    arm = rb.load("reis_rv130_like").with_drives(damping=np.zeros(6))
    theta = rb.motor_positions(arm, arm.home)
    rows = round(10 / STEP) // held
    start = sim.ArmState(arm.home + 1e-3, jnp.zeros(6))
    motion = jax.jit(lambda s: sim.free_motion(arm, s, theta, STEP, rows, held=held))(
        start
    )
    energy = np.asarray(
        jax.vmap(lambda q, v: rb.mechanical_energy(arm, q, v, theta))(
            motion.joint_positions, motion.joint_velocities
        )
    )
    at_rest = float(rb.mechanical_energy(arm, arm.home, np.zeros(6), theta))
    swinging = energy - at_rest
    drift = np.abs(swinging / swinging[0] - 1).max()
    assert motion.time[-1] == pytest.approx(10, rel=1e-3)
    assert drift < (1e-4 if held == 1 else 1e-3)


@pytest.mark.slow
def test_the_explicit_rule_in_the_coupled_step():
    robot, frequency, ratio = one_mode(), 10.0, 0.02
    stock = wp.box([1, 1, 1], [1.005, 1.005, 1.005], 1e-3)
    mill = ct.flat_end_mill(10e-3, 2)
    plan = pr.choose_engagement(stock, mill, axial_depth=1e-3)
    theta = np.full((60, 1), 1e-3)
    theta[0] = 0.0
    process = pr.Process(stock, mill, PAPER_LAW, math.pi / PERIOD, plan)
    arm = sim.ElasticArm(robot, np.eye(4), sim.RungeKutta4())
    found = jax.jit(lambda theta: arm.run(process, theta).actual[:, 0])(
        jnp.asarray(theta)
    )
    # From rest at 1e-3 the error decays; row 1 gives the phase and the amplitude.
    omega = 2 * math.pi * frequency
    pole = omega * complex(-ratio, math.sqrt(1 - ratio**2))
    t = PERIOD * np.arange(59)
    x = np.asarray(found)[1:] - 1e-3
    swing = np.exp(np.asarray(pole * t, complex))
    basis = np.column_stack([np.real(swing), np.imag(swing)])
    weights, *_ = np.linalg.lstsq(basis, x, rcond=None)
    np.testing.assert_allclose(basis @ weights, x, atol=1e-6 * np.abs(x).max())


def test_a_fast_joint_rings_where_steps_follow_and_settles_where_not():
    anchor = rb.build(
        [
            rb.PrismaticJoint("anchor", (1, 0, 0), stiffness=1e9, damping=1e5),
            rb.RigidBody(1e3, (0, 0, 0), np.eye(3)),
            rb.Tool("tool"),
        ]
    )
    tool = rb.BendingTool(50e-3, 0.0, 10e-3, 10e-3, damping_ratio=0.0)
    robot = tool.mounted_on(anchor)
    frequency = float(rb.natural_frequencies(robot, np.zeros(3))[1])
    start = sim.ArmState.steady(robot, jnp.zeros(3), jnp.zeros(3))
    start = sim.ArmState(start.q.at[2].add(1e-4), start.v)
    run = jax.jit(lambda h: sim.free_motion(robot, start, jnp.zeros(3), h, 200))
    assert 2 * math.pi * frequency * STEP > 10
    slow = run(STEP).joint_positions[:, 2]
    rest = float(slow[-1])
    assert np.all(np.abs(slow[3:] - rest) < 1e-2 * abs(slow[0] - rest))
    # Fifty steps a turn: after four turns it is back, with its amplitude.
    fine = run(1 / (50 * frequency)).joint_positions[:, 2]
    kept = np.ptp(fine[150:]) / np.ptp(fine[:50])
    assert 0.99 < kept < 1.001


class Holding(sim.RungeKutta4):
    """A rule that brings the arm where its terms were taken."""

    def steps_to_middle(self, substeps):
        return 1

    def begin(self, robot, terms, step):  # pyright: ignore[reportIncompatibleMethodOverride]
        return terms.joint_positions

    def step(self, robot, prepared: Any, state, command, load, step):
        return sim.ArmState(prepared, state.v)


def test_terms_of_the_middle_come_from_the_rule_asked_for():
    # A rule that stays where it is foretells no other place; another one would.
    start = sim.ArmState(jnp.array([0.9, -0.4]), jnp.array([1.0, -2.0]))
    theta = jnp.array([0.3, 0.2])
    held = sim.free_motion(planar_arm(), start, theta, STEP, 2, Holding(), held=8)
    np.testing.assert_array_equal(
        held.joint_positions, np.tile(start.q, (3, 1)).astype(float)
    )


def test_derivatives_of_a_swing_by_all_that_the_middle_follows():
    # Where the terms are held for a while, the place for which they hold depends on
    # masses and springs too, through the matrix of the step that foretells it.
    arm, theta = planar_arm(), jnp.array([0.3, 0.2])

    @jax.jit
    def end(scales):
        of = lambda arm: (arm.link_masses, arm.joint_stiffness, arm.joint_damping)
        scaled = tuple(x * (1 + s) for x, s in zip(of(arm), scales[:3], strict=True))
        moved = eqx.tree_at(of, arm, scaled)
        start = sim.ArmState(
            jnp.array([0.9, -0.4]) + scales[3], jnp.array([1.0, -2.0]) + scales[4]
        )
        swung = sim.free_motion(moved, start, theta, STEP, 20, held=SUBSTEPS)
        return jnp.concatenate([swung.joint_positions[-1], swung.joint_velocities[-1]])

    at = jnp.zeros(5)
    forward = jax.jit(jax.jacfwd(end))(at)
    back = jax.jit(jax.jacrev(end))(at)
    np.testing.assert_allclose(back, forward, rtol=0, atol=1e-11)
    h = 3e-5
    by_differences = jnp.stack(
        [(end(h * way) - end(-h * way)) / (2 * h) for way in jnp.eye(5)], axis=1
    )
    error = np.abs(forward - by_differences).max(axis=0)
    size = np.abs(forward).max(axis=0)
    assert np.all(error < 1e-7 * size)


def test_single_precision_stays_single():
    robot = jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_array(x) else x, planar_arm()
    )
    start = sim.ArmState(jnp.zeros(2, jnp.float32), jnp.ones(2, jnp.float32))
    theta = jnp.zeros(2, jnp.float32)
    for rule in (sim.Midpoint(), sim.RungeKutta4()):
        motion = sim.free_motion(robot, start, theta, 1e-3, 3, rule)
        assert motion.joint_velocities.dtype == jnp.float32
        assert bool(jnp.all(jnp.isfinite(motion.joint_positions)))


@pytest.mark.parametrize("integrator", [sim.Midpoint, sim.RungeKutta4])
def test_articulated_bodies_swing_as_the_mass_matrix_does(integrator):
    arm, theta = planar_arm(), jnp.array([0.3, 0.2])
    start = sim.ArmState(jnp.array([0.9, -0.4]), jnp.array([1.0, -2.0]))
    by_matrix, by_bodies = (
        jax.jit(
            lambda q, v, rule=integrator(dynamics): (
                sim.free_motion(
                    arm, sim.ArmState(q, v), theta, STEP, 25, rule, held=4
                ).joint_positions
            )
        )(start.q, start.v)
        for dynamics in ("crba", "aba")
    )
    np.testing.assert_allclose(by_bodies, by_matrix, rtol=0, atol=1e-12)
    # Two algorithms never round alike all the way.
    assert not np.array_equal(by_bodies, by_matrix)
    assert float(jnp.abs(by_matrix[-1] - by_matrix[0]).max()) > 0.1
