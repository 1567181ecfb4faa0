"""Programs of robots and planning systems: motion by hand, refusals, round trips."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import interpolate

from diffmill.io import ProgramError, parse_gcode, read_program, write_program
from diffmill.toolpath import Path, Program, reduce_path, sample_program

LIMITS = {"acceleration": 2.0, "rapid_feed": 0.2, "corner_tolerance": 0.0}
MM = 1e-3


def ends(program):
    return [
        ("r" if m.is_rapid else "f", *(round(v / MM, 6) for v in m.end))
        for m in program.moves
    ]


KRL = """&ACCESS RVP
DEF part( )
;FOLD INI
BAS(#INITMOV,0)
$BASE=BASE_DATA[1]
$TOOL=TOOL_DATA[3]
PTP HOME
PTP {X 0,Y 0,Z 5,A 0,B 0,C 180} C_PTP
$VEL.CP=0.05
LIN XP1 C_DIS
WAIT SEC 0.5
CIRC {X 11,Y 1,Z 0},{X 10,Y 2,Z 0}
SPLINE WITH $VEL.CP=0.02
SLIN {X 0}
SLIN {Y 5}
ENDSPLINE
END
"""
DATA = "DEFDAT part\nDECL E6POS XP1={X 10.0,Y 0,Z 0,A 0,B 30,C 180,S 2,T 35}\nENDDAT\n"


def test_krl(read):
    program = read(KRL, ".src", DATA)
    assert ends(program) == [
        ("r", 0, 0, 5),
        ("f", 10, 0, 0),
        ("f", 10, 2, 0),
        ("f", 0, 2, 0),
        ("f", 0, 5, 0),
    ]
    assert [move.feed for move in program.moves] == [None, 0.05, 0.05, 0.02, 0.02]
    assert program.tools == (3,)
    assert program.moves[1].rest == 0.5
    arc = program.moves[2]
    assert arc.centre == pytest.approx((0.01, 0.001, 0.0))
    assert arc.sweep == pytest.approx(math.pi)
    # B turns about y: the shank, which points up, leans by 30 degrees to +x.
    assert program.moves[1].axis == pytest.approx((0.5, 0.0, math.cos(math.pi / 6)))


RAPID = """MODULE part
  CONST robtarget p1:=[[10,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST speeddata slow:=[20,500,5000,1000];
  PROC main()
    ! comment ; with a semicolon
    MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1000,fine,tool0;
    MoveJ Offs(p1,-10,0,5),v500,z10,tool0\\WObj:=wobj1;
    MoveL p1,v50,
      z1,tool0\\WObj:=wobj1;
    WaitTime 0.5;
    MoveC [[11,1,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
      Offs(p1,0,2,0),slow,z1,tool0\\WObj:=wobj1;
    MoveL Offs(p1,-10,2,0),v1000\\T:=0.25,fine,tool0\\WObj:=wobj1;
  ENDPROC
ENDMODULE
"""


def test_rapid(read):
    program = read(RAPID.replace(",tool0;", ",tool0\\WObj:=wobj1;"), ".mod")
    assert ends(program) == [
        ("r", 0, 0, 5),
        ("f", 10, 0, 0),
        ("f", 10, 2, 0),
        ("f", 0, 2, 0),
    ]
    paces = [(move.feed, move.duration) for move in program.moves]
    assert paces == [(None, None), (0.05, None), (0.02, None), (None, 0.25)]
    assert program.moves[1].line == 8
    assert program.moves[1].rest == 0.5
    assert program.moves[2].sweep == pytest.approx(math.pi)
    assert program.moves[2].axis == pytest.approx((0, 0, 1))


APT = """PARTNO/TEST
UNITS/INCHES
LOADTL/4
SPINDL/6000,RPM,CLW
RAPID
GOTO/0,0,1,0,0,1
FEDRAT/10,IPM
GOTO/0,0,0
GOTO/1,0,0,0.6,0,0.8
CIRCLE/1,1,0,0,0,1
GOTO/2,1,0
GODLTA/0,0,$
0.5
DELAY/0.25
FINI
"""


def test_apt(read):
    program = read(APT, ".apt")
    inch = 25.4
    assert ends(program) == [
        ("r", 0, 0, inch),
        ("f", 0, 0, 0),
        ("f", inch, 0, 0),
        ("f", 2 * inch, inch, 0),
        ("f", 2 * inch, inch, 12.7),
    ]
    assert program.moves[1].feed == pytest.approx(10 * inch * MM / 60)
    assert program.moves[2].axis == pytest.approx((0.6, 0, 0.8))
    assert program.moves[3].sweep == pytest.approx(math.pi / 2)
    assert program.moves[4].rest == 0.25
    assert program.tools == (4,)
    assert program.spindle_speed == pytest.approx(200 * math.pi)


KRL_INLINE = """DEF part( )
FDAT_ACT=FP1
PTP {X 0,Y 0,Z 5,A 0,B 0,C 180}
;FOLD LIN P1 Vel=0.1 m/s CPDAT1 Tool[1]:mill Base[2]:part;%{PE}
$BWDSTART=FALSE
LDAT_ACT=LCPDAT1
FDAT_ACT=FP1
BAS(#CP_PARAMS,0.1)
LIN XP1 C_DIS C_DIS
;ENDFOLD
;FOLD SLIN P2 Vel=0.2 m/s CPDAT2 Tool[1] Base[2];%{PE}
SLIN XP2 WITH $VEL = SVEL_CP(0.2, , LCPDAT2), $TOOL = STOOL2(FP2), $ACC = SACC_CP(L)
;ENDFOLD
$VEL={CP 0.3,ORI1 200,ORI2 200}
LIN_REL {X 1,Z -1} C_DIS
LIN_REL {Z 2} #TOOL
XP2.X=9
$VEL.CP=SLOW
LIN XP2
"""
DATA_INLINE = """DEFDAT part
DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0}
DECL E6POS XP2={X 4.0,Y 2.0,Z 3.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}
DECL REAL SLOW=0.05
ENDDAT
"""


def test_inline_forms_and_relative_motion_of_krl(read):
    moves = read(KRL_INLINE + "END\n", ".src", DATA_INLINE).moves
    # The tool of C 180 points down, so that its Z is that of the base with a minus.
    places = [(0, 0, 5), (1, 2, 3), (4, 2, 3), (5, 2, 2), (5, 2, 0), (9, 2, 3)]
    for move, place in zip(moves, places, strict=True):
        assert [v / MM for v in move.end] == pytest.approx(place, abs=1e-9)
    assert [move.feed for move in moves] == [None, 0.1, 0.2, 0.3, 0.3, 0.05]


@pytest.mark.parametrize(
    ("angle", "end", "normal"),
    [(180, (2, 0), -1), (90, (1, 1), -1), (-90, (1, -1), 1), (720, (0, 0), -1)],
)
def test_an_arc_of_krl_over_an_angle(read, angle, end, normal):
    text = (
        f"DEF a( )\nPTP {{X 0}}\n$VEL.CP=1\nCIRC {{X 1,Y 1}},{{X 2,Y 0}},CA {angle}\n"
    )
    arc = read(text + "LIN_REL {X 1}\nEND", ".src").moves[1]
    assert [v / MM for v in arc.end] == pytest.approx((*end, 0), abs=1e-9)
    assert abs(arc.sweep) == pytest.approx(math.radians(abs(angle)))
    assert arc.normal[2] * arc.turn / abs(arc.turn) == pytest.approx(normal)


def test_a_spline_is_the_natural_cubic_one_through_its_points(read):
    rng = np.random.default_rng(3)
    places = rng.uniform(-90, 90, (12, 6)) * [1, 1, 1, 0.3, 0.3, 0.3]
    places[:, 5] += 180
    rows = [
        ",".join(
            f"{name} {value:.6f}" for name, value in zip("XYZABC", row, strict=True)
        )
        for row in places
    ]
    points = "".join(f"SPL {{{row}}}\n" for row in rows[1:])
    text = f"DEF a( )\nPTP {{{rows[0]}}}\n$VEL.CP=1\nSPLINE\n{points}ENDSPLINE\nEND"
    moves = read(text, ".src").moves[1:]
    chords = np.linalg.norm(np.diff(1e-3 * places[:, :3], axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(chords)])
    lines = np.array([move.line for move in moves])
    share = [np.arange(1, n + 1) / n for n in np.unique(lines, return_counts=True)[1]]
    at = np.concatenate([length[k] + chords[k] * part for k, part in enumerate(share)])
    curve = interpolate.CubicSpline(length, 1e-3 * places[:, :3], bc_type="natural")
    np.testing.assert_allclose([move.end for move in moves], curve(at), atol=2e-9)
    for move in moves:
        assert np.linalg.norm(move.axis) == pytest.approx(1)
        assert np.linalg.norm(move.tool_x) == pytest.approx(1)
        assert np.dot(move.axis, move.tool_x) == pytest.approx(0, abs=1e-12)


def test_straight_and_round_pieces_of_a_spline_block_are_exact(read):
    block = "SPLINE\nSPL {X 1,Y 1}\nSPL {X 2,Y 0}\nSLIN {X 3}\n"
    block += "SCIRC {X 4,Y 1},{X 5,Y 0}\nENDSPLINE\nEND"
    *_, line, arc = read(f"DEF a( )\nPTP {{X 0}}\n$VEL.CP=1\n{block}", ".src").moves
    assert [v / MM for v in line.start] == pytest.approx((2, 0, 0))
    assert [v / MM for v in line.end] == pytest.approx((3, 0, 0))
    assert arc.sweep == pytest.approx(math.pi)


RAPID_DATA = """MODULE m
TASK PERS num d:=4;
CONST robtarget p1:=[[1,2,3],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget row{2}:=[[[1,0,5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
  [[2,0,5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]];
VAR robtarget q;
PROC main()
  MoveAbsJ home\\NoEOffs,v500,fine,mill;
  MoveJ p1\\ID:=1,v500,fine,mill\\WObj:=part;
  MoveL RelTool(p1,1,2,3),v50,z1,mill\\WObj:=part;
  MoveL Offs(Offs(p1,d,0,0),0,-d,1),v50,z1,mill\\WObj:=part;
  MoveL RelTool(p1,0,0,0\\Ry:=30\\Rz:=90),v50,z1,mill\\WObj:=part;
  WaitTime\\InPos,0.5;
  MoveL row{2},v50,z1,mill\\WObj:=part;
  q:=p1;
  q.trans.x:=9;
  MoveL q,v50,z1,mill\\WObj:=part;
ENDPROC
ENDMODULE
"""


def test_data_and_tool_frames_of_rapid(read):
    moves = read(RAPID_DATA, ".mod").moves
    # The tool points down: its y and z are those of the work object with a minus.
    places = [(1, 2, 3), (2, 0, 0), (5, -2, 4), (1, 2, 3), (2, 0, 5), (9, 2, 3)]
    for move, place in zip(moves, places, strict=True):
        assert [v / MM for v in move.end] == pytest.approx(place, abs=1e-9)
    assert moves[3].axis == pytest.approx((-0.5, 0.0, math.cos(math.pi / 6)))
    assert moves[3].rest == 0.5


RAPID_MOVE = (
    "MoveL [[{},0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],{},{},{};\n"
)


def rapid_module(*moves, data=""):
    rows = [
        RAPID_MOVE.format(10 * place, *move, *("z0", "tool0")[len(move) - 1 :])
        if isinstance(move, tuple)
        else f"{move};\n"
        for place, move in enumerate(moves)
    ]
    return f"MODULE m\n{data}PROC main()\n{''.join(rows)}ENDPROC\nENDMODULE\n"


def test_speeds_and_times_of_rapid_are_worked_out(read):
    data = "CONST num vCut:=60/6;\nTASK PERS num half:=vcut/020;\n"
    text = rapid_module(
        ("v50",),
        (r"v1000\V:=VCUT",),
        (r"v1000 \V:=(vcut+2)*-half/-1.5",),
        (r"v1000\T:=half",),
        data=data,
    )
    paces = [(move.feed, move.duration) for move in read(text, ".mod").moves[1:]]
    expected = [(0.01, None), (0.004, None), (None, 0.5)]
    assert paces == [pytest.approx(pace) for pace in expected]


def test_velset_of_rapid_sets_the_speeds_but_no_times(read):
    text = rapid_module(
        ("v50",),
        "VelSet 50, top",
        ("v50",),
        (r"v50\V:=300",),
        (r"v50\T:=0.5",),
        "VelSet 100, 5000",
        ("v50",),
        data="CONST num top:=120;\n",
    )
    paces = [(move.feed, move.duration) for move in read(text, ".mod").moves[1:]]
    expected = [(0.025, None), (0.12, None), (None, 0.5), (0.05, None)]
    assert paces == [pytest.approx(pace) for pace in expected]


def test_another_tool_of_rapid_is_another_section(read):
    home = "MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,fine,tool0"
    one = (home, ("v50", "z0", "Mill"), ("v50", "z0", "mill"), home, ("v50", "z0"))
    moves = [*one[:4], ("v50", "z0", "MILL"), ("v50", "z0", "mill")]
    program = read(rapid_module(*moves), ".mod")
    # One tool needs no number, and tool0 moves joints only.
    assert program.tools == (None,)
    assert not any("is tool" in note for note in program.notes)
    moves += [("v50", "z0", "drill"), ("v50", "z0", "drill"), ("v50", "z0", "Mill")]
    program = read(rapid_module(*moves, ("v50", "z0", "saw")), ".mod")
    assert program.tools == (1, 2, 3)
    assert [part.tool for part in program.sections] == [1, 1, 2, 1, 3]
    assert [move.is_rapid for move in program.moves] == [1, 0, 1, 0, 1, 0, 1, 1]
    for note in ("line 4: Mill: is tool 1", "line 9: drill: is tool 2"):
        assert note in program.notes
    # A tool that is new has to be brought to its place before an arc.
    with pytest.raises(ProgramError, match="needs a motion to a stated place"):
        read(RAPID.replace("slow,z1,tool0", "slow,z1,drill"), ".mod")


@pytest.mark.parametrize("end", ["\n", " "])
def test_frames_of_rapid_may_share_a_line_with_moves(read, end):
    text = rapid_module(("v50",), ("v50",), data="%%%\nVERSION:1\n%%%\n")
    text = text.replace("m\n", "m(SYSMODULE, NOVIEW)\n")
    moves = read(text.replace("\n", end), ".mod").moves
    assert [move.end[0] / MM for move in moves] == pytest.approx([0, 10])


def test_return_ends_a_program_of_rapid(read):
    moves = ("v50",), ("v50",), "return"
    program = read(rapid_module(*moves), ".mod")
    assert read(rapid_module(*moves, ("v50",)), ".mod").moves == program.moves
    with pytest.raises(ProgramError, match="which of several routines"):
        read(rapid_module(*moves).replace("main", "a") + "PROC b()\nENDPROC\n", ".mod")


@pytest.mark.parametrize(
    "move",
    [
        (r"v50\V:=fast",),
        (r"v50\V:=0",),
        (r"v50\T:=a-a",),
        (r"v50\T:=Read(1)",),
        "VelSet fast, 5000",
        "VelSet 50",
        "VelSet 0, 5000",
    ],
)
def test_a_speed_of_rapid_that_is_no_number_is_refused(faults, move):
    text = rapid_module(("v50",), move, ("v50",), data="CONST num a:=1;\n")
    assert [line for line, _ in faults(text, ".mod")] == [5]


def test_axes_feeds_and_lines_of_apt(read):
    text = "FROM/0,0,0 $$ start\nTLAXIS/0,0.6,0.8\nSPINDL/1200,CLW\nFEDRAT/0.1,MMPR\n"
    text += (
        "GOTO/10,$ a comment\n0,0\nSPINDL/RPM,600\nCIRCLE/5,0,0,0,0,1,5,.01,.1,8,0\n"
    )
    line, arc = read(text + "GOTO/0,0,0\nFINI", ".apt").moves
    assert line.axis == pytest.approx((0.0, 0.6, 0.8))
    assert line.end == pytest.approx((0.01, 0.0, 0.0))
    assert [line.feed, arc.feed] == pytest.approx([2e-3, 1e-3])
    assert arc.sweep == pytest.approx(math.pi)


def test_a_depth_of_apt_lies_below_the_point_whatever_its_sign(read):
    text = "FEDRAT/300,MMPM\nRAPID\nGOTO/0,0,9\n"
    plain = "CYCLE/DEEP,RAPTO,3.0,FEDTO,20.0,1STPECK,8,SUBPECK,6\nGOTO/5,0,0\n"
    plain += "CYCLE/DRILL,RAPTO,3.0,FEDTO,20.0,RTRCTO,AUTO\nGOTO/9,0,0\n"
    minus = plain.replace("TO,20", "TO,-20").replace("PECK,", "PECK,-")
    program = read(text + minus + "CYCLE/OFF\nFINI", ".apt")
    assert min(end[3] for end in ends(program)) == -20
    assert program.moves == read(text + plain + "CYCLE/OFF\nFINI", ".apt").moves
    assert any("lines 4, 6: FEDTO" in note for note in program.notes)
    assert any("line 4: SUBPECK" in note for note in program.notes)


@pytest.mark.parametrize("word", ["PPRINT/", "partno ", "REMARK$", "INSERT/"])
def test_a_dollar_in_a_text_of_apt_goes_on_nowhere(read, word):
    text = f"FEDRAT/300,MMPM\nGOTO/0,0,0\n{word}costs $ 5, A/B\nGOTO/$\n7,0,0\n"
    assert ends(read(text + "GOTO/9,0,0\nFINI", ".apt"))[1:] == [
        ("f", 7, 0, 0),
        ("f", 9, 0, 0),
    ]


def test_rapid_of_apt_holds_for_one_motion_of_any_kind(read):
    text = "FEDRAT/300,MMPM\nGOTO/0,0,0\nRAPID\n{}\nGOTO/7,0,0\nFINI"
    for one in (
        "CIRCLE/1,0,0,0,0,1,1\nGOTO/2,0,0",
        "CYCLE/DRILL,RAPTO,3,FEDTO,4\nGOTO/2,0,0\nCYCLE/OFF",
        "GODLTA/2,0,0",
    ):
        assert not read(text.format(one), ".apt").moves[-1].is_rapid


H = "PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}"


@pytest.mark.parametrize(
    ("suffix", "text", "line"),
    [
        (".src", "DEF a( )\nFOR I=1 TO 3\nEND", 3),
        (".src", "DEF a( )\nLIN XP9\nEND", 2),
        (".src", "DEF a( )\nPTP {X 1}\nLIN {X 2}\nEND", 3),
        (".src", f"DEF a( )\n$BASE={{X 1}}\n{H}\n$BASE={{X 2}}\n{H}\nEND", 4),
        (".src", "DEF a( )\nPTP {X 1}\n$VEL.CP=1\nCIRC {X 2},{X 3}\nEND", 4),
        (".src", "DEF a( )\nPTP {X 1}\nIF $IN[1] THEN\nLIN {X 3}\nENDIF\nEND", 3),
        (".src", "DEF a( )\n$VEL.CP=1\nLIN_REL {X 1}\nEND", 3),
        (".src", "DEF a( )\n$VEL.CP=FAST\nEND", 2),
        (".mod", "MODULE a\nVAR robtarget q;\nMoveL q,v50,z1,tool0;", 3),
        (".mod", "MODULE a\nPROC main()\nIF a=1 THEN\nENDPROC\nENDMODULE", 4),
        (".mod", "MODULE a\nPROC main()\nMoveL p9,v50,z1,tool0;\nENDPROC", 3),
        (".apt", "PARTNO/A\nGOTO/1,2\n", 2),
        (".apt", "PARTNO/A\nLOOPST\n", 2),
        (".apt", "PARTNO/A\nFEDRAT/0.1,MMPR\n", 2),
        (".apt", "PARTNO/A\nTLAXIS/0,1\n", 2),
        (".apt", "FEDRAT/9\nCYCLE/DRILL,RAPTO,3,FEDTO,0\nGOTO/1,2,3\n", 2),
        (".apt", "FEDRAT/9\nCYCLE/DRILL,RAPTO,3,FEDTO,5,MMPR,0.1\nGOTO/1,2,3\n", 2),
        (".apt", "FEDRAT/9\nCYCLE/DRILL,RAPTO,3,FEDTO,5,ORIENT,9\nGOTO/1,2,3\n", 2),
        (".apt", "MODE/INCR\nGOTO/1,2,4\n", 1),
        (".apt", "GOTO/1,2,4\nCSYS/1,0,0,5,0,1,0,0,0,0,1,0\nGOTO/1,2,3\n", 2),
    ],
)
def test_what_is_no_plain_motion_is_refused(read, suffix, text, line):
    with pytest.raises(ProgramError) as caught:
        read(text, suffix)
    assert caught.value.faults[0].line == line
    assert f"part{suffix}, line {line}" in str(caught.value)


def curved_path(is_tilted=False):
    t = 0.004 * np.arange(600)
    x = 0.05 * t + 2e-4 * np.sin(9 * t)
    positions = np.stack([x, 0.01 * np.sin(2 * t), 1e-3 * np.cos(5 * t)], axis=1)
    path = Path.upright(t, positions)
    if not is_tilted:
        return path
    axes = np.stack([np.sin(0.2 * t), 0 * t, np.cos(0.2 * t)], axis=1)
    return Path(t, positions, axes, path.is_rapid, path.line)


@pytest.mark.parametrize("tolerance", [1e-6, 5e-6, 20e-6])
@pytest.mark.parametrize("is_tilted", [False, True])
def test_few_blocks_keep_the_tolerance_at_every_time(tolerance, is_tilted):
    path = curved_path(is_tilted)
    blocks = reduce_path(path, tolerance)
    time = np.asarray(path.time)
    for points, others, most in [
        (path.positions, blocks.positions, tolerance),
        (path.axes, blocks.axes, 20 * tolerance),
    ]:
        back = [np.interp(time, blocks.time, row) for row in np.asarray(others).T]
        gap = np.linalg.norm(np.stack(back, axis=1) - points, axis=1)
        assert np.max(gap) < 1.01 * most
    # A chord on either side of an arc: its sagitta is two tolerances, a T^2 / 8.
    speed = np.gradient(path.positions, time, axis=0)
    bend = np.linalg.norm(np.gradient(speed, time, axis=0), axis=1)
    fewest = np.sum(np.sqrt(bend / (16 * tolerance))) * 0.004
    assert blocks.step_count - 1 < 1.6 * fewest + 3


@pytest.mark.parametrize("suffix", [".ngc", ".src", ".mod"])
def test_written_path_reads_back_in_position_and_time(read, suffix):
    path = reduce_path(curved_path(), 5e-6)
    text = write_program(path, suffix, header=["made ( here )"])
    program = read(text, suffix)
    period = 0.004
    expected = sample_program(Program.of_path(path), period, **LIMITS)
    back = sample_program(program, period, **LIMITS)
    assert back.step_count == expected.step_count
    gap = np.linalg.norm(np.asarray(back.positions) - expected.positions, axis=1)
    assert np.max(gap) < 5e-9


@pytest.mark.parametrize("is_tilted", [False, True])
def test_a_spline_of_few_points_keeps_the_tolerance_as_it_is_read(read, is_tilted):
    path, tolerance = curved_path(is_tilted), 5e-6
    points = reduce_path(path, tolerance, is_spline=True)
    text = write_program(points, ".src", is_spline=True)
    assert text.count("SPL {") == points.step_count - 1
    back = sample_program(read(text, ".src"), 0.004, **LIMITS)
    assert back.step_count == path.step_count
    for found, expected, most in [
        (back.positions, path.positions, tolerance),
        (back.axes, path.axes, 20 * tolerance),
    ]:
        gap = np.linalg.norm(np.asarray(found) - np.asarray(expected), axis=1)
        assert np.max(gap) < 1.05 * most
    # The cubic nearest to a quartic over T is |p^(4)| T^4 / 384 / 4 off at most.
    speed, step = np.asarray(path.positions), 0.004
    for _ in range(4):
        speed = np.gradient(speed, step, axis=0)
    bend = np.linalg.norm(speed, axis=1)
    fewest = np.sum((bend / (4 * 384 * tolerance)) ** 0.25) * step
    assert points.step_count - 1 < 2.5 * fewest + 3
    with pytest.raises(ValueError, match="is_spline"):
        write_program(points, ".mod", is_spline=True)


@pytest.mark.parametrize("is_spline", [False, True])
def test_a_block_is_rapid_as_a_whole(is_spline):
    given = curved_path()
    is_rapid = np.isin(np.arange(given.step_count), [*range(101, 251), 300, 599])
    path = dataclasses.replace(given, is_rapid=is_rapid)
    points = reduce_path(path, 20e-6, is_spline=is_spline)
    block = np.searchsorted(points.time, given.time[1:])
    np.testing.assert_array_equal(points.is_rapid[block], is_rapid[1:])
    assert points.step_count < 60


def test_a_spline_follows_a_corner_with_more_points():
    time = 0.004 * np.arange(400)
    turned = np.maximum(time - 0.8, 0.0)
    path = Path.upright(time, np.stack([0.05 * time, 0.05 * turned, 0 * time], axis=1))
    points = reduce_path(path, 2e-6, is_spline=True)
    curve = interpolate.CubicSpline(points.time, points.positions, bc_type="natural")
    gap = np.linalg.norm(curve(time) - path.positions, axis=1)
    assert np.max(gap) <= 2.001e-6
    assert points.step_count < 40


@pytest.mark.parametrize("suffix", [".src", ".mod", ".apt"])
def test_tool_axes_read_back(read, suffix):
    path = reduce_path(curved_path(is_tilted=True), 20e-6)
    program = read(write_program(path, suffix), suffix)
    axes = np.array([move.axis for move in program.moves])
    assert axes == pytest.approx(np.asarray(path.axes), abs=1e-7)
    timed = sample_program(program, 0.01, **LIMITS)
    found = np.asarray(timed.axes)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(len(found)))
    assert found[-1] == pytest.approx(np.asarray(path.axes)[-1], abs=1e-6)
    assert np.max(np.abs(np.diff(found, axis=0))) < 0.02
    with pytest.raises(ValueError):
        write_program(path, ".ngc")


@pytest.mark.parametrize("suffix", [".src", ".mod"])
def test_a_tool_that_turns_where_it_stands_reads_back(read, suffix):
    time, lean = 0.5 * np.arange(5), np.array([0.0, 0.0, 0.3, 0.3, 0.3])
    positions = np.outer(np.array([0.0, 1.0, 1.0, 2.0, 3.0]), [0.01, 0.0, 0.0])
    axes = np.stack([np.sin(lean), 0 * lean, np.cos(lean)], axis=1)
    path = Path(time, positions, axes, np.zeros(5, bool), np.zeros(5, np.int32))
    program = read(write_program(path, suffix), suffix)
    ends = np.array([move.end for move in program.moves])
    np.testing.assert_allclose(ends, positions, atol=1e-9)
    turned = np.array([move.axis for move in program.moves])
    np.testing.assert_allclose(turned, axes, atol=1e-7)
    durations = [move.duration for move in program.moves[1:]]
    assert durations == pytest.approx(np.diff(time))


PART = """G21 G90 S6000 M3
G0 X0 Y0 Z5
G1 Z0 F300
G1 X10 F600
G3 X10 Y10 J5
G4 P0.5
G2 X5 Y5 R-5
G18 G2 X0 Z3 R9
G17 G3 X0 Y5 I3 Z4 P2
G0 Z9
M2
"""


@pytest.mark.parametrize("suffix", [".ngc", ".src", ".mod", ".apt"])
def test_a_program_keeps_its_motion_in_every_format(read, suffix):
    program = parse_gcode(PART)
    back = read(write_program(program, suffix, tolerance=1e-7), suffix)
    assert back.path_length == pytest.approx(program.path_length, rel=1e-5)
    assert sum(move.rest for move in back.moves) == 0.5
    one, two = (
        sample_program(p, 0.01, acceleration=1e8, rapid_feed=0.2, corner_tolerance=0.0)
        for p in (program, back)
    )
    rows = min(one.step_count, two.step_count)
    assert abs(one.step_count - two.step_count) <= 2
    gap = np.asarray(one.positions)[:rows] - np.asarray(two.positions)[:rows]
    assert np.max(np.linalg.norm(gap, axis=1)) < 2e-5


def test_spline_of_krl_goes_through_its_points(read):
    t = np.linspace(0.0, 1.0, 21)
    points = np.stack([50 * t, 5 * np.sin(4 * t), 0 * t], axis=1)
    lines = [
        f"SPL {{X {x:.6f},Y {y:.6f},Z 0}}\nTIME_BLOCK PART=5" for x, y, _ in points[1:]
    ]
    text = "DEF a( )\nPTP {X 0,Y 0,Z 0,A 0,B 0,C 180}\nSPLINE\nTIME_BLOCK START\n"
    text += "\n".join(lines).rsplit("\n", 1)[0] + "\nTIME_BLOCK END=1\nENDSPLINE\nEND\n"
    path = sample_program(read(text, ".src"), 0.0125, **LIMITS)
    found = np.asarray(path.positions)
    # Away from the ends, where a natural spline has no bend, it follows the sine.
    assert path.duration == pytest.approx(1.0)
    time = np.asarray(path.time)
    gap = found[:, 1] - 5e-3 * np.sin(4 * time)
    inside = (time > 0.2) & (time < 0.8)
    assert np.max(np.abs(gap[inside])) < 2e-6


@pytest.mark.parametrize(
    ("lines", "speed"),
    [
        ("$VEL.CP = 12.0/60\nLIN {X 10}", 0.2),
        ("V1=6.0\n$VEL.CP=V1/60\nLIN {X 10}", 0.1),
        ("$VEL.CP=0.1*0.5\nLIN {X 10}", 0.05),
        ("$VEL.CP=(0.05)\nLIN {X 10}", 0.05),
        ("V[2]=0.01\nBAS(#VEL_CP,V[2])\nLIN {X 10}", 0.01),
        ("$VEL={VEL: CP 0.05,ORI1 200.0}\nLIN {X 10}", 0.05),
        ("SLIN {X 10} WITH $VEL={CP 0.05}", 0.05),
        ("V1=0.1\nV2=V1/2\nSLIN {X 10} WITH $ACC.CP=2, $VEL.CP=V2 C_SPL", 0.05),
        ("SPLINE WITH $VEL.CP=0.05\nSLIN {X 10}\nENDSPLINE", 0.05),
        ("SPLINE\nSLIN {X 10} WITH $VEL.CP=0.05\nENDSPLINE", 0.05),
        ("SPLINE\nSPL {X 10} WITH $VEL.CP=0.05\nENDSPLINE", 0.05),
    ],
)
def test_speeds_of_krl_are_worked_out_and_hold_where_they_are_said(read, lines, speed):
    text = f"DEF a( )\n{H}\n$VEL.CP=0.3\n{lines}\nLIN {{X 20}}\nEND"
    moves = read(text, ".src").moves
    assert moves[1].feed == pytest.approx(speed)
    is_local = "WITH" in lines
    assert moves[-1].feed == pytest.approx(0.3 if is_local else speed)


@pytest.mark.parametrize(
    "line",
    [
        "$VEL.CP=12/60",
        "$VEL=V3",
        "$VEL.CP=__import__('os')",
        "BAS(#VEL_CP,V9)",
        "SLIN {X 10} WITH $VEL.CP=V9",
        "LIN {X 10,Y 20}\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\nLIN {X 50}",
        "$IPO_MODE=#TCP\nLIN {X 10}",
        "FDAT_ACT=FP2\nLIN {X 10}",
        "BAS(#BASE,5)\nLIN {X 10}",
    ],
)
def test_what_krl_leaves_open_or_changes_for_all_is_refused(faults, line):
    data = "DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}\n"
    data += "DECL FDAT FP2={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n"
    text = f"DEF a( )\nFDAT_ACT=FP1\n{H}\n$VEL.CP=1\n{line}\nEND"
    assert len(faults(text, ".src", data)) == 1


def test_home_of_krl_may_have_a_base_and_a_tool_of_its_own(read):
    data = "DECL FDAT FHOME={TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}\n"
    data += "DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n"
    data += "DECL FDAT FP2={TOOL_NO 3,BASE_NO 2,IPO_FRAME #BASE}\n"
    home = "FDAT_ACT=FHOME\nPTP HOME\n"
    text = f"DEF a( )\n{home}FDAT_ACT=FP1\n{H}\n$VEL.CP=1\nLIN {{X 10}}\n"
    text += f"FDAT_ACT=FP2\n{H}\nLIN {{X 30}}\n{home}END"
    program = read(text, ".src", data)
    assert program.tools == (1, 3)
    assert program.of_tool(3).path_length == pytest.approx(0.03)


def test_a_fault_of_the_data_file_names_it_and_bits_of_a_place_are_read_over(read):
    place = "DECL E6POS XP1={X 1,Y 2,Z 3,A 0,B 0,C 180,S 'B110',T 'H1F'}\n"
    text = f"DEF a( )\n{H}\n$VEL.CP=1\nLIN XP1\nEND"
    assert read(text, ".src", place).moves[1].end == pytest.approx((1e-3, 2e-3, 3e-3))
    with pytest.raises(ProgramError, match=r"part\.dat, line 2"):
        read(text, ".src", place + "DECL E6POS XP2={X 1,Y TWO}\n")


@pytest.mark.parametrize("suffix", [".ngc", ".src", ".mod", ".apt"])
@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("G21 G90 G0 Z5\nG0 X0 Y0\nG1 Z-1 F300\nX10\nM2", ".ngc"),
        ("G21 G90 G0 Z5\nG0 X0 Y0\nG3 X10 Y0 I5 F300\nX0 Y0 I-5\nM2", ".ngc"),
        ("FROM/10,0,5,0,0,1\nFEDRAT/300,MMPM\nGOTO/10,0,0\nGOTO/0,0,0\nFINI", ".apt"),
        ("time_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,10,0,0\n2,10,10,0\n", ".csv"),
        ("G21 G90 G0 X0 Y0 Z5\nG93 G1 X10 F60\nG4 P2\nG1 X20 F60\nM2", ".ngc"),
    ],
)
def test_written_programs_begin_where_the_motion_does_and_rest(
    read, tmp_path, text, kind, suffix
):
    (tmp_path / f"given{kind}").write_text(text)
    given = read_program(tmp_path / f"given{kind}")
    back = read(write_program(given, suffix), suffix)
    program = Program.of_path(given) if isinstance(given, Path) else given
    assert back.path_length == pytest.approx(program.path_length, rel=1e-4)
    start, place = program.timed_moves[0].start, back.timed_moves[0].start
    assert place == pytest.approx(start, abs=1e-9)
    rests = [sum(move.rest for move in one.moves) for one in (program, back)]
    assert rests[0] == rests[1]


@pytest.mark.parametrize("suffix", [".src", ".apt"])
def test_the_tool_turns_evenly_over_an_arc_in_pieces(read, suffix):
    text = "PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}\n$VEL.CP=1\n"
    text += "CIRC {X 5,Y 5},{X 10,Y 0,Z 0,A 0,B 80,C 180}"
    given = read(f"DEF a( )\n{text}\nEND", ".src")
    back = read(write_program(given, suffix, tolerance=1e-5), suffix)
    limits = LIMITS | {"acceleration": 1e6}
    for share in (0.25, 0.5, 0.75):
        axes = []
        for program in (given, back):
            path = sample_program(program, 1e-4, **limits)
            axes.append(np.asarray(path.axes)[round(share * path.step_count)])
        np.testing.assert_allclose(axes[0], axes[1], atol=2e-3)


INCHES = """LOADTL/1
SPINDL/RPM,6000,CLW
RAPID
GOTO/0,0,1
{}
GOTO/0,0,-1
GOTO/2,0,-1
FINI
"""


@pytest.mark.parametrize(
    ("statement", "scale", "note"),
    [
        ("FEDRAT/IPM,20", 25.4, "lengths are inches: as FEDRAT says"),
        ("SPINDL/600\nFEDRAT/.01,IPR", 25.4, "lengths are inches: as FEDRAT says"),
        ("FEDRAT/500,MMPM", 1.0, "lengths are millimetres: as FEDRAT says"),
        ("FEDRAT/500", 1.0, "lengths are millimetres: there is no UNITS"),
        ("UNITS/INCHES\nFEDRAT/20", 25.4, ""),
        ("UNITS/MM\nFEDRAT/20,MMPM", 1.0, ""),
    ],
)
def test_the_unit_of_apt_is_that_of_its_feeds(read, statement, scale, note):
    program = read(INCHES.format(statement), ".cls")
    # The unit holds for what stands before the statement too.
    first, *_, last = (move.end for move in program.moves)
    assert first == pytest.approx((0, 0, scale * 1e-3))
    assert last == pytest.approx((2 * scale * 1e-3, 0, -scale * 1e-3))
    if "20" in statement and scale > 1:
        assert program.moves[-1].feed == pytest.approx(20 * 25.4e-3 / 60)
    notes = [one for one in program.notes if "lengths" in one]
    assert len(notes) == bool(note)
    assert note in "".join(notes)


@pytest.mark.parametrize(
    ("statement", "line"),
    [
        ("UNITS/MM\nFEDRAT/20,IPM", 6),
        ("UNITS/INCHES\nFEDRAT/20,MMPM", 6),
        ("FEDRAT/20,IPM\nFEDRAT/20,MMPM", 6),
        ("UNITS/MM\nFEDRAT/20\nUNITS/INCHES", 7),
        ("UNITS/MM\nFEDRAT/20\nCYCLE/DRILL,RAPTO,1,FEDTO,2,IPM,9\nCYCLE/OFF", 7),
    ],
)
def test_units_of_apt_that_contradict_are_refused(read, statement, line):
    with pytest.raises(ProgramError) as caught:
        read(INCHES.format(statement), ".cls")
    (fault,) = caught.value.faults
    assert fault.line == line
    assert "contradict" in fault.message


@pytest.mark.parametrize(
    "frame", ["CSYS/0,-1,0,5,1,0,0,0,0,0,1,0", "MSYS/5,0,0,1,0,0,0,1,0"]
)
def test_one_frame_for_all_motion_is_work(read, faults, frame):
    text = "UNITS/MM\n{}\nRAPID\nGOTO/0,0,5\n{}\nFEDRAT/100,MMPM\nGOTO/1,2,3\n"
    program = read(text.format(frame, frame), ".cls")
    assert program.moves[-1].end == pytest.approx((1e-3, 2e-3, 3e-3))
    assert "is the frame of all motion, which is taken to be work" in program.notes[0]
    word = frame.split("/")[0]
    pairs = [("", frame), (frame, f"{word}/A")]
    plain = "CSYS/1,0,0,0,0,1,0,0,0,0,1,0"
    pairs += [(frame, plain), (plain, frame)] if word == "CSYS" else []
    for pair in pairs:
        assert [line for line, _ in faults(text.format(*pair), ".cls")] == [5]


def test_a_comment_of_creo_goes_on_as_a_statement_does(read):
    text = "$$* Creo\n$$-> CSYS / {}, 0, 0, 0, $\n   0, 1, 0, 0, $\n   0, 0, 1, 0\n"
    text += "$$-> CUTTER / 10., $\n  2.\n$$ costs 5$\nUNITS / MM\nRAPID\n"
    text += "GOTO / 0, 0, 5\n$$-> END /\nFEDRAT / 120., MMPM\nGOTO / 1, 2, 3\nFINI\n"
    program = read(text.format(1), ".cl")
    assert program.moves[-1].end == pytest.approx((1e-3, 2e-3, 3e-3))
    assert "line 2: CSYS: changes no motion here" in program.notes
    notes = read(text.format(-1), ".cl").notes
    assert "line 2: CSYS: is the frame of all motion" in notes[0]


def test_from_tells_a_place_before_the_motion_of_a_tool(read, faults):
    start = "UNITS/MM\nLOADTL/1\nFROM/0,0,50\nFEDRAT/100,MMPM\nGOTO/0,0,5\n"
    program = read(start + "FROM/0,0,5\nLOADTL/2\nFROM/9,0,5\nGOTO/9,0,1", ".cls")
    assert program.of_tool(2).moves[0].start == pytest.approx((9e-3, 0, 5e-3))
    for text, line in ((start + "FROM/0,0,9\n", 6), ("GODLTA/0,0,-5\nGOTO/1,1,1", 1)):
        assert faults(text, ".cls")[0][0] == line
