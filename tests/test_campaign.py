"""Campaigns: what varies, what is kept, and that nothing is lost or done twice."""

import contextlib
import importlib.util
import math
import pathlib
import sys
import textwrap
import types
from typing import Any

import numpy as np
import pytest
import xarray

from diffmill import JobError, load_job, sim, simulate
from diffmill.campaign import run_campaign
from diffmill.cli import main
from diffmill.config import load_campaign
from diffmill.examples import copy_example
from small_job import CUTS, small_job

# No such program: the job is refused without compiling anything.
REFUSED = """
job = "job.toml"
[[sweep]]
key = "program.file"
values = ["none.ngc", "neither.ngc"]
"""


@pytest.fixture
def folder(here):
    text = small_job('diameter = "10 mm"\nteeth = 2')
    (here / "job.toml").write_text(text)
    (here / "part.ngc").write_text(CUTS)
    return here


def plan(text, folder):
    (folder / "c.toml").write_text(textwrap.dedent(text))
    return load_campaign(folder / "c.toml")


def drawn(key, count, folder, **table) -> list[Any]:
    told = "".join(f"{k} = {v!r}\n" for k, v in {"key": key, **table}.items())
    text = f'job = "job.toml"\ndraws = {count}\nseed = 3\n[[draw]]\n{told}'
    return [change[key] for change in plan(text, folder).changes()]


def numbers(values):
    return np.array([float(value.split()[0]) for value in values])


def test_a_job_is_every_combination(folder):
    campaign = plan(
        """
        job = "job.toml"
        command = "correct"
        draws = 3
        sweep = [
            { key = "spindle.speed", values = ["7000 rpm", "8000 rpm"] },
            { key = "stock.spacing", values = ["0.5 mm", "0.4 mm"] },
        ]
        starts = { count = 2, spread = "20 um" }
        [[draw]]
        key = "force.K_tc"
        relative = 0.1
        """,
        folder,
    )
    names = [variation.name for variation in campaign.variations]
    assert names == ["spindle_speed", "stock_spacing", "draw", "start"]
    changes = list(campaign.changes())
    assert len(changes) == math.prod(campaign.shape) == 24
    assert len({str(change) for change in changes}) == 24
    # The same draws at every point of the grid; the first start is the job's own.
    assert changes[0]["force.K_tc"] == changes[12]["force.K_tc"]
    assert changes[0]["correction.start_spread"] == "0.0 m"
    spread = float(str(changes[1]["correction.start_spread"]).split()[0])
    assert spread == pytest.approx(20e-6)


def test_values_have_the_distribution_asked_for(folder):
    count = 300
    sigma = 3.5 / math.sqrt(count)
    normal = numbers(drawn("force.K_tc", count, folder, relative=0.1)) / 989.8
    assert abs(normal.mean() - 1) < 0.1 * sigma
    assert normal.std() == pytest.approx(0.1, rel=sigma / math.sqrt(2))
    table = {"kind": "uniform", "lower": "6 krpm", "upper": "9000 rpm"}
    uniform = numbers(drawn("spindle.speed", count, folder, **table)) * 30 / np.pi
    assert uniform.min() >= 6000 and uniform.max() <= 9000
    assert uniform.mean() == pytest.approx(7500, abs=3000 / math.sqrt(12) * sigma)
    assert uniform.std() == pytest.approx(3000 / math.sqrt(12), rel=sigma)
    skewed = drawn("force.K_rc", count, folder, kind="lognormal", relative=0.3)
    log = np.log(numbers(skewed) / 337.3)
    assert log.mean() == pytest.approx(0, abs=0.3 * sigma)
    assert log.std() == pytest.approx(0.3, rel=sigma / math.sqrt(2))


