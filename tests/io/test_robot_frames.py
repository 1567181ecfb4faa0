"""What a robot program says of bases, tools, held work and axes beside the arm."""

import math

import pytest

from diffmill.io import read_program
from diffmill.toolpath import Program

H = "PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}"
TARGET = "[[{},0,0],[0,1,0,0],[0,0,0,0],[{},9E9,9E9,9E9,9E9,9E9]]"


def krl(*rows):
    return "\n".join(["DEF part( )", "$VEL.CP=0.05", *rows, "END"])


def rapid(*moves, data=""):
    return f"MODULE m\n{data}PROC main()\n{''.join(moves)}ENDPROC\nENDMODULE\n"


def move(x, *, axis="9E9", tool="mill", work="\\WObj:=part"):
    return f"MoveL {TARGET.format(x, axis)},v50,z0,{tool}{work};\n"


def test_external_axes_of_krl_stand_still_or_are_refused(read, faults):
    at = "{{X {},Y 0,Z 0,A 0,B 0,C 180,E1 {},E2 0}}"
    rows = [f"PTP {at.format(0, 5)}", f"LIN {at.format(9, 5)}", "LIN {X 12}"]
    notes = read(krl(*rows)).notes
    assert any("external axes: stand still" in note for note in notes)
    assert not any("external" in note for note in read(krl(H, "LIN {X 9}")).notes)
    moved = [*rows, f"LIN {at.format(20, 6)}"]
    assert faults(krl(*moved)) == [(6, "E1")]
    # A motion of joints moves them too, and a position without them leaves them there.
    home = "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 7}"
    assert faults(krl(*rows, home, H)) == [(7, "E1")]
    assert faults(krl(*rows, "LIN_REL {E1 3}"))[0][0] == 6


def test_an_external_axis_is_stated_from_the_start_or_not_at_all(faults):
    assert faults(krl(H, "LIN {X 9}", "LIN {X 12,E1 500}")) == [(5, "E1")]
    moved = rapid(move(0), move(9, axis="500"))
    assert faults(moved, ".mod") == [(4, "external axis a")]


def test_what_a_spline_is_told_ends_with_it(read):
    rows = "SPLINE WITH $ORI_TYPE=#CONSTANT", "SLIN {X 10,B 20}", "ENDSPLINE"
    moves = read(krl(H, *rows, "LIN {X 30,A 0,B 10,C 180}")).moves
    leans = [math.degrees(math.acos(move.axis[2])) for move in moves]
    assert leans == pytest.approx([0, 0, 10], abs=1e-6)


def test_an_orientation_is_known_where_the_place_is(read):
    turned = "PTP {X 0,Y 0,Z 0,A 0,B 90,C 0}"
    home = "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"
    # A motion of joints leaves no orientation that a position could keep.
    program = read(krl(turned, "LIN {X 1}", home, "LIN {X 10,Y 0,Z 0}", "LIN {X 20}"))
    assert program.moves[-1].axis == pytest.approx((0, 0, 1))
    first = "LIN {X 0,Y 0,Z 0,A 0,B 30,C 180}"
    program = read(krl("$ORI_TYPE=#CONSTANT", first, "LIN {X 9,A 0,B 0,C 180}"))
    assert program.moves[-1].axis[2] == pytest.approx(math.cos(math.radians(30)))


def test_both_sentences_on_one_word_are_noted(read):
    notes = read(krl("$ORI_TYPE=#VAR", H, "$ORI_TYPE=#CONSTANT", "LIN {X 9}")).notes
    assert len([note for note in notes if "$ORI_TYPE" in note]) == 2


def test_a_position_may_serve_as_a_base(read):
    data = "DECL E6POS B1={X 100,Y 0,Z 50,A 0,B 0,C 0,S 2,T 2,E1 0}"
    program = read(krl(data, "$BASE=B1", H, "LIN {X 9}"))
    assert program.work_position == pytest.approx((0.1, 0, 0.05))


