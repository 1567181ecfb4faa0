"""What the report says of a tolerance, and of what limited the result."""

import dataclasses
import math

import numpy as np
import pytest
import xarray as xr

from diffmill.viz import summary, write_report

from .synthetic import PERIOD
from .test_report import read


def report(folder, dataset, job=None):
    return read(write_report(folder, dataset, {}, job=job)).text


def with_correction(job, **settings):
    """Return a job whose correction has other settings."""
    changed = dataclasses.replace(job.correction, **settings)
    return dataclasses.replace(job, correction=changed)


def offset_by(dataset, offset):
    """Return a result whose corrected command is the desired path and an offset."""
    commanded = dataset["commanded"].copy()
    commanded.loc[{"case": "corrected"}] = dataset["desired"].values + offset
    return dataset.assign(commanded=commanded)


def corrected_error(dataset):
    error = np.abs(dataset["contour_error"].sel(case="corrected").values)
    return np.where(dataset["is_cutting"].values, error, 0.0)


@pytest.mark.parametrize(("factor", "is_held"), [(1.01, True), (0.99, False)])
def test_the_largest_error_decides(tmp_path, correction, factor, is_held):
    error = corrected_error(correction)
    band = factor * error.max()
    text = report(tmp_path, correction.assign_attrs(tolerance_band=band))
    assert ("Not within" in text) != is_held
    assert ("within the tolerance at all of" in text) == is_held
    row = int(error.argmax())
    x, y, z = 1e3 * correction["desired"].values[row]
    time = correction["time"].values[row]
    assert f"at {time:.3f} s, x, y, z = {x:.1f}, {y:.1f}, {z:.1f} mm" in text


def test_the_written_program_has_to_keep_the_band_too(tmp_path, correction):
    band = 1.01 * corrected_error(correction).max()
    given = correction.assign_attrs(tolerance_band=band, written_max_ngc=1.1 * band)
    text = report(tmp_path, given)
    assert "Not within" in text and "within the tolerance at all of" in text
    assert f"Of corrected.ngc, read back and run: {1.1e6 * band:.3g}" in text
    assert "Not within" not in report(
        tmp_path, given.assign_attrs(written_max_ngc=0.9 * band)
    )


def test_verdict_and_headline_are_those_of_the_program_to_load(tmp_path, correction):
    largest = corrected_error(correction).max()
    told = dict(
        tolerance_band=2 * largest,
        written_max_ngc=1.1 * largest,
        written_rms_ngc=1e-6 * largest,
        moved_max_ngc=3 * largest,
        moved_rms_ngc=2 * largest,
        stream_max_csv=4 * largest,
        stream_rms_csv=2 * largest,
    )
    text = report(tmp_path, correction.assign_attrs(told))
    assert "Not within" not in text
    assert f"Of moved.ngc, read back and run: {3e6 * largest:.3g}" in text
    assert "not judged, is moved.ngc and stream.csv" in text
    assert "smaller contour error" in text and "of what is written" not in text
    calm = told | dict(moved_max_ngc=largest, stream_max_csv=largest)
    assert "not judged" not in report(tmp_path, correction.assign_attrs(calm))


def test_a_program_that_may_not_keep_its_times_is_not_judged(tmp_path, correction):
    largest = corrected_error(correction).max()
    told = dict(tolerance_band=2 * largest, written_max_src=3 * largest)
    told |= dict(written_rms_src=2 * largest, written_max_ngc=1.1 * largest)
    assert "Not within" in report(tmp_path, correction.assign_attrs(told))
    told |= dict(written_untimed_src="the controller rests at corners")
    text = report(tmp_path, correction.assign_attrs(told))
    assert "Not within" not in text and "Outside the tolerance" not in text
    assert f"Of corrected.src, read back and run: {3e6 * largest:.3g}" in text
    assert "if its times are kept; not judged." in text
    box = text.split("Before you load it")[2]
    assert "\u2610 times of corrected.src The controller rests at corners." in box
    assert "of what is written" not in text


