"""The report holds everything in one file, and says what the dataset says."""

import base64
import dataclasses
import json
from html.parser import HTMLParser

import numpy as np
import pytest
import xarray

from diffmill.viz import case_numbers, write_figures, write_report

from .synthetic import chip_chart, cut_dexels, force_record, surface_error

MICROMETRE = "\u00b5m"


class Reader(HTMLParser):
    """Collect tags with their attributes, and the visible text."""

    def __init__(self):
        super().__init__()
        self.tags, self.words, self.open = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "link", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def read(path):
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    assert not reader.open
    return reader


def view(path):
    """Return what the script of a report draws."""
    text = path.read_text(encoding="utf-8")
    return json.loads(text.split('id="run-data">')[1].split("</script>")[0])


def unpacked(packed):
    return np.frombuffer(base64.b64decode(packed), "<f4")


@pytest.fixture(scope="module")
def full_run(tmp_path_factory, correction):
    folder = tmp_path_factory.mktemp("run")
    maps = {"uncorrected": surface_error(), "corrected": surface_error(0.05)}
    figures = write_figures(
        folder,
        correction,
        forces=force_record(),
        chip=chip_chart(),
        dexels=cut_dexels(),
        surfaces=maps,
    )
    notes = "the spacing exceeds 0.05 R & more"
    versions = f"{correction.attrs['versions']}, jax 0.0"
    told = correction.assign_attrs(angles="192", versions=versions, notes=notes)
    return figures, write_report(folder, told, figures, surfaces=maps)


def test_the_power_is_the_torque_times_the_speed_where_the_tool_cuts(correction):
    assert np.isnan(case_numbers(correction, "mirror").power_maximum)
    torque = np.where(correction["is_cutting"], 0.5, 9.0)
    known = correction.assign(spindle_torque=("step", torque))
    known = known.assign_attrs(spindle_speed=800.0)
    assert case_numbers(known, "mirror").power_maximum == 400.0


def test_headline_numbers_match_numpy(correction):
    numbers = case_numbers(correction, "mirror")
    cutting = correction["is_cutting"].values
    part = correction.sel(case="mirror")
    error = np.abs(part["contour_error"].values[cutting])
    assert numbers.contour.rms == pytest.approx(np.sqrt(np.mean(error**2)))
    assert numbers.contour.p95 == pytest.approx(np.percentile(error, 95))
    assert numbers.contour.max == pytest.approx(error.max())
    force = np.linalg.norm(part["force"].values[cutting], axis=1)
    assert numbers.force_mean == pytest.approx(force.mean())
    assert numbers.removed_volume == pytest.approx(part["removed_volume"].sum())


def test_unknown_case_is_refused(correction):
    with pytest.raises(ValueError, match="`name`"):
        case_numbers(correction, "nonsense")


def test_all_figures_are_written_as_png(full_run):
    figures, _ = full_run
    assert list(figures) == [
        "paths",
        "deviation",
        "forces",
        "chip",
        "surface",
        "dexels",
    ]
    for name, file in figures.items():
        assert file.path is not None and file.path.name == f"{name}.png"
        assert file.path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert file.caption and not file.skipped


def test_absent_inputs_are_named(tmp_path, simulation):
    files = write_figures(tmp_path, simulation.drop_vars(["desired", "force"]))
    assert all(file.path is None for file in files.values())
    assert files["paths"].skipped == "the result has no desired"
    assert files["forces"].skipped == "the result has no force"
    assert not list(tmp_path.iterdir())


def test_figures_are_written_by_name(tmp_path, simulation):
    chosen = lambda name: name in ("deviation", "chip")
    files = write_figures(tmp_path, simulation, is_chosen=chosen)
    assert list(files) == ["deviation", "chip"]
    assert files["chip"].skipped == "no chip chart was computed"
    assert [file.name for file in tmp_path.iterdir()] == ["deviation.png"]


