"""Written programs read back to the same path at the same instants."""

import math

import numpy as np
import pytest

from diffmill.io import parse_gcode, program_frame, write_gcode, write_program
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


PROGRAM = """%
O100 (bracket)
(6 mm slot drill) ; roughing
G21 G17 G90 G94 G55
T1 M6 (face mill)
G43 H1
S4000 M3
G0 X0 Y0 Z5
G1 X10 F600 (face)
M5
T2
M6
G43 H2 T3
(slot)
S8000 M4
M8
G0 X0 Y0 Z1
G1 Z-1 F300
(first wall)
G1 X20 F600
M9
(second wall)
G1 Y10
(nothing more)
M5
G0 Z50
M9
T3 M6
(drill)
M8
G0 X1
M9
M30
%
"""


def test_a_corrected_program_keeps_what_the_program_says_beside_its_motion():
    program = parse_gcode(PROGRAM)
    path = sample_program(program.of_tool(2), 0.02, **LIMITS)
    frame = program_frame(program.source, np.asarray(path.line).tolist())
    text = write_gcode(path, spindle_speed=8000 * math.pi / 30, frame=frame)
    lines = text.splitlines()
    start = next(i for i, one in enumerate(lines) if one.startswith("G0"))
    assert lines[:start] == [
        "(bracket)",
        "(6 mm slot drill)",
        "(roughing)",
        "(face mill)",
        "G17 G21 G90 G93",
        "T2 M6",
        "G43 H2",
        "M8",
        "S8000 M4",
    ]
    rest = [one for one in lines[start:] if one[0] != "G"]
    assert rest == [
        "(slot)",
        "(first wall)",
        "M9",
        "(second wall)",
        "(nothing more)",
        "M5",
        "M9",
        "M30",
    ]
    # A comment stands before the motion that it stood before.
    after = lines[lines.index("(second wall)") + 1]
    row = np.flatnonzero(np.asarray(path.line) == 23)[0]
    assert after.startswith(f"G1 X{path.positions[row, 0] * 1e3:.6f} ")
    back = sample_program(parse_gcode(text), 0.02, **LIMITS)
    np.testing.assert_allclose(back.positions, path.positions, atol=3e-9)
    np.testing.assert_allclose(back.time, path.time, rtol=1e-12)


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("T12345678 M6\nG43 H1234567", ["T12345678 M6", "G43 H1234567"]),
        ("T1 M6\nG43 H2\nG43.2 H3", ["T1 M6", "G43 H2", "G43.2 H3"]),
        ("T1 M6 G43", ["T1 M6", "G43"]),
        ("M61 Q3\nG43.1 Z50", ["M61 Q3", "G43.1 Z50"]),
        ("T1 M6\nM61 Q3\nG20 G43.1 Z2.5\nG21", ["T1 M6", "M61 Q3", "G43.1 Z63.5"]),
        ("T1 M6\nG43.1 Z50\nG0 X1 Y1 Z9\nG1 Z8 F300\nM61 Q3\nG49", ["M61 Q3"]),
    ],
)
def test_a_corrected_program_keeps_tool_and_length_however_they_are_said(said, kept):
    source = f"{said}\n(slot)\nG0 X0 Y0 Z1\nG1 Z-1 F300\nG1 X20\nM2\n"
    program = parse_gcode(source)
    tool = program.tools[-1]
    path = sample_program(program.of_tool(tool), 0.02, **LIMITS)
    frame = program_frame(source, np.asarray(path.line).tolist())
    assert frame.opening == tuple(kept)
    # The Z of a length is no motion: the header goes on behind it.
    assert frame.comments == (() if "G1 " in said else ("slot",))
    back = parse_gcode(write_gcode(path, frame=frame))
    assert back.tools == (tool,)
    gap = sample_program(back, 0.02, **LIMITS).positions - path.positions
    assert np.max(np.abs(gap)) < 3e-9


def test_of_another_format_nothing_is_kept():
    frame = program_frame("&ACCESS RVP\nDEF part( )\n;T1 M6\nPTP {X 0}\nEND\n", [4])
    assert (frame.comments, frame.opening, frame.between) == ((), (), ())


def test_no_number_is_written_with_an_exponent():
    text = "(tiny)\nT1 M6\nG43.1 Z0.000002\nS0.00002 M3\nG0 X0.000001 Y0 Z0\n"
    text += "G1 X1 F0.00001\nG4 P0.00001\nX2 F200000\nG93 X3 F0.0001\n"
    program = parse_gcode(text)
    frame = program_frame(text, [move.line for move in program.moves])
    written = write_program(program, ".ngc", frame=frame)
    assert "G4 P0.00001\n" in written
    assert "G43.1 Z0.000002\n" in written
    assert not [row for row in written.splitlines() if "e" in row.lower()]
    back = parse_gcode(written)
    assert [move.rest for move in back.moves if move.rest] == [1e-5]
    assert back.moves[-2].feed == pytest.approx(200 / 60)
    assert back.spindle_speed == pytest.approx(program.spindle_speed)


def test_comments_keep_their_brackets_and_lose_control_characters():
    text = "(Pocket (2) \x1b[2J)\nG0 X0 Y0 Z0\nG1 X1 F60\n"
    frame = program_frame(text, [2, 3])
    written = write_program(parse_gcode(text), ".ngc", frame=frame)
    assert written.splitlines()[0] == "(Pocket [2] ?[2J)"


def test_frame_of_a_program_with_parameters():
    text = "(head)\nT1 M6\nM8\n#1=5\no1 repeat [2]\nG0 X0 Y0 Z#1\nG1 Z-1 F9\n"
    text += "G0 Z#1\no1 endrepeat\n(after)\nM9\nM30\n"
    program = parse_gcode(text)
    frame = program_frame(text, [move.line for move in program.moves])
    assert frame.opening == ("T1 M6", "M8")
    assert frame.closing == ("M5", "M9", "M30")
    assert "head" in frame.comments
