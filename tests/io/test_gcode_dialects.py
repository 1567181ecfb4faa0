"""Words of real programs: their motion by hand, and what a program cannot say."""

import itertools
import math

import numpy as np
import pytest

from diffmill.config import program_setup
from diffmill.io import ProgramError, ProgramSetup, parse_gcode, read_program
from diffmill.toolpath import sample_program

MM = 1e-3


def motion(text, **setup):
    """Return kind and end [mm] of every move."""
    moves = parse_gcode(text, setup=ProgramSetup(**setup)).moves
    return [
        ("r" if move.is_rapid else "f", *(round(v / MM, 6) for v in move.end))
        for move in moves
    ]


def sampled(program, period=0.01):
    return sample_program(
        program, period, acceleration=1.0, rapid_feed=0.1, corner_tolerance=0.0
    )


def faults(text, **setup):
    with pytest.raises(ProgramError) as caught:
        parse_gcode(text, setup=ProgramSetup(**setup))
    return [(fault.line, fault.word) for fault in caught.value.faults]


def test_words_that_move_nothing_are_noted():
    text = "%\nO1001 (part)\nn1.5 g21 g40 g64 p0.1\nM8\nS100 M4\nM0\n/G0X1\n"
    text += "M48 G97\nG61.1\nG0 X2 Y2 Z2\nM9\nM30\n%\n"
    program = parse_gcode(text)
    assert [move.line for move in program.moves] == [7, 10]
    noted = " ".join(program.notes)
    for word in ("O1001", "G40", "G64", "M8", "M4", "M0", "/", "M48", "G97", "M9"):
        assert f" {word}: " in noted
    assert "line 4: M8" in noted
    skipped = parse_gcode(text, setup=ProgramSetup(skips_blocks=True))
    assert [move.line for move in skipped.moves] == [10]


def test_rest_takes_its_time():
    program = parse_gcode("G0 X0 Y0 Z0\nG1 X1 F60\nG4 P0.5\nX2\nG82 X3 R0 Z-1 P.25\n")
    assert [move.rest for move in program.moves if move.rest] == [0.5, 0.25]
    timed = [move.duration for move in program.timed_moves if move.duration]
    assert timed == [0.5, 0.25]
    path = sampled(program)
    still = (path.positions[1:] == path.positions[:-1]).all(axis=1).sum()
    assert still == pytest.approx(75, abs=3)


@pytest.mark.parametrize(
    ("plane", "arc", "end", "centre", "normal"),
    [
        ("G17", "G2 X1 Y1 J1 Z2", (1, 1, 2), (0, 1, 0), (0, 0, 1)),
        ("G18", "G3 X1 Z1 R1 Y2", (1, 2, 1), (1, 0, 0), (0, 1, 0)),
        ("G18", "G2 X1 Z1 I1 Y2", (1, 2, 1), (1, 0, 0), (0, 1, 0)),
        ("G19", "G3 Y1 Z1 K1 X2", (2, 1, 1), (0, 0, 1), (1, 0, 0)),
        ("G90.1 G17", "G3 X1 Y1 I0 J1", (1, 1, 0), (0, 1, 0), (0, 0, 1)),
    ],
)
def test_arcs_of_all_planes_turn_about_their_axis(plane, arc, end, centre, normal):
    program = parse_gcode(f"{plane} F60\n{arc}")
    (move,) = program.moves
    assert [round(v / MM, 9) for v in move.end] == list(end)
    assert move.normal == normal
    assert move.centre is not None
    assert [round(v / MM, 9) for v in move.centre] == list(centre)
    assert move.radii == pytest.approx((MM, MM))
    across = np.asarray(sampled(program).positions) - np.array(move.centre)
    across = across - (across @ normal)[:, None] * [normal]
    assert (across**2).sum(axis=1) == pytest.approx(MM**2, rel=1e-9)


