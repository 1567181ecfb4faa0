"""APT and CLDATA as their makers write them: frames, arcs and cycles by hand."""

import math

import numpy as np
import pytest

MM = 1e-3
START = "UNITS/MM\n{}\nFEDRAT/600,MMPM\nGOTO/{}\n"


def places(program):
    """Ends of the moves [mm] and their tool axes."""
    return [(*np.array(m.end) / MM, *m.axis) for m in program.moves]


def test_points_of_another_frame_are_brought_into_that_of_the_first(read):
    # The second has its origin at (0, 0, 7) of the part, x up and y along -y of it; the
    # first lies at (10, 20, 0). So (1, 2, 3) is at (-3, -2, 8) of the part.
    text = START.format("MSYS/10,20,0,1,0,0,0,1,0", "1,2,3,0,0.6,0.8")
    text += "MSYS/0,0,7,0,0,1,0,-1,0\nGOTO/1,2,3\nGODLTA/1,0,0\nTLAXIS/1,0,0\n"
    text += "GOTO/1,2,3\nMSYS/10,20,0,1,0,0,0,1,0\nGOTO/1,2,3\nFINI"
    program = read(text, ".cls")
    z = np.cross([0, 0, 1], [0, -1, 0])
    np.testing.assert_array_equal(z, [1, 0, 0])
    expected = [
        (1, 2, 3, 0, 0.6, 0.8),
        (3 - 10, -2 - 20, 8, *z),
        (3 - 10, -2 - 20, 9, *z),
        (3 - 10, -2 - 20, 8, 0, 0, 1),
        (1, 2, 3, 0, 0, 1),
    ]
    np.testing.assert_allclose(places(program), expected, atol=1e-9)
    assert any("line 5: MSYS: another frame" in note for note in program.notes)


def test_tracut_is_applied_and_ends(read, faults):
    # A quarter of a turn about z, then 5 along x: (1, 2, 3) becomes (3, 1, 3).
    text = START.format("", "1,2,3") + "TRACUT/0,-1,0,5,1,0,0,0,0,0,1,0\nGOTO/1,2,3\n"
    arc = "CIRCLE/1,4,3,0,0,1,2\nGOTO/3,4,3\nTRACUT/NOMORE\nGOTO/1,2,3\nFINI"
    program = read(text + arc, ".apt")
    ends = [place[:3] for place in places(program)]
    np.testing.assert_allclose(
        ends, [(1, 2, 3), (3, 1, 3), (1, 3, 3), (1, 2, 3)], atol=1e-9
    )
    round_ = program.moves[2]
    assert round_.centre == pytest.approx((1 * MM, 1 * MM, 3 * MM))
    assert round_.sweep == pytest.approx(math.pi / 2)
    for wrong in ("1,2,3", "2,0,0,0,0,2,0,0,0,0,2,0", "-1,0,0,0,0,1,0,0,0,0,1,0"):
        assert faults(f"TRACUT/{wrong}\n" + text, ".apt")[0] == (1, "TRACUT")


def test_home_is_where_it_says_or_where_a_program_came_from(read, faults):
    text = "UNITS/MM\nFROM/1,2,30\nFEDRAT/600,MMPM\nGOTO/4,5,6\nGOHOME{}\nFINI"
    for words, end in (("", (1, 2, 30)), ("/7,8,9", (7, 8, 9))):
        program = read(text.format(words), ".cls")
        assert places(program)[-1][:3] == pytest.approx(end)
        assert [move.is_rapid for move in program.moves] == [False, True]
    assert faults(START.format("", "1,2,3") + "GOHOME\nFINI", ".cls") == [(5, "GOHOME")]


def test_points_of_the_world_stay_whatever_a_clamping_says(read):
    text = "UNITS/MM\nTRNTYP/WORLD,0,0,0\nCSYS/-1,0,0,0,0,1,0,0,0,0,-1,0\nRAPID\n"
    text += "GOTO/1,2,-30,0,0,-1\nTRNTYP/WORLD,0,0,0\nCSYS/1,0,0,0,0,1,0,0,0,0,1,0\n"
    program = read(text + "FEDRAT/600\nGOTO/4,5,6\nFINI", ".apt")
    # The second clamping states no axis again: it is upright.
    np.testing.assert_allclose(
        places(program), [(1, 2, -30, 0, 0, -1), (4, 5, 6, 0, 0, 1)]
    )
    assert any(
        "line 3: CSYS: states how the work is clamped" in n for n in program.notes
    )


def test_frames_and_axes_of_catia(read):
    frame = "$$*CATIA0\n$$ 001\n$$ 0. 1. 0. {}\n$$ 0. 0. 1. 0.\n$$ 1. 0. 0. 0.\n"
    text = frame.format("0.") + "PARTNO A\nMULTAX\nFEDRAT/ 600.,MMPM\n"
    text += "GOTO  / 1.,2.,3., 0.6,0.,0.8\nMULTAX/OFF\nGOTO / 4.,2.,3.\n"
    # Another origin, 9 along the third axis: x of its first row is z of the frame.
    program = read(text + frame.format("9.") + "GOTO / 4., 2., 3.\n", ".aptsource")
    expected = [(1, 2, 3, 0.6, 0, 0.8), (4, 2, 3, 0, 0, 1), (4, 2 + 9, 3, 0, 0, 1)]
    np.testing.assert_allclose(places(program), expected, atol=1e-9)


