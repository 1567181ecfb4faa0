"""G-code: the motion of small programs, and what is refused, by line and word."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from diffmill.io import ProgramError, parse_gcode, read_program
from diffmill.toolpath import Program

MM = 1e-3
INCH = 25.4e-3


def ends(text, **rest):
    return [move.end for move in parse_gcode(text, **rest).moves]


def faults(text):
    with pytest.raises(ProgramError) as caught:
        parse_gcode(text, name="part.ngc")
    return caught.value.faults


def approx(*values, scale=MM):
    return pytest.approx([value * scale for value in values], abs=1e-15)


@pytest.mark.parametrize(
    "line",
    [
        "G1 X5 Y-.5 Z+3 F600",
        "g1x5.y-0.5z3.000f600.",
        "G01 F600 Z3 Y-.5 X5",
        "N10 G1.0 X 5 Y - . 5 Z+ 3 F6 00",
        "X+5.0G1(first)Y-0.5 (second) Z3F600;third (still",
        "\tG1\tX5\tY-.5\tZ3\tF600\r",
        "G1 X5 Y-.5 Z3 F600 (\u00e9\u00df\u4e2d)",
        "x0005y-00.50z3.g1f600",
    ],
)
def test_ways_to_write_one_line(line):
    (move,) = parse_gcode(line).moves
    assert list(move.end) == approx(5, -0.5, 3)
    assert move.start == (0.0, 0.0, 0.0)
    assert move.feed == pytest.approx(0.01)
    assert (move.is_rapid, move.line, move.centre) == (False, 1, None)


def test_modal_state_runs_on():
    text = "G0 X1\nY2\nG1 F60 Z-1\nX3\n\n(note)\nG91\nX1 Y1\nG90 G0 X0"
    program = parse_gcode(text)
    expected = [(1, 0, 0), (1, 2, 0), (1, 2, -1), (3, 2, -1), (4, 3, -1), (0, 3, -1)]
    assert [move.end for move in program.moves] == [
        pytest.approx([c * MM for c in point], abs=1e-15) for point in expected
    ]
    assert [move.line for move in program.moves] == [1, 2, 3, 4, 8, 9]
    assert [move.is_rapid for move in program.moves] == [True] * 2 + [False] * 3 + [
        True
    ]
    assert program.moves[0].feed is None


def test_units_keep_the_position_and_the_feed():
    moves = parse_gcode("G21 G1 F600 X25.4\nG20 Y1\nF6 X2\nG21 X2").moves
    assert list(moves[1].end) == approx(25.4, 25.4, 0)
    assert list(moves[2].end) == approx(2, 1, 0, scale=INCH)
    assert list(moves[3].end) == approx(2, 25.4, 0)
    assert [move.feed for move in moves] == pytest.approx(
        [0.01, 0.01, 6 * INCH / 60, 6 * INCH / 60]
    )


def test_inverse_time():
    text = "G93 G1 X1 F30\nX2 F16000\nG0 X3\nG1 X3 F60\nG94 X4 F60"
    moves = parse_gcode(text).moves
    assert [move.duration for move in moves] == [
        pytest.approx(2.0),
        pytest.approx(0.00375),
        None,
        pytest.approx(1.0),
        None,
    ]
    assert moves[4].feed == pytest.approx(1e-3)


def test_end_of_program_and_percent():
    text = "\n%\nG0 X1 Y1 Z1\nG1 F60 X2\n%\nthis is not read"
    assert len(parse_gcode(text).moves) == 2
    assert len(parse_gcode("G0 X1 M2\nG77 nonsense").moves) == 1
    assert len(parse_gcode("G0 X1 M30\n%").moves) == 1
    assert "closing" in faults("%\nG0 X1")[0].message
    assert len(parse_gcode("G0 X1\n%\n").moves) == 1
    found = faults("G0 X1\n%\nG0 X2")[0]
    assert (found.line, found.word) == (2, "%")


def test_line_endings_are_counted_alike():
    for newline in ("\n", "\r\n", "\r"):
        found = faults(newline.join(["G0 X1", "", "G1 X2 F1", "G33"]))
        assert (found[0].line, found[0].word) == (4, "G33")


def test_spindle_and_tool():
    program = parse_gcode("T1 M6\nS8000 M3\nG0 X1\nT1 M6\nM5\nM2")
    assert program.spindle_speed == pytest.approx(8000 * 2 * math.pi / 60)
    assert parse_gcode("G0 X1").spindle_speed is None
    two = parse_gcode("S1000\nG0 X1\nS0\nS2000\nX2\nS1000")
    assert two.spindle_speeds == pytest.approx(
        [1000 * math.pi / 30, 2000 * math.pi / 30]
    )


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("G0 X1 Y1 Z5\nG0 Z1\nG1 F1 Z0", 1),
        ("G0 Z5\nX1 Y1\nZ1\nG1 F1 Z0", 2),
        ("G0 Z5\nG0 X1\nG1 F1 Z0", 2),
        ("G1 F1 Z5\nG0 X1", 0),
        ("G91 G0 X1 Y1 Z1\nG1 F1 Z0", 1),
    ],
)
def test_approach_ends_when_all_axes_are_known(text, count):
    assert parse_gcode(text).approach_count == count


@pytest.mark.parametrize(
    ("arc", "centre", "sweep"),
    [
        ("G2 X10 Y0 I5 J0", (5, 0), -math.pi),
        ("G3 X10 Y0 I5", (5, 0), math.pi),
        ("G3 X10 Y0 R5", (5, 0), math.pi),
        ("G2 X10 Y0 R5", (5, 0), -math.pi),
        ("G2 X5 Y5 R5", (5, 0), -math.pi / 2),
        ("G2 X5 Y5 R-5", (0, 5), -3 * math.pi / 2),
        ("G3 X5 Y5 R5", (0, 5), math.pi / 2),
        ("G3 X5 Y5 R-5", (5, 0), 3 * math.pi / 2),
        ("G2 X0 Y0 I0 J3", (0, 3), -2 * math.pi),
        ("G3 I-2", (-2, 0), 2 * math.pi),
    ],
)
@pytest.mark.parametrize(("units", "scale"), [("G21", MM), ("G20", INCH)])
@pytest.mark.parametrize("shift", [0.0, 7.3])
def test_arcs(arc, centre, sweep, units, scale, shift):
    text = f"{units} G0 X{shift} Y0 Z0\nG91 F60 {arc} Z-2"
    move = parse_gcode(text).moves[1]
    assert move.centre is not None
    assert list(move.centre) == pytest.approx(
        [(centre[0] + shift) * scale, centre[1] * scale, 0], abs=1e-7 * scale
    )
    assert move.sweep == pytest.approx(sweep, rel=1e-7)
    assert move.end[2] == pytest.approx(-2 * scale)
    assert move.radii[0] == pytest.approx(move.radii[1], rel=1e-7)


def test_arc_mode_is_modal():
    moves = parse_gcode("F60 G2 X2 I1\nX4 I1\nI1").moves
    assert [move.turn for move in moves] == [-1, -1, -1]
    assert abs(moves[2].sweep) == pytest.approx(2 * math.pi)


@settings(max_examples=60, deadline=None)
@given(
    radius=st.floats(0.1, 100.0),
    start=st.floats(0, 6.28),
    sweep=st.floats(0.01, 6.2),
    turn=st.sampled_from([1, -1]),
    use_radius=st.booleans(),
)
def test_any_arc_is_recovered(radius, start, sweep, turn, use_radius):
    last = start + turn * sweep
    x0, y0 = radius * math.cos(start), radius * math.sin(start)
    x1, y1 = radius * math.cos(last), radius * math.sin(last)
    signed = radius if sweep <= math.pi else -radius
    how = f"R{signed:.9f}" if use_radius else f"I{-x0:.9f} J{-y0:.9f}"
    text = f"G0 X{x0:.9f} Y{y0:.9f}\nG{2 if turn < 0 else 3} F60"
    move = parse_gcode(f"{text} X{x1:.9f} Y{y1:.9f} {how}").moves[1]
    # A chord near the diameter loses half of the digits of the centre.
    loose = use_radius and abs(sweep - math.pi) < 0.3
    tolerance = 1e-3 * radius if loose else 1e-5
    assert move.centre is not None
    assert move.centre[:2] == pytest.approx((0, 0), abs=tolerance * MM)


@pytest.mark.parametrize(
    ("text", "line", "word", "part"),
    [
        ("G0 X1\nG4", 2, "G4", "needs a P"),
        ("g0 x1\ng62 p0.1", 2, "g62", "G62 is not supported"),
        ("G0 X1 A5", 1, "A5", "axis that turns"),
        ("G18 G2 X1 J1 F1", 1, "J1", "XZ plane has no J"),
        ("G1.5 X1 F1", 1, "G1.5", "G1.5 is not supported"),
        ("M98 P100\nG0 X1", 1, "100", "is not in the program's file"),
        ("G0 X1\nO100 X", 2, "O100X", "no O-word"),
        ("G0 /X1", 1, "/", "block delete"),
        ("G0 X", 1, "X", "X needs a number"),
        ("G0 X(5)5", 1, "X", "X needs a number"),
        ("G0 X--5", 1, "X--5", "X needs a number"),
        ("G0 X1.2.3", 1, ".3", "no word starts like this"),
        ("G0 X1e3", 1, "e3", "E is not supported"),
        ("G0 X1 \u00b5", 1, "\u00b5", "no word starts"),
        ("G0 X1 (open", 1, "(open", "not closed"),
        ("G0 X1 (a (b)", 1, "(a (b)", "not closed"),
        ("G0 X1 (a) b)", 1, ")", "no comment"),
        ("G80\nG80 X1", 2, "X1", "G80 moves nothing"),
        ("F1 G81 X1 Z-1 R1 P2", 1, "P2", "P belongs to no code"),
        ("F1 G82 X1 Z-1 R1 P2\nX2 Q3", 2, "Q3", "Q belongs to no code"),
        ("F1 G81 X1 Z-1 R1 P2", 1, "P2", "P belongs to no code"),
        ("G5.1 I1 J2\nG0 X1", 1, "G5.1", "write it as arcs"),
        ("G0 X1\nG50 S2000", 2, "G50", "without X, Y, Z and S"),
        ("G0 X1\nG50 X2", 2, "G50", "without X, Y, Z and S"),
        ("G0 X1 )", 1, ")", "no comment"),
        ("G0 X1 X2", 1, "X2", "only one X"),
        ("G0 G1 X2 F1", 1, "G1", "only one code for motion"),
        ("G90 G91 G0 X2", 1, "G91", "only one code for distance"),
        ("M3 M5\nG0 X1", 1, "M5", "only one code for spindle"),
        ("G0 N5 X1", 1, "N5", "starts its line"),
        ("X1 Y1", 1, "X1", "no motion is chosen"),
        ("G1 X1", 1, "G1", "there is no feed"),
        ("F100\nG94\nG1 X1", 3, "G1", "there is no feed"),
        ("G1 X1 F0", 1, "F0", "the feed is 0"),
        ("G0 F0\nG1\nX1", 2, "G1", "the feed is 0"),
        ("G1 X1 F-3", 1, "F-3", "must be positive"),
        ("G93 G1 X1 F2\nX2", 2, "X2", "needs an F above 0"),
        ("G93 F2\nG2 X2 I1", 2, "G2", "needs an F above 0"),
        ("G93 G1 X2 F0", 1, "F0", "needs an F above 0"),
        ("G0 X1 I2", 1, "I2", "belongs to an arc"),
        ("G1 X1 F1 R2", 1, "R2", "belongs to an arc"),
        ("J2\nG0 X1", 1, "J2", "belongs to an arc"),
        ("F1 G2 X1 I.5 K1", 1, "K1", "no K"),
        ("F1 G2 X1 I.5 R.5", 1, "R.5", "either R"),
        ("F1 G2 X1", 1, "G2", "needs its centre"),
        ("F1 G2 R1", 1, "R1", "needs an end"),
        ("F1 G2 X0 Y0 R1", 1, "G2", "full circle"),
        ("F1 G2 X10 R4.9", 1, "G2", "too small"),
        ("F1 G2 X10 I4", 1, "G2", "4 at the start of the arc, but 6"),
        ("F1 G2 X10 I0 J0", 1, "G2", "no radius"),
        ("G0 X99999999999", 1, "X99999999999", "beyond"),
        ("G0 X200000", 1, "X200000", "100 m"),
        ("G1 X1 F99999999", 1, "F99999999", "mm/min at most"),
        ("S9999999\nG0 X1", 1, "S9999999", "spindle speed"),
        ("S-1\nG0 X1", 1, "S-1", "spindle speed"),
        ("T1.5\nG0 X1", 1, "T1.5", "whole number"),
        ("G0 X1\nG41 D1 X2", 2, "G41", "radius of the cutter is not known"),
        ("G0 X1\no1 call", 2, "1", "is not in the program's file"),
        ("G68.2 X0 Y0 Z0 I9\nG0 X1", 1, "G68.2", "no kinematics"),
        ("G43.4 H1\nG0 X1", 1, "G43.4", "no kinematics"),
        ("G68 X0 Y0\nG0 X1", 1, "G68", "needs R"),
        ("G91 G68 X0 Y0 R9\nG0 X1", 1, "G68", "needs the XY plane, G90"),
        ("G51 X0 Y0 P2000\nG0 X1", 1, "G51", "decimal point"),
        ("G51 X0 Y0 Z0 P2.\nG0 X1", 1, "G51", "X and Y alone"),
        ("G51.1\nG0 X1", 1, "G51.1", "needs X or Y"),
        ("G91 G16\nG0 X1", 1, "G16", "needs the XY plane and G90"),
        ("G0 X1 Z1\nG91 G81 ^9 R1 Z-2 L3 F9", 2, "L3", "several holes"),
        ("G0 X1 Y1\n@5 X3", 2, "@5", "has no X or Y"),
        ("G0 X1\nG68 X0 Y0 R9\nG92 X0", 3, "G92", "does not go with"),
        ("G0 X1\nG10 L1 P1 X2", 2, "G10", "L2 or L20"),
        ("G0 X1\nG81 X2 Z-1 F9", 2, "G81", "needs its retract plane"),
        ("G0 X1 Z5\nG81 X2 Z3 R1 F9", 2, "G81", "below the bottom"),
        ("G0 X1 Q5", 1, "Q5", "Q belongs to no code"),
        ("G0 X1 U2", 1, "U2", "U is not supported"),
        ("G21 G90\nF100 M3 S100", 0, "", "moves nothing"),
        ("", 0, "", "moves nothing"),
        ("G0 X0 Y0", 0, "", "moves nothing"),
    ],
)
def test_refusals_name_line_and_word(text, line, word, part):
    first = faults(text)[0]
    assert (first.line, first.word) == (line, word)
    assert part in first.message


def test_arc_tolerances_are_those_of_linuxcnc():
    # 0.0283 mm, or a thousandth of the radius if that is more.
    assert ends("F1 G2 X10.028 I5")
    assert faults("F1 G2 X10.04 I5")[0].word == "G2"
    assert ends("F1 G2 X200.09 I100")
    assert ends("F1 G2 X10 R4.999")
    assert faults("F1 G2 X10 R4.998")[0].word == "G2"
    assert faults("G20 F1 G2 X2 R.9999")[0].word == "G2"
    assert ends("G20 F1 G2 X2 R.99996")


def test_all_faults_are_reported_without_echoes():
    found = faults("G72\nG2 X1 Z1 I1 F5\nG17 G38.2\nG1 X3\nG62\nG1 X#1\nX9")
    assert [(fault.line, fault.word) for fault in found] == [
        (1, "G72"),
        (3, "G38.2"),
        (5, "G62"),
    ]


def test_message_names_file_and_allowed_words_and_stops_at_twenty():
    with pytest.raises(ProgramError) as caught:
        parse_gcode("G62\n" * 30, name="part.ngc")
    message = str(caught.value)
    assert message.startswith('part.ngc, line 1: found "G62"')
    assert "further faults" in message
    assert "Allowed are N, G0 to G4" in message
    assert len(caught.value.faults) == 20


def test_feed_from_outside_fills_in():
    move = parse_gcode("G1 X1", feed=0.05).moves[0]
    assert move.feed == pytest.approx(0.05)
    assert parse_gcode("G1 X1 F60", feed=0.05).moves[0].feed == pytest.approx(1e-3)


def test_trivial_block_delete_is_accepted():
    assert len(parse_gcode("/\n/ (nothing)\nG0 X1").moves) == 1


def test_files(tmp_path):
    file = tmp_path / "part.ngc"
    file.write_bytes(b"\xef\xbb\xbf(\xb5m \xff)\r\nG0 X1 Y1 Z1\r\nG1 F60 X2 \xb5\r\n")
    with pytest.raises(ProgramError, match=r"part\.ngc, line 3"):
        read_program(file)
    file.write_bytes(b"(\xb5m \xff)\r\nG0 X1 Y1 Z1\r\nG1 F60 X2\r\n")
    program = read_program(file)
    assert isinstance(program, Program)
    assert program.name == "part.ngc"
    assert "G1 F60 X2" in program.source
    with pytest.raises(ProgramError):
        read_program(tmp_path / "none.ngc")
