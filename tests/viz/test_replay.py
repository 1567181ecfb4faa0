"""Figures show the process that was simulated: poses, sizes and laws are the run's."""

import numpy as np
import pytest

import diffmill as dm
from diffmill.viz import figure_inputs, write_figures

JOB = """
[cutter]
{cutter}
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
K_te = "3.0 N/mm"
K_re = "15.4 N/mm"
{force}
[stock]
lower = ["0 mm", "-5 mm", "-3 mm"]
upper = ["10 mm", "5 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "path.csv"
[robot]
{robot}
[simulation]
{simulation}
"""
FLAT = 'kind = "flat"\ndiameter = "6 mm"\nteeth = 2'
UNEVEN = FLAT + '\nrunout = "20 um"\npitch = ["170 deg", "190 deg"]'
BALL = 'kind = "ball"\ndiameter = "6 mm"\nteeth = 2'
BOTTOM = """[force.bottom]
K_tc = "3000 N/mm^2"
K_rc = "2000 N/mm^2"
K_ac = "100 N/mm^2"
"""
SLOW = pytest.mark.slow
STEPS, DEPTH, FEED = 48, 0.8, 0.2
PERIOD = 60 / 8000 / 2


def solved(folder, *, lean=0.0, ramp=0.0, z=-DEPTH, robot="rigid = true", **tables):
    """Return a job along +x, its axis leaning about x, and its solution."""
    texts = {"cutter": FLAT, "force": "", "simulation": ""} | tables
    x = -3.5 + FEED * np.arange(STEPS)
    z = z - ramp * (x - x[0])
    lines = ["time_s,x_mm,y_mm,z_mm,i,j,k"] + [
        f"{k * PERIOD:.9f},{x[k]:.6f},0,{z[k]:.6f},0,{np.sin(lean):.12f},"
        f"{np.cos(lean):.12f}"
        for k in range(STEPS)
    ]
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    (folder / "job.toml").write_text(JOB.format(robot=robot, **texts))
    job = dm.load_job(folder / "job.toml")
    return job, dm.simulate(job)


def tooth_means(record):
    """Return the mean of a record of forces over each tooth period."""
    count = round(record.tooth_period * record.sample_rate)
    return record.force.reshape(-1, count, 3).mean(axis=1)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"cutter": BALL, "lean": 0.4}, marks=SLOW),
        pytest.param(
            {"ramp": 0.1, "force": BOTTOM, "simulation": "bottom_edges = true"},
            marks=SLOW,
        ),
        {"cutter": UNEVEN},
    ],
    ids=["leaning", "bottom", "runout"],
)
def test_replayed_forces_are_those_of_the_run(tmp_path, options):
    job, solution = solved(tmp_path, **options)
    record = figure_inputs(job, {"predicted": solution})["forces"]
    force = np.asarray(solution.force)[1:]
    assert np.abs(force).max() > 10.0
    np.testing.assert_allclose(tooth_means(record), force, atol=1e-9 * force.max())


def test_the_surface_that_is_mapped_is_that_of_the_chosen_case(tmp_path):
    job, solution = solved(tmp_path, cutter=UNEVEN)
    cases = {name: solution for name in ("uncorrected", "mirror", "corrected")}
    mapped = figure_inputs(job, cases, chosen="mirror")["surfaces"]
    assert tuple(mapped) == ("uncorrected", "mirror")
    again = figure_inputs(job, cases, mapped | {"corrected": mapped["mirror"]})
    assert tuple(again["surfaces"]) == ("uncorrected", "corrected")


def test_a_program_that_cuts_nothing_has_no_surface(tmp_path):
    job, solution = solved(tmp_path, cutter=UNEVEN, z=1.0)
    inputs = figure_inputs(job, {"predicted": solution})
    assert inputs["surfaces"] == {}
    figures = write_figures(tmp_path, solution.to_dataset(), **inputs)
    assert figures["surface"].path is None
    assert figures["surface"].skipped.startswith("nothing was cut")
