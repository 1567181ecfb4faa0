"""A job whose robot is calibrated: two kinematics, and a work that is touched off."""

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm

# The slide along y is displaced across its axis.
DISPLACED = """
[robot.calibration]
rotation = [
  ["0 mrad", "0 mrad", "0 mrad"],
  ["0 mrad", "0 mrad", "0 mrad"],
  ["0 mrad", "0 mrad", "0 mrad"],
]
displacement = [
  ["0 mm", "0 mm", "0 mm"],
  ["0 mm", "0.4 mm", "0 mm"],
  ["0 mm", "0 mm", "0 mm"],
]
"""
POINTS = """
[registration]
points = [["0 mm", "0 mm", "0 mm"], ["8 mm", "0 mm", "0 mm"], ["8 mm", "8 mm", "0 mm"]]
"""


def test_a_displaced_link_is_touched_off(tmp_path):
    file = write_slides_job(tmp_path)
    plain = dm.load_job(file)
    file.write_text(file.read_text() + DISPLACED)
    job = dm.load_job(file)
    assert job.nominal is not None and job.robot is not None
    assert len(job.nominal.probes) == 40
    away = np.asarray(job.T_base_work)[:3, 3] - np.asarray(plain.T_base_work)[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(away), 0.4e-3, rtol=1e-6)
    assert any("[robot.calibration]: the controller is taken" in n for n in job.notes)
    # A constant displacement leaves nothing after touching off.
    errors = job.nominal.probe_errors(job.robot)
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)
    command = jnp.asarray(plain.path.positions)
    motors = [dm.sim.JobKinematics(j).motors(command).positions for j in (plain, job)]
    np.testing.assert_allclose(motors[0], motors[1], atol=1e-12)


def test_points_of_the_registration(tmp_path):
    file = write_slides_job(tmp_path)
    text = file.read_text()
    file.write_text(text + DISPLACED + POINTS)
    job = dm.load_job(file)
    assert job.nominal is not None
    wanted = np.array([[0, 0, 0], [8e-3, 0, 0], [8e-3, 8e-3, 0]])
    np.testing.assert_allclose(job.nominal.probes, wanted, atol=1e-9)
    for points, message in (
        ('[["0 mm", "0 mm", "0 mm"]]', "points: found"),
        (
            '[["0 mm", "0 mm", "0 mm"], ["1 mm", "0 mm", "0 mm"], ["2 mm", "0 mm", '
            '"0 mm"]]',
            "found points on a line",
        ),
    ):
        file.write_text(text + DISPLACED + f"[registration]\npoints = {points}\n")
        with pytest.raises(dm.JobError) as error:
            dm.load_job(file)
        assert message in str(error.value)