@pytest.mark.parametrize("left", [np.nan, np.inf])
def test_a_written_error_that_is_not_finite_keeps_no_tolerance(correction, left):
    given = correction.assign_attrs(tolerance_band=1.0, written_max_ngc=left)
    text = summary(given, "verdict")
    assert text.startswith("Not within") and "corrected.ngc" in text


def test_a_written_program_that_could_not_be_run_is_said(tmp_path, correction):
    given = correction.assign_attrs(tolerance_band=1e-3, written_not_run=1)
    assert "were not run" in report(tmp_path, given)
    assert "were not run" not in report(
        tmp_path, correction.assign_attrs(tolerance_band=1e-3)
    )


def test_the_share_within_is_that_of_the_steps_that_cut(tmp_path, correction):
    error = corrected_error(correction)
    cutting = correction["is_cutting"].values
    band = float(np.percentile(error[cutting], 60))
    share = 100 * np.mean(error[cutting] <= band)
    text = report(tmp_path, correction.assign_attrs(tolerance_band=band))
    assert f"within the tolerance at {share:.1f} % of the steps" in text


def test_an_unfinished_run_and_one_without_a_tolerance_get_no_verdict(
    tmp_path, correction
):
    text = report(tmp_path, correction)
    assert "No tolerance stated" in text and "--tolerance-band" in text
    stopped = correction.assign_attrs(tolerance_band=1.0, incomplete=np.int32(1))
    assert "No verdict. The run did not reach its end" in report(tmp_path, stopped)


def test_the_summary_says_the_verdict_too(correction):
    assert "tolerance" not in summary(correction)
    assert "Within 10 mm" in summary(correction.assign_attrs(tolerance_band=1e-2))
    assert "Not within 0.01 um" in summary(correction.assign_attrs(tolerance_band=1e-8))


def test_a_bound_that_the_command_reaches_is_named_with_its_share(
    tmp_path, correction, job
):
    count = correction.sizes["step"]
    ramp = np.linspace(0, 1, count)[:, None] * np.array([1e-3, 0, 0])
    wide = with_correction(job, acceleration_factor=np.inf)
    text = report(tmp_path, offset_by(correction, ramp), wide)
    share = 100 * np.mean(np.linspace(0, 1, count) >= 0.98)
    assert f"max_offset of 0.001 m in {share:.2g} %" in text
    assert "max_acceleration" not in text
    assert "max_offset" not in report(tmp_path, offset_by(correction, ramp / 2), wide)


def test_the_largest_departure_is_told_in_the_cut_and_in_the_air(
    tmp_path, correction, simulation
):
    commanded = correction["commanded"].copy()
    desired = correction["desired"].values
    commanded.loc[{"case": "uncorrected"}] = desired
    offset = np.full(desired.shape, 1e-5)
    offset[100, 1], offset[5, 2] = -2.5e-4, 4.34e-4
    commanded.loc[{"case": "corrected"}] = desired + offset
    text = report(tmp_path, correction.assign(commanded=commanded))
    time = correction["time"].values
    x, y, z = 1e3 * desired[100]
    assert (
        f"by up to -250 \u00b5m in y where the tool cuts (at {time[100]:.3f} s, "
        f"x, y, z = {x:.1f}, {y:.1f}, {z:.1f} mm)" in text
    )
    assert f"and +434 \u00b5m in z in the air (at {time[5]:.3f} s" in text
    assert "departs from the program" not in report(tmp_path, simulation)


def test_a_command_as_fast_as_it_may_be_is_told(tmp_path, correction, job):
    time = correction["time"].values
    offset = np.zeros((time.size, 3))
    offset[:, 2] = 1e-4 * np.sin(2 * np.pi * 20 * time)
    bound = 0.8 * 1e-4 * (2 * np.pi * 20) ** 2
    capped = with_correction(job, max_acceleration=bound, acceleration_factor=np.inf)
    text = report(tmp_path, offset_by(correction, offset), capped)
    assert f"of {bound:.3g} m/s" in text and "a wider one may gain more" in text


