"""URDF: every kind of joint, the tree that elements make, and what is refused."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

INERTIAL = """
<inertial>
  <origin xyz="0.1 0 {z}" rpy="0.3 -0.2 0.1"/>
  <mass value="{mass}"/>
  <inertia ixx="0.05" iyy="0.06" izz="0.04" ixy="0.003" ixz="-0.002" iyz="0.001"/>
</inertial>
"""
# A fork of two branches, the one with the tool carrying a fixed load and a follower;
# the children come neither in the order of the file nor in that of the alphabet.
GOOD = f"""<?xml version="1.0" encoding="utf-8"?>
<robot name="bench" version="1.0">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base">{INERTIAL.format(mass=40, z=0)}</link>
  <link name="column">
    {INERTIAL.format(mass=8, z=0.2)}
    <visual><geometry><mesh filename="package://x/y.stl"/></geometry></visual>
  </link>
  <link name="wheel">{INERTIAL.format(mass=1, z=0)}</link>
  <link name="arm">{INERTIAL.format(mass=4, z=0.1)}</link>
  <link name="load">{INERTIAL.format(mass=2, z=-0.1)}</link>
  <link name="jaw">{INERTIAL.format(mass=0.5, z=0)}</link>
  <link name="tip"/>
  <joint name="turn" type="revolute">
    <child link="column"/> <parent link="base"/>
    <origin rpy="0 0 0.5" xyz="0 0 0.3"/>
    <axis xyz="0 0 2"/>
    <limit lower="0.2" upper="3" effort="100" velocity="1"/>
    <dynamics damping="87.098" friction="3.1290"/>
  </joint>
  <joint name="spin" type="continuous">
    <parent link="column"/> <child link="wheel"/>
    <origin xyz="0 0.2 0.1"/>
    <axis xyz="0 1 0"/>
    <limit effort="1" velocity="2"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="column"/> <child link="arm"/>
    <origin xyz="0 0 0.5" rpy="1.2 0.3 -0.4"/>
    <axis xyz="1 0 -0.5"/>
    <limit upper="0.8" effort="1" velocity="0.5"/>
  </joint>
  <joint name="hold" type="fixed">
    <parent link="arm"/> <child link="load"/>
    <origin xyz="0.3 0 0" rpy="0 0.7 0"/>
  </joint>
  <joint name="grip" type="revolute">
    <parent link="load"/> <child link="jaw"/>
    <origin xyz="0 0 0.2"/>
    <mimic joint="spin" multiplier="-0.5" offset="0.1"/>
  </joint>
  <joint name="end" type="fixed">
    <parent link="jaw"/> <child link="tip"/> <origin xyz="0 0 0.15"/>
  </joint>
  <transmission name="t"><joint name="turn"/><actuator name="m"/></transmission>
  <gazebo reference="arm"><gravity>true</gravity></gazebo>
