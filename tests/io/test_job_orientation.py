"""What a job takes from the frames of its program, and what its arm does of them."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import load_job
from diffmill.cli import main
from diffmill.robot import forward_kinematics
from diffmill.sim import JobKinematics
from small_job import problems_of, write_job

JOB = {
    "stock.lower": ["0 mm", "-20 mm", "-8 mm"],
    "stock.upper": ["5 mm", "20 mm", "0 mm"],
    "stock.spacing": "0.25 mm",
}
ARM = {"model": "kuka_kr210_like"}
PLACED = ARM | {"work_in_base": {"position": ["1800 mm", "0 mm", "900 mm"]}}
BASE = "$BASE={X 1800,Y 0,Z 900,A 90,B 0,C 0}"


def krl(angles, frames=""):
    a, b, c = angles
    place = f"{{X -6,Y 0,Z 1,A {a},B {b},C {c}}}"
    rows = ["DEF part( )", frames, "$VEL.CP=0.02", f"PTP {place}"]
    return "\n".join([*rows, "LIN {Z -1}", "LIN {X 2}", "END"])


@pytest.fixture
def write(tmp_path):
    def write(text, robot=None, name="part.src", **changes):
        (tmp_path / name).write_text(text)
        changes = {key.replace("_", ".", 1): one for key, one in changes.items()}
        machine = {"robot": robot or {"rigid": True}, "program.file": name}
        file = write_job(tmp_path, JOB, machine, changes)
        (tmp_path / name).write_text(text)
        return file

    return write


def joints_of(job):
    found = JobKinematics(job).joints(jnp.asarray(job.path.positions))
    return np.asarray(found.positions)


def test_the_arm_takes_the_rotation_that_the_program_states(write):
    """Angles 0, 180, 0 stand for half a turn of the last joint against 0, 0, 180."""
    joints, tool_x = [], []
    for angles, rotation in (
        ((0, 0, 180), {}),
        ((0, 180, 0), {}),
        ((0, 180, 0), {"tool_rotation": "fixed"}),
    ):
        job = load_job(write(krl(angles), PLACED | rotation))
        q = joints_of(job)
        joints.append(np.degrees(q[0]))
        assert job.robot is not None
        tool_x.append(np.asarray(forward_kinematics(job.robot, q[-1]))[:3, 0])
    turned = np.abs(joints[1] - joints[0])
    np.testing.assert_allclose(turned, [0, 0, 0, 0, 0, 180], atol=1e-6)
    np.testing.assert_allclose(joints[2], joints[0], atol=1e-6)
    np.testing.assert_allclose(tool_x, [[1, 0, 0], [-1, 0, 0], [1, 0, 0]], atol=1e-6)


def test_the_base_of_a_program_is_the_place_of_its_work(write):
    job = load_job(write(krl((30, 0, 180), BASE), ARM))
    expected = [[0, -1, 0, 1.8], [1, 0, 0, 0], [0, 0, 1, 0.9], [0, 0, 0, 1]]
    np.testing.assert_allclose(job.T_base_work, expected, atol=1e-12)
    assert any("work_in_base: taken from the base" in note for note in job.notes)
    # 30 degrees in the base, which itself is turned by 90.
    assert job.robot is not None
    tool_x = np.asarray(forward_kinematics(job.robot, joints_of(job)[0]))[:3, 0]
    np.testing.assert_allclose(tool_x, [-0.5, np.sqrt(0.75), 0], atol=1e-6)
    (problem,) = problems_of(write(krl((30, 0, 180), "$BASE=BASE_DATA[3]"), ARM))
    assert problem.startswith("[robot] work_in_base: found nothing")


def test_base_and_tool_of_program_and_job_are_compared(write):
    frames = BASE.replace("1800", "1790") + "\n$TOOL={X 10,Y 0,Z 150,A 0,B 0,C 0}"
    tool = {
        "position": ["0 mm", "0 mm", "150 mm"],
        "rpy": ["180 deg", "0 deg", "0 deg"],
    }
    robot = PLACED | {"tool_in_flange": tool}
    text = krl((0, 0, 180), frames)
    notes = load_job(write(text, robot)).notes
    (base,) = (note for note in notes if "work_in_base" in note)
    assert "lies 10 mm from" in base and "turned by 90 deg" in base
    (found,) = (note for note in notes if "tool_in_flange" in note)
    assert "lies 10 mm from" in found and "axes differ by 0 deg" in found
    equal = (
        text.replace("X 10,Y", "X 0,Y").replace("1790", "1800").replace("A 90", "A 0")
    )
    notes = load_job(write(equal, robot)).notes
    assert not any("_in_" in note for note in notes)


def test_a_rotation_that_no_program_states_is_refused(write):
    robot = PLACED | {"tool_rotation": "program"}
    text = "G90 G0 X-6 Y0 Z1\nG1 Z-1 F600\nX2"
    (problem,) = problems_of(write(text, robot, name="part.ngc"))
    assert '[robot] tool_rotation: found "program"' in problem
    text = "time_s,x_mm,y_mm,z_mm\n0,-6,0,1\n0.4,2,0,-1\n"
    (problem,) = problems_of(write(text, robot, name="part.csv"))
    assert '[robot] tool_rotation: found "program"' in problem


def test_a_tool_that_turns_about_its_axis_on_the_spot_is_refused(write):
    text = krl((0, 0, 180)).replace("LIN {X 2}", "LIN {A 40}\nLIN {X 2}")
    (problem,) = problems_of(write(text, PLACED))
    assert "part.src, line 6: the tool turns about its axis on the spot" in problem
    # A machine that is rigid has no arm that would turn.
    assert load_job(write(text)).path.tool_x is not None


def test_a_cutter_that_lies_flat_or_points_up_is_noted(write):
    flat = krl((0, 90, 0))
    (note,) = (n for n in load_job(write(flat)).notes if "the cutter lies flat" in n)
    assert "90.0 deg" in note
    upright = load_job(write(flat, program_tool_axis="x"))
    assert upright.path.is_upright and upright.output.tool_axis == "x"
    assert not any("cutter" in note for note in upright.notes)
    up = "time_s,x_mm,y_mm,z_mm,i,j,k\n0,-6,0,1,0,0,-1\n1,2,0,-1,0,0,-1\n"
    job = load_job(write(up, name="part.csv"))
    assert any("points up" in note and "180.0 deg" in note for note in job.notes)
    turned = load_job(write(up, name="part.csv", program_tool_axis="z"))
    # How a path states its axis says nothing of the tool that a program is written for.
    assert turned.path.is_upright and turned.output.tool_axis == "z"
    chosen = write(up, name="part.csv", output_tool_axis="x")
    assert load_job(chosen).output.tool_axis == "x"
    (problem,) = problems_of(write(up, name="part.csv", program_tool_axis="x"))
    assert 'the tool axis "x"; allowed for path as CSV: z, -z' in problem


def test_check_prints_axis_base_and_tool(write, tmp_path, capsys):
    frames = f"{BASE}\n$TOOL={{X 0,Y 0,Z 250,A 0,B 0,C 0}}"
    write(krl((0, 30, 180), frames).replace("LIN {X 2}", "LIN {X 2,B -40}"))
    assert main(["check", str(tmp_path / "part.src")]) == 0
    lines = capsys.readouterr().out.splitlines()
    (axis,) = (line for line in lines if "tool axis" in line)
    assert "(0.5, 0, 0.866)" in axis and re.search(r"by 30\.00 to 40\.00 deg$", axis)
    (base,) = (line for line in lines if line.startswith("  base"))
    assert "position 1800, 0, 900 mm, rpy 0, 0, 90 deg" in base
    (tool,) = (line for line in lines if "in the flange" in line)
    assert "position 0, 0, 250 mm, rpy 180, 0, 0 deg" in tool
    assert main(["check", str(tmp_path / "job.toml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any("tool axis" in line and "40.00 deg" in line for line in lines)
    write(krl((0, 90, 0)))
    assert main(["check", str(tmp_path / "part.src"), "--tool-axis", "x"]) == 0
    assert "from +z by 0.00 deg, upright" in capsys.readouterr().out


def test_convert_turns_the_frame_of_the_tool(write, tmp_path, capsys):
    write(krl((0, 90, 0)))
    files = [str(tmp_path / name) for name in ("part.src", "part.apt", "again.src")]
    axis = ["--tool-axis", "x"]
    assert main(["convert", *files[:2], *axis]) == 0
    assert "GOTO/2,0,-1,0,0,1" in (tmp_path / "part.apt").read_text()
    assert main(["convert", *files[1:], *axis]) == 0
    text = (tmp_path / "again.src").read_text()
    assert "LIN {X 2,Y 0,Z -1,A 0,B 90,C 0}" in text and "(its tip, x of it" in text
    (tmp_path / "part.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,1,0,0\n")
    apt = ["convert", str(tmp_path / "part.csv"), str(tmp_path / "other.apt"), *axis]
    assert main(apt) == 2 and "--tool-axis: neither" in capsys.readouterr().err
