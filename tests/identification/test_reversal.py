"""Spring, reversal, backlash and delay of joints whose numbers are known."""

import dataclasses
import os
import pathlib

import jax.numpy as jnp
import numpy as np
import pytest
from joint_motions import STEP, Joint, save_joint, stretches

from diffmill import robot as rb
from diffmill.config import load_identification
from diffmill.identification import JointRecord, ReversalStudy, StudyError

ROOT = pathlib.Path(__file__).parents[2]
DATA = ROOT / os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data")
KR300 = DATA / "robots" / "measured" / "kr300_secondary_encoders"
RATIOS = [256.857, 267.429, 252.333, 221, 239.619, 154.323]


def study(records, **more):
    return ReversalStudy("joints.toml", ("joint_1",), tuple(records), **more)


def drive_of(joint, seed, count=2, **more):
    rng = np.random.default_rng(seed)
    (fitted,) = study([joint.record(rng, **more) for _ in range(count)]).run().drives
    return fitted


def scores(joint, drive):
    """Return errors over standard errors: K, r, b, T, F_c, F_v."""
    pairs = (
        (drive.compliance, 1 / joint.stiffness),
        (drive.reversal, joint.friction / joint.stiffness),
        (drive.backlash, joint.backlash),
        (drive.delay, joint.delay),
        (drive.coulomb, joint.friction + joint.motor_friction),
        (drive.viscous, joint.viscous),
    )
    return np.array([(one.value - truth) / one.error for one, truth in pairs])


def test_a_joint_without_noise_is_found():
    joint = Joint()
    drive = drive_of(joint, 0, noise=1e-9, torque_noise=0.01).drive
    assert drive.stiffness.value == pytest.approx(joint.stiffness, rel=2e-3)
    assert drive.reversal.value == pytest.approx(30e-6, rel=5e-3)
    assert drive.backlash.value == pytest.approx(40e-6, rel=5e-3)
    assert drive.presliding == pytest.approx(80e-6, rel=2e-2)
    assert drive.delay.value == pytest.approx(2.9e-3, rel=1e-3)
    assert drive.coulomb.value == pytest.approx(400.0, rel=1e-3)
    assert drive.viscous.value == pytest.approx(1500.0, rel=1e-3)


@pytest.mark.slow
def test_noise_and_gross_errors_are_within_the_interval():
    joint, rng = Joint(), np.random.default_rng(7)
    records = [joint.record(rng) for _ in range(2)]
    records[0].link[1500:1503] += 5e-3
    (fitted,) = study(records).run().drives
    assert (np.abs(scores(joint, fitted.drive)) < 3.5).all()
    low, high = fitted.drive.presliding_interval
    assert low < 1.3 * joint.presliding and high > joint.presliding / 1.3


@pytest.mark.slow
def test_intervals_of_95_per_cent_hold_the_truth():
    joint, hits = Joint(), []
    for seed in range(30):
        drive = drive_of(joint, seed).drive
        low, high = drive.presliding_interval
        is_within = np.abs(scores(joint, drive)) < 1.96
        hits.append([*is_within, low < joint.presliding < high])
    shares = np.mean(hits, axis=0)
    print("K, r, b, T, F_c, F_v, z within:", shares)
    # Of 30 draws at 95 % two shares of a hundred are below 0.86.
    assert shares.min() > 0.82
    assert 0.85 < shares.mean() < 0.99


@pytest.mark.slow
def test_a_load_to_one_side_shows_no_backlash():
    joint = dataclasses.replace(Joint(), weight=0.0)
    rng = np.random.default_rng(1)
    record = joint.record(rng)
    weight = 3000.0
    record = dataclasses.replace(
        record,
        link=record.link - weight / joint.stiffness,
        torque=record.torque + weight,
    )
    (fitted,) = study([record]).run().drives
    assert not fitted.drive.sees_both_flanks
    assert np.isnan(fitted.drive.backlash.value)
    assert [one.name for one in fitted.cross_validated] == [
        "first half of joint.csv",
        "second half of joint.csv",
    ]


@pytest.mark.slow
def test_an_error_of_the_position_repeats_between_records():
    fitted = drive_of(dataclasses.replace(Joint(), wave=40e-6), 3)
    assert fitted.repeating is not None and fitted.repeating_share > 0.7
    for one in fitted.cross_validated:
        measured, drive, repeating = one.rms
        assert repeating < 0.6 * drive < drive < measured
    plain = drive_of(Joint(), 3)
    assert plain.repeating_share < 0.3


def test_the_memory_is_that_of_the_friction_of_a_robot():
    rng = np.random.default_rng(2)
    q, z = np.cumsum(rng.normal(size=300)) * 1e-5, 40e-6
    robot = rb.load("kuka_kr210_like").with_friction(
        [100.0] * 6, [0.0] * 6, [1e-3] * 6, presliding=[z] * 6
    )
    stretch, seen = jnp.zeros(6), []
    assert robot.friction is not None
    for travel in np.diff(q, prepend=q[0]):
        stretch = robot.friction.moved_bristles(stretch, jnp.full(6, travel))
        seen.append(float(stretch[0]) / z)
    np.testing.assert_allclose(stretches(q, z), seen, atol=1e-12)


