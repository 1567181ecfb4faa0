"""What a file adds to a robot: springs, drives, locked joints, a spindle, a tilt."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

BOX = ["0.4 kg*m^2", "0.3 kg*m^2", "0.2 kg*m^2"]
MADE = np.diag([0.4, 0.3, 0.2])


def link(mass):
    """Return a link of the chain."""
    return [
        dr.RigidBody(mass, (0.1, 0.0, 0.1), MADE),
        dr.FixedTranslation((0.3, 0.0, 0.2)),
    ]


def urdf(*joints):
    """Return a chain of links of 4, 5, ... kg as a URDF."""
    parts = ['<robot name="chain"><link name="link_0"/>']
    for i, (name, kind, axis, more) in enumerate(joints):
        origin = "0 0 0" if i == 0 else "0.3 0 0.2"
        parts.append(
            f'<link name="link_{i + 1}"><inertial><origin xyz="0.1 0 0.1"/>'
            f'<mass value="{4 + i}"/><inertia ixx="0.4" iyy="0.3" izz="0.2" ixy="0" '
            f'ixz="0" iyz="0"/></inertial></link><joint name="{name}" type="{kind}">'
            f'<parent link="link_{i}"/><child link="link_{i + 1}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{more}</joint>'
        )
    i = len(joints)
    return "".join(
        [
            *parts,
            f'<link name="tool0"/><joint name="end" type="fixed"><parent link="link_{i}'
            '"/><child link="tool0"/><origin xyz="0.3 0 0.2"/></joint></robot>',
        ]
    )


RANGE = '<limit lower="-1" upper="1" effort="1" velocity="0"/>'
CHAIN = (
    ("track", "prismatic", "0 1 0", RANGE),
    ("turn", "continuous", "0 0 1", ""),
    ("lift", "continuous", "0 1 1", ""),
    ("finger", "continuous", "1 0 0", '<mimic joint="track" multiplier="2"/>'),
)


@pytest.fixture
def load(tmp_path):
    """Load the chain with a file beside it."""

    def loader(text="", robot=None):
        (tmp_path / "arm.urdf").write_text(robot or urdf(*CHAIN))
        (tmp_path / "drives.toml").write_text(text)
        return dr.load(tmp_path / "arm.urdf", drives=tmp_path / "drives.toml")

    return loader


def same_dynamics(robot, expected, q):
    """Assert that two robots move alike, springs included."""
    assert robot.joint_names == expected.joint_names
    for measure in (dr.forward_kinematics, dr.mass_matrix, dr.gravity_forces):
        assert_allclose(measure(robot, q), measure(expected, q), atol=1e-12)
    assert_allclose(robot.joint_stiffness, expected.joint_stiffness)


def test_a_locked_joint_is_none_and_so_is_what_follows_it(load):
    robot = load('[locked]\ntrack = "250 mm"\n')
    expected = dr.build(
        [
            dr.FixedTranslation((0.3, 0.25, 0.2)),
            dr.RevoluteJoint("turn", (0, 0, 1)),
            *link(5.0),
            dr.RevoluteJoint("lift", (0, 1, 1)),
            *link(6.0),
            dr.FixedRotation(dr.rpy_matrix(0.5, 0, 0)),
            *link(7.0),
        ]
    )
    same_dynamics(robot, expected, [0.3, -0.7])


def test_a_turned_joint_is_locked_about_its_own_axis(load):
    whole, robot = load(), load('[locked]\nlift = "40 deg"\n')
    q = [0.1, 0.4]
    at = np.array([0.1, 0.4, np.deg2rad(40.0)])
    assert robot.joint_names == ("track", "turn")
    assert_allclose(
        dr.forward_kinematics(robot, q), dr.forward_kinematics(whole, at), atol=1e-14
    )
    M = dr.mass_matrix(whole, at)
    assert_allclose(dr.mass_matrix(robot, q), M[:2, :2], atol=1e-12)


SPINDLE = f"""[spindle]
mass = "30 kg"
center_of_mass = ["0 mm", "50 mm", "80 mm"]
inertia = {BOX}
"""
SPRINGS = """[stiffness]
track = "1e8 N/m"
turn = "1e6 N*m/rad"
lift = "1e6 N*m/rad"
"""


def test_a_spindle_hangs_on_the_flange(load):
    bare, robot = load(), load(SPINDLE)
    q = np.array([0.1, 0.4, -0.8])
    # What it adds to the weight: 30 kg at its centre.
    center = bare.with_tool(np.array(_shift(0.0, 0.05, 0.08)))
    J = np.asarray(dr.jacobian(center, q))
    added = dr.mass_matrix(robot, q) - dr.mass_matrix(bare, q)
    R = np.asarray(dr.forward_kinematics(bare, q))[:3, :3]
    expected = 30 * J[:3].T @ J[:3] + J[3:].T @ R @ MADE @ R.T @ J[3:]
    assert_allclose(added, expected, atol=1e-11)


def _shift(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def test_a_spindle_of_ones_own_replaces_the_built_in_one(tmp_path):
    (tmp_path / "cell.toml").write_text(SPINDLE)
    for name in dr.built_in_models():
        bare = dr.load(name)
        robot = dr.load(name, drives=tmp_path / "cell.toml")
        assert 1.0 < bare.link_masses.sum() + 30 - robot.link_masses.sum() <= 30.0


def test_modes_fall_with_a_spindle(load):
    q = [0.0, 0.0, 0.0]
    bare = dr.natural_frequencies(load(SPRINGS), q)
    assert (dr.natural_frequencies(load(SPRINGS + SPINDLE), q) < 0.9 * bare).all()


def test_a_tilted_base_feels_gravity_from_aside(load):
    q = np.array([0.2, 0.4, -0.8])
    robot = load('base_rpy = ["20 deg", "90 deg", "0 deg"]\n')
    R = np.asarray(dr.rpy_matrix(np.deg2rad(20.0), np.deg2rad(90.0), 0.0))
    assert_allclose(robot.gravity, R.T @ [0, 0, -9.81], atol=1e-14)
    # The torque of the weight is the slope of its potential energy in the world.
    upright = load(SPRINGS)
    step = 1e-5 * np.eye(3)
    slope = [
        (_height(upright, q + d, R) - _height(upright, q - d, R)) / 2e-5 for d in step
    ]
    assert_allclose(dr.gravity_forces(robot, q), 9.81 * np.array(slope), rtol=1e-8)


def _height(robot, q, R_world_base):
    """Return mass times height of a robot in the world [kg m]."""
    tilted = dataclasses.replace(
        robot, gravity=jnp.asarray(R_world_base.T @ [0.0, 0.0, -1.0])
    )
    return float(dr.mechanical_energy(tilted, q, np.zeros(3), q))


def test_drives_have_backlash_friction_and_motors(load):
    text = '[drive.turn]\nbacklash = "0.1 mrad"\ncoulomb_friction = "30 N*m"\n'
    robot = load(text)
    assert_allclose(robot.backlash.gap, [0.0, 1e-4, 0.0])
    assert_allclose(robot.friction.coulomb, [0.0, 30.0, 0.0])
    servo = "".join(
        f'[drive.{name}]\nmotor_inertia = "2 {mass}"\nservo_stiffness = "3e5 {unit}"\n'
        for name, mass, unit in (
            ("track", "kg", "N/m"),
            ("turn", "kg*m^2", "N*m/rad"),
            ("lift", "kg*m^2", "N*m/rad"),
        )
    )
    assert_allclose(load(servo).motors.stiffness, 3e5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[locked]\ntrack = "2 m"\n', "locked.track: must be within the joint's lim"),
        ('[locked]\nfinger = "0 deg"\n', "allowed are kind, lift, source, track, turn"),
        ('[locked]\nturn = "0 m"\n', "locked.turn: "),
        ('[drive.turn]\nbacklash = "1 mm"\n', "drive.turn.backlash"),
        ('[drive.turn]\nslack = "1 mrad"\n', "drive.turn.slack: is not a known key"),
        ("drive = 1\n", "drive: must be a table"),
        ('[spindle]\nmass = "3 kg"\n', "spindle.inertia: is missing"),
        ('base_rpy = ["1 deg"]\n', "base_rpy: must be a list of 3"),
        (SPRINGS + '[locked]\nturn = "0 deg"\n', "stiffness.turn: is not a known"),
    ],
)
def test_faults_are_named(load, text, message):
    with pytest.raises(dr.RobotFileError, match=r"drives\.toml") as caught:
        load(text)
    assert message in str(caught.value)