def test_factors_scale_what_the_job_holds(folder):
    campaign = plan(
        """
        job = "job.toml"
        [[sweep]]
        key = "stock.upper"
        factors = [0.5, 1, 2]
        [[sweep]]
        key = "cutter.diameter"
        factors = [1.2]
        [[sweep]]
        key = "force"
        factors = [2]
        """,
        folder,
    )
    factors = [variation.factors for variation in campaign.variations]
    assert factors == [(0.5, 1, 2), (), (2,)]
    held = numbers(load_campaign(folder / "c.toml").tables["stock"]["upper"])
    for change, factor in zip(campaign.changes(), (0.5, 1, 2), strict=True):
        upper = change["stock.upper"]
        assert isinstance(upper, list) and upper[0].endswith(" mm")
        assert numbers(upper) == pytest.approx(factor * held)
        assert change["cutter.diameter"] == "12 mm"
        force = load_campaign(folder / "c.toml").tables["force"]
        doubled = change["force"]
        assert isinstance(doubled, dict) and doubled.keys() == force.keys()
        assert numbers([doubled["K_tc"]]) == pytest.approx(2 * numbers([force["K_tc"]]))


def test_factors_of_counts_are_counts(folder):
    text = """
        job = "job.toml"
        [[sweep]]
        key = "cutter.teeth"
        factors = [1, 1.5, 2]
        """
    teeth = [change["cutter.teeth"] for change in plan(text, folder).changes()]
    assert teeth == [2, 3, 4]
    with pytest.raises(JobError, match="whole number"):
        plan(text.replace("1.5", "1.2"), folder)


@pytest.mark.parametrize("table", ["force", "force.bottom"])
def test_a_scaled_law_keeps_the_thicknesses_that_it_refers_to(folder, table):
    law = """law = "kienzle"
K_tc11 = "1500 N/mm^2"
K_rc11 = ["500 N/mm^2", "600 N/mm^2"]
K_ac11 = "0 N/mm^2"
K_te = "3 N/mm"
m_t = [0.25, 0.3]
reference_thickness = "1 mm"
least_thickness = "2 um"
"""
    file = folder / "job.toml"
    text = file.read_text()
    a, b = text.index("K_tc"), text.index("[stock]")
    side = text[a:b] if table == "force.bottom" else ""
    bottom = "[force.bottom]\n" if side else ""
    file.write_text(f"{text[:a]}{side}{bottom}{law}{text[b:]}")
    for key in {"force", table}:
        sweep = f'[[sweep]]\nkey = "{key}"\nfactors = [1, 2]\n'
        campaign = plan(f'job = "job.toml"\n{sweep}', folder)
        found: list[Any] = [change[key] for change in campaign.changes()]
        once, twice = found
        if key != table:
            once, twice = once["bottom"], twice["bottom"]
        assert numbers([twice["K_tc11"], *twice["K_rc11"], twice["K_te"]]) == (
            pytest.approx(np.array([3000, 1000, 1200, 6]))
        )
        kept = ("law", "m_t", "reference_thickness", "least_thickness")
        assert all(once[name] == twice[name] for name in kept)


def test_the_coordinate_of_a_scaled_list_are_its_factors(folder):
    text = REFUSED.replace('"none.ngc", ', "")
    text += '[[sweep]]\nkey = "stock.upper"\nfactors = [0.5, 2]\n'
    campaign = plan(text, folder)
    dataset = run_campaign(campaign, "out", workers=0)
    np.testing.assert_array_equal(dataset.stock_upper, [0.5, 2])
    values = dataset.stock_upper_values.values
    np.testing.assert_allclose(values[1], 4 * values[0])