def test_joints_that_show_nothing_are_refused():
    joint = Joint().record(np.random.default_rng(0))
    still = dataclasses.replace(joint, motor=0 * joint.motor, link=0 * joint.link)
    with pytest.raises(StudyError, match="joint_1 is left out: no record has"):
        study([still]).run()
    t = STEP * np.arange(5000)[:, None]
    once = JointRecord("once.csv", STEP, 0.1 * t, 0.1 * t, 0 * t + 1.0)
    with pytest.raises(StudyError, match="it never turns back"):
        study([once]).run()


def text_of(names, more=""):
    return f'kind = "reversal"\n[reversal]\n{more}\n' + "".join(
        f'[[joint_record]]\nfile = "{name}"\n' for name in names
    )


def problems(folder, text):
    (folder / "joints.toml").write_text(text)
    with pytest.raises(ValueError) as error:
        load_identification(folder / "joints.toml")
    return str(error.value)


def test_torques_of_motors_are_taken_behind_their_gears(tmp_path):
    record = Joint().record(np.random.default_rng(0), duration=4.0)
    save_joint(tmp_path / "a.csv", record)
    (tmp_path / "joints.toml").write_text(text_of(["a.csv"], "gear_ratios = [-200]"))
    read = load_identification(tmp_path / "joints.toml")
    assert isinstance(read, ReversalStudy) and read.joint_names == ("joint_1",)
    (one,) = read.records
    np.testing.assert_allclose(one.torque, -200 * record.torque, rtol=1e-9)
    np.testing.assert_allclose(one.link, record.link, atol=1e-12)
    assert one.time_step == pytest.approx(STEP)


def test_wrong_files_are_told(tmp_path):
    record = Joint().record(np.random.default_rng(0), duration=4.0)
    save_joint(tmp_path / "a.csv", record)
    assert "but a finite number beside 0 is required" in problems(
        tmp_path, text_of(["a.csv"], "gear_ratios = [0]")
    )
    assert "an angle above 0 is required" in problems(
        tmp_path, text_of(["a.csv"], 'longest_presliding = "0 mrad"')
    )
    assert "[[joint_record]]: found no such table" in problems(tmp_path, text_of([]))
    save_joint(
        tmp_path / "motor.csv", dataclasses.replace(record, motor=50 * record.motor)
    )
    text = problems(tmp_path, text_of(["motor.csv"]))
    assert "no link follows its motor" in text
    off = dataclasses.replace(record, link=0.9 * record.link)
    save_joint(tmp_path / "off.csv", off)
    assert "which no gear bends" in problems(tmp_path, text_of(["off.csv"]))
    rows = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "gap.csv").write_text("\n".join(rows[:300] + rows[500:]))
    assert "gaps in the time, but a record in one piece" in problems(
        tmp_path, text_of(["gap.csv"])
    )
    (tmp_path / "half.csv").write_text(
        "\n".join(row.rpartition(",")[0] for row in rows)
    )
    assert "found no joint with all of motor, link and torque" in problems(
        tmp_path, text_of(["half.csv"])
    )
    robot = '[robot]\nmodel = "kuka_kr210_like"\n'
    assert "[reversal] gear_ratios: found 1 values, but one per joint" in problems(
        tmp_path, text_of(["a.csv"], "gear_ratios = [200]") + robot
    )


@pytest.mark.slow
@pytest.mark.skipif(not KR300.exists(), reason="needs DIFFMILL_REFERENCE_DATA")
def test_record_b_of_a_real_robot_is_foretold_by_record_a(tmp_path):
    names = ["record_A.csv", "record_B.csv"]
    for name in names:
        (tmp_path / name).write_bytes((KR300 / name).read_bytes())
    (tmp_path / "kr300.toml").write_text(text_of(names, f"gear_ratios = {RATIOS}"))
    read = load_identification(tmp_path / "kr300.toml")
    assert isinstance(read, ReversalStudy)
    result = read.run()
    left = [1e6 * fitted.cross_validated[1].rms[2] for fitted in result.drives]
    # A spring, a sign of the velocity and an acceleration leave as much of the records
    # that they were fitted to.
    assert (np.array(left) < [51, 57, 42]).all()
    # The encoders share a clock; published are 2050, 2307, 2024 N m s/rad.
    drives = [fitted.drive for fitted in result.drives]
    for one, published in zip(drives, (2050, 2307, 2024), strict=True):
        assert one.delay.value == pytest.approx(3.0e-3, abs=0.15e-3)
        assert one.viscous.value == pytest.approx(published, rel=0.2)
