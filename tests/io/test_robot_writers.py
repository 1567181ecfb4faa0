"""Programs of robots that are written keep what stands around their motion."""

import pytest

from diffmill.io import ProgramSetup, read_program, write_program
from diffmill.toolpath import Program

KRL = """&ACCESS RVP
DEF part( )
;Bracket, side 2
;FOLD INI
BAS (#INITMOV,0 )
;ENDFOLD
$BASE={X 800,Y 0,Z 100,A 0,B 0,C 0}
$TOOL=TOOL_DATA[3]
$OUT[7]=TRUE ; coolant
SPINDLE_ON(12000)
PTP HOME
$VEL.CP=0.05
PTP {X 0,Y 0,Z 5,A 180,B 0,C 180,S 'B110',T 'B100011'}
LIN {X 10}
$OUT[8]=TRUE
LIN {X 20}
SPINDLE_OFF()
$OUT[7]=FALSE
PTP HOME
END
"""
RAPID = """MODULE m
! Bracket, side 2
PERS tooldata mill:=[TRUE,[[0,0,100],[1,0,0,0]],
  [1,[0,0,1],[1,0,0,0],0,0,0]];
PERS tooldata other:=[TRUE,[[0,0,50],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
TASK PERS wobjdata part:=[FALSE,TRUE,"",[[0,0,9],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
CONST robtarget p:=[[0,0,5],[0,1,0,0],[0,-1,-2,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PROC main()
ConfL\\Off;
SetDO spindle,1;
MoveJ p,v500,fine,mill\\WObj:=part;
MoveL Offs(p,10,0,0),v50,z0,mill\\WObj:=part;
SetDO spindle,0;
ENDPROC
ENDMODULE
"""
SETUP = ProgramSetup(pass_over=("SPINDLE_ON", "SPINDLE_OFF"))


def rewritten(tmp_path, text, suffix, **options):
    (tmp_path / f"part{suffix}").write_text(text)
    program = read_program(tmp_path / f"part{suffix}", setup=SETUP)
    written = write_program(program, suffix, **options)
    (tmp_path / f"back{suffix}").write_text(written)
    axis = options.get("tool_axis")
    setup = ProgramSetup(pass_over=SETUP.pass_over, tool_axis=axis)
    back = read_program(tmp_path / f"back{suffix}", setup=setup)
    assert isinstance(program, Program) and isinstance(back, Program)
    return program, written, back


def test_krl_keeps_base_tool_outputs_and_the_way_of_the_joints(tmp_path):
    program, written, back = rewritten(tmp_path, KRL, ".src")
    rows = written.splitlines()
    first = next(row for row in rows if row.startswith("PTP"))
    assert first == "PTP {X 0,Y 0,Z 5,A 180,B 0,C 180,S 6,T 35}"
    opening = rows[: rows.index(first)]
    assert opening[2] == ";Bracket, side 2"
    assert opening[-5:] == [
        "BAS (#INITMOV,0 )",
        "$BASE={X 800,Y 0,Z 100,A 0,B 0,C 0}",
        "$TOOL=TOOL_DATA[3]",
        "$OUT[7]=TRUE",
        "SPINDLE_ON(12000)",
    ]
    assert rows[-3:] == ["SPINDLE_OFF()", "$OUT[7]=FALSE", "END"]
    assert back.work_position == pytest.approx((0.8, 0, 0.1))
    assert [move.end for move in back.moves] == [move.end for move in program.moves]
    assert [move.tool_x for move in back.moves] == [m.tool_x for m in program.moves]


def test_rapid_keeps_tool_work_object_and_configuration(tmp_path):
    program, written, back = rewritten(tmp_path, RAPID, ".mod")
    rows = [row.strip() for row in written.splitlines()]
    assert rows[1].startswith("PERS tooldata mill:=[TRUE,[[0,0,100]")
    assert rows[2].startswith("TASK PERS wobjdata part:=")
    assert not any("other" in row for row in rows)
    assert rows[rows.index("ConfL\\Off;") + 1] == "SetDO spindle,1;"
    assert "[0,-1,-2,0]" in next(row for row in rows if row.startswith("MoveJ"))
    assert rows[-3] == "SetDO spindle,0;"
    assert all("mill\\WObj:=part;" in row for row in rows if row.startswith("Move"))
    assert back.work_position == pytest.approx((0, 0, 9e-3))
    assert [move.end for move in back.moves] == [move.end for move in program.moves]


def test_a_tool_of_another_axis_keeps_no_frame(tmp_path):
    _, written, back = rewritten(tmp_path, KRL, ".src", tool_axis="x")
    assert "$TOOL" not in written and "motion only" in written
    assert back.moves[0].axis == pytest.approx((0, 0, 1))


def test_motion_in_several_routines_has_no_frame(tmp_path):
    text = KRL.replace("LIN {X 20}", "CUT()").replace(
        "END\n", "END\nDEF CUT()\nLIN {X 20}\nEND\n"
    )
    _, written, _ = rewritten(tmp_path, text, ".src")
    assert "$BASE" not in written and "motion only" in written
