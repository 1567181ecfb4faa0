"""`[controller]` of a job, and what it does to a run."""

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import JobError, load_job, sim
from small_job import FLANGE_SPRING

PROGRAM = """G21 G17 G90 G94
G0 X-6 Y5 Z1
G0 Z-1
G1 X4 F3000
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
material = "aluminium_3.1325"
[stock]
lower = ["0 mm", "0 mm", "-3 mm"]
upper = ["8 mm", "10 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
[robot]
rigid = true
"""
ROBOT = """model = "reis_rv130_like"
work_in_base = { position = ["1525 mm", "-5 mm", "936 mm"] }
"""


def write(folder, controller, robot=ROBOT):
    (folder / "part.ngc").write_text(PROGRAM)
    (folder / "job.toml").write_text(JOB.replace("rigid = true", robot) + controller)
    return folder / "job.toml"


def test_an_ideal_controller_is_none(tmp_path):
    plain = load_job(write(tmp_path, ""))
    ideal = load_job(write(tmp_path, '[controller]\npreset = "ideal"'))
    assert plain.controller is None and ideal.controller is None
    assert np.array_equal(plain.path.positions, ideal.path.positions)


def test_a_preset_and_keys_of_its_own(tmp_path):
    table = """[controller]
preset = "kuka_krc4_like"
moving_average = "none"
interpolation = "hold"
bandwidth = ["4 Hz", "5 Hz", "6 Hz", "7 Hz", "8 Hz", "9 Hz"]
shaper = { frequency = "9 Hz", damping_ratio = 0.04 }
"""
    found = load_job(write(tmp_path, table)).controller
    assert found is not None
    assert found.interpolation_cycle == pytest.approx(12e-3)
    assert found.interpolation == "hold"
    assert found.moving_average is None
    assert found.damping_ratio == pytest.approx(0.707)
    assert found.bandwidth is not None
    assert np.allclose(found.bandwidth, [4, 5, 6, 7, 8, 9])
    assert found.shaper_frequency == pytest.approx(9.0)
    assert found.shaper_damping_ratio == pytest.approx(0.04)


def test_the_interpolation_of_a_preset_goes_with_its_cycle(tmp_path):
    table = '[controller]\npreset = "abb_irc5_like"\ninterpolation_cycle = "none"'
    found = load_job(write(tmp_path, table)).controller
    assert found is not None and found.interpolation_cycle is None


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('preset = "best"', "preset: found 'best'; allowed: ideal, "),
        ('bandwidth = "8"', "bandwidth: found '8'"),
        ('bandwidth = ["8 Hz", "9 Hz"]', "bandwidth: found 2 values"),
        ("damping_ratio = 0.7", "damping_ratio: found without a bandwidth"),
        ('bandwidth = "8 Hz"\ndamping_ratio = 0', "a finite number above 0"),
        ('interpolation = "round"', "interpolation: found 'round'"),
        ('low_pas = "8 Hz"', "low_pas: found an unknown key; allowed: "),
        ("shaper = { damping_ratio = 0.1 }", "frequency: found nothing"),
        ('shaper = { frequency = "9 Hz", damping_ratio = 1 }', "to less than 1"),
        ('bandwidth = "10 Hz"\ndamping_ratio = inf', "a finite number above 0"),
        ('bandwidth = "10 Hz"\ndamping_ratio = 1e300', "tooth periods before and"),
        ('bandwidth = "1e-320 Hz"', "inf tooth periods before and"),
        ('moving_average = "1 h"', "at most 1000000 are allowed"),
        ('interpolation = "linear"', "interpolation: found without an interp"),
        (
            'preset = "abb_irc5_like"\ninterpolation_cycle = "none"\n'
            'interpolation = "hold"',
            "interpolation: found without an interp",
        ),
    ],
)
def test_what_is_wrong_has_one_line(tmp_path, table, message):
    with pytest.raises(JobError) as error:
        load_job(write(tmp_path, f"[controller]\n{table}"))
    (problem,) = error.value.problems
    assert problem.startswith("[controller]") and message in problem


def test_a_jerk_is_the_time_that_keeps_it(tmp_path):
    """Tangential jerk of a straight way, by differences of a finely sampled path."""
    file = write(tmp_path, "", robot="rigid = true")
    text = file.read_text().replace(
        'file = "part.ngc"', 'file = "part.ngc"\njerk = "40 m/s^3"'
    )
    file.write_text(text)
    path = load_job(file).path
    step = path.time[1] - path.time[0]
    jerk = np.abs(np.diff(path.positions, n=3, axis=0)).max() / step**3
    assert 0.9 * 20.0 < jerk < 40.0 * (1 + 1e-6)
    file.write_text(text.replace("jerk =", 'smoothing = "10 ms"\njerk ='))
    with pytest.raises(JobError, match="jerk: found beside smoothing"):
        load_job(file)


def test_a_rigid_machine_has_no_motors(tmp_path):
    file = write(tmp_path, '[controller]\nbandwidth = "8 Hz"', robot="rigid = true")
    with pytest.raises(JobError, match=r"\[controller\]"):
        load_job(file)


def test_the_motors_follow_their_controller(tmp_path):
    """At a constant speed they are where they should be, and a stop is rounded."""
    plain = load_job(write(tmp_path, ""))
    job = load_job(write(tmp_path, '[controller]\nmoving_average = "100 ms"'))
    assert job.controller is not None
    rest = (job.path.step_count - plain.path.step_count) // 2
    assert rest * job.tooth_period >= 100e-3
    rows = slice(rest, rest + plain.path.step_count)
    assert np.allclose(job.path.positions[rows], plain.path.positions)
    command, _ = sim.JobKinematics(job).motors(jnp.asarray(job.path.positions))
    theta = np.asarray(job.controller.motors(command, job.tooth_period))
    shifts = np.linspace(-50e-3, 50e-3, 2001)
    command = np.asarray(command)
    at = job.path.time[:, None] + shifts[None]
    for have, one in zip(theta.T, command.T, strict=True):
        mean = np.trapezoid(np.interp(at, job.path.time, one), shifts, axis=1) / 100e-3
        assert np.allclose(have, mean, atol=2e-8)
    assert np.abs(theta - command).max() > 1e-5


SERVOS = """[controller]
bandwidth = ["4 Hz", "5 Hz", "6 Hz", "7 Hz", "8 Hz", "9 Hz"]
damping_ratio = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
"""


def test_joints_without_a_motor_leave_the_delay_of_the_servos(tmp_path):
    plain = load_job(write(tmp_path, SERVOS))
    sprung = load_job(write(tmp_path, SERVOS, ROBOT + FLANGE_SPRING))
    assert plain.controller is not None and sprung.controller is not None
    lag = 2 * np.arange(0.5, 1.05, 0.1) / (2 * np.pi * np.arange(4.0, 10.0))
    assert float(plain.controller.delay) == pytest.approx(lag.mean(), rel=1e-12)
    bandwidth = sprung.controller.bandwidth
    assert bandwidth is not None and np.shape(bandwidth) == (9,)
    assert float(sprung.controller.delay) == pytest.approx(lag.mean(), rel=1e-12)
    assert plain.path.step_count == sprung.path.step_count


def test_a_fault_of_a_spring_is_no_fault_of_the_controller(tmp_path):
    heavy = FLANGE_SPRING.replace("30 kg", "99 kg")
    with pytest.raises(JobError) as error:
        load_job(write(tmp_path, SERVOS, ROBOT + heavy))
    (problem,) = error.value.problems
    assert "flange_spring" in problem
