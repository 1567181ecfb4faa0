"""Springs against gravity and load."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

WRENCH = np.array([30.0, -20.0, 40.0, 2.0, 1.0, -3.0])


@pytest.mark.parametrize("name", ["arm", "soft_arm", "planar_arm"])
def test_equilibrium_balances_all_forces(name, request):
    robot = request.getfixturevalue(name)
    theta = np.full(robot.joint_count, 0.3)
    q = dr.loaded_equilibrium(robot, theta, WRENCH)
    motor = np.where(robot.is_virtual, 0.0, theta)
    spring = robot.joint_stiffness * (motor - q)
    load = dr.jacobian(robot, q).T @ WRENCH - dr.gravity_forces(robot, q)
    assert float(jnp.max(jnp.abs(q - motor))) > 1e-5
    scale = float(jnp.max(jnp.abs(load)))
    assert_allclose(spring + load, 0.0, atol=1e-10 * scale)


def test_gravity_compensation_brings_the_arm_where_it_is_wanted(arm):
    theta = dr.motor_positions(arm, arm.home)
    assert_allclose(dr.loaded_equilibrium(arm, theta), arm.home, atol=1e-13)
    plain = dr.motor_positions(arm, arm.home, is_gravity_compensated=False)
    assert_allclose(plain, arm.home)
    sag = dr.loaded_equilibrium(arm, plain) - arm.home
    # Axis 2 sinks by G / K, against its own direction of rising.
    G = dr.gravity_forces(arm, arm.home)
    assert_allclose(sag[1], -G[1] / arm.joint_stiffness[1], rtol=1e-2)


def test_virtual_joints_have_no_motor(soft_arm):
    q = np.full(5, 0.1)
    theta = dr.motor_positions(soft_arm, q)
    assert float(theta[1]) == 0.0
    moved = np.asarray(theta).copy()
    moved[1] = 9.0
    assert_allclose(
        dr.loaded_equilibrium(soft_arm, moved), dr.loaded_equilibrium(soft_arm, theta)
    )
    # Gravity alone tilts it: its spring carries its share of G.
    at_rest = dr.loaded_equilibrium(soft_arm, theta)
    G = dr.gravity_forces(soft_arm, at_rest)
    assert_allclose(at_rest[1], -G[1] / soft_arm.joint_stiffness[1], rtol=1e-9)


def test_a_rigid_joint_does_not_move(planar_arm):
    stiff = planar_arm.with_drives(stiffness=[np.inf, 400.0])
    q = dr.loaded_equilibrium(stiff, [0.2, 0.1])
    assert float(q[0]) == 0.2
    assert float(q[1]) < 0.1
    assert_allclose(dr.motor_positions(stiff, [0.2, 0.1])[0], 0.2)


@pytest.mark.slow
def test_derivatives_of_the_equilibrium(soft_arm, difference):
    n = soft_arm.joint_count

    def rest(x):
        robot = soft_arm.with_drives(stiffness=x[n + 6 :] * 1e3)
        return dr.loaded_equilibrium(robot, x[:n], x[n : n + 6])

    rest = jax.jit(rest)
    x = np.concatenate([np.full(n, 0.2), WRENCH, soft_arm.joint_stiffness / 1e3])
    expected = difference(rest, x, 1e-4)
    for derivative in (jax.jacrev, jax.jacfwd):
        slope = derivative(rest)(jnp.asarray(x))
        assert_allclose(slope, expected, rtol=1e-6, atol=1e-9)


def test_second_derivatives_of_the_equilibrium(arm, difference):
    slope = jax.jit(jax.jacfwd(lambda F: dr.loaded_equilibrium(arm, arm.home, F)))
    start = np.concatenate([10.0 * WRENCH[:3], WRENCH[3:]])
    expected = difference(slope, start, 1.0)
    assert np.abs(expected).max() > 0
    found = jax.jacfwd(slope)(jnp.asarray(start))
    assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
