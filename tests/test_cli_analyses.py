"""Analyses and figures of a run on the command line: added to what is written."""

import re
import time
import types

import jax
import numpy as np
import pytest
import xarray

from diffmill import config, correction, sim, viz
from diffmill.cli import main
from small_job import small_job

PROGRAM = """G21 G17 G90 G94
G0 X-26 Y3 Z1
G0 Z-1.5
G1 X-7 F6000
G1 X-26
M2
"""
CUTTER = """diameter = "10 mm"
teeth = 2
overhang = "1 mm"
holder = [{ diameter = "40 mm", length = "20 mm" }]"""
JOB = small_job(CUTTER).replace('lower = ["0 mm"', 'lower = ["-4 mm"')
ELASTIC = """
[[machine.modes]]
frequency = "12 Hz"
damping_ratio = 0.05
direction = [1, 0, 0]
stiffness = "0.8 N/um"
[simulation]
scatter = { force = 0.1 }
"""


def fake_simulate(job, *, on_progress, **options):
    """Return a run whose tool follows the program; the force is made up."""
    count = job.path.step_count
    rows = {
        "desired": job.path.positions,
        "actual": job.path.positions,
        "force": np.full((count, 3), 7.0),
    }
    solution = types.SimpleNamespace(
        actual=job.path.positions,
        is_cutting=np.ones(count, bool),
        is_engagement_update=None,
        engagement_force_error=None,
        shank_volume=np.where(np.arange(count) == 40, 2e-9, 0.0),
        stock=job.stock,
    )
    solution.to_dataset = lambda: xarray.Dataset(
        {name: (("step", "axis"), values) for name, values in rows.items()}
        | {"contour_error": ("step", np.full(count, 2e-6))},
        {"time": ("step", np.asarray(job.path.time))},
    )
    return solution


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sim, "simulate", fake_simulate)
    monkeypatch.setattr(sim.Stability, "where_suspected", lambda job, solution: None)
    (tmp_path / "job.toml").write_text(JOB)
    (tmp_path / "part.ngc").write_text(PROGRAM)
    return tmp_path


def fail(*_, **__):
    raise RuntimeError("no memory left")


def interrupt(*_, **__):
    raise KeyboardInterrupt


def chatter(job, solution):
    return types.SimpleNamespace(
        row=np.arange(3),
        radius=np.array([0.9, 1.2, 1.1]),
        frequency=np.array([10.0, 58.7, 59.0]),
        strongest=1,
        warning=lambda: "the cut is unstable",
        visibility=lambda: "it shows",
    )


def result(folder):
    return xarray.load_dataset(folder / "job-simulate" / "result.nc")


