"""Large and hostile programs: bounded time and memory, and the speed of plain lines."""

import time

import pytest
from helpers import python

from diffmill.io import (
    ProgramError,
    parse_gcode,
    read_path_csv,
    read_program,
    write_program,
)
from diffmill.toolpath import Program

# Processor time for a refusal [s].
QUICK = 5.0
# Largest memory of a program that is read, per line [B].
LINE_MEMORY = 2000


def refused(read):
    """Return the message of a refusal that takes little time."""
    begin = time.process_time()
    with pytest.raises(ValueError) as caught:
        read()
    assert time.process_time() - begin < QUICK
    message = str(caught.value)
    assert len(message) < 3000
    return message


@pytest.mark.parametrize("suffix", [".ngc", ".src", ".mod", ".apt", ".csv"])
def test_a_line_of_a_gigabyte_is_refused_before_it_is_read(tmp_path, suffix):
    file = tmp_path / f"long{suffix}"
    with file.open("wb") as out:
        out.truncate(1 << 30)
    read = read_path_csv if suffix == ".csv" else read_program
    assert "250 MB" in refused(lambda: read(file))


@pytest.mark.parametrize(
    "text",
    [
        "G0 X1 Y1 Z5\nG81 X1 R2 Z0 L999999999 F9",
        "G0 X1 Y1 Z5\nG83 X1 R2 Z0 Q.0000001 F9",
        "G0 X1\n" + "(" * 9_000,
        "G3 I1 P1e9 F1",
    ],
)
def test_endless_constructions_are_refused(text):
    refused(lambda: parse_gcode(text))


def test_a_robot_program_without_an_end_of_its_statement(tmp_path):
    file = tmp_path / "open.mod"
    file.write_text("MODULE a\nPROC main()\n" + "MoveL [[1,\n" * 50_000)
    refused(lambda: read_program(file))
    file = tmp_path / "deep.apt"
    file.write_text(
        "CYCLE/DEEP,FEDTO,9,1STPECK,.0000001,SUBPECK,.0000001,RAPTO,1\nGOTO/1,1,1\n"
    )
    refused(lambda: read_program(file))


@pytest.mark.parametrize("suffix", [".ngc", ".mod", ".src", ".apt"])
def test_a_program_is_never_cut_short(tmp_path, suffix):
    file = tmp_path / f"long{suffix}"
    file.write_text("\n" * 2_000_001)
    with pytest.raises(ProgramError, match="more than 2000000 lines"):
        read_program(file)


BLANKS, BRACES = " " * 60_000, "{" * 60_000


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".src", f"DEF a()\nLIN {{X 1, Y 2, Z {BLANKS}}}\nEND\n"),
        (".src", f"DEF a()\nCIRC {{X 1}},{BLANKS}{{X 2}} {{X 3}}\nEND\n"),
        (".src", f"DEF a()\nLIN {{X 1, Y 2, Z 3}}{BRACES}\nEND\n"),
        (".src", f"DEF a()\nDECL {'DECL ' * 12_000}\nLIN {{Q 1}}\nEND\n"),
        (".src", "DEF a()\n" + f"STRUC s {'a b , ' * 1600}!\n" * 9 + "END\n"),
        (".src", f"DEF a()\nSTRUC s REAL {'a' * 9000}, {'b' * 900}!\nEND\n"),
        (".apt", f"GOTO/{'1,' * 1_000_000}1\n"),
        (".mod", f"MODULE m\nPROC main()\nMoveL Offs(p,{BLANKS}),v1,z1,t;\n"),
        (".apt", f"GOTO/1,2,{BLANKS}\n"),
        (".ngc", f"G1 X1 {BLANKS} Y\n"),
    ],
)
def test_long_lines_of_one_sign_are_refused_in_little_time(tmp_path, suffix, text):
    file = tmp_path / f"long{suffix}"
    file.write_text(text)
    refused(lambda: read_program(file))


def rapid(head, body=""):
    return f"MODULE m\n{head}PROC main()\n{body}ENDPROC\nENDMODULE\n"


ARRAYS = "".join(f"CONST robtarget a{k}{{100000}};\n" for k in range(100))
E6POS = "".join(f"DECL E6POS a{k}[200000]\n" for k in range(100))
FORS = "".join(f"FOR i{k} FROM 1 TO 9 DO\n" for k in range(300)) + "ENDFOR\n" * 300


