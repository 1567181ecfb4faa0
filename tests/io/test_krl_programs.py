"""KRL as it is written by hand and by posts: loops, structures, calls, by hand."""

import math

import numpy as np
import pytest

from diffmill.io import ProgramError, ProgramSetup, read_program
from diffmill.toolpath import Program

START = "PTP {X 0,Y 0,Z 9,A 0,B 0,C 180}"


def krl(*rows, more=""):
    return "\n".join(["DEF part( )", "$VEL.CP=0.05", START, *rows, "END", more])


def places(program):
    """Ends of the moves behind the first [mm]."""
    return [tuple(np.round(np.array(m.end) * 1e3, 9)) for m in program.moves[1:]]


@pytest.mark.parametrize(
    ("rows", "xs"),
    [
        ("FOR I=1 TO 3\nLIN {X 0}\nP.X=I*10\nLIN P\nENDFOR", [0, 10, 0, 20, 0, 30]),
        ("FOR I=6 TO 2 STEP -2\nP.X=I\nLIN P\nENDFOR", [6, 4, 2]),
        ("I=0\nWHILE I<2\nI=I+1\nP.X=I\nLIN P\nENDWHILE", [1, 2]),
        ("I=5\nREPEAT\nP.X=I\nLIN P\nI=I+1\nUNTIL (I>6)", [5, 6]),
        ("I=0\nLOOP\nI=I+1\nIF I==3 THEN\nEXIT\nENDIF\nP.X=I\nLIN P\nENDLOOP", [1, 2]),
        ("IF (1<2) AND NOT (3<2) THEN\nLIN {X 7}\nELSE\nLIN {X 8}\nENDIF", [7]),
        (
            "FOR I=1 TO 4\nSWITCH I\nCASE 1,3\nLIN {X 1}\nCASE 2\nLIN {X 2}\n"
            "DEFAULT\nLIN {X 9}\nENDSWITCH\nENDFOR",
            [1, 2, 1, 9],
        ),
        ("GOTO ON\nLIN {X 5}\nON:\nLIN {X 6}", [6]),
        # Quotients of whole numbers are cut, numbers of REAL stay, INT rounds.
        ("I=7/2\nP.X=I\nLIN P\nR=7\nP.X=R/2\nLIN P\nI=2.5\nP.X=I\nLIN P", [3, 3.5, 3]),
        ("P.X=10*SIN(30)+ABS(-1)+SQRT(4)+ATAN2(1,1)\nLIN P", [5 + 1 + 2 + 45]),
    ],
)
def test_loops_and_branches(read, rows, xs):
    rows = [f"DECL INT I\nREAL R\nDECL POS P\nP=$POS_ACT\n{rows}"]
    assert [x for x, *_ in places(read(krl(*rows)))] == pytest.approx(xs)


def test_arrays_and_structures(read):
    data = "DEFDAT part\nDECL E6POS XP[3]\nXP[1]={X 1,Y 2,Z 3,A 0,B 0,C 180}\n"
    data += "DECL REAL STEP[2,2]\nSTEP[1,2]=0.5\nDECL FRAME F={X 5,Y 6,Z 7}\nENDDAT\n"
    rows = ["INT I", "XP[2]=XP[1]", "XP[2].X=XP[2].X+STEP[1,2]", "XP[3]=F"]
    rows += ["FOR I=1 TO 3", "LIN XP[I] C_DIS", "ENDFOR", "LIN XP[1]"]
    found = places(read(krl(*rows), ".src", data))
    assert found == [(1, 2, 3), (1.5, 2, 3), (5, 6, 7), (1, 2, 3)]


def test_places_that_are_written_out_have_values_of_any_kind(read, faults):
    rows = ["STRUC LAYER INT N,CHAR NAME[8],REAL DEPTH", "INT I", "DECL FRAME S"]
    rows += ['DECL LAYER L={N 7,NAME[] "a",DEPTH .5}', "S={X 4,Y 3,S 'B011'}"]
    rows += ["FOR I=1 TO 2", "LIN {X I*10,Y -L.DEPTH,Z L.N/2}", "ENDFOR", "LIN S"]
    # 7/2 is a quotient of whole numbers.
    assert places(read(krl(*rows))) == [(10, -0.5, 3), (20, -0.5, 3), (4, 3, 3)]
    for row in ("LIN {X 1,Q 2}", "$BASE={X 1,Q 2}", "$TOOL={X 1E11}", "LIN {X W}"):
        assert faults(krl(row))[0][0] == 4