def test_a_failing_analysis_or_figure_loses_no_run(folder, monkeypatch, capsys):
    for module, name in ((config, "tool_notes"), (viz, "figure_inputs")):
        monkeypatch.setattr(module, name, fail)
    monkeypatch.setattr(viz, "write_figures", fail)
    assert main(["simulate", "job.toml", "--quiet"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    for step in ("contacts", "surface", "figures"):
        assert f"{step} failed: RuntimeError: no memory left" in line
    assert "job-simulate" in line and "errors.txt" in line
    found = result(folder)
    assert found.attrs["incomplete"] == 0
    assert "figures failed" in found.attrs["notes"]
    assert np.isfinite(found["force"]).all() and found["force"].any()
    out = folder / "job-simulate"
    kept = {"result.nc", "stock.npz", "report.html", "errors.txt", "manifest.txt"}
    assert {file.name for file in out.iterdir()} == kept
    assert set((out / "manifest.txt").read_text().split()) == kept
    assert "no memory left" in (out / "errors.txt").read_text()


@pytest.mark.slow
def test_a_log_has_one_line_a_stage_and_one_if_it_compiles(folder, monkeypatch, capsys):
    event = "/jax/core/compile/backend_compile_duration"

    def simulate(job, *, on_progress, **options):
        on_progress("rigid cut", 0.0)
        jax.monitoring.record_scalar(event, 0.0)
        time.sleep(20)
        jax.monitoring.record_event_duration_secs(event, 20.0)
        on_progress("robot and cut", 0.4)
        time.sleep(20)
        return fake_simulate(job, on_progress=on_progress)

    monkeypatch.setattr(sim, "simulate", simulate)
    monkeypatch.setattr(viz, "figure_inputs", fail)
    main(["simulate", "job.toml"])
    said = capsys.readouterr().err
    told = re.findall(r"^ *(\d+\.\d) s +(.+)$", said, re.M)
    # Reading the job may have a line of its own.
    told = told[[text for _, text in told].index("0 %  rigid cut") :]
    first, second, third = told[:3]
    assert first[1] == "0 %  rigid cut"
    assert second[1].startswith("0 %  rigid cut: compiling") and float(second[0]) > 5
    assert third[1] == "40 %  robot and cut"
    assert sum("robot and cut" in text for _, text in told) == 1


def test_a_first_step_that_compiles_does_not_count_in_the_time_left(
    folder, monkeypatch, capsys
):
    now = [time.perf_counter() + 1e3]

    def simulate(job, *, on_progress, **options):
        monkeypatch.setattr(time, "perf_counter", lambda: now[0])
        for seconds, share in ((0, 0.0), (900, 0.1), (10, 0.3)):
            now[0] += seconds
            on_progress(f"step at {share}", share)
        raise KeyboardInterrupt

    monkeypatch.setattr(sim, "simulate", simulate)
    assert main(["simulate", "job.toml"]) == 1
    # A fifth took 10 s.
    assert "30 %  step at 0.3, about 35 s left\n" in capsys.readouterr().err


def test_a_log_gets_a_line_every_minute_of_a_long_stage(folder, monkeypatch, capsys):
    begun, clock = time.perf_counter(), time.perf_counter

    def simulate(job, *, on_progress, **options):
        # A second is forty.
        fast = lambda: begun + 40 * (clock() - begun)
        monkeypatch.setattr(time, "perf_counter", fast)
        on_progress("rigid cut", 0.0)
        time.sleep(8)
        raise KeyboardInterrupt

    monkeypatch.setattr(sim, "simulate", simulate)
    assert main(["simulate", "job.toml"]) == 1
    said = re.findall(
        r"^ *([\d.]+) s    0 %  rigid cut$", capsys.readouterr().err, re.M
    )
    gaps = np.diff([float(seconds) for seconds in said])
    assert len(gaps) >= 2 and gaps.min() > 60 and gaps.max() < 150


def test_results_are_there_before_anything_is_analysed(folder, monkeypatch, capsys):
    def interrupt(*_, **__):
        assert result(folder)["force"].any()
        raise KeyboardInterrupt

    monkeypatch.setattr(config, "tool_notes", interrupt)
    assert main(["simulate", "job.toml"]) == 1
    assert "job-simulate" in capsys.readouterr().err.splitlines()[-1]
    assert result(folder)["force"].any()


def test_growth_too_brief_for_chatter_is_no_warning(folder, monkeypatch, capsys):
    found = types.SimpleNamespace(
        row=np.arange(3),
        radius=np.array([0.9, 1.01, 0.9]),
        frequency=np.array([10.0, 58.7, 59.0]),
        strongest=1,
        warning=lambda: None,
        note=lambda: "vibrations grow, too briefly",
        visibility=lambda: "it shows",
    )
    monkeypatch.setattr(sim.Stability, "where_suspected", lambda job, solution: found)
    monkeypatch.setattr(viz, "figure_inputs", fail)
    main(["simulate", "job.toml"])
    assert "stability: vibrations grow, too briefly" in capsys.readouterr().err
    written = result(folder)
    assert written.attrs["stability_has_chatter"] == 0
    assert "The cut is unstable" not in (
        folder / "job-simulate" / "report.html"
    ).read_text(encoding="utf-8")


def test_contacts_and_stability_are_said_and_kept(folder, monkeypatch, capsys):
    monkeypatch.setattr(sim.Stability, "where_suspected", chatter)
    monkeypatch.setattr(viz, "figure_inputs", fail)
    assert main(["simulate", "job.toml"]) == 1
    said = capsys.readouterr().err.splitlines()
    written = result(folder)
    *notes, last = written.attrs["notes"].splitlines()
    assert "surface failed" in last
    assert {f"note: {note}" for note in notes} & set(said)
    assert all(note in said for note in notes if f"note: {note}" not in said)
    assert "warning: the cut is unstable" in notes and "stability: it shows" in notes
    (shank,) = [note for note in notes if "2 mm^3" in note]
    (holder,) = [n for n in notes if "holder" in n and n.startswith("warning")]
    assert notes.index(shank) < notes.index(holder)
    assert written.attrs["stability_largest_radius"] == 1.2
    assert written.attrs["stability_has_chatter"] == 1
    assert written["holder_depth"].max() > 0


def band(job, solution):
    return types.SimpleNamespace(
        rms=3e-6,
        shares=dict,
        to_dataset=lambda: xarray.Dataset(attrs={"expected_contour_error_rms_m": 3e-6}),
    )


@pytest.mark.parametrize("step", [band, fail, interrupt])
def test_the_verdict_tells_of_chatter_and_scatter(folder, monkeypatch, capsys, step):
    (folder / "job.toml").write_text(JOB.replace("[robot]\nrigid = true\n", ELASTIC))
    monkeypatch.setattr(sim.Stability, "where_suspected", chatter)
    monkeypatch.setattr(sim, "error_band", step)
    monkeypatch.setattr(viz, "figure_inputs", fail)
    main(["simulate", "job.toml", "--tolerance-band", "20 um"])
    (verdict,) = [x for x in capsys.readouterr().out.splitlines() if "unstable" in x]
    assert verdict.startswith("The cut is unstable (chatter). A vibration at 58.7 Hz")
    assert ("3 um rms is to be expected" in verdict) == (step is band)


@pytest.mark.parametrize(
    ("search", "words"),
    [(chatter, "warning: the cut is unstable"), (fail, "no memory left")],
)
def test_chatter_is_told_before_anything_is_corrected_and_its_failure_stops_nothing(
    folder, monkeypatch, capsys, search, words
):
    (folder / "job.toml").write_text(JOB.replace("[robot]\nrigid = true\n", ELASTIC))
    monkeypatch.setattr(sim.Stability, "where_suspected", search)

    def correct(job, *, on_predicted, **_):
        on_predicted(fake_simulate(job, on_progress=None))
        assert words in capsys.readouterr().err
        raise KeyboardInterrupt

    monkeypatch.setattr(correction, "correct", correct)
    assert main(["correct", "job.toml"]) == 1
    assert "interrupted" in capsys.readouterr().err


def test_a_long_step_logs_its_share_and_the_time_left(folder, monkeypatch, capsys):
    (folder / "job.toml").write_text(JOB.replace("[robot]\nrigid = true\n", ELASTIC))
    begun = time.perf_counter() + 1e3
    now = [begun]

    def correct(job, *, on_step_progress, **_):
        monkeypatch.setattr(time, "perf_counter", lambda: now[0])
        for second in range(1, 21):
            now[0] = begun + second
            on_step_progress("step 1 over 900 tooth periods", second / 40)
        # Another step begins anew.
        now[0] += 20.0
        on_step_progress("step 2 over 900 tooth periods", 0.5)
        raise KeyboardInterrupt

    monkeypatch.setattr(correction, "correct", correct)
    assert main(["correct", "job.toml"]) == 1
    said = capsys.readouterr().err
    # A line where it was silent for eight seconds, not for each part.
    shares = re.findall(r"(\d+) %  step 1 over 900 tooth periods(.*)", said)
    assert 2 <= len(shares) <= 3
    assert re.fullmatch(r", about 2\d s left", shares[-1][1])
    assert "50 %  step 2 over 900 tooth periods\n" in said


def test_correct_says_that_it_reuses_no_engagement(folder, monkeypatch, capsys):
    elastic = f'{ELASTIC}resolution = "adaptive"\n'
    (folder / "job.toml").write_text(JOB.replace("[robot]\nrigid = true\n", elastic))
    asked = []

    def correct(job, **_):
        asked.append(job.notes)
        raise KeyboardInterrupt

    monkeypatch.setattr(correction, "correct", correct)
    assert main(["correct", "job.toml"]) == 1
    note = 'resolution: found "adaptive", which holds in simulate'
    assert capsys.readouterr().err.count(note) == 1
    # Results have the notes of their job.
    assert sum(note in one for one in asked[0]) == 1
