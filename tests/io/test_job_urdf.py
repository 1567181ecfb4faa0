"""A job whose robot is a URDF."""

import numpy as np
import pytest

import diffmill as dm
from diffmill import load_job
from small_job import problems_of, write_job

PROGRAM = "G21 G90 G0 X-4 Y5 Z-1\nG1 X-2 F2400\nM2\n"
ROBOT = {
    "file": "gantry.urdf",
    "tool": "spindle",
    "tool_in_flange": {"position": ["0 mm", "0 mm", "-80 mm"]},
    "work_in_base": {"position": ["500 mm", "0 mm", "200 mm"]},
}
SPRINGS = {
    "joint_stiffness": ["20 N/um", "20 N/um", "10 N/um", *3 * ["1 MN*m/rad"]],
    "joint_damping": [*3 * ["2 kN*s/m"], *3 * ["1 kN*m*s/rad"]],
}
JOB = {
    "cutter.helix_angle": "30 deg",
    "stock.upper": ["6 mm", "10 mm", "0 mm"],
    "program.acceleration": "20 m/s^2",
}
DRIVES = """
[stiffness]
x = "20 N/um"
y = "20 N/um"
z = "10 N/um"
c = "1 MN*m/rad"
b = "1 MN*m/rad"
a = "1 MN*m/rad"
"""


