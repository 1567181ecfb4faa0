"""Elements and their compilation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

TURN = dr.RevoluteJoint("turn")


def test_two_halves_make_one_body():
    # Two cubes side by side against the box that they make: mass 2, 1 x 1 x 2 m.
    cube = np.eye(3) / 6
    halves = dr.build(
        [
            TURN,
            dr.RigidBody(1.0, (0, 0, 0.5), cube),
            dr.FixedTranslation((0, 0, 1)),
            dr.RigidBody(1.0, (0, 0, 0.5), cube),
        ]
    )
    assert_allclose(halves.link_masses, [2.0])
    assert_allclose(halves.link_centers, [[0, 0, 1.0]])
    box = 2.0 / 12 * np.diag([5.0, 5.0, 2.0])
    assert_allclose(halves.link_inertias[0], box, atol=1e-15)


def test_bodies_before_the_first_joint_belong_to_the_base():
    robot = dr.build([dr.RigidBody(9.0, (0, 0, 0), np.eye(3)), TURN])
    assert_allclose(robot.link_masses, [0.0])


def test_topology_and_names_are_kept():
    robot = dr.build(
        [
            TURN,
            dr.Fork([[dr.PrismaticJoint("left")], [dr.RevoluteJoint("right")]]),
            dr.RevoluteJoint("on", is_virtual=True),
        ],
        name="forked",
    )
    assert robot.joint_names == ("turn", "left", "right", "on")
    assert robot.parents == (-1, 0, 0, 0)
    assert robot.joint_kinds == ("revolute", "prismatic", "revolute", "revolute")
    assert robot.is_virtual == (False, False, False, True)
    assert robot.motor_joints == (0, 1, 2)
    assert robot.flange_joint == 3


def test_a_tool_is_chosen_by_name():
    left = [dr.FixedTranslation((1, 0, 0)), dr.Tool("left")]
    right = [dr.FixedTranslation((0, 1, 0)), dr.Tool("right", (0, 0, 1.0))]
    elements = [TURN, dr.Fork([left, right])]
    robot = dr.build(elements, tool="right")
    assert_allclose(dr.forward_kinematics(robot, [0.0])[:3, 3], [0, 1, 1], atol=1e-15)
    with pytest.raises(ValueError, match=r"\(left, right\).*None"):
        dr.build(elements)
    with pytest.raises(ValueError, match=r"\(left, right\).*'up'"):
        dr.build(elements, tool="up")
    with pytest.raises(ValueError, match="`tool`"):
        dr.build([TURN], tool="up")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: dr.build([]), "at least one joint"),
        (lambda: dr.build([TURN, TURN]), r"occur twice: \['turn'\]"),
        (lambda: dr.build([TURN, dr.Tool(), dr.Tool()]), "Two tools"),
        (lambda: dr.FixedTranslation((1.0, 2.0)), "`position` must be 3"),
        (lambda: dr.FixedTranslation((1.0, 2.0, np.nan)), "`position` must be 3"),
        (lambda: dr.FixedRotation(np.diag([1.0, 1.0, -1.0])), "`rotation` must be"),
        (lambda: dr.Tool(rotation=2 * np.eye(3)), "`rotation` must be"),
        (lambda: dr.RevoluteJoint("a", (0, 0, 0)), "`axis` of 'a'"),
        (lambda: dr.RevoluteJoint("a", stiffness=0.0), "`stiffness` of 'a'"),
        (lambda: dr.PrismaticJoint("a", damping=-1.0), "`damping` of 'a'"),
        (lambda: dr.RevoluteJoint("a", lower=1.0), "lower <= home <= upper"),
        (
            lambda: dr.RigidBody(-1.0, (0, 0, 0), np.eye(3)),
            "`mass` must be finite and not",
        ),
        (lambda: dr.RigidBody(1.0, (0, 0, 0), -np.eye(3)), "positive semidef"),
        (lambda: dr.RigidBody(1.0, (0, 0, 0), np.eye(3) + np.eye(3, k=1)), "symmetric"),
    ],
)
def test_wrong_elements_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_drives_are_changed_one_by_one(planar_arm):
    changed = planar_arm.with_drives(stiffness=[1.0, 2.0])
    assert_allclose(changed.joint_stiffness, [1.0, 2.0])
    assert_allclose(changed.joint_damping, planar_arm.joint_damping)
    changed = planar_arm.with_drives(damping=np.array([3.0, 4.0]))
    assert_allclose(changed.joint_stiffness, planar_arm.joint_stiffness)
    assert_allclose(changed.joint_damping, [3.0, 4.0])
    with pytest.raises(ValueError, match="`stiffness`"):
        planar_arm.with_drives(stiffness=[1.0])
    with pytest.raises(ValueError, match="`stiffness`"):
        planar_arm.with_drives(stiffness=[1.0, 0.0])
    with pytest.raises(ValueError, match="`damping`"):
        planar_arm.with_drives(damping=[-1.0, 0.0])