</robot>
"""


@pytest.fixture
def write(tmp_path):
    """Write a URDF and return its path."""

    def writer(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return writer


def body(mass, z):
    """Return the mass of `INERTIAL`."""
    R = dr.rpy_matrix(0.3, -0.2, 0.1)
    own = [[0.05, 0.003, -0.002], [0.003, 0.06, 0.001], [-0.002, 0.001, 0.04]]
    inertia = R @ np.array(own) @ R.T
    return dr.RigidBody(mass, (0.1, 0.0, z), (inertia + inertia.T) / 2)


def bench():
    """Return `GOOD` by elements."""
    arm = [
        dr.FixedTranslation((0, 0, 0.5)),
        dr.FixedRotation(dr.rpy_matrix(1.2, 0.3, -0.4)),
        dr.PrismaticJoint("slide", (1, 0, -0.5), lower=0.0, upper=0.8, speed=0.5),
        body(4.0, 0.1),
        dr.FixedTranslation((0.3, 0, 0)),
        dr.FixedRotation(dr.rpy_matrix(0, 0.7, 0)),
        body(2.0, -0.1),
        dr.FixedTranslation((0, 0, 0.2)),
        dr.RevoluteJoint("grip", (1, 0, 0), mimic=dr.Mimic("spin", -0.5, 0.1)),
        body(0.5, 0.0),
        dr.FixedTranslation((0, 0, 0.15)),
        dr.Tool("tip"),
    ]
    wheel = [
        dr.FixedTranslation((0, 0.2, 0.1)),
        dr.RevoluteJoint("spin", (0, 1, 0), speed=2.0),
        body(1.0, 0.0),
    ]
    return dr.build(
        [
            dr.FixedTranslation((0, 0, 0.3)),
            dr.FixedRotation(dr.rpy_matrix(0, 0, 0.5)),
            dr.RevoluteJoint(
                "turn", (0, 0, 1), lower=0.2, upper=3.0, home=0.2, speed=1.0
            ),
            body(8.0, 0.2),
            dr.Fork([arm, wheel]),
        ],
        name="bench",
    )


def test_a_urdf_is_the_same_robot_as_its_elements(write):
    robot, expected = dr.load(write(GOOD), tool="tip"), bench()
    assert robot.joint_names == ("turn", "slide", "spin")
    assert jax.tree.structure(robot) == jax.tree.structure(expected)
    for found, wanted in zip(
        jax.tree.leaves(robot), jax.tree.leaves(expected), strict=True
    ):
        assert_allclose(found, wanted, rtol=1e-15, atol=1e-15)
    assert_allclose(robot.joint_lower, [0.2, 0.0, -np.inf])
    assert_allclose(robot.home, [0.2, 0.0, 0.0])
    assert np.isinf(robot.joint_stiffness).all() and not robot.joint_damping.any()


def test_the_tool_is_the_only_leaf_or_must_be_chosen(write):
    with pytest.raises(dr.RobotFileError, match="wheel, tip"):
        dr.load(write(GOOD))
    with pytest.raises(dr.RobotFileError, match="'nose'"):
        dr.load(write(GOOD), tool="nose")
    inner = dr.load(write(GOOD), tool="arm")
    assert_allclose(inner.T_joint_flange[:3, 3], 0.0)
    assert inner.flange_joint == 1
    assert dr.load(write(SMALL)).name == "small"


SMALL = """<robot name="small">
<link name="a"/>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute">
<parent link="a"/>
<child link="b"/>
<axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/>
</joint>
</robot>"""  # noqa: E501


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('xyz="0 0 1"', 'xyz="0 1"', "line 4, joint 'j', axis: xyz must be 3 finite n"),
        ('xyz="0 0 1"', 'xyz="0 0 nan"', "must be 3 finite numbers, but is '0 0 nan'"),
        ('xyz="0 0 1"', 'xyz="0 0 1_0"', "must be 3 finite numbers, but is '0 0 1_0'"),
        ('xyz="0 0 1"', 'xyz="0 0 0"', "axis: xyz must be not zero"),
        ('xyz="0 0 1"', 'xyz="0 0 1e-300"', "axis: xyz must be not zero"),
        ('"revolute"', '"floating"', "type must be revolute, continuous, prismatic or"),
        ('"revolute"', '"planar"', "or fixed, but is 'planar'"),
        ('type="revolute"', "", "attribute type is missing or empty"),
        ('"revolute"', '"fixed"', "there is no movable joint"),
        ('lower="-1"', 'lower="2"', "lower must not be above upper, but is 2.0 above"),
        ('lower="-1" upper="1"', 'lower="inf" upper="inf"', "finite position between"),
        ('lower="-1"', 'lower="low"', "limit: lower must be a number, but is 'low'"),
        ('velocity="1"', 'velocity="-2"', "limit: velocity must not be negative"),
        ('effort="1"', 'effort=""', "limit: effort must be a number, but is ''"),
        ('<parent link="a"/>', "", "joint 'j': <parent> is missing"),
        ('<parent link="a"/>', "<parent/>", "parent: attribute link is missing"),
        ('<parent link="a"/>', '<parent link="z"/>', "the parent 'z' is no link"),
        ('<child link="b"/>', '<child link="z"/>', "the child 'z' is no link"),
        ('<child link="b"/>', '<child link="a"/>', "the joints form a loop: a"),
        ('<link name="a"/>', '<link name="a"/><link name="c"/>', "one root link, but"),
        ('<link name="a"/>', '<link name="a"/><link name="a"/>', "'a' occurs more"),
        ('<link name="a"/>', '<link name="a"/><link/>', "link: attribute name is miss"),
        ('name="small"', "", "line 1, robot: attribute name is missing"),
        ('name="small"', 'name="s" version="2.0"', "version must be 1.0, 1.1 or 1.2"),
        ('<mass value="1"/>', "", "link 'b', inertial: <mass> is missing"),
        ('value="1"', 'value="-1"', "link 'b', mass: value must be not negative"),
        ('value="1"', 'value="1 kg"', "value must be a finite number, but is '1 kg'"),
        ('ixy="0"', "", "link 'b', inertia: attribute ixy is missing"),
        ('ixx="1"', 'ixx="1e999"', "ixx must be a finite number, but is '1e999'"),
        ('ixx="1"', 'ixx="1e200"', "ixx must be a finite number, but is '1e200'"),
        ("</joint>", '<mimic joint="j"/></joint>', "'j' mimics itself"),
        ("</joint>", '<mimic joint="k"/></joint>', "'j' mimics 'k', which is no"),
        ("</joint>", '<mimic joint="k" offset="x"/></joint>', "mimic: offset must be"),
        ("</joint>", "", "not valid XML: line 10: mismatched tag"),
        ("<robot", "<xrobot", "not valid XML"),
    ],
)  # fmt: skip
def test_one_fault_is_named(write, old, new, message):
    assert old in SMALL
    with pytest.raises(dr.RobotFileError, match=r"arm\.urdf: ") as caught:
        dr.load(write(SMALL.replace(old, new)))
    assert message in str(caught.value)
    assert "2 faults" not in str(caught.value)


def test_all_faults_are_listed_at_once(write):
    text = SMALL.replace("0 0 1", "0 0").replace('"-1"', '"?"').replace("b", "c", 1)
    with pytest.raises(dr.RobotFileError, match="2 faults") as caught:
        dr.load(write(text.replace("<rocot", "<robot")))
    assert "axis: xyz" in str(caught.value) and "limit: lower" in str(caught.value)


BOMB = """<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>"""
LEAK = """<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]>"""


@pytest.mark.parametrize("head", [BOMB, LEAK])
def test_entities_are_refused(write, head):
    text = head + SMALL.replace('name="small"', 'name="&a;"')
    with pytest.raises(dr.RobotFileError):
        dr.load(write(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not valid XML"),
        ("\0", "not valid XML"),
        ('<?xml version="1.0" encoding="no-such"?><robot name="r"/>', "not valid XML"),
        ('<robot name="r"/>', "there is no link"),
        ("<mujoco/>", "root element must be <robot>, but is <mujoco>"),
        ('<robot name="r"><xacro:macro name="m"/></robot>', "expand them with xacro"),
    ],
)
def test_other_files_are_refused(write, text, message):
    with pytest.raises(dr.RobotFileError, match=message):
        dr.load(write(text, "arm.xml"))


def test_what_ros_allows_and_what_it_should(write):
    text = SMALL.replace('<link name="a"/>', "").replace('link="a"', 'link="world"')
    text = text.replace('<limit lower="-1" upper="1" effort="1" velocity="1"/>', "")
    text = text.replace('<axis xyz="0 0 1"/>', '<origin quat_xyzw="0 0 3 4"/>')
    robot = dr.load(write(text))
    assert robot.joint_lower[0] == -np.inf and robot.joint_upper[0] == np.inf
    # The axis is x where none is named; the quaternion turns by 2 atan(3 / 4).
    T = dr.forward_kinematics(robot, [0.0])
    assert_allclose(T[:2, 0], [7 / 25, 24 / 25], atol=1e-15)
    assert_allclose(dr.jacobian(robot, [0.3])[3:, 0], [7 / 25, 24 / 25, 0], atol=1e-15)


def test_bodies_without_extent_and_without_mass(write):
    # A point mass, and a rotor that is an inertia alone.
    point = SMALL.replace('ixx="1" iyy="1" izz="1"', 'ixx="0" iyy="0" izz="0"')
    point = point.replace('<mass value="1"/>', '<mass value="3"/><origin xyz="2 0 0"/>')
    assert_allclose(dr.mass_matrix(dr.load(write(point)), [0.4]), [[12.0]])
    rotor = write(SMALL.replace('<mass value="1"/>', '<mass value="0"/>'))
    with pytest.warns(dr.RobotFileWarning, match="joints j move less"):
        robot = dr.load(rotor)
    assert_allclose(dr.mass_matrix(robot, [0.4]), [[1.0]])


def test_an_impossible_inertia_is_read_with_a_warning(write):
    text = SMALL.replace('izz="1"', 'izz="5"')
    with pytest.warns(
        dr.RobotFileWarning, match="line 3, link 'b': the inertia should"
    ):
        robot = dr.load(write(text))
    assert_allclose(dr.mass_matrix(robot, [0.0]), [[5.0]])
    text = SMALL.replace('ixx="1"', 'ixx="-1"')
    with pytest.warns(dr.RobotFileWarning, match="should be positive semidefinite"):
        dr.load(write(text))


def test_links_without_mass(write):
    bare = GOOD.replace(INERTIAL.format(mass=1, z=0), "")
    # The follower's mass hangs on `spin`; without it nothing does.
    with pytest.warns(dr.RobotFileWarning, match=r"taken as massless: \['wheel'\]$"):
        robot = dr.load(write(bare), tool="tip")
    assert np.linalg.eigvalsh(dr.mass_matrix(robot, robot.home))[0] > 1e-3
    with pytest.warns(
        dr.RobotFileWarning, match="kinematics only.* on the joints spin"
    ):
        robot = dr.load(write(bare.replace("<mimic", "<nothing")), tool="wheel")
    q = jnp.array([0.3, 0.1, 0.2, 0.5])
    robot = robot.with_drives(stiffness=np.full(4, 1e5))
    assert np.isfinite(dr.forward_kinematics(robot, q)).all()
    zero = np.zeros(4)
    with pytest.raises(ValueError, match=r"'bench'.* spin "):
        dr.forward_dynamics(robot, q, zero, zero)
    under_jit = jax.jit(dr.forward_dynamics)(robot, q, zero, zero)
    assert np.isnan(under_jit).any()
    with pytest.raises(ValueError):
        dr.natural_frequencies(robot, q)


def test_a_mass_matrix_that_is_singular_by_the_structure_is_refused():
    # Two slides are parallel and share one mass: only their sum is felt.
    slide = lambda name: dr.PrismaticJoint(name, (1, 2, 3))
    both = dr.build([slide("a"), slide("b"), dr.RigidBody(3.0, (0, 0, 0), np.eye(3))])
    with pytest.raises(ValueError):
        dr.forward_dynamics(both, [0.1, 0.2], [0.0, 0.0], [1.0, 2.0])


def test_springs_come_from_a_file_beside_the_urdf(write):
    drives = 'source = "a bench"\n[stiffness]\nturn = "2 MN*m/rad"\nslide = "5 N/um"\n'
    drives += '[damping]\nturn = "30 N*m*s/rad"\n'
    urdf = write(GOOD)
    robot = dr.load(urdf, tool="tip", drives=write(drives, "drives.toml"))
    assert_allclose(robot.joint_stiffness, [2e6, 5e6, np.inf])
    assert_allclose(robot.joint_damping, [30.0, 0.0, 0.0])
    bad = drives.replace("turn", "trun", 1).replace("5 N/um", "-5 N/um")
    bad = bad.replace("[damping]", "[dampers]")
    with pytest.raises(dr.RobotFileError, match=r"drives\.toml: 3 faults") as caught:
        dr.load(urdf, tool="tip", drives=write(bad, "drives.toml"))
    for part in (
        "stiffness.trun: is not a known key; allowed are kind, slide, source, spin",
        "stiffness.slide: must be positive, but is '-5 N/um'",
        "top level.dampers: is not a known key",
    ):
        assert part in str(caught.value)
    with pytest.raises(dr.RobotFileError, match="stiffness: "):
        dr.load(urdf, tool="tip", drives=write("stiffness = 3\n", "drives.toml"))


def test_a_good_file_gives_no_warning(write):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dr.load(write(GOOD), tool="tip")


@pytest.mark.parametrize(
    ("right", "slip", "parts"),
    [
        ('<origin xyz="0 0 0.5"', '<orgin xyz="0 0 0.5"', ("<orgin>", "<origin>")),
        ('upper="3"', 'uper="3"', ("attribute uper", "'upper'")),
        ('<mass value="8"/>', '<mas value="8"/>', ("<mas>", "<mass>")),
        ('<axis xyz="0 1 0"/>', '<axes xyz="0 1 0"/>', ("<axes>", "<axis>")),
        ('multiplier="-0.5"', 'multipler="-0.5"', ("multipler", "'multiplier'")),
    ],
)
def test_a_misspelt_name_is_a_fault(write, right, slip, parts):
    assert right in GOOD
    with pytest.raises(dr.RobotFileError, match="line ") as error:
        dr.load(write(GOOD.replace(right, slip, 1)), tool="tip")
    for part in parts:
        assert part in str(error.value)


@pytest.mark.parametrize(
    ("right", "slip", "part"),
    [
        ('lower="0.2" upper="3"', 'lower="-185" upper="185"', "in degrees?"),
        ('<origin xyz="0 0 0.5"', '<origin xyz="0 0 500"', "in millimetres?"),
        ('upper="0.8"', 'upper="800"', "in millimetres?"),
        ('<origin xyz="0.1 0 0.2"', '<origin xyz="100 0 200"', "in millimetres?"),
        ('ixx="0.05"', 'ixx="5e4"', "is it in kg m^2?"),
        ('<mass value="0.5"/>', '<mass value="5e-4"/>', "is it in kg m^2?"),
    ],
)
def test_a_slip_in_a_unit_is_noted(write, right, slip, part):
    assert right in GOOD
    with pytest.warns(dr.RobotFileWarning) as noted:
        dr.load(write(GOOD.replace(right, slip)), tool="tip")
    assert part in " ".join(str(item.message) for item in noted)


def test_a_joint_that_moves_next_to_nothing_is_noted(write):
    grain = """<robot name="grain"><link name="base"/><link name="tip"><inertial>
    <mass value="1e-3"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0"
    iyz="0"/></inertial></link><joint name="spin" type="continuous">
    <parent link="base"/><child link="tip"/></joint></robot>"""
    with pytest.warns(dr.RobotFileWarning, match="spin move less than 10 g") as noted:
        dr.load(write(grain))
    assert len(noted) == 1


def test_what_is_no_urdf_is_refused_with_the_reason(write):
    spaced = GOOD.replace("<robot ", '<u:robot xmlns:u="http://x" ')
    spaced = spaced.replace("</robot>", "</u:robot>")
    with pytest.raises(dr.RobotFileError, match="'u:'"):
        dr.load(write(spaced))
    with pytest.raises(ValueError):
        dr.load(write("<robot/>", "arm.xacro"))
    with pytest.raises(dr.RobotFileError):
        dr.load(write("[robot]\nrigid = true\n", "job.toml"))


def arm(**changes):
    """Return an arm of one joint with some of its text changed."""
    text = """<robot name="arm">
  <link name="base"/>
  <link name="l1">
    <inertial>
      <origin xyz="0.3 0 0"/> <mass value="10"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.4" iyz="0" izz="0.4"/>
    </inertial>
  </link>
  <joint name="j1" type="revolute">
    <parent link="base"/> <child link="l1"/> <axis xyz="0 0 1"/>
    <origin xyz="0 0 0.5" rpy="0 0 0"/>
    <limit lower="-2" upper="2" effort="80" velocity="7"/>
  </joint>
