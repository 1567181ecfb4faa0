"""Parameters of arm and cut from records of three slides that carry a cutter."""

import dataclasses
import functools
import math

import equinox as eqx
import numpy as np
import pytest
from helpers import PAPER_LAW

from diffmill import identification, sim, toolpath as tp, workpiece as wp
from diffmill.cutting import LinearEdgeLaw
from diffmill.identification import fit_coupled
from machines import STIFFNESS, job_of, slides

PERIOD, ZETA = 3.75e-3, 0.08
# Where a fit starts, over the truth.
OFF = {"K": [0.7, 1.6, 0.8], "D": [2.0, 2.0, 1.5], "law": [1.3, 0.8, 1.5, 0.7, 1.4, 2]}


def cut(teeth, feeds, spacing, angles, substeps, **settings):
    """Return a slot along x, then along y, at two feeds each."""
    steps = np.repeat(feeds, teeth)
    x = np.cumsum(np.concatenate([[0.0], steps, 0 * steps])) - 5.5e-3
    y = np.cumsum(np.concatenate([[0.0], 0 * steps, steps])) + 6e-3
    tips = np.column_stack([x, y, np.full(len(x), -1e-3)])
    return job_of(
        slides(ZETA),
        tp.Path.upright(PERIOD * np.arange(len(x)), tips),
        wp.box([0, 0, -2e-3], [x[-1] + 6e-3, y[-1] + 6e-3, 0], spacing),
        angles=angles,
        substeps=substeps,
        **settings,
    )


def started(job, changes=("K", "D", "law")):
    """Return a job whose parameters are off."""
    robot, law = job.robot, job.law
    if "K" in changes:
        K, D = STIFFNESS * OFF["K"], np.asarray(robot.joint_damping) * OFF["D"]
        robot = robot.with_drives(stiffness=K, damping=D)
    if "law" in changes:
        factors = zip(LinearEdgeLaw.NAMES, OFF["law"], strict=True)
        law = dataclasses.replace(law, **{n: f * getattr(law, n) for n, f in factors})
    return eqx.tree_at(lambda j: (j.robot, j.law), job, (robot, law))


def values_of(job):
    """Return the parameters of a job, by name."""
    robot, law = job.robot, job.law
    values = [*robot.joint_stiffness, *robot.joint_damping]
    values += [getattr(law, name) for name in LinearEdgeLaw.NAMES]
    *names, speed = job.parameter_names
    assert speed == "speed"
    return dict(zip(names, map(float, values), strict=True))


def errors(fit, truth):
    """Return the relative error of what is identifiable, by name."""
    wanted = values_of(truth)
    return {n: v / wanted[n] - 1 for n, v in fit.parameters.items() if v == v}


@functools.cache
def small():
    return cut(12, (0.3e-3, 0.4e-3), 0.6e-3, 96, 4)


@functools.cache
def small_record():
    """The force and the deviation of the small job, by its own model."""
    return sim.simulate(small())


@pytest.mark.slow
def test_deflection_alone_gives_springs_and_names_what_it_does_not_show():
    clean, draw = np.asarray(small_record().deviation), np.random.default_rng(0)
    offset = np.array([3e-5, -2e-5, 1e-5])
    # The axial force bends the third slide by less than this noise.
    seen = clean + offset[None] + 3e-6 * draw.normal(size=clean.shape)
    fit = fit_coupled(started(small(), ["K"]), deviation=seen, has_offset=True)
    off = errors(fit, small())
    assert set(off) == {"K x", "K y", "D x", "D y"}
    assert max(abs(v) for v in off.values()) < 0.05
    assert fit.offset is not None
    np.testing.assert_allclose(fit.offset, offset, atol=2e-6)
    assert fit.has_converged and fit.explained["deviation"] > 0.97
    left = fit.residual["deviation"]
    assert left.shape == seen.shape and set(fit.residual) == {"deviation"}
    rms = np.sqrt(np.nanmean(left**2))
    assert rms == pytest.approx(fit.residual_rms["deviation"])
    assert rms == pytest.approx(3e-6, rel=0.2)
    named = " ".join(fit.notes)
    assert "K z is not identifiable" in named and "D z is not" in named
    for name in off:
        wanted = values_of(small())[name]
        assert abs(fit.parameters[name] - wanted) < 4 * fit.standard_errors[name]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_one_record_gives_arm_and_cut(precision):
    """The record is that of finer rays, angles and sub-steps, with 5 % noise."""
    fine = cut(60, (0.1e-3, 0.3e-3), 0.4e-3, 240, 12)
    record, draw = sim.simulate(fine), np.random.default_rng(0)
    seen = {
        name: rows + 0.05 * np.sqrt(np.mean(rows**2)) * draw.normal(size=rows.shape)
        for name, rows in (
            ("force", np.asarray(record.force)),
            ("deviation", np.asarray(record.deviation)),
        )
    }
    coarse = cut(60, (0.1e-3, 0.3e-3), 0.5e-3, 192, 8, precision=precision)
    fit = fit_coupled(started(coarse), **seen)
    off = errors(fit, fine)
    assert {"K x", "K y", "D x", "K_tc", "K_rc"} <= set(off)
    assert max(abs(v) for v in off.values()) < 0.05
    assert min(fit.explained.values()) > 0.98
    lost = {name for name, known in fit.identifiable.items() if not known}
    assert lost == {name for name, value in fit.parameters.items() if math.isnan(value)}
    assert all(f"{name} is not identifiable" in " ".join(fit.notes) for name in lost)


