"""Backlash and friction of a job's robot from a preset."""

import numpy as np
import pytest

from diffmill import load_job
from small_job import ARM, SLOT, problems_of, write_job

JOB = {
    "cutter.flute_length": "22 mm",
    "force": {"material": "aluminium_3.1325"},
    "stock.upper": ["8 mm", "10 mm", "0 mm"],
}


def write(folder, **robot):
    program = SLOT.replace("X20", "X4")
    return write_job(folder, JOB, {"robot": ARM | robot}, program=program)


def robot_of(folder, **robot):
    arm = load_job(write(folder, **robot)).robot
    assert arm is not None
    return arm


def test_a_preset_gives_backlash_and_friction(tmp_path):
    arm = robot_of(tmp_path, reversal="kuka_kr300")
    assert arm.backlash is not None and arm.friction is not None
    assert arm.friction.presliding is not None
    np.testing.assert_allclose(arm.backlash.gap, 30e-6)
    np.testing.assert_allclose(arm.friction.coulomb, [285, 10, 30, 0, 0, 0])
    np.testing.assert_allclose(arm.friction.viscous, [2050, 2307, 2024, 0, 0, 0])
    np.testing.assert_allclose(arm.friction.presliding, 80e-6)
    plain = robot_of(tmp_path)
    assert plain.backlash is None and plain.friction is None


def test_a_preset_replaces_what_the_drives_have(tmp_path):
    drives = tmp_path / "drives.toml"
    drives.write_text('[drive.axis_1]\nbacklash = "0.1 mrad"\n')
    job = load_job(write(tmp_path, reversal="kuka_kr300", drives="drives.toml"))
    assert any("replaces backlash and friction" in note for note in job.notes)
    assert job.robot is not None and job.robot.backlash is not None
    np.testing.assert_allclose(job.robot.backlash.gap, 30e-6)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ({"reversal": "kuka"}, "reversal: found 'kuka'; allowed: kuka_kr300"),
        (
            {"reversal": "kuka_kr300", "model": "reis_rlp16_like"},
            "which is of 6 joints that turn",
        ),
    ],
)
def test_a_preset_that_does_not_suit_is_told(tmp_path, robot, message):
    (problem,) = problems_of(write(tmp_path, **robot))
    assert message in problem
