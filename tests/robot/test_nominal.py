"""What a controller knows of its machine: where a probe then finds the work."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import robot as rb

MOTORS = np.array(
    [[0.0, 0.1, -0.1, 0, 0, 0], [0.05, 0.12, -0.1, 0, 0, 0], [0.05, 0.2, -0.2, 0, 0, 0]]
)


@pytest.fixture(scope="module")
def known(arm):
    """The arm itself, whose tips at some motors are the probed points."""
    motors = jnp.asarray(np.concatenate([MOTORS, MOTORS[:2] + 0.03]))
    rest = lambda theta: rb.loaded_equilibrium(arm, theta)
    tip = lambda theta: rb.forward_kinematics(arm, rest(theta))[:3, 3]
    frame = jnp.eye(4).at[:3, :3].set(rb.rpy_matrix(0.2, -0.1, 0.7))
    frame = frame.at[:3, 3].set(jnp.array([1.5, 0.1, 0.9]))
    probes = (jax.vmap(tip)(motors) - frame[None, :3, 3]) @ frame[:3, :3]
    return rb.NominalRobot(arm, frame, probes, motors)


def turned(robot, vector, shift):
    """The robot with its base turned and shifted, and gravity turned with it."""
    R = jnp.asarray(rb.rpy_matrix(*vector))
    first = lambda r: (r.placement_rotations, r.placement_positions, r.gravity)
    rotations, positions, gravity = first(robot)
    moved = (
        rotations.at[0].set(R @ rotations[0]),
        positions.at[0].set(R @ positions[0] + jnp.asarray(shift)),
        R @ gravity,
    )
    return eqx.tree_at(first, robot, moved)


def test_the_frame_of_the_robot_itself_is_the_one_that_is_set(known, arm):
    np.testing.assert_allclose(known.touch_off(arm), known.T_base_work, atol=1e-13)


def test_a_displaced_base_displaces_the_frame(known, arm):
    vector, shift = (0.004, -0.003, 0.02), np.array([3e-3, -8e-3, 5e-3])
    R = rb.rpy_matrix(*vector)
    frame = known.touch_off(turned(arm, vector, shift))
    wanted = np.asarray(known.T_base_work)
    np.testing.assert_allclose(frame[:3, :3], R @ wanted[:3, :3], atol=1e-9)
    np.testing.assert_allclose(frame[:3, 3], R @ wanted[:3, 3] + shift, atol=1e-9)


def test_the_frame_is_the_best_rigid_fit(known, arm):
    """Against the singular value decomposition of Kabsch."""
    other = arm.with_drives(stiffness=arm.joint_stiffness * 0.8)
    motors = known.probe_motors
    rest = jax.vmap(lambda theta: rb.loaded_equilibrium(other, theta))(motors)
    tips = np.asarray(jax.vmap(lambda q: rb.forward_kinematics(other, q)[:3, 3])(rest))
    a = np.asarray(known.probes) - np.asarray(known.probes).mean(0)
    U, _, Vt = np.linalg.svd(a.T @ (tips - tips.mean(0)))
    R = (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T
    frame = known.touch_off(other)
    np.testing.assert_allclose(frame[:3, :3], R, atol=1e-12)
    place = tips.mean(0) - R @ np.asarray(known.probes.mean(0))
    np.testing.assert_allclose(frame[:3, 3], place, atol=1e-12)


def test_each_point_is_touched_from_both_sides(known, arm):
    """A joint that carries less than its friction is probed at the middle of its gap.

    The first axis stands upright and carries no weight. The others carry more than
    their friction, and hang on one side of their gaps.
    """
    gap = np.array([4e-5, 0, 0, 0, 0, 0])
    worn = arm.with_backlash(gap).with_friction([50.0] * 6, [0.0] * 6, [1e-3] * 6)
    np.testing.assert_allclose(known.touch_off(worn), known.T_base_work, atol=1e-10)
    heavy = arm.with_backlash(np.roll(gap, 1))
    assert np.abs(known.touch_off(heavy) - known.T_base_work).max() > 1e-5


def test_derivatives_are_differences(known, arm):
    soft = lambda K: known.touch_off(arm.with_drives(stiffness=K))
    K, size = arm.joint_stiffness, 1e-3
    way = jnp.asarray(np.random.default_rng(1).normal(size=K.shape)) * K
    slope = jax.jvp(soft, (K,), (way,))[1]
    numeric = (soft(K + size * way) - soft(K - size * way)) / (2 * size)
    np.testing.assert_allclose(slope, numeric, rtol=2e-5, atol=1e-9)


def test_virtual_joints_of_the_machine_have_no_motor(known, arm):
    spring = rb.FlangeSpring(5.0, (0.0, 0.0, 0.1), (0.1, 0.1, 0.1), (1e9, 1e9, 1e9))
    machine = spring.mounted_on(arm)
    places = known.motor_places(machine)
    assert places == (*range(6), *[-1] * (machine.joint_count - 6))
    rows = rb.placed_motors(places, known.probe_motors)
    np.testing.assert_array_equal(rows[:, :6], known.probe_motors)
    assert not rows[:, 6:].any()


def test_what_fits_not_is_refused(known, planar_arm):
    with pytest.raises(ValueError, match=r"6 motors.*but has 2"):
        known.motor_places(planar_arm)
    line = jnp.asarray(np.linspace(0, 1, 5)[:, None] * np.ones(3))
    with pytest.raises(ValueError, match="not on a line"):
        dataclasses.replace(known, probes=line)


@pytest.mark.parametrize("size", [0.0, 1e-5, 9.9e-4, 1.01e-3, 0.5, 3.0])
def test_a_rotation_vector_is_a_matrix_exponential(size):
    from jax.scipy.linalg import expm

    from diffmill.robot import rotation_matrix

    x, y, z = vector = size * np.array([0.6, -0.48, 0.64])
    K = jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    np.testing.assert_allclose(
        rotation_matrix(jnp.asarray(vector)), expm(K), atol=1e-14
    )
    slope = jax.jacfwd(rotation_matrix)(jnp.asarray(vector))
    step = 1e-6
    for k in range(3):
        d = step * jnp.eye(3)[k]
        numeric = (rotation_matrix(vector + d) - rotation_matrix(vector - d)) / 2 / step
        np.testing.assert_allclose(slope[:, :, k], numeric, atol=1e-9)