def test_a_base_on_a_table_that_turns_is_refused(faults):
    table = "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{X 0,Y 0,Z 0})"
    assert [line for line, _ in faults(krl(table, H, "LIN {X 9}"))] == [3]


def test_external_axes_of_rapid_stand_still_or_are_refused(read, faults):
    program = read(rapid(move(0, axis="30"), move(9, axis="30")), ".mod")
    assert any("external axes: stand still" in note for note in program.notes)
    unused = read(rapid(move(0), move(9)), ".mod")
    assert not any("external" in note for note in unused.notes)
    moved = rapid(move(0, axis="30"), move(9, axis="31"))
    assert faults(moved, ".mod") == [(4, "external axis a")]


MILL = "PERS tooldata mill:=[{},[[0,10,250],[0,0,1,0]],[8,[0,0,90],[1,0,0,0],0,0,0]];\n"
WORK = 'PERS wobjdata part:=[{},{},"{}",[[1000,0,500],[1,0,0,0]],[[0,0,20],{}]];\n'
NO_TURN, QUARTER = "[1,0,0,0]", "[0.7071068,0,0,0.7071068]"


def test_a_robot_that_holds_the_work_is_refused(read, faults):
    moves = move(0), move(9)
    data = MILL.format("FALSE") + WORK.format("FALSE", "TRUE", "", NO_TURN)
    assert faults(rapid(*moves, data=data), ".mod")[0] == (5, "mill")
    data = MILL.format("TRUE") + WORK.format("TRUE", "TRUE", "", NO_TURN)
    assert faults(rapid(*moves, data=data), ".mod")[0] == (5, "part")
    # What a motion does not use may be as it is.
    other = rapid(*(move(x, tool="tool0", work="") for x in (0, 9)), data=data)
    assert read(other, ".mod").moves


def test_tool_and_work_object_of_rapid_are_stated(read):
    mill = MILL.format("TRUE")
    data = mill + WORK.format("FALSE", "TRUE", "", QUARTER)
    program = read(rapid(move(0), move(9), data=data), ".mod")
    assert program.work_position == pytest.approx((1.0, 0.0, 0.52))
    assert program.work_rpy == pytest.approx((0, 0, math.pi / 2), abs=1e-6)
    (part,) = program.sections
    assert part.tool_position == pytest.approx((0.0, 0.01, 0.25))
    # Half a turn about y, and ours about x: half a turn about z.
    assert part.tool_rpy == pytest.approx((0, 0, math.pi), abs=1e-6)
    data = mill + WORK.format("FALSE", "FALSE", "STN1", QUARTER)
    program = read(rapid(move(0), move(9), data=data), ".mod")
    assert any("moves with a mechanical unit" in note for note in program.notes)
    # The unit says where its frame lies, and not the program.
    assert program.work_position is None


def test_base_and_tool_of_krl_are_stated(read):
    frames = "$BASE={X 800,Y 0,Z 100,A 90,B 0,C 0}", "$TOOL={X 0,Y 0,Z 250,A 0,B 0,C 0}"
    program = read(krl(*frames, H, "LIN {X 9}"))
    assert program.work_position == pytest.approx((0.8, 0.0, 0.1))
    assert program.work_rpy == pytest.approx((0, 0, math.pi / 2))
    (part,) = program.sections
    assert part.tool_position == pytest.approx((0, 0, 0.25))
    # Its z points out of the flange, ours up the shank.
    assert abs(part.tool_rpy[0]) == pytest.approx(math.pi)
    named = read(krl("$BASE=BASE_DATA[2]", "$TOOL=TOOL_DATA[5]", H, "LIN {X 9}"))
    assert named.work_position is None and named.sections[0].tool_position is None
    for name in ("BASE_DATA[2]", "TOOL_DATA[5]"):
        assert f"line 5: {name}: its numbers are not in the program" in named.notes


