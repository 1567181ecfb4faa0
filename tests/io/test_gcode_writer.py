"""Written programs read back to the same path at the same instants."""

import math

import numpy as np
import pytest

from diffmill.io import parse_gcode, write_gcode
from diffmill.toolpath import Path, sample_program

LIMITS = {"acceleration": 2.0, "rapid_feed": 0.2, "corner_tolerance": 1e-4}


def curve(period, rows=400):
    t = period * np.arange(rows)
    positions = np.stack(
        [0.1 + 0.05 * t, 0.003 * np.sin(9 * t), 1e-3 * np.cos(5 * t)], axis=1
    )
    positions[100:120] = positions[100:101]
    return Path.upright(t, positions)


@pytest.mark.parametrize("rpm", [8000.0, 7777.7, 12345.678])
def test_round_trip_within_a_micrometre(rpm):
    period = 60 / (rpm * 2)
    path = curve(period)
    program = parse_gcode(write_gcode(path, spindle_speed=rpm * 2 * math.pi / 60))
    back = sample_program(program, period, **LIMITS)
    np.testing.assert_allclose(back.time, path.time, rtol=1e-12)
    assert back.step_count == path.step_count
    # Six decimals of a millimetre, and 1 nm for a row that repeats another.
    gap = np.linalg.norm(np.asarray(back.positions) - path.positions, axis=1)
    assert np.max(gap) < 3e-9
    assert program.spindle_speed == pytest.approx(rpm * 2 * math.pi / 60, rel=1e-9)


def test_dwell_rows_are_no_empty_moves():
    text = write_gcode(curve(0.00375))
    moves = parse_gcode(text).timed_moves
    assert all(move.length > 0 for move in moves)
    assert all(move.duration == pytest.approx(0.00375) for move in moves)


def test_frame_of_the_program():
    text = write_gcode(curve(0.00375, 3), header=["part (left)", "two\nlines \u00b5"])
    lines = text.splitlines()
    assert lines[:2] == ["(part [left])", "(two lines ?)"]
    assert lines[2] == "G17 G21 G90 G93"
    assert lines[3] == "G0 X100.000000 Y0.000000 Z1.000000"
    assert lines[4].endswith("F16000.000000000")
    assert lines[-2:] == ["M5", "M2"]
    assert "-0.000000" not in text


def test_refusals():
    path = curve(0.00375, 3)
    tilt = Path(path.time, path.positions, np.eye(3), path.is_rapid, path.line)
    with pytest.raises(ValueError):
        write_gcode(tilt)
    with pytest.raises(ValueError):
        write_gcode(Path.upright(np.zeros(3), path.positions))
    with pytest.raises(ValueError):
        write_gcode(Path.upright(path.time, np.full((3, 3), np.nan)))
