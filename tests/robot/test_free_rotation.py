"""Poses of which only tip and tool axis count, and how near they are to singular."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

L1, L2 = 0.7, 0.5


@pytest.fixture(scope="module")
def flat_arm():
    """A 2R arm in the horizontal plane whose tool stands upright."""
    return dr.build(
        [
            dr.RevoluteJoint("one", (0, 0, 1), lower=-2.5, upper=2.5),
            dr.RigidBody(1.0, (0.3, 0.0, 0.0), np.eye(3)),
            dr.FixedTranslation((L1, 0.0, 0.0)),
            dr.RevoluteJoint("two", (0, 0, 1), lower=-2.7, upper=2.7),
            dr.RigidBody(1.0, (0.3, 0.0, 0.0), np.eye(3)),
            dr.FixedTranslation((L2, 0.0, 0.0)),
        ],
        name="flat",
    )


free = functools.partial(dr.inverse_kinematics, tool_rotation="free")
free_path = functools.partial(dr.inverse_kinematics_path, tool_rotation="free")


def upright(points):
    """Return poses with the tool along +z at points, turned in any way about it."""
    points = np.asarray(points, dtype=float)
    Ts = np.tile(np.eye(4), (len(points), 1, 1))
    for T, angle in zip(Ts, np.linspace(0, 2, len(points)), strict=True):
        T[:3, :3] = dr.rpy_matrix(0.0, 0.0, angle)
    Ts[:, :3, 3] = points
    return Ts


def law_of_cosines(points, side):
    x, y = np.asarray(points, dtype=float)[:, :2].T
    elbow = side * np.arccos((x**2 + y**2 - L1**2 - L2**2) / (2 * L1 * L2))
    shoulder = np.arctan2(y, x) - np.arctan2(
        L2 * np.sin(elbow), L1 + L2 * np.cos(elbow)
    )
    return np.stack([shoulder, elbow], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_two_joints_in_closed_form(flat_arm, side):
    # The law of cosines; the start decides whether the elbow is left or right.
    t = np.linspace(0, 2 * math.pi, 40)
    points = np.stack([0.6 + 0.2 * np.cos(t), 0.3 * np.sin(t), 0 * t], axis=-1)
    found = free_path(flat_arm, upright(points), [0.0, side])
    assert found.converged.all() and found.within_limits.all()
    assert_allclose(found.q, law_of_cosines(points, side), atol=1e-9)
    # Half way in the joints is half way in space, to second order of the step.
    assert float(found.midway_error.max()) < 2e-3
    # Fixed, the rotation would have to be one that two joints cannot give.
    fixed = dr.inverse_kinematics_path(flat_arm, upright(points), [0.0, side])
    assert not fixed.converged[1:].any()


def test_all_configurations_of_two_joints(flat_arm):
    point = [[0.3, 0.6, 0.0]]
    found = dr.configurations(
        flat_arm, upright(point)[0], [0.0, -1.0], tool_rotation="free"
    )
    expected = np.concatenate([law_of_cosines(point, side) for side in (-1.0, 1.0)])
    assert_allclose(found, expected, atol=1e-9)
    nothing = dr.configurations(flat_arm, upright([[1.4, 0.0, 0.0]])[0], [0.0, 1.0])
    assert nothing.shape == (0, 2)
    # Nor is there one that turns the tool over.
    over = upright(point)[0] @ np.diag([1.0, -1.0, -1.0, 1.0])
    nothing = dr.configurations(flat_arm, over, [0.0, 1.0], tool_rotation="free")
    assert nothing.shape == (0, 2)


def test_the_branch_within_limits_is_taken(flat_arm):
    # To its left the elbow may only bend by 0.5.
    tight = eqx.tree_at(lambda r: r.joint_upper, flat_arm, jnp.array([2.5, 0.5]))
    T = upright([[0.3, 0.6, 0.0]])
    left = law_of_cosines(T[:, :3, 3], 1.0)[0]
    found = free(tight, T[0], left + 0.1)
    assert bool(found.converged) and bool(found.within_limits)
    assert_allclose(found.q, law_of_cosines(T[:, :3, 3], -1.0)[0], atol=1e-9)
    # With one attempt the start decides, and what is beyond is said.
    found = free(tight, T[0], left + 0.1, attempts=1)
    assert_allclose(found.q, left, atol=1e-9)
    assert bool(found.converged) and not bool(found.within_limits)


def test_whole_turns_are_taken_off_where_limits_ask(flat_arm):
    turned = eqx.tree_at(
        lambda r: (r.joint_lower, r.joint_upper),
        flat_arm,
        (jnp.array([2.0, -2.7]), jnp.array([8.0, 2.7])),
    )
    T = upright([[0.3, 0.6, 0.0]])
    found = free(turned, T[0], [2.1, 0.5])
    expected = law_of_cosines(T[:, :3, 3], 1.0)[0] + np.array([2 * math.pi, 0.0])
    assert bool(found.within_limits)
    assert_allclose(found.q, expected, atol=1e-9)


def test_a_path_starts_where_limits_let_it_end(flat_arm):
    # Along this line the shoulder passes 0.9 with the elbow on one side only.
    points = np.stack([np.linspace(0.9, 0.3, 30), np.full(30, 0.5), np.zeros(30)], -1)
    limit = float(law_of_cosines(points, -1.0)[:, 0].max()) - 0.1
    tight = eqx.tree_at(lambda r: r.joint_upper, flat_arm, jnp.array([limit, 2.7]))
    nearest, *others = dr.configurations(
        tight, upright(points)[0], [0.0, -1.0], tool_rotation="free"
    )
    assert nearest[1] < 0.0 and len(others) == 1
    (start,) = dr.path_starts(tight, upright(points), [0.0, -1.0], tool_rotation="free")
    assert_allclose(start, law_of_cosines(points, 1.0)[0], atol=1e-9)
    found = free_path(tight, upright(points), start)
    assert found.converged.all() and found.within_limits.all()


@pytest.mark.slow
@pytest.mark.parametrize("tool_rotation", ["fixed", "free"])
def test_poses_within_reach_are_found_and_not_flagged(arm, tool_rotation):
    lower, upper = np.asarray(arm.joint_lower), np.asarray(arm.joint_upper)
    q = lower + np.random.default_rng(0).random((60, 6)) * (upper - lower)
    Ts = jax.vmap(lambda q: dr.forward_kinematics(arm, q))(jnp.asarray(q))
    solve = lambda T: dr.inverse_kinematics(
        arm, T, arm.home, tool_rotation=tool_rotation
    )
    found = jax.jit(jax.vmap(solve))(Ts)
    assert found.converged.all() and found.within_limits.all()
    reached = jax.vmap(lambda q: dr.forward_kinematics(arm, q))(found.q)
    columns = slice(2, 4) if tool_rotation == "free" else slice(0, 4)
    assert_allclose(reached[:, :3, columns], Ts[:, :3, columns], atol=1e-9)


def test_what_a_point_beyond_reach_lacks(flat_arm):
    found = free(flat_arm, upright([[1.5, 0.0, 0.0]])[0], [0.1, 0.2])
    assert not bool(found.converged)
    assert_allclose(found.position_residual, 1.5 - L1 - L2, rtol=5e-2)
    # A tool that has to lean by 0.1 rad cannot: all of it is missing.
    T = np.eye(4)
    T[:3, :3] = dr.rpy_matrix(0.1, 0.0, 0.0)
    T[:3, 3] = (0.9, 0.1, 0.0)
    found = free(flat_arm, T, [0.1, 0.2])
    assert_allclose(found.rotation_residual, 0.1, rtol=1e-3)


def test_limits_are_exceeded_by_what_is_said(flat_arm):
    elbow = 2.9
    T = np.asarray(dr.forward_kinematics(flat_arm, [0.2, elbow]))
    found = free(flat_arm, T, [0.0, 1.8])
    assert bool(found.converged) and not bool(found.within_limits)
    assert_allclose(found.limit_excess, [0.0, elbow - 2.7], atol=1e-9)


def test_a_change_of_configuration_shows_between_the_rows(flat_arm):
    # Through the stretched arm: the other side of the base, by half a turn.
    points = np.tile([-0.9, 0.0, 0.0], (40, 1))
    points[:20] = [0.9, 0.02, 0.0]
    points[10:20, 1] = 0.0
    found = free_path(flat_arm, upright(points), [0.4, -0.8])
    assert_allclose(found.midway_error[:10], 0.0, atol=1e-10)
    assert 0.0 < float(found.midway_error[10]) < 1e-3
    assert float(found.midway_error[20]) > 0.1


def test_singularity_of_two_joints(flat_arm):
    # Stretched, both joints push the tip the same way; lengths in units of the arm.
    found = dr.singularity(flat_arm, [0.3, 0.0], tool_rotation="free")
    assert float(found.smallest) == 0.0 and float(found.condition) == math.inf
    measures = lambda q: dr.singularity(flat_arm, q, tool_rotation="free")
    for slope in jax.tree.leaves(jax.jacfwd(measures)(jnp.array([0.3, 0.0]))):
        assert np.isfinite(slope).all()
    # The motion that does not move the tip: (L1 + L2) q1 + L2 q2 = 0.
    expected = np.array([L2, -(L1 + L2)]) / math.hypot(L2, L1 + L2)
    assert_allclose(abs(found.joint_direction @ expected), 1.0, atol=1e-12)
    # det J = L1 L2 sin(elbow) is the product of both singular values.
    q = [0.3, 0.8]
    found = dr.singularity(flat_arm, q, tool_rotation="free")
    reach = math.sqrt(L1**2 + L2**2 + 2 * L1 * L2 * math.cos(0.8))
    product = float(found.smallest**2 * found.condition)
    assert_allclose(product, L1 * L2 * math.sin(0.8) / reach**2, rtol=1e-10)


def test_the_wrist_of_six_joints(arm):
    q = np.asarray(arm.home) * np.array([1, 1, 1, 1, 0, 1])
    straight = dr.singularity(arm, q)
    assert float(straight.smallest) == 0.0 and float(straight.condition) == math.inf
    # Axes 4 and 6 are in line: they turn against each other.
    direction = np.abs(straight.joint_direction)
    assert_allclose(direction[[3, 5]], math.sqrt(0.5), atol=1e-8)
    assert float(dr.singularity(arm, arm.home).smallest) > 0.05


@pytest.fixture(scope="module")
def gantry():
    """Three slides and a rotary axis along the tool's."""
    slides = []
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
        slides += [
            dr.PrismaticJoint(name, axis, lower=-1.0, upper=1.0),
            dr.RigidBody(5.0, (0.0, 0.0, 0.0), np.eye(3)),
        ]
    return dr.build(
        [
            *slides,
            dr.RevoluteJoint("c", (0, 0, 1), lower=-1.0, upper=3.0),
            dr.RigidBody(1.0, (0.0, 0.0, 0.1), np.eye(3)),
        ],
        name="gantry",
    )