def test_a_base_that_comes_late_is_another_base(read, faults):
    base = "$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}"
    assert faults(krl(H, "LIN {X 9}", base, "LIN {X 20}")) == [(5, "base")]
    assert read(krl(base, H, "LIN {X 9}", base, "LIN {X 20}")).moves


def test_a_tool_of_krl_is_known_by_its_value(read):
    one, two = (f"$TOOL={{X 0,Y 0,Z {z},A 0,B 0,C 0}}" for z in (150, 250))
    work = [H, "LIN {X 9}"]
    program = read(krl(one, *work, two, *work, one, *work))
    assert program.tools == (1, 2)
    assert [part.tool for part in program.sections] == [1, 2, 1]
    assert any("tool 2: is {X0,Y0,Z250" in note for note in program.notes)
    heights = [part.tool_position[2] for part in program.sections]
    assert heights == pytest.approx([0.15, 0.25, 0.15])
    assert read(krl(one, *work, one.replace("150", "150.0"), *work)).tools == (None,)


@pytest.mark.parametrize(
    "row",
    [
        "CHANGE_TOOL( )",
        "ASYPTP {E1 90}",
        "BAS (#EX_BASE,2)",
        "$ROBROOT={X 0,Y 0,Z 100,A 0,B 0,C 0}",
        "SLIN {X 9} WITH $EX_AX_IGNORE='B0001'",
    ],
)
def test_what_may_change_tool_place_or_arm_is_refused(faults, row):
    assert [line for line, _ in faults(krl(H, row, "LIN {X 12}"))] == [4]


def test_a_work_object_that_changes_is_refused(read, faults):
    work = '[FALSE,TRUE,"",[[{},0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]]'
    data = f"PERS wobjdata part:={work.format(0)};\n"
    first = f"part:={work.format(7)};\n"
    program = read(rapid(first, move(0), move(9), data=data), ".mod")
    assert program.work_position == pytest.approx((7e-3, 0, 0))
    for row in (f"part:={work.format(8)};\n", "part.uframe.trans.x:=7;\n"):
        assert faults(rapid(first, move(0), row, move(9), data=data), ".mod")[0][0] == 6


@pytest.mark.parametrize("row", ["EOffsSet e1;", "PDispOn p1,tool0;"])
def test_offsets_of_rapid_are_refused(faults, row):
    assert [line for line, _ in faults(rapid(row, move(0), move(9)), ".mod")] == [3]


def test_first_lines_of_posts_are_read(read):
    rows = [
        "PDAT_ACT = {VEL 15,ACC 100,APO_DIST 50}",
        "BAS (#PTP_DAT )",
        "FDAT_ACT = {TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}",
        "BAS (#FRAMES )",
        "PTP $AXIS_ACT ; skip BCO quickly",
        "LDAT_ACT = {VEL 0.05,ACC 100,APO_DIST 10}",
        "PTP $H_POS",
    ]
    program = read(krl(*rows, H, "LIN {X 9}"))
    assert program.tools == (1,) and program.path_length == pytest.approx(9e-3)
    # Where the arm is, the motion stays: place and section are as before.
    stays = read(krl(H, "PTP $POS_ACT", "LIN {X 9}"))
    assert len(stays.sections) == 1 and len(stays.moves) == 2


@pytest.mark.parametrize("name", ["PART.SRC", "Part.Src"])
@pytest.mark.parametrize("data", ["PART.DAT", "part.dat"])
def test_suffixes_may_have_capitals(tmp_path, name, data):
    (tmp_path / name).write_text("DEF part( )\n$VEL.CP=0.1\nPTP P1\nLIN {X 9}\nEND")
    (tmp_path / data).write_text("DECL E6POS P1={X 1,Y 2,Z 3,A 0,B 0,C 180}\n")
    program = read_program(tmp_path / name)
    assert isinstance(program, Program)
    assert program.moves[0].end == pytest.approx((1e-3, 2e-3, 3e-3))
