"""Robot files: what they may say, and what is said of the rest."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

GOOD = """
name = "bench"
[[elements]]
kind = "translation"
position = ["0 mm", "0 m", "50 cm"]
[[elements]]
kind = "rotation"
rpy = ["90 deg", "0 deg", "0 rad"]
[[elements]]
kind = "revolute"
name = "turn"
axis = [0, 0, 1]
lower = "-90 deg"
upper = "90 deg"
home = "30 deg"
stiffness = "1 kN*m/deg"
damping = "5 N*m*s/rad"
[[elements]]
kind = "body"
mass = "2000 g"
inertia = ["1 kg*m^2", "1 kg*m^2", "1 kg*m^2", "0.1 kg*m^2", "0 kg*m^2", "0 kg*m^2"]
[[elements]]
kind = "fork"
branches = [[
  { kind = "prismatic", name = "slide", axis = [1, 0, 0], stiffness = "2 N/mm" },
  { kind = "tool", name = "b" },
]]
[[elements]]
kind = "tool"
name = "a"
position = ["0 mm", "0 mm", "200 mm"]
"""


@pytest.fixture
def write(tmp_path):
    """Write a robot file and return its path."""

    def writer(text):
        path = tmp_path / "arm.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return writer


def test_a_file_becomes_a_robot_in_si(write):
    robot = dr.load(write(GOOD), tool="a")
    assert robot.name == "bench"
    assert robot.joint_names == ("turn", "slide")
    assert_allclose(robot.home, [np.pi / 6, 0.0])
    assert_allclose(robot.joint_lower, [-np.pi / 2, -np.inf])
    assert_allclose(robot.joint_stiffness, [1e3 * 180 / np.pi, 2e3])
    assert_allclose(robot.link_masses, [2.0, 0.0])
    assert_allclose(robot.link_inertias[0, 0, 1], 0.1)
    # The roll of 90 degrees lays the tool along -y.
    T = dr.forward_kinematics(robot, [0.3, 0.0])
    assert_allclose(T[:3, 3], [0.0, -0.2, 0.5], atol=1e-15)


def test_several_tools_must_be_chosen_from(write):
    with pytest.raises(dr.RobotFileError, match=r"arm\.toml.*\(b, a\), but is None"):
        dr.load(write(GOOD))


def test_all_faults_are_listed_at_once(write):
    text = (
        GOOD.replace('name = "bench"', "nmae = 3")
        .replace('"50 cm"', '"50 kg"')
        .replace('"1 kN*m/deg"', "5e4")
        .replace('"2000 g"', '"-1 kg"')
        .replace('"0.1 kg*m^2"', '"3 kg*m^2"')
        .replace('home = "30 deg"', 'home = "120 deg"')
        .replace("axis = [1, 0, 0]", "axis = [0, 0, 0]")
        .replace('name = "slide"', 'name = "turn"')
        .replace('kind = "rotation"', 'kind = "rotate"')
        .replace('"200 mm"', '"nan mm"')
    )
    with pytest.raises(dr.RobotFileError) as caught:
        dr.load(write(text))
    message = str(caught.value)
    for part in (
        "arm.toml: 10 faults",
        "top level.name: is missing",
        "top level.nmae: is not a known key; allowed are",
        "elements[0] (translation).position[2]: found '50 kg', but a length",
        "elements[1].kind: must be one of translation, rotation, revolute",
        "elements[2] (revolute).stiffness: found 50000.0 without a unit, but",
        "elements[2] (revolute).home: must be between",
        "elements[3] (body).mass: must be positive, but is '-1 kg'",
        "elements[3] (body).inertia: (xx, yy, zz, xy, xz, yz) must be positive sem",
        "elements[4] (fork).branches[0][0] (prismatic).axis: must be a list of 3",
        "elements[5] (tool).position[2]: found 'nan mm', but a finite number",
    ):
        assert part in message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "slide"', 'name = "turn"', "'turn' occurs more than once"),
        ('"2000 g"', '"two kg"', "mass: found 'two kg', but a mass"),
        ('"2000 g"', "2.0", "mass: found 2.0 without a unit"),
        ('"2000 g"', '"2"', "mass: found '2' without a unit"),
        # Nothing is evaluated, and radians are not left out.
        ('"2000 g"', '"2*3 kg"', "mass: found '2*3 kg'"),
        ('"2000 g"', '"9**9**9**9**9 kg"', "mass: found '9**9**9**9**9 kg'"),
        ('"2000 g"', '"1 g**9**9**9**9"', "mass: found '1 g**9**9**9**9'"),
        ('"-90 deg"', '"-1 percent"', "lower: found '-1 percent', but an angle"),
        ('damping = "5 N*m*s/rad"',
         'drive = { friction_speed = "90 Hz" }', "friction_speed: found '90 Hz', but"),
        ('["0 mm", "0 m", "50 cm"]', '["0 m"]', "position: must be a list of 3"),
        ('mass = "2000 g"', "", "mass: is missing"),
        ('["1 kg*m^2", "1 kg*m^2", "1 kg*m^2",', '["9 kg*m^2", "1 kg*m^2", "1 kg*m^2",',
         "no principal value above"),
        ('kind = "tool"\nname = "a"', 'kind = "tool"\nname = 5', "non-empty string"),
        ('axis = [0, 0, 1]', 'axis = "z"', "axis: must be a list of 3 numbers"),
        ('axis = [0, 0, 1]', 'virtual = 1', "virtual: must be true or false"),
        ("branches = [[", "branches = 5 #", "branches: must be a list of lists"),
        ("[[elements]]", "elements = 5 #", "elements: must be a list of tables"),
    ],
)  # fmt: skip
def test_one_fault_is_named(write, old, new, message):
    text = GOOD.replace(old, new)
    if "#" in new:
        head = text[: text.index("#")]
        text = head if "elements" in new else head + "\n"
    with pytest.raises(dr.RobotFileError, match="1 fault") as caught:
        dr.load(write(text), tool="a")
    assert message in str(caught.value)


def test_a_file_without_joints_is_refused(write):
    with pytest.raises(dr.RobotFileError, match="at least one joint"):
        dr.load(write('name = "nothing"\nelements = []\n'))


def test_broken_toml_is_named(write):
    with pytest.raises(dr.RobotFileError, match=r"arm\.toml: found invalid TOML"):
        dr.load(write("name = "))


@pytest.mark.parametrize("name", ["reis", "arm.urdf", "absent.toml"])
def test_what_is_not_there_is_answered_with_what_is(name):
    with pytest.raises(ValueError, match=r"built-in models are .*reis_rv130_like"):
        dr.load(name)
