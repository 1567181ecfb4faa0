"""Joint positions from poses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import diffmill.robot as dr


def line(arm, step_count, step=(2e-4, 1e-4, -0.5e-4)):
    """Return poses on a straight line from home."""
    T = np.asarray(dr.forward_kinematics(arm, arm.home))
    Ts = np.tile(T, (step_count, 1, 1))
    Ts[:, :3, 3] += np.arange(step_count)[:, None] * np.asarray(step)
    return Ts


@pytest.mark.parametrize("seed", range(6))
def test_a_pose_is_reached_from_afar(arm, seed):
    rng = np.random.default_rng(seed)
    q = np.asarray(arm.home) + rng.uniform(-0.5, 0.5, 6)
    T = dr.forward_kinematics(arm, q)
    found = dr.inverse_kinematics(arm, T, arm.home)
    assert bool(found.converged)
    assert_allclose(dr.forward_kinematics(arm, found.q), T, atol=1e-11)


def test_the_branch_near_the_start_is_kept(arm):
    q = np.asarray(arm.home) + 0.05
    found = dr.inverse_kinematics(arm, dr.forward_kinematics(arm, q), arm.home)
    assert_allclose(found.q, q, atol=1e-10)


def test_an_unreachable_pose_is_flagged_and_finite(arm):
    T = np.asarray(dr.forward_kinematics(arm, arm.home)).copy()
    T[0, 3] += 5.0
    found = dr.inverse_kinematics(arm, T, arm.home)
    assert not bool(found.converged)
    assert float(found.position_residual) > 1.0
    assert np.isfinite(found.q).all()
    slope = jax.jacrev(lambda T: dr.inverse_kinematics(arm, T, arm.home).q)(
        jnp.asarray(T)
    )
    assert np.isfinite(slope).all()


def test_limits_are_reported(arm):
    # A turn about the tool axis, by axis 6 alone, past limits right above home.
    tight = dr.Robot(**{**vars(arm), "joint_upper": arm.home + 0.01})
    q = np.asarray(arm.home) + np.array([0, 0, 0, 0, 0, 0.1])
    T = dr.forward_kinematics(arm, q)
    assert bool(dr.inverse_kinematics(arm, T, arm.home).within_limits)
    found = dr.inverse_kinematics(tight, T, arm.home, attempts=1)
    assert bool(found.converged) and not bool(found.within_limits)
    assert_allclose(found.limit_excess, [0, 0, 0, 0, 0, 0.09], atol=1e-9)
    # With the wrist the other way round axis 6 has room.
    assert bool(dr.inverse_kinematics(tight, T, arm.home).within_limits)


def test_a_path_is_followed(arm):
    Ts = line(arm, 40)
    found = dr.inverse_kinematics_path(arm, Ts, arm.home)
    assert found.converged.all() and found.within_limits.all()
    assert float(found.position_residual.max()) < 1e-12
    again = jax.vmap(lambda q: dr.forward_kinematics(arm, q))(found.q)
    assert_allclose(again, Ts, atol=1e-12)


# 100 rows run as 256, of which those are left out that do not count; the longest path
# is followed in two pieces.
@pytest.mark.parametrize("count", [100, 16_500])
def test_a_path_that_is_padded_is_followed_alike(arm, count):
    turn = 2 * np.pi * np.arange(count) / 4000
    Ts = line(arm, count, step=(0, 0, 0))
    Ts[:, :2, 3] += 0.05 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    found = dr.inverse_kinematics_path(arm, Ts, arm.home)
    traced = jax.jit(lambda Ts: dr.inverse_kinematics_path(arm, Ts, arm.home))
    for one, other in zip(
        *map(jax.tree.leaves, (found, traced(jnp.asarray(Ts)))), strict=True
    ):
        assert_allclose(one, other, atol=1e-12)


def test_a_rapid_jump_within_a_path_is_followed(arm):
    Ts = line(arm, 8, step=(0.012, -0.008, 0.004))
    assert dr.inverse_kinematics_path(arm, Ts, arm.home).converged.all()


def test_a_path_that_leaves_the_reach_is_flagged_where_it_does(arm):
    Ts = line(arm, 30, step=(0.05, 0.0, 0.0))
    found = dr.inverse_kinematics_path(arm, Ts, arm.home)
    assert found.converged[:10].all()
    assert not found.converged[-1]
    assert np.isfinite(found.q).all()


def test_derivatives_of_a_path_are_those_of_the_root(arm, difference):
    Ts = line(arm, 3)

    def joints(shift):
        moved = jnp.asarray(Ts).at[1, :3, 3].add(shift)
        return dr.inverse_kinematics_path(arm, moved, arm.home).q

    joints = jax.jit(joints)
    expected = difference(joints, np.zeros(3), 1e-5)
    for derivative in (jax.jacrev, jax.jacfwd):
        slope = derivative(joints)(jnp.zeros(3))
        assert_allclose(slope, expected, rtol=1e-7, atol=1e-8)


def test_derivative_by_the_geometry(arm):
    # A tool longer by s lifts the flange by s: joints as for a higher target.
    T = jnp.asarray(dr.forward_kinematics(arm, arm.home))

    def by_tool(s):
        robot = arm.with_tool(arm.T_flange_tool.at[2, 3].add(s))
        return dr.inverse_kinematics(robot, T, arm.home).q

    def by_target(s):
        return dr.inverse_kinematics(arm, T.at[2, 3].add(s), arm.home).q

    none = jnp.zeros(())
    assert_allclose(jax.jacfwd(by_tool)(none), jax.jacfwd(by_target)(none), atol=1e-9)


def test_a_singular_pose_gives_finite_numbers(arm):
    # Axes 4 and 6 in line.
    q = np.asarray(arm.home) * np.array([1, 1, 1, 1, 0, 1])
    T = jnp.asarray(dr.forward_kinematics(arm, q))
    found = dr.inverse_kinematics(arm, T, q)
    assert bool(found.converged)
    slope = jax.jacrev(lambda T: dr.inverse_kinematics(arm, T, q).q)(T)
    assert np.isfinite(found.q).all() and np.isfinite(slope).all()


@pytest.mark.parametrize("axis", range(3))
def test_half_a_turn_of_the_tool_is_an_error_of_half_a_turn(arm, axis):
    T = np.asarray(dr.forward_kinematics(arm, arm.home))
    rpy = np.eye(3)[axis]
    turned = lambda angle: (
        T
        @ np.block([[dr.rpy_matrix(*(angle * rpy)), np.zeros((3, 1))], [np.eye(4)[3:]]])
    )
    # Without a search what is missing is the whole angle.
    missing = lambda T: dr.inverse_kinematics(arm, T, arm.home, attempts=0)
    for angle in (3.1, 3.13, 3.1415, np.pi):
        found = missing(turned(angle))
        assert not bool(found.converged)
        assert_allclose(found.rotation_residual, angle, atol=1e-6)
    flip = np.round(turned(np.pi), 12)
    for derivative in (jax.jacfwd, jax.jacrev):
        assert np.isfinite(derivative(lambda T: missing(T).q)(jnp.asarray(flip))).all()
    found = dr.inverse_kinematics(arm, flip, arm.home)
    reached = dr.forward_kinematics(arm, found.q)
    assert bool(found.converged)
    assert_allclose(reached, flip, atol=1e-9)


def test_a_path_that_turns_the_tool_round_between_two_rows_is_flagged(arm):
    Ts = line(arm, 3, step=(0.0, 0.0, 0.0))
    Ts[2, :3, :2] *= -1.0
    found = dr.inverse_kinematics_path(arm, Ts, arm.home)
    assert_array_equal(found.converged, [True, True, False])
    assert float(found.rotation_residual[2]) > 1.0


def test_virtual_joints_stay_at_rest(soft_arm):
    # 4 motors reach the position of poses that they themselves made.
    q = np.array([0.1, 0.0, -0.2, 0.05, 0.3])
    T = dr.forward_kinematics(soft_arm, q)
    found = dr.inverse_kinematics(soft_arm, T, np.zeros(5) + 0.02)
    assert bool(found.converged)
    assert_allclose(found.q, q, atol=1e-8)
    assert float(found.q[1]) == 0.0
