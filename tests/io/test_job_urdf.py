"""A job whose robot is a URDF."""

import numpy as np
import pytest

import diffmill as dm
from diffmill import JobError, load_job

PROGRAM = "G21 G90 G0 X-4 Y5 Z-1\nG1 X-2 F2400\nM2\n"
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
helix_angle = "30 deg"
flute_length = "22 mm"
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
K_te = "3.0 N/mm"
K_re = "15.4 N/mm"
K_ae = "4.5 N/mm"
[stock]
lower = ["0 mm", "0 mm", "-3 mm"]
upper = ["6 mm", "10 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
acceleration = "20 m/s^2"
[robot]
file = "gantry.urdf"
tool = "spindle"
tool_in_flange = { position = ["0 mm", "0 mm", "-80 mm"] }
work_in_base = { position = ["500 mm", "0 mm", "200 mm"] }
joint_stiffness = ["20 N/um", "20 N/um", "10 N/um", "1 MN*m/rad", "1 MN*m/rad", "1 MN*m/rad"]
joint_damping = ["2 kN*s/m", "2 kN*s/m", "2 kN*s/m", "1 kN*m*s/rad", "1 kN*m*s/rad", "1 kN*m*s/rad"]
"""  # noqa: E501
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
    """Write a job with replaced text beside its robot; return its path."""

    def write(*changes, robot=None, drives=DRIVES):
        text = JOB
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "job.toml").write_text(text)
        (tmp_path / "part.ngc").write_text(PROGRAM)
        (tmp_path / "gantry.urdf").write_text(robot or gantry())
        (tmp_path / "drives.toml").write_text(drives)
        return tmp_path / "job.toml"

    return write


def without_springs(extra=""):
    """Return the change that takes the springs out of the job."""
    return (JOB[JOB.index("joint_stiffness") :], extra + "\n")


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
    job = load_job(write(without_springs('drives = "drives.toml"')))
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
    file = write(without_springs('drives = "drives.toml"'), drives=DRIVES + spindle)
    job = load_job(file)
    assert not any("spindle" in note for note in job.notes)
    bare = load_job(write())
    assert job.robot is not None and bare.robot is not None
    added = job.robot.link_masses.sum() - bare.robot.link_masses.sum()
    np.testing.assert_allclose(added, 30.0)


@pytest.mark.parametrize(
    ("changes", "options", "parts"),
    [
        (
            [without_springs()],
            {},
            ("no stiffness for the joints x, y, z, c, b, a", "by"),
        ),
        (
            [without_springs('drives = "drives.toml"')],
            {"drives": DRIVES.replace('z = "10 N/um"', "")},
            ("no stiffness for the joints z, but", "drives"),
        ),
        (
            [without_springs('drives = "drives.toml"')],
            {"drives": DRIVES.replace("N/um", "N*m/rad")},
            ("[robot] file", "drives.toml: 3 faults", "'10 N*m/rad'"),
        ),
        (
            [without_springs('drives = "x.toml"')],
            {},
            ("[robot] drives", "no such file"),
        ),
        (
            [without_springs('drives = "../x.toml"')],
            {},
            ("[robot] drives", "outside the job's folder"),
        ),
        ([('tool = "spindle"\n', "")], {}, ("[robot] file", "last links", "spindle")),
        ([("gantry.urdf", "gantry.stl")], {}, ("[robot] file", ".toml, .urdf")),
        ([], {"robot": "<robot/>"}, ("[robot] file", "attribute name is missing")),
        (
            [],
            {"robot": gantry().replace("<inertial", "<x").replace("/inertial", "/x")},
            ("found no mass on the joints x, y, z, c, b, a",),
        ),
    ],
)
def test_what_is_wrong_is_named(write, changes, options, parts):
    with pytest.raises(JobError) as caught:
        load_job(write(*changes, **options))
    for part in parts:
        assert part in str(caught.value)
