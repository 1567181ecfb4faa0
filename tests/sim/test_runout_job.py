"""Run-out of a job reaches what its surface is held against the ideal one."""

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
