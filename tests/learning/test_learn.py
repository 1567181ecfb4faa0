"""Learning from parts that were cut on a machine that is not its model."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl
from diffmill.robot import Controller

NOISE = 2e-6
PRIOR = dl.MachinePrior(friction=1e-5, backlash=1e-5)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    return dm.load_job(file).with_precision()


@pytest.mark.slow
@pytest.mark.parametrize("has_servos", [False, True])
def test_columns_are_differences(job, has_servos):
    if has_servos:
        job = dataclasses.replace(job, controller=Controller(bandwidth=12.0))
    machine = dl.AdaptableMachine.of_job(job, PRIOR)
    rigid = dm.sim.rigid_cut(machine.base, dm.process.FrozenStock())
    x, program = np.zeros(machine.count), np.asarray(job.path.positions)
    # Away from gaps, whose corners are round for slopes alone.
    x[machine.group("friction").index] = 0.5
    x[machine.group("backlash").index] = 0.3
    columns = machine.columns(x, rigid, program, machine.rigid_force_slopes())

    def observables(x, smooth):
        adapted = machine.job_at(x, smooth=smooth)
        run = dm.sim.Solution.of_command(
            adapted, rigid, jnp.asarray(program), dm.process.FrozenStock()
        )
        arm = np.asarray(run.surface_deviation)
        tip = arm + machine.field(x, program)
        wall = tip + machine.wall_columns() @ x
        cut = dm.sim.rigid_cut(adapted, dm.process.FrozenStock())
        return tip, wall, arm - machine.frame_shift(adapted), np.asarray(cut.force)

    names = machine.names
    assert any(n.startswith("servo") for n in np.array(names)[machine.is_free]) == (
        has_servos
    )
    # Two of each group: a run takes a second.
    groups = [machine.group("servo")] if has_servos else machine.groups
    chosen = np.concatenate([group.index[[0, -1]] for group in groups])
    for k in np.intersect1d(chosen, np.flatnonzero(machine.is_free)):
        # Friction and gaps have secants over half a prior.
        has_corners = names[k].startswith(("friction", "backlash"))
        above, below = (0.5, 0.0) if has_corners else (0.02, -0.02)
        way = np.eye(machine.count)[k]
        both = (observables(x + a * way, not has_corners) for a in (above, below))
        for found, more, less in zip(columns, *both, strict=True):
            numeric = (more - less) / (above - below)
            if np.abs(numeric).max() > 1e-8:
                away = np.sqrt(np.mean((found[:, :, k] - numeric) ** 2))
                # Torques are taken at the rows.
                share = 0.01 if has_corners else 0.15
                assert away < share * np.sqrt(np.mean(numeric**2)), names[k]


def test_joints_are_seen_as_the_tip_that_they_place(job):
    """Encoders on the links of three slides: their positions are the tip's."""
    run = dm.simulate(job)
    joints, time = np.asarray(run.joint_positions), np.asarray(run.time)
    record = dl.LinkEncoders(joints, NOISE, time, offset=1e-5)
    seen = record.seen(job, run)
    rows = np.searchsorted(time, seen.time[::3])
    away = np.asarray(run.deviation)[rows]
    found = np.einsum(
        "kia,ki->ka", seen.direction.reshape(-1, 3, 3), seen.value.reshape(-1, 3)
    )
    sag = away - found
    np.testing.assert_allclose(sag, sag[:1] * np.ones_like(sag), atol=1e-10)
    np.testing.assert_allclose(seen.variance, NOISE**2)
    assert seen.nuisance.shape[1] == 3 and not seen.is_tracked
    with pytest.raises(ValueError, match="must have 3 columns"):
        dl.LinkEncoders(joints[:, :2], NOISE, time).seen(job, run)


def test_forces_are_means_over_tooth_periods(job):
    run = dm.simulate(job)
    ends, force = np.asarray(run.time), np.asarray(run.force)
    time = np.linspace(ends[3], ends[-2], 7 * (len(ends) - 5) + 1)[1:]
    each = force[np.searchsorted(ends, time - 1e-12)]
    seen = dl.MeasuredForces(each, 7.0, time, offset=2.0).seen(job, run)
    predicted = seen.of(dl.Observables(force, force, force, force))
    np.testing.assert_allclose(seen.value, predicted, atol=1e-9)
    np.testing.assert_allclose(np.median(seen.variance), 7.0)
    assert seen.nuisance.shape[1] == 3
    with pytest.raises(ValueError, match="within the program"):
        dl.MeasuredForces(each, 1.0, time + 1e3).seen(job, run)


@pytest.mark.slow
def test_a_late_clock_is_not_learnt(job):
    """A tracker that is 1 ms late on a machine as modelled: the set-up, no machine."""
    model = dm.simulate(job)
    program, period = np.asarray(model.time), float(job.tooth_period)
    made = dl.wall_times(model)
    of = lambda time, known, rows: np.stack(
        [np.interp(time, known, row) for row in np.asarray(rows).T], axis=1
    )
    tips = of(made, program, model.desired) + np.asarray(model.surface_deviation)
    seen, late = program[3:-3], 1e-3
    noise = NOISE * np.random.default_rng(1).normal(size=(len(seen), 3))
    tracked = dl.TrackedTips(
        of(seen - late, made, tips) + noise, NOISE, seen, delay=period
    )
    part = dl.Part(job.path.positions, tracked)
    learnt = dl.learn(job, [part], prior=PRIOR, max_steps=0)
    beyond = np.abs(np.asarray(learnt.job.path.disturbance))
    feed = 0.05
    assert beyond.max() < 0.15 * late * feed


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
    np.testing.assert_allclose(
        seen.of(dl.Observables(rows, rows, rows, rows)), seen.value, atol=1e-12
    )
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
