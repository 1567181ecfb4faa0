"""A job whose machine is given by modes: beside the same slides, corrected, refused."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import with_machine, write_slides_job

import diffmill as dm

MASS, STIFFNESS, DAMPING = 80.0, 1e6, 2e3
MODE = """
[[machine.modes]]
frequency = "{frequency!r} Hz"
damping_ratio = {ratio!r}
direction = {direction}
{size}
"""
SIZES = (f'mass = "{MASS} kg"', f'stiffness = "{STIFFNESS} N/m"', f'mass = "{MASS} kg"')


def slides_modes(directions=((1, 0, 0), (0, 1, 0), (0, 0, 1)), head="[machine]\n"):
    """Return the modes of the slides."""
    frequency = math.sqrt(STIFFNESS / MASS) / (2 * math.pi)
    ratio = DAMPING / (2 * math.sqrt(STIFFNESS * MASS))
    return head + "".join(
        MODE.format(frequency=frequency, ratio=ratio, direction=list(way), size=size)
        for way, size in zip(directions, SIZES, strict=True)
    )


def write_modal_job(folder, modes, *lines):
    """Write a job with some modes instead of its slides."""
    text = write_slides_job(folder, *lines).read_text()
    file = folder / "modal.toml"
    file.write_text(with_machine(text, modes))
    return file


@pytest.mark.slow
def test_modes_deviate_as_the_slides_that_they_are_those_of(tmp_path):
    arm = dm.simulate(dm.load_job(write_slides_job(tmp_path)))
    modal = dm.simulate(dm.load_job(write_modal_job(tmp_path, slides_modes())))
    off = np.abs(modal.deviation - arm.deviation).max()
    largest = np.abs(arm.deviation).max()
    assert largest > 50e-6
    assert off < 0.01 * largest
    assert modal.motor_positions is None and modal.joint_positions is None
    assert arm.to_dataset()["joint_positions"].attrs["units"] == "m"
    assert arm.to_dataset()["joint_unit"].values.tolist() == ["m", "m", "m"]
    assert "joint" not in modal.to_dataset().dims


@pytest.mark.slow
def test_the_error_band_of_modes_knows_the_controller(tmp_path):
    job = dm.load_job(write_modal_job(tmp_path, slides_modes()))
    scattered = dataclasses.replace(
        job.simulation, scatter=dm.ScatterSettings(force=0.1)
    )
    slow = dm.robot.Controller(low_pass=5.0)
    job = dataclasses.replace(job, simulation=scattered, controller=slow)
    solution = dm.simulate(job)
    followed = slow.motors(jnp.asarray(solution.commanded), job.tooth_period)
    known = dataclasses.replace(solution, motor_positions=followed)
    plain = dataclasses.replace(job, controller=None)
    found, wanted = (
        dm.sim.error_band(one, ran) for one, ran in ((job, solution), (plain, known))
    )
    np.testing.assert_allclose(found.shift, wanted.shift, rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_a_machine_of_modes_is_corrected(tmp_path):
    # Without an inverse drive it begins farther away than the default steps reach.
    file = write_modal_job(tmp_path, slides_modes(), "max_steps = 4")
    found = dm.correct(dm.load_job(file))
    assert "inverse_drive" not in found.cases
    rms = {name: one.measures.rms for name, one in found.methods.items()}
    assert rms["corrected"] < 0.2 * rms["uncorrected"]
    assert rms["corrected"] < 0.6 * rms["mirror"]


def test_the_axes_of_a_measurement_are_turned_into_those_of_the_work(tmp_path):
    head = '[machine]\nrpy = ["0 deg", "0 deg", "90 deg"]\ntool_axes = ["x", "z"]\n'
    job = dm.load_job(write_modal_job(tmp_path, slides_modes(head=head)))
    assert job.modes is not None and job.robot is None and not job.is_rigid
    turned = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(job.modes.shapes, turned / MASS**0.5, atol=1e-15)
    carried = turned * MASS**0.5 * [1, 0, 1]
    np.testing.assert_allclose(job.modes.participation, carried, atol=1e-12)


@pytest.mark.parametrize("count", [20, 21, 40])
def test_of_many_modes_as_soft_the_fastest_counts(tmp_path, count):
    """From 20 on no mode has more than the share below which one does not count."""
    mode = """[[machine.modes]]
frequency = "{} Hz"
damping_ratio = 0.1
direction = [1, 0, 0]
stiffness = "1 N/um"
"""

    def substeps(*frequencies):
        modes = "".join(map(mode.format, frequencies))
        file = write_modal_job(tmp_path, modes)
        file.write_text(file.read_text().replace("substeps = 4", ""))
        return dm.load_job(file).simulation.substeps

    assert substeps(*np.linspace(200, 400, count)) == substeps(400) > substeps(200)


def test_modes_may_stand_in_a_file_of_their_own(tmp_path):
    own = dm.load_job(write_modal_job(tmp_path, slides_modes()))
    (tmp_path / "modes.toml").write_text(slides_modes(head=""))
    named = '[machine]\nfile = "modes.toml"\n'
    job = dm.load_job(write_modal_job(tmp_path, named))
    assert job.modes is not None and own.modes is not None
    np.testing.assert_array_equal(job.modes.shapes, own.modes.shapes)


@pytest.mark.parametrize(
    ("modes", "message"),
    [
        ("[machine]\n", "nothing of modes and file"),
        ('[machine]\nfile = "none.toml"\n', "no such file"),
        (slides_modes() + '[robot]\nmodel = "ur10e"\n', "a job has either"),
        (slides_modes(((0, 0, 0), (0, 1, 0), (0, 0, 1))), "a direction is required"),
        (slides_modes().replace('mass = "80.0 kg"', ""), "nothing of stiffness"),
        (slides_modes().replace(" Hz", ""), "without a unit"),
        (
            slides_modes() + "[machine.extra]\na = 1\n",
            "extra: found an unknown key; allowed: modes, file, rpy, tool_axes",
        ),
    ],
)
def test_faulty_modes_are_refused(tmp_path, modes, message):
    with pytest.raises(dm.JobError, match=message):
        dm.load_job(write_modal_job(tmp_path, modes))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('command = "joint"', "has no joints"),
        ('method = "inverse_drive"', "known of a robot alone"),
    ],
)
def test_what_only_a_robot_has_is_refused(tmp_path, line, message):
    with pytest.raises(dm.JobError, match=message):
        dm.load_job(write_modal_job(tmp_path, slides_modes(), line))
