"""A run in segments is the run, and each segment differentiates as the run does."""

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import relative

from diffmill import cutter as ct, cutting, process as pr, sim, workpiece as wp
from machines import slides

PERIOD = 2.5e-3
# Three teeth of unlike force: a segment must begin with the right one.
MILL = ct.flat_end_mill(10e-3, 3)
LAW = cutting.LinearEdgeLaw(
    K_tc=np.array([0.5e9, 1.0e9, 1.5e9]), K_rc=3e8, K_ac=1e8, K_te=0, K_re=0, K_ae=0
)
STOCK = wp.box([0, 0, -1e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 1))
ROWS = 49
# Neither a multiple of the teeth; the last segment turns back into the cut of others.
BREAKS = (0, 16, 32, 48)


ROBOT = slides(0.02, np.full(3, 80.0 * (2 * np.pi * 30.0) ** 2))
MACHINES = {
    "elastic": sim.ElasticArm(ROBOT, np.eye(4)),
    "quasi-static": sim.QuasiStaticArm(ROBOT, np.eye(4)),
}
PROCESS = pr.Process(
    STOCK,
    MILL,
    LAW,
    2 * np.pi / (3 * PERIOD),
    pr.choose_engagement(STOCK, MILL, axial_depth=1e-3, angles=24, substeps=4),
    derivative=pr.ThroughPoses(),
)


@functools.cache
def motors():
    """Return slides that cut along x, shift and come back."""
    t = np.linspace(0, 1, ROWS)
    x = -6e-3 + 7e-3 * np.sin(np.pi * t) ** 2
    y = -3e-3 + 6e-3 * t**2
    return jnp.asarray(np.stack([x, y, np.full(ROWS, -0.6e-3)], axis=1))


@eqx.filter_jit
def whole(theta, machine=MACHINES["elastic"]):
    return machine.run(PROCESS, theta)


@eqx.filter_jit
def segment(state, theta, machine=MACHINES["elastic"]):
    return machine.run_segment(PROCESS, theta, state)


def in_segments(theta, machine=MACHINES["elastic"]):
    """Return segments and the state at the start of each."""
    state = eqx.filter_jit(machine.begin_run)(PROCESS, theta)
    found, states = [], []
    for first, last in itertools.pairwise(BREAKS):
        states.append(state)
        rows = segment(state, theta[first : last + 1], machine)
        state = rows.state
        found.append(rows)
    return found, states


@pytest.mark.parametrize(
    "kind", ["elastic", pytest.param("quasi-static", marks=pytest.mark.slow)]
)
def test_a_run_in_segments_is_the_run(kind):
    machine = MACHINES[kind]
    wanted = whole(motors(), machine)
    found, carries = in_segments(motors(), machine)
    force = np.concatenate([part.force[1:] for part in found])
    actual = np.concatenate([part.actual[1:] for part in found])
    assert np.abs(wanted.force).max() > 20
    assert np.abs(wanted.force[BREAKS[2] :]).max() > 5
    np.testing.assert_allclose(force, wanted.force[1:], atol=1e-9)
    np.testing.assert_allclose(actual, wanted.actual[1:], atol=1e-14)
    assert len({c.process.track.poses.tip.shape for c in carries}) == 1


@pytest.mark.slow
def test_a_segment_differentiates_as_the_run():
    first = BREAKS[2]
    push = jnp.asarray(np.random.default_rng(0).normal(size=(ROWS, 3)))
    push = push.at[: first + 1].set(0)
    wanted = jax.jvp(lambda x: whole(x).actual, (motors(),), (push,))[1][first:]
    carry = in_segments(motors())[1][-1]
    part = lambda x: segment(carry, x).actual
    found = jax.jvp(part, (motors()[first:],), (push[first:],))[1]
    assert relative(found, wanted) < 1e-9
    h = 1e-8
    ends = [part((motors() + s * h * push)[first:]) for s in (1, -1)]
    slope = (np.asarray(ends[0]) - np.asarray(ends[1])) / (2 * h)
    assert relative(found, slope) < 1e-4
