"""Run-out of a job reaches what its surface is held against the ideal one."""

import numpy as np
import pytest

import diffmill as dm
from small_job import write_job

# A wall at y = 4 mm, 0.1 mm per tooth; of two teeth only one reaches it.
PROGRAM = "G21 G17 G90 G94\nG0 X-6 Y-1 Z1\nG0 Z-1\nG1 X10 F1600\nG0 Z1\nM2\n"
RUNOUT, RADIUS, FEED = 12e-6, 5e-3, 0.2e-3


def test_the_part_is_cut_into_by_the_run_out(tmp_path):
    job = dm.load_job(write_job(tmp_path, {"cutter.runout": "12 um"}, program=PROGRAM))
    assert any("12 um" in note for note in job.notes)
    solution = dm.simulate(job)
    error = dm.workpiece.SurfaceError.of_stock(
        solution.stock, solution.rigid.stock, leaves_out_raw=True
    )
    found = error.measures()
    assert found.deepest == pytest.approx(RUNOUT, rel=0.05)
    # Between two passages of this tooth the wall stands out by the mark of its feed.
    wanted = RUNOUT - FEED**2 / (24 * RADIUS)
    assert found.wall_mean == pytest.approx(-wanted, rel=0.05)


# Softer and faster than an arm: within a tooth period it swings more than twice.
MODE = {"damping_ratio": 0.05, "stiffness": "5 N/um"}
MACHINE = {
    "robot": None,
    "machine.modes": [
        MODE | {"frequency": "500 Hz", "direction": [1, 0, 0]},
        MODE | {"frequency": "550 Hz", "direction": [0, 1, 0]},
    ],
    "simulation.stability": False,
}
CUT = "G21 G17 G90 G94\nG0 X{} Y-1 Z1\nG0 Z-1\nG1 X{} F1600\nG0 Z1\nM2\n"


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "end"), [(14, -6), (-6, 14)], ids=["down", "up"])
def test_a_fast_machine_adds_the_run_out_to_its_own_deflection(tmp_path, begin, end):
    walls, tips = [], []
    for runout in (0, 10):
        changes, program = {"cutter.runout": f"{runout} um"}, CUT.format(begin, end)
        file = write_job(tmp_path, MACHINE, changes, program=program)
        solution = dm.simulate(dm.load_job(file))
        points = np.asarray(solution.stock.ray_ends(1).points)
        is_inside = (points[:, 0] > 2e-3) & (points[:, 0] < 6e-3)
        is_wall = is_inside & (abs(points[:, 1] - 4e-3) < 0.3e-3)
        walls.append(points[is_wall, 1].mean())
        actual = np.asarray(solution.actual)
        rows = np.flatnonzero((actual[:, 0] > 2e-3) & (actual[:, 0] < 6e-3))
        # The first tooth, which stands out by all of the run-out, is at even rows.
        tips.append(actual[rows[rows % 2 == 0], 1].mean())
    # Feeds of one and of two teeth leave marks of their own.
    mark = (FEED**2 - (FEED / 2) ** 2) / (24 * RADIUS)
    wanted = 10e-6 + tips[1] - tips[0] - mark
    assert walls[1] - walls[0] == pytest.approx(wanted, abs=0.05 * 10e-6)
