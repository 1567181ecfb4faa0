"""The inverse drive against closed forms and the statics of a robot."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import robot as rb, sim
from diffmill.correction import inverse_drive


@pytest.fixture(scope="module")
def arm():
    return rb.load("reis_rv130_like")


def slide(stiffness, damping, mass=1.0):
    """A robot of one slide, which gravity does not load."""
    joint = rb.PrismaticJoint("slide", (1, 0, 0), stiffness=stiffness, damping=damping)
    return rb.build([joint, rb.RigidBody(mass, (0, 0, 0), np.eye(3))])


def deflection(robot, force, time_step, positions=None):
    """The slide's deflection for means of the force along it."""
    rows = np.zeros((len(force), 3))
    rows[:, 0] = force
    q = jnp.zeros((len(force), 1)) if positions is None else positions
    return inverse_drive(robot, q, rows, time_step).deflection[:, 0]


def test_the_deflection_by_a_ramp_is_exact():
    # D d' + K d = c t from rest: d = c (t - D / K + D / K exp(-K t / D)) / K.
    K, D, c, T = 2.0, 0.5, 3.0, 0.3
    t = T * np.arange(20)
    # Means over the steps that end at t_k; the arm pulls against the force.
    found = deflection(slide(K, D), -c * (t - T / 2), T)
    expected = c * (t - D / K * (1 - np.exp(-K * t / D))) / K
    np.testing.assert_allclose(found[:-1], expected[:-1], rtol=1e-12, atol=1e-15)


def test_the_deflection_without_damping_is_the_static_one():
    means = np.random.default_rng(0).normal(size=10)
    found = deflection(slide(2.0, 0.0), means, 0.1)
    expected = -(means[:-1] + means[1:]) / 2 / 2.0
    np.testing.assert_allclose(found[:-1], expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("stiffness", "damping", "time_step"),
    [
        (2.0, 0.5, 0.3),
        (2.0, 0.5, math.inf),
        (2.0, 0.0, 0.3),
        (2.0, 0.0, math.inf),
        (math.inf, 0.5, 0.3),
    ],
)
def test_derivatives_of_the_deflection(stiffness, damping, time_step):
    means = np.random.default_rng(0).normal(size=10)

    def total(K, D, T):
        robot = dataclasses.replace(
            slide(2.0, 0.5), joint_stiffness=K[None], joint_damping=D[None]
        )
        return jnp.sum(deflection(robot, means, T) ** 2)

    K, D = jnp.asarray(stiffness), jnp.asarray(damping)
    by_K, by_D = jax.grad(total, argnums=(0, 1))(K, D, time_step)
    h = 1e-6
    if math.isfinite(stiffness):
        ahead, behind = (total(K + s, D, time_step) for s in (h, -h))
        np.testing.assert_allclose(by_K, (ahead - behind) / (2 * h), rtol=1e-6)
    else:
        assert by_K == 0
    if damping:
        ahead, behind = (total(K, D + s, time_step) for s in (h, -h))
        np.testing.assert_allclose(by_D, (ahead - behind) / (2 * h), atol=1e-8)


def test_the_force_of_inertia_converges_with_the_square_of_the_step():
    errors = []
    for count in (100, 200):
        t = np.linspace(0, 1, count + 1)
        q = jnp.asarray(t**4 * (1 - t) ** 4)[:, None]
        found = deflection(slide(5.0, 0.0, mass=2.0), np.zeros(t.size), 1 / count, q)
        p = np.polynomial.Polynomial.fromroots([0, 0, 0, 0, 1, 1, 1, 1])
        errors.append(np.abs(found - 2.0 / 5.0 * p.deriv(2)(t)).max())
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_without_end_slowly_there_are_springs_alone():
    """As of a robot that is taken without inertia and damping."""
    rng = np.random.default_rng(0)
    means, q = rng.normal(size=10), jnp.asarray(rng.normal(size=(10, 1)))
    robot = slide(2.0, 0.7, mass=3.0).with_motors([5.0], [8.0], [0.3])
    robot = robot.with_friction([4.0], [1.0], [0.1])
    found = deflection(robot, means, math.inf, q)
    expected = -(means[:-1] + means[1:]) / 2 * (1 / 2.0 + 1 / 8.0)
    np.testing.assert_allclose(found[:-1], expected, rtol=1e-12)


@pytest.mark.slow
def test_a_constant_force_is_answered_by_the_compliance(arm):
    q = arm.home
    rows = 6
    force = np.array([100.0, -50.0, 30.0])
    command = inverse_drive(
        arm, jnp.tile(q, (rows, 1)), np.tile(force, (rows, 1)), 1e-3
    )
    expected = -np.asarray(rb.cartesian_compliance(arm, q))[:3, :3] @ force
    found = command.tip - rb.forward_kinematics(arm, q)[None, :3, 3]
    # Linear in the force up to the square of the joints' small deflections.
    size = float(np.linalg.norm(expected))
    np.testing.assert_allclose(found, np.tile(expected, (rows, 1)), atol=5e-3 * size)


