"""The arm in a slot: vibrations grow in time as the eigenvalues say."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp
from machines import home_frame, motors_of

MILL = ct.flat_end_mill(10e-3, 2)
PERIOD, FEED, ROWS = 3.75e-3, 0.1875e-3, 260
ROBOT = rb.load("reis_rv130_like")
STOCK = wp.box([0, 15e-3, -3e-3], [45e-3, 35e-3, 0], 0.5e-3, interval_counts=(6, 6, 1))
PLAN = pr.choose_engagement(STOCK, MILL, axial_depth=2e-3)


FRAME = home_frame(ROBOT)
FRAME[:2, 3] -= 25e-3
ARM = sim.ElasticArm(ROBOT, FRAME)
PROCESS = pr.Process(STOCK, MILL, PAPER_LAW, np.pi / PERIOD, PLAN)


motors = jax.jit(lambda tips: motors_of(ROBOT, tips, FRAME))


@functools.cache
def program():
    return jax.jit(lambda theta: ARM.run(PROCESS, theta))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [0.5e-3, 0.75e-3])
def test_a_kick_of_the_arm_grows_as_predicted(depth):
    # The tool sinks in smoothly: after an entry at full depth it swings so far that
    # teeth leave the cut, and growth differs from period to period.
    share = np.clip((np.arange(ROWS) - 5) / 100, 0, 1)
    share = share**3 * (10 - 15 * share + 6 * share**2)
    tips = np.arange(ROWS)[:, None] * np.array([FEED, 0, 0])
    tips += np.array([-6e-3, 25e-3, 0]) - depth * share[:, None] * np.array([0, 0, 1])
    theta = motors(jnp.asarray(tips))
    plain, kicked = (program()(x) for x in (theta, theta.at[120].add(1e-9)))
    moved = np.abs(np.asarray(kicked.actual - plain.actual)).max(axis=1)
    # In the first windows other modes still fade.
    start, end = (moved[k : k + 20].max() for k in (150, 230))
    found = sim.Stability.along(
        ARM, PROCESS, theta, plain.joint_positions, np.arange(160, 241, 8)
    )
    predicted = np.log(found.radius).mean()
    np.testing.assert_allclose(np.log(end / start) / 80, predicted, atol=1.5e-3)
    # The limit lies between the first depth and the second.
    assert (predicted > 0) == (depth > 0.6e-3)
    if depth > 0.6e-3:
        assert 55 < np.median(found.frequency) < 65
