"""Backlash, friction and motors with a mass, against closed forms."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from diffmill import robot as rb, sim
from small_job import arm_text, body, slide as slide_of

M, K, D = 50.0, 8e5, 400.0
STEP = 3.75e-3 / 8
RULES = [sim.Midpoint(), sim.RungeKutta4()]
BOTH = pytest.mark.parametrize("rule", RULES, ids=["midpoint", "rk4"])


def slide(*, stiffness=K, damping=0.0, axis=(1, 0, 0)):
    """Return one mass on one spring, sliding; along z gravity pulls it."""
    joint = rb.PrismaticJoint("slide", axis, stiffness=stiffness, damping=damping)
    return rb.build([joint, rb.RigidBody(M, (0, 0, 0), np.eye(3)), rb.Tool("tool")])


@functools.partial(jax.jit, static_argnums=(3,))
def run(robot, start, theta, rows, rule, step=STEP):
    return sim.free_motion(robot, start, theta, step, rows, rule)


def move(robot, q, v, rows, rule, *, theta=0.0, step=STEP):
    start = sim.ArmState(jnp.array([q]), jnp.array([v]))
    motion = run(robot, start, jnp.array([theta]), rows, rule, step)
    return np.asarray(motion.joint_positions)[:, 0], np.asarray(
        motion.joint_velocities
    )[:, 0]


@BOTH
def test_frequencies_of_two_masses(rule):
    J, K_s = 30.0, 2e6
    robot = slide().with_motors([J], [K_s], [0.0])
    q, _ = move(robot, 1e-3, 0.0, 4000, rule, step=2e-4)
    # Both modes swing undamped: x[k+4] + a (x[k+3] + x[k+1]) + b x[k+2] + x[k] = 0.
    A = np.column_stack([q[3:-1] + q[1:-3], q[2:-2]])
    (a, b), *_ = np.linalg.lstsq(A, -(q[4:] + q[:-4]), rcond=None)
    cosines = np.roots([1.0, a / 2, (b - 2) / 4])
    found = np.sort(np.arccos(cosines) / 2e-4)
    stiffness = np.array([[K, -K], [-K, K + K_s]])
    squares = np.linalg.eigvals(np.diag([1 / M, 1 / J]) @ stiffness)
    wanted = np.sqrt(np.sort(squares))
    # The midpoint rule turns omega into 2 / h atan(omega h / 2).
    if isinstance(rule, sim.Midpoint):
        wanted = 2 / 2e-4 * np.arctan(wanted * 2e-4 / 2)
    assert_allclose(found, wanted, rtol=2e-5)


@BOTH
def test_a_hanging_mass_rests_at_the_end_of_its_gap(rule):
    b = 2e-4
    robot = slide(damping=5000.0, axis=(0, 0, 1)).with_backlash([b])
    sag = M * 9.81 / K + b / 2
    assert_allclose(rb.loaded_equilibrium(robot, [0.0]), [-sag], rtol=1e-12)
    start = sim.ArmState.steady(robot, jnp.zeros(1), jnp.zeros(1))
    assert_allclose(start.q, [-sag], rtol=1e-12)
    # From either side it comes to the same place.
    for q in (0.0, -4e-4, 3e-4):
        found, _ = move(robot, q, 0.0, 1000, rule)
        assert_allclose(found[-1], -sag, rtol=1e-6)
    # The controller lifts the spring's part only.
    theta = rb.motor_positions(robot, [0.0])
    assert_allclose(rb.loaded_equilibrium(robot, theta), [-b / 2], rtol=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_a_vertical_axis_rests_in_the_middle_of_its_gap(dtype):
    # What is left of the weight in it is rounding, of one sign or the other.
    gap = 1e-4
    plain = rb.load("kuka_kr210_like").with_backlash([gap] * 6)
    cast = lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x
    robot = jax.tree.map(cast, plain)
    for turn in np.linspace(-0.3, 0.3, 7).astype(robot.dtype):
        q = robot.home + turn
        theta = rb.motor_positions(robot, q)
        away = np.abs(rb.loaded_equilibrium(robot, theta) - theta)
        assert away[0] < 0.05 * gap
        # Two axes carry the arm.
        assert np.min(away[1:3]) > 0.4 * gap


def test_dead_zone_and_its_inverse():
    robot = slide().with_backlash([2e-4], corner=0.3)
    x = jnp.linspace(-3e-4, 3e-4, 601)
    tau = jax.vmap(lambda x: robot.gear_torque(x[None], jnp.zeros(1)).torque[0])
    torque = np.asarray(tau(x))
    outside = np.abs(np.asarray(x)) > 1.3e-4
    assert_allclose(torque[outside], K * (x - jnp.sign(x) * 1e-4)[outside], rtol=1e-9)
    inside = np.abs(np.asarray(x)) < 0.7e-4
    assert_allclose(torque[inside], 0.0)
    slopes = jax.vmap(lambda x: robot.gear_torque(x[None], jnp.zeros(1)).stiffness[0])(
        x
    )
    assert_allclose(slopes, jax.vmap(jax.grad(lambda x: tau(x[None])[0]))(x), rtol=1e-9)
    # A gear that carries less is on its way from the middle of the gap to its side.
    loaded = np.abs(torque) > 1e-3 * 0.3 * 2e-4 * K
    back = jax.vmap(lambda t: robot.drive_deflection(t[None])[0])(torque[loaded])
    assert_allclose(back, x[loaded], rtol=1e-9)


@BOTH
def test_a_sliding_mass_stops_where_friction_has_used_its_energy(rule):
    # A spring as soft as nothing: F_c brakes evenly, s = M v^2 / (2 F_c).
    F_c, v0 = 100.0, 0.05
    robot = slide(stiffness=1e-3).with_friction([F_c], [0.0], [1e-5])
    step = STEP if isinstance(rule, sim.Midpoint) else 1e-5 * M / F_c
    rows = round(2 * M * v0 / F_c / step)
    q, v = move(robot, 0.0, v0, rows, rule, step=step)
    assert_allclose(q[-1], M * v0**2 / (2 * F_c), rtol=2e-2)
    assert abs(v[-1]) < 1e-6
    # It never turns round.
    assert v.min() > -1e-7


def test_friction_sticks_below_its_limit_and_slides_above():
    F_c, v_s = 100.0, 1e-5
    soft = slide(stiffness=1e-3, axis=(0, 0, 1)).with_friction([F_c], [20.0], [v_s])
    weight = M * 9.81
    held = soft.with_friction([2 * weight], [0.0], [v_s])
    _, v = move(held, 0.0, 0.0, 400, sim.Midpoint())
    # It creeps as slowly as the smooth law says.
    assert_allclose(v[-1], -v_s * math.atanh(0.5), rtol=1e-6)
    _, v = move(soft, 0.0, 0.0, 400, sim.Midpoint())
    t = 400 * STEP
    rate = 20.0 / M
    wanted = -(weight - F_c) / 20.0 * (1 - math.exp(-rate * t))
    # Tearing loose takes it some sub-steps.
    assert_allclose(v[-1], wanted, rtol=5e-3)


# z_s of joints that stick.
YIELD = 1e-5


def sticking(F_c, viscous=0.0, **drive):
    robot = slide(**drive)
    return robot.with_friction([F_c], [viscous], [1e-3], presliding=[YIELD])


@BOTH
def test_a_sticking_mass_stops_as_friction_says(rule):
    F_c, v0 = 100.0, 0.05
    step = STEP if isinstance(rule, sim.Midpoint) else 1e-4
    rows = round(2 * M * v0 / F_c / step)
    q, _ = move(sticking(F_c, stiffness=1e-3), 0.0, v0, rows, rule, step=step)
    # On its bristles it swings about the place where it stops.
    assert_allclose(q[-1], M * v0**2 / (2 * F_c), atol=2.5 * YIELD)


@pytest.mark.parametrize("share", [0.4, 0.95])
def test_a_loaded_joint_that_sticks_does_not_creep(share):
    """At rest for 10 s, with the load put on at once, so that it slides at first."""
    weight = M * 9.81
    robot = sticking(weight / share, damping=D, axis=(0, 0, 1))
    q, _ = move(robot, 0.0, 0.0, round(10 / STEP), sim.Midpoint())
    assert np.ptp(q[-2000:]) < 1e-15
    if share < 0.5:
        bristle = weight / share / YIELD
        assert_allclose(q[-1], -weight / (K + bristle), rtol=1e-9)


def test_a_shaken_joint_stays_within_its_bristles():
    """Elastic below F_c: a load that swings leaves no drift, as Dahl's law would."""
    F_c, stiffness = 100.0, 1e3
    robot = sticking(F_c, stiffness=stiffness)
    t = np.arange(4000) * STEP
    load = np.minimum(t, 1.0) * (50.0 + 40.0 * np.sin(2 * np.pi * 5.0 * t))
    command = load / stiffness

    def step(state, theta):
        motors = sim.MotorCommand(jnp.asarray([theta]), jnp.zeros(1))
        terms = rb.ArmTerms.of_state(robot, state.q, state.v)
        rule = sim.Midpoint()
        held = rule.begin(robot, terms, jnp.asarray(STEP))
        state = rule.step(robot, held, state, motors, jnp.zeros(1), jnp.asarray(STEP))
        return state, state.q[0]

    start = sim.ArmState.steady(robot, jnp.zeros(1), jnp.zeros(1))
    _, q = jax.lax.scan(step, start, jnp.asarray(command))
    assert np.abs(np.asarray(q)).max() < YIELD
    period = round(0.2 / STEP)
    early, late = q[-3 * period : -2 * period], q[-period:]
    assert_allclose(np.mean(late), np.mean(early), atol=2e-3 * YIELD)


