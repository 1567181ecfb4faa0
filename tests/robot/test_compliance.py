"""Compliance and natural modes."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

import diffmill.robot as dr


def test_compliance_is_the_slope_of_the_loaded_pose(arm, difference):
    # Without gravity and from no load, so that only the springs answer.
    light = dr.Robot(**{**vars(arm), "gravity": jnp.zeros(3)})
    J = dr.jacobian(light, light.home)

    def displacement(wrench):
        q = dr.loaded_equilibrium(light, light.home, wrench)
        position = dr.forward_kinematics(light, q)[:3, 3]
        return jnp.concatenate([position, J[3:] @ (q - light.home)])

    expected = difference(displacement, np.zeros(6), 1.0)
    C = dr.cartesian_compliance(light, light.home)
    assert_allclose(C, expected, rtol=1e-6, atol=1e-13)
    assert_allclose(C, C.T, rtol=1e-12, atol=1e-20)


def two_masses(K1, K2):
    """Return two sliders in a row: the textbook chain of two masses."""
    I = np.eye(3)
    return dr.build(
        [
            dr.PrismaticJoint("first", (1, 0, 0), stiffness=K1, damping=3.0),
            dr.RigidBody(2.0, (0, 0, 0), I),
            dr.PrismaticJoint("second", (1, 0, 0), stiffness=K2, damping=0.6),
            dr.RigidBody(1.0, (0, 0, 0), I),
        ]
    )


def test_two_masses_ring_as_in_the_textbook():
    # m1 = 2, m2 = 1 kg; x1 = q1, x2 = q1 + q2; det(K - w^2 M) = 0.
    K1, K2 = 5e3, 1e3
    a, b, c = 2.0 * 1.0, -(2.0 * K2 + 1.0 * (K1 + K2)), K1 * K2
    roots = np.sort(np.roots([a, b, c]))
    found = dr.natural_frequencies(two_masses(K1, K2), [0.1, 0.2])
    assert_allclose(found, np.sqrt(roots) / (2 * np.pi), rtol=1e-12)


def test_damping_in_proportion_to_stiffness():
    # D = beta K gives each mode the ratio beta omega / 2, exactly.
    robot = two_masses(5e3, 1e3)
    assert_allclose(robot.joint_damping / robot.joint_stiffness, 6e-4)
    omega = 2 * np.pi * np.asarray(dr.natural_frequencies(robot, [0.0, 0.0]))
    ratios = dr.damping_ratios(robot, [0.0, 0.0])
    assert_allclose(ratios, 6e-4 * omega / 2, rtol=1e-10)


def test_a_rigid_joint_does_not_ring():
    found = dr.natural_frequencies(two_masses(np.inf, 1e3), [0.0, 0.0])
    assert_allclose(found[0], np.sqrt(1e3) / (2 * np.pi), rtol=1e-9)
    assert found[1] > 1e6


def test_gradients_of_frequencies_and_compliance(arm, difference):
    def both(x):
        robot = dr.with_drives(arm, stiffness=x * 1e6)
        first = dr.natural_frequencies(robot, robot.home)[:2]
        return jnp.concatenate(
            [first, 1e6 * jnp.diag(dr.cartesian_compliance(robot, robot.home))[:3]]
        )

    both = jax.jit(both)
    x = np.asarray(arm.joint_stiffness) / 1e6
    expected = difference(both, x, 1e-6)
    assert_allclose(jax.jacrev(both)(jnp.asarray(x)), expected, rtol=1e-5, atol=1e-6)