@pytest.mark.parametrize(
    ("suffix", "text", "part"),
    [
        (".mod", rapid(ARRAYS), 'line 2: found "A0": the program keeps more than'),
        (".mod", rapid("", "VAR num a{1,1,1,1};\n"), "3 dimensions at most"),
        (".mod", rapid("", FORS), "line 102: blocks are in each other more than 100"),
        (".mod", rapid("", "ENDIF\n" * 100_000), "line 3: there is no IF"),
        (".src", f"DEF a()\n{E6POS}END\n", 'line 2: found "A0": the program keeps'),
        (".src", "DEF a()\nDECL REAL b[3,0]\nEND\n", "a whole number from 1"),
        (".src", "DEF a()\n" + "IF TRUE THEN\n" * 100_000, "line 102: blocks are in"),
        (".src", "DEF a()\n" + "ENDIF\n" * 100_000, "line 2: there is no IF"),
        (".ngc", "#1=1\n" + "o1 if [\n" * 100_000, "line 2"),
        (".ngc", "#1=1\n" + "o1 endif\n" * 100_000, "line 2"),
    ],
)
def test_values_blocks_and_faults_without_end_are_bounded(tmp_path, suffix, text, part):
    file = tmp_path / f"many{suffix}"
    file.write_text(text)
    assert part in refused(lambda: read_program(file))


@pytest.mark.parametrize("value", [f"{'1+' * 300}1", f"[{'w,' * 300}1]"])
def test_an_expression_has_a_bounded_number_of_values(tmp_path, value, monkeypatch):
    monkeypatch.setattr("diffmill.io._programs.expressions.MOST_OPERANDS", 300)
    file = tmp_path / "many.mod"
    file.write_text(rapid(f"VAR num a:={value};\n"))
    assert "line 2" in (message := refused(lambda: read_program(file)))
    assert "an expression has more than 300 values" in message


BOUND = """
import time
from diffmill.io import ProgramError
from diffmill.io import read_program
begin = time.process_time()
try:
    read_program("bound.mod")
except ProgramError as error:
    print(time.process_time() - begin, error)
"""
LOOP = "FOR i FROM 1 TO 100000 DO\n{}\nENDFOR\n"


READ = """
import time
from diffmill.io import read_program
begin = time.process_time()
print(len(read_program("{}").moves), time.process_time() - begin)
"""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".mod", ".src"])
def test_many_declared_places_are_read_in_little_time(tmp_path, suffix):
    # Declarations of 4 MB in one line, or 10 MB in many; apart, as the million lines.
    target, count = TARGET.format("5.5"), 71_000
    head = f"CONST robtarget p{{{count}}}:=[{','.join([target] * count)}];\n"
    (tmp_path / "part.mod").write_text(
        rapid(head, "MoveJ p{1},v9,fine,tool0;\nMoveL Offs(p{2},5,0,0),v9,z1,tool0;\n")
    )
    rows = "\n".join(
        f"DECL E6POS P{k}={{X {k}.5,Y 2,Z 3,A 0,B 0,C 180,S 2,T 35,E1 0,E2 0}}"
        for k in range(130_000)
    )
    (tmp_path / "part.dat").write_text(f"DEFDAT part\n{rows}\nENDDAT\n")
    (tmp_path / "part.src").write_text("DEF part()\n$VEL.CP=1\nPTP P0\nLIN P1\nEND\n")
    code = READ.format(f"part{suffix}")
    moves, spent = python(code, cwd=tmp_path, check=True).stdout.split()
    assert moves == "2" and float(spent) < 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("head", "row", "part"),
    [
        ("VAR num a{500,200};\nVAR num b{500,200};\n", "a:=b;", "line 6"),
        ("VAR num a{90000};\nPROC f(num x{*})\nENDPROC\n", "f a;", "copy more than"),
        ("VAR num y;\n", f"y:={'+'.join(['y'] * 2000)};", "more than 250000 lines"),
    ],
)
def test_long_lines_and_large_values_in_loops_are_bounded(tmp_path, head, row, part):
    # Apart, as the million lines below.
    (tmp_path / "bound.mod").write_text(rapid(head, LOOP.format(row)))
    spent, _, message = python(BOUND, cwd=tmp_path, check=True).stdout.partition(" ")
    assert part in message and float(spent) < 10.0


SPEED = """
import resource, time
from diffmill.io import parse_gcode
def spent(count):
    rows = [f"G1 X{k % 97}.25 Y{k % 89}.5 Z-{k % 7}.125" for k in range(count)]
    text = "G21 G90 G94\\nG0 X0 Y0 Z9\\nF1000\\n" + "\\n".join(rows)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    program = parse_gcode(text)
    seconds = time.process_time() - begin
    used = 1e3 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert len(program.moves) == count + 1
    return seconds, used
few = sum(spent(100_000)[0] for _ in range(3))
print(few / 3, *spent(1_000_000))
"""


@pytest.mark.slow
def test_a_million_lines_take_as_long_for_each_as_fewer():
    # Apart: checks of types at every call, as tests have them, take ten times as long.
    few, many, used = map(float, python(SPEED, check=True).stdout.split())
    print(f"{many:.1f} s of processor time, {used / 1e9:.2f} GB for a million lines")
    # The same machine in the same run: a time for each line that grows is a regression.
    assert many < 1.5 * 10 * few
    assert used < 1e6 * LINE_MEMORY