def test_a_line_of_a_new_inline_form_is_read(read):
    data = "DEFDAT part\nDECL E6POS XP5={X 1,Y 2,Z 3,A 0,B 0,C 180}\n"
    data += "DECL LDAT LCPDAT3={VEL 0.1,ACC 100,APO_DIST 100,ORI_TYP #VAR}\nENDDAT\n"
    row = "SLIN XP5 WITH $VEL=SVEL_CP(0.1,,LCPDAT3),$ACC=SACC_CP(LCPDAT3),$ORI_TYPE="
    row += "SORI_TYP(LCPDAT3),$COLLMON_TOL_PRO[1]=USE_CM_PRO_VALUES(0) C_SPL"
    program = read(krl(row), ".src", data)
    assert places(program) == [(1, 2, 3)]
    assert program.moves[-1].feed == pytest.approx(0.1)


def test_frames_in_frames(read):
    # F turns by 90 deg about z: x of what is in it is y above.
    rows = [
        "FRAME F,G",
        "F={X 10,Y 20,Z 0,A 90,B 0,C 0}",
        "G={X 1,Y 2,Z 3,A 0,B 0,C 180}",
    ]
    rows += ["LIN F:G", "LIN F:{X 4,Y 0,Z 0,A 0,B 0,C 180}", "LIN INV_POS(F):F:G"]
    program = read(krl(*rows))
    assert places(program) == [(8, 21, 3), (10, 24, 0), (1, 2, 3)]
    assert program.moves[1].tool_x == pytest.approx((0, 1, 0), abs=1e-12)
    assert program.moves[3].tool_x == pytest.approx((1, 0, 0), abs=1e-12)
    frame = "$BASE=$WORLD:{X 100,Y 0,Z 0,A 0,B 0,C 0}:{Y 5}\nPTP"
    base = read(krl("LIN {X 1}").replace("PTP", frame))
    assert base.work_position == pytest.approx((0.1, 0.005, 0))


def test_routines_take_values_and_give_them_back(read):
    more = "DEF CUT(WHERE:IN,DEPTH:IN,COUNT:OUT)\nPOS WHERE\nREAL DEPTH\nINT COUNT\n"
    more += "DECL POS UP\nUP=WHERE\nUP.Z=DEPTH\nLIN UP\nLIN WHERE\nCOUNT=COUNT+1\nEND\n"
    more += "DEFFCT REAL HALF(V:IN)\nREAL V\nRETURN V/2\nENDFCT\n"
    rows = [
        "POS P",
        "INT N",
        "N=0",
        "P={X 1,Y 0,Z 5,A 0,B 0,C 180}",
        "CUT(P,-HALF(4),N)",
    ]
    rows += ["P.X=P.X+N", "CUT(P,0,N)", "P.X=10*N", "LIN P"]
    found = places(read(krl(*rows, more=more)))
    assert found == [(1, 0, -2), (1, 0, 5), (2, 0, 0), (2, 0, 5), (20, 0, 5)]


def test_what_does_not_move_is_noted_or_passed_over(tmp_path, faults):
    text = krl("WAIT FOR $IN[3]", "SPINDLE_ON(12000)", "$OUT[3]=TRUE", "LIN {X 1}")
    text = text.replace("LIN", "IF $IN[4] THEN\n$OUT[4]=TRUE\nENDIF\nLIN")
    assert faults(text) == [(5, "SPINDLE_ON(12000)")]
    file = tmp_path / "part.src"
    file.write_text(text)
    with pytest.raises(ProgramError, match=r'pass_over = \["SPINDLE_ON"\]'):
        read_program(file)
    program = read_program(file, setup=ProgramSetup(pass_over=("Spindle_On",)))
    assert "line 5: SPINDLE_ON: is passed over, as [program] pass_over says" in (
        program.notes
    )
    assert "line 4: WAIT: changes no path" in program.notes


