"""What is said of a run that did not succeed."""

import re

import numpy as np
import pytest

import diffmill as dm
from small_job import ARM, write_job

JOB = {
    "stock.lower": ["0 mm", "-7 mm", "-2 mm"],
    "stock.upper": ["8 mm", "7 mm", "0 mm"],
    "stock.spacing": "0.4 mm",
    "stock.intervals": [1, 1, 1],
    "program.file": "path.csv",
    "robot": ARM,
    "robot.work_in_base.position": ["1514 mm", "-8.5 mm", "936 mm"],
}


def load(folder, depth, *changes):
    """Return a job along x at a depth [mm]."""
    lines = ["time_s,x_mm,y_mm,z_mm"]
    lines += [f"{k * 3.75e-3:.5f},{-6 + 0.2 * k:.3f},0,-{depth}" for k in range(40)]
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    return dm.load_job(write_job(folder, JOB, *changes))


@pytest.mark.slow
def test_an_unreachable_pose_and_an_overflow_are_both_named(tmp_path):
    job = load(tmp_path, 1)
    commanded = np.array(job.path.positions)
    commanded[38:, 0] += 2.9
    with pytest.raises(dm.SimulationFailed) as failure:
        dm.simulate(job, commanded=commanded)
    text = str(failure.value)
    unreached, overflow = re.findall(r"First at step (\d+), time ([\d.]+) s", text)
    assert unreached == ("38", f"{38 * 3.75e-3:.4f}")
    assert 6 <= int(overflow[0]) < 38
    assert "does not reach 2 of the 40 poses" in text
    # Stretched out in the plane of axes 2 and 3, or a joint at the end of its range.
    assert re.search(r"mm and [\d.]+ deg away, where .*axis_[1-6]", text)
    assert "intervals" in text
    solution = failure.value.solution
    assert isinstance(solution, dm.Solution)
    np.testing.assert_array_equal(np.flatnonzero(~solution.is_reached), [38, 39])


MODE = {"damping_ratio": 0.01, "stiffness": "0.2 N/um"}
MODES = [
    MODE | {"direction": [1.0, 0.0, 0.0], "frequency": "300 Hz"},
    MODE | {"direction": [0.0, 0.5, 1.0], "frequency": "320 Hz"},
]


@pytest.mark.slow
def test_a_tool_that_swings_out_of_its_window_is_said_to_chatter(tmp_path):
    stock = {"stock.lower": ["0 mm", "-7 mm", "-8 mm"], "stock.intervals": [3, 3, 3]}
    job = load(tmp_path, 6, stock, {"robot": None, "machine": {"modes": MODES}})
    with pytest.raises(dm.SimulationFailed) as failure:
        dm.simulate(job)
    told = re.search(r"up to ([\d.]+) mm off its path .*chatter", str(failure.value))
    solution = failure.value.solution
    assert isinstance(solution, dm.Solution)
    first = int(np.argmax(solution.has_failed))
    deviation = np.linalg.norm(solution.deviation, axis=1)[: first + 1]
    assert told and float(told[1]) == pytest.approx(1e3 * deviation.max(), rel=1e-2)
    # A tenth of the radius, from where the tool counts as swinging.
    assert float(told[1]) > 0.5
