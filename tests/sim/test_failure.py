"""What is said of a run that did not succeed."""

import re

import numpy as np
import pytest

import diffmill as dm

JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
[stock]
lower = ["0 mm", "-7 mm", "-2 mm"]
upper = ["8 mm", "7 mm", "0 mm"]
spacing = "0.4 mm"
intervals = [1, 1, 1]
[program]
file = "path.csv"
[robot]
model = "reis_rv130_like"
work_in_base = { position = ["1514 mm", "-8.5 mm", "936 mm"] }
"""


@pytest.mark.slow
def test_an_unreachable_pose_and_an_overflow_are_both_named(tmp_path):
    rows = 40
    lines = ["time_s,x_mm,y_mm,z_mm"]
    lines += [f"{k * 3.75e-3:.5f},{-6 + 0.2 * k:.3f},0,-1" for k in range(rows)]
    (tmp_path / "path.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "job.toml").write_text(JOB)
    job = dm.load_job(tmp_path / "job.toml")
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


MODES = """
[[machine.modes]]
direction = [1.0, 0.0, 0.0]
frequency = "300 Hz"
damping_ratio = 0.01
stiffness = "0.2 N/um"
[[machine.modes]]
direction = [0.0, 0.5, 1.0]
frequency = "320 Hz"
damping_ratio = 0.01
stiffness = "0.2 N/um"
"""


@pytest.mark.slow
def test_a_tool_that_swings_out_of_its_window_is_said_to_chatter(tmp_path):
    lines = ["time_s,x_mm,y_mm,z_mm"]
    lines += [f"{k * 3.75e-3:.5f},{-6 + 0.2 * k:.3f},0,-6" for k in range(40)]
    (tmp_path / "path.csv").write_text("\n".join(lines) + "\n")
    text = JOB.split("[robot]")[0] + MODES
    text = text.replace('"-2 mm"', '"-8 mm"').replace("[1, 1, 1]", "[3, 3, 3]")
    (tmp_path / "job.toml").write_text(text)
    with pytest.raises(dm.SimulationFailed) as failure:
        dm.simulate(dm.load_job(tmp_path / "job.toml"))
    told = re.search(r"up to ([\d.]+) mm off its path .*chatter", str(failure.value))
    solution = failure.value.solution
    assert isinstance(solution, dm.Solution)
    first = int(np.argmax(solution.has_failed))
    deviation = np.linalg.norm(solution.deviation, axis=1)[: first + 1]
    assert told and float(told[1]) == pytest.approx(1e3 * deviation.max(), rel=1e-2)
    # A tenth of the radius, from where the tool counts as swinging.
    assert float(told[1]) > 0.5
