"""The next command: how far it goes, and learning that is interrupted."""

import dataclasses

import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl

NOISE = 2e-6
PROCESS_ALONE = dl.MachinePrior(
    stiffness=0.0,
    damping=0.0,
    force=0.0,
    coefficient=0.0,
    friction=0.0,
    backlash=0.0,
    servo=0.0,
)
PRIOR = dl.MachinePrior(friction=1e-5, backlash=1e-5)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    return dm.load_job(file).with_precision()


def tracked(run, seed=0):
    """What a tracker with noise sees of a run."""
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation)
    noise = NOISE * np.random.default_rng(seed).normal(size=tips.shape)
    return dl.TrackedTips(tips + noise, NOISE)


def distance(one, other):
    away = np.asarray(one) - np.asarray(other)
    return np.sqrt(np.mean(np.sum(away**2, axis=1)))


@pytest.mark.slow
def test_a_step_that_has_failed_is_cut_to_half(job):
    """Of two parts the later one was worse: the next goes half as far from the best.

    Where the later one is the best, nothing holds the next one back.
    """
    program = np.asarray(job.path.positions)
    beyond = np.tile([8e-6, -5e-6, 0.0], (len(program), 1))
    machine = dm.sim.mismatched(job, job)
    path = dataclasses.replace(job.path, disturbance=beyond)
    machine = dataclasses.replace(machine, path=path)
    cut = lambda u: dm.simulate(machine, commanded=u)
    away = np.asarray(cut(program).surface_deviation)
    first, failed = program - 0.5 * away, program + 0.2 * away
    parts = [dl.Part(u, tracked(cut(u), k)) for k, u in enumerate((first, failed))]
    after, far = {}, {}
    for name, order in (("failed", parts), ("better", parts[::-1])):
        learnt = dm.learn(job, order, prior=PROCESS_ALONE, max_steps=2)
        after[name] = cut(learnt.commanded).contour.rms
        far[name] = distance(learnt.commanded, first)
    half = 0.5 * distance(failed, first)
    # Its start is brought onto the knots.
    assert 0.8 * half < far["failed"] < 1.2 * half < far["better"]
    assert after["better"] < after["failed"] < cut(first).contour.rms


@pytest.mark.slow
def test_learning_goes_on_from_each_of_its_checkpoints(job):
    machine = dm.sim.drawn_machine(job, dm.TruthSettings(friction=1e-5, seed=3))
    command = job.path.positions
    parts = [dl.Part(command, tracked(dm.simulate(machine, commanded=command)))]
    kept = []
    asked, told = {"prior": PRIOR, "max_steps": 2}, dict[str, list[float]]()
    whole = dm.learn(
        job,
        parts,
        **asked,
        on_checkpoint=kept.append,
        on_progress=lambda stage, share: told.setdefault(stage, []).append(share),
    )
    # Each stage begins at 0 and says how far it is.
    for stage in (
        *("the program as the model", "beyond its model, step 1", "step 3 of 3"),
        *("as it was learnt", "next command: mirror", "Gauss-Newton step 1 done"),
    ):
        begun = [shares[0] for name, shares in told.items() if stage in name]
        assert begun and not any(begun)
    for name, shares in told.items():
        if "beyond its model" in name:
            # The linear system, then a run for each friction and gap.
            assert len(shares) == 7 and shares == sorted(shares) and shares[-1] < 1
    stages = [(int(a["step"]), int(a["stage"])) for a in kept]
    # Two later steps on the parameters, then by turns of mirror and Gauss-Newton.
    assert stages[:2] == [(1, 0), (2, 0)]
    assert {stage for _, stage in stages[2:]} == {1, 2, 3}
    inside = [a for a in kept if any(name.startswith("correction/") for name in a)]
    again = dm.learn(job, parts, **asked, resume=inside[0])
    np.testing.assert_allclose(again.commanded, whole.commanded, atol=1e-12)
    np.testing.assert_allclose(again.posterior.mean, whole.posterior.mean)
    with pytest.raises(ValueError, match="of the same parts"):
        dm.learn(job, parts, **asked, resume={**kept[0], "step": np.asarray(3)})


def points_of(run, radius, more):
    """Points that a probe touches on the walls left of the feed."""
    desired = np.asarray(run.desired)
    way = np.gradient(desired[:, :2], axis=0)
    size = np.linalg.norm(way, axis=1)
    rows = np.flatnonzero(np.asarray(run.is_cutting) & (size > 1e-9))[::3]
    left = np.stack([-way[rows, 1], way[rows, 0]], axis=1) / size[rows, None]
    # The wall is on the left, and looks to the tool.
    normals = np.concatenate([-left, np.zeros((len(rows), 1))], axis=1)
    error = np.sum(np.asarray(run.surface_deviation)[rows] * normals, axis=1)
    noise = NOISE * np.random.default_rng(1).normal(size=len(rows))
    points = desired[rows] + (error + noise - radius - more)[:, None] * normals
    return dl.WallPoints(points, normals, NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("has_tracker", [True, False])
def test_points_show_the_radius_of_the_cutter(job, has_tracker):
    """A cutter 8 um larger than its radius: the next command keeps off the wall."""
    more, command = 8e-6, job.path.positions
    run = dm.simulate(job, commanded=command)
    radius = float(job.cutter.nominal_radius)
    seen = (points_of(run, radius, more), *((tracked(run),) if has_tracker else ()))
    learnt = dm.learn(job, [dl.Part(command, seen)], prior=PRIOR, max_steps=2)
    found = {one.name: one for one in learnt.values()}["radius of the cutter"]
    if has_tracker:
        assert abs(found.value - more) < 3 * found.error < 3e-6
        assert learnt.causes()["radius"] > 0.8 * more
    after = dm.simulate(job, commanded=learnt.commanded)
    normals = learnt.posterior.normals
    is_wall = np.linalg.norm(normals, axis=1) > 0
    assert is_wall.mean() > 0.5
    before, left = (
        np.sum(np.asarray(one.surface_deviation) * normals, axis=1)[is_wall] - more
        for one in (run, after)
    )
    # In corners no command brings the arm onto its path.
    assert np.median(np.abs(left)) < min(2.5e-6, 0.1 * np.median(np.abs(before)))