@pytest.mark.parametrize(("hertz", "is_named"), [(10.0, False), (25.0, True)])
def test_what_is_faster_than_the_knots_is_named(
    tmp_path, correction, job, hertz, is_named
):
    """Knots 30 ms apart follow up to 16.7 Hz."""
    count = correction.sizes["step"]
    wave = 1e-6 * np.sin(2 * np.pi * hertz * PERIOD * np.arange(count))
    deviation = correction["deviation"].copy()
    deviation.loc[{"case": "corrected"}] = wave[:, None] * np.ones(3)
    knots = with_correction(job, knot_spacing=30e-3)
    text = report(tmp_path, correction.assign(deviation=deviation), knots)
    assert ("is faster than 16.7 Hz" in text) == is_named


def test_steps_that_ran_out_and_a_constant_error_are_named(tmp_path, correction):
    mean = np.zeros((correction.sizes["case"], 3))
    error = corrected_error(correction)[correction["is_cutting"].values]
    mean[-1, 2] = 0.9 * np.sqrt(np.mean(error**2))
    result = correction.assign(contour_mean=(("case", "axis"), mean))
    text = report(tmp_path, result.assign_attrs(corrected_outcome="steps ran out"))
    assert "[correction] max_steps" in text
    assert "81 % of the square of the contour error is a constant vector" in text
    assert "What limited the result" not in report(tmp_path, correction)


@pytest.mark.parametrize("chatters", [0, 1])
def test_chatter_limits_the_result(tmp_path, correction, chatters):
    """Growth that is too brief for chatter, a radius above 1 alone, does not."""
    told = {"stability_largest_radius": 1.01, "stability_has_chatter": chatters}
    text = report(tmp_path, correction.assign_attrs(told))
    assert ("a corrected path does not" in text) == bool(chatters)


def test_an_unstable_cut_is_the_headline_whatever_its_errors_are(correction):
    told = {
        "stability_has_chatter": 1,
        "stability_largest_radius": 1.043,
        "stability_frequency": 58.7,
    }
    for band in (0.0, 1.0):
        given = correction.assign_attrs(tolerance_band=band)
        assert not summary(given, "verdict").startswith("The cut is unstable")
        text = summary(given.assign_attrs(told), "verdict")
        assert text.startswith(
            "The cut is unstable (chatter). A vibration at 58.7 Hz grows by up to "
            "4.3 % per tooth period"
        )
        assert "no corrected path calms it" in text


def test_a_mirror_that_diverges_is_marked(tmp_path, correction):
    grown = correction["contour_error"].copy(deep=True)
    grown.loc[{"case": "mirror"}] *= 10.0
    diverged = correction.assign(contour_error=grown)
    for dataset, diverges in ((correction, False), (diverged, True)):
        lines = summary(dataset, "figures").splitlines()
        marked = [line.split()[0] for line in lines if line.endswith("  diverges")]
        assert marked == (["mirror"] if diverges else [])
        assert ("diverges (0." in report(tmp_path, dataset)) == diverges
        assert ("note: the mirror is worse" in summary(dataset)) == diverges


def test_a_verdict_says_what_the_contour_error_does_not_count(tmp_path, correction):
    band = 1.01 * corrected_error(correction).max()
    cases = correction["case"].values
    deep = np.where(cases == "corrected", 3 * band, 0.0)
    place = np.tile([1e-3, -2e-3, 3.5e-3], (len(cases), 1))
    given = correction.assign(
        surface_deepest=("case", deep), surface_deepest_at=(("case", "axis"), place)
    ).assign_attrs(tolerance_band=band, stability_has_chatter=1)
    text = report(tmp_path, given)
    assert "inside the part (x, y, z = 1.0, -2.0, 3.5 mm), cut at" in text
    assert f"up to {3e6 * band:.3g} \u00b5m inside the part" in text
    assert "The cut is unstable" in text and "Not within" not in text
    given = given.assign_attrs(stability_has_chatter=0)
    assert "Not within" in report(tmp_path, given)
    without = summary(given.assign_attrs(tolerance_band=0.0), "verdict")
    assert "cuts into the part" in without and "inside the part" in without
    some = summary(given.assign(surface_deepest=("case", 0.4 * deep)), "verdict")
    assert some.startswith("Within") and "inside the part" in some
    calm = given.assign(surface_deepest=("case", 0.3 * deep))
    text = report(tmp_path, calm.assign_attrs(stability_has_chatter=0))
    assert "inside the part" not in text and "But the cut" not in text