@pytest.mark.slow
def test_a_rotary_tool_axis_stays_still(gantry):
    points = np.random.default_rng(1).normal(size=(12, 3)) * 0.2
    found = free_path(gantry, upright(points), [0.0, 0.0, 0.0, 0.4])
    assert found.converged.all()
    assert_allclose(found.q[:, :3], points, atol=1e-10)
    # In the middle of its range, whatever the poses say about their rotation.
    assert_allclose(found.q[:, 3], 1.0, atol=1e-10)


@pytest.mark.parametrize("angle", [3.13, 3.1415, math.pi])
def test_a_tool_axis_that_cannot_turn_round_is_not_reached(gantry, angle):
    T = np.eye(4)
    T[:3, :3] = dr.rpy_matrix(angle, 0.0, 0.0)
    T[:3, :3] = np.where(np.abs(T[:3, :3]) < 1e-12, 0.0, T[:3, :3])
    solve = lambda T: free(gantry, T, gantry.home, attempts=0)
    for found in (solve(T), free(gantry, T, gantry.home)):
        assert not bool(found.converged)
        assert_allclose(found.rotation_residual, angle, atol=1e-6)
    for derivative in (jax.jacfwd, jax.jacrev):
        assert np.isfinite(derivative(lambda T: solve(T).q)(jnp.asarray(T))).all()


