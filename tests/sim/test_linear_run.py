"""The run as a linear system, against forward-mode derivatives that hold the stock."""

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
ROWS = 20
STOCK = wp.box([0, 0, -1e-3], [8e-3, 6e-3, 0], 0.5e-3, interval_counts=(4, 4, 2))
FLAT = ct.flat_end_mill(10e-3, 2)
UNEVEN = ct.flat_end_mill(10e-3, 3, pitch=np.radians([95, 220, 45]))
HELIX = ct.flat_end_mill(10e-3, 2, helix_angle=math.radians(30))


gantry = functools.cache(machines.gantry)


def motors():
    """Return motors that bring the tool from the air into the block."""
    t = np.linspace(0, 1, ROWS)
    x, y = -8e-3 + 9e-3 * t, 1.5e-3 + 1e-3 * np.sin(2 * t)
    z = 0.1 - 0.6e-3 - 0.2e-3 * t
    return jnp.asarray(np.stack([x, y, z, 2e-3 * t], axis=1))


BEND = rb.BendingTool(40e-3, 0.0, 8e-3, 8e-3)
SPRING = rb.FlangeSpring(20.0, (0.0, 0.0, 0.1), (0.2, 0.2, 0.1), (2e7, 3e7, 4e7))
ROBOTS = {
    "plain": gantry,
    "motors": lambda: gantry().with_motors([30.0] * 4, [2e7] * 4, [900.0] * 4),
    "backlash and friction": lambda: (
        gantry()
        .with_backlash([2e-6] * 4)
        .with_friction([20.0] * 4, [5.0] * 4, [1e-3] * 4)
    ),
    "bending tool": lambda: BEND.mounted_on(gantry()),
    "flange spring": lambda: SPRING.mounted_on(gantry()),
    "modes": gantry,
    "rk4": gantry,
    "quasi-static": gantry,
    "quasi-static, bending tool": lambda: BEND.mounted_on(gantry()),
    "quasi-static, backlash": lambda: (
        gantry()
        .with_backlash([2e-5] * 4)
        .with_motors([30.0] * 4, [2e8] * 4, [900.0] * 4)
    ),
}
CUTS = {
    "upright": (FLAT, {}),
    "looks": (FLAT, {"updates_per_period": 2}),
    "bottom": (FLAT, {"plunges": True}),
    "helix": (HELIX, {}),
    "in space": (FLAT, {"is_upright": False}),
    "cloud": (FLAT, {"chip": "point_cloud"}),
    # The teeth are two periods apart, then less than one.
    "uneven": (UNEVEN, {}),
    "uneven, looks": (UNEVEN, {"updates_per_period": 2}),
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
        derivative=pr.FrozenStock(),
    )
    theta = motors()
    if kind == "modes":
        found = rb.TipModes.of_robot(robot, robot.home, np.eye(4))
        tips = theta[:, :3] - jnp.array([[0.0, 0.0, 0.1]])
        return sim.ModalMachine(found), process, tips
    if kind.startswith("quasi-static"):
        machine = sim.QuasiStaticArm(robot, np.eye(4))
    else:
        rule = sim.RungeKutta4() if kind == "rk4" else sim.Midpoint()
        machine = sim.ElasticArm(robot, np.eye(4), rule)
    theta = jnp.pad(theta, ((0, 0), (0, robot.joint_count - theta.shape[1])))
    return machine, process, theta


CASES = [
    pytest.param("plain", "upright"),
    *(pytest.param("plain", cut, marks=pytest.mark.slow) for cut in list(CUTS)[1:]),
    *(pytest.param(r, "upright", marks=pytest.mark.slow) for r in list(ROBOTS)[1:]),
    *(
        pytest.param("quasi-static", cut, marks=pytest.mark.slow)
        for cut in ("helix", "in space", "cloud", "uneven")
    ),
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
        at, pushed = jax.jvp(run, (theta,), (change[..., 1],))
        wanted = pushed.ends, pushed.force
        return (found.ends[..., 1], found.force[..., 1]), wanted, at.force

    found, wanted, force = both(theta, jnp.asarray(change))
    # In the air, where nothing is computed of the forces, and in the cut.
    is_cut = np.any(np.asarray(force) != 0, axis=1)
    assert not is_cut[:5].any() and is_cut[-5:].all()
    assert_same(found, wanted)


def assert_same(found, wanted):
    """Compare to 1e-9 of the largest entry, which is not zero."""
    for have, want in zip(found, wanted, strict=True):
        assert np.max(np.abs(want)) > 0
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))


def array(rng, *shape):
    return jnp.asarray(rng.normal(size=shape) / np.sqrt(shape[-1]))


