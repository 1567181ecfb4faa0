import dataclasses
import functools
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from slot_force import DEPTH, HELIX, PERIOD, SPEED, K, R, slot_force

import diffmill as dm
from diffmill import (
    cutter as ct,
    examples,
    identification,
    toolpath as tp,
    workpiece as wp,
)
from diffmill.cutting import LinearEdgeLaw

# The records of this module have neither offset nor drift but where it is said.
fit_force_coefficients = functools.partial(
    identification.fit_force_coefficients, has_offset=False, has_drift=False
)
NAMES = LinearEdgeLaw.NAMES
STEPS = 45
FEEDS = (0.08e-3, 0.16e-3)


def slot(feed):
    """A slot that begins within the stock: what comes first is not looked at."""
    x = feed * np.arange(STEPS)
    rows = np.column_stack([x, np.full(STEPS, 6e-3), np.full(STEPS, -DEPTH)])
    return identification.Cut(
        rows,
        wp.box([-6e-3, 0, -3e-3], [14e-3, 12e-3, 0], 0.2e-3, interval_counts=(4, 4, 1)),
        ct.flat_end_mill(2 * R, 2, helix_angle=HELIX),
        SPEED,
    )


@functools.cache
def cuts():
    return tuple(slot(feed) for feed in FEEDS)


def record(feed, seed=0, noise=0.05, shift=0.0, runout=0.0):
    # From the eleventh tooth on the slot is steady.
    time = np.arange(11 * PERIOD, (STEPS - 3) * PERIOD, 1e-4)
    clean = slot_force(time + shift, feed, runout)
    rms = np.sqrt(np.mean(clean**2))
    draw = np.random.default_rng(seed)
    return time, clean + noise * rms * draw.normal(size=clean.shape)


def found(fit):
    return np.array([fit.coefficients[name] for name in NAMES])


def errors(fit):
    return np.array([fit.standard_errors[name] for name in NAMES])


def fitted(time, force):
    """Return the fit of the second cut, on its clock."""
    return fit_force_coefficients(cuts()[1], time, force, time_shift=0.0)


def both(**how):
    pairs = [record(feed, i, **how) for i, feed in enumerate(FEEDS)]
    return list(cuts()), [t for t, _ in pairs], [f for _, f in pairs]


def test_records_of_an_independent_program_give_the_coefficients():
    cut, time, seen = both(noise=0.0)
    fit = fit_force_coefficients(cut, time, seen, time_shift=0.0)
    np.testing.assert_allclose(found(fit), K, rtol=1.5e-2)
    assert fit.explained > 0.9995 and all(fit.identifiable.values())
    # Nothing to advise: only what material it may be.
    assert ["as published of" in note for note in fit.notes] == [True]
    assert fit.time_shift == (0.0, 0.0)
    left_out = identification.cross_validate(fit)
    assert max(part.error for part in left_out) < 0.03


def test_noise_a_time_shift_and_turned_axes():
    shift = 1.7e-3
    cut, time, seen = both(shift=shift)
    # The dynamometer's y is the work's -x, its x the work's y.
    turned = [np.column_stack([f[:, 1], -f[:, 0], f[:, 2]]) for f in seen]
    fit = fit_force_coefficients(cut, time, turned, axes=("-y", "x", "z"))
    assert fit.axes == ("-y", "x", "z")
    np.testing.assert_allclose(fit.time_shift, shift, atol=1e-5)
    assert (np.abs(found(fit) - K) < 4 * errors(fit) + 0.01 * K).all()
    assert fit.residual_rms / fit.force_rms == pytest.approx(0.05, rel=0.1)
    assert (errors(fit) < 0.05 * K).all()


