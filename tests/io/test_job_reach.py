"""What a job says of a robot that cannot follow its path, before anything runs."""

import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import load_job, robot as rb
from diffmill.examples import copy_example
from diffmill.sim import JobKinematics
from small_job import SLOT, SLOT_STOCK, arm_text, body, problems_of, slide, write_job

# Three slides along the axes of the base, and a tool that they cannot turn.
SLIDE = {"stiffness": "1e6 N/m", "lower": "-1 m"}
SLIDES = arm_text(
    *(slide("x", 0, **SLIDE, upper="5 mm", home="-10 mm"), body("5 kg")),
    *(slide("y", 1, **SLIDE, upper="1 m", home="-10 mm"), body("5 kg")),
    *(slide("z", 2, **SLIDE, upper="-0.2 mm", home="-10 mm"), body("5 kg")),
    name="slides",
)


def place(x, y, z, yaw=0):
    position = ", ".join(f'"{value} mm"' for value in (x, y, z))
    rpy = f'rpy = ["0 deg", "0 deg", "{yaw} deg"]'
    return f"work_in_base = {{ position = [{position}], {rpy} }}\n"


@pytest.fixture
def write(tmp_path):
    """Write a job with a robot table beside its program; return its path."""

    def write(robot, program=SLOT):
        (tmp_path / "slides.toml").write_text(SLIDES)
        tables = SLOT_STOCK | {"cutter.flute_length": "22 mm", "robot": {}}
        file = write_job(tmp_path, tables, program=program)
        file.write_text(file.read_text() + robot)
        return file

    return write


SLIDING = 'file = "slides.toml"\n'


def test_every_joint_beyond_its_limits_is_named(write):
    first, second = problems_of(write(SLIDING + place(0, 0, 0)))
    # The program goes to x = 20 mm and up to z = 1 mm.
    for part in ("joint x", "-1000.0 to 5.0 mm", "20.0 mm", "15 mm more", "rows"):
        assert part in first
    for part in ("time 0.000 s", "joint z would be at 1.0 mm", "1.2 mm more"):
        assert part in second


@pytest.mark.slow
def test_a_free_tool_rotation_reaches_where_a_fixed_one_does_not(write):
    turned = SLIDING + place(-100, 0, -100, yaw=30)
    (problem,) = problems_of(write(turned))
    for part in ("time 0.000 s", " is 0 mm and 30 deg away", "so are ", " rows"):
        assert part in problem
    assert problem.endswith('tool_rotation = "free" would reach it')
    job = load_job(write(turned + 'tool_rotation = "free"\n'))
    assert job.tool_rotation == "free"
    q, is_reached = JobKinematics(job.with_precision()).joints(
        jnp.asarray(job.path.positions)
    )
    assert is_reached.all()
    # The slides' positions are those of the tip in the base.
    R, p = np.asarray(job.T_base_work)[:3, :3], np.asarray(job.T_base_work)[:3, 3]
    np.testing.assert_allclose(q, job.path.positions @ R.T + p[None], atol=1e-9)


def test_a_nearly_singular_pose_is_a_note(write):
    # A tool that leaves the flange sideways stands upright when the wrist is straight.
    tool = 'tool_in_flange = { position = ["0 mm", "0 mm", "200 mm"], '
    tool += 'rpy = ["0 deg", "90 deg", "0 deg"] }\n'
    arm = 'model = "reis_rv130_like"\n'
    job = load_job(write(arm + place(1950, 0, 1880, yaw=180) + tool))
    (note,) = [note for note in job.notes if "singular" in note]
    for part in ("time ", "position (", "(axis_4, axis_6)", "singular value", "rows"):
        assert part in note


def sprung(x, y, z):
    """Return a file of slides of some stiffness [N/m]."""
    x, y, z = (
        slide(name, axis, stiffness=f"{stiffness} N/m")
        for axis, (name, stiffness) in enumerate(zip("xyz", (x, y, z), strict=True))
    )
    return arm_text(x, body("5 kg"), y, z, body("5 kg"))


@pytest.mark.parametrize(
    ("stiffness", "substeps", "note"),
    [
        # y and z: sqrt(K / 5 kg) / (2 pi); period 3.75 ms, 8 sub-steps under 0.5 ms.
        (1e5, 8, ""),  # 22.5 Hz
        (2.5e7, 25, ""),  # 356 Hz: (2 pi f h)^2 / 12 < 1 % up to 0.155 ms
        (2.5e8, 32, "sub-steps of 0.117 ms let the mode at 1125 Hz ring 5.7 %"),
    ],
)
def test_substeps_follow_the_modes(write, stiffness, substeps, note):
    # All as stiff, so that each gives way by its share.
    file = write('file = "sprung.toml"\n' + place(0, 0, 0))
    (file.parent / "sprung.toml").write_text(sprung(*3 * [stiffness]))
    job = load_job(file)
    assert job.simulation.substeps == substeps
    assert any(note in text for text in job.notes) if note else not job.notes


