"""The closed loop on machines that are not their model: cut, measure, learn, cut again."""

import dataclasses

import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl

NOISE = 2e-6
PRIOR = dl.MachinePrior(friction=1e-5, backlash=1e-5)
TRUTH = dm.TruthSettings(backlash=1e-5, friction=1e-5, seed=3)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    return dm.load_job(file).with_precision()


@pytest.fixture(scope="module")
def nominal(job):
    """Command that is corrected for the model."""
    return np.asarray(dm.correct(job).commanded)


def tracked(run):
    """The tip of a run, as a tracker with noise sees it."""
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation)
    noise = NOISE * np.random.default_rng(0).normal(size=tips.shape)
    return dl.TrackedTips(tips + noise, NOISE)


def learnt_from_one_part(job, machine, command):
    """Contour error of a part [m rms], what it shows, and that of the next part."""
    run = dm.simulate(machine, commanded=command)
    learnt = dl.learn(job, [dl.Part(command, tracked(run))], prior=PRIOR)
    return run, learnt, dm.simulate(machine, commanded=learnt.commanded)


@pytest.mark.slow
def test_one_part_makes_the_next_one_better(job, nominal):
    machine = dm.sim.drawn_machine(job, TRUTH)
    first, learnt, second = learnt_from_one_part(job, machine, nominal)
    print(first.contour, learnt.gain, second.contour, learnt.correction.after.contour)
    for n, v, s in zip(learnt.names, learnt.parameters, np.sqrt(np.diag(learnt.covariance))): print(n, round(v,2), round(s,2))
    assert second.contour.rms < first.contour.rms / 4


@pytest.mark.slow
def test_a_model_that_is_right_is_not_spoilt(job, nominal):
    machine = dm.sim.mismatched(job, job)
    first, learnt, second = learnt_from_one_part(job, machine, nominal)
    print(first.contour, learnt.gain, second.contour, learnt.correction.after.contour)
    assert second.contour.rms < first.contour.rms + 0.2 * NOISE


@pytest.mark.slow
def test_a_correction_goes_on_from_a_command_and_takes_what_was_measured(job, nominal):
    """What a machine does beyond its model is taken off, from a start of one's own."""
    machine = dm.sim.drawn_machine(job, TRUTH)
    known = dm.sim.mismatched(job, job)
    run, model = (dm.simulate(j, commanded=nominal) for j in (machine, known))
    beyond = np.asarray(run.surface_deviation) - np.asarray(model.surface_deviation)
    found = dm.correct(known, start=nominal, disturbance=beyond)
    assert list(found.cases) == ["uncorrected", "corrected"]
    after = dm.simulate(machine, commanded=found.commanded)
    print(run.contour, model.contour, found.after.contour, after.contour, found.before.contour)
    assert after.contour.rms < run.contour.rms / 3
    # A disturbance that is the same everywhere is subtracted from the command.
    shift = np.array([6e-6, -4e-6, 0.0])
    moved = dm.correct(known, start=nominal, disturbance=np.tile(shift, (len(nominal), 1)))
    still = dm.correct(known, start=nominal)
    cuts = np.asarray(run.is_cutting)
    way = np.asarray(moved.commanded - still.commanded)[cuts]
    print(way.mean(axis=0), way.std(axis=0))
    np.testing.assert_allclose(np.median(way, axis=0), -shift, atol=1e-6)
