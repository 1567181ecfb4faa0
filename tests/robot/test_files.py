"""Robot files: what they may say, and what is said of the rest."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr
from small_job import arm_text, body

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
    with pytest.warns(dr.RobotFileWarning, match="hangs on the joints slide"):
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
    with pytest.raises(dr.RobotFileError, match=r"arm\.toml.*\(b, a\).*None"):
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
    with pytest.raises(dr.RobotFileError):
        dr.load(write('name = "nothing"\nelements = []\n'))


def test_broken_toml_is_named(write):
    with pytest.raises(dr.RobotFileError, match=r"arm\.toml"):
        dr.load(write("name = "))


@pytest.mark.parametrize("name", ["reis", "arm.urdf", "absent.toml"])
def test_what_is_not_there_is_answered_with_what_is(name):
    with pytest.raises(ValueError, match="reis_rv130_like") as caught:
        dr.load(name)
    assert name in str(caught.value)


def dh_matrix(theta, d, a, alpha, convention):
    """Return the textbook's matrix of a row of Denavit and Hartenberg's."""
    (ct, st), (ca, sa) = ((np.cos(x), np.sin(x)) for x in (theta, alpha))
    if convention == "standard":
        rows = [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
        ]
    else:
        rows = [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
        ]
    return np.array([*rows, [0, 0, 0, 1]])


# theta [deg], d, a [mm], alpha [deg] of a PUMA 560's first joints, with offsets.
ROWS = [(10, 660, 0, -90), (-30, 149, 432, 5), (90, 20, -20, 90)]


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_rows_of_denavit_and_hartenberg(tmp_path, convention):
    text = 'name = "rows"\n'
    for i, (theta, d, a, alpha) in enumerate(ROWS):
        joint = f'[[elements]]\nkind = "revolute"\nname = "joint_{i + 1}"\n'
        row = (
            f'[[elements]]\nkind = "dh"\ntheta = "{theta} deg"\nd = "{d} mm"\n'
            f'a = "{a} mm"\nalpha = "{alpha} deg"\n'
        )
        if convention == "modified":
            row += 'convention = "modified"\n'
        text += joint + row if convention == "standard" else row + joint
    (tmp_path / "rows.toml").write_text(text)
    with pytest.warns(dr.RobotFileWarning, match="usable for kinematics only"):
        robot = dr.load(tmp_path / "rows.toml")
    q = np.array([0.3, -0.4, 0.9])
    T = np.eye(4)
    for angle, (theta, d, a, alpha) in zip(q, ROWS, strict=True):
        turn = angle + np.deg2rad(theta)
        T = T @ dh_matrix(turn, d / 1e3, a / 1e3, np.deg2rad(alpha), convention)
    assert_allclose(dr.forward_kinematics(robot, q), T, atol=1e-14)


def coupled(joint):
    """Return an arm whose forearm's joint is coupled with a joint."""
    turn = {"kind": "revolute", "axis": [0, 1, 0]}
    link = lambda *way: {"kind": "translation", "position": [f"{x} mm" for x in way]}
    return arm_text(
        turn | {"name": "two", "stiffness": "3e5 N*m/rad"},
        link(0, 0, 800),
        turn
        | {"name": "three", "stiffness": "2e5 N*m/rad"}
        | {"coupled": {"joint": joint, "ratio": -1.0}},
        link(600, 0, 0),
        body("50 kg"),
    )


def test_a_joint_is_coupled_with_another(tmp_path):
    # A parallelogram: the forearm's angle to the ground is the third motor's.
    (tmp_path / "arm.toml").write_text(coupled("two"))
    robot = dr.load(tmp_path / "arm.toml")
    assert robot.joint_names == ("two", "three")
    q2, q3 = 0.4, -0.2
    x, z = (0.8 * f(q2) for f in (np.sin, np.cos))
    T = np.asarray(dr.forward_kinematics(robot, [q2, q3]))
    assert_allclose(T[:3, 3], [x + 0.6 * np.cos(q3), 0, z - 0.6 * np.sin(q3)])
    # So the weight of the forearm's end turns each motor by its own lever alone.
    assert_allclose(
        dr.gravity_forces(robot, [q2, q3]),
        [-50 * 9.81 * x, -50 * 9.81 * 0.6 * np.cos(q3)],
    )
    (tmp_path / "arm.toml").write_text(coupled("tow"))
    with pytest.raises(dr.RobotFileError, match="'tow'"):
        dr.load(tmp_path / "arm.toml")
    (tmp_path / "arm.toml").write_text(coupled("three"))
    with pytest.raises(dr.RobotFileError, match=r"1 fault(.|\n)*another joint, but is"):
        dr.load(tmp_path / "arm.toml")
