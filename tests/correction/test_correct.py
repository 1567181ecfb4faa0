"""Correcting a small job from its file, all methods, as the command line does."""

import dataclasses
import pathlib

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from diffmill import load_job, workpiece
from diffmill.correction import (
    AbstractObjective,
    InfeasibleLimit,
    JointLimits,
    NothingToCorrect,
    SplineOffsets,
    UnsuitableSettings,
    correct,
    project,
)
from diffmill.examples import copy_example
from diffmill.sim import JobKinematics
from small_job import ARM, write_job

PROGRAM = """G21 G17 G90 G94
G0 X-6 Y3 Z-1
G1 X7 F3000
G1 Y14
G1 X20
M2
"""
JOB = {
    "cutter.flute_length": "22 mm",
    "stock.upper": ["12 mm", "12 mm", "0 mm"],
    "program.acceleration": "1 m/s^2",
    "program.rapid_feed": "100 mm/s",
    "robot": ARM,
    "simulation": {"angles": 192, "substeps": 4},
    "correction": {"max_steps": 1},
}


@pytest.fixture
def load(tmp_path):
    def load(more="", program=PROGRAM):
        file = write_job(tmp_path, JOB, program=program)
        file.write_text(file.read_text() + more)
        return load_job(file)

    return load


def offsets_of(job):
    spacing = job.correction.knot_spacing
    return SplineOffsets(job.path.step_count, float(job.tooth_period), spacing)


def test_a_limit_below_the_program_is_refused_before_anything_runs(load):
    with pytest.raises(InfeasibleLimit, match="`max_acceleration`"):
        correct(load('max_acceleration = "0.2 m/s^2"\n'))


@pytest.mark.parametrize("method", ["adam", "mirror"])
def test_a_joint_beyond_its_limit_is_refused_before_anything_runs(load, method):
    job, told = load(f'method = "{method}"\n'), []
    desired = jnp.asarray(job.path.positions)
    most = float(JobKinematics(job).motors(desired).positions[:, 0].max())
    upper = jnp.asarray(job.robot.joint_upper).at[0].set(most - 1e-4)
    close = eqx.tree_at(lambda j: j.robot.joint_upper, job, upper)
    with pytest.raises(InfeasibleLimit, match="'axis_1'"):
        correct(close, on_progress=lambda message, rms: told.append(message))
    assert not told


def test_knots_wider_than_the_program_are_refused(load):
    with pytest.raises(UnsuitableSettings, match="`knot_spacing`"):
        correct(load('knot_spacing = "3 s"\n'))


COMPARED = {
    "uncorrected",
    "mirror",
    "mirror_iterated",
    "input_shaper",
    "inverse_drive",
    "corrected",
}


@pytest.mark.slow
def test_every_case_has_every_figure(load):
    more = 'max_velocity = "120 mm/s"\nfinishing_only = true\ncompare = "all"\n'
    job = load(more)
    result = correct(job)
    data = result.to_dataset()
    fastest = jnp.abs(jnp.diff(result.commanded, axis=0)).max() / job.tooth_period
    assert float(fastest) <= 0.12 * (1 + 1e-9)
    assert set(result.cases) == COMPARED
    parts = data["path_part"].values
    np.testing.assert_array_equal(parts >= 0, data["is_cutting"].values > 0)
    assert {0, 1, 2} <= set(parts.tolist())
    first = data.sel(case="corrected")
    error = np.abs(first["contour_error"].values)
    entry = np.sqrt(np.mean(error[parts == 0] ** 2))
    assert float(first["part_rms"].sel(part="entry")) == pytest.approx(entry)
    for name in ("contour_mean", "part_max", "surface_wall_rms", "surface_floor_p95"):
        assert data[name].attrs["units"] == "m"
        assert "case" in data[name].dims
    rms = np.sqrt(np.mean(error[parts >= 0] ** 2))
    before = data.sel(case="uncorrected")["contour_error"].values[parts >= 0]
    assert rms < 0.7 * np.sqrt(np.mean(before**2))


