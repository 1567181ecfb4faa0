"""`diffmill feed`: what it prints, writes and refuses."""

import equinox as eqx
import numpy as np
import pytest
import xarray
from slides_job import JOB, with_machine, write_slides_job

from diffmill import SimulationFailed, config, correction, io, load_job
from diffmill.cli import main
from diffmill.correction import FeedPoint, FeedTradeoff, NothingToCorrect, TunedFeed
from diffmill.toolpath import PathFeed, Program, retime


@pytest.fixture
def folder(here):
    write_slides_job(here)
    return here


@pytest.fixture
def asked(monkeypatch):
    """Return what the command asks for; the errors are made up, the times are not."""
    calls = {}

    def tradeoff(job, overrides, *, corrects, on_progress):
        calls.update(overrides=overrides, corrects=corrects)
        on_progress("override 1", 0.5)
        factors, feed = np.array(overrides), PathFeed.of_path(job.path)
        times = np.array([feed.cycle_time(value) for value in overrides])
        after = np.full(len(overrides), 1e-6 if corrects else np.nan)
        return FeedTradeoff(
            factors, times, 1e-4 * factors, 9e-6 * factors, after, after
        )

    def tuned(job, *, time_weights, lowest, on_progress):
        calls.update(weights=time_weights)
        points, paths = [], []
        for k, weight in enumerate((np.nan, *time_weights)):
            override = np.full(3, 1.0 - 0.1 * k)
            paths.append(retime(job.path, override))
            seconds = float(PathFeed.of_path(job.path).cycle_time(override))
            points.append(FeedPoint(weight, override, seconds, 8e-6, k, 3 * k, k < 2))
        return TunedFeed(tuple(points), np.linspace(0, 0.02, 3), tuple(paths))

    monkeypatch.setattr(correction, "feed_tradeoff", tradeoff)
    monkeypatch.setattr(correction, "tune_feed", tuned)
    return calls