def random_run(rng, parameters):
    """Return a linear system of three joints without a meaning."""
    steps, joints, n, S, T, d, l, circles = 12, 3, 6, 4, 2, 6, 3, 4
    cause, known = T * S * d + circles * d + d, n + 2 * joints
    return sim.LinearRun(
        ends=array(rng, steps, S, 3),
        force=array(rng, steps, 3),
        loads=array(rng, steps - 1, S * l, known + cause + parameters),
        arm=array(rng, steps - 1, n + S * d + 3 * S, known + S * l + parameters) / 2,
        pose=array(rng, steps - 1, d, n),
        circles=jnp.asarray(np.arange(steps - 1)[:, None] - np.arange(1, 1 + circles)),
        begin=array(rng, n, 3 * joints + parameters),
        periods=T,
        substeps=S,
    )


def test_pull_is_the_transpose_of_move():
    rng = np.random.default_rng(3)
    linear = random_run(rng, parameters=2)
    change, factors = array(rng, 12, 3, 5), array(rng, 2, 5)
    moved = linear.move(change, factors)
    weights = jax.tree.map(lambda x: array(rng, *x.shape), moved)
    motors, by_parameters = linear.pull(weights)
    dot = lambda a, b: float(jnp.sum(a * b))
    wanted = dot(weights.ends, moved.ends) + dot(weights.force, moved.force)
    found = dot(motors, change) + dot(by_parameters, factors)
    size = jnp.linalg.norm(weights.ends) * jnp.linalg.norm(moved.ends)
    assert abs(found - wanted) < 1e-12 * float(size)
    assert abs(wanted) > 1e-6 * float(size)


@pytest.mark.parametrize("first", [0, 1, 2, 3, 7])
def test_walls_move_as_the_tips_between_the_sub_steps(first):
    rng = np.random.default_rng(5)
    linear = random_run(rng, parameters=0)
    change = array(rng, 12, 3, 4).at[:first].set(0)
    shares = jnp.asarray(rng.uniform(size=12)).at[4].set(0).at[5].set(1)
    found, moved = linear.move_walls(change, shares), linear.move(change)
    still = jnp.zeros((12, 3))
    for k in range(4):
        wanted = pr.wall_deviation(moved.ends[..., k], still, shares)
        np.testing.assert_allclose(found.tips[..., k], wanted, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.force, moved.force, rtol=1e-12, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "quasi-static"])
def test_pull_is_the_reverse_derivative_with_the_stock_held(kind):
    machine, process, theta = model(kind, "upright")

    @jax.jit
    def both(theta):
        linear = sim.linearise(machine, process, theta)
        rng = np.random.default_rng(4)
        ends, force = (
            jnp.asarray(rng.normal(size=x.shape)) for x in (linear.ends, linear.force)
        )
        weights = linear.move(jnp.zeros((*theta.shape, 1)))
        weights = type(weights)(1e3 * ends[..., None], force[..., None])
        run = lambda x: machine.run(process, x)
        both_of = lambda ran: (ran.ends, ran.force)
        _, back = jax.vjp(lambda x: both_of(run(x)), theta)
        return linear.pull(weights)[0][..., 0], back((1e3 * ends, force))[0]

    found, wanted = both(theta)
    assert_same([found], [wanted])


@pytest.mark.parametrize(
    ("kind", "cut"),
    [
        ("plain", "upright"),
        pytest.param("bending tool", "in space", marks=pytest.mark.slow),
        pytest.param("modes", "helix", marks=pytest.mark.slow),
        ("quasi-static", "cloud"),
    ],
)
def test_the_memory_of_a_linear_run_is_known_before(kind, cut):
    machine, process, theta = model(kind, cut)
    needed = sim.LinearRun.needed_bytes(machine, process, theta)
    found = jax.eval_shape(lambda x: sim.linearise(machine, process, x), theta)
    size = lambda x: math.prod(x.shape) * x.dtype.itemsize
    assert needed == sum(size(x) for x in jax.tree.leaves(found))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "motors", "quasi-static"])
def test_the_linear_run_follows_parameters_of_machine_and_cut(kind):
    machine, process, theta = model(kind, "upright")
    change = jnp.asarray([[0.1], [-0.2], [0.3], [0.4]])

    def leaves(machine, process):
        robot, law = machine.robot, process.side_law
        return robot.joint_stiffness, robot.joint_damping, law.K_tc, law.K_re

    def scaled(model, log):
        values = [x * jnp.exp(y) for x, y in zip(leaves(*model), log, strict=True)]
        return eqx.tree_at(lambda m: leaves(*m), model, values)

    @jax.jit
    def both(theta, change):
        still = jnp.zeros((*theta.shape, 1))
        linear = sim.linearise(
            machine, process, theta, scaled=scaled, parameter_count=4
        )
        found = linear.move(still, change)

        def run(log):
            soft, cut = scaled((machine, process), log)
            return soft.run(cut, theta)

        pushed = jax.jvp(run, (jnp.zeros(4),), (change[:, 0],))[1]
        return (found.ends[..., 0], found.force[..., 0]), (pushed.ends, pushed.force)

    found, wanted = both(theta, change)
    assert_same(found, wanted)


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

    assert_same(*both(theta, change))
