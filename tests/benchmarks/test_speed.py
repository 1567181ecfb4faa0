"""Time per run, compilation apart: `pytest tests/benchmarks --benchmark-only`."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp

PERIOD = 3.75e-3
STEPS = 200
MILL = ct.flat_end_mill(10e-3, 2)
ROBOT = rb.load("reis_rv130_like")


def path():
    x = -5.6e-3 + 0.1e-3 * np.arange(STEPS)
    columns = [x, np.full(STEPS, 6e-3), np.full(STEPS, -1.03e-3)]
    return jnp.asarray(np.column_stack(columns))


def block():
    return wp.box([0, 0, -2e-3], [20e-3, 12e-3, 0], 0.2e-3)


def alone(tips):
    speed = 2 * math.pi / (2 * PERIOD)
    return sim.simulate_process(
        tips,
        block(),
        MILL,
        PAPER_LAW,
        speed,
        axial_depth=1.5e-3,
        adjoint=pr.ThroughPoses(),
    ).force


def coupled(tips):
    frame = rb.forward_kinematics(ROBOT, ROBOT.home)
    frame = jnp.eye(4).at[:3, 3].set(frame[:3, 3])
    Ts = jnp.broadcast_to(frame[None], (STEPS, 4, 4)).at[:, :3, 3].add(tips)
    q = rb.inverse_kinematics_path(ROBOT, Ts, ROBOT.home).q
    motors = jax.vmap(lambda row: rb.motor_positions(ROBOT, row))(q)
    plan = pr.choose_engagement(block(), MILL, axial_depth=1.5e-3)
    process = pr.Process(
        block(),
        MILL,
        PAPER_LAW,
        math.pi / PERIOD,
        plan,
        derivative=pr.ThroughPoses(),
    )
    return sim.ElasticArm(ROBOT, frame).run(process, motors).actual


def gradient(tips):
    return jax.grad(lambda p: jnp.sum((coupled(p) - p) ** 2))(tips)


FUNCTIONS = (alone, coupled, gradient)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_run(benchmark, function):
    tips = path()
    compiled = jax.jit(function).lower(tips).compile()
    found = benchmark(lambda: jax.block_until_ready(compiled(tips)))
    assert np.isfinite(found).all()


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_compile(benchmark, function):
    tips = path()
    lower = lambda: jax.jit(lambda p: function(p)).lower(tips).compile()
    assert benchmark.pedantic(lower, rounds=1, iterations=1) is not None