def test_turns_of_a_helix():
    program = parse_gcode("F60 G3 I1 Z3 P3")
    (move,) = program.moves
    assert move.sweep == pytest.approx(6 * math.pi)
    assert move.length == pytest.approx(math.hypot(6 * math.pi, 3) * MM)
    assert sampled(program, 0.001).duration == pytest.approx(
        move.length / 1e-3, rel=1e-2
    )


def test_drilling_goes_back_to_the_plane_that_is_asked_for():
    text = "G0 X0 Y0 Z9\n{} G81 X1 R2 Z-3 F60\nX4\nG80"
    high = [("r", 0, 0, 9), ("r", 1, 0, 9), ("r", 1, 0, 2), ("f", 1, 0, -3)]
    high += [("r", 1, 0, 9), ("r", 4, 0, 9), ("r", 4, 0, 2), ("f", 4, 0, -3)]
    assert motion(text.format("G98")) == [*high, ("r", 4, 0, 9)]
    low = [*high[:4], ("r", 1, 0, 2), ("r", 4, 0, 2), ("f", 4, 0, -3), ("r", 4, 0, 2)]
    assert motion(text.format("G99")) == low


def test_pecks():
    text = "G0 X0 Y0 Z2\nG83 X0 R1 Z-3 Q2 F60"
    found = [(kind, z) for kind, _, _, z in motion(text)]
    clear = 0.254
    first = [("r", 2), ("r", 2), ("r", 1), ("f", -1), ("r", 1)]
    assert found == [*first, ("r", -1 + clear), ("f", -3), ("r", 1)]


def test_feed_per_revolution():
    moves = parse_gcode("G95 S600 F0.2\nG1 X1\nS1200\nX2").moves
    assert [move.feed for move in moves] == pytest.approx([2e-3, 4e-3])
    assert faults("G95 F0.2\nG1 X1") == [(2, "G1")]


def test_one_coordinate_system_is_the_workpiece():
    assert motion("G56 G0 X1") == [("r", 1, 0, 0)]
    assert faults("G0 X1\nG55\nG0 X1 Y1") == [(3, "")]
    both = {"G54": (0.0, 0.0, 0.0), "G55": (0.1, 0.0, -0.01)}
    assert motion("G0 X1\nG55 X1 Z2\nG91 X1", offsets=both) == [
        ("r", 1, 0, 0),
        ("r", 101, 0, -8),
        ("r", 102, 0, -8),
    ]


def test_g92_moves_the_zero_and_not_the_tool():
    text = "G0 X10 Y0 Z0\nG92 X1\nG0 X3\nG92.2\nX3\nG92.3\nX3\nG92.1\nX3"
    assert [row[1] for row in motion(text)] == [10, 12, 3, 12, 3]
    # Before any motion it says where the tool is.
    program = parse_gcode("G92 X10 Y5 Z2\nG91 G0 X1")
    assert program.moves[0].end == pytest.approx((11 * MM, 5 * MM, 2 * MM))


def test_machine_positions_need_the_zero_of_the_machine():
    text = "G0 X1 Y1 Z1\nG91 G28 Z0\nG90 G53 G0 X-5\n"
    assert faults(text.replace("G90 G53 G0", "G90 F9 G53 G1")) == [
        (3, "G53"),
        (3, "G1"),
    ]
    setup = {
        "machine_zero": (0.0, 0.0, 0.5),
        "reference_points": ((0.0, 0.0, -0.01), (0.0, 0.0, 0.0)),
    }
    assert motion(text, **setup)[1:] == [
        ("r", 1, 1, 1),
        ("r", 1, 1, 490),
        ("r", -5, 1, 490),
    ]


HOME = """G53 G0 Z0.
T1 M6
G0 X0. Y0.
G43 Z15. H1
G1 Z-1. F300
X50.
G0 Z15.
G91 G28 Z0.
G90
T2 M6
G0 X5. Y0.
G43 Z15. H2
G1 Z-2.
G0 Z15.
G28 G91 Z0 X0 Y0
G90 G0 X100.
M30
"""


