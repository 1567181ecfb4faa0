"""Measurements by what they would leave unknown, against what parts then show."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm
from diffmill import learning as dl

PRIOR = dl.MachinePrior(friction=1e-5, backlash=1e-5)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    file = write_slides_job(tmp_path_factory.mktemp("job"))
    return dm.load_job(file).with_precision()


def test_a_load_test_tells_of_springs_alone(job):
    """100 N on a slide bend its spring by F / K, and no other."""
    known = dl.MachinePosterior.of_prior(job, PRIOR)
    machine = known.machine_for(job)
    rows = dl.LoadTest(job, 100.0 * np.eye(3), 1e-6).slopes(known)
    springs = machine.group("stiffness").index
    stiffness = np.asarray(job.robot.joint_stiffness)
    wanted = np.zeros((9, 3))
    wanted[[0, 4, 8], [0, 1, 2]] = -100.0 / stiffness * 0.1 / 1e-6
    np.testing.assert_allclose(rows[:, springs], wanted, atol=1e-9)
    assert not np.delete(rows, springs, axis=1).any()


@pytest.mark.slow
def test_trials_rank_by_what_they_leave_unknown(job):
    known = dl.MachinePosterior.of_prior(job, PRIOR)
    trials = dl.usual_trials(job, tracker=2e-6, gauge=1e-6)
    weak = {"weak": dl.TrackedRun(job, 1e-3)}
    told = []
    ranked = dl.advise(
        job, known, trials | weak, on_progress=lambda *said: told.append(said)
    )
    assert told == [(name, 0.0) for name in ("the part", *trials, "weak")]
    names = [one.name for one in ranked]
    spreads = [one.spread for one in ranked]
    assert names[-1] == "" and spreads == sorted(spreads)
    assert names[0] == "this part under a tracker"
    # A trial without news leaves all as it was.
    place = dict(zip(names, spreads, strict=True))
    assert place["weak"] > 0.9 * spreads[-1] and spreads[0] < 0.3 * spreads[-1]
    # Two measurements tell more than the better one, and no more than both could.
    both = np.concatenate([trials[name].slopes(known) for name in names[:2]])
    free = known.sizes > 0
    own = known.covariance[np.ix_(free, free)]
    after = np.linalg.inv(np.linalg.inv(own) + both[:, free].T @ both[:, free])
    joined = np.zeros_like(known.covariance)
    joined[np.ix_(free, free)] = after
    more = dl.advise(job, dataclasses.replace(known, covariance=joined), {})[-1]
    assert 0.5 * spreads[0] < more.spread < spreads[0]


def test_a_prior_is_a_posterior_of_nothing(job):
    known = dl.MachinePosterior.of_prior(job, PRIOR)
    adapted = known.job_for(job)
    springs = lambda job: job.robot.joint_stiffness
    np.testing.assert_array_equal(springs(adapted), springs(job))
    assert not np.asarray(adapted.path.disturbance).any()
    assert jnp.allclose(adapted.T_base_work, job.T_base_work, atol=1e-12)