def test_feed_writes_numbers_a_figure_and_tuned_paths(folder, asked, capsys):
    command = ["feed", "job.toml", "--overrides", "0.5", "1", "--weights", "0.3", "0.1"]
    assert main(command) == 0
    wanted = {"overrides": (0.5, 1.0), "corrects": False, "weights": (0.3, 0.1)}
    assert asked == wanted
    said = capsys.readouterr()
    assert "program  corrected" in said.out
    text = said.out + said.err
    for part in ("0.90 to 0.90\n", "0.80 to 0.80 (steps ran out)", "results: job-feed"):
        assert part in text
    out = folder / "job-feed"
    assert {p.name for p in out.iterdir()} >= {
        *("result.nc", "feed.png", "tuned_0.3.csv", "tuned_0.3.ngc"),
        *("tuned_0.1.csv", "tuned_0.1.ngc"),
    }
    page = (out / "report.html").read_text()
    assert "leaves 4.5 um rms, the least, at an override of 0.5 in" in page
    for title in ("Feeds of the whole program", "Overrides along the path", "Figures"):
        assert f"<h2>{title}</h2>" in page
    assert "steps ran out" in page and page.count("<img ") == 1
    with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as found:
        np.testing.assert_allclose(found["uncorrected"], [4.5e-6, 9e-6])
        slow, usual = (float(value) for value in found["cycle_time"])
        assert slow == pytest.approx(2 * usual, rel=0.1)
        np.testing.assert_allclose(found["tuned_feed_override"][2], 0.8)
        assert found["override"].attrs["units"] == "1"
        assert found.attrs["job"] == "job"
        seconds = float(found["tuned_cycle_time"][1])
    # What is written takes the time that is told, up to a row.
    path = io.read_path_csv(out / "tuned_0.3.csv")
    assert float(path.time[-1]) == pytest.approx(seconds, abs=4e-3)
    program = (out / "tuned_0.3.ngc").read_text()
    assert "tuned for a weight of the time of 0.3" in program and "G93" in program
    assert program.count("\nG1 ") == path.step_count - 1
    assert main([*command, "--quiet"]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("error", [SimulationFailed, NothingToCorrect, ValueError])
def test_errors_of_all_feeds_are_kept_if_none_can_be_tuned(
    folder, asked, capsys, monkeypatch, error
):
    def fails(job, **options):
        raise error("the arm shakes itself free.")

    monkeypatch.setattr(correction, "tune_feed", fails)
    assert main(["feed", "job.toml", "--overrides", "0.5", "1"]) == 1
    said = capsys.readouterr()
    assert "the arm shakes itself free" in said.err and "4.50" in said.out
    with xarray.open_dataset("job-feed/result.nc", engine="h5netcdf") as found:
        np.testing.assert_allclose(found["uncorrected"], [4.5e-6, 9e-6])


def test_a_folder_that_fills_up_meanwhile_costs_nothing(
    folder, asked, capsys, monkeypatch
):
    known = correction.feed_tradeoff

    def filled(*arguments, **options):
        (folder / "job-feed").mkdir()
        (folder / "job-feed/note.txt").write_text("of somebody else")
        return known(*arguments, **options)

    monkeypatch.setattr(correction, "feed_tradeoff", filled)
    assert main(["feed", "job.toml", "--overrides", "1", "--weights"]) == 0
    assert "results: job-feed-2" in capsys.readouterr().err
    assert [p.name for p in (folder / "job-feed").iterdir()] == ["note.txt"]
    assert (folder / "job-feed-2/result.nc").exists()


def test_an_empty_list_of_weights_tunes_nothing(folder, asked, capsys):
    assert main(["feed", "job.toml", "--weights", "--correct"]) == 0
    assert asked == {"overrides": (0.5, 0.75, 1.0, 1.25, 1.5), "corrects": True}
    assert "along the path" not in capsys.readouterr().err
    names = [p.name for p in (folder / "job-feed").iterdir()]
    assert "feed.png" in names
    assert not [name for name in names if name.startswith("tuned")]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--overrides", "1", "0"], "--overrides: found 1 0, but numbers above 0"),
        (["--overrides"], "--overrides: found none"),
        (["--weights", "-0.1"], "--weights: found -0.1, but numbers above 0"),
        (["--weights", "0.1", "0.1"], "each may occur once"),
        (["--overrides", "1", "1e-9"], "override 1e-09: found a motion of"),
        (["--overrides", "1e-200"], "inf tooth periods; at most 1000000 are allowed"),
    ],
)
def test_what_cannot_be_tried_is_refused_before_anything_runs(
    folder, asked, capsys, arguments, words
):
    assert main(["feed", "job.toml", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not asked and not (folder / "job-feed").exists()


def test_the_slowest_override_along_the_path_has_a_limit_too(
    folder, asked, capsys, monkeypatch
):
    def rows(feed, override):
        if override < 0.6:
            raise ValueError("too many rows")

    monkeypatch.setattr(PathFeed, "row_count", rows)
    command = ["feed", "job.toml", "--overrides", "1", "--weights"]
    assert main(command) == 0
    assert main([*command, "0.1", "--force"]) == 2
    assert "error: override 0.5: too many rows" in capsys.readouterr().err


def test_a_rigid_machine_and_an_idle_program_are_refused(
    folder, asked, capsys, monkeypatch
):
    (folder / "rigid.toml").write_text(with_machine(JOB, "[robot]\nrigid = true\n"))
    assert main(["feed", "rigid.toml"]) == 2
    assert "but feed needs a machine that is soft" in capsys.readouterr().err

    def idle(job, overrides, **options):
        raise NothingToCorrect("the rigid tool removes nothing.")

    monkeypatch.setattr(correction, "feed_tradeoff", idle)
    assert main(["feed", "job.toml"]) == 2
    assert "found nothing that the feed could change" in capsys.readouterr().err
    assert not (folder / "job-feed").exists()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('knot_spacing = "9 s"', "`knot_spacing`"),
        ("horizon = 1", "an overlap below its horizon of 1 rows"),
    ],
)
def test_settings_that_correct_refuses_are_one_message(folder, capsys, line, words):
    write_slides_job(folder, line)
    command = ["feed", "job.toml", "--correct", "--overrides", "1", "--weights"]
    assert main(command) == 2
    *_, said = capsys.readouterr().err.splitlines()
    assert said.startswith("error: job: [correction] ") and words in said
    assert not (folder / "job-feed").exists()


def test_the_feed_of_a_machine_of_modes_is_studied(folder, asked):
    mode = """[[machine.modes]]
frequency = "20 Hz"
damping_ratio = 0.1
direction = [1, 1, 1]
mass = "80 kg"
"""
    (folder / "modal.toml").write_text(with_machine(JOB, mode))
    assert main(["feed", "modal.toml", "--overrides", "1"]) == 0
    assert asked["overrides"] == (1.0,)


@pytest.mark.slow
def test_feed_of_a_job(folder, capsys):
    command = ["feed", "job.toml", "--overrides", "0.5", "1", "--weights", "0.3"]
    assert main(command) == 0, capsys.readouterr().err
    with xarray.open_dataset(folder / "job-feed" / "result.nc") as found:
        assert found["uncorrected"][0] < found["uncorrected"][1]
        assert found["tuned_rms"][1] < found["tuned_rms"][0]