</robot>"""
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return text


def test_attributes_of_a_vendor_beside_the_right_one_pass(write):
    more = ('velocity="7"', 'velocity="7" gear_velocity="10" k_velocity="3"')
    speed = dr.load(write(arm(more=more))).joint_speed
    assert speed is not None and float(speed[0]) == 7
    alone = ('velocity="7"', 'gear_velocity="10"')
    with pytest.raises(dr.RobotFileError, match="gear_velocity"):
        dr.load(write(arm(alone=alone)))


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ('rpy="0 0 0"', 'rpy="0 90 0"', "rpy 0 90 0 rad is more than a turn"),
        ('lower="-2" upper="2"', 'lower="0" upper="0"', "0 to 0 leaves the joint no"),
    ],
)
def test_degrees_and_limits_that_were_not_filled_in_are_noted(write, old, new, note):
    with pytest.warns(dr.RobotFileWarning, match=note):
        dr.load(write(arm(one=(old, new))))


def test_a_whole_turn_is_no_slip(write):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dr.load(write(arm(turn=('rpy="0 0 0"', 'rpy="0 0 -6.283185"'))))


def test_of_several_leaves_the_tool_is_asked_for_by_name(write):
    more = """<link name="tool0"/><link name="camera"/>
  <joint name="a" type="fixed"><parent link="l1"/><child link="tool0"/></joint>
  <joint name="b" type="fixed"><parent link="l1"/><child link="camera"/></joint>
</robot>"""
    file = write(arm(more=("</robot>", more)))
    with pytest.raises(dr.RobotFileError, match=r"--tool tool0.*are tool0, camera"):
        dr.load(file)
    assert dr.load(file, tool="tool0").joint_names == ("j1",)
