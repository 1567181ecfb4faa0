"""Where the tool was when the teeth before passed, of uneven teeth."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp

PERIOD = 2.5e-3
STOCK = wp.box([0, 0, -1e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 2))
PITCH = (97, 220, 43)
# Tooth 1 stands 97 degrees ahead of tooth 0, and so on; an even step is 120 degrees.
DELAYS = np.array([PITCH, (317, 263, 140), (360, 360, 360)]) / 120


def process_of(pitch, substeps, updates_per_period=1):
    """Return the process of a cutter with three teeth."""
    mill = ct.flat_end_mill(
        10e-3, 3, pitch=None if pitch is None else np.radians(pitch)
    )
    plan = pr.choose_engagement(
        STOCK,
        mill,
        axial_depth=1e-3,
        angles=3 * substeps,
        substeps=substeps,
        updates_per_period=updates_per_period,
    )
    return pr.Process(STOCK, mill, PAPER_LAW, 2 * math.pi / (3 * PERIOD), plan)


def test_a_tooth_passes_after_the_one_ahead_of_it():
    process = process_of(PITCH, 4)
    np.testing.assert_allclose(process.cutter.delays(float), DELAYS, rtol=1e-12)


def swing(turns, instants):
    """Return poses of a tool that drifts and swings, at instants in tooth periods."""
    x = np.sin(2 * np.pi * turns * np.asarray(instants))
    return wp.Pose(jnp.asarray(np.stack([x, x, np.asarray(instants)], axis=-1)))


def test_delays_of_a_known_cutter_keep_the_precision_of_the_host():
    mill = jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float32), process_of(PITCH, 4).cutter
    )
    found = mill.delays(np.float64)
    assert isinstance(found, np.ndarray) and found.dtype == np.float64
    np.testing.assert_allclose(found, DELAYS, rtol=1e-6)
    traced = jax.jit(lambda mill: mill.delays(jnp.float32))(mill)
    np.testing.assert_allclose(traced, DELAYS, rtol=1e-6)


@pytest.mark.parametrize("pitch", [PITCH, None])
def test_poses_are_those_at_the_delays(pitch):
    errors = []
    for substeps in (10, 20):
        process = process_of(pitch, substeps)
        middles = (np.arange(substeps) + 0.5) / substeps
        recent = swing(0.7, middles - np.arange(1.0, 4)[:, None])
        found = process.earlier(recent, swing(0.7, middles)).tip
        delays = np.arange(1.0, 4) if pitch is None else DELAYS
        at = middles.reshape(-1, *(1,) * delays.ndim) - delays
        wanted = swing(0.7, at).tip
        # Straight on, nothing is off.
        np.testing.assert_allclose(found[..., 2], wanted[..., 2], atol=1e-12)
        errors.append(np.abs(found - wanted).max())
    if pitch is None:
        assert max(errors) < 1e-12
    else:
        # Of straight lines between the middles of sub-steps.
        assert 0 < errors[0] < (2 * np.pi * 0.7 / 10) ** 2 / 8
        assert 3 < errors[0] / errors[1] < 5


@pytest.mark.parametrize("pitch", [PITCH, None])
def test_a_tool_that_stops_in_the_material_does_not_rub_in_single_precision(pitch):
    """It has been just where it is, far from the origin too."""
    corner = np.array([0.31, 0.22, 0.13])
    stock = wp.box(
        corner - [0, 0, 1e-3],
        corner + np.array([8e-3, 6e-3, 0]),
        0.5e-3,
        interval_counts=(4, 4, 2),
        dtype=jnp.float32,
    )
    process = process_of(pitch, 8)
    single = lambda x: jnp.asarray(x, jnp.float32)
    path = np.tile([0.0, 2e-3, -0.5e-3], (24, 1))
    path[:, 0] = -2e-3 + 2e-4 * np.minimum(np.arange(24), 14)
    found = sim.simulate_process(
        single(path + corner),
        stock,
        jax.tree.map(single, process.cutter),
        PAPER_LAW,
        process.spindle_speed,
        engagement=process.engagement,
    )
    force = np.linalg.norm(found.force, axis=1)
    assert force[14] > 10 and force[-3:].max() < 0.01 * force[14]


def slide():
    """Return a soft slide across the feed of a tool that is carried along x."""
    K = 5.0 * (2 * np.pi * 300.0) ** 2
    x = rb.PrismaticJoint("x", (1, 0, 0), stiffness=1e9, damping=1e4)
    y = rb.PrismaticJoint("y", (0, 1, 0), stiffness=K, damping=50.0)
    body = rb.RigidBody(5.0, (0.0, 0.0, 0.1), 0.01 * np.eye(3))
    return rb.build([x, y, body, rb.Tool("tool", (0.0, 0.0, 0.0))])


@pytest.mark.parametrize("pitch", [PITCH, None])
def test_a_vibrating_tool_is_pushed_as_its_poses_say(pitch):
    """Also by teeth that passed within the same period."""
    process = process_of(pitch, 12)
    frame = np.eye(4)
    frame[2, 3] = 0.5e-3
    machine = sim.ElasticArm(slide(), frame)
    count = 10
    path = np.stack([2e-3 + 2e-4 * np.arange(count + 1), np.full(count + 1, 2e-3)], 1)
    state = machine.begin_run(process, jnp.asarray(path))
    rows = machine.rows(process, jnp.asarray(path), None)
    period = jax.jit(lambda *given: machine.period(process, *given))

    def run(state, k):
        command = jax.tree.map(lambda x: x[k], rows)
        return period(state, sim.PeriodRow(jnp.asarray(k + 1, jnp.int32), command))

    for k in range(count - 1):
        state = run(state, k)[0]
    recent, (_, period) = state.process.recent, run(state, count - 1)
    steps = period.substeps
    middles = wp.Pose(steps.tips)

    def loads(now):
        wrench = jax.vmap(
            lambda samples, pose, earlier: process.engagement.wrench(
                process, samples, pose, earlier, period.engagement.decimated
            )
        )(period.engagement.samples, middles, process.earlier(recent, now))
        return np.mean(wrench, axis=1)[:, :3]

    wanted = loads(middles)
    scale = np.abs(wanted).max()
    assert scale > 10
    np.testing.assert_allclose(steps.loads, wanted, atol=1e-9 * scale)
    # By the vibration of the period before the teeth would push otherwise.
    is_apart = np.abs(loads(recent[0]) - wanted).max() > 1e-3 * scale
    assert is_apart == (pitch is not None)
