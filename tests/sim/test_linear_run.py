"""The run as a linear system, against forward-mode derivatives that hold the stock."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import cutter as ct, process as pr, robot as rb, sim, workpiece as wp

PERIOD = 2.5e-3
ROWS = 20
STOCK = wp.box([0, 0, -1e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 2))
FLAT = ct.flat_end_mill(10e-3, 2)
HELIX = ct.flat_end_mill(10e-3, 2, helix_angle=math.radians(30))


@functools.cache
def gantry():
    """Return three soft slides and a swivel about y with a milling spindle."""
    K = 80.0 * (2 * np.pi * 30.0) ** 2
    joints = [
        rb.PrismaticJoint(n, axis=a, stiffness=K, damping=600.0)
        for n, a in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))
    ]
    swivel = rb.RevoluteJoint("b", axis=(0, 1, 0), stiffness=4e4, damping=30.0)
    body = rb.RigidBody(80.0, (0.0, 0.0, 0.1), np.eye(3))
    return rb.build([*joints, swivel, body, rb.Tool("tool", (0.0, 0.0, -0.1))])


def motors():
    t = np.linspace(0, 1, ROWS)
    x, y = -3e-3 + 4e-3 * t, 1.5e-3 + 1e-3 * np.sin(2 * t)
    z = 0.1 - 0.6e-3 - 0.2e-3 * t
    return jnp.asarray(np.stack([x, y, z, 2e-3 * t], axis=1))


BEND = rb.BendingTool(40e-3, 0.0, 8e-3, 8e-3)
ROBOTS = {
    "plain": gantry,
    "motors": lambda: gantry().with_motors([30.0] * 4, [2e7] * 4, [900.0] * 4),
    "backlash and friction": lambda: (
        gantry()
        .with_backlash([2e-6] * 4)
        .with_friction([20.0] * 4, [5.0] * 4, [1e-3] * 4)
    ),
    "bending tool": lambda: BEND.mounted_on(gantry()),
    "modes": gantry,
}
CUTS = {
    "upright": (FLAT, {}),
    "looks": (FLAT, {"looks": 2}),
    "bottom": (FLAT, {"plunges": True}),
    "helix": (HELIX, {}),
    "in space": (FLAT, {"is_upright": False}),
}


def model(kind, cut):
    """Return machine, process and motors of a case."""
    robot = ROBOTS[kind]()
    mill, options = CUTS[cut]
    engagement = pr.choose_engagement(
        STOCK, mill, axial_depth=1e-3, angles=24, substeps=4, **options
    )
    process = pr.Process(
        STOCK,
        mill,
        PAPER_LAW,
        math.pi / PERIOD,
        engagement,
        derivative=pr.StockHeld(),
    )
    theta = motors()
    if kind == "modes":
        found = rb.TipModes.of_robot(robot, robot.home, np.eye(4))
        tips = theta[:, :3] - jnp.array([[0.0, 0.0, 0.1]])
        return sim.ModalMachine(found), process, tips
    machine = sim.ElasticArm(robot, np.eye(4))
    theta = jnp.pad(theta, ((0, 0), (0, robot.joint_count - theta.shape[1])))
    return machine, process, theta


CASES = [
    pytest.param("plain", "upright"),
    *(pytest.param("plain", cut, marks=pytest.mark.slow) for cut in list(CUTS)[1:]),
    *(pytest.param(r, "upright", marks=pytest.mark.slow) for r in list(ROBOTS)[1:]),
]


@pytest.mark.parametrize(("kind", "cut"), CASES)
def test_the_linear_run_is_the_derivative_with_the_stock_held(kind, cut):
    machine, process, theta = model(kind, cut)
    rng = np.random.default_rng(0)
    change = 1e-6 * np.cumsum(rng.normal(size=(*theta.shape, 2)), axis=0)
    change[:, 4:] = 0.0

    @jax.jit
    def both(theta, change):
        found = sim.linearise(machine, process, theta).move(change)
        run = lambda x: machine.run(process, x)
        pushed = jax.jvp(run, (theta,), (change[..., 1],))[1]
        return (found.ends[..., 1], found.force[..., 1]), (pushed.ends, pushed.force)

    found, wanted = both(theta, jnp.asarray(change))
    for have, want in zip(found, wanted, strict=True):
        assert np.max(np.abs(want)) > 0
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "motors"])
def test_the_linear_run_follows_parameters_of_machine_and_cut(kind):
    machine, process, theta = model(kind, "upright")
    change = jnp.asarray([[0.1], [-0.2], [0.3], [0.4]])

    def scaled(log):
        factor = jnp.exp(log)
        assert isinstance(machine, sim.ElasticArm)
        robot = machine.robot
        leaves = lambda r: (r.joint_stiffness, r.joint_damping)
        values = robot.joint_stiffness * factor[0], robot.joint_damping * factor[1]
        soft = sim.ElasticArm(eqx.tree_at(leaves, robot, values), np.eye(4))
        leaves = lambda p: (p.side_law.K_tc, p.side_law.K_re)
        values = PAPER_LAW.K_tc * factor[2], PAPER_LAW.K_re * factor[3]
        return sim.CuttingMachine(soft, eqx.tree_at(leaves, process, values))

    @jax.jit
    def both(theta, change):
        still = jnp.zeros((*theta.shape, 1))
        linear = sim.linearise(
            machine, process, theta, scaled=scaled, parameter_count=4
        )
        found = linear.move(still, change)
        run = lambda log: scaled(log).machine.run(scaled(log).process, theta)
        pushed = jax.jvp(run, (jnp.zeros(4),), (change[:, 0],))[1]
        return (found.ends[..., 0], found.force[..., 0]), (pushed.ends, pushed.force)

    found, wanted = both(theta, change)
    for have, want in zip(found, wanted, strict=True):
        assert np.max(np.abs(want)) > 0
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))


@pytest.mark.slow
@pytest.mark.parametrize("rows", [8, 9])
def test_a_segment_has_the_linear_run_of_its_rows(rows):
    """From a state that does not move, with older poses in what a chip remembers."""
    machine, process, theta = model("plain", "upright")
    rng = np.random.default_rng(1)
    change = jnp.asarray(1e-6 * np.cumsum(rng.normal(size=theta.shape), axis=0))
    change = (change - change[rows][None])[rows:]

    @jax.jit
    def both(theta, change):
        begun = machine.begin_run(process, theta)
        state = machine.run_segment(process, theta[: rows + 1], begun).state
        rest = theta[rows:]
        found = sim.linearise(machine, process, rest, state)
        run = lambda x: machine.run_segment(process, x, state)
        ran, pushed = jax.jvp(run, (rest,), (change,))
        moved = found.move(change[..., None])
        have = (found.ends, found.force, moved.ends[..., 0], moved.force[..., 0])
        return have, (ran.ends, ran.force, pushed.ends, pushed.force)

    for have, want in zip(*both(theta, change), strict=True):
        assert np.max(np.abs(want)) > 0
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))
