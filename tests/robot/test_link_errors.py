"""Link errors against a chain that is multiplied by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diffmill import robot as rb

SIZES = {"displacement": 5e-3, "rotation": 0.3, "joint_offsets": 0.2}
SIZES |= {"tool_position": 0.1, "tool_rotation": 1.0, "base_position": 0.5}
SIZES |= {"base_rotation": 2.0}


def drawn(robot, seed=0):
    """Return errors far larger than any robot has."""
    draw = np.random.default_rng(seed)
    none = rb.LinkErrors.none(robot)
    values = {
        name: jnp.asarray(size * draw.normal(size=getattr(none, name).shape))
        for name, size in SIZES.items()
    }
    return dataclasses.replace(none, **values)


def transform(position=(0, 0, 0), rotation=(0, 0, 0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.array(rotation)).as_matrix()
    T[:3, 3] = position
    return T


def by_hand(robot, errors, q):
    """Return the pose of the tool, frame after frame."""
    T = {-1: transform(errors.base_position, errors.base_rotation)}
    q, own = np.asarray(q) + np.asarray(errors.joint_offsets), 0
    for body, (parent, mimic) in enumerate(
        zip(robot.parents, robot.mimics, strict=True)
    ):
        T[body] = T[parent] @ np.block(
            [
                [
                    np.asarray(robot.placement_rotations[body]),
                    np.asarray(robot.placement_positions[body])[:, None],
                ],
                [np.zeros((1, 3)), np.ones((1, 1))],
            ]
        )
        if mimic is None:
            T[body] = T[body] @ transform(
                errors.displacement[own], errors.rotation[own]
            )
            value, own = q[own], own + 1
        else:
            value = q[mimic[0]] * mimic[1] + mimic[2]
        along = value * np.array([0.0, 0.0, 1.0])
        is_slide = robot.body_kinds[body] == "prismatic"
        T[body] = T[body] @ (
            transform(along) if is_slide else transform((0,) * 3, along)
        )
    tool = transform(errors.tool_position, errors.tool_rotation)
    end = np.asarray(robot.T_joint_flange) @ np.asarray(robot.T_flange_tool) @ tool
    return T[robot.flange_joint] @ end


@pytest.mark.parametrize("name", ["reis_rv130_like", "kuka_kr10_like"])
def test_a_chain_multiplied_by_hand(name):
    robot = rb.load(name)
    errors = drawn(robot)
    q = np.asarray(robot.home) + 0.3
    found = rb.forward_kinematics(errors.applied_to(robot), q)
    np.testing.assert_allclose(found, by_hand(robot, errors, q), atol=1e-13)


def test_slides_and_branches(soft_arm):
    errors = drawn(soft_arm)
    q = np.asarray(soft_arm.home) + 0.1
    found = rb.forward_kinematics(errors.applied_to(soft_arm), q)
    np.testing.assert_allclose(found, by_hand(soft_arm, errors, q), atol=1e-13)


def test_followers_turn_by_the_offset_of_their_joint():
    joint = rb.RevoluteJoint("one")
    follower = rb.RevoluteJoint("two", (0, 1, 0), mimic=rb.Mimic("one", -2.0, 0.1))
    body = rb.RigidBody(1.0, (0.1, 0, 0), 0.01 * np.eye(3))
    arm = rb.build(
        [joint, body, rb.FixedTranslation((0.5, 0, 0)), follower, body, rb.Tool()]
    )
    errors = drawn(arm)
    found = rb.forward_kinematics(errors.applied_to(arm), [0.4])
    np.testing.assert_allclose(found, by_hand(arm, errors, [0.4]), atol=1e-13)


def test_none_changes_nothing(arm):
    same = rb.LinkErrors.none(arm).applied_to(arm)
    for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(arm), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-15)


def test_dynamics_are_those_of_the_displaced_joints(arm):
    """The torque of gravity is the slope of the weight's energy."""
    errors = drawn(arm)
    robot = errors.applied_to(arm)
    q = jnp.asarray(arm.home) + 0.2
    still = jnp.zeros_like(q)
    slope = jax.grad(lambda q: rb.mechanical_energy(robot, q, still, q))(q)
    torque = rb.gravity_forces(robot, q)
    np.testing.assert_allclose(slope, torque, rtol=1e-9, atol=1e-8)
    # The base turns in the frame of its poses, not against the weight.
    mounted = dataclasses.replace(
        errors, base_position=jnp.zeros(3), base_rotation=jnp.zeros(3)
    )
    np.testing.assert_allclose(
        rb.gravity_forces(mounted.applied_to(arm), q), torque, rtol=1e-9, atol=1e-8
    )
    assert np.abs(torque - rb.gravity_forces(arm, q)).max() > 10


@pytest.mark.parametrize("name", SIZES)
def test_derivatives_against_differences_also_at_no_error(arm, name):
    q = jnp.asarray(arm.home) + 0.1

    @jax.jit
    def pose(values, errors):
        errors = dataclasses.replace(errors, **{name: values})
        return rb.forward_kinematics(errors.applied_to(arm), q)

    for errors in (rb.LinkErrors.none(arm), drawn(arm)):
        at = getattr(errors, name)
        J = np.asarray(jax.jacfwd(pose)(at, errors)).reshape(16, -1)
        back = np.asarray(jax.jacrev(pose)(at, errors)).reshape(16, -1)
        np.testing.assert_allclose(back, J, atol=1e-12)
        for i in range(at.size):
            step = jnp.zeros(at.size).at[i].set(1e-5).reshape(at.shape)
            slope = (pose(at + step, errors) - pose(at - step, errors)) / 2e-5
            np.testing.assert_allclose(J[:, i], np.ravel(slope), atol=1e-9)


def test_gear_waves_stand_between_motor_and_joint(arm):
    n = arm.joint_count
    amplitudes = 1e-3 * np.random.default_rng(0).normal(size=(n, 4))
    errors = dataclasses.replace(
        rb.LinkErrors.none(arm), waves=jnp.asarray(amplitudes), waves_per_turn=3.0
    )
    robot = errors.applied_to(arm)
    q = np.linspace(-1.0, 2.0, n)
    wanted = q + [
        a[0] * np.sin(3 * x)
        + a[1] * np.cos(3 * x)
        + a[2] * np.sin(6 * x)
        + a[3] * np.cos(6 * x)
        for a, x in zip(amplitudes, q, strict=True)
    ]
    np.testing.assert_allclose(robot.transmitted(jnp.asarray(q)), wanted, rtol=1e-14)
    np.testing.assert_array_equal(arm.transmitted(jnp.asarray(q)), q)
    # Virtual joints behind the arm turn evenly.
    spring = rb.FlangeSpring(
        linear_stiffness=[1e7] * 3,
        mass=10.0,
        center_of_mass=[0.0, 0.0, 0.1],
        inertia=[0.1] * 3,
    )
    soft = spring.mounted_on(robot)
    more = np.append(q, [1e-3] * 3)
    np.testing.assert_allclose(soft.transmitted(jnp.asarray(more))[n:], 1e-3)


def test_errors_of_another_robot_are_refused(arm, planar_arm):
    with pytest.raises(
        ValueError, match=r"`displacement` must have the shape \(2, 3\)"
    ):
        rb.LinkErrors.none(arm).applied_to(planar_arm)