def test_ways_home_before_and_after_the_cuts_of_a_tool_are_left_out():
    program = parse_gcode(HOME)
    assert program.tools == (1, 2)
    for tool, ends in ((1, [-1, -1, 15]), (2, [-2, 15])):
        moves = program.of_tool(tool).timed_moves
        assert [move.end[2] / MM for move in moves] == pytest.approx(ends)
        # It begins where the program first states the whole place.
        assert moves[0].start == pytest.approx(
            ((5 if tool == 2 else 0) * MM, 0, 15 * MM)
        )
    notes = "\n".join(program.notes)
    assert "line 1: G53: goes to a place of the machine" in notes
    assert "lines 8, 15: G28: goes to a place of the machine" in notes
    assert "line 16: a rapid move: leads to a place that is not stated" in notes


def test_a_way_home_between_two_cuts():
    text = "G0 X0 Y0 Z5\nG1 Z-1 F60\n{}G53 G0 Z0\nG0 X9 Y9\nZ5\nG1 Z-1\n"
    # From above the part a straight way leads to where the place is known again.
    program = parse_gcode(text.format("G0 Z5\n")).of_tool()
    assert [move.end[0] / MM for move in program.timed_moves] == [0, 0, 9, 9]
    # Out of a cut the tool goes up, across and down again.
    for way in ("G53 G0 Z0", "G91 G28 Z0\nG90", "G91 G30 Z0\nG90"):
        program = parse_gcode(text.format("").replace("G53 G0 Z0", way))
        ends = [[round(v / MM) for v in move.end] for move in program.timed_moves]
        assert ends == [[0, 0, -1], [0, 0, 30], [9, 9, 30], [9, 9, 5], [9, 9, -1]]
        assert any("goes up, by an unknown way" in note for note in program.notes)
    # Behind the last cut there is no such way.
    assert len(motion("G0 X0 Y0 Z5\nG1 Z-1 F60\nG53 G0 Z0\nM30")) == 2
    # A cut that depends on it needs the zero, and so does a way to the side.
    lost = "G0 X0 Y0 Z5\nG1 Z-1 F60\nG53 G0 Z0\nG0 X9 Y9\nG1 X5"
    assert faults(lost)[0] == (5, "G1")
    aside = text.format("").replace("G53 G0 Z0", "G91 G28 X0 Y0 Z0\nG90")
    assert faults(aside)[0] == (3, "G28")
    # A place that is not stated again is no place to cut from.
    lost = "G0 X0 Y0 Z5\nG53 G0 Z0\nG0 X9\n{}"
    for code in ("G1 X5 F60", "G81 X1 Z-1 R1 F60", "G92 Z0", "G28.1", "G10 L20 P1 Z0"):
        assert faults(lost.format(code))[0] == (4, code.split()[0])
    assert len(motion(lost.format("G91 G0 Z1\nG90 Z2\nG1 X5 F60"))) == 5


def test_codes_that_end_what_is_off_are_noted():
    text = (
        "G15 G40.1 G50 G69 G50.1 G13.1 G67\nG5.1 Q0\nG187 P2 E0.01\nG0 X1\nG1 X2 F60\n"
    )
    program = parse_gcode(text)
    assert [move.end[0] / MM for move in program.moves] == [1, 2]
    noted = " ".join(program.notes)
    for word in ("G15", "G40.1", "G50", "G69", "G50.1", "G13.1", "G67"):
        assert f": {word}: ends what is off here anyway" in noted
    assert ": G5.1: how far the control looks ahead changes no path" in noted
    assert "G187: corners are as" in noted


@pytest.mark.parametrize(
    ("words", "plane"), [("I.5 K0", "G17"), ("K.5 J0.", "G18"), ("J.5 I-0", "G19")]
)
def test_the_centre_across_the_plane_may_be_zero(words, plane):
    end = {"G17": "X1", "G18": "Z1", "G19": "Y1"}[plane]
    program = parse_gcode(f"{plane} F60\nG2 {end} {words}\n")
    assert abs(program.moves[0].sweep) == pytest.approx(math.pi)
    assert "0 changes nothing" in program.notes[0]


