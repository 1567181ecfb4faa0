"""Large and hostile programs: bounded time and memory, and the speed of plain lines."""

import subprocess
import sys
import time

import pytest

from diffmill.io import ProgramError, parse_gcode, read_path_csv, read_program

# Processor time for a refusal [s].
QUICK = 3.0
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
        "G0 X1\n" + "X" * 200_000,
        "G0 X1\n" * 2_000_001,
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


@pytest.mark.parametrize("suffix", [".mod", ".src", ".apt"])
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
        (".mod", f"MODULE m\nPROC main()\nMoveL Offs(p,{BLANKS}),v1,z1,t;\n"),
        (".apt", f"GOTO/1,2,{BLANKS}\n"),
        (".ngc", f"G1 X1 {BLANKS} Y\n"),
    ],
)
def test_long_lines_of_one_sign_are_refused_in_little_time(tmp_path, suffix, text):
    file = tmp_path / f"long{suffix}"
    file.write_text(text)
    refused(lambda: read_program(file))


SPEED = """
import resource, time
from diffmill.io import parse_gcode
rows = [f"G1 X{k % 97}.25 Y{k % 89}.5 Z-{k % 7}.125" for k in range(1_000_000)]
text = "G21 G90 G94\\nG0 X0 Y0 Z9\\nF1000\\n" + "\\n".join(rows)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
begin = time.process_time()
program = parse_gcode(text)
spent = time.process_time() - begin
used = 1e3 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
print(len(program.moves), spent, used)
"""


@pytest.mark.slow
def test_a_million_lines_take_less_than_a_minute():
    # Apart: checks of types at every call, as tests have them, take ten times as long.
    run = subprocess.run(
        [sys.executable, "-c", SPEED], capture_output=True, text=True, check=True
    )
    count, spent, used = (float(word) for word in run.stdout.split())
    print(f"{spent:.1f} s of processor time, {used / 1e9:.2f} GB for a million lines")
    assert count == 1_000_001
    assert spent < 60.0
    assert used < 1e6 * LINE_MEMORY


def test_error_lists_at_most_twenty_faults():
    with pytest.raises(ProgramError) as caught:
        parse_gcode("G62\n" * 100)
    assert len(caught.value.faults) == 20
