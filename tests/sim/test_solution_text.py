"""Jobs and solutions as text and as tables: what a notebook shows of them."""

import dataclasses
import inspect
import subprocess
import sys
from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest

import diffmill as dm
from small_job import write_job

# Rows that all cases of a correction share.
SHARED = ("time", "desired")
PROGRAM = "G21 G17 G90 G94\nG0 X-6 Y4 Z-1\nG1 X-4 F6000\nM2\n"


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    folder = tmp_path_factory.mktemp("text")
    return dm.load_job(write_job(folder, program=PROGRAM))


@pytest.fixture(scope="module")
def solution(job):
    return dm.simulate(job)


def test_a_job_is_five_lines(job):
    lines = repr(job).splitlines()
    assert len(lines) == 5
    assert lines[0].startswith(f"Job 'job': {job.path.step_count} rows in 0.")
    assert lines[1] == "  cutter: EndMill, 10 mm, 2 teeth, 8000 rpm"
    assert lines[3] == "  stock: 192.0 mm^3, rays 0.5 mm apart"
    assert lines[4] == "  machine: rigid"
    seen = []
    jax.eval_shape(lambda speed: seen.append(repr(with_speed(job, speed))), 800.0)
    assert seen == ["Job('job', traced, stacked or without values)"]
    assert repr(eqx.filter(job, lambda _: False)) == seen[0]


def test_a_notebook_shows_a_table_in_which_names_are_escaped(job):
    named = job.replace(name="<b>slot</b>")
    html = named._repr_html_()
    assert html.startswith("<table>") and html.count("<tr>") == 5
    assert "&lt;b&gt;slot" in html and "<b>" not in html
    assert ">cutter</td>" in html and ">EndMill, 10 mm, 2 teeth, 8000 rpm</td>" in html


def test_a_job_is_replaced_by_attributes_that_it_has(job):
    settings = dm.CorrectionSettings(max_offset=2e-3)
    changed = job.replace(correction=settings, notes=())
    assert changed.correction is settings and changed.notes == ()
    assert changed.path is job.path and job.correction is not settings
    with pytest.raises(
        ValueError, match=r"attributes of a job \(name, .*but found nam"
    ):
        job.replace(nam="x")


@pytest.mark.parametrize("run", [dm.simulate, dm.correct])
def test_a_path_without_a_row_per_tooth_is_refused(job, run):
    words = r"per tooth period, 3.75 ms .* rows .* are 7.5 ms apart"
    path = job.path
    twice = eqx.tree_at(lambda path: path.time, path, 2 * np.asarray(path.time))
    with pytest.raises(ValueError, match=words):
        run(job.replace(path=twice))


@pytest.mark.parametrize("name", ["simulate", "correct"])
def test_what_is_no_job_is_refused(name):
    """In a process of its own: here types are checked before."""
    code = f"import diffmill as dm; dm.{name}('job.toml')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    words = "TypeError: Argument `job` must be a Job, as `load_job` returns it, but is"
    assert ended.stderr.endswith(f"{words} 'job.toml'.\n")


def with_speed(job, speed):
    return eqx.tree_at(lambda j: j.spindle_speed, job, speed)


def test_help_shows_a_signature_that_can_be_read():
    for function in (dm.simulate, dm.correct):
        text = str(inspect.signature(function))
        assert "diffmill." not in text and "jaxtyping." not in text
        assert "job: Job" in text
        # What checks types by annotations still finds them.
        assert function.__annotations__["job"] is dm.Job


@pytest.mark.slow
def test_a_solution_is_five_lines(solution):
    lines = repr(solution).splitlines()
    assert len(lines) == 5
    assert lines[0].startswith(f"Solution of {len(solution.time)} rows")
    assert "contour error 0.00 um rms" in lines[1]
    assert lines[4] == "  outcome: successful"


@pytest.mark.slow
def test_time_is_a_coordinate_and_a_table_has_a_row_per_tooth_period(solution):
    dataset = solution.to_dataset()
    assert dataset.time.dims == ("step",) and "time" in dataset.coords
    rows = len(solution.time)
    of_rows = dataset[["contour_error", "removed_volume"]].to_dataframe()
    assert len(of_rows) == rows and "time" in of_rows
    table = solution.to_dataframe()
    assert len(table) == rows
    np.testing.assert_array_equal(table.force_y, solution.force[:, 1])
    np.testing.assert_array_equal(table.time, solution.time)


def test_every_row_of_a_run_may_differ_from_case_to_case_of_a_correction(solution):
    """Rows that a case has of its own are not taken from another one."""
    before, names = solution, [field.name for field in dataclasses.fields(solution)]
    rows = [name for name in names if is_row(solution, name)]
    changes = {name: getattr(before, name) + 1 for name in rows}
    assert {"force", "spindle_torque", "contour_error"} <= set(changes)
    after = dataclasses.replace(before, **changes)
    cases = {"uncorrected": before, "corrected": after}
    data = correction_of(cases).to_dataset({})
    for name, solution in cases.items():
        for key, wanted in solution.to_dataset().items():
            found = data[key].sel(case=name) if "case" in data[key].dims else data[key]
            np.testing.assert_array_equal(found, wanted, err_msg=str(key))


def is_row(solution, name):
    """True if rows of numbers, one a tooth period, belong to a case."""
    values = getattr(solution, name)
    is_long = getattr(values, "shape", ())[:1] == solution.time.shape
    return name not in SHARED and is_long and values.dtype.kind == "f"


def correction_of(cases):
    """Return a correction with some cases, of which no method is known."""
    before = cases["uncorrected"]
    method = SimpleNamespace(
        contour=np.ones(before.desired.shape),
        forward_runs=1,
        linearisations=0,
        detail={},
        history=(),
        result=before.result,
    )
    parts = np.where(np.asarray(before.is_cutting), 0, -1)
    values = {
        "cases": cases,
        "methods": dict.fromkeys(cases, method),
        "wall_time": dict.fromkeys(cases, 1.0),
        "path_parts": dm.correction.PathParts(parts),
        "chosen": "corrected",
    }
    # Without the checks of its fields: the methods are none.
    correction = object.__new__(dm.correction.Correction)
    for name, value in values.items():
        object.__setattr__(correction, name, value)
    return correction
