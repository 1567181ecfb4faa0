"""Jobs whose tool leans: by the program, or because the arm bends."""

import numpy as np
import pytest

import diffmill as dm
from small_job import ARM, write_job

JOB = {
    "cutter": {"kind": "ball", "diameter": "6 mm", "teeth": 2},
    "stock.lower": ["0 mm", "-6 mm", "-3 mm"],
    "stock.upper": ["12 mm", "6 mm", "0 mm"],
    "stock.spacing": "0.3 mm",
    "program.file": "path.csv",
}
REIS = {"robot": ARM, "robot.work_in_base.position": ["1514 mm", "-8.5 mm", "936 mm"]}


def load(folder, lean, *changes):
    """Return a job that crosses a block with a leaning ball, 0.5 mm deep."""
    rows = 60
    x = np.linspace(-4.0, 5.0, rows)
    z = 3 - 3 * np.cos(lean) - 0.5
    y = -3 * np.sin(lean)
    lines = ["time_s,x_mm,y_mm,z_mm,i,j,k"] + [
        f"{k * 3.75e-3:.5f},{x[k]:.6f},{y:.9f},{z:.9f},0,{np.sin(lean):.12f},"
        f"{np.cos(lean):.12f}"
        for k in range(rows)
    ]
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    return dm.load_job(write_job(folder, JOB, *changes))


@pytest.mark.slow
def test_a_leaning_ball_takes_what_an_upright_one_takes(tmp_path):
    upright = dm.simulate(load(tmp_path, 0.0))
    leaning = dm.simulate(load(tmp_path, 0.3))
    whole = float(upright.removed_volume.sum())
    assert whole > 5e-9
    np.testing.assert_allclose(float(leaning.removed_volume.sum()), whole, rtol=2e-3)
    assert bool(np.all(np.isfinite(leaning.force)))
    assert np.linalg.norm(leaning.force[40]) > 5


@pytest.mark.slow
def test_an_arm_that_tilts_its_tool_cuts_almost_as_one_that_does_not(tmp_path):
    rigid = dm.simulate(load(tmp_path, 0.0, REIS))
    tilting = dm.simulate(load(tmp_path, 0.0, REIS, {"simulation.tool_tilt": True}))
    leaning = dm.simulate(load(tmp_path, 0.2, REIS))
    scale = float(np.abs(rigid.deviation).max())
    assert 1e-6 < scale < 1e-3
    # The arm turns its tool by less than 1 mrad.
    np.testing.assert_allclose(tilting.actual, rigid.actual, rtol=0, atol=0.03 * scale)
    assert bool(np.all(np.isfinite(leaning.actual)))
    assert float(np.abs(leaning.deviation).max()) < 3 * scale
