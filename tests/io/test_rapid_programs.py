"""RAPID as it is written by hand and by posts: loops, records, calls, by hand."""

import numpy as np
import pytest

from diffmill.io import ProgramError, ProgramSetup, read_program
from diffmill.toolpath import Program

TARGET = "[[{},{},{}],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
DATA = (
    f"CONST robtarget p:={TARGET.format(1, 2, 3)};\nVAR robtarget q;\nVAR num i:=0;\n"
)
DATA += (
    "VAR num r{2,3};\nPERS robtarget row{3};\nVAR speeddata slow:=[40,500,5000,1000];\n"
)
GO = "MoveJ [[0,0,9],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tool0;\n"


def rapid(rows, more=""):
    return f"MODULE m\n{DATA}PROC main()\n{GO}{rows}\nENDPROC\n{more}\nENDMODULE\n"


def to(place):
    return f"MoveL {place},v50,z0,tool0;\n"


def places(program):
    """Ends of the moves behind the first [mm]."""
    return [tuple(np.round(np.array(m.end) * 1e3, 9)) for m in program.moves[1:]]


AT = to("Offs(p,i,0,0)")


@pytest.mark.parametrize(
    ("rows", "xs"),
    [
        (f"FOR k FROM 1 TO 3 DO\ni:=10*k;\n{AT}ENDFOR", [11, 21, 31]),
        (f"FOR k FROM 3 TO 1 DO i:=k; {AT}ENDFOR", [4, 3, 2]),
        (f"FOR k FROM 0 TO 1 STEP 0.5 DO\ni:=k;\n{AT}ENDFOR", [1, 1.5, 2]),
        (f"WHILE i<2 DO\ni:=i+1;\n{AT}ENDWHILE", [2, 3]),
        (
            f"IF i=0 AND NOT i>5 THEN\n{AT}ELSEIF i=1 THEN\nEXIT;\nELSE\nEXIT;\nENDIF",
            [1],
        ),
        (f"IF i<>0 EXIT;\nIF i=0 i:=4;\n{AT}", [5]),
        (
            "FOR k FROM 1 TO 3 DO\nTEST k\nCASE 1,3:\ni:=k;\nDEFAULT:\ni:=7;\n"
            f"ENDTEST\n{AT}ENDFOR",
            [2, 8, 4],
        ),
        (f"IF i=0\nAND i<5 THEN\n{AT}ENDIF", [1]),
        (f"GOTO on;\ni:=5;\non:\n{AT}", [1]),
        (f"i:=7 DIV 2 + 7 MOD 4 + 5/2 + Abs(-1) + Pow(2,3);\n{AT}", [18.5]),
    ],
)
def test_loops_and_branches(read, rows, xs):
    found = [x for x, *_ in places(read(rapid(rows), ".mod"))]
    assert found == pytest.approx(xs)


def test_targets_that_are_written_out_have_expressions(read):
    head = "VAR num m{2,3}:=[[1,2,3],[4,-i+5,+.6e1]];\n"
    rows = f"i:=2;\n{to(TARGET.format('10*i', 'm{2,1}', 'r{1,1}'))}"
    rows += to("[[m{2,2},m{2,3},1.],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]")
    assert places(read(rapid(head + rows), ".mod")) == [(20, 4, 0), (5, 6, 1)]


def test_motions_that_set_signals_go_where_others_go(read):
    place = [TARGET.format(x, y, 9) for x, y in [(5, 5), (0, 10), (7, 3), (8, 4)]]
    rows = "VAR triggdata on;\nActUnit STN1;\nTriggIO on,5\\DOp:=do1,1;\n"
    rows += f"TriggC {place[0]},{place[1]},v50,on\\T2:=on,z1,tool0\\WObj:=wobj0;\n"
    rows += f"TriggL {place[2]},v50,on,z1,tool0;\n"
    rows += f"MoveLDO {place[3]},v50,z1,tool0\\WObj:=wobj0,do1,1;\nDeactUnit STN1;\n"
    program = read(rapid(rows), ".mod")
    assert places(program) == [(0, 10, 9), (7, 3, 9), (8, 4, 9)]
    # From (0, 0) over (5, 5) to (0, 10): half a circle about (0, 5).
    assert program.moves[1].centre == pytest.approx((0, 5e-3, 9e-3))
    assert program.moves[-1].feed == pytest.approx(0.05)