def gantry():
    """Return a URDF with three slides, a wrist, and a counterweight that follows."""
    inertia = 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    parts = ['<robot name="gantry"><link name="bed"/>']
    below = "bed"
    for name, kind, axis in [
        *((n, "prismatic", axes[n]) for n in "xyz"),
        *((n, "revolute", axes[x]) for n, x in zip("cba", "zyx", strict=True)),
    ]:
        parts.append(
            f'<link name="link_{name}"><inertial><mass value="20"/>'
            f"<inertia {inertia}/></inertial></link>"
            f'<joint name="{name}" type="{kind}"><parent link="{below}"/>'
            f'<child link="link_{name}"/><axis xyz="{axis}"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
        below = f"link_{name}"
    parts.append(
        f'<link name="weight"><inertial><mass value="5"/><inertia {inertia}/>'
        '</inertial></link><joint name="w" type="prismatic"><parent link="link_y"/>'
        '<child link="weight"/><axis xyz="0 0 1"/><mimic joint="z" multiplier="-1"/>'
        '<limit effort="1" velocity="1"/></joint>'
        f'<link name="spindle"/><joint name="mount" type="fixed">'
        f'<parent link="{below}"/><child link="spindle"/></joint></robot>'
    )
    return "".join(parts)


@pytest.fixture
def write(tmp_path):
    """Write a job with keys of its robot beside that; return its path."""

    def write(keys=SPRINGS, robot=None, drives=DRIVES):
        (tmp_path / "gantry.urdf").write_text(robot or gantry())
        (tmp_path / "drives.toml").write_text(drives)
        changes = {f"robot.{key}": value for key, value in keys.items()}
        return write_job(tmp_path, JOB, {"robot": ROBOT}, changes, program=PROGRAM)

    return write


FROM_FILE = {"drives": "drives.toml"}


@pytest.mark.slow
def test_the_job_runs(write):
    job = load_job(write())
    assert job.robot is not None
    assert job.robot.joint_names == ("x", "y", "z", "c", "b", "a")
    assert job.robot.has_mimics
    np.testing.assert_allclose(job.robot.joint_stiffness[:3], [2e7, 2e7, 1e7])
    solution = dm.simulate(job)
    assert np.isfinite(solution.actual).all()
    # In the air nothing bends it but its own 120 kg, braked at 20 m/s^2.
    lag = np.abs(solution.actual - solution.desired).max()
    assert 1e-6 < lag < 2 * 120 * 20 / 2e7


@pytest.mark.slow
def test_springs_may_come_from_a_file(write):
    job = load_job(write(FROM_FILE))
    assert job.robot is not None
    np.testing.assert_allclose(job.robot.joint_stiffness[:3], [2e7, 2e7, 1e7])
    assert job.notes == load_job(write()).notes


def test_doubtful_inertias_are_noted(write):
    robot = gantry().replace('izz="1"', 'izz="9"', 1)
    doubt, spindle = [
        n for n in load_job(write(robot=robot)).notes if "[robot] file" in n
    ]
    assert "the inertia should be that of a body" in doubt
    assert "the spindle counts only where" in spindle


def test_a_spindle_is_given_beside_a_urdf(write):
    inertia = ["1 kg*m^2"] * 3
    spindle = f'[spindle]\nmass = "30 kg"\ninertia = {inertia}\n'
    job = load_job(write(FROM_FILE, drives=DRIVES + spindle))
    assert not any("spindle" in note for note in job.notes)
    bare = load_job(write())
    assert job.robot is not None and bare.robot is not None
    added = job.robot.link_masses.sum() - bare.robot.link_masses.sum()
    np.testing.assert_allclose(added, 30.0)


WITHOUT_MASS = gantry().replace("<inertial", "<x").replace("/inertial", "/x")


@pytest.mark.parametrize(
    ("keys", "options", "parts"),
    [
        ({}, {}, ("no stiffness for the joints x, y, z, c, b, a", "by")),
        (
            FROM_FILE,
            {"drives": DRIVES.replace('z = "10 N/um"', "")},
            ("no stiffness for the joints z, but", "drives"),
        ),
        (
            FROM_FILE,
            {"drives": DRIVES.replace("N/um", "N*m/rad")},
            ("[robot] file", "drives.toml: 3 faults", "'10 N*m/rad'"),
        ),
        ({"drives": "x.toml"}, {}, ("[robot] drives", "no such file")),
        ({"drives": "../x.toml"}, {}, ("[robot] drives", "outside the job's folder")),
        (SPRINGS | {"tool": None}, {}, ("[robot] file", "last links", "spindle")),
        (SPRINGS | {"file": "gantry.stl"}, {}, ("[robot] file", ".toml, .urdf")),
        (SPRINGS, {"robot": "<robot/>"}, ("[robot] file", "attribute name is missing")),
        (
            SPRINGS,
            {"robot": WITHOUT_MASS},
            ("found no mass on the joints x, y, z, c, b, a",),
        ),
    ],
)
def test_what_is_wrong_is_named(write, keys, options, parts):
    text = "\n".join(problems_of(write(keys, **options)))
    for part in parts:
        assert part in text


# Six axes with the dimensions of an arm of 200 kg.
AXES = {
    "a1": ("0 0 0.8", "0 0 1"),
    "a2": ("0.3 0 0", "0 1 0"),
    "a3": ("0 0 1.1", "0 1 0"),
    "a4": ("0 0 0.2", "1 0 0"),
    "a5": ("1.4 0 0", "0 1 0"),
    "a6": ("0.2 0 0", "1 0 0"),
}
CLASS = {
    "drives": "class 200 kg",
    "tool": "tool0",
    "tool_in_flange": {
        "position": ["0 mm", "0 mm", "150 mm"],
        "rpy": ["180 deg", "0 deg", "0 deg"],
    },
    "work_in_base": {"position": ["1500 mm", "0 mm", "800 mm"]},
    "joint_start": ["0 deg", "0 deg", "0 deg", "0 deg", "90 deg", "0 deg"],
}


def arm():
    """Return a URDF of an arm with six axes that turn, without springs."""
    parts, below = ['<robot name="arm"><link name="base"/>'], "base"
    for name, (place, axis) in AXES.items():
        parts.append(
            f'<link name="link_{name}"><inertial><mass value="100"/><inertia ixx="9" '
            'iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{below}"/>'
            f'<child link="link_{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
            '<limit lower="-4" upper="4" effort="1" velocity="2"/></joint>'
        )
        below = f"link_{name}"
    parts.append(
        '<link name="tool0"/><joint name="flange" type="fixed"><parent '
        f'link="{below}"/><child link="tool0"/><origin rpy="0 1.570796326794897 0"/>'
        "</joint></robot>"
    )
    return "".join(parts)


def test_drives_of_a_class_are_assumed_and_their_spread_counts(write):
    job = load_job(write(CLASS, robot=arm()))
    known = dm.robot.drive_classes()["class 200 kg"]
    assert job.robot is not None and job.simulation.scatter is not None
    np.testing.assert_allclose(job.robot.joint_stiffness, known.stiffness)
    np.testing.assert_allclose(job.robot.joint_damping, known.damping)
    # Published for the axes of a KR 210: 2.2072 MN m/rad and 4.7 kN m s/rad or less.
    assert known.stiffness[0] == pytest.approx(2.2072e6)
    assert 2e3 < known.damping[0] < 4.7e3
    assert job.simulation.scatter.stiffness == known.spread > 0
    assert job.simulation.scatter.damping == known.damping_spread > 0
    (note,) = [n for n in job.notes if "assumed" in n]
    assert note.startswith("[robot] drives: stiffness and damping are assumed")
    assert "28N6" in note and "differs by 40%" in note


def test_a_scatter_that_is_stated_is_not_assumed(write):
    text = write(CLASS | {"joint_damping": 6 * ["2 kN*m*s/rad"]}, robot=arm())
    text.write_text(text.read_text() + "\n[simulation.scatter]\nforce = 0.1\n")
    scatter = load_job(text).simulation.scatter
    assert scatter is not None
    assert (scatter.stiffness, scatter.damping, scatter.force) == (0.4, 0.0, 0.1)


@pytest.mark.parametrize(
    ("robot", "keys", "parts"),
    [
        (arm, {"drives": "class 300 kg"}, ("[robot] drives", "class 200 kg")),
        (gantry, {}, ("6 joints that turn", "x, y, z")),
        (
            None,
            {"file": None, "model": "kuka_kr210_like", "tool": None},
            ("a robot without springs", "axis_1"),
        ),
    ],
)
def test_drives_of_a_class_suit_robots_without_springs_alone(write, robot, keys, parts):
    text = "" if robot is None else robot()
    tool = {"tool": "spindle"} if robot is gantry else {}
    problems = problems_of(write(CLASS | tool | keys, robot=text))
    assert any(all(part in one for part in parts) for one in problems)
