"""Run-out of a job reaches what its surface is held against the ideal one."""

import numpy as np
import pytest

import diffmill as dm
from small_job import small_job

# A wall at y = 4 mm, 0.1 mm per tooth; of two teeth only one reaches it.
PROGRAM = "G21 G17 G90 G94\nG0 X-6 Y-1 Z1\nG0 Z-1\nG1 X10 F1600\nG0 Z1\nM2\n"
RUNOUT, RADIUS, FEED = 12e-6, 5e-3, 0.2e-3


def test_the_part_is_cut_into_by_the_run_out(tmp_path):
    (tmp_path / "part.ngc").write_text(PROGRAM)
    file = tmp_path / "job.toml"
    file.write_text(small_job('diameter = "10 mm"\nteeth = 2\nrunout = "12 um"'))
    job = dm.load_job(file)
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
MODES = """
[[machine.modes]]
frequency = "500 Hz"
damping_ratio = 0.05
direction = [1, 0, 0]
stiffness = "5 N/um"
[[machine.modes]]
frequency = "550 Hz"
damping_ratio = 0.05
direction = [0, 1, 0]
stiffness = "5 N/um"
"""
CUT = "G21 G17 G90 G94\nG0 X{begin} Y-1 Z1\nG0 Z-1\nG1 X{end} F1600\nG0 Z1\nM2\n"


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "end"), [(14, -6), (-6, 14)], ids=["down", "up"])
def test_a_fast_machine_adds_the_run_out_to_its_own_deflection(tmp_path, begin, end):
    walls, tips = [], []
    for runout in (0, 10):
        cutter = f'diameter = "10 mm"\nteeth = 2\nrunout = "{runout} um"'
        text = small_job(cutter, more=MODES + "[simulation]\nstability = false\n")
        text = text.replace("[robot]\nrigid = true\n", "")
        (tmp_path / "part.ngc").write_text(CUT.format(begin=begin, end=end))
        (tmp_path / "job.toml").write_text(text)
        solution = dm.simulate(dm.load_job(tmp_path / "job.toml"))
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