def test_the_motion_before_a_cycle_goes_on_behind_it():
    text = "G0 X0 Y0 Z5\n{}\nG81 X1 Z-1 R1 F60\nX2\nG80\nX4\nY1"
    for code, is_rapid in (("G0 X0", True), ("G1 X0 F60", False)):
        program = parse_gcode(text.format(code))
        assert [move.is_rapid for move in program.moves[-2:]] == [is_rapid] * 2
        assert program.moves[-1].end == pytest.approx((4 * MM, 1 * MM, 1 * MM))
        word = code.split()[0]
        assert f"line 6: G80: {word} goes on behind it" in " ".join(program.notes)
    # An arc would need its centre; without a motion before there is none.
    assert faults(text.format("G2 I1 F60")) == [(6, "X4"), (7, "Y1")]
    assert faults("G80\nX4") == [(2, "X4")]


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("G0 X10 Y5\nG3 X0 Y15 I0 J5 F60", "I and J fit as an absolute centre"),
        ("G18 G0 X10 Z5\nG2 X0 Z15 I0 K5 F60", "I and K fit as an absolute centre"),
        ("G90.1 G0 X10 Y5\nG3 X0 Y15 I-10 J0 F60", "fit as measured from its start"),
        ("G20 G92 X3 Y0\nG0 X10 Y5\nG3 X0 Y15 I0 J5 F6", "absolute centre"),
    ],
)
def test_a_centre_of_the_other_kind_is_named(text, part):
    with pytest.raises(ProgramError) as caught:
        parse_gcode(text)
    assert part in caught.value.faults[0].message


@pytest.mark.parametrize(
    "words",
    ["G5.1 Q1", "G5.1 Q1 R3", "G5 P10000", "G8 P1", "G103 P1", "G91 G28 X0 Y0 A0\nG90"],
)
def test_modes_of_controllers_change_no_path(words):
    # A way home with an axis that turns ends the programs of usual posts.
    program = parse_gcode(f"G0 X0 Y0 Z5\nG1 Z1 F60\nX2\nG0 Z5\n{words}\n")
    assert [move.end[0] / MM for move in program.moves] == pytest.approx([0, 0, 2, 2])
    assert words.split()[0] in " ".join(program.notes) or "G28" in words


def test_units_of_other_controllers_and_the_second_point():
    rows = "{}\nG0 X1 Y0 Z2\nG1 X3 F10\nG0 Z4\n"
    for old, new in (("G20", "G70"), ("G21", "G71")):
        assert motion(rows.format(old)) == motion(rows.format(new))
    assert faults("G70 I10 J0 L4\nG0 X1")[0] == (1, "I10")
    rows = rows.format("G21") + "G30 {} G91 Z0\n"
    assert motion(rows.format("P2")) == motion(rows.format(""))
    assert faults(rows.format("P3")) == [(5, "G30")]


def test_further_systems_by_p():
    rows = "G54.1 P3\nG0 X1 Y1 Z5\nG1 X2 F60\n"
    assert motion(rows) == motion(rows.replace("G54.1", "G154"))
    assert motion(rows)[-1] == ("f", 2, 1, 5)
    assert faults(rows + "G154 P4 G0 X3") == [(4, "G154")]
    assert faults("G54.1\nG0 X1") == [(1, "G54.1")]


def test_repeats_by_k_and_a_rest_behind_pecks():
    rows = "G90 G0 X0 Y0 Z9\nG83 X5 Z-4 R1 Q2.5 P.25 F60\nG91 X5 Z-5 R-8 K2\nG80\n"
    program = parse_gcode(rows)
    bottoms = [move for move in program.moves if abs(move.end[2] + 4 * MM) < 1e-9]
    assert [move.end[0] / MM for move in bottoms] == pytest.approx([5, 10, 15])
    assert [move.rest for move in bottoms] == [0.25] * 3
    assert sum(move.rest for move in program.moves) == 0.75
    assert faults(rows.replace("Z-5 R-8 ", "")) == [(3, "X5")]


