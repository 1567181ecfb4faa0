"""`[controller]` of a job, and what it does to a run."""

import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import load_job, sim
from small_job import ARM, FLANGE_SPRING, SLOT, problems_of, write_job

JOB = {
    "cutter.flute_length": "22 mm",
    "force": {"material": "aluminium_3.1325"},
    "stock.upper": ["8 mm", "10 mm", "0 mm"],
}
PROGRAM = SLOT.replace("X20", "X4")


def write(folder, controller, robot=ARM, more=""):
    """Write a job with a table of its controller, and more text behind it."""
    changes = {"robot": robot, "controller": controller}
    file = write_job(folder, JOB, changes, program=PROGRAM)
    file.write_text(file.read_text() + more)
    return file


def test_an_ideal_controller_is_none(tmp_path):
    plain = load_job(write(tmp_path, None))
    ideal = load_job(write(tmp_path, {"preset": "ideal"}))
    assert plain.controller is None and ideal.controller is None
    assert np.array_equal(plain.path.positions, ideal.path.positions)


def test_a_preset_and_keys_of_its_own(tmp_path):
    table = {
        "preset": "kuka_krc4_like",
        "moving_average": "none",
        "interpolation": "hold",
        "bandwidth": ["4 Hz", "5 Hz", "6 Hz", "7 Hz", "8 Hz", "9 Hz"],
        "shaper": {"frequency": "9 Hz", "damping_ratio": 0.04},
    }
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
    table = {"preset": "abb_irc5_like", "interpolation_cycle": "none"}
    found = load_job(write(tmp_path, table)).controller
    assert found is not None and found.interpolation_cycle is None


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"preset": "best"}, "preset: found 'best'; allowed: ideal, "),
        ({"bandwidth": "8"}, "bandwidth: found '8'"),
        ({"bandwidth": ["8 Hz", "9 Hz"]}, "bandwidth: found 2 values"),
        ({"damping_ratio": 0.7}, "damping_ratio: found without a bandwidth"),
        ({"bandwidth": "8 Hz", "damping_ratio": 0}, "a finite number above 0"),
        ({"interpolation": "round"}, "interpolation: found 'round'"),
        ({"low_pas": "8 Hz"}, "low_pas: found an unknown key; allowed: "),
        ({"shaper": {"damping_ratio": 0.1}}, "frequency: found nothing"),
        ({"shaper": {"frequency": "9 Hz", "damping_ratio": 1}}, "to less than 1"),
        ({"bandwidth": "10 Hz", "damping_ratio": np.inf}, "a finite number above 0"),
        ({"bandwidth": "10 Hz", "damping_ratio": 1e300}, "tooth periods before and"),
        ({"bandwidth": "1e-320 Hz"}, "inf tooth periods before and"),
        ({"moving_average": "1 h"}, "at most 1000000 are allowed"),
        ({"interpolation": "linear"}, "interpolation: found without an interp"),
        (
            {"preset": "abb_irc5_like", "interpolation_cycle": "none"}
            | {"interpolation": "hold"},
            "interpolation: found without an interp",
        ),
    ],
)
def test_what_is_wrong_has_one_line(tmp_path, table, message):
    (problem,) = problems_of(write(tmp_path, table))
    assert problem.startswith("[controller]") and message in problem


def test_a_jerk_is_the_time_that_keeps_it(tmp_path):
    """Tangential jerk of a straight way, by differences of a finely sampled path."""
    jerk = {"program.jerk": "40 m/s^3"}
    path = load_job(write_job(tmp_path, JOB, jerk, program=PROGRAM)).path
    step = path.time[1] - path.time[0]
    largest = np.abs(np.diff(path.positions, n=3, axis=0)).max() / step**3
    assert 0.9 * 20.0 < largest < 40.0 * (1 + 1e-6)
    both = jerk | {"program.smoothing": "10 ms"}
    (problem,) = problems_of(write_job(tmp_path, JOB, both, program=PROGRAM))
    assert "jerk: found beside smoothing" in problem


def test_a_rigid_machine_has_no_motors(tmp_path):
    (problem,) = problems_of(write(tmp_path, {"bandwidth": "8 Hz"}, {"rigid": True}))
    assert "[controller]" in problem


def test_the_motors_follow_their_controller(tmp_path):
    """At a constant speed they are where they should be, and a stop is rounded."""
    plain = load_job(write(tmp_path, None))
    job = load_job(write(tmp_path, {"moving_average": "100 ms"}))
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


SERVOS = {
    "bandwidth": ["4 Hz", "5 Hz", "6 Hz", "7 Hz", "8 Hz", "9 Hz"],
    "damping_ratio": [0.5, 0.6, 0.7, 0.8, 0.9, 1.0],
}


def test_joints_without_a_motor_leave_the_delay_of_the_servos(tmp_path):
    plain = load_job(write(tmp_path, SERVOS))
    sprung = load_job(write(tmp_path, SERVOS, more=FLANGE_SPRING))
    assert plain.controller is not None and sprung.controller is not None
    lag = 2 * np.arange(0.5, 1.05, 0.1) / (2 * np.pi * np.arange(4.0, 10.0))
    assert float(plain.controller.delay) == pytest.approx(lag.mean(), rel=1e-12)
    bandwidth = sprung.controller.bandwidth
    assert bandwidth is not None and np.shape(bandwidth) == (9,)
    assert float(sprung.controller.delay) == pytest.approx(lag.mean(), rel=1e-12)
    assert plain.path.step_count == sprung.path.step_count


def test_a_fault_of_a_spring_is_no_fault_of_the_controller(tmp_path):
    heavy = FLANGE_SPRING.replace("30 kg", "99 kg")
    (problem,) = problems_of(write(tmp_path, SERVOS, more=heavy))
    assert "flange_spring" in problem
