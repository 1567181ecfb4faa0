"""Learning from parts that were cut on a machine that is not its model."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl

NOISE = 2e-6
PRIOR = dl.MachinePrior(friction=1e-5, backlash=1e-5)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    return dm.load_job(file).with_precision()


@pytest.fixture(scope="module")
def truth(job):
    """Slides with other springs and forces, and a squareness error."""
    scale = np.zeros(len(job.parameter_names))
    scale[:3] = np.log([0.85, 1.1, 0.95])
    scale[6:9] = np.log([1.25, 1.2, 1.1])
    return dm.sim.mismatched(job, job.with_scaled(jnp.asarray(scale)))


def tracked(truth, commanded, seed=1):
    """A part that was cut there, as a tracker saw it, and its contour error."""
    run = dm.simulate(truth, commanded=commanded)
    noise = NOISE * np.random.default_rng(seed).normal(size=(len(run.time), 3))
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation) + noise
    return dl.Part(commanded, dl.TrackedTips(tips, NOISE)), run.contour.rms


@pytest.mark.slow
def test_columns_are_differences(job):
    machine = dl.AdaptableMachine.of_job(job, PRIOR)
    rigid = dm.sim.rigid_cut(machine.base, dm.process.FrozenStock())
    x, program = np.zeros(machine.count), np.asarray(job.path.positions)
    # Away from gaps, whose corners are round for slopes alone.
    x[machine.group("friction").index] = 0.5
    x[machine.group("backlash").index] = 0.3
    columns = machine.columns(x, rigid, program)

    def deviation(x):
        adapted = machine.job_at(x, smooth=True)
        run = dm.sim.Solution.of_command(
            adapted, rigid, jnp.asarray(program), dm.process.FrozenStock()
        )
        return np.asarray(run.surface_deviation) + machine.field(x, program)

    for k in np.flatnonzero(machine.is_free):
        way = 0.02 * np.eye(machine.count)[k]
        numeric = (deviation(x + way) - deviation(x - way)) / 0.04
        size = np.abs(numeric).max()
        if size > 1e-8:
            away = np.sqrt(np.mean((columns[:, :, k] - numeric) ** 2))
            assert away < 0.15 * np.sqrt(np.mean(numeric**2)), machine.names[k]


@pytest.mark.slow
def test_one_part_makes_the_next_one_better(job, truth):
    program = np.asarray(job.path.positions)
    part, before = tracked(truth, program)
    learnt = dl.learn(job, [part], prior=PRIOR)
    after = dm.simulate(truth, commanded=learnt.commanded).contour.rms
    nominal = dm.simulate(truth, commanded=dm.correct(job).commanded).contour.rms
    assert after < 0.4 * nominal < before
    # What is expected holds what comes out, but for the noise that was learnt.
    assert learnt.correction is not None
    expected = learnt.correction.after.contour.rms
    assert after < expected + 2 * NOISE
    assert learnt.gain > 100
    again, _ = tracked(truth, learnt.commanded, 2)
    second = dl.learn(job, [part, again], prior=PRIOR, known=learnt)
    better = dm.simulate(truth, commanded=second.commanded).contour.rms
    assert better < after + NOISE


@pytest.mark.slow
def test_a_model_that_is_right_is_not_spoilt(job):
    same = dm.sim.mismatched(job, job)
    part, before = tracked(same, np.asarray(dm.correct(job).commanded))
    learnt = dl.learn(job, [part], prior=PRIOR)
    after = dm.simulate(same, commanded=learnt.commanded).contour.rms
    assert after < before + 0.5 * NOISE


def test_samples_of_a_tracker_are_found_on_the_path(job):
    """A deviation that grows along the program, seen at times of its own and late."""
    rigid = dm.simulate(dataclasses.replace(job, robot=None))
    program = np.asarray(rigid.time)
    time = np.linspace(program[2], program[-2], 400)
    at = lambda rows: np.stack([np.interp(time, program, r) for r in rows.T], axis=1)
    grown = 1e-6 * time[:, None] * np.array([1.0, 2.0, 3.0])
    tips = at(np.asarray(rigid.desired)) + grown
    measured = dl.TrackedTips(tips, NOISE, time, offset=1e-5, delay=1e-3)
    seen = measured.seen(job, rigid)
    assert seen.nuisance.shape[1] == 4 and seen.is_tracked
    rows = 1e-6 * dl.wall_times(rigid)[:, None] * np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(seen.of_rows(rows), seen.value, atol=1e-12)
    with pytest.raises(ValueError, match="a row for each of the path's"):
        dl.TrackedTips(tips, NOISE).seen(job, rigid)
    with pytest.raises(ValueError, match="in the order of time"):
        dl.TrackedTips(tips, NOISE, time[::-1]).seen(job, rigid)


def test_points_of_walls_are_found_on_the_path(job):
    """A wall beside a straight cut along x: the tool's side, one radius away."""
    rigid = dm.simulate(dataclasses.replace(job, robot=None))
    desired, radius = np.asarray(rigid.desired), 5e-3
    rows = np.flatnonzero(np.asarray(rigid.is_cutting))
    row = rows[
        np.argmin(np.abs(desired[rows, 0] - 2e-3) + np.abs(desired[rows, 1] - 1e-3))
    ]
    error, normal = 7e-6, np.array([0.0, -1.0, 0.0])
    wall = desired[row] + np.array([0.0, radius + error, 0.2e-3])
    point = dl.WallPoints(wall[None], normal[None], NOISE)
    seen = point.seen(job, rigid)
    np.testing.assert_allclose(seen.value, [-error], atol=1e-9)
    found = np.asarray(desired)[seen.row[0]] * (1 - seen.share[0])
    found += np.asarray(desired)[seen.row[0] + 1] * seen.share[0]
    np.testing.assert_allclose(found[:2], desired[row, :2], atol=1e-9)
    with pytest.raises(ValueError, match=r"point 0 is .* mm beside it"):
        dl.WallPoints(wall[None] + 0.1, normal[None], NOISE).seen(job, rigid)


def test_what_cannot_be_learnt_from_is_refused(job):
    with pytest.raises(ValueError, match="must have a part"):
        dl.learn(job, [])
    with pytest.raises(ValueError, match="must have a robot"):
        dl.learn(dataclasses.replace(job, robot=None), [])