def test_centres_are_absolute_where_a_job_says_so():
    # A quarter about (0, 5) of radius 10, half way at 45 degrees; then, by G91.1, one
    # that states the way from its start.
    text = "G0 X10 Y5 F60\nG3 X0 Y15 I0 J5\nG91.1 G3 X-10 Y5 I0 J-10"
    setup = program_setup(['arc_centres = "absolute"'])
    _, first, second = parse_gcode(text, setup=setup).moves
    for move, x in ((first, 7.0710678), (second, -7.0710678)):
        assert move.centre == pytest.approx((0, 5 * MM, 0))
        half = move.points_at(np.array([0.5]))[0] / MM
        assert half == pytest.approx((x, 12.0710678, 0), abs=1e-6)
    # In G18 with the zero of G54 at (100, 0, 0): K is absolute, too.
    text = "G18 G0 X10 Z5 F60\nG2 X0 Z15 I0 K5"
    offsets = {"G54": (0.1, 0.0, 0.0)}
    setup = ProgramSetup(arc_centres="absolute", offsets=offsets)
    arc = parse_gcode(text, setup=setup).moves[-1]
    assert arc.centre == pytest.approx((100 * MM, 0, 5 * MM))


def test_a_refused_centre_names_the_key():
    with pytest.raises(ProgramError, match=r'arc_centres = "absolute"'):
        parse_gcode("G0 X10 Y5\nG3 X0 Y15 I0 J5 F60")
    setup = ProgramSetup(arc_centres="absolute")
    with pytest.raises(ProgramError, match=r'arc_centres = "relative"'):
        parse_gcode("G0 X10 Y5\nG3 X0 Y15 I-10 J0 F60", setup=setup)


def test_a_centre_that_fits_in_no_way_is_not_named():
    with pytest.raises(ProgramError) as caught:
        parse_gcode("G0 X9\nG2 X7 Y1 I5 J3 F1")
    assert "fit as" not in caught.value.faults[0].message


def test_tool_lengths():
    # The tip of a tool that is 20 mm longer is 20 mm lower; the machine stands still.
    text = "T1 M6\nG43 H1 G0 X0 Y0 Z50\nT2 M6\nG43 H2\nG91 G0 Z-5"
    assert motion(text, tool_lengths={1: 0.1, 2: 0.12})[-1] == ("r", 0, 0, 25)
    # Without lengths a height must be stated before the tool cuts again.
    assert parse_gcode("G43 H1\nG0 X0 Y0 Z5\nG1 Z0 F60").approach_count == 1
    assert faults("G0 X0 Y0 Z5\nG43 H1\nG1 X5 F60\nG1 Z1") == [(3, "G1")]


TWO_TOOLS = """T1 M6 S1000 M3
G0 X0 Y0 Z5
G1 Z-1 F60
G0 Z5
T2 M6 S2000
G0 X9 Y9
G0 Z5
G1 Z-2
G0 Z5
T1 M6 S1000
G0 X4 Y4
Z5
G1 Z-3
M2
"""


def test_lengths_that_the_program_states():
    lengths = {1: 0.010, 2: 0.003}
    text = "T1 M6\nG0 X0 Y0 Z5\n{}\nG0 X1\nG0 Z5"
    for word, z in (("G43.1 Z2", 3), ("G43", -5), ("G43 H1\nG43.2 H2", -8)):
        found = motion(text.format(word), tool_lengths=lengths)
        assert found[1:] == [("r", 1, 0, z), ("r", 1, 0, 5)]
    assert faults(text.format("G43.1 X2 Z2")) == [(3, "G43.1")]


def test_reference_points_that_the_program_sets():
    text = "G0 X1 Y2 Z3\nG28.1\nG0 X5 Y5 Z5\nG28 Z6"
    assert motion(text)[2:] == [("r", 5, 5, 6), ("r", 5, 5, 3)]


