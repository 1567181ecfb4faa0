"""The end of the cutter in a job: whether it cuts, and what is said if not."""

import re

import numpy as np
import pytest

import diffmill as dm
from small_job import write_job

JOB = {
    "cutter.diameter": "6 mm",
    "force.K_tc": "900 N/mm^2",
    "force.K_rc": "300 N/mm^2",
    "force.K_ac": "0 N/mm^2",
    "force.K_te": "3 N/mm",
    "force.K_re": "15 N/mm",
    "force.K_ae": "0 N/mm",
    "stock.lower": ["0 mm", "0 mm", "-2 mm"],
    "stock.upper": ["16 mm", "8 mm", "0 mm"],
    "stock.spacing": "0.25 mm",
    "simulation.stability": False,
}
RIGID = {}
# 1 um per 2 N along z.
MODE = {"frequency": "20 Hz", "damping_ratio": 0.05, "direction": [0, 0, 1]}
MODES = {"robot": None, "machine.modes": [MODE | {"stiffness": "2 N/um"}]}
# Down by 0.6 mm over 8 mm, and back on the level.
RAMP = "G21 G90 G94\nG0 X4 Y4 Z1\nG1 Z0 F3000\nG1 X12 Z-0.6\nG1 X4\nM2\n"
LEVEL = "G21 G90 G94\nG0 X-4 Y4 Z1\nG0 Z-0.6\nG1 X12 F3000\nM2\n"


@pytest.fixture
def load(tmp_path):
    """Return the job of a machine with other changes."""
    return lambda machine, *changes, program=RAMP: dm.load_job(
        write_job(tmp_path, JOB, machine, *changes, program=program)
    )


def alone(job):
    """Return the run of the process alone on the path of a job."""
    tips, speed = np.asarray(job.path.positions), job.spindle_speed
    return dm.sim.simulate_process(tips, job.stock, job.cutter, job.law, speed)


def about_the_end(job):
    return [note for note in job.notes if "bottom_edges" in note]


@pytest.mark.parametrize("dish", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_the_force_of_an_end_that_is_left_out_is_told(load, dish):
    cutter = {"cutter.dish_angle": f"{dish} deg"}
    job = load(MODES, cutter, {"simulation.bottom_edges": False})
    (note,) = about_the_end(job)
    told = [float(x) for x in re.findall(r"([\d.]+) (?:N|um)\b", note)]
    force = np.asarray(alone(job).force)[:, 2]
    largest, mean = force.max(), force[force > 0.1 * force.max()].mean()
    np.testing.assert_allclose(told[:2], [largest, mean], rtol=0.06)
    np.testing.assert_allclose(told[2:], np.array(told[:2]) / 2, rtol=0.01)


def test_an_end_that_does_not_descend_is_not_told_of(load):
    assert not about_the_end(load(MODES, program=LEVEL))


HOLLOW = {"cutter.dish_angle": "2 deg"}


@pytest.mark.parametrize(
    ("machine", "changes", "has_bottom"),
    [
        (RIGID, {}, True),
        (MODES, {}, False),
        (MODES, HOLLOW, True),
        (MODES, HOLLOW | {"simulation.bottom_edges": False}, False),
        (MODES, {"simulation.bottom_edges": True}, True),
        (MODES, HOLLOW | {"cutter.runout": "5 um"}, False),
    ],
)
def test_whether_the_end_cuts_if_it_is_left_open(load, machine, changes, has_bottom):
    job = load(machine, changes)
    assert job.simulation.has_bottom == has_bottom
    assert bool(about_the_end(job)) != has_bottom
    # What is assumed of an end that cuts: its coefficients, and how flat it is.
    assert any("[force.bottom]" in note for note in job.notes) == has_bottom
    is_pressed = has_bottom and machine == MODES and "cutter.dish_angle" not in changes
    assert any("dish_angle is 0" in note for note in job.notes) == is_pressed


@pytest.mark.parametrize(
    ("machine", "stability", "is_told"),
    [(MODES, "quick", True), (MODES, False, False), (RIGID, "quick", False)],
)
def test_chatter_of_the_end_is_not_judged_which_is_told(
    load, machine, stability, is_told
):
    changes = HOLLOW | {"simulation.stability": stability}
    job = load(machine, changes)
    assert any("the end of the cutter chatters" in x for x in job.notes) == is_told
    level = load(machine, changes, program=LEVEL)
    assert not any("the end of the cutter chatters" in x for x in level.notes)


@pytest.mark.slow
def test_a_rigid_job_cuts_as_the_process_alone(load):
    job = load(RIGID)
    force, wanted = (np.asarray(x.force) for x in (dm.simulate(job), alone(job)))
    assert wanted[:, 2].max() > 50
    np.testing.assert_allclose(force, wanted, rtol=1e-6, atol=1e-6)