@pytest.mark.slow
def test_a_coefficient_that_pulls_is_fitted_with_its_sign():
    """The axial force of a right-hand helix is negative."""
    law = dataclasses.replace(PAPER_LAW, K_ac=-300e6)
    truth = dataclasses.replace(small(), law=law)
    seen = np.asarray(sim.simulate(truth).force)
    job = dataclasses.replace(truth, law=dataclasses.replace(law, K_ac=-200e6))
    fit = fit_coupled(job, force=seen, fit=["K_ac"])
    assert fit.parameters["K_ac"] == pytest.approx(-300e6, rel=1e-4)
    assert fit.standard_errors["K_ac"] >= 0
    with pytest.raises(ValueError, match="K_ac is 0"):
        none = dataclasses.replace(job, law=dataclasses.replace(law, K_ac=0.0))
        fit_coupled(none, force=seen, fit=["K_ac"])


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 0.2, 8.0])
def test_a_start_that_is_far_off_does_no_harm(factor):
    clean, draw = np.asarray(small_record().deviation), np.random.default_rng(0)
    seen = clean + 3e-6 * draw.normal(size=clean.shape)
    job = small()
    robot = slides(ZETA).with_drives(stiffness=factor * STIFFNESS)
    far = eqx.tree_at(lambda j: j.robot, job, robot)
    fit = fit_coupled(far, deviation=seen)
    off = errors(fit, small())
    assert {"K x", "K y"} <= set(off) and max(abs(v) for v in off.values()) < 0.05
    assert fit.is_explained and fit.explained["deviation"] > 0.97


@pytest.mark.slow
def test_a_record_of_another_machine_is_called_so():
    turned = np.asarray(small_record().deviation)[:, [1, 2, 0]]
    fit = fit_coupled(started(small(), ["K"]), deviation=turned)
    assert fit.explained["deviation"] < 0.7
    assert "does not suit the job" in " ".join(fit.notes)


def test_the_mean_over_a_period_is_that_of_the_integral():
    time = np.arange(0, 0.1, 1e-4)
    wave = np.column_stack([np.sin(60 * time), 0 * time + 2, time])
    found = identification.mean_over_period(time, wave, PERIOD)
    first = time < PERIOD
    assert np.isnan(found[first]).all() and not np.isnan(found[~first]).any()
    t = time[~first]
    wanted = (np.cos(60 * (t - PERIOD)) - np.cos(60 * t)) / (60 * PERIOD)
    np.testing.assert_allclose(found[~first, 0], wanted, atol=5e-6)
    np.testing.assert_allclose(found[~first, 1], 2.0)
    np.testing.assert_allclose(found[~first, 2], t - PERIOD / 2)


def test_a_missing_force_is_missing_for_a_period_only():
    time = np.arange(0, 0.1, 1e-4)
    wave = np.column_stack([np.sin(60 * time), 0 * time + 2, time])
    holed = wave.copy()
    holed[300, 0] = np.nan
    found = identification.mean_over_period(time, holed, PERIOD)
    wanted = identification.mean_over_period(time, wave, PERIOD)
    near = np.abs(time - time[300] - PERIOD / 2) < PERIOD / 2 + 1.5e-4
    assert np.isnan(found[near, 0]).sum() >= PERIOD / 1e-4
    np.testing.assert_allclose(found[~near, 0], wanted[~near, 0], atol=1e-12)
    np.testing.assert_allclose(found[:, 1:], wanted[:, 1:])


@pytest.mark.slow
def test_what_has_no_start_is_not_fitted_and_noted():
    """A job may leave out edge coefficients: they are 0 then."""
    job = eqx.tree_at(lambda j: j.law.K_te, small(), 0.0)
    record = small_record()
    rows = {"force": np.asarray(record.force), "deviation": record.deviation}
    told = []
    fit = fit_coupled(job, **rows, max_steps=1, on_progress=told.append)
    assert told[0].startswith("step 1 of at most 1 explains ")
    assert set(values_of(job)) - set(fit.parameters) == {"K_te"}
    (note,) = [note for note in fit.notes if note.startswith("Not fitted")]
    assert "K_te is 0" in note


def test_a_parameter_without_a_start_is_refused():
    job = eqx.tree_at(lambda j: j.law.K_te, small(), 0.0)
    with pytest.raises(ValueError, match="K_te"):
        fit_coupled(job, force=np.zeros((49, 3)), fit=["K_te"])


def test_wrong_arguments_are_named():
    job, rows = small(), np.zeros((49, 3))
    with pytest.raises(ValueError, match="`force` and `deviation`"):
        fit_coupled(job)
    with pytest.raises(ValueError, match="robot"):
        bare = eqx.tree_at(lambda j: j.robot, job, None)
        fit_coupled(bare, deviation=rows)
    with pytest.raises(ValueError, match=r"`deviation`.*\(49, 3\)"):
        fit_coupled(job, deviation=rows[:20])
    with pytest.raises(ValueError, match="`fit`"):
        fit_coupled(job, deviation=rows, fit=["K elbow"])
    with pytest.raises(ValueError, match="`loss`"):
        fit_coupled(job, deviation=rows, loss="tukey")