def test_five_joints_reach_with_a_free_rotation_only(arm):
    # Axis 6 is locked by taking it for a virtual joint at rest.
    locked = dr.Robot(**{**vars(arm), "is_virtual": (False,) * 5 + (True,)})
    rng = np.random.default_rng(3)
    q = np.asarray(arm.home) + np.append(rng.uniform(-0.2, 0.2, 5), 0.0)
    q[5] = 0.0
    T = np.array(dr.forward_kinematics(locked, q))
    T[:3, :3] = T[:3, :3] @ dr.rpy_matrix(0.0, 0.0, 0.3)
    assert not bool(dr.inverse_kinematics(locked, T, arm.home).converged)
    found = free(locked, T, arm.home)
    assert bool(found.converged)
    assert float(found.q[5]) == 0.0
    reached = np.asarray(dr.forward_kinematics(locked, found.q))
    assert_allclose(reached[:3, 2:], T[:3, 2:], atol=1e-10)


@pytest.fixture(scope="module")
def leaning(arm):
    """The milling robot with its tool at an angle to axis 6."""
    T = np.eye(4)
    T[:3, :3] = dr.rpy_matrix(0.0, 0.9, 0.2)
    T[:3, 3] = (0.1, 0.02, 0.15)
    return arm.with_tool(arm.T_flange_tool @ jnp.asarray(T))


def circle(robot, count):
    T = np.asarray(dr.forward_kinematics(robot, robot.home))
    t = np.linspace(0, 2 * math.pi, count)
    Ts = np.tile(T, (count, 1, 1))
    Ts[:, :3, 3] += 0.15 * np.stack([np.sin(t), np.cos(t) - 1, 0 * t], axis=-1)
    return Ts