def test_springs_that_do_not_hold_the_weight_are_refused(write):
    # m g = 49 N on 50 N/m.
    file = write('file = "sprung.toml"\n' + place(0, 0, 0))
    (file.parent / "sprung.toml").write_text(sprung(1e5, 1e5, 50))
    (problem,) = problems_of(file)
    for part in ("joint z (50 N/m)", "by 981 mm", "stiffer"):
        assert part in problem
    (file.parent / "sprung.toml").write_text(sprung(1e5, 1e5, 1000))
    (note,) = load_job(file).notes
    assert "joint z" in note and "49.1 mm" in note


@pytest.mark.slow
def test_a_free_rotation_reaches_what_is_in_reach(tmp_path):
    file = pathlib.Path(copy_example("paper_small", tmp_path))
    place = 'work_in_base = { position = ["1.78 m", "-1 m", "1.4 m"] }'
    free = f'{place}\ntool_rotation = "free"'
    text = re.sub("^work_in_base = .*$", free, file.read_text(), flags=re.MULTILINE)
    file.write_text(text)
    job = load_job(file)
    robot = job.robot
    assert robot is not None
    q, is_reached = JobKinematics(job).joints(jnp.asarray(job.path.positions))
    assert is_reached.all()
    # Every tip and every tool axis is where the program says.
    Ts = np.asarray(jax.vmap(lambda x: rb.forward_kinematics(robot, x))(q))
    R, p = np.asarray(job.T_base_work)[:3, :3], np.asarray(job.T_base_work)[:3, 3]
    tips = np.asarray(job.path.positions) @ R.T + p[None]
    np.testing.assert_allclose(Ts[:, :3, 3], tips, atol=15e-9)
    axes = np.broadcast_to([0.0, 0.0, 1.0], tips.shape)
    np.testing.assert_allclose(Ts[:, :3, 2], axes, atol=1e-8)


def flat_arm(**elbow):
    """Return a file of a 2R arm in the horizontal plane, with keys of its elbow."""
    joint = {"kind": "revolute", "axis": [0, 0, 1], "stiffness": "1e6 N*m/rad"}
    link = (
        body("1 kg", center_of_mass=["100 mm", "0 mm", "0 mm"]),
        {"kind": "translation", "position": ["500 mm", "0 mm", "0 mm"]},
    )
    one, two = joint | {"name": "one"}, joint | {"name": "two"} | elbow
    return arm_text(one, *link, two, *link, name="flat")


@pytest.fixture
def flat_job(write):
    """Write a job of this arm on a recorded path, a row each 4 ms; return its path."""

    def flat_job(arm, x, y, start):
        joints = ", ".join(f'"{value} rad"' for value in start)
        lines = ['file = "flat.toml"', 'tool_rotation = "free"', place(0, 0, 0)]
        file = write("\n".join([*lines, f"joint_start = [{joints}]"]))
        text = file.read_text().replace("part.ngc", "path.csv")
        text = text.replace("8000 rpm", "7500 rpm").replace(
            '"20 mm", "10 mm", "0 mm"', '"20 mm", "10 mm", "-1 mm"'
        )
        file.write_text(text)
        (file.parent / "flat.toml").write_text(arm)
        rows = [f"{4e-3 * k!r},{at!r},{y},0,1" for k, at in enumerate(x.tolist())]
        text = "\n".join(["time_s,x_m,y_m,z_m,rapid", *rows])
        (file.parent / "path.csv").write_text(f"{text}\n")
        return file

    return flat_job


@pytest.mark.slow
def test_another_configuration_is_suggested(flat_job):
    # From here the elbow bends to the left, and farther than it may.
    arm = flat_arm(lower="-2 rad", upper="1.6 rad")
    x = np.linspace(0.8, 0.6, 9)
    (problem,) = problems_of(flat_job(arm, x, 0, (-0.6, 1.2)))
    assert "joint two would be at" in problem
    found = re.search(r'joint_start = \["(.*) deg", "(.*) deg"\] avoids it', problem)
    assert found is not None
    start = np.deg2rad([float(text) for text in found.groups()])
    # The law of cosines at the first point, to the other side.
    elbow = -np.arccos(0.8**2 / (2 * 0.5**2) - 1)
    np.testing.assert_allclose(start, [-elbow / 2, elbow], atol=1e-3)
    assert load_job(flat_job(arm, x, 0, start)).joint_start == pytest.approx(start)


