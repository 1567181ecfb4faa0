"""The feed of a job: three slides that cut a slot deeper and deeper."""

import dataclasses
import itertools

import equinox as eqx
import numpy as np
import pytest

from diffmill import CorrectionSettings, LineWeight, toolpath as tp, workpiece as wp
from diffmill.correction import NothingToCorrect, feed_tradeoff, tune_feed
from diffmill.sim import simulate
from machines import job_of, slides

PERIOD = 3.75e-3
LIMITS = {"acceleration": 0.5, "rapid_feed": 0.1, "corner_tolerance": 0.0}


@pytest.fixture(scope="module")
def job():
    """Return a path along a side, narrow at first and then wide."""
    corners = [(-6e-3, -4.5e-3), (6e-3, -4.5e-3), (7e-3, -2e-3), (20e-3, -2e-3)]
    moves = tuple(
        tp.Move((*a, -1e-3), (*b, -1e-3), feed=0.05, line=k)
        for k, (a, b) in enumerate(itertools.pairwise(corners), 1)
    )
    return job_of(
        slides(),
        tp.sample_program(tp.Program(moves), PERIOD, **LIMITS),
        wp.box([0, 0, -2e-3], [14e-3, 5e-3, 0], 0.5e-3),
        CorrectionSettings(max_steps=1),
        angles=96,
        substeps=1,
        element_height=1e-3,
        mode="quasistatic",
    )


@pytest.mark.slow
def test_a_slower_feed_takes_longer_and_leaves_less(job):
    told = []
    found = feed_tradeoff(
        job,
        (0.5, 1.0),
        corrects=False,
        on_progress=lambda text, share: told.append(share),
    )
    assert found.feed_per_tooth[0] == pytest.approx(
        0.5 * found.feed_per_tooth[1], rel=2e-2
    )
    assert found.cycle_time[0] == pytest.approx(2 * found.cycle_time[1], rel=1e-3)
    # Half the chip: half the force, which the springs balance.
    assert found.uncorrected[0] / found.uncorrected[1] == pytest.approx(0.5, rel=0.05)
    assert np.isnan(found.corrected).all()
    assert told[-1] == 1.0 and np.all(np.diff(told) >= 0)
    data = found.to_dataset()
    assert data["uncorrected"].attrs["units"] == "m"
    # The row at 1 is the simulation of the program itself, at rest after its end.
    rows = 2 * job.path.step_count - 1
    path = tp.retime(job.path, 1.0, step_count=rows)
    itself = simulate(eqx.tree_at(lambda j: j.path, job, path))
    steps = np.linalg.norm(np.diff(path.positions, axis=0, prepend=np.nan), axis=1)
    cutting = np.asarray(itself.is_cutting)
    square = np.asarray(itself.contour_error)[cutting] ** 2
    rms = np.sqrt(np.average(square, weights=steps[cutting]))
    assert found.uncorrected[1] == pytest.approx(float(rms), rel=1e-6)


def test_a_rigid_machine_is_refused(job):
    rigid = eqx.tree_at(lambda j: j.robot, job, None, is_leaf=lambda x: x is None)
    for function in (feed_tradeoff, tune_feed):
        with pytest.raises(ValueError, match=r"`job`.*rigid"):
            function(rigid)


@pytest.mark.slow
def test_a_path_of_which_nothing_counts_is_refused(job):
    settings = dataclasses.replace(job.correction, sections=(LineWeight(1, 9, 0.0),))
    with pytest.raises(NothingToCorrect, match="lines 1 to 3"):
        tune_feed(dataclasses.replace(job, correction=settings))


@pytest.mark.slow
def test_the_override_along_the_path_beats_an_even_one(job):
    """At the same time less error, and slower where more is cut."""
    found = tune_feed(job, time_weights=(0.1,), count=5, max_steps=6)
    before, best = found.points
    assert best.rms < before.rms and best.runs <= 30
    even = feed_tradeoff(job, (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5), corrects=False)
    order = np.argsort(even.cycle_time)
    at = np.interp(best.cycle_time, even.cycle_time[order], even.uncorrected[order])
    assert best.rms < 0.98 * at
    again = eqx.tree_at(lambda j: j.path, job, found.paths[1])
    check = feed_tradeoff(again, (1.0,), corrects=False)
    assert check.cycle_time[0] == pytest.approx(best.cycle_time, abs=2 * PERIOD)
    assert check.uncorrected[0] == pytest.approx(best.rms, rel=0.05)


@pytest.mark.slow
def test_each_feed_is_corrected(job):
    found = feed_tradeoff(job, (0.7,))
    assert np.all(found.corrected < 0.5 * found.uncorrected)
    assert np.all(found.max_offset > 0)