def test_report_needs_no_other_file(full_run):
    figures, path = full_run
    reader = read(path)
    for tag, attributes in reader.tags:
        assert tag not in ("link", "iframe", "object")
        source = attributes.get("src", "")
        assert not source or source.startswith("data:image/png;base64,")
    policy = next(a["content"] for t, a in reader.tags if "http-equiv" in a)
    assert policy.startswith("default-src 'none'") and "http" not in policy
    images = [tag for tag, _ in reader.tags if tag == "img"]
    assert len(images) == len(figures)
    assert path.stat().st_size < 4e6


def test_report_prints_the_headline(full_run, correction):
    text = read(full_run[1]).text
    before, after = (
        case_numbers(correction, c).contour for c in ("uncorrected", "corrected")
    )
    assert f"{before.rms * 1e6:.0f} {MICROMETRE} contour error" in text
    assert f"{after.rms * 1e6:.2f} {MICROMETRE} contour error" in text
    assert f"{before.rms / after.rms:.1f} x" in text
    for part in (
        "mirror, iterated",
        "wall time [s] 0.400 0.900 12.0",
        "cutoff hz - - 3.00",
    ):
        assert part in text
    for part in ("diffmill 0.0-test", "angles 192", "jax 0.0", "exceeds 0.05 R & more"):
        assert part in text


def test_text_of_the_job_is_escaped(tmp_path, simulation):
    hostile = simulation.assign_attrs(
        job="<script>alert(1)</script>", notes="<img src=x>", **{"<u>": "<i>"}
    )
    one = next(iter(write_figures(tmp_path, simulation).values()))
    text = {"title": "<b>bold</b>", "skipped": "<b>why</b>"}
    bad = dataclasses.replace(one, path=None, **text)
    figures = {"bad": bad}
    stopped = hostile.assign_attrs(incomplete=1, incomplete_reason="<b>stop</b>")
    path = write_report(tmp_path, stopped, figures)
    reader = read(path)
    tags = [tag for tag, _ in reader.tags]
    assert tags.count("script") == 2 and "img" not in tags and "u" not in tags
    for part in ("<script>alert(1)</script>", "<b>not markup</b>", "<b>why</b>"):
        assert part in reader.text


def test_caption_says_whose_worst_places_are_magnified(
    tmp_path, correction, simulation
):
    caption = write_figures(tmp_path, correction)["paths"].caption
    assert "A is the place where the uncorrected path" in caption
    assert "B that of the corrected path" in caption
    alone = write_figures(tmp_path, simulation)["paths"].caption
    assert "the two places where the predicted path" in alone


def test_headline_is_that_of_the_chosen_case(tmp_path, correction):
    chosen = correction.assign_attrs(corrected_case="mirror")
    text = read(write_report(tmp_path, chosen, {})).text
    rms = case_numbers(correction, "mirror").contour.rms * 1e6
    assert f"{rms:.1f} {MICROMETRE} contour error (rms) after" in text


def test_the_error_of_the_written_program_stands_beside_that_of_the_command(
    tmp_path, correction
):
    given = correction.assign_attrs(written_rms_ngc=12.34e-6)
    text = read(write_report(tmp_path, given, {})).text
    assert "12.3" in text and "corrected.ngc" in text
    assert "written_rms_ngc" not in text
    # What is loaded counts, not the command that it was written from.
    factor = case_numbers(correction, "uncorrected").contour.rms / 12.34e-6
    assert f"{factor:.3g} x smaller contour error of what is written" in text


def test_what_to_load_and_to_set_is_said(tmp_path, correction, job):
    given = correction.assign_attrs(written_rms_ngc=12.34e-6)
    text = read(write_report(tmp_path, given, {}, job=job)).text
    assert f"corrected.ngc (12.3 {MICROMETRE} rms, read back and run)" in text
    assert "x 0 to 8, y 0 to 8, z -2 to 0 mm" in text
    assert "10 mm, 2 teeth, at 8000 rpm" in text


