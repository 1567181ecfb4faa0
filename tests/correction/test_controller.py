"""A correction through a controller: the linear system, and what it makes of a path."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill.config import load_job
from diffmill.correction import TipPlant, correct
from diffmill.process import StockHeld
from diffmill.sim import JobKinematics

PROGRAM = """G21 G17 G90 G94
G0 X-6 Y5 Z1
G0 Z-1
G1 X0 F3000
G1 Y8
G0 Z1
M2
"""
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
helix_angle = "0 deg"
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
upper = ["8 mm", "14 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
corner_tolerance = "0 mm"
[robot]
model = "reis_rv130_like"
work_in_base = { position = ["1525 mm", "-5 mm", "936 mm"] }
joint_damping = [
  "1825 N*m*s/rad", "4675 N*m*s/rad", "1200 N*m*s/rad",
  "157.5 N*m*s/rad", "125 N*m*s/rad", "25 N*m*s/rad",
]
[controller]
moving_average = "30 ms"
interpolation_cycle = "12 ms"
interpolation = "hold"
bandwidth = "10 Hz"
damping_ratio = 0.7
"""


@pytest.fixture
def job(tmp_path):
    (tmp_path / "part.ngc").write_text(PROGRAM)
    (tmp_path / "job.toml").write_text(JOB)
    return load_job(tmp_path / "job.toml")


@pytest.mark.slow
def test_the_linear_system_goes_through_the_controller(job):
    plant = TipPlant(job, StockHeld())
    command = jnp.asarray(job.path.positions)
    rng = np.random.default_rng(0)
    change = jnp.asarray(1e-6 * np.cumsum(rng.normal(size=command.shape), axis=0))
    system = plant.linearised(command)
    assert system is not None
    found = system.move(change[..., None])
    ran, pushed = jax.jit(lambda x, d: jax.jvp(plant, (x,), (d,)))(command, change)
    for have, want in [
        (system.motion.actual, ran.actual),
        (found.actual[0], pushed.actual),
        (found.force[0], pushed.force),
    ]:
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))


@pytest.mark.slow
def test_a_correction_makes_up_for_the_controller(job):
    found = correct(job)
    error = {
        name: np.sqrt(np.mean(np.asarray(case.contour_error)[case.is_cutting] ** 2))
        for name, case in found.cases.items()
    }
    assert error["corrected"] < 0.1 * error["uncorrected"]
    assert error["corrected"] < 0.3 * min(error["mirror"], error["inverse_drive"])
    # What is recorded are the motors as they move, not as they are told.
    told, _ = JobKinematics(job).motors(jnp.asarray(job.path.positions))
    assert job.controller is not None and found.before.motor_positions is not None
    moved = job.controller.motors(told, job.tooth_period)
    assert np.allclose(found.before.motor_positions, moved, rtol=0, atol=1e-12)
    assert np.abs(moved - told).max() > 1e-5