def test_words_of_signals_are_no_words_of_the_motion():
    text = "G0 X0 Y0 Z0\nG2 X1 I.5 F60\nM66 P1 L3 Q2\nM19 R45\nM61 Q4\nG1 X2"
    program = parse_gcode(text)
    assert len(program.moves) == 3
    assert program.tools == (None, 4)
    assert " M66: " in " ".join(program.notes)


def test_a_surface_speed_is_no_spindle_speed():
    program = parse_gcode("G96 D3000 S120 M3\nG1 X1 F60")
    assert program.spindle_speeds == ()
    assert faults("S100\nG96 S120 M3\nG95 G1 X1 F1") == [(3, "G1")]


def test_one_of_several_tools_is_chosen():
    program = parse_gcode(TWO_TOOLS)
    assert program.tools == (1, 2)
    assert len(program.moves) == 10
    first = program.of_tool()
    ends = [tuple(round(v / MM, 6) for v in move.end) for move in first.timed_moves]
    assert ends == [(0, 0, -1), (0, 0, 5), (4, 4, 5), (4, 4, -3)]
    for before, after in itertools.pairwise(first.moves):
        assert before.end == after.start
    second = program.of_tool(2)
    assert [move.line for move in second.timed_moves] == [8, 9]
    rpm = 2 * math.pi / 60
    assert second.spindle_speeds == pytest.approx((2000 * rpm,))
    assert first.spindle_speeds == pytest.approx((1000 * rpm,))
    with pytest.raises(ValueError):
        program.of_tool(3)


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        ("G68 X10 Y0 R90\nX20 Y0\nX10 Y5\nG69\nX0", [(10, 10), (5, 0), (0, 0)]),
        ("G68 X10 Y0 R90\nG91 X20\nY5", [(0, 20), (-5, 20)]),
        ("G51 X10 Y0 P2.0\nX5 Y1\nX20\nG50\nX1", [(0, 2), (30, 2), (1, 2)]),
        ("G51.1 X10\nX5 Y1\nG50.1 X0\nX5", [(15, 1), (5, 1)]),
        ("G51.1 Y4\nX5 Y1\nX6", [(5, 7), (6, 7)]),
        ("G51.1 X0 Y0\nX5 Y1", [(-5, -1)]),
        ("G16\nX10 Y0\nY90\nX5\nG15\nX1 Y1", [(10, 0), (0, 10), (0, 5), (1, 1)]),
        ("@10 ^90\n^0\n@5\nG91 ^90", [(0, 10), (10, 0), (5, 0), (0, 5)]),
        # A mirror image of what is turned.
        ("G68 X0 Y0 R90\nG51.1 X1\nX5 Y0", [(2, 5)]),
    ],
)
def test_turned_scaled_mirrored_and_polar_places(text, ends):
    found = [row[1:3] for row in motion(f"G0 X0 Y0 Z0\n{text}")[1:]]
    assert np.array(found) == pytest.approx(np.array(ends), abs=1e-6)


def test_arcs_are_turned_scaled_and_mirrored():
    text = "G0 X0 Y0 Z0\n{}\nG0 X10 Y0\nG2 X20 Y10 {} F60"
    for words in ("I10 J0", "R10", "G90.1 I20 J0"):
        for turn, centre, sign in (
            ("G68 X0 Y0 R90", (0, 20), -1),
            ("G51 X0 Y0 P.5", (10, 0), -1),
            ("G51.1 X0", (-20, 0), 1),
        ):
            arc = parse_gcode(text.format(turn, words)).moves[-1]
            assert arc.centre is not None
            assert np.array(arc.centre[:2]) / MM == pytest.approx(centre, abs=1e-6)
            assert arc.turn == sign
            assert abs(arc.sweep) == pytest.approx(math.pi / 2)


def test_holes_are_turned_as_well():
    text = "G0 X0 Y0 Z5\nG68 X0 Y0 R90\nG81 X10 Y0 Z-1 R1 F60\nX20"
    assert [row[1:3] for row in motion(text) if row[3] == -1] == [(0, 10), (0, 20)]