def test_frames_and_gravity(arm):
    """The sag is left to the controller, and `work` may stand anywhere."""
    q = jnp.tile(arm.home, (4, 1))
    T_base_work = np.array(
        [[0.0, -1, 0, 0.7], [1, 0, 0, -0.2], [0, 0, 1, 0.4], [0, 0, 0, 1]]
    )
    idle = inverse_drive(arm, q, np.zeros((4, 3)), 1e-3, T_base_work=T_base_work)
    tip = np.asarray(rb.forward_kinematics(arm, arm.home))[:, 3]
    np.testing.assert_allclose(
        idle.tip[0], (np.linalg.inv(T_base_work) @ tip)[:3], atol=1e-12
    )
    np.testing.assert_allclose(idle.motor_positions, q, atol=1e-12)
    lifted = inverse_drive(arm, q, np.zeros((4, 3)), 1e-3, is_gravity_compensated=False)
    sag = rb.gravity_forces(arm, arm.home) / arm.joint_stiffness
    np.testing.assert_allclose(lifted.motor_positions[0], arm.home + sag, rtol=1e-12)


def test_solves_the_equation_of_motion(arm):
    T, rows = 1e-3, 401
    t = T * np.arange(rows)
    # From rest to rest; amplitude and duration of a milling move.
    shape = 0.02 * np.sin(np.pi * t / t[-1]) ** 4
    direction = np.array([1.0, -0.5, 0.7, 0.3, -0.2, 0.4])
    q = jnp.asarray(np.asarray(arm.home) + shape[:, None] * direction)
    force = np.stack([50 * np.sin(30 * t), 20 * t, -30 * np.cos(20 * t)], axis=1)
    # Means over the step of a force this slow are its values half a step earlier.
    half = t - T / 2
    means = np.stack(
        [50 * np.sin(30 * half), 20 * half, -30 * np.cos(20 * half)], axis=1
    )
    command = inverse_drive(arm, q, means, T, is_gravity_compensated=False)
    delta = np.asarray(command.motor_positions - q)
    rate = (delta[2:] - delta[:-2]) / (2 * T)
    spring = np.asarray(arm.joint_stiffness) * delta[1:-1]
    spring += np.asarray(arm.joint_damping) * rate
    qd = np.gradient(np.asarray(q), T, axis=0)
    qdd = np.gradient(qd, T, axis=0)
    for k in (50, 137, 333):
        wrench = np.concatenate([force[k], np.zeros(3)])
        tau = rb.mass_matrix(arm, q[k]) @ qdd[k]
        tau = tau + rb.ArmTerms.of_state(arm, q[k], qd[k]).bias_forces
        tau = tau - rb.jacobian(arm, q[k]).T @ wrench
        error = np.abs(spring[k - 1] - np.asarray(tau))
        assert error.max() < 2e-3 * np.abs(tau).max()


def test_virtual_joints_move_the_tip_command_only(arm):
    virtual = (False, True, False, False, False, False)
    mixed = dataclasses.replace(arm, is_virtual=virtual)
    q = jnp.tile(arm.home, (4, 1))
    force = np.tile([0.0, 0.0, -100.0], (4, 1))
    plain = inverse_drive(arm, q, force, 1e-3, is_gravity_compensated=False)
    found = inverse_drive(mixed, q, force, 1e-3, is_gravity_compensated=False)
    assert np.all(np.asarray(found.motor_positions[:, 1]) == 0)
    np.testing.assert_allclose(found.tip, plain.tip, atol=1e-15)


@pytest.mark.slow
def test_with_a_drive_of_all_options_the_arm_follows():
    # Hanging, so that the gear always lies on the same side of its gap.
    joint = rb.PrismaticJoint("slide", (0, 0, 1), stiffness=8e5, damping=400.0)
    plain = rb.build([joint, rb.RigidBody(50.0, (0, 0, 0), np.eye(3))])
    robot = plain.with_backlash([2e-4])
    robot = robot.with_friction([20.0], [50.0], [5e-3])
    robot = robot.with_motors([20.0], [4e6], [2e4])
    T, rows = 0.5e-3, 601
    t = T * np.arange(rows)
    q = jnp.asarray(5e-3 * np.sin(np.pi * t / t[-1]) ** 4)[:, None]
    command = inverse_drive(robot, q, np.zeros((rows, 3)), T)
    gravity = rb.gravity_forces(robot, [0.0])
    theta = command.motor_positions + robot.gravity_compensation(gravity)[None]
    rule, h = sim.Midpoint(), jnp.asarray(T)
    begun = rule.begin(robot, rb.ArmTerms.of_state(robot, [0.0], [0.0]), h)

    def step(state, ends):
        target = sim.MotorCommand((ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / T)
        after = rule.step(robot, begun, state, target, jnp.zeros(1), h)
        return after, after.q

    start = sim.ArmState.steady(robot, theta[0], jnp.zeros(1))
    _, found = jax.lax.scan(step, start, (theta[:-1], theta[1:]))
    np.testing.assert_allclose(found, q[1:], atol=3e-6)
    # It matters: the plain answer misses by the gap and the servo's yielding.
    simple = inverse_drive(plain, q, np.zeros((rows, 3)), T)
    assert float(jnp.abs(simple.motor_positions - command.motor_positions).max()) > 9e-5