def test_more_draws_leave_the_earlier_ones(folder):
    few = drawn("stock.upper", 3, folder, relative=0.1)
    many = drawn("stock.upper", 5, folder, relative=0.1)
    assert many[:3] == few
    # Each entry of a list on its own.
    x, y, _ = few[0]
    assert x != y


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('job = "none.toml"', ("none.toml", "no such file")),
        ("speed = 1", ("speed", "sweep", "draws")),
        ('sweep = [{key = "spindle.sped", values = [1]}]', ("sped", "speed")),
        (
            'sweep = [{key = "spindle.speed", values = ["1 m"]}]',
            ("'1 m'", "rotational speed"),
        ),
        ('sweep = [{key = "stock.upper.4", values = ["1 m"]}]', ("'4'", "1 to 3")),
        (
            'sweep = [{key = "stock.upper", values = [1]},'
            '{key = "stock.upper.1", values = ["1 m"]}]',
            ("stock.upper", "once"),
        ),
        ('sweep = [{key = "spindle.speed"}]', ("spindle.speed", "values", "factors")),
        (
            'sweep = [{key = "cutter.runout", factors = [2]}]',
            ("cutter.runout", "no value"),
        ),
        (
            'sweep = [{key = "program.file", factors = [2]}]',
            ("program.file", "part.ngc"),
        ),
        ('sweep = [{key = "spindle.speed", factors = [-2]}]', ("factors", "-2")),
        ("draws = 3", ("draws", "[[draw]]")),
        (
            'draws = 1\ndraw = [{key = "cutter.runout", relative = 0.1}]',
            ("cutter.runout", "no value"),
        ),
        ('draws = 1\ndraw = [{key = "force.K_tc", mean = 1.0}]', ("mean", "deviation")),
        ('starts = {count = 2, spread = "1 um"}', ("starts", "correct")),
    ],
)
def test_a_faulty_campaign_is_refused_at_once(folder, capsys, text, words):
    job = "" if text.startswith("job") else 'job = "job.toml"\n'
    (folder / "c.toml").write_text(job + text)
    assert main(["campaign", "c.toml"]) == 2
    error = capsys.readouterr().err
    assert all(word in error for word in words), error
    assert not (folder / "c-campaign").exists()


def test_a_speed_that_is_asked_for_counts_before_that_of_the_program(tmp_path):
    file = copy_example("tiny", tmp_path)
    assert "S8000" in file.with_suffix(".ngc").read_text()
    job = load_job(file, changes={"spindle.speed": "6000 rpm"})
    assert job.tooth_period == pytest.approx(5e-3)
    file.write_text(file.read_text().replace("8000 rpm", "6000 rpm"))
    with pytest.raises(JobError, match="S8000"):
        load_job(file)


def test_a_job_with_changes_is_that_of_a_changed_file(folder):
    file = folder / "job.toml"
    changes = {"spindle.speed": "6000 rpm", "stock.upper.2": "9 mm"}
    job = load_job(file, changes={**changes, "simulation.stability": False})
    text = file.read_text().replace("8000 rpm", "6000 rpm")
    file.write_text(text.replace('upper = ["8 mm", "8 mm"', 'upper = ["8 mm", "9 mm"'))
    other = load_job(file)
    assert job.spindle_speed == other.spindle_speed
    assert job.stock.volume() == other.stock.volume()
    np.testing.assert_array_equal(job.path.positions, other.path.positions)
    assert 'spindle.speed = "6000 rpm"' in job.source
    with pytest.raises(JobError, match=r"stock\.upper\.7"):
        load_job(file, changes={"stock.upper.7": "9 mm"})


def test_a_refused_job_is_kept_with_its_message(folder):
    campaign, told = plan(REFUSED, folder), []
    run = lambda **more: run_campaign(
        campaign, "out", workers=0, on_progress=lambda *s: told.append(s), **more
    )
    dataset = run()
    assert dataset.status.attrs["flag_meanings"].split()[2] == "refused"
    assert dataset.status.values.tolist() == [2, 2]
    message = dataset.message.sel(program_file="neither.ngc").item()
    assert "neither.ngc" in message and "no such file" in message
    assert dataset.attrs["incomplete"] == 1
    # Again: nothing runs, but for a retry.
    assert [done for done, _, _ in told] == [0, 1, 2]
    told.clear()
    xarray.testing.assert_identical(run(), dataset)
    assert told == [(2, 2, "kept")]
    run(retry=True)
    assert len(told) == 4
    kept = xarray.load_dataset("out/result.nc")
    np.testing.assert_array_equal(kept.message, dataset.message)


