"""`[robot.calibration]`: the geometric errors of a job's robot."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

from diffmill import load_job
from diffmill.robot import LinkErrors, forward_kinematics, load
from small_job import FLANGE_SPRING, problems_of

ZERO = '["0 mm", "0 mm", "0 mm"]'
CALIBRATION = f"""
[robot.calibration]
displacement = [["0.12 mm", "0 mm", "-50 um"], {", ".join([ZERO] * 5)}]
rotation = [{", ".join(['["0.3 mrad", "-0.1 mrad", "0.01 deg"]'] * 6)}]
joint_offsets = ["0.2 mrad", "0 deg", "0 deg", "0 deg", "0 deg", "-1 mrad"]
waves = [{", ".join(['["0.1 mrad", "0 mrad", "20 urad", "0 mrad"]'] * 6)}]
wave_period = "180 deg"
tool = ["0 mm", "1 mm", "0 mm"]
"""


def test_the_arm_stands_where_its_errors_say(write):
    """Springs behind it have no errors, and one that no robot has is noted."""
    text = CALIBRATION.replace('"-1 mrad"', '"-4 deg"')
    job = load_job(write(text + FLANGE_SPRING))
    robot, plain = job.robot, load("reis_rv130_like")
    assert robot is not None and robot.joint_count == 9
    errors = dataclasses.replace(
        LinkErrors.none(plain),
        displacement=jnp.zeros((6, 3)).at[0].set(jnp.array([120e-6, 0, -50e-6])),
        rotation=jnp.tile(jnp.array([[0.3e-3, -0.1e-3, math.radians(0.01)]]), (6, 1)),
        joint_offsets=jnp.array([0.2e-3, 0, 0, 0, 0, -math.radians(4)]),
        tool_position=jnp.array([0, 1e-3, 0]),
    )
    q = plain.home + 0.2
    pose = forward_kinematics(robot, jnp.pad(q, (0, 3)))
    np.testing.assert_allclose(
        pose, forward_kinematics(errors.applied_to(plain), q), atol=1e-12
    )
    np.testing.assert_allclose(
        robot.transmitted(jnp.pad(q, (0, 3))),
        np.pad(q + 0.1e-3 * np.sin(2 * q) + 20e-6 * np.sin(4 * q), (0, 3)),
        rtol=1e-14,
    )
    notes = [note for note in job.notes if "calibration" in note]
    (note,) = [note for note in notes if "the controller is taken" not in note]
    assert "joint_offsets: found '-4 deg'; 0 deg to 3 deg are usual" in note


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('displacement = [["0.12', 'displacement = [["0.12 m", "0 mm", "0 mm"], ["0.12',
         ("displacement", "7 rows", "one per joint", "axis_6")),
        ('joint_offsets = ["0.2 mrad", ', "joint_offsets = [",
         ("joint_offsets", "5 values", "axis_1")),
        ('["0.2 mrad"', '["0.2 mm"', ("joint_offsets.0 (axis_1)", "0.2 mm", "angle")),
        ('"20 urad", ', "", ("waves.0", "4 values")),
        ('"180 deg"', '"0 deg"', ("wave_period", "above 0")),
        ('tool = ["0 mm", ', "tool = [", ("tool", "3 values")),
        ("rotation", "rotations", ("rotations", "unknown key", "perhaps rotation")),
    ],
)  # fmt: skip
def test_faults_of_the_table(write, old, new, parts):
    assert old in CALIBRATION
    problem = problems_of(write(CALIBRATION.replace(old, new, 1)))[0]
    for part in ("[robot", "calibration", *parts):
        assert part in problem


def test_a_period_without_waves_is_refused(write):
    (problem,) = problems_of(write('[robot.calibration]\nwave_period = "90 deg"\n'))
    assert "[robot.calibration] wave_period: found without waves" in problem


def test_a_slide_has_no_waves(tmp_path):
    rows = ", ".join(['["1 urad", "0 rad", "0 rad", "0 rad"]'] * 3)
    job = write_slides_job(tmp_path)
    job.write_text(job.read_text() + f"[robot.calibration]\nwaves = [{rows}]\n")
    problem = problems_of(job)[0]
    assert "waves.0 (x): found waves, but a slide has none" in problem