def test_arrays_take_others_and_lists(read):
    rows = "row:=[p,Offs(p,1,0,0),p];\nr:=[[1,2,3],[4,5,6]];\nrow{3}:="
    rows += f"{TARGET.format('r{2,3}', 0, 9)};\n{to('row{2}')}{to('row{3}')}"
    assert places(read(rapid(rows), ".mod")) == [(2, 2, 3), (6, 0, 9)]
    with pytest.raises(ProgramError, match="needed are 3 values of robtarget"):
        read(rapid("row:=[p,p];\n"), ".mod")


def test_arrays_and_records(read):
    rows = "q:=p;\nq.trans.x:=q.trans.x+0.5;\nr{2,3}:=4;\nq.trans.z:=r{2,3};\n"
    rows += (
        f"row{{1}}:=q;\nrow{{2}}:=Offs(q,1,0,0);\nrow{{3}}:={TARGET.format(7, 8, 9)};\n"
    )
    rows += "q.trans:=[5,6,7];\nFOR k FROM 1 TO Dim(row,1) DO\n"
    rows += f"{to('row{k}')}ENDFOR\n{to('q')}"
    rows += (
        "slow.v_tcp:=30;\nMoveL p,slow,z0,tool0;\nMoveL\\Conc,q,[20,1,1,1],z0,tool0;"
    )
    program = read(rapid(rows), ".mod")
    expected = [(1.5, 2, 4), (2.5, 2, 4), (7, 8, 9), (5, 6, 7), (1, 2, 3), (5, 6, 7)]
    assert places(program) == expected
    assert [move.feed for move in program.moves[-2:]] == pytest.approx([0.03, 0.02])


def test_an_input_that_decides_on_no_motion_is_noted(read):
    rows = f"IF TestDI(di1) THEN\nWaitDI di1,0;\nENDIF\n{AT}IF di2=1 SetDO do1,1;\n"
    program = read(
        rapid(rows + "WHILE DInput(d)=0 DO\nWaitTime 0.1;\nENDWHILE"), ".mod"
    )
    assert places(program) == [(1, 2, 3)]
    sentence = "is not known, and decides on nothing that moves"
    assert len([note for note in program.notes if sentence in note]) == 3


def test_routines_take_values_and_give_them_back(read):
    more = (
        "PROC cut(robtarget at,num depth,INOUT num count\\switch twice)\nVAR num k;\n"
    )
    more += "k:=half(depth);\nMoveL Offs(at,0,0,-2*k),v50,z0,tool0;\ncount:=count+1;\n"
    more += "RETURN;\ncount:=99;\nERROR\nRETRY;\nENDPROC\n"
    more += (
        "FUNC num half(num v)\nRETURN v/2;\nENDFUNC\nPROC up()\n" + to("p") + "ENDPROC"
    )
    rows = f"cut p,4,i;\nup;\ncut Offs(p,i,0,0),half(4)-1,i\\twice;\n{AT}"
    found = places(read(rapid(rows, more), ".mod"))
    assert found == [(1, 2, -1), (1, 2, 3), (2, 2, 2), (3, 2, 3)]


def test_modules_beside_it_are_used(tmp_path):
    (tmp_path / "main.mod").write_text(
        rapid("SyncMoveOn s,t;\npath_10;\nSyncMoveOff s;")
    )
    path = (
        f"MODULE paths\nPROC path_10()\n{to(TARGET.format(4, 5, 6))}ENDPROC\nENDMODULE"
    )
    (tmp_path / "paths.mod").write_text(path)
    program = read_program(tmp_path / "main.mod")
    assert places(program) == [(4, 5, 6)]
    assert any("paths.mod: is used too" in note for note in program.notes)
    (tmp_path / "paths.mod").unlink()
    with pytest.raises(ProgramError, match=r'pass_over = \["path_10"\]'):
        read_program(tmp_path / "main.mod")
    setup = ProgramSetup(pass_over=("PATH_10",))
    (tmp_path / "main.mod").write_text(rapid("path_10;\n" + AT))
    program = read_program(tmp_path / "main.mod", setup=setup)
    assert isinstance(program, Program) and len(program.moves) == 2


