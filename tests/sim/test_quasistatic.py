"""The robot without inertia against hand calculation and the dynamic robot."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, relative

from diffmill import cutter as ct, robot as rb, sim, workpiece as wp

MILL = ct.flat_end_mill(10e-3, 2)
PERIOD = 3.75e-3
STOCK = wp.box([0, 0, -2e-3], [10e-3, 8e-3, 0], 0.5e-3, interval_counts=(4, 4, 1))
PLAN = sim.process_plan(STOCK, MILL, axial_depth=1.5e-3)
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


def run(simulate, stiffness, theta):
    robot = rb.with_drives(slides(1.0), stiffness=stiffness)
    return simulate(
        theta, robot, np.eye(4), STOCK, MILL, PAPER_LAW, PERIOD, PLAN, sim.Traced()
    )


quasistatic = jax.jit(functools.partial(run, sim.simulate_quasistatic))
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
            plan=PLAN,
            adjoint=sim.Traced(),
        )
    )(still().actual)
    # The process alone bends its path smoothly through the instants, here the tip
    # goes straight from one to the next.
    assert relative(alone.force, still().force) < 5e-3


@pytest.mark.slow
def test_it_is_the_mean_of_an_overdamped_robot():
    # In the full slot, after the arm has settled.
    swung = jax.jit(functools.partial(run, sim.simulate_coupled))(
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