def test_a_joint_that_is_too_slow_is_named(flat_job):
    # Stretching the arm the elbow turns faster and faster.
    x = np.linspace(0.9, 0.99, 31)
    elbow = 2 * np.arccos(x)
    rate = np.abs(np.diff(elbow)) / 4e-3
    start = (-0.5, 1.0)
    (problem,) = problems_of(flat_job(flat_arm(speed="2 rad/s"), x, 0, start))
    assert "joint two would move at" in problem and "time 0.120 s" in problem
    assert f"{np.rad2deg(rate.max()):.1f} deg/s; allowed is 114.6 deg/s" in problem
    assert f"so in {(rate > 2.0).sum()} of 31 rows" in problem
    fast_enough = flat_arm(speed=f"{rate.max() * (1 + 1e-9)} rad/s")
    assert load_job(flat_job(fast_enough, x, 0, start)).robot is not None


@pytest.mark.slow
def test_a_change_of_configuration_is_a_fault(flat_job):
    # Close past its own base axis the arm must swing round within a few rows.
    x = np.array([20, 12, 4, -4, -12, -20]) * 1e-3
    (problem,) = problems_of(flat_job(flat_arm(), x, 0.012, (-1.0, 3.0)))
    for part in ("time 0.012 s", "joint one turns by 36.9 deg", "joint_start"):
        assert part in problem


def test_a_program_slows_down_for_a_slow_joint(write):
    file = write(SLIDING + place(0, 0, 0))
    slides = SLIDES.replace('"5 mm"', '"1 m"').replace('"-0.2 mm"', '"1 m"')
    slow = slides.replace('name = "x"', 'name = "x"\nspeed = "20 mm/s"')
    found = {}
    for name, text in (("free", slides), ("slow", slow)):
        (file.parent / "slides.toml").write_text(text)
        found[name] = load_job(file)
    rate = lambda job: np.abs(np.diff(job.path.positions[:, 0])).max() / 3.75e-3
    assert rate(found["free"]) == pytest.approx(0.05, rel=1e-3)
    assert 0.019 < rate(found["slow"]) <= 0.02
    time = {name: job.timing.cycle_time for name, job in found.items()}
    # Of 26 mm at a feed of 50 mm/s.
    longer = 26e-3 / 0.02 - 26e-3 / 0.05
    lost = dict(time["slow"].lost)
    assert lost["joint x"] == pytest.approx(longer, rel=0.05)
    assert "joint x" not in dict(time["free"].lost)
    assert found["slow"].path.time[-1] - found["free"].path.time[-1] > 0.9 * longer

    # Its acceleration follows from the time in which it is at full speed.
    text = file.read_text().replace("[program]", '[program]\njoint_ramp = "100 ms"')
    file.write_text(text)
    path = load_job(file).path
    steepest = np.abs(np.diff(path.positions[:, 0], 2)).max() / 3.75e-3**2
    assert 0.05 < steepest <= 0.2 * (1 + 1e-6)

    (file.parent / "slides.toml").write_text(slides)
    (problem,) = problems_of(file)
    assert "joint_ramp" in problem and "no joint has a speed" in problem


def test_a_program_slows_down_again_where_rows_were_too_far_apart(write):
    # The slides go round a circle of 0.3 mm at a few rows behind a rapid move.
    program = (
        "G21 G17 G90 G94\nG0 X-50 Y5 Z1\nG0 X40\nG3 X40 Y5 I0 J0.3 F3000\n"
        "G1 X60\nG0 X-6\nG0 Z-1\nG1 X10\nM2\n"
    )
    file = write(SLIDING + place(0, 0, 0), program)
    slides = SLIDES.replace('"5 mm"', '"1 m"').replace('"-0.2 mm"', '"1 m"')
    for name in "xy":
        slides = slides.replace(
            f'name = "{name}"', f'name = "{name}"\nspeed = "20 mm/s"'
        )
    (file.parent / "slides.toml").write_text(slides)
    rates = np.abs(np.diff(load_job(file).path.positions[:, :2], axis=0)) / 3.75e-3
    assert 0.0195 < rates.max() <= 0.02


@pytest.mark.parametrize("height", [200, -200])
def test_a_tool_below_its_flange_is_a_note(write, height):
    # The slides' axes are those of the work: z of the flange is up.
    tool = f'tool_in_flange = {{ position = ["0 mm", "0 mm", "{height} mm"] }}\n'
    job = load_job(write(SLIDING + place(-100, 0, height - 100) + tool))
    notes = [note for note in job.notes if "tool_in_flange" in note]
    assert len(notes) == (height > 0)