POSE = ",A 0,B 0,C 180}"
TARGET = "[[{},0,1],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
KRL = "DEF a()\n$VEL.CP=0.1\nPTP {X 0,Y 0,Z 1,A 0,B 0,C 180}\n%s\nLIN {X 9}\nEND\n"
MODULE = f"MODULE a\nPROC main()\nMoveJ {TARGET.format(0)},v50,fine,tool0;\n%s\n"
MODULE += f"MoveL {TARGET.format(9)},v50,fine,tool0;\n"
APT = "UNITS/MM\nSPINDL/900,CLW\nFEDRAT/100,MMPM\nFROM/0,0,5\n%s\nGOTO/9,0,5\nFINI\n"
GCODE = "G0 X0 Y0 Z5\nG1 Z1 F60\n\n%s\nG1 X9\n"
DIGITS = "1" * 400


@pytest.mark.parametrize(
    ("suffix", "statement", "part"),
    [
        (".ngc", "G4 P-1", "a rest of -1 s"),
        (".ngc", "G4 P2E6", "E is not supported"),
        (".ngc", "G4 P2000000", "a rest of 2e+06 s"),
        (".ngc", "G2 I150000", "the centre of an arc at x = 150 m"),
        (".ngc", "G1 X90000\nG3 X90000 Y1 I6000 J.5", "a point of an arc at x = 102 m"),
        (".ngc", "G2 I1 P20000", "turns 10000 times at most"),
        (".ngc", "G91 G81 X40000 Z-1 R1 L3\nG90 G80", "a position at x = 120 m"),
        (".ngc", "G93 G1 X1 F.00001\nG94 F60", "a motion of 6e+06 s"),
        (".src", "WAIT SEC -1", "a rest of -1 s"),
        (".src", "WAIT SEC 1E400", "a rest of inf s"),
        (".src", "$VEL.CP=1E400", "a speed is above 0"),
        (".src", "$VEL.CP=1E9", "a feed of 6e+13 mm/min"),
        (".src", "LIN {X 1E400" + POSE, "a number is 1e+10 at most"),
        (".src", f"LIN {{X {DIGITS}" + POSE, "300 digits at most"),
        (".src", "LIN {X 1E6" + POSE, "a position at x = 1000 m"),
        (".src", "LIN {X 1,A 1E300,B 0,C 0}", "a number is 1e+10 at most"),
        (".src", "CIRC {X 1,Y 1},{X 2},CA 1E400", "an angle other than 0"),
        (".src", f"$TOOL=TOOL_DATA[{DIGITS}]", "300 digits at most"),
        (".mod", "WaitTime -1;", "a rest of -1 s"),
        (".mod", f"MoveL {TARGET.format('1E400')},v50,fine,tool0;", "17 numbers"),
        (".mod", f"MoveL {TARGET.format('nan')},v50,fine,tool0;", "17 numbers"),
        (".mod", f"MoveL {TARGET.format('1E6')},v50,fine,tool0;", "x = 1000 m"),
        (".mod", f"MoveL {TARGET.format(5)},v{DIGITS},fine,tool0;", "300 digits"),
        (".mod", f"MoveL {TARGET.format(5)},v5\\T:=2E6,fine,tool0;", "of 2e+06 s"),
        (".mod", f"MoveL {'Offs(' * 11}p{',1,0,0)' * 11},v5,z1,tool0;", "deeper than"),
        (".mod", f"MoveL {TARGET.format(5)},v50\\V:={'(' * 11}5{')' * 11},fine,tool0;",
         "deeper than 10"),
        (".mod", f"MoveL {TARGET.format(5).replace('0,1,0,0', '0,1E-200,0,0', 1)},v50,"
         "fine,tool0;", "no length"),
        (".apt", "DELAY/-1", "a rest of -1 s"),
        (".apt", "CYCLE/DRILL,RAPTO,1,FEDTO,2,DWELL,-2\nGOTO/1,1,1", "a rest of -2 s"),
        (".apt", "GOTO/1E400,0,0", "3 numbers up to 1e+10"),
        (".apt", "GOTO/1E6,0,0", "a position at x = 1000 m"),
        (".apt", "CIRCLE/150000,0,5,0,0,1,150000\nGOTO/0,0,5", "x = 150 m"),
        (".apt", "SPINDL/1E9", "0 and 1e+06 rpm"),
        (".apt", "FROM/1E6,0,0", "a position at x = 1000 m"),
    ],
)  # fmt: skip
def test_numbers_pass_one_gate_in_every_language(tmp_path, suffix, statement, part):
    texts = {".ngc": GCODE, ".src": KRL, ".mod": MODULE, ".apt": APT}
    file = tmp_path / f"part{suffix}"
    file.write_text(texts[suffix] % statement)
    with pytest.raises(ProgramError) as caught:
        read_program(file)
    first = caught.value.faults[0]
    assert part in first.message
    begun = 5 if suffix == ".apt" else 4
    assert begun <= first.line <= begun + 1
    # What can be said is said, and nothing else is wrong because of it.
    (tmp_path / f"good{suffix}").write_text(texts[suffix] % "")
    read_program(tmp_path / f"good{suffix}")