def test_a_cycle_of_friction_takes_the_energy_of_its_loop():
    """4 F_c (X - z_s) over a slow cycle of amplitude X: a parallelogram."""
    F_c, X, n = 100.0, 1e-4, 4000
    friction = sticking(F_c).friction
    assert friction is not None
    way = X * np.sin(2 * np.pi * np.arange(2 * n + 1) / n)

    def step(z, travel):
        rate = travel[None]
        brake = friction.brake(z, rate, 0 * rate, jnp.ones(()), jnp.ones(()))
        return friction.moved_bristles(z, rate), (brake.impulse * rate)[0]

    _, works = jax.lax.scan(step, jnp.zeros(1), jnp.asarray(np.diff(way)))
    work = np.sum(works[n:])
    assert_allclose(work, 4 * F_c * (X - YIELD), rtol=1e-4)


def test_slopes_of_friction_that_sticks():
    """Against differences, for a joint that turns round and sticks on the way."""
    x = np.array([60.0, 3e-5, 20.0])

    @jax.jit
    def end(scale):
        F_c, z_s, F_v = x * scale
        robot = slide(damping=D, axis=(0, 0, 1))
        robot = robot.with_friction([F_c], [F_v], [1e-3], presliding=[z_s])
        start = sim.ArmState.steady(robot, jnp.zeros(1), jnp.zeros(1))
        start = sim.ArmState(start.q, start.v + 0.05, bristles=start.bristles)
        motion = sim.free_motion(robot, start, jnp.zeros(1), STEP, 200)
        return 1e6 * motion.joint_positions[jnp.array([40, 120, 200]), 0]

    slope = jax.jit(jax.jacfwd(end))(jnp.ones(3))
    h = 1e-7
    wanted = [(end(1 + h * e) - end(1 - h * e)) / (2 * h) for e in np.eye(3)]
    assert_allclose(slope, np.array(wanted).T, rtol=1e-2, atol=1e-4)
    assert np.abs(wanted).max() > 1.0


