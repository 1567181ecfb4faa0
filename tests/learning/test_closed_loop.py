"""The closed loop on machines that are not the model: cut, measure, learn, cut."""

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
    """A model with friction and gaps of nothing: machines share its programs."""
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    job = dm.load_job(file).with_precision()
    assert job.robot is not None
    none = np.zeros(3)
    robot = job.robot.with_friction(none, none, none + 1e-3, presliding=none + 5e-6)
    job = dataclasses.replace(job, robot=robot.with_backlash(none))
    return dm.sim.mismatched(job, job)


@pytest.fixture(scope="module")
def nominal(job):
    """Command that is corrected for the model."""
    return np.asarray(dm.correct(job, start=job.path.positions).commanded)


def learnt_from_one_part(job, machine, command):
    """The first part, what a tracker with noise shows of it, and the next part."""
    run = dm.simulate(machine, commanded=command)
    tips = np.asarray(run.desired) + np.asarray(run.surface_deviation)
    tips = tips + NOISE * np.random.default_rng(0).normal(size=tips.shape)
    part = dl.Part(command, dl.TrackedTips(tips, NOISE))
    learnt = dl.learn(job, [part], prior=PRIOR)
    return run, learnt, dm.simulate(machine, commanded=learnt.commanded)


@pytest.mark.slow
def test_one_part_makes_the_next_one_better(job, nominal):
    machine = dm.sim.drawn_machine(job, TRUTH)
    first, learnt, second = learnt_from_one_part(job, machine, nominal)
    assert second.contour.rms < first.contour.rms / 2
    found = {one.name: one.value / one.size for one in learnt.values()}
    # The machine has as much of both as is expected; z turns round once.
    for axis in "xy":
        assert abs(found[f"friction {axis}"] - 1) < 0.1
        assert abs(found[f"backlash {axis}"] - 1) < 0.2
    # What is expected of the next part is what it shows.
    assert learnt.correction is not None
    expected = learnt.expected_rms(learnt.correction.after)
    assert abs(second.contour.rms / expected - 1) < 0.3


@pytest.mark.slow
def test_a_model_that_is_right_is_not_spoilt(job, nominal):
    first, learnt, second = learnt_from_one_part(job, job, nominal)
    assert not learnt.is_known_better
    assert second.contour.rms < first.contour.rms + 0.1 * NOISE


@pytest.mark.slow
def test_a_machine_that_sticks_is_corrected_with_what_was_measured(job, nominal):
    """From a command of one's own, on a machine that its controller does not know."""
    machine = dm.sim.drawn_machine(job, TRUTH)
    beyond = np.tile([6e-6, -4e-6, 0.0], (len(nominal), 1))
    path = dataclasses.replace(machine.path, disturbance=beyond)
    true = dataclasses.replace(machine, path=path)
    before = dm.simulate(true, commanded=nominal)
    found = dm.correct(machine, start=nominal, disturbance=beyond)
    assert list(found.cases) == ["uncorrected", "corrected"]
    after = dm.simulate(true, commanded=found.commanded)
    np.testing.assert_allclose(found.after.contour.rms, after.contour.rms, rtol=1e-6)
    assert after.contour.rms < before.contour.rms / 2