@pytest.mark.parametrize(
    ("rows", "part"),
    [
        ("WHILE TRUE DO\ni:=1;\nENDWHILE", "carry out more than"),
        ("main;", "deep"),
        (f"IF DInput(di1)=1 THEN\n{AT}ENDIF", "no such function"),
        ("i:=row{4}.trans.x;", "allowed is 1 to 3"),
        ("VAR robtarget much{200000};", "more than 2000000 values"),
        (to("q2"), "does not state its value"),
        (f"q:={TARGET.format(1, 2, '3,4')};", "3 components, not 4"),
        (AT + "ENDPROC\nENDMODULE\nMODULE b\nCONST num w:=v;\nPROC b()", "its value"),
        ("WHILE TRUE DO\ni:=[i];\nENDWHILE", "in each other more than 40 deep"),
        ("IF TRUE " * 1200 + "i:=1;", "has no other one in it"),
        ("main 5;", "takes 0 value"),
        ("FOR i FROM " + "TO " * 9000, "10000 are allowed"),
        ("cut_it 5;", 'pass_over = \\["cut_it"\\]'),
    ],
)
def test_what_has_no_end_or_no_value_is_refused(read, rows, part, monkeypatch):
    monkeypatch.setattr("diffmill.io._programs.control.MOST_REPEATED", 2000)
    with pytest.raises(ProgramError, match=part) as caught:
        read(rapid(rows), ".mod")
    assert len(caught.value.faults) == 1


def test_a_routine_leaves_the_values_of_its_caller_as_they_are(read):
    rows = "VAR robtarget r:=p;\nr.trans.x:=50;\nmove_it p;\n" + to("p") + to("r")
    more = "PROC move_it(robtarget at)\nat.trans.x:=90;\n" + to("at") + "ENDPROC"
    assert [x for x, _, _ in places(read(rapid(rows, more), ".mod"))] == [90, 1, 50]


def test_a_function_gives_parameters_back_and_a_counter_hides_a_variable(read):
    rows = "i:=7;\nFOR i FROM 1 TO 2 DO\n" + AT + "ENDFOR\n" + AT
    rows += "i:=five(i)+10*i;\nIncr i;\nAdd i,2*3;\n" + AT + "Decr i;\nClear i;\n" + AT
    more = "FUNC num five(INOUT num k)\nk:=5;\nRETURN k+1;\nENDFUNC\n"
    xs = [x for x, _, _ in places(read(rapid(rows, more), ".mod"))]
    assert xs == [2, 3, 8, 64, 1]


RECORDS = f"""MODULE m
LOCAL RECORD part
  robtarget at;
  num depth;
  string kind;
ENDRECORD
RECORD pair
  part a; part b;
ENDRECORD
VAR pair p;
CONST part q:=[{TARGET.format(1, 2, 3)},4,"a;!b"];
VAR string s:="x";
PROC main()
VAR part list{{2}};
p.a:=q;
p.b.at:=q.at;
p.b.at.trans:=[5,6,7];
p.b.depth:=2;
list{{2}}:=p.b;
MoveJ p.a.at,v50,fine,tool0;
%s
ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (to("Offs(list{2}.at,0,0,-list{2}.depth)"), [(5, 6, 5)]),
        ('p.a:=[p.b.at,1,""];\n' + to("p.a.at"), [(5, 6, 7)]),
        ('s:=s+"y";\nIF s="xy" AND p.a.kind="a;!b" ' + to("list{2}.at"), [(5, 6, 7)]),
        ('IF s="y" Stop;\nIF s="x" p.a.at.trans.x:=9;\n' + to("p.a.at"), [(9, 2, 3)]),
        ('IF NumToStr(4,1)+StrPart("abc",2,1)="4.0b" ' + to("p.b.at"), [(5, 6, 7)]),
        ('TPWrite "end; ! here";\nIF StrLen(p.b.kind)=0 ' + to("p.b.at"), [(5, 6, 7)]),
    ],
)
def test_records_and_strings_of_a_program(read, rows, expected):
    assert places(read(RECORDS % rows, ".mod")) == expected


def test_a_record_with_other_components_is_refused(read):
    with pytest.raises(ProgramError, match="a part has 3 components, not 2"):
        read(RECORDS % "p.a:=[p.b.at,1];", ".mod")
    with pytest.raises(ProgramError, match=r"line 3: .* is a type and a name"):
        read(RECORDS.replace("robtarget at;", "robtarget;") % "", ".mod")


@pytest.mark.parametrize(
    ("rows", "feed"),
    [
        ("slow:=v200;", 0.2),
        ("slow:=v200;\nslow.v_tcp:=slow.v_tcp/4;", 0.05),
        ("slow:=vmax;", 5.0),
    ],
)
def test_predefined_speeds_and_zones_are_values(read, rows, feed):
    rows = f"VAR zonedata near;\nnear:=z50;\n{rows}\n" + to("p").replace("v50", "slow")
    assert read(rapid(rows), ".mod").moves[-1].feed == pytest.approx(feed)