def test_nothing_of_an_option_is_the_plain_drive():
    plain, rule = slide(damping=D), sim.Midpoint()
    wanted, _ = move(plain, 1e-3, 0.2, 200, rule)
    gap = plain.with_backlash([0.0])
    smooth = plain.with_friction([0.0], [0.0], [1e-3])
    scale = np.abs(wanted).max()
    still = plain.with_friction([0.0], [0.0], [1e-3], presliding=[0.0])
    for robot in (gap, smooth, still):
        assert_allclose(move(robot, 1e-3, 0.2, 200, rule)[0], wanted, atol=1e-9 * scale)
    narrow = plain.with_backlash([1e-9])
    assert_allclose(move(narrow, 1e-3, 0.2, 200, rule)[0], wanted, atol=1e-5 * scale)


def test_a_light_motor_on_a_stiff_servo_is_no_motor():
    plain = slide(damping=D)
    wanted, _ = move(plain, 1e-3, 0.2, 200, sim.Midpoint())
    light = plain.with_motors([1e-6], [K * 1e6], [K * 1e3])
    found, _ = move(light, 1e-3, 0.2, 200, sim.Midpoint())
    assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    # And one without mass on a servo as soft as the gear halves the stiffness.
    series = slide().with_motors([1e-9], [K], [0.0])
    half, _ = move(slide(stiffness=K / 2), 1e-3, 0.0, 200, sim.Midpoint())
    start = sim.ArmState(*(jnp.array([x]) for x in (1e-3, 0.0, 0.5e-3, 0.0)))
    found = run(series, start, jnp.zeros(1), 200, sim.Midpoint()).joint_positions
    assert_allclose(found[:, 0], half, atol=1e-6)


def test_the_rules_agree_on_all_options_together():
    robot = everything(jnp.array([2e-4, 3.0, 10.0, 0.02, 20.0, 4e6, 800.0]))
    q0, v0 = -4e-4, 0.01
    fine, _ = move(robot, q0, v0, 3000, sim.RungeKutta4(), step=1e-4)
    for rows, bound in ((640, 3e-2), (2560, 8e-3)):
        coarse, _ = move(robot, q0, v0, rows, sim.Midpoint(), step=0.3 / rows)
        assert abs(coarse[-1] - fine[-1]) < bound * np.abs(fine).max()


def everything(x):
    robot = slide(damping=D, axis=(0, 0, 1))
    robot = robot.with_backlash(x[:1])
    robot = robot.with_friction(x[1:2], x[2:3], x[3:4])
    return robot.with_motors(x[4:5], x[5:6], x[6:7])