@pytest.mark.slow
def test_the_rotation_belongs_to_the_pose_and_not_to_the_way(leaning):
    Ts = circle(leaning, 60)
    found = free_path(leaning, Ts, leaning.home)
    assert found.converged.all() and found.within_limits.all()
    # Closed in space, closed in the joints, and smooth between.
    assert_allclose(found.q[-1], found.q[0], atol=1e-8)
    fixed = dr.inverse_kinematics_path(leaning, Ts, leaning.home)
    largest = lambda q: float(jnp.max(jnp.abs(jnp.diff(q, axis=0))))
    assert largest(found.q) < 3 * largest(fixed.q)
    # Nearer to the middle of the ranges, in half ranges, than with the rotation fixed.
    middle = (leaning.joint_lower + leaning.joint_upper) / 2
    half = (leaning.joint_upper - leaning.joint_lower) / 2
    spread = lambda q: jnp.sum(((q - middle[None]) / half[None]) ** 2, axis=1)
    assert (spread(found.q) <= spread(fixed.q) + 1e-9).all()
    # No turn of the tool about its axis does better nearby.
    for turn in (-0.01, 0.01):
        reached = jax.vmap(lambda q: dr.forward_kinematics(leaning, q))(found.q)
        spun = Ts.copy()
        spun[:, :3, :3] = reached[:, :3, :3] @ dr.rpy_matrix(0.0, 0.0, turn)[None]
        beside = dr.inverse_kinematics_path(leaning, spun, found.q[0])
        assert (spread(beside.q) > spread(found.q)).all()


@pytest.fixture(scope="module")
def three():
    """A 3R arm in the plane: one joint more than its tip needs."""
    links = []
    for i, length in enumerate((0.5, 0.4, 0.3)):
        links += [
            dr.RevoluteJoint(f"{i}", (0, 0, 1), lower=-2.0, upper=2.4, home=0.3),
            dr.RigidBody(1.0, (0.1, 0.0, 0.0), np.eye(3)),
            dr.FixedTranslation((length, 0.0, 0.0)),
        ]
    return dr.build(links, name="three")


def ahead(robot, count):
    T = np.asarray(dr.forward_kinematics(robot, robot.home))
    return upright(T[:3, 3] + np.linspace(0, 0.05, count)[:, None] * [[-1.0, 1.0, 0]])


def test_derivatives_are_those_of_the_root(three, difference):
    T = jnp.asarray(ahead(three, 3)[1])

    def joints(shift):
        # Out of the plane nothing can be reached.
        moved = T.at[:2, 3].add(shift[:2])
        robot = three.with_tool(three.T_flange_tool.at[0, 3].add(shift[2]))
        return free(robot, moved, three.home).q

    joints = jax.jit(joints)
    expected = difference(joints, np.zeros(3), 1e-5)
    slope = jax.jit(jax.jacrev(joints))(jnp.zeros(3))
    assert_allclose(slope, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_many_poses_at_once(three, dtype):
    robot = jax.tree.map(lambda x: x.astype(dtype), three)
    Ts = jnp.asarray(ahead(three, 4), dtype)
    starts = jnp.stack([robot.home, robot.home + 0.05, robot.home - 0.1, robot.home])
    found = jax.vmap(lambda T, q: free(robot, T, q))(Ts, starts)
    assert found.q.dtype == dtype and found.converged.all()
    # From wherever it starts, a pose has one solution on this side.
    expected = [free(three, T, three.home).q for T in ahead(three, 4)]
    tolerance = {jnp.float64: 1e-9, jnp.float32: 2e-3}[dtype]
    assert_allclose(found.q, np.stack(expected), atol=tolerance)


def test_derivatives_are_finite_where_nothing_is_reached(three):
    T = jnp.asarray(upright([[1.9, 0.1, 0.0]])[0])
    slope = jax.jit(jax.jacrev(lambda T: free(three, T, three.home).q))(T)
    assert np.isfinite(slope).all()


@pytest.mark.parametrize(
    ("start", "angle"),
    [([1.9, -1.8, 0.9], 110.0), ([-0.4, -1.8, 2.3], -70.0), ([0.0, -1.9, 2.1], 40.0)],
)
def test_a_line_is_followed_past_the_end_of_a_middle(three, start, angle):
    # The middle of the joints' ranges that the arm begins at ceases to be one.
    begin = np.asarray(dr.forward_kinematics(three, start))[:3, 3]
    way = 0.3 * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    points = begin + np.linspace(0, 1, 60)[:, None] * np.append(way, 0.0)
    found = free_path(three, upright(points), start)
    assert found.converged.all() and found.within_limits[-1]
    tips = jax.vmap(lambda q: dr.forward_kinematics(three, q)[:3, 3])(found.q)
    assert_allclose(tips, points, atol=1e-12)
