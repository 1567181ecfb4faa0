"""`diffmill new`: a job for a program, what it lacks, and what the user is asked."""

import sys

import pytest
from slides_job import PROGRAM

import diffmill as dm
from diffmill.cli import main

ANSWERED = ["--robot", "kuka_kr210_like", "--diameter", "6 mm", "--teeth", "2"]
ANSWERED += ["--material", "aluminium_7075_t6"]
LIST = "(T1 D=8. CR=0. - flat end mill)\n(a pocket of diameter 12)\n"


@pytest.fixture
def program(here):
    (here / "part.ngc").write_text("T1 M6 S9000 M3\n" + PROGRAM)
    return here / "part.ngc"


def test_a_program_and_four_options_make_a_job_without_faults(program, capsys):
    assert main(["new", "part.ngc", *ANSWERED]) == 0
    said = capsys.readouterr().out
    for part in ("wrote part.toml", "without faults", "next: diffmill correct"):
        assert part in said
    job = dm.load_job(program.with_suffix(".toml"))
    assert float(job.spindle_speed) == pytest.approx(9000 * 2 * 3.14159265 / 60)
    assert float(job.cutter.diameter) == pytest.approx(6e-3)
    # From x -5.5 to 6 mm and y 1 to 4 mm: along x it begins beside the block.
    text = program.with_suffix(".toml").read_text()
    assert 'lower = ["-2 mm", "-2 mm", "-1.8 mm"]' in text
    assert 'upper = ["2.5 mm", "7 mm", "0 mm"]' in text
    assert "FILL IN" not in text and text.count("ASSUMED") == 3


def test_what_is_missing_is_a_line_to_fill_in(program, capsys):
    text = program.read_text().replace("S9000", "").replace("X6", "X30")
    program.write_text(LIST + text)
    assert main(["new", "part.ngc"]) == 0
    said = capsys.readouterr().out
    text = program.with_suffix(".toml").read_text()
    lines = [line for line in text.splitlines() if "FILL IN" in line]
    keys = [line.split()[1] for line in lines]
    assert keys == ["diameter", "teeth", "speed", "material", "model", "work_in_base"]
    assert 'diameter = "8 mm"  # FILL IN: of the cutter; comments of the' in text
    assert "comments of the program name 8 mm\n" in text
    assert said.count("FILL IN") == len(lines)
    # Each names the line, whose example is of the right kind.
    for line in lines:
        number = text.splitlines().index(line) + 1
        assert f"line {number}: " in said
    filled = text
    for line in lines:
        filled = filled.replace(line, line.removeprefix("# "))
    program.with_suffix(".toml").write_text(filled)
    assert main(["check", "part.toml"]) == 0


OUTLINE = """DEF outline()
$TOOL={X 0,Y 0,Z 250,A 0,B 0,C 0}
$BASE={X 1800,Y 0,Z 900,A 0,B 0,C 0}
$VEL.CP=0.1
LIN {X -4,Y 4,Z 15,A 0,B 0,C 180}
LIN {X -4,Y 4,Z -2,A 0,B 0,C 180}
$VEL.CP=0.02
LIN {X 20,Y 4,Z -2,A 0,B 0,C 180}
LIN {X 20,Y 24,Z -2,A 0,B 0,C 180}
LIN {X 20,Y 24,Z 15,A 0,B 0,C 180}
END
"""


def test_the_assumed_block_of_an_outline_is_cut(here, capsys):
    (here / "outline.src").write_text(OUTLINE)
    assert main(["new", "outline.src", *ANSWERED, "--speed", "8000 rpm"]) == 0
    assert "nothing is cut" not in capsys.readouterr().out
    text = (here / "outline.toml").read_text()
    # Moves up and down do not say how high the block is.
    assert 'lower = ["-4 mm", "4 mm", "-3 mm"]' in text
    assert 'upper = ["20 mm", "24 mm", "0 mm"]' in text
    assert dm.load_job(here / "outline.toml").output.formats == ("krl",)


def test_a_diameter_of_a_program_in_inches(program):
    text = "G20 (inch)\n(T1 D=0.25 FLAT END MILL)\n" + program.read_text()
    program.write_text(text.replace("G21", ""))
    assert main(["new", "part.ngc"]) == 0
    assert 'diameter = "0.25 in"' in program.with_suffix(".toml").read_text()


TOOLS = """(T1 D=16. - face mill)
(T2 D=6.8 - drill)
G21 G17 G90 G94
T1 M6
S6000 M3
G0 X-10 Y6 Z1
G1 Z-0.5 F400
G1 X30 F1200
G0 Z20
T2 M6
S3000 M3
G0 X6 Y6 Z20
G81 X6 Y6 Z-8 R2 F240
X34
G80
M2
"""


