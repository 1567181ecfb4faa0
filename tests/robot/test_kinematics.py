"""Poses and Jacobians."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr


def test_planar_arm_has_its_closed_form(planar_arm):
    q = np.array([0.4, -1.1])
    T = dr.forward_kinematics(planar_arm, q)
    x = 0.7 * np.cos(q[0]) + 0.5 * np.cos(q.sum())
    z = 0.7 * np.sin(q[0]) + 0.5 * np.sin(q.sum())
    assert_allclose(T[:3, 3], [x, 0.0, z], atol=1e-15)
    assert_allclose(T[:3, 0], [np.cos(q.sum()), 0.0, np.sin(q.sum())], atol=1e-15)
    upper = 0.5 * np.array([-np.sin(q.sum()), 0.0, np.cos(q.sum())])
    expected = np.zeros((6, 2))
    expected[:3, 0], expected[:3, 1] = [-z, 0.0, x], upper
    expected[4] = -1.0
    assert_allclose(dr.jacobian(planar_arm, q), expected, atol=1e-15)


@pytest.mark.parametrize("name", ["arm", "soft_arm"])
def test_the_jacobian_is_the_derivative_of_the_pose(name, request, rng):
    robot = request.getfixturevalue(name)
    q, qd = jnp.asarray(rng.uniform(-1, 1, (2, robot.joint_count)))
    T, rate = jax.jvp(lambda q: dr.forward_kinematics(robot, q), (q,), (qd,))
    spin = rate[:3, :3] @ T[:3, :3].T
    turn = jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
    twist = dr.jacobian(robot, q) @ qd
    assert_allclose(twist, jnp.concatenate([rate[:3, 3], turn]), atol=1e-12)
    assert_allclose(spin, -spin.T, atol=1e-12)


def test_joints_that_do_not_carry_the_tool_have_no_column():
    robot = dr.build(
        [
            dr.RevoluteJoint("turn"),
            dr.Fork([[dr.RevoluteJoint("aside", (1, 0, 0))]]),
            dr.FixedTranslation((1.0, 0.0, 0.0)),
        ]
    )
    J = dr.jacobian(robot, [0.0, 0.3])
    assert_allclose(J[:, 0], [0, 1, 0, 0, 0, 1], atol=1e-15)
    assert_allclose(J[:, 1], 0.0)


def test_another_tool_moves_the_tip(planar_arm):
    T = np.eye(4)
    T[:3, 3] = [0.1, 0.0, 0.0]
    longer = planar_arm.with_tool(T)
    assert_allclose(
        dr.forward_kinematics(longer, [0.0, 0.0])[:3, 3], [1.3, 0, 0], atol=1e-15
    )


def test_rpy_turns_about_fixed_axes():
    # By hand: roll takes y to z, yaw then takes x to y; z is left by the yaw.
    R = dr.rpy_matrix(np.pi / 2, 0.0, np.pi / 2)
    assert_allclose(R @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    assert_allclose(R @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    # Pitch before yaw: x goes down by the pitch, and down is left by the yaw.
    R = dr.rpy_matrix(0.0, np.pi / 2, 0.7)
    assert_allclose(R @ [1, 0, 0], [0, 0, -1], atol=1e-15)