@pytest.mark.slow
def test_only_what_is_asked_for_runs(load, monkeypatch):
    result = correct(load('method = "mirror"\n'))
    assert tuple(result.cases) == ("uncorrected", "mirror", "inverse_drive")
    assert result.after is result.mirror and result.history == ()
    runs = {name: found.forward_runs for name, found in result.methods.items()}
    assert sum(runs.values()) <= 4
    # A case's solution and figures are those of one run.
    for name, found in result.methods.items():
        solution = result.cases[name]
        np.testing.assert_array_equal(found.command, solution.commanded)
        np.testing.assert_array_equal(
            found.motion.actual, solution.desired + solution.surface_deviation
        )
    # What is found is kept where the mesh of its surface is too large.
    whole = result.to_dataset()

    def large(*arguments, **options):
        raise ValueError("it would fill the memory.")

    monkeypatch.setattr(workpiece.SurfaceError, "of_stocks", large)
    data = result.to_dataset()
    assert data.attrs["surface_left_out"] == "it would fill the memory."
    np.testing.assert_array_equal(data["contour_error"], whole["contour_error"])
    assert "surface_wall_rms" in whole and "surface_left_out" not in whole.attrs
    # Once all is compiled, both cases take the time of one run of the arm.
    again = correct(load('method = "mirror"\n')).wall_time
    assert again["uncorrected"] > 0.5 * again["mirror"]


@pytest.mark.slow
def test_weights_that_leave_nothing_are_named(load):
    with pytest.raises(NothingToCorrect, match="lines 3 to 4"):
        correct(load("weight = [{ lines = [1, 9], value = 0 }]\n"))


@pytest.mark.slow
def test_a_surface_of_which_nothing_is_left_does_not_suit(load):
    job = load('objective = "surface"\n')
    scrap = workpiece.box([3e-3, 1e-3, -1e-3], [6e-3, 5e-3, 0], 0.5e-3)
    with pytest.raises(UnsuitableSettings, match="walls or floors"):
        correct(dataclasses.replace(job, stock=scrap))


@pytest.mark.slow
def test_joints_are_held_within_their_limits(load):
    """A limit 0.1 mm of travel beyond the program: most offsets would break it."""
    job = load()
    spline = offsets_of(job)
    nominal = np.asarray(job.path.positions)
    bound = float(job.correction.max_offset)
    assert JointLimits(job).rows(spline, nominal, bound) == ()
    rows = lambda tips: JobKinematics(job).motors(jnp.asarray(tips)).positions
    motors = np.asarray(rows(nominal))
    joint = 0
    limit = float(motors[:, joint].max()) + 1e-4 / 1.5
    upper = jnp.asarray(job.robot.joint_upper).at[joint].set(limit)
    close = eqx.tree_at(lambda j: j.robot.joint_upper, job, upper)
    (limits,) = JointLimits(close).rows(spline, nominal, bound)
    wild = bound * np.sign(np.random.default_rng(0).normal(size=nominal.shape))
    wild = np.repeat(wild[::60], 60, axis=0)[: len(nominal)]
    free = nominal + np.asarray(
        spline.offsets(jnp.asarray(project(spline, wild, bound)))
    )
    with pytest.raises(InfeasibleLimit, match="`joint limits`"):
        JointLimits(close).check(free, is_joints=False)
    coefficients = project(spline, wild, bound, limits=(limits,))
    held = nominal + np.asarray(spline.offsets(jnp.asarray(coefficients)))
    JointLimits(close).check(held, is_joints=False)
    most = np.asarray(rows(held))[:, joint].max()
    assert limit - 1e-5 < most <= limit
    # The rows are the derivative of what the motors do.
    small = 1e-3 * coefficients
    moved = nominal + np.asarray(spline.offsets(jnp.asarray(small)))
    change = np.asarray(rows(moved)) - motors
    rows = limits.apply(small)
    assert np.max(np.abs(rows)) > 1e-8
    apart = np.abs(change[:, joint][None] - rows[:, None]).min(axis=1)
    assert apart.max() < 2e-3 * np.max(np.abs(rows))
    deadband = eqx.tree_at(lambda j: j.robot.joint_upper, job, upper - 2e-4)
    with pytest.raises(InfeasibleLimit, match="`joint limits`"):
        JointLimits(deadband).rows(spline, nominal, bound)


@pytest.mark.slow
def test_a_joint_near_its_limit_bends_no_more_than_elsewhere(load):
    """An arm that starts beyond the limit would start in another configuration."""
    job, joint, room, bound = load(), 4, 3e-4, 1e-3
    nominal = np.asarray(job.path.positions)
    most = np.asarray(JobKinematics(job).motors(jnp.asarray(nominal)).positions).max(0)
    upper = jnp.asarray(job.robot.joint_upper).at[joint].set(most[joint] + room)
    close = eqx.tree_at(lambda j: j.robot.joint_upper, job, upper)
    (limits,) = JointLimits(close).rows(offsets_of(job), nominal, bound)
    # What the whole offset bends is about its square over the arm's length.
    assert limits.upper.min() == pytest.approx(room, abs=2 * bound**2)


