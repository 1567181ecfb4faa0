"""The robot without inertia against hand calculation and the dynamic robot."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, relative

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp

MILL = ct.flat_end_mill(10e-3, 2)
PERIOD = 3.75e-3
STOCK = wp.box([0, 0, -2e-3], [10e-3, 8e-3, 0], 0.5e-3, interval_counts=(4, 4, 1))
PLAN = pr.choose_engagement(STOCK, MILL, axial_depth=1.5e-3)
STIFFNESS, MASS = np.array([1.5e6, 2.5e6, 4e6]), 80.0


def slides(ratio):
    """Return three slides, the mass on the last, each damped by `ratio` alone."""
    elements = []
    for name, axis, K in zip("xyz", np.eye(3), STIFFNESS, strict=True):
        D = 2 * ratio * math.sqrt(K * MASS)
        joint = rb.PrismaticJoint(name, tuple(axis), stiffness=float(K), damping=D)
        elements.append(joint)
    return rb.build([*elements, rb.RigidBody(MASS, (0, 0, 0), np.eye(3))])


def slot(count=48):
    """Return a slot along x that begins in the air, at constant speed."""
    tips = np.tile([-6e-3, 4e-3, -1e-3], (count, 1))
    tips[:, 0] += 0.3e-3 * np.arange(count)
    return tips


PROCESS = pr.Process(
    STOCK, MILL, PAPER_LAW, math.pi / PERIOD, PLAN, derivative=pr.ThroughPoses()
)


def run(machine, stiffness, theta):
    robot = slides(1.0).with_drives(stiffness=stiffness)
    return machine(robot, np.eye(4)).run(PROCESS, theta)


quasistatic = jax.jit(functools.partial(run, sim.QuasiStaticArm))
WEIGHT = np.array([0.0, 0.0, 9.81 * MASS])


@functools.cache
def still():
    return quasistatic(jnp.asarray(STIFFNESS), jnp.asarray(slot()))


def test_springs_balance_weight_and_force_in_every_period():
    # Three slides: K (theta - q) = m g - F, axis by axis, in every row.
    pull = (np.asarray(still().force) - WEIGHT) / STIFFNESS
    np.testing.assert_allclose(still().actual, slot() + pull, atol=1e-12)
    np.testing.assert_allclose(still().joint_positions, still().actual, atol=1e-12)
    assert np.linalg.norm(still().force, axis=1).max() > 60


@pytest.mark.slow
def test_the_force_is_that_of_the_process_on_the_actual_path():
    alone = jax.jit(
        lambda tips: sim.simulate_process(
            tips,
            STOCK,
            MILL,
            PAPER_LAW,
            2 * math.pi / (2 * PERIOD),
            engagement=PLAN,
            adjoint=pr.ThroughPoses(),
        )
    )(still().actual)
    # The process alone bends its path smoothly through the instants, here the tip
    # goes straight from one to the next.
    assert relative(alone.force, still().force) < 5e-3


@pytest.mark.slow
def test_it_is_the_mean_of_an_overdamped_robot():
    # In the full slot, after the arm has settled.
    swung = jax.jit(functools.partial(run, sim.ElasticArm))(
        jnp.asarray(STIFFNESS), jnp.asarray(slot())
    )
    rows = slice(30, 36)
    expected = (np.asarray(swung.actual) - slot())[rows].mean(axis=0)
    found = (np.asarray(still().actual) - slot())[rows].mean(axis=0)
    assert relative(found, expected) < 0.02


def test_an_arm_softer_than_the_cut_needs_no_relaxation():
    # The plain iteration diverges here.
    soft = STIFFNESS / 20
    found = quasistatic(jnp.asarray(soft), jnp.asarray(slot() + WEIGHT / soft))
    force = np.asarray(found.force)
    np.testing.assert_allclose(found.actual, slot() + force / soft, atol=1e-10)
    steady = force[30:36]
    assert np.abs(steady).max() > 60
    assert np.ptp(steady, axis=0).max() < 0.1 * np.abs(steady).max()


@pytest.mark.slow
def test_derivatives_agree_with_central_differences():
    mask = np.linspace(0.5, 1.0, 3)[None]

    def answer(x):
        found = quasistatic(x * STIFFNESS, jnp.asarray(slot(30)))
        return jnp.sum((found.actual - slot(30)) * mask) * 1e3

    x, step = jnp.ones(3), 1e-4
    expected = [
        (answer(x + step * d) - answer(x - step * d)) / (2 * step) for d in np.eye(3)
    ]
    np.testing.assert_allclose(jax.jacfwd(answer)(x), expected, rtol=1e-4)
    np.testing.assert_allclose(jax.grad(answer)(x), expected, rtol=1e-4)


@pytest.mark.slow
def test_a_bending_tool_bends_as_a_beam_loaded_along_its_flutes():
    depth, L = 12e-3, 40e-3
    stock = wp.box([0, 0, -15e-3], [10e-3, 8e-3, 0], 0.5e-3, interval_counts=(4, 4, 1))
    plan = pr.choose_engagement(stock, MILL, axial_depth=depth + 0.5e-3)
    stiff = slides(1.0).with_drives(stiffness=np.full(3, 1e13))
    tool = rb.BendingTool(L, 0.0, 10e-3, 10e-3)
    robot = tool.mounted_on(stiff)
    theta = np.zeros((48, 5))
    theta[:, :3] = slot()
    theta[:, 2] = -depth
    process = pr.Process(stock, MILL, PAPER_LAW, math.pi / PERIOD, plan)
    machine = sim.QuasiStaticArm(robot, np.eye(4))
    simulate = jax.jit(lambda theta: machine.run(process, theta))
    found = simulate(jnp.asarray(theta))
    bend = np.asarray(found.actual - theta[:, :3])[30:, :2]
    EI = 600e9 * math.pi * 10e-3**4 / 64
    # A force at height a shifts the tip by (L - a)^2 (2 L + a) / (6 E I); straight
    # flutes in a slot load all heights alike.
    a = (np.arange(1000) + 0.5) / 1000 * depth
    shift = np.mean((L - a) ** 2 * (2 * L + a)) / (6 * EI)
    wanted = np.asarray(found.force)[30:, :2] * shift
    assert np.abs(wanted).max() > 10e-6
    np.testing.assert_allclose(bend, wanted, atol=0.01 * np.abs(wanted).max())
    # At the tip it would be a quarter more.
    assert L**3 / (3 * EI) / shift == pytest.approx(1.285, abs=2e-3)