def test_a_shank_in_the_stock_is_not_within_a_tolerance(correction):
    band = 1.01 * corrected_error(correction).max()
    shank = xr.zeros_like(correction["contour_error"])
    shank[dict(step=3)] = 1e-10
    held = correction.assign_attrs(tolerance_band=band)
    assert summary(held, "verdict").startswith("Within")
    assert "exactly as modelled" in summary(held, "verdict")
    text = summary(held.assign(shank_volume=shank), "verdict")
    assert text.startswith("Not within") and "shank" in text
    without = held.assign(shank_volume=shank).assign_attrs(tolerance_band=0.0)
    assert summary(without, "verdict").startswith("The shank is in the stock")


def test_the_verdict_says_what_is_left_beside_the_model(tmp_path, correction):
    off = dict(
        mismatch_share=0.1,
        mismatch_rms_stiffness=9.5e-6,
        mismatch_rms_force=math.nan,
        tolerance_band=1e-3,
        stability_has_chatter=0,
    )
    text = summary(correction.assign_attrs(off), "verdict")
    assert "stiffness 10% off the command leaves up to 9.5 um rms, with" in text
    assert "force coefficients 10% off no result;" in text
    settings = report(tmp_path, correction.assign_attrs(off)).lower()
    assert "mismatch" not in settings and "stability has chatter" not in settings


def test_a_machine_that_was_learnt_is_not_said_to_be_as_modelled(correction):
    told = dict(learnt_expected_rms=4.6e-6, tolerance_band=1e-3)
    learnt = correction.assign_attrs(told)
    text = summary(learnt, "verdict")
    assert "exactly as modelled" not in text and "4.6 um rms is expected" in text


def test_a_robust_command_is_judged_over_its_draws(correction):
    told = dict(
        tolerance_band=1e-3,
        corrected_draws=8.0,
        corrected_draw_rms_least=3e-6,
        corrected_draw_rms_largest=7e-6,
    )
    text = summary(correction.assign_attrs(told), "verdict")
    assert "Over the 8 draws" in text and "leaves 3 um to 7 um rms" in text
    assert "exactly as modelled" not in text


def test_more_steps_are_proposed_only_where_they_may_be_needed(correction):
    most = corrected_error(correction).max()
    short = correction.assign_attrs(corrected_outcome="steps ran out")
    for band, is_told in ((0.0, True), (0.9 * most, True), (1.1 * most, False)):
        text = summary(short.assign_attrs(tolerance_band=band), "figures")
        assert ("max_steps" in text) == is_told


def test_the_figures_of_a_path_in_the_air_are_dashes(simulation):
    none = np.zeros(simulation.sizes["step"], bool)
    line = summary(simulation.assign(is_cutting=("step", none))).splitlines()[2]
    assert line.split() == ["predicted", "-", "-", "-", "-"]


@pytest.mark.parametrize(
    ("uncorrected", "words"),
    [(8e-5, "where the program leaves 80"), (np.nan, "where the program fails on one")],
)
def test_a_program_that_fails_on_a_drawn_machine_has_no_number(
    tmp_path, correction, uncorrected, words
):
    said = report(
        tmp_path,
        correction.assign_attrs(
            tolerance_band=1.0,
            truth_draws=4,
            truth_rms_median=2e-5,
            truth_rms_largest=3e-5,
            truth_rms_uncorrected=uncorrected,
        ),
    )
    assert words in said and "nan" not in said