def test_ten_brackets_are_not_too_deep(tmp_path):
    file = tmp_path / "part.mod"
    offset = "Offs(" * 8 + TARGET.format(0) + ",1,0,0)" * 8
    file.write_text(MODULE % f"MoveL {offset},v50,fine,tool0;")
    program = read_program(file)
    assert isinstance(program, Program)
    assert program.moves[1].end == pytest.approx((8e-3, 0, 1e-3))


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".ngc", "G0 X0 Y0 Z5\nG83 X1 Z-99 R1 Q.0002 F60\nX2"),
        (".ngc", "G0 X0 Y0 Z5\nG83 X1 Z-9 R1 Q.00001 F60"),
        (".ngc", "G0 X0 Y0 Z5\nG91 G81 X.0001 Z-9 R1 L9000000 F60"),
        (".apt", "UNITS/MM\nGOTO/0,0,5\nFEDRAT/9\nCYCLE/DEEP,RAPTO,1,FEDTO,9,1STPECK,1,"
         "SUBPECK,1E-300\nGOTO/1,1,1\n"),
    ],
)  # fmt: skip
def test_cycles_make_a_bounded_number_of_moves(tmp_path, suffix, text, monkeypatch):
    # Fewer, so that the ones that are made before take no time.
    monkeypatch.setattr("diffmill.io._programs.move_list.MOST_CYCLE_MOVES", 2000)
    file = tmp_path / f"part{suffix}"
    file.write_text(text)
    assert "cycles make more than 2000 moves" in refused(lambda: read_program(file))


def test_many_short_moves_are_refused_in_the_end(monkeypatch):
    monkeypatch.setattr("diffmill.io._programs.move_list.MOST_MOVES", 2000)
    rows = "".join(f"X{k % 7}\n" for k in range(2001))
    message = refused(lambda: parse_gcode("G1 F60\n" + rows))
    assert "line 2001: the program makes more than 2000 moves" in message


CURVES = """
import sys, time
from diffmill.io import read_program
begin = time.process_time()
moves = read_program(sys.argv[1]).moves
print(len(moves), time.process_time() - begin)
"""


@pytest.mark.slow
@pytest.mark.parametrize("count", [99_000, 3])
def test_splines_take_about_as_long_as_lines(tmp_path, count):
    # In one block, or in blocks of three points.
    places = [f"{{X {k % 900},Y {k * 1e-3},Z {k % 7 * 1e-3}}}\n" for k in range(99_000)]
    head, spent = "DEF a()\n$VEL.CP=1\nPTP {X 1,Y -1,Z 1}\n", []
    rows = [f"SPL {place}" for place in places]
    ends = range(count, len(rows) + 1, count)
    blocks = [f"SPLINE\n{''.join(rows[end - count : end])}ENDSPLINE\n" for end in ends]
    for body in ([f"LIN {place}" for place in places], blocks):
        file = tmp_path / "curve.src"
        file.write_text(f"{head}{''.join(body)}END\n")
        code = CURVES.replace("sys.argv[1]", repr(str(file)))
        done = python(code, check=True).stdout.split()
        spent.append(float(done[1]) / max(int(done[0]), 99_000))
    assert spent[1] < 3 * spent[0]


def test_splines_of_too_many_pieces_are_refused_before_they_are_made(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("diffmill.io._programs.move_list.MOST_CYCLE_MOVES", 1000)
    points = "".join(f"SPL {{X {k % 90},Z {k % 7 * 30}}}\n" for k in range(40))
    file = tmp_path / "curve.src"
    text = f"DEF a()\n$VEL.CP=1\nPTP {{X 1}}\nSPLINE\n{points}ENDSPLINE\nEND"
    file.write_text(text)
    message = refused(lambda: read_program(file))
    assert "line 45: the pieces of splines make more than 1000 moves" in message


def test_an_arc_of_too_many_pieces_is_not_cut_short():
    program = parse_gcode("G0 X0 Y0 Z0\nG2 I10 P9999 Z-1 F60\n")
    with pytest.raises(ValueError, match=r"line 2: the arc takes \d+ straight pieces"):
        write_program(program, ".apt", tolerance=1e-9)