def test_a_changed_file_makes_another_job(folder):
    campaign = plan(REFUSED.replace('"none.ngc", ', ""), folder)
    run_campaign(campaign, "out", workers=0)
    (folder / "neither.ngc").write_text("G1 X1\n")
    message = run_campaign(campaign, "out", workers=0).message.item()
    assert "no such file" not in message


@pytest.mark.parametrize(
    ("program", "beside"),
    [
        ("part.ngc", "O1234.nc"),
        ("part.ngc", "hole.ngc"),
        ("part.src", "part.dat"),
        ("part.src", "SIDE.src"),
        ("part.src", "side.DAT"),
        ("part.mod", "tools.sys"),
        ("part.mod", "other.mod"),
    ],
)
def test_a_changed_file_beside_the_program_makes_another_job(folder, program, beside):
    (folder / program).write_text("nothing\n")
    part = folder / beside
    text = REFUSED.replace('"none.ngc", "neither.ngc"', f'"{program}"')
    campaign, counts = plan(text, folder), []
    for content in ("one", "two", "two"):
        part.write_text(content)
        run_campaign(campaign, "out", workers=0)
        counts.append(len(list((folder / "out" / "jobs").iterdir())))
    assert counts == [1, 2, 2]
    # What no reader opens counts for nothing: other files, links out of the folder.
    (folder / "notes.txt").write_text("three")
    (folder / "path.csv").write_text("three")
    (folder / "far").mkdir()
    (folder / "far" / "far.ngc").write_text("three")
    (folder / "link.ngc").symlink_to(folder / "far" / "far.ngc")
    run_campaign(campaign, "out", workers=0)
    assert len(list((folder / "out" / "jobs").iterdir())) == 2


def test_sizes_and_times_stand_for_programs_too_large_to_hash(folder):
    text = REFUSED.replace('"none.ngc", "neither.ngc"', '"neither.src"')
    campaign, large = plan(text, folder), folder / "large.src"
    for size, count in ((2_000_000_000, 1), (2_000_000_000, 1), (2_000_000_001, 2)):
        if not large.exists() or large.stat().st_size != size:
            with large.open("wb") as file:
                file.truncate(size)
        run_campaign(campaign, "out", workers=0)
        assert len(list((folder / "out" / "jobs").iterdir())) == count


class StandInFuture:
    """A future of a stand-in for Dask, whose task has not run."""

    def __init__(self, run, task):
        self.run, self.task, self.status = run, task, "pending"

    def result(self):
        return self.run(self.task)

    def exception(self):
        return KeyError("of the worker")


@pytest.mark.parametrize("first", ["finished", "error"])
def test_the_first_job_compiles_before_the_others_start(folder, monkeypatch, first):
    order = []

    class StandInClient(contextlib.nullcontext):
        def submit(self, run, task, **options):
            order.append("start")
            return StandInFuture(run, task)

        def __enter__(self):
            return self

    def as_completed(futures):
        for future in futures:
            future.status = first if order == ["start"] else "finished"
            order.append("end")
            yield future

    dask = types.ModuleType("distributed")
    dask.__dict__.update(Client=StandInClient, as_completed=as_completed)
    dask.__dict__.update(LocalCluster=lambda **options: contextlib.nullcontext())
    monkeypatch.setitem(sys.modules, "distributed", dask)
    text = REFUSED.replace('"neither.ngc"', '"neither.ngc", "no.ngc"')
    dataset = run_campaign(plan(text, folder), "out", workers=2)
    assert order == ["start", "end", "start", "start", "end", "end"]
    refused, lost = 2, 3
    assert dataset.status.values.tolist() == [
        lost if first == "error" else refused,
        refused,
        refused,
    ]


def test_a_folder_of_something_else_is_left_alone(folder, capsys):
    (folder / "c.toml").write_text(REFUSED)
    (folder / "out").mkdir()
    (folder / "out" / "thesis.tex").touch()
    assert main(["campaign", "c.toml", "--out", "out"]) == 2
    assert "not empty" in capsys.readouterr().err
    assert main(["campaign", "c.toml", "--workers", "-1"]) == 2