@pytest.mark.slow
def test_a_job_in_float32_gives_the_coefficients():
    one = cuts()[1]
    with tempfile.TemporaryDirectory() as folder:
        example = dm.load_job(examples.copy_example("paper_small", Path(folder)))
    path = tp.Path.upright(PERIOD * np.arange(STEPS), np.asarray(one.positions))
    job = dataclasses.replace(
        example,
        cutter=one.cutter,
        spindle_speed=SPEED,
        stock=one.stock,
        path=path,
        robot=None,
        simulation=dataclasses.replace(example.simulation, precision="float32"),
    )
    time, seen = record(FEEDS[1], shift=4e-4)
    for refine in ((), ("runout",)):
        fit = fit_force_coefficients(job, time, seen, refine=refine)
        assert fit.records[0].cut.stock.origin.dtype == np.float32
        assert (np.abs(found(fit) - K) < 4 * errors(fit) + 0.015 * K).all()
        np.testing.assert_allclose(fit.time_shift, 4e-4, atol=1e-5)
    assert abs(fit.refined["runout_x"]) < 2e-6


def test_gross_errors_change_little_under_a_robust_loss():
    cut, time, seen = both()
    clean = fit_force_coefficients(cut, time, seen, time_shift=0.0)
    draw = np.random.default_rng(5)
    for f in seen:
        f[draw.choice(len(f), len(f) // 20, replace=False)] = 2000.0
    fits = {
        loss: fit_force_coefficients(cut, time, seen, time_shift=0.0, loss=loss)
        for loss in ("squares", "tukey")
    }
    off = {n: np.abs(fit.raw / clean.raw - 1).max() for n, fit in fits.items()}
    assert off["tukey"] < 0.05 < off["squares"]


def test_robust_weights_are_the_same_in_any_unit():
    """Beside a force that was not measured, whose scatter is not known."""
    time, force = record(FEEDS[1])
    force[::20] += 500.0
    force[:, 2] = np.nan
    in_newton, in_giganewton = (fitted(time, unit * force) for unit in (1.0, 1e-9))
    wanted = 1e-9 * found(in_newton)
    np.testing.assert_allclose(found(in_giganewton), wanted, rtol=1e-3)
    assert np.isfinite(wanted).sum() == 4


@pytest.mark.slow
def test_both_sides_pass_the_low_pass():
    """Vibration of the dynamometer goes; what is cut off of the force does not bias."""
    cut, time, seen = both(shift=4e-4)
    clean = [f.copy() for f in seen]
    for t, f in zip(time, seen, strict=True):
        f += 150 * np.sin(2 * math.pi * 2300 * t)[:, None]
    seen[0][200:203] = np.nan
    fits = [
        fit_force_coefficients(cut, time, f, loss="squares", lowpass=c)
        for f, c in ((seen, None), (seen, 700.0), (clean, 700.0))
    ]
    off = [np.abs(found(fit) - K) for fit in fits]
    assert (errors(fits[1]) < errors(fits[0])).all()
    assert (off[1] < 4 * errors(fits[1]) + 0.01 * K).all()
    assert (off[2] < 4 * errors(fits[2]) + 0.01 * K).all()
    assert fits[0].explained < 0.8 < 0.99 < fits[1].explained
    np.testing.assert_allclose(fits[1].time_shift, 4e-4, atol=1e-5)
    assert "less than 80%" in fits[0].doubts[0] and not fits[1].doubts
    with pytest.raises(ValueError, match=r"`lowpass`.* 5000 Hz"):
        fit_force_coefficients(cut, time, seen, lowpass=5e3)


def test_saturated_samples_and_gross_errors_are_told():
    cut, time, seen = both()
    fits = []
    for f in seen:
        f[:, 1] = np.minimum(f[:, 1], 100.0)
        f[[30, 200], 2] = 900.0
    fits = fit_force_coefficients(cut, time, seen, time_shift=0.0)
    assert (np.abs(found(fits) - K) < 4 * errors(fits) + 0.01 * K).all()
    told = " ".join(fits.notes)
    assert "at the end of a channel's range were left out" in told
    assert fits.gross_errors == 4 and "4 measured forces are off" in told
    assert fits.explained > 0.99 and not fits.doubts


def spinning(time, draw):
    """Return the angle of a spindle that does not run evenly, and its tacho."""
    angle = SPEED * (1.003 * time - 2e-3 * np.cos(9 * time)) + 0.7
    pulse = (np.mod(angle - math.radians(40), 2 * math.pi) < 0.6).astype(float)
    return angle, 5 * pulse + 0.05 * draw.normal(size=time.size)


@pytest.mark.slow
@pytest.mark.parametrize("is_known", [True, False])
def test_a_tacho_is_the_clock_of_an_uneven_spindle(is_known):
    time, draw = np.arange(0, 0.3, 1e-4), np.random.default_rng(0)
    angle, tacho = spinning(time, draw)
    force = slot_force(angle / SPEED, FEEDS[0]) + 3 * draw.normal(size=(time.size, 3))
    nothing = np.zeros(time.size, bool)
    record = identification.Record(
        time, force, 1e4, nothing, nothing, tacho=tacho, angle=None
    )
    first = math.radians(40) if is_known else 0.0
    seen = record.angle_from_tacho(first_angle=first, smoothing=21)
    off = np.remainder(seen - angle - first + math.radians(40) + 1, 2 * math.pi) - 1
    assert np.abs(off).max() < 0.05
    sizes = identification.StraightCut(cuts()[0].cutter, SPEED, FEEDS[0], DEPTH)
    beside = identification.RecordRegistration.on_straight_cut(
        sizes, time, force, angle=seen
    )
    fit = fit_force_coefficients(
        beside.cut, beside.time, beside.force, time_shift=0.0 if is_known else None
    )
    # A degree of the tacho's phase is some percent of the radial coefficients.
    np.testing.assert_allclose(found(fit), K, rtol=0.06 if is_known else 0.03)
    assert fit.explained > 0.995
    # The speed alone does not follow the spindle.
    blind = fit_force_coefficients(
        beside.cut, time - time[0] + beside.time[0], force, time_shift=fit.time_shift[0]
    )
    assert blind.explained < 0.98


def trochoid_force(time, feed, tooth_count=2):
    """The force of straight teeth in a slot, on the ways that they really go."""
    period, force = 2 * math.pi / SPEED / tooth_count, 0.0
    v = feed / period
    for tooth in range(tooth_count):
        phi = SPEED * time + 2 * math.pi * tooth / tooth_count
        sin, cos = np.sin(phi), np.cos(phi)
        # When the tooth before passed the line through this tooth and the axis.
        ago = np.full(time.size, period)
        for _ in range(20):
            angle = phi + SPEED * (period - ago)
            x, y = R * np.sin(angle) - v * ago, R * np.cos(angle)
            dx, dy = v + SPEED * R * np.cos(angle), -SPEED * R * np.sin(angle)
            ago = ago + (sin * y - cos * x) / (sin * dy - cos * dx)
        angle = phi + SPEED * (period - ago)
        chip = R - (sin * (R * np.sin(angle) - v * ago) + cos * R * np.cos(angle))
        is_cutting = (chip > 0) & (sin > -0.1)
        t, r, a = (DEPTH * (K[i] * chip + K[i + 3]) * is_cutting for i in range(3))
        force += np.stack([-t * cos - r * sin, t * sin - r * cos, a], axis=1)
    return force


@pytest.mark.slow
def test_a_straight_cut_is_simulated_as_finely_as_its_coefficients_ask():
    """Rays 1.4 times as far apart put the coefficients of the edge off by 6 %."""
    cutter = ct.flat_end_mill(2 * R, 2)
    sizes = [identification.StraightCut(cutter, SPEED, f, DEPTH) for f in FEEDS]
    time = np.arange(14 * PERIOD, 40 * PERIOD, 0.9e-4)
    fit = fit_force_coefficients(
        [one.cut(largest_feed=max(FEEDS)) for one in sizes],
        [time, time],
        [trochoid_force(time, feed) for feed in FEEDS],
    )
    np.testing.assert_allclose(found(fit), K, rtol=0.015)


def test_what_is_not_measured_is_not_identifiable():
    cut, time, seen = both()
    for f in seen:
        f[:, 2] = np.nan
    fit = fit_force_coefficients(cut, time, seen, time_shift=0.0)
    lost = {name for name in NAMES if not fit.identifiable[name]}
    assert lost == {"K_ac", "K_ae"}
    assert math.isnan(fit.coefficients["K_ac"])
    assert math.isinf(fit.standard_errors["K_ae"])
    assert "axial force" in " ".join(fit.notes)
    # A force of zero would be a guess.
    with pytest.raises(ValueError, match="K_ac, K_ae"):
        _ = fit.law
    law = fit.law_with(K_ac=1e8, K_ae=0.0)
    assert (law.K_ac, law.K_ae, law.K_tc) == (1e8, 0.0, fit.coefficients["K_tc"])
    with pytest.raises(ValueError, match="K_tx"):
        fit.law_with(K_tx=1.0)


def test_saturation_shows_where_a_force_was_not_measured():
    time, force = record(FEEDS[1])
    force[:, 0] = np.minimum(force[:, 0], 100.0)
    force[:, 2] = np.nan
    fit = fitted(time, force)
    assert "at the end of a channel's range were left out" in " ".join(fit.notes)


def test_a_channel_that_is_dead_in_one_of_two_records_is_told():
    cut, time, seen = both()
    seen[1][:, 1] = 0.0
    fit = fit_force_coefficients(cut, time, seen, time_shift=0.0, axes=("y", "x", "z"))
    (doubt,) = [d for d in fit.doubts if "does not vary" in d]
    assert "along x of the work of record 2" in doubt
    assert '{ Fy = "none" }' in doubt


@pytest.mark.parametrize("axis", range(3))
def test_a_dead_channel_is_told(axis):
    """Along z next to nothing may act on a flat cutter; in the plane that cannot be."""
    time, force = record(FEEDS[1])
    fit = fitted(time, force)
    assert not any("does not vary" in note for note in fit.notes)
    force[:, axis] = 0.0
    fit = fitted(time, force)
    text = f"along {'xyz'[axis]} of the work does not vary"
    assert any(text in note for note in fit.notes)
    assert any(text in doubt for doubt in fit.doubts) == (axis < 2)


def told(force):
    """Return what a fit of the second cut tells of a force."""
    time, _ = record(FEEDS[1])
    fit = fitted(time[: len(force)], force)
    return {one.code: one.values for one in fit.diagnoses}


def test_a_record_without_faults_has_no_diagnosis():
    for noise in (0.02, 0.2):
        assert told(record(FEEDS[1], noise=noise)[1]) == {}


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_rows_lost_here_and_there_are_told_by_the_rate_of_the_teeth(share):
    _, force = record(FEEDS[1])
    kept = np.random.default_rng(1).uniform(size=len(force)) > share
    values = told(force[kept])
    # Nothing else is blamed on the channels.
    assert set(values) <= {"clock_rate", "implausible_ratio"}
    lost = 1 - kept.mean()
    assert values["clock_rate"]["ratio"] == pytest.approx(1 + lost, abs=0.3 * lost)


def test_a_unit_that_no_material_has_is_told():
    found = told(1e3 * record(FEEDS[1])[1])
    assert found["implausible_pressure"]["factor"] == 1e3
    assert found["implausible_pressure"]["value"] == pytest.approx(1e3 * K[0], rel=0.1)


def test_materials_that_a_coefficient_is_known_of_are_told():
    # A gain of two in every channel leaves no other trace.
    time, force = record(FEEDS[1])
    for gain, expected, other in ((1, "aluminium", "steel"), (2.5, "steel", "alumin")):
        fit = fitted(time, gain * force)
        note = next(note for note in fit.notes if "as published of" in note)
        assert expected in note
        assert other not in note


@pytest.mark.parametrize("axis", [0, 1])
def test_the_gain_of_a_channel_is_told(axis):
    _, force = record(FEEDS[1])
    force[:, axis] *= 2
    values = told(force)["channel_gain"]
    # Of two channels nobody knows which is wrong.
    ratio = values["ratio"] ** (1 if values["axis"] == axis else -1)
    assert ratio == pytest.approx(2, rel=0.05)
    assert values["left"] < 0.1 * values["before"]


def test_an_offset_and_a_drift_are_told():
    time, force = record(FEEDS[1])
    offset = np.array([30.0, -40.0, 0.0])
    values = told(force + offset[None])["offset"]
    assert (values["x"], values["y"]) == pytest.approx((30, -40), abs=6)
    slope = 4 * offset / (time[-1] - time[0])
    values = told(force + slope[None] * (time - time[0])[:, None])["drift"]
    assert (values["x"], values["y"]) == pytest.approx(tuple(slope[:2]), rel=0.1)


def test_a_line_at_the_frequency_of_the_spindle_tells_of_runout():
    _, force = record(FEEDS[1], runout=5e-6)
    values = told(force)["spindle_line"]
    assert values["frequency"] == pytest.approx(100) and not values["is_fitted"]
    time, alike = record(FEEDS[1], noise=0.0)
    off = record(FEEDS[1], noise=0.0, runout=5e-6)[1] - alike
    turns = time < time[0] + 0.01 * math.floor((time[-1] - time[0]) / 0.01)
    wave = np.exp(-2j * math.pi * 100 * time[turns])
    expected = 2 * np.abs(wave @ off[turns]) / turns.sum()
    found = [values[axis] for axis in "xyz"]
    np.testing.assert_allclose(found, expected, atol=0.05 * expected.max())
    # Beside the spindle's frequency, and at that of the teeth, no run-out is blamed.
    for frequency in (130, 200):
        force = alike + 8 * np.sin(2 * math.pi * frequency * time)[:, None]
        assert "spindle_line" not in told(force)


def test_the_spectrum_of_the_residual_shows_what_the_model_has_not():
    cut, time, seen = both(noise=0.01)
    seen[0][:, 1] += 8 * np.sin(2 * math.pi * 730 * time[0])
    fit = fit_force_coefficients(cut, time, seen, time_shift=0.0)
    frequency, amplitude = fit.residual_spectrum()
    peak = np.argmax(amplitude[:, 1])
    assert frequency[peak] == pytest.approx(730, abs=8)
    assert amplitude[peak, 1] == pytest.approx(8, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("later", [0.0, PERIOD])
def test_runout_is_found(later):
    """Also where one record begins at the other tooth: alike teeth do not show it."""
    cut, time, seen = both(shift=0.4e-3, runout=10e-6)
    time[1], seen[1] = record(FEEDS[1], 1, shift=0.4e-3 + later, runout=10e-6)
    fit = fit_force_coefficients(cut, time, seen, refine=["runout"])
    assert fit.has_converged and fit.explained > 0.995
    # Which of the teeth is called 0 is chance.
    np.testing.assert_allclose(abs(fit.refined["runout_x"]), 10e-6, atol=0.5e-6)
    # Two teeth tell the difference of their radii only, which the helix turns a little.
    off, known = fit.refined["runout_y"], fit.refined_errors
    assert known["runout_y"] > 5 * known["runout_x"]
    assert math.isnan(off) or abs(off) < 2 * known["runout_y"]
    np.testing.assert_allclose(found(fit), K, rtol=0.03)


@pytest.mark.slow
def test_runout_stays_where_no_step_lowers_the_cost():
    """A record on a wrong clock, whose force no run-out explains."""
    cutter = ct.flat_end_mill(
        2 * R, 2, helix_angle=HELIX, runout=15e-6, runout_angle=math.pi
    )
    cut = dataclasses.replace(cuts()[1], cutter=cutter)
    time, seen = record(FEEDS[1], noise=0.0, shift=3e-3)
    fit = fit_force_coefficients(cut, time, seen, refine=["runout"], time_shift=0.0)
    found = fit.records[0].cut.cutter
    assert float(found.runout) == pytest.approx(15e-6, rel=1e-9)
    assert not fit.has_converged
    told = " ".join(fit.notes)
    assert "runout_x, runout_y has not converged" in told
    # It is no result, and has no error.
    assert "runout_x has stayed at -15 um" in told
    assert math.isnan(fit.refined["runout_x"])
    assert math.isinf(fit.refined_errors["runout_x"])


def test_wrong_arguments_are_named():
    cut, time, seen = both()
    with pytest.raises(ValueError, match="`axes`"):
        fit_force_coefficients(cut, time, seen, axes=("x", "x", "z"))
    with pytest.raises(ValueError):
        fit_force_coefficients(cut, time[:1], seen)
    with pytest.raises(ValueError, match="`time`"):
        fit_force_coefficients(cut[0], time[0] + 9.0, seen[0])
    with pytest.raises(ValueError, match="radius"):
        fit_force_coefficients(cut, time, seen, refine=["speed"])
