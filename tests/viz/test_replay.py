"""Figures show the process that was simulated: poses, sizes and laws are the run's."""

import html
import json
import re

import numpy as np
import pytest

import diffmill as dm
from diffmill.viz import figure_inputs, show, write_figures
from small_job import write_job

JOB = {
    "force.K_te": "3.0 N/mm",
    "force.K_re": "15.4 N/mm",
    "stock.lower": ["0 mm", "-5 mm", "-3 mm"],
    "stock.upper": ["10 mm", "5 mm", "0 mm"],
    "program.file": "path.csv",
    "cutter.diameter": "6 mm",
}
UNEVEN = {"cutter.runout": "20 um", "cutter.pitch": ["170 deg", "190 deg"]}
BALL = {"cutter.kind": "ball"}
BOTTOM = {
    "force.bottom": {"K_tc": "3 GPa", "K_rc": "2 GPa", "K_ac": "100 N/mm^2"},
    "simulation.bottom_edges": True,
}
SLOW = pytest.mark.slow
STEPS, DEPTH, FEED = 48, 0.8, 0.2
PERIOD = 60 / 8000 / 2


def solved(folder, changes, *, lean=0.0, ramp=0.0, z=-DEPTH):
    """Return a job along +x, its axis leaning about x, and its solution."""
    x = -3.5 + FEED * np.arange(STEPS)
    z = z - ramp * (x - x[0])
    lines = ["time_s,x_mm,y_mm,z_mm,i,j,k"] + [
        f"{k * PERIOD:.9f},{x[k]:.6f},0,{z[k]:.6f},0,{np.sin(lean):.12f},"
        f"{np.cos(lean):.12f}"
        for k in range(STEPS)
    ]
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    job = dm.load_job(write_job(folder, JOB, changes))
    return job, dm.simulate(job)


def tooth_means(record):
    """Return the mean of a record of forces over each tooth period."""
    count = round(record.tooth_period * record.sample_rate)
    return record.force.reshape(-1, count, 3).mean(axis=1)


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        pytest.param(BALL, {"lean": 0.4}, marks=SLOW),
        pytest.param(BOTTOM, {"ramp": 0.1}, marks=SLOW),
        (UNEVEN, {}),
    ],
    ids=["leaning", "bottom", "runout"],
)
def test_replayed_forces_are_those_of_the_run(tmp_path, changes, options):
    job, solution = solved(tmp_path, changes, **options)
    record = figure_inputs(job, {"predicted": solution})["forces"]
    assert record is not None and record.force_range is not None
    window, force = record.window, np.asarray(solution.force)
    assert window is not None
    rows = np.unique(np.ceil(window.time / PERIOD).astype(int))
    assert len(rows) == 6 and np.abs(force[rows]).max() > 10.0
    atol = 1e-9 * np.abs(force).max()
    np.testing.assert_allclose(tooth_means(window), force[rows], atol=atol)
    np.testing.assert_allclose(record.force, force, atol=atol)
    samples = window.force.reshape(6, -1, 3)
    extremes = np.stack([samples.min(axis=1), samples.max(axis=1)], axis=1)
    np.testing.assert_allclose(record.force_range[rows], extremes, atol=atol)


def test_the_surface_that_is_mapped_is_that_of_the_chosen_case(tmp_path):
    job, solution = solved(tmp_path, UNEVEN)
    cases = {name: solution for name in ("uncorrected", "mirror", "corrected")}
    mapped = figure_inputs(job, cases, chosen="mirror")["surfaces"]
    assert tuple(mapped) == ("uncorrected", "mirror")
    again = figure_inputs(job, cases, mapped | {"corrected": mapped["mirror"]})
    assert tuple(again["surfaces"]) == ("uncorrected", "corrected")


def test_a_notebook_shows_the_view_of_the_report(tmp_path):
    job, solution = solved(tmp_path, UNEVEN)
    surfaces = figure_inputs(job, {"predicted": solution})["surfaces"]
    shown = show(solution, job, surfaces=surfaces)._repr_html_()
    # A frame holds the page as an attribute: nothing of it is left unescaped.
    page = re.fullmatch(r'<iframe [^>]*srcdoc="([^"]*)" [^>]*></iframe>', shown)
    assert page is not None and 'sandbox="allow-scripts"' in shown
    text = html.unescape(page[1])
    data = json.loads(text.split('id="run-data">')[1].split("</script>")[0])
    assert data["rows"] == STEPS and data["cases"][0]["cloud"] is not None
    assert "<b>No tolerance stated.</b> Largest contour error" in text


def test_a_program_that_cuts_nothing_has_no_surface(tmp_path):
    job, solution = solved(tmp_path, UNEVEN, z=1.0)
    inputs = figure_inputs(job, {"predicted": solution})
    assert inputs["surfaces"] == {}
    figures = write_figures(tmp_path, solution.to_dataset(), **inputs)
    assert figures["surface"].path is None
    assert figures["surface"].skipped.startswith("nothing was cut")