ROUND = "INDIRV/{}\nTLON,GOFWD/ (CIRCLE/ 0.,0.,5.,$\n 10.),ON,{}(LINE/ 0.,0.,5.,{})"


@pytest.mark.parametrize(
    ("forward", "times", "end", "sweep"),
    [
        ("0,1,0", "", "0,10,5", 90),
        ("0,-1,0", "2,INTOF,", "0,10,5", -270),
        ("0,1,0", "", "-10,0,5", 180),
        ("0,-1,0", "2,INTOF,", "10,0,5", -360),
    ],
)
def test_arcs_of_catia_in_the_plane(read, forward, times, end, sweep):
    text = START.format("AUTOPS", "10,0,5") + ROUND.format(forward, times, end)
    arc = read(text + "\nFINI", ".aptsource").moves[-1]
    assert arc.centre == pytest.approx((0, 0, 5 * MM))
    assert arc.end == pytest.approx([MM * float(one) for one in end.split(",")])
    assert arc.sweep * arc.normal[2] == pytest.approx(math.radians(sweep))
    assert arc.feed == pytest.approx(0.01)


def test_arcs_of_catia_about_a_cylinder(read, faults):
    # About x, from the top to the side y.
    text = START.format("", "1,0,4,1,0,0")
    text += "PSIS/(PLANE/(POINT/1,0,4),PERPTO,(VECTOR/1,0,0))\n{}TLON,GOFWD/(CYLNDR/"
    text += "1,0,0,$\n1,0,0,4),ON,(PLANE/PERPTO,(PLANE/(POINT/1,0,0),PERPTO,$\n"
    text += "(VECTOR/1,0,0)),(POINT/1,0,0),(POINT/1,4,0))\nGOTO/1,4,0\nFINI"
    arc = read(text.format("INDIRV/0,1,0\n"), ".apt").moves[1]
    assert arc.normal == pytest.approx((-1, 0, 0))
    assert abs(arc.sweep) == pytest.approx(math.pi / 2)
    assert arc.points_at(np.array([0.5]))[0] == pytest.approx(
        (MM, 4 * MM * math.sqrt(0.5), 4 * MM * math.sqrt(0.5))
    )
    assert faults(text.format(""), ".apt")[0][0] == 6
    whole = START.format("", "10,0,5") + ROUND.format("0,1,0", "", "10,0,5")
    assert faults(whole, ".apt")[0][0] == 6


@pytest.mark.parametrize(("axis", "angle", "middle"), [(1, 90, 1), (-1, 270, -1)])
def test_an_angle_tells_which_way_round(read, axis, angle, middle):
    text = START.format("", "10,0,0") + f"MOVARC/0,0,0, 0,0,1, 10, ANGLE, {angle}\n"
    arc = read(text + "GOTO/0,10,0\nFINI", ".apt").moves[-1]
    assert abs(arc.sweep) == pytest.approx(math.radians(angle))
    half = arc.points_at(np.array([0.5]))[0] / MM
    assert half[:2] == pytest.approx([middle * 10 * math.sqrt(0.5)] * 2)
    assert arc.normal[2] * arc.turn == axis


@pytest.mark.parametrize(
    "cycle",
    [
        "CYCLE/DRILL,RAPTO,3.0000,FEDTO,-8.0000,RTRCTO,AUTO,MMPM,120.0000",
        "CYCLE / DRILL, DEPTH, 8., MMPM, 120., CLEAR, 3.",
        "CYCLE/DRILL, FEDTO, 8, MMPM, 120, CLEAR, 9, RETURN, 3, RAPTO, 3",
        "CYCLE/DEEP,FEDTO,8.,INCR,10.,MMPM,120,RAPTO,3.",
        "CYCLE/DRILL,DEEP,CLEAR,3,FEDTO,-8,STEP1,9,MMPM,120",
    ],
)
def test_cycles_of_makers(read, cycle):
    program = read(
        START.format("", "0,0,9") + f"{cycle}\nGOTO/5,6,1\nCYCLE/OFF", ".ncl"
    )
    plunge = [m for m in program.moves if not m.is_rapid]
    assert plunge[-1].end == pytest.approx((5 * MM, 6 * MM, -7 * MM))
    assert plunge[-1].feed == pytest.approx(2e-3)
    above = [m.end[2] / MM for m in program.moves[1:] if m.is_rapid]
    assert set(np.round(above, 9)) == {4.0}


@pytest.mark.parametrize(
    "cycle", ["DRILL,126,85,1,MMPR", "DRILL,FEDTO,5,CLEAR,-3", "TAP,FEDTO,5,CLEAR,3"]
)
def test_cycles_that_leave_something_open_are_refused(faults, cycle):
    text = START.format("", "0,0,9") + f"CYCLE/{cycle}\nGOTO/5,6,1\n"
    assert faults(text, ".apt")[0][0] == 5


def test_origin_tells_the_machine_and_comments_of_creo_go_on(read):
    text = "$$-> CSYS / 1, 0, 0, 0, $\n$$->  0, 1, 0, 0, $\n$$-> 0, 0, 1, 0\n"
    text += START.format("ORIGIN/5,6,7", "1,2,3") + "ORIGIN/0,0,0\nGOTO/4,5,6\nFINI"
    program = read(text, ".ncl")
    assert program.moves[-1].end == pytest.approx((4 * MM, 5 * MM, 6 * MM))
    assert "states where the machine's zero is" in "".join(program.notes)