# There and back again: an offset is 0 at both ends.
ACROSS = """G21 G17 G90 G94
G0 X-6 Y6 Z-1
G1 X7 Y-7 F3000
G1 X-6 Y6
M2
"""


@pytest.mark.slow
def test_a_joint_is_held_where_its_motion_bends_least_at_the_corners(load):
    """45 degrees aside axis 1 bends with x^2 - y^2 of the offset: 0 at its corners."""
    job, room, bound = load(program=ACROSS), 1e-3, 5e-3
    place = jnp.asarray(job.T_base_work).at[:2, 3].set(1.525 / np.sqrt(2))
    job = eqx.tree_at(lambda j: j.T_base_work, job, place)
    nominal = np.asarray(job.path.positions)
    motors = lambda tips: JobKinematics(job).motors(jnp.asarray(tips)).positions[:, 0]
    limit = float(motors(nominal).min()) - room
    lower = jnp.asarray(job.robot.joint_lower).at[0].set(limit)
    close = eqx.tree_at(lambda j: j.robot.joint_lower, job, lower)
    spline = offsets_of(job)
    limits = JointLimits(close).rows(spline, nominal, bound)
    aside = np.broadcast_to(bound * np.array([[-0.5, -1.0, 0.0]]), nominal.shape)
    held = project(spline, aside, bound, limits=limits)
    command = nominal + np.asarray(spline.offsets(jnp.asarray(held)))
    JointLimits(close).check(command, is_joints=False)
    assert float(motors(command).min()) < limit + 3e-5


class Along(AbstractObjective):
    """The deviation along x alone."""

    def errors(self, problem, motion, lag_weight):
        off = (motion.actual - jnp.asarray(problem.desired))[:, 0]
        return off * jnp.sqrt(problem.is_cutting / problem.is_cutting.sum())


def test_an_objective_of_ones_own_sees_the_whole_path(load):
    with pytest.raises(UnsuitableSettings, match="one of your own"):
        correct(load("horizon = 40\noverlap = 10\n"), objective=Along())


@pytest.mark.slow
def test_an_objective_of_ones_own_becomes_small(load):
    job = load("")
    along = lambda found: np.asarray(found.after.deviation)[:, 0]
    cuts = lambda found: along(found)[np.asarray(found.after.is_cutting)]
    own, path = (correct(job, objective=x) for x in (Along(), None))
    # The path alone sees the deviation along it only a little.
    assert np.std(cuts(own)) < 0.5 * np.std(cuts(path))


@pytest.mark.slow
def test_the_command_does_not_swing_into_what_has_been_cut(tmp_path):
    """The short job of the documents: its floor once lay 181 um too deep."""
    document = pathlib.Path(__file__).parents[2] / "docs" / "job.md"
    text = document.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    copy_example("paper_small", tmp_path)
    (tmp_path / "short.toml").write_text(text)
    found = correct(load_job(tmp_path / "short.toml"))
    data = found.to_dataset().sel(case="corrected")
    cuts = np.asarray(data["is_cutting"], bool)
    largest = np.abs(np.asarray(data["contour_error"]))[cuts].max()
    deepest = float(data["surface_deepest"])
    assert largest < 25e-6 and deepest < 1.5 * largest, (largest, deepest)


@pytest.mark.slow
def test_half_a_turn_from_the_start_is_no_bend(load):
    """Either way round is as near there: an offset may choose the other."""
    job = load()
    # In the plane of axes 2 and 3, so that what chooses is the offset's sign alone.
    nominal = np.asarray(job.path.positions) + np.array([0.0, 2e-3, 0.0])
    start = np.array(JobKinematics(job).motors(jnp.asarray(nominal)).positions[0])
    start[0] = start[3] = 0.0
    start[-1] -= np.pi
    wide = np.full(start.size, 9.0)
    there = lambda j: (j.joint_start, j.robot.joint_lower, j.robot.joint_upper)
    job = eqx.tree_at(there, job, (start, -wide, wide), is_leaf=lambda x: x is None)
    aside = [
        JobKinematics(job).motors(jnp.asarray(nominal + np.array([0.0, y, 0.0])))
        for y in (1e-3, -1e-3)
    ]
    ways = np.diff([float(one.positions[0, -1]) for one in aside])
    assert abs(ways[0]) == pytest.approx(2 * np.pi, abs=0.01)
    bound = float(job.correction.max_offset)
    assert JointLimits(job).rows(offsets_of(job), nominal, bound) == ()