@pytest.mark.parametrize(
    ("rows", "line", "part"),
    [
        ("LOOP\nI=1\nENDLOOP", None, "carry out more than"),
        ("FOR I=1 TO 1000000000\nR=1\nENDFOR", None, "carry out more than"),
        ("PART()", 4, "deep"),
        ("IF $IN[1] THEN\nLIN {X 1}\nENDIF", 4, "does not state its value"),
        ("FOR I=1 TO 5\nLIN {X 1}", 6, "FOR of line 4 is open"),
        ("LIN XP[4]", 4, "no position"),
        ("DECL REAL M[5000,5000]", 4, "more than 2000000 values"),
        ("LIN Q", 4, "no position"),
        ("LOOP\nM[1]=M\nENDLOOP", 5, "keeps more|40 deep"),
        ("I=F(1)", 7, "calls are in each other more than 100 deep"),
        ("GOTO NOWHERE", 4, "no label NOWHERE"),
        ("PART(1)", 4, "takes 0 value"),
        ("I=F(1,2)", 4, "takes 1 value"),
        ("FOR " + "= " * 20_000, 4, "10000 are allowed"),
        ("GOTO A\nFOR I=1 TO 3\nA:\nLIN_REL {X 1}\nENDFOR", 8, "jump into a loop"),
    ],
)
def test_what_has_no_end_or_no_value_ends_with_its_line(
    read, rows, line, part, monkeypatch
):
    # Fewer, as checks of types at every call, as tests have them, take much time.
    monkeypatch.setattr("diffmill.io._programs.control.MOST_REPEATED", 2000)
    with pytest.raises(ProgramError, match=part) as caught:
        more = "DEFFCT INT F(X:IN)\nRETURN F(X)\nENDFCT" if "F(" in rows else ""
        data = "DECL INT I\nDECL REAL R\nDECL POS P,Q\nDECL REAL M[3]\n"
        read(krl(rows, more=more), ".src", data)
    assert line in (None, caught.value.faults[0].line)
    assert len(caught.value.faults) == 1


def test_a_function_gives_parameters_back_too(read):
    rows = ["INT I,J", "DECL INT N[2]", "I=1", "N[1]=3", "N[2]=4", "J=F(I)+10*I"]
    rows += ["LIN_REL {X 1}", "SUM(N[])", "P={X 0}", "P.X=J", "LIN P", "P.X=N[1]"]
    more = "DEFFCT INT F(K:OUT)\nINT K\nK=5\nRETURN K+1\nENDFCT\n"
    more += "DEF SUM(A[]:OUT)\nINT A[]\nA[1]=A[1]+A[2]\nEND"
    program = read(krl(*rows, "LIN P", more=more), ".src", "DECL POS P\n")
    assert [x for x, _, _ in places(program)][-2:] == [56, 7]


def test_a_job_gives_the_speed_that_a_program_leaves_to_the_controller(tmp_path):
    text = krl("LIN {X 1}", "$VEL.CP=0.1", "LIN {X 2}").replace("$VEL.CP=0.05", "")
    (tmp_path / "part.src").write_text(text)
    with pytest.raises(ProgramError, match=r"there is no speed.*\[program\] feed"):
        read_program(tmp_path / "part.src")
    program = read_program(tmp_path / "part.src", setup=ProgramSetup(feed=0.02))
    assert isinstance(program, Program)
    assert [move.feed for move in program.moves] == [None, 0.02, 0.1]


def test_a_fault_in_a_loop_is_told_once(faults):
    rows = ["INT I", "FOR I=1 TO 9", "LIN XP9", "ENDFOR"]
    assert faults(krl(*rows)) == [(6, "XP9")]


def test_status_and_turn_are_read(read):
    place = "PTP {X 1,Y 2,Z 3,A 10,B 20,C 170,S 'B010',T 'B1'}"
    program = read(krl("LIN {X 5}").replace(START, place))
    assert program.first_angles == pytest.approx((10, 20, 170))
    assert math.isclose(program.moves[0].end[0], 1e-3)