@pytest.mark.slow
def test_slopes_in_the_numbers_of_all_options():
    x = np.array([2e-4, 3.0, 10.0, 0.02, 20.0, 4e6, 800.0])

    @jax.jit
    def end(scale):
        start = sim.ArmState.steady(everything(x * scale), jnp.zeros(1), jnp.zeros(1))
        start = sim.ArmState(start.q, start.v + 0.05, start.theta, start.omega)
        motion = sim.free_motion(everything(x * scale), start, jnp.zeros(1), STEP, 60)
        return 1e6 * motion.joint_positions[-1, 0]

    slope = jax.jit(jax.grad(end))(jnp.ones(7))
    h = 1e-6
    wanted = [(end(1 + h * e) - end(1 - h * e)) / (2 * h) for e in np.eye(7)]
    assert_allclose(slope, np.array(wanted), rtol=1e-4, atol=1e-5)
    assert np.all(np.abs(np.array(wanted)) > 1e-4)


def test_what_is_refused():
    for make, text in (
        (lambda: slide().with_backlash([-1e-4]), "`gap` must be not negative"),
        (lambda: slide().with_backlash([1e-4], corner=2.0), "`corner` must be"),
        (lambda: slide().with_friction([1.0], [0.0], [0.0]), "`speed` must be pos"),
        (
            lambda: slide().with_friction([1.0], [0.0], [1.0], presliding=[0.0]),
            "`presliding` must be positive where there is Coulomb friction",
        ),
        (lambda: slide().with_motors([0.0], [1.0], [0.0]), "`inertia` must be pos"),
        (lambda: slide().with_motors([1.0, 2.0], [1.0], [0.0]), "one number per"),
    ):
        with pytest.raises(ValueError, match=text):
            make()


TURN = {
    "backlash": "0.1 mrad",
    "motor_inertia": "9 kg*m^2",
    "servo_stiffness": "1e6 N*m/rad",
}
MOTOR = {"motor_inertia": "30 kg", "servo_stiffness": "2e6 N/m"}
SLIDE = {
    "coulomb_friction": "20 N",
    "friction_speed": "2 mm/s",
    "presliding": "3 um",
}
DAMPED = {"servo_damping": "500 N*s/m"}


def write_arm(file, turn=TURN, sliding=SLIDE | MOTOR | DAMPED):
    """Write a turning joint and a slide with drives; return the file."""
    joint = {"kind": "revolute", "name": "turn", "stiffness": "2e5 N*m/rad"}
    end = slide_of("slide", 0, stiffness="3e5 N/m", drive=sliding)
    arm = arm_text(joint | {"drive": turn}, body("20 kg"), end, body("20 kg"))
    file.write_text(arm)
    return file


def test_options_in_a_robot_file(tmp_path):
    file = tmp_path / "two.toml"
    robot = rb.load(write_arm(file))
    assert robot.backlash and robot.friction and robot.motors
    assert_allclose(robot.backlash.gap, [1e-4, 0.0])
    assert_allclose(robot.friction.coulomb, [0.0, 20.0])
    assert_allclose(robot.friction.speed, [1e-3, 2e-3])
    assert robot.friction.presliding is not None
    assert_allclose(robot.friction.presliding, [0.0, 3e-6])
    assert_allclose(robot.motors.inertia, [9.0, 30.0])
    assert_allclose(robot.motors.stiffness, [1e6, 2e6])
    assert_allclose(robot.motors.damping, [0.0, 500.0])
    inertia = {"motor_inertia": "30 kg"}
    for faulty, text in (
        ({"turn": TURN | {"backlash": "0.1 mm"}}, r"found '0\.1 mm', but an angle"),
        ({"turn": {"gap": "1 mrad"}}, r"drive\.gap: is not a known key"),
        ({"sliding": SLIDE | inertia | DAMPED}, "beside servo_stiffness"),
        ({"sliding": 1}, "a table of backlash"),
        ({"sliding": SLIDE | DAMPED}, "all motors or none"),
    ):
        with pytest.raises(ValueError, match=text):
            rb.load(write_arm(file, **faulty))


def test_a_bending_tool_has_a_plain_drive():
    robot = everything(jnp.array([2e-4, 3.0, 10.0, 0.02, 20.0, 4e6, 800.0]))
    tool = rb.BendingTool(50e-3, 0.0, 10e-3, 10e-3)
    found = tool.mounted_on(robot)
    assert found.backlash and found.friction
    assert_allclose(found.backlash.gap, [2e-4, 0.0, 0.0])
    assert_allclose(found.friction.coulomb, [3.0, 0.0, 0.0])
    start = sim.ArmState.steady(found, jnp.zeros(3), jnp.zeros(3))
    motion = run(found, start, jnp.zeros(3), 50, sim.Midpoint(), STEP)
    assert_allclose(motion.joint_positions, start.q[None].repeat(51, 0), atol=1e-9)
