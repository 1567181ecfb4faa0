"""`diffmill robot`: what it prints, writes and refuses."""

import json

import numpy as np
import pytest
from slides_job import write_slides_job

from diffmill import load_job
from diffmill.cli import main
from small_job import arm_text, body, slide

# Three slides and a mass: everything about it is known. Short ones: a small map.
X = {"lower": "-1 m", "upper": "1 m", "stiffness": "4 N/um", "damping": "400 N*s/m"}
SLIDES = arm_text(
    slide("x", 0, **X),
    slide("y", 1, lower="-250 mm", upper="250 mm"),
    slide("z", 2, lower="-100 mm", upper="100 mm", stiffness="16 N/um"),
    body("100 kg"),
    name="slides",
)


@pytest.fixture
def folder(here):
    (here / "slides.toml").write_text(SLIDES)
    return here


@pytest.mark.slow
def test_robot_prints_and_draws(folder, capsys):
    command = ["robot", "slides.toml", "--pose", "100 mm, -20 cm, 0 m"]
    assert main(command) == 0
    text = capsys.readouterr().out
    for part in (
        "moving mass 100.0 kg",
        "at (100.0, -200.0, 0.0) mm",
        "along base axes [N/um]: x 4.000, y rigid, z 16.000",
        "31.83 Hz  damping   1.00 %  x 100 %",  # sqrt(4e6 / 100) = 200 rad/s
        "63.66 Hz  damping   0.00 %  z 100 %",
        "note: joints without a spring, taken as rigid: y",
    ):
        assert part in text
    out = folder / "slides-robot"
    names = {p.name for p in out.iterdir()}
    assert {"robot.json", "robot.png", "stiffness.png"} <= names
    facts = json.loads((out / "robot.json").read_text())
    deflection = np.array(facts["statics"]["deflection_mm"])
    np.testing.assert_allclose(deflection, np.diag([0.025, 0.0, 0.00625]), atol=1e-9)
    sag = facts["statics"]["gravity_sag_mm"]
    np.testing.assert_allclose(sag, [0.0, 0.0, -981.0 / 16e3], atol=1e-9)
    assert len(facts["modes"]) == 2
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.slow
def test_the_robot_of_a_job_stands_half_way_through_its_path(folder, capsys):
    job = write_slides_job(folder)
    assert main(["robot", job.name]) == 0
    text = capsys.readouterr().out
    path = load_job(job).path.positions
    x, y, z = 1e3 * np.asarray(path[len(path) // 2])
    assert f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm" in text
    assert main(["robot", job.name, "--tool", "a", "--force"]) == 2
    assert "--pose" in capsys.readouterr().err


def test_a_robot_without_springs_says_so(folder, capsys):
    lines = SLIDES.splitlines()
    kept = [x for x in lines if not x.startswith(("stiffness", "damping", "lower"))]
    (folder / "rigid.toml").write_text("\n".join(kept))
    assert main(["robot", "rigid.toml"]) == 0
    text = capsys.readouterr().out
    assert "note: no joint has a spring, so nothing bends" in text
    assert "nan" not in text.lower()
    assert "none to 1000" in text
    names = {p.name for p in (folder / "rigid-robot").iterdir()}
    assert "robot.png" in names
    assert "stiffness.png" not in names
    facts = json.loads((folder / "rigid-robot" / "robot.json").read_text())
    assert facts["statics"] is None


def test_a_robot_without_masses_has_no_modes(folder, capsys):
    (folder / "light.toml").write_text(SLIDES[: SLIDES.rindex("[[elements]]")])
    assert main(["robot", "light.toml", "--quiet"]) == 0
    facts = json.loads((folder / "light-robot" / "robot.json").read_text())
    assert facts["modes"] is None
    assert any("natural modes" in note for note in facts["notes"])
    assert facts["statics"]["stiffness_along_axes_N_per_um"] == [4.0, None, 16.0]


def test_a_joint_that_is_hardly_damped_is_named(folder, capsys):
    stiff = 'stiffness = "16 N/um"\n'
    text = SLIDES.replace(stiff, f'{stiff}damping = "0.001 N*s/m"\n')
    (folder / "soft.toml").write_text(text)
    assert main(["robot", "soft.toml", "--quiet"]) == 0
    facts = json.loads((folder / "soft-robot" / "robot.json").read_text())
    notes = [note for note in facts["notes"] if "practically undamped" in note]
    assert len(notes) == 1 and notes[0].startswith("z is practically undamped: 0.001")


@pytest.mark.slow
def test_drives_make_a_urdf_soft(folder, capsys):
    (folder / "slide.urdf").write_text(
        '<robot name="slide"><link name="base"/><link name="tip"><inertial>'
        '<mass value="100"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="x" type="prismatic"><parent link="base"/>'
        '<child link="tip"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (folder / "drives.toml").write_text(
        '[stiffness]\nx = "4 N/um"\n[damping]\nx = "400 N*s/m"\n'
    )
    assert main(["robot", "slide.urdf", "--drives", "drives.toml"]) == 0
    said = capsys.readouterr().out
    assert "31.83 Hz  damping   1.00 %  x 100 %" in said
    assert "the spindle counts only where" in said
    # Three times as much again hangs on the spring.
    with open(folder / "drives.toml", "a") as file:
        inertia = ["1 kg*m^2"] * 3
        file.write(f'[spindle]\nmass = "300 kg"\ninertia = {inertia}\n')
    assert main(["robot", "slide.urdf", "--drives", "drives.toml", "--force"]) == 0
    said = capsys.readouterr().out
    assert "15.92 Hz" in said and "spindle" not in said
    assert main(["robot", "slide.urdf", "--drives", "no.toml", "--force"]) == 2
    assert "no.toml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing"], "the built-in models are kuka_kr10_like"),
        (["slides.toml", "--pose", "1 m, 2 m"], "--pose: found 2 positions"),
        (["slides.toml", "--pose", "-1 m, 2 m"], "--pose: found 2 positions"),
        (["slides.toml", "--pose", "1 deg, 0 m, 0 m"], "x: "),
        (["slides.toml", "--pose", "0 m, 0 m, 2 m"], "allowed is -100 to 100 mm"),
        (["slides.toml", "--tool", "drill"], "'drill'"),
    ],
)
def test_bad_input_is_refused(folder, capsys, arguments, message):
    assert main(["robot", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in folder.iterdir()] == ["slides.toml"]


def test_known_robots_are_listed_with_where_their_models_are(folder, capsys):
    assert main(["robot", "--list"]) == 0
    said = capsys.readouterr().out
    assert "kuka_kr210_like" in said and '"class 500 kg": 2.3, 8.6,' in said
    # Eight arms beside those that are built in, each with its licence and place.
    assert said.count("masses: ") == said.count("https://github.com/") == 8
    for part in ("Apache-2.0", "BSD", "kuka_fortec_support/urdf/kr500_r2800_2"):
        assert part in said
    assert main(["robot"]) == 2
    assert "found no MODEL; --list" in capsys.readouterr().err