@pytest.mark.parametrize("error", [OSError(28, "No space left"), MemoryError()])
def test_what_a_full_disk_ended_is_computed_again(folder, monkeypatch, error):
    def fails(job):
        raise error

    campaign, told = plan(REFUSED.replace("neither", "part"), folder), []
    run = lambda: run_campaign(
        campaign, "out", workers=0, on_progress=lambda *seen: told.append(seen[2])
    )
    monkeypatch.setattr(sim, "simulate", fails)
    run()
    assert sorted(told) == ["kept", "lost", "refused"]
    # The next one does not take it for an answer.
    told.clear()
    run()
    assert told == ["kept", "lost"]


def test_without_dask_the_jobs_run_one_after_the_other(folder, capsys, monkeypatch):
    (folder / "c.toml").write_text(REFUSED)
    found = importlib.util.find_spec
    none = lambda name: None if name == "distributed" else found(name)
    monkeypatch.setattr(importlib.util, "find_spec", none)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["campaign", "c.toml"]) == 1
    told = capsys.readouterr().err
    assert "Dask" in told and "2 jobs" in told


@pytest.mark.slow
def test_a_sweep_that_changes_nothing_is_said(folder, capsys):
    """The program has a feed of its own."""
    values = 'job = "job.toml"\n[[sweep]]\nkey = "program.feed"\nvalues = '
    (folder / "c.toml").write_text(f'{values}["40 mm/s", "50 mm/s"]\n')
    assert main(["campaign", "c.toml", "--workers", "0"]) == 0
    assert "program_feed changes nothing" in capsys.readouterr().out


def kill_a_worker(ones_before):
    """Kill one worker process with SIGKILL; return whether there was one."""
    import psutil

    children = psutil.Process().children(recursive=True)
    found = [p for p in children if "spawn_main" in " ".join(p.cmdline())]
    if found:
        found[ones_before % len(found)].kill()
    return bool(found)


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_nothing_runs_twice(folder):
    pytest.importorskip("distributed")
    text = """
        job = "job.toml"
        draws = 20
        sweep = [{ key = "program.feed", values = ["40 mm/s", "50 mm/s"] }]
        draw = [{ key = "force.K_tc", relative = 0.1 }]
        """
    (folder / "part.ngc").write_text(CUTS.replace(" F3000", ""))
    campaign, told = plan(text, folder), []
    killed = []

    def tell(done, count, status):
        told.append(done)
        if done in (10, 25):
            killed.append(kill_a_worker(len(killed)))

    dataset = run_campaign(campaign, "out", workers=2, on_progress=tell)
    assert killed == [True, True]
    assert told == list(range(41))
    assert (dataset.status == 0).all() and dataset.sizes["draw"] == 20
    assert len(list((folder / "out/jobs").glob("*.json"))) == 40
    # A job of it is what it would be alone; the force follows its coefficient.
    changes = list(campaign.changes())[7]
    alone = simulate(load_job("job.toml", changes=changes)).to_dataset()
    found = dataset.isel(program_feed=0, draw=7)
    force = np.linalg.norm(alone.force, axis=1).max()
    assert found.force_max.item() == pytest.approx(force, rel=1e-9)
    assert np.corrcoef(dataset.force_K_tc, dataset.force_max[0])[0, 1] > 0.9
    # The same again, then with four draws more.
    files = {p: p.stat().st_mtime_ns for p in pathlib.Path("out/jobs").iterdir()}
    told.clear()
    xarray.testing.assert_identical(
        run_campaign(campaign, "out", on_progress=tell), dataset
    )
    assert told == [40]
    more = plan(text.replace("draws = 20", "draws = 22"), folder)
    told.clear()
    run_campaign(more, "out", workers=1, on_progress=tell)
    assert told == [40, 41, 42, 43, 44]
    assert all(p.stat().st_mtime_ns == time for p, time in files.items())
