"""The robot without inertia against hand calculation and the dynamic robot."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW, relative

from diffmill import (
    RESULTS,
    SimulationFailed,
    cutter as ct,
    process as pr,
    robot as rb,
    sim,
    toolpath as tp,
    workpiece as wp,
)
from machines import MASS, STIFFNESS, job_of, slides

MILL = ct.flat_end_mill(10e-3, 2)
PERIOD = 3.75e-3
STOCK = wp.box([0, 0, -2e-3], [10e-3, 8e-3, 0], 0.5e-3, interval_counts=(4, 4, 1))
PLAN = pr.choose_engagement(STOCK, MILL, axial_depth=1.5e-3)


def slot(count=48):
    """Return a slot along x that begins in the air, at constant speed."""
    tips = np.tile([-6e-3, 4e-3, -1e-3], (count, 1))
    tips[:, 0] += 0.3e-3 * np.arange(count)
    return tips


PROCESS = pr.Process(
    STOCK, MILL, PAPER_LAW, math.pi / PERIOD, PLAN, derivative=pr.ThroughPoses()
)


def alone(tips):
    return sim.simulate_process(
        tips,
        STOCK,
        MILL,
        PAPER_LAW,
        math.pi / PERIOD,
        engagement=PLAN,
        adjoint=pr.ThroughPoses(),
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
    found = jax.jit(alone)(still().actual)
    # The process alone bends its path smoothly through the instants, here the tip
    # goes straight from one to the next.
    assert relative(found.force, still().force) < 5e-3


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


GAP = 1e-4


def beside(y, count):
    """Return a way along x at some y that goes into the work."""
    tips = np.tile([-4.3e-3, y, -1e-3], (count, 1))
    tips[:, 0] += 44e-6 * np.arange(count)
    return tips


@jax.jit
def with_gaps(theta):
    machine = sim.QuasiStaticArm(slides(1.0).with_backlash([GAP] * 3), np.eye(4))
    return machine.run(PROCESS, theta)


def test_gears_with_a_gap_balance_the_force_of_the_actual_path():
    # In the air two slides are in the middle of their gaps; on entry the force drags
    # one of them to and fro.
    tips = beside(11e-3, 28)
    found = with_gaps(jnp.asarray(tips))
    # Between the gap's end and the corner's the spring carries a parabola of it.
    stretch, w = tips - np.asarray(found.actual), 0.2 * GAP
    u = np.maximum(np.abs(stretch) - (GAP - w) / 2, 0.0)
    s = np.where(u > w, np.abs(stretch) - GAP / 2, u**2 / (2 * w))
    lack = STIFFNESS * np.sign(stretch) * s - (WEIGHT - np.asarray(found.force))
    # What a gear carries at most in its gap.
    assert np.abs(lack).max() < 1.1e-3 * w * STIFFNESS.max()
    force = np.asarray(found.force)
    wanted = np.asarray(jax.jit(alone)(found.actual).force)
    assert np.abs(force).max() > 4
    # The process alone goes smoothly through the instants, so that it sees less of a
    # jump; a force that is no balance is off by more than 3 N.
    np.testing.assert_allclose(force, wanted, atol=1.0)
    assert np.ptp(np.asarray(found.actual - tips)[:, 1]) > 0.4 * GAP


@pytest.mark.slow
def test_derivatives_with_gaps_agree_with_central_differences():
    tips = jnp.asarray(beside(-2.5e-3, 40))

    @jax.jit
    def answer(shift):
        ramp = jnp.linspace(0, 1, 40)[:, None]
        found = with_gaps(tips + shift[None] * ramp)
        return jnp.sum((found.actual - tips)[20:] * jnp.array([[0.5, 0.7, 1.0]]))

    at, step = jnp.zeros(3), 1e-8
    expected = [(answer(step * d) - answer(-step * d)) / (2 * step) for d in np.eye(3)]
    np.testing.assert_allclose(jax.jacfwd(answer)(at), expected, rtol=1e-3)
    np.testing.assert_allclose(jax.grad(answer)(at), expected, rtol=1e-3)


def test_a_run_without_a_balance_says_so():
    # The tool begins in the work, where its edges hold it while the slides take up the
    # feed in their gaps.
    found = with_gaps(jnp.asarray(beside(0.0, 28)))
    assert found.result == RESULTS.non_finite
    assert np.isnan(found.force[1:]).all()


@pytest.mark.slow
def test_a_message_names_the_gaps_that_find_no_balance():
    tips = beside(0.0, 6)
    job = job_of(
        slides(1.0).with_backlash([GAP] * 3),
        tp.Path.upright(PERIOD * np.arange(len(tips)), tips),
        STOCK,
        angles=PLAN.angles,
        substeps=PLAN.substeps,
        mode="quasistatic",
        is_gravity_compensated=False,
    )
    with pytest.raises(SimulationFailed, match="backlash may find no balance"):
        sim.simulate(job)


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