def test_the_fastest_feed_within_a_tolerance_is_written(folder, monkeypatch, capsys):
    asked = {}

    def fastest(job, tolerance, *, corrects, knots, on_progress, **limits):
        asked.update(tolerance=tolerance, corrects=corrects, **limits)
        assert knots == 0
        on_progress("override 1", 0.0)
        tried = (
            correction.TriedFeed(1.0, 5.0, 2e-5, 90.0, 350.0, 0.3, ""),
            correction.TriedFeed(1.5, 4.0, 7e-5, 99.0, 420.0, 0.5, "tolerance"),
        )
        path = retime(job.path, 1.0)
        return correction.FastestFeed(tried, tried[0], "tolerance", path)

    monkeypatch.setattr(correction, "fastest_feed", fastest)
    program = (folder / "part.ngc").read_text()
    (folder / "part.ngc").write_text(f"T3 M6\nG43 H3\n{program}")
    command = ["feed", "job.toml", "--tolerance", "50 um", "--max-force", "100 N"]
    assert main([*command, "--max-power", "0.5 kW"]) == 0
    assert asked["tolerance"] == pytest.approx(5e-5) and not asked["corrects"]
    assert asked["max_force"] == pytest.approx(100.0)
    assert asked["max_power"] == pytest.approx(500.0)
    said, out = capsys.readouterr().out, folder / "job-feed"
    assert "; the next larger breaks: tolerance" in said
    assert "beyond the limit: tolerance" in said and "       350" in said
    assert (out / "summary.txt").read_text() in said
    fastest_program = (out / "fastest.ngc").read_text()
    for part in ("the fastest feed by diffmill", "\nT3 M6\n", "\nG43 H3\n"):
        assert part in fastest_program
    page = (out / "report.html").read_text()
    assert "a power of 0.5 kW" in page and "largest power [W]" in page
    assert "<b>Override 1.000.</b>" in page and page.count("<img ") == 1
    for part in ("a contour error of 50 um", "a force of 100 N", "Assumptions"):
        assert part in page
    (best,) = [row for row in page.split("<tr") if row.startswith(' class="best"')]
    assert ">1.000<" in best and ">20<" in best
    with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as found:
        np.testing.assert_allclose(found["override"], [1.0, 1.5])
        assert found["broken"].values.tolist() == ["", "tolerance"]


def test_with_correct_the_command_that_kept_the_tolerance_is_written(
    folder, monkeypatch, capsys
):
    offset = 1e-4 * np.array([1.0, -2.0, 3.0])

    def fastest(job, tolerance, *, corrects, **options):
        assert corrects
        tried = (correction.TriedFeed(0.8, 5.0, 2e-5, 90.0, 350.0, 0.3, ""),)
        path = retime(job.path, 0.8)
        commanded = np.asarray(path.positions) + offset
        return correction.FastestFeed(tried, tried[0], "", path, None, commanded)

    monkeypatch.setattr(correction, "fastest_feed", fastest)
    (folder / "job.toml").write_text(f'{JOB}[output]\nformats = ["gcode", "krl"]\n')
    command = ["feed", "job.toml", "--tolerance", "50 um", "--correct"]
    assert main(command) == 0
    out, path = folder / "job-feed", retime(load_job("job.toml").path, 0.8)
    told = np.asarray(path.positions) + offset
    recorded = io.read_path_csv(out / "fastest.csv")
    np.testing.assert_allclose(recorded.positions, told, atol=2e-6)
    for suffix in (".ngc", ".src"):
        program = io.read_program(out / f"fastest{suffix}")
        assert isinstance(program, Program)
        np.testing.assert_allclose(program.moves[-1].end, told[-1], atol=2e-6)
    assert "corrected by diffmill" in (out / "fastest.ngc").read_text()
    assert "DEF fastest" in (out / "fastest.src").read_text()
    said = capsys.readouterr().out
    assert "fastest.src: " in said and (out / "summary.txt").read_text() in said


def test_a_corrected_program_that_cannot_be_written_is_refused_at_once(
    folder, monkeypatch, capsys
):
    asked = []
    monkeypatch.setattr(correction, "fastest_feed", lambda *a, **k: asked.append(a))
    text = f'{JOB}[output]\nformats = ["gcode"]\n'
    (folder / "job.toml").write_text(text)
    job = load_job("job.toml")
    axes = np.broadcast_to([0.6, 0.0, 0.8], job.path.positions.shape)
    tilted = eqx.tree_at(lambda j: j.path.axes, job, axes)
    monkeypatch.setattr(config, "load_job", lambda file, **options: tilted)
    command = ["feed", "job.toml", "--tolerance", "50 um"]
    assert main([*command, "--correct"]) == 2
    assert "the tool tilts" in capsys.readouterr().err and not asked


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--tolerance", "50 N"], "--tolerance: found '50 N'"),
        (["--tolerance", "0 mm"], "--tolerance: found 0 mm"),
        (["--tolerance", "1 mm", "--max-force", "-1 N"], "--max-force: found -1 N"),
        (["--max-force", "100 N"], "without --tolerance"),
        (["--max-power", "2 kW"], "--max-power: found without --tolerance"),
        (["--tolerance", "1 mm", "--max-power", "2 kN"], "a power"),
        (["--along", "9"], "--along: found without --tolerance"),
        (["--tolerance", "1 mm", "--along", "1"], "--along: found 1, but 0 or 2"),
    ],
)
def test_a_limit_that_is_none_is_refused_before_anything_runs(
    folder, capsys, options, message
):
    assert main(["feed", "job.toml", *options]) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "job-feed").exists()
