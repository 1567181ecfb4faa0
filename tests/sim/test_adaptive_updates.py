"""Adaptive engagement updates give the run with an update at every tooth."""

import dataclasses

import jax
import numpy as np
import pytest
from sim.test_long_paths import SEGMENT, Kept, Stopped, assert_same, job_of

import diffmill as dm
from small_job import job_text

# Of the jobs of long paths; the others are refused by name.
ALIKE = ("rigid", "elastic", "quasi-static", "shank", "tilted", "modes")
SLOW = pytest.mark.slow
REFUSED = {
    "pitch": ({"cutter.pitch": ["170 deg", "190 deg"]}, "teeth that are not alike"),
    "runout": ({"cutter.runout": "10 um"}, "teeth that are not alike"),
    "points": ({"simulation.chip": "point_cloud"}, 'chip = "point_cloud"'),
    "slow": ({"spindle.speed": "300 rpm"}, "a tooth period of 100 ms"),
}


def adaptive(job):
    """Return a job whose engagement is held where the cut is steady."""
    held = dataclasses.replace(job.simulation, resolution="adaptive")
    return dataclasses.replace(job, simulation=held)


def rms(rows):
    """Return the root of the mean square of some rows."""
    return float(np.sqrt(np.mean(np.sum(np.asarray(rows) ** 2, axis=-1))))


@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=() if x == "modes" else SLOW) for x in ALIKE]
)
def test_a_held_engagement_gives_the_run_of_every_tooth(tmp_path, kind):
    job = job_of(tmp_path, kind)
    full = dm.simulate(job, throw=False)
    held = dm.simulate(adaptive(job), throw=False)
    is_cut = np.asarray(full.is_cutting)
    off = np.asarray(held.force - full.force)[is_cut]
    # A ball that the arm tilts meets other rays in each period.
    share = 0.02 if kind == "tilted" else 0.01
    assert rms(off) < share * rms(np.asarray(full.force)[is_cut])
    largest = float(np.abs(np.asarray(full.deviation)).max())
    np.testing.assert_allclose(held.actual, full.actual, 0, share * largest + 1e-12)
    for name in ("removed_volume", "shank_volume", "initial_overlap_volume"):
        found, wanted = (float(np.sum(getattr(run, name))) for run in (held, full))
        np.testing.assert_allclose(found, wanted, 2e-3, 1e-15, err_msg=name)
    np.testing.assert_allclose(held.stock.volume(), full.stock.volume(), 2e-4)
    if kind != "rigid":
        # Fewer updates than teeth, and an estimate that is no smaller than the error.
        updates = held.is_engagement_update
        assert updates is not None and np.mean(updates) < 0.8
        estimate = rms(np.asarray(held.engagement_force_error)[is_cut][:, None])
        assert rms(off) < 2 * estimate
        names = {"is_engagement_update", "engagement_force_error"}
        assert names <= set(held.to_dataset())
    assert full.is_engagement_update is None
    assert "is_engagement_update" not in full.to_dataset()


def test_segments_and_interruptions_change_little(tmp_path):
    job = adaptive(job_of(tmp_path, "elastic"))
    whole = dm.simulate(job, throw=False)
    kept = Kept(last=2)
    with pytest.raises(Stopped):
        dm.simulate(job, throw=False, segment_periods=SEGMENT, on_checkpoint=kept)
    resumed, found = (
        dm.simulate(job, throw=False, segment_periods=SEGMENT, resume=arrays)
        for arrays in (dict(kept), None)
    )
    assert_same(resumed, found)
    largest = np.abs(np.asarray(whole.force)).max()
    np.testing.assert_allclose(found.force, whole.force, 0, 0.02 * largest)


def test_what_is_traced_has_an_update_at_every_tooth(tmp_path):
    job = job_of(tmp_path, "elastic")

    way = 1e-5 * np.sin(np.arange(3 * job.path.step_count)).reshape(-1, 3)

    def tips(share, job):
        commanded = job.path.positions + share * way
        return dm.simulate(job, throw=False, commanded=commanded).actual

    slope = lambda job: jax.jvp(lambda share: tips(share, job), (0.5,), (1.0,))
    slopes = slope(job), slope(adaptive(job))
    assert jax.tree.all(jax.tree.map(np.array_equal, *slopes))


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_held_is_refused(tmp_path, name):
    changes, why = REFUSED[name]
    job_of(tmp_path, "elastic")
    text = job_text({"simulation.resolution": "adaptive"}, changes)
    (tmp_path / "job.toml").write_text(text)
    with pytest.raises(dm.JobError, match=f"resolution: found .adaptive. with {why}"):
        dm.load_job(tmp_path / "job.toml")
