"""A correction through a controller: the linear system, and what it makes of a path."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import cut_rms
from slides_job import write_slides_job

from diffmill.config import load_job
from diffmill.correction import TipPlant, UnsuitableSettings, correct
from diffmill.process import FrozenStock
from diffmill.sim import JobKinematics
from small_job import ARM, write_job

PROGRAM = """G21 G17 G90 G94
G0 X-6 Y5 Z1
G0 Z-1
G1 X0 F3000
G1 Y8
G0 Z1
M2
"""
JOB = {
    "cutter.helix_angle": "0 deg",
    "cutter.flute_length": "22 mm",
    "force.K_te": "3.0 N/mm",
    "force.K_re": "15.4 N/mm",
    "force.K_ae": "4.5 N/mm",
    "stock.upper": ["8 mm", "14 mm", "0 mm"],
    "program.corner_tolerance": "0 mm",
    "robot": ARM,
    "robot.joint_damping": [
        f"{damping} N*m*s/rad" for damping in (1825, 4675, 1200, 157.5, 125, 25)
    ],
    "controller": {
        "moving_average": "30 ms",
        "interpolation_cycle": "12 ms",
        "interpolation": "hold",
        "bandwidth": "10 Hz",
        "damping_ratio": 0.7,
    },
}


@pytest.fixture
def job(tmp_path):
    return load_job(write_job(tmp_path, JOB, program=PROGRAM))


CONTROLLER = (
    "[controller]",
    'interpolation_cycle = "12 ms"',
    'moving_average = "30 ms"',
    'dead_time = "8 ms"',
    "bandwidth = ['10 Hz', '8 Hz', '12 Hz']",
    "damping_ratio = 0.7",
)
HOP = 60


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    """A plant of three slides behind a controller, and a command of it."""
    program = "G21 G90\nG0 X-5.5 Y1 Z-0.8\nG1 X0 F3000\nG1 Y3\nM2\n"
    folder = tmp_path_factory.mktemp("slides")
    file = write_slides_job(folder, *CONTROLLER, program=program)
    job = load_job(file).with_precision()
    count = job.path.step_count
    share = 0.2 + 0.6 * np.random.default_rng(1).random(count)
    plant = TipPlant(job, FrozenStock(), share)
    swing = np.sin(0.11 * np.arange(count)[:, None] + np.arange(3)[None])
    return plant, np.asarray(job.path.positions) + 2e-4 * swing


def rows_of(pieces, first, count):
    """Return the rows of a piece, and those ahead of it."""
    rows = np.arange(first, first + HOP + 1 + pieces.preview_rows)
    return np.minimum(rows, count - 1)


def assert_moves_as(system, found, ran, pushed):
    """Compare a linear system and its motion with a run and its derivative."""
    for have, want in [
        (system.motion.actual, ran.actual),
        (found.actual[0], pushed.actual),
        (found.force[0], pushed.force),
    ]:
        assert np.max(np.abs(have - want)) < 1e-9 * np.max(np.abs(want))


def test_an_overlap_that_the_controller_looks_across_is_refused(tmp_path):
    settings = ("horizon = 100", "overlap = 12")
    job = load_job(write_slides_job(tmp_path, *settings, *CONTROLLER))
    with pytest.raises(UnsuitableSettings, match=r"above the 1\d rows .* 12 rows"):
        correct(job)


@pytest.mark.slow
def test_pieces_of_a_job_do_what_the_whole_does(slides):
    plant, command = slides
    count, pieces = len(command), plant.pieces
    assert count > 3 * HOP and pieces.preview_rows > 10
    whole = plant.run(command)
    state = pieces.begin(jnp.asarray(command[: 3 + pieces.preview_rows]))
    once = eqx.debug.assert_max_traces(max_traces=1)
    run = eqx.filter_jit(once(lambda piece, command: piece.run(command)))
    # What the walls show at the first row of a piece, the one before has shown.
    actual, force = [], []
    for first in range(0, count, HOP):
        rows = rows_of(pieces, first, count)
        motion, state = run(pieces.piece(state, rows), jnp.asarray(command[rows]))
        actual.append(motion.actual[1:])
        force.append(motion.force[1:])
    assert np.abs(whole.force).max() > 20
    for parts, want in ((actual, whole.actual[1:]), (force, whole.force[1:])):
        have = np.concatenate(parts)[: count - 1]
        assert np.abs(have - want).max() < 1e-9 * np.abs(want).max()
    # With an ideal controller it is another motion.
    ideal = dataclasses.replace(plant.job, controller=None)
    other = dataclasses.replace(plant, job=ideal).run(command)
    assert np.abs(other.actual - whole.actual).max() > 1e-5


@pytest.mark.slow
def test_the_linear_system_of_a_piece_goes_through_the_controller(slides):
    plant, command = slides
    pieces, first = plant.pieces, HOP
    start = rows_of(pieces, 0, len(command))
    state = pieces.begin(jnp.asarray(command[: 3 + pieces.preview_rows]))
    run = eqx.filter_jit(lambda piece, command: piece.run(command))
    _, state = run(pieces.piece(state, start), jnp.asarray(command[start]))
    rows = rows_of(pieces, first, len(command))
    piece, here = pieces.piece(state, rows), jnp.asarray(command[rows])
    noise = np.random.default_rng(0).normal(size=here.shape)
    change = 1e-6 * np.cumsum(noise, axis=0)
    # The state at the start knows the rows up to those ahead, which stay.
    change[: pieces.preview_rows + 1] = 0
    change = jnp.asarray(change)
    system = piece.linearised(here)
    found = system.move(change[..., None])

    @eqx.filter_jit
    def pushed_through(piece, command, change):
        return jax.jvp(lambda x: piece.run(x)[0], (command,), (change,))

    ran, pushed = pushed_through(piece, here, change)
    assert_moves_as(system, found, ran, pushed)


@pytest.mark.slow
def test_the_linear_system_goes_through_the_controller(job):
    plant = TipPlant(job, FrozenStock())
    command = jnp.asarray(job.path.positions)
    rng = np.random.default_rng(0)
    change = jnp.asarray(1e-6 * np.cumsum(rng.normal(size=command.shape), axis=0))
    system = plant.linearised(command)
    assert system is not None
    found = system.move(change[..., None])
    ran, pushed = jax.jit(lambda x, d: jax.jvp(plant, (x,), (d,)))(command, change)
    assert_moves_as(system, found, ran, pushed)


@pytest.mark.slow
def test_a_correction_makes_up_for_the_controller(job):
    found = correct(job)
    error = {name: cut_rms(case) for name, case in found.cases.items()}
    assert error["corrected"] < 0.1 * error["uncorrected"]
    assert error["corrected"] < 0.3 * min(error["mirror"], error["inverse_drive"])
    # What is recorded are the motors as they move, not as they are told.
    told, _ = JobKinematics(job).motors(jnp.asarray(job.path.positions))
    assert job.controller is not None and found.before.motor_positions is not None
    moved = job.controller.motors(told, job.tooth_period)
    assert np.allclose(found.before.motor_positions, moved, rtol=0, atol=1e-12)
    assert np.abs(moved - told).max() > 1e-5


@pytest.mark.slow
def test_segments_of_a_job_find_what_its_whole_path_finds(tmp_path):
    preset = ("[controller]", 'preset = "kuka_krc4_like"')
    settings = ("max_steps = 10", "acceleration_factor = inf")
    # Less of an overlap than arm and servos ring leaves a corner in another minimum.
    parts = ("horizon = 220", "overlap = 130")
    load = lambda *lines: load_job(write_slides_job(tmp_path, *lines, *preset))
    whole, job = correct(load(*settings)), load(*settings, *parts)
    kept = []
    found = correct(job, on_checkpoint=lambda arrays: kept.append(dict(arrays)))
    rms = [cut_rms(x.after) for x in (whole, found)]
    assert rms[1] < 1.05 * rms[0]
    assert found.methods["corrected"].detail["segment_count"] == 3
    # In the middle of a sweep: the controller's state is kept with the plant's.
    at = [k for k, arrays in enumerate(kept) if "search/corrected/row" in arrays]
    again = correct(job, resume=kept[at[2]])
    assert np.array_equal(again.commanded, found.commanded)
