"""A program that cuts its rays into many pieces gets the slots that it needs."""

import numpy as np
import pytest

import diffmill as dm
from diffmill.cli import main
from small_job import write_job

# Grooves side by side leave ten ridges, which the rays across them meet one by one.
GROOVES, PITCH = 9, 3.0
JOB = {
    "cutter.diameter": "2 mm",
    "spindle.speed": "3000 rpm",
    "stock.lower": ["0 mm", "0 mm", "-2 mm"],
    "stock.upper": ["4 mm", "30 mm", "0 mm"],
    "simulation.substeps": 1,
}


def job_file(folder, **stock):
    lines = ["G21 G17 G90 G94", "G0 X-2 Y3 Z5"]
    for groove in range(GROOVES):
        lines += [f"G0 X-2 Y{PITCH * (groove + 1)}", "Z-1", "G1 X6 F6000", "G0 Z5"]
    changes = {f"stock.{key}": value for key, value in stock.items()}
    return write_job(folder, JOB, changes, program="\n".join([*lines, "M2", ""]))


@pytest.mark.slow
def test_a_run_that_needs_more_intervals_is_repeated_with_more(tmp_path):
    told = []
    job = dm.load_job(job_file(tmp_path))
    grown = dm.simulate(job, on_progress=lambda message, share: told.append(message))
    assert grown.stock.interval_counts == (16, 16, 1)
    assert any("intervals" in message for message in told)
    stated = dm.load_job(job_file(tmp_path, intervals=[16, 16, 1]))
    wanted = dm.simulate(stated)
    np.testing.assert_array_equal(grown.force, wanted.force)
    np.testing.assert_array_equal(grown.stock.volumes(), wanted.stock.volumes())


@pytest.mark.slow
def test_stated_intervals_are_kept_and_the_overflow_is_told(tmp_path):
    job = dm.load_job(job_file(tmp_path, intervals=[8, 8, 1]))
    with pytest.raises(dm.SimulationFailed, match="intervals"):
        dm.simulate(job)


@pytest.mark.slow
def test_the_command_line_says_how_many_were_taken(tmp_path, capsys):
    file = job_file(tmp_path)
    assert main(["simulate", str(file), "--out", str(tmp_path / "out")]) == 0
    assert "16, 16, 1 intervals" in capsys.readouterr().err