def test_a_command_that_is_worse_is_not_to_be_loaded(tmp_path, correction, job):
    error = correction["contour_error"]
    worse = correction.assign(
        contour_error=error.where(error["case"] != "corrected", 1e3 * error)
    )
    text = read(write_report(tmp_path, worse, {}, job=job)).text
    assert "Nothing to load" in text and "Load in place of" not in text


def test_a_command_that_was_given_is_not_called_the_program(tmp_path, simulation):
    text = read(write_report(tmp_path, simulation, {})).text
    assert "(rms) as programmed" in text
    given = simulation.assign_attrs(is_commanded=1)
    text = read(write_report(tmp_path, given, {})).text
    assert "(rms) as programmed" not in text and "given command" in text


def test_failed_run_without_a_reason_is_marked_too(tmp_path, simulation):
    failed = simulation.assign_attrs(is_successful=0)
    assert "This run is incomplete." in read(write_report(tmp_path, failed, {})).text


def test_complete_run_carries_no_warning(tmp_path, simulation):
    path = write_report(tmp_path, simulation, {})
    assert "incomplete" not in read(path).text


def test_incomplete_run_says_so(tmp_path, simulation):
    stopped = simulation.isel(step=slice(0, 100)).assign_attrs(
        incomplete=np.int32(1),
        incomplete_reason="Out of slots.",
        incomplete_time=0.3713,
        incomplete_place=np.array([1e-3, 2e-3, -1e-3]),
    )
    text = read(write_report(tmp_path, stopped, {})).text
    assert "rounded square (incomplete)" in text
    assert "This run is incomplete. Out of slots. It stopped at 0.3713 s" in text
    assert "x, y, z = 1.0, 2.0, -1.0 mm" in text


def test_simulation_report_lists_skipped_figures(tmp_path, simulation):
    figures = write_figures(tmp_path, simulation)
    text = read(write_report(tmp_path, simulation, figures)).text
    assert 'No figure "Chip thickness of one tooth": no chip chart' in text
    assert "predicted" in text and "largest contour error" in text


def test_rigid_run_divides_by_no_zero(tmp_path, simulation):
    rigid = simulation.copy(deep=True)
    rigid["deviation"].values[:] = 0.0
    rigid["contour_error"].values[:] = 0.0
    figures = write_figures(tmp_path, rigid)
    assert f"0 {MICROMETRE}" in read(write_report(tmp_path, rigid, figures)).text


def test_a_long_view_keeps_the_worst_moments_of_both_cases(tmp_path, job):
    """Neither the other case nor the air beside them hides them."""
    count = 20_000
    error = np.full((2, count), 1e-6)
    error[0, 3:12_000:10], error[1, 10_006] = 5e-5, -2e-5
    error[0, 7_001], error[:, 10_004] = -9e-5, 1e-3
    vectors = np.zeros((2, count, 3))
    time = np.arange(count) * 1e-3
    result = xarray.Dataset(
        {
            "desired": (("step", "axis"), vectors[0] + time[:, None]),
            "deviation": (("case", "step", "axis"), vectors),
            "force": (("case", "step", "axis"), vectors),
            "contour_error": (("case", "step"), error),
            "joint_positions": (
                ("case", "step", "joint"),
                vectors + 1e-3 * time[:, None],
            ),
            "is_cutting": ("step", np.arange(count) != 10_004),
        },
        {"case": ["uncorrected", "corrected"], "time": ("step", time)},
    )
    data = view(write_report(tmp_path, result, {}, job=job))
    assert data["rows"] < 2_100
    before, after = (np.abs(unpacked(case["error"])) for case in data["cases"])
    assert before.max() == pytest.approx(90.0) and after.max() == pytest.approx(20.0)
    shown = unpacked(data["time"])
    assert shown[data["worst"]] == pytest.approx(10.006)
    # The arm keeps up with the rows, of which the end has half as many.
    tip = unpacked(data["arm"]["points"]).reshape(data["arm"]["frames"], -1, 3)[:, -1]
    at = np.linspace(0, len(shown) - 1, len(tip)).astype(int)
    np.testing.assert_allclose(tip[:, 0] - tip[0, 0], shown[at], atol=1e-3)