@pytest.mark.parametrize(
    ("suffix", "text", "name", "instead"),
    [
        (".h", "0 BEGIN PGM A MM\n1 L X+10 R0 FMAX\n", "Heidenhain", "G-code as"),
        (".mpf", "%_N_A_MPF\n;$PATH=/_N_MPF_DIR\nG1 X=AC(5)\n", "Siemens", "G-code as"),
        (".ls", "/PROG  A\n/ATTR\n/MN\n 1:L P[1] 100mm/sec FINE ;\n", "Fanuc robots",
         "APT"),
        (".jbi", "/JOB\n//NAME A\n//POS\nMOVL C0001 V=50.0\nEND\n", "Yaskawa", ".csv"),
        (".gcode", "G28\nM104 S210\nG1 X1 E.5\n", "a printer", "G-code as"),
        (".nc", "/JOB\n//NAME A\n//POS\nMOVL C0001 V=50.0\nEND\n", "Yaskawa", ".csv"),
    ],
)  # fmt: skip
def test_a_language_that_is_not_read_is_named_once(
    tmp_path, suffix, text, name, instead
):
    (tmp_path / f"part{suffix}").write_text(text)
    with pytest.raises(ProgramError, match=name) as caught:
        read_program(tmp_path / f"part{suffix}")
    (fault,) = caught.value.faults
    assert fault.line and instead in fault.message


def test_m_codes_of_one_machine_are_passed_over_by_name():
    text = "G21 G90 F600\nG0 X0 Y0 Z1\nM88\nM77 P3 S2\nG1 X5 M88\nM2\n"
    with pytest.raises(ProgramError) as caught:
        parse_gcode(text)
    (first, second, third) = caught.value.faults[0], *caught.value.faults[1:3]
    assert first.line == 3 and '[program] pass_over = ["M88"]' in first.message
    assert second.line == 4 and third.line in (4, 5)
    program = parse_gcode(text, setup=ProgramSetup(pass_over=("M88", "M77")))
    assert [move.end for move in program.moves] == [(0, 0, 1e-3), (5e-3, 0, 1e-3)]
    (note,) = (note for note in program.notes if "M88" in note)
    assert note == "lines 3, 5: M88: is passed over, as [program] pass_over says"
    # S of a line with another code belongs to that.
    more = text.replace("M77 P3 S2", "M77 M3 S800")
    program = parse_gcode(more, setup=ProgramSetup(pass_over=("M88", "M77")))
    assert program.spindle_speeds == pytest.approx((800 * 2 * np.pi / 60,))


def test_zeros_in_machine_coordinates_are_seen_from_the_first_system():
    """G55 lies 20 mm beside G54, whose zero moves by 1 mm later."""
    text = "G21 G90 F600\nG10 L2 P1 X-100 Y-50 Z-200\nG10 L2 P2 X-80 Y-50 Z-199\n"
    text += "G54 G0 X0 Y0 Z5\nG1 X3\nG55 X0\nZ5\nG10 L2 P1 X-99\nG54 X0 Z5\n"
    program = parse_gcode(text)
    ends = np.array([move.end for move in program.moves]) / MM
    wanted = [[0, 0, 5], [3, 0, 5], [20, 0, 5], [20, 0, 6], [1, 0, 5]]
    np.testing.assert_allclose(ends, wanted, atol=1e-9)
    assert any(note.startswith("lines 2, 3, 8: G10 L2: ") for note in program.notes)
    # With the zero of the machine, the first system is where it says.
    setup = ProgramSetup(machine_zero=(0.1, 0.05, 0.2))
    same = parse_gcode(text, setup=setup)
    ends = np.array([move.end for move in same.moves]) / MM
    np.testing.assert_allclose(ends, wanted, atol=1e-9)
    for wrong in ("G54 G0 X0 Y0 Z5\nG10 L2 P1 X1 Y1 Z1\nG0 X1", "G10 L2 P1 X1\nG0 X1"):
        with pytest.raises(ProgramError, match="where the machine's zero lies"):
            parse_gcode(wrong)