def test_a_job_names_the_tool_of_several_and_takes_its_diameter(here, capsys):
    (here / "plate.ngc").write_text(TOOLS)
    assert main(["new", "plate.ngc"]) == 0
    note = "has the tools T1, T2; the job is of T1, --tool chooses another"
    assert note in capsys.readouterr().err
    text = (here / "plate.toml").read_text()
    assert "\ntool = 1\n" in text and "comments of the program name 16 mm\n" in text
    assert main(["new", "plate.ngc", "--tool", "2", "--out", "holes.toml"]) == 0
    text = (here / "holes.toml").read_text()
    assert "\ntool = 2\n" in text and "comments of the program name 6.8 mm\n" in text
    # Holes lie within the block, which is as wide as the drill about them.
    assert 'lower = ["2.6 mm", "2.6 mm", "-9 mm"]' in text
    assert 'upper = ["37.4 mm", "9.4 mm", "0 mm"]' in text


FACING = """G21 G17 G90 G94
S6000 M3
G0 X-10 Y6 Z1
G1 Z-0.5 F400
G1 X50 F1200
G0 Y18
G1 X-10
G0 Y36
G1 X50
G0 Z20
M2
"""


def test_the_assumed_block_is_clear_of_rapid_moves_at_depth(here, capsys):
    (here / "top.ngc").write_text(FACING)
    options = [*ANSWERED[:2], "--diameter", "16 mm", *ANSWERED[4:]]
    assert main(["new", "top.ngc", *options]) == 0
    assert "without faults" in capsys.readouterr().out
    text = (here / "top.toml").read_text()
    # Along y no rapid move follows an edge.
    assert 'lower = ["-1.5 mm", "6 mm", "-1.5 mm"]' in text
    assert 'upper = ["41.5 mm", "36 mm", "0 mm"]' in text


def test_a_file_that_is_there_is_kept(program, capsys):
    job = program.with_suffix(".toml")
    job.write_text("precious")
    assert main(["new", "part.ngc"]) == 2
    assert "--force replaces it" in capsys.readouterr().err
    assert job.read_text() == "precious"
    assert main(["new", "part.ngc", "--force"]) == 0
    assert "FILL IN" in job.read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--material", "cheese"], "--material: found 'cheese'; allowed: "),
        (["--robot", "puma"], "--robot: found 'puma'; allowed: "),
        (["--diameter", "10"], "unit"),
        (["--tool", "7"], "7"),
    ],
)
def test_a_wrong_option_is_refused(program, capsys, options, message):
    assert main(["new", "part.ngc", *options]) == 2
    assert message in capsys.readouterr().err
    assert not program.with_suffix(".toml").exists()


def test_on_a_terminal_what_is_missing_is_asked(program, monkeypatch):
    asked = []
    answers = {"robot": "", "diameter": '"6 mm"', "its number": "3", "material": ""}

    def ask(question):
        asked.append(question)
        return next(x for key, x in answers.items() if question.startswith(key))

    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", ask)
    assert main(["new", "part.ngc"]) == 0 and len(asked) == 4
    text = program.with_suffix(".toml").read_text()
    assert 'diameter = "6 mm"' in text and "\nteeth = 3" in text
    assert text.count("FILL IN") == 3


def test_a_recorded_path_needs_no_acceleration(here, capsys):
    rows = [f"{0.01 * k},{k - 2},0,{-0.5}" for k in range(12)]
    (here / "path.csv").write_text(
        "\n".join(["time [s],x [mm],y [mm],z [mm]", *rows]) + "\n"
    )
    assert main(["new", "path.csv"]) == 0
    text = (here / "path.toml").read_text()
    assert "acceleration" not in text and 'file = "path.csv"' in text


def test_what_the_program_leaves_to_the_control_goes_into_the_job(program, capsys):
    text = program.read_text().replace("G21", "M88\nG21", 1)
    program.write_text(text)
    assert main(["new", "part.ngc", *ANSWERED]) == 2
    assert "M88" in capsys.readouterr().err
    line = 'pass_over = ["M88"]'
    assert main(["new", "part.ngc", *ANSWERED, "--program", line]) == 0
    assert f"\n{line}\n" in program.with_suffix(".toml").read_text()
    assert dm.load_job(program.with_suffix(".toml")).output.pass_over == ("M88",)


def test_the_axis_of_the_tool_of_a_robot_goes_into_the_job(here):
    lying = OUTLINE.replace("A 0,B 0,C 180}", "A 0,B 90,C 0}")
    (here / "outline.src").write_text(lying)
    options = [*ANSWERED, "--speed", "8000 rpm", "--tool-axis", "x"]
    assert main(["new", "outline.src", *options]) == 0
    assert '\ntool_axis = "x"\n' in (here / "outline.toml").read_text()
    assert dm.load_job(here / "outline.toml").output.tool_axis == "x"
    # A line counts before the option.
    line = 'tool_axis = "-x"'
    main(["new", "outline.src", *options, "--force", "--program", line])
    keys = (here / "outline.toml").read_text().splitlines()
    assert [key for key in keys if key.startswith("tool_axis")] == [line]


def test_a_urdf_gets_drives_of_a_payload_class_to_fill_in(program):
    assert main(["new", "part.ngc", "--robot", "arm.urdf"]) == 0
    text = program.with_suffix(".toml").read_text()
    assert '# drives = "class 200 kg"  # FILL IN: payload of the arm: "class 10' in text
    assert "joint_stiffness" not in text
