"""What is said of programs and paths: unusual numbers, extents, other languages."""

import math

import numpy as np
import pytest

from diffmill.cli import main
from diffmill.io import ProgramError, parse_gcode, read_path_csv, read_program
from diffmill.toolpath import Move, Path, Program

MM = 1e-3


@pytest.fixture
def described(tmp_path, capsys):
    """Return what `diffmill check` prints of a text with a suffix."""

    def described(text, suffix=".ngc"):
        file = tmp_path / f"part{suffix}"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        assert main(["check", str(file)]) == 0
        return capsys.readouterr().out

    return described


@pytest.fixture
def refused(tmp_path):
    """Return the one fault with which a text with a suffix is refused."""

    def refused(text, suffix=".ngc"):
        file = tmp_path / f"part{suffix}"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(ProgramError) as caught:
            read_program(file)
        assert caught.value.name == file.name
        (fault,) = caught.value.faults
        return fault

    return refused


def test_bounds_of_a_move_are_those_of_its_points():
    rng = np.random.default_rng(3)
    share = np.linspace(0.0, 1.0, 20_001)
    for _ in range(60):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        spoke = np.cross(normal, rng.standard_normal(3))
        centre, angle = rng.standard_normal(3), rng.uniform(0.05, 6.2)
        turn = int(rng.choice([-3, -1, 1, 2]))
        turned = math.cos(angle) * spoke + math.sin(angle) * np.cross(normal, spoke)
        rise = rng.choice([0.0, rng.uniform(-3, 3)]) * normal
        start, end = centre + spoke, centre + turned + rise
        first, last, middle, axis = (
            (float(x), float(y), float(z)) for x, y, z in (start, end, centre, normal)
        )
        move = Move(first, last, middle, turn, normal=axis)
        sampled = move.points_at(share)
        assert sampled[-1] == pytest.approx(end, abs=1e-9)
        low, high = move.bounds
        # Between the samples a coordinate may turn back.
        assert sampled.min(axis=0) == pytest.approx(low, abs=1e-6)
        assert sampled.max(axis=0) == pytest.approx(high, abs=1e-6)
        assert np.all(sampled.min(axis=0) >= np.array(low) - 1e-12)


def test_extents_of_a_full_circle_are_its_diameter(described):
    lines = described("G0 X10 Y0 Z5\nG1 Z-2 F200\nG3 I-15 J0\nG0 Z5")
    assert "x: -20.000 to 10.000 mm" in lines
    assert "y: -15.000 to 15.000 mm" in lines
    assert "z: -2.000 to 5.000 mm" in lines


@pytest.mark.parametrize(
    ("suffix", "text", "line", "found"),
    [
        (".ngc", "G0 X0\nG1 X1 F60\nG4 P90\n", 3, "rest of 90 s"),
        (".src", "DEF a()\n$VEL.CP=0.1\nPTP {X 0,Y 0,Z 0}\nLIN {X 1}\n"
         "WAIT SEC 90\nEND", 5, "rest of 90 s"),
        (".ngc", "G0 X0\nG1 X1 F400000\n", 2, "6.67 m/s"),
        (".ngc", "G0 X0\nG93 G1 X100 F6000\n", 2, "10 m/s"),
        (".src", "DEF a()\n$VEL.CP=40\nPTP {X 0,Y 0,Z 0}\nLIN {X 1}\nEND", 4, "40 m/s"),
        (".mod", "MODULE a\nPROC main()\nMoveJ [[0,0,0],[0,1,0,0],[0,0,0,0],"
         "[9E9,9E9,9E9,9E9,9E9,9E9]],v50,fine,tool0;\nMoveL [[9,0,0],[0,1,0,0],"
         "[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1\\V:=9000,fine,tool0;\n", 4, "9 m/s"),
    ],
)  # fmt: skip
def test_rests_and_feeds_that_no_cell_has_are_noted(
    described, suffix, text, line, found
):
    notes = [row for row in described(text, suffix).splitlines() if "note:" in row]
    assert any(f"line {line}" in note and found in note for note in notes)


def test_a_usual_rest_and_feed_have_no_note(described):
    assert "note:" not in described("G0 X0\nG1 X1 F200000\nG4 P59\n")


CSV = "time_s,x_mm,y_mm,z_mm"
ROWS = [(0.0, 0.0, 0.0, 0.0), (0.25, 1.5, -0.5, 2.0), (1.0, 3.0, 0.0, 0.125)]


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
@pytest.mark.parametrize("comma", [",", "."])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le"])
def test_recorded_paths_of_any_country(tmp_path, delimiter, comma, encoding):
    rows = [delimiter.join(str(v).replace(".", comma) for v in row) for row in ROWS]
    text = "\n".join([CSV.replace(",", delimiter), *rows])
    file = tmp_path / "path.csv"
    file.write_bytes(text.encode(encoding))
    if delimiter == comma == ",":
        with pytest.raises(ProgramError, match="line 2: found 8 values in every row"):
            read_path_csv(file)
        return
    path = read_path_csv(file)
    np.testing.assert_allclose(path.time, [0.0, 0.25, 1.0])
    np.testing.assert_allclose(path.positions, np.array(ROWS)[:, 1:] * MM)


def test_both_decimal_signs_in_a_path_are_refused(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(f"{CSV.replace(',', ';')}\n0;0;0;0\n1;1.5;0;0\n2;1,5;0;0\n")
    with pytest.raises(ProgramError) as caught:
        read_path_csv(file)
    (fault,) = caught.value.faults
    assert "line 4: found decimal commas, but points in line 3" in fault.message


def test_a_path_that_jumps_is_noted(described):
    text = f"{CSV}\n0,0,0,0\n0.1,1,0,0\n0.100000001,2,0,0\n0.2,3,0,0\n"
    (note,) = [row for row in described(text, ".csv").splitlines() if "note:" in row]
    assert "1e+06 m/s before line 4 (0.001 m in 1e-09 s)" in note
    assert "in 1 row:" in note
    path = Path.upright(np.array([0.0, 0.01]), np.array([[0, 0, 0], [0, 0, 0.049]]))
    assert path.notes == ()


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("; %_N_HOUSING_MPF\nTRANS X5\nG0 X1\n", 1, "Siemens"),
        ("N5 G90\nN10 T=\"MILL\" D1\nG0 X1\n", 2, "Siemens"),
        ("N5 G90 G0 X=12.5 Y0\n", 1, "Siemens"),
        ("G0 X1\nG1 X2 F9\nCYCLE82(5,0,1,-3,,0.5)\n", 3, "Siemens"),
        ("0 BEGIN PGM PLATE MM\n1 TOOL CALL 3 Z S4000\n", 1, "Heidenhain"),
        ("5 L X+10 Y-5 R0 FMAX M3\n6 CC X+0 Y+0\n", 1, "Heidenhain"),
        ("%PLATE G71 *\nN10 G00 G40 G90 X+0 Y+0 *\n", 1, "DIN/ISO"),
        ("(part)\nG0 X0,5 Y1\nG1 X3,25 F100\n", 2, "as in X0.5"),
        ("DEF part()\n$VEL.CP=0.1\nLIN {X 1}\n", 1, ".src"),
        ("MODULE part\nPROC main()\n", 1, ".mod"),
        ("PARTNO/PLATE\nGOTO/1,2,3\n", 1, ".apt"),
        (b"G0 X1\0\0\1\2", 0, "binary"),
    ],
)  # fmt: skip
def test_a_program_of_another_kind_is_named_once(refused, text, line, part):
    fault = refused(text, ".nc")
    assert fault.line == line
    assert part in fault.message


def test_a_program_of_another_language_is_named_whatever_its_suffix(refused):
    assert "this is APT" in refused("UNITS/MM\nGOTO/1,2,3\n", ".mod").message
    # What is neither stays as its reader has it.
    assert "no position" in refused("DEF a()\nPTP 5 6\nEND", ".src").message


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_programs_in_utf_16(tmp_path, encoding):
    file = tmp_path / "part.nc"
    file.write_bytes("(\u00b5m)\r\nG0 X1 Y2 Z3\r\nG1 X5 F60\r\n".encode(encoding))
    program = read_program(file)
    assert isinstance(program, Program)
    assert program.moves[-1].end == pytest.approx((5 * MM, 2 * MM, 3 * MM))


def test_brackets_in_a_comment(described):
    lines = described("(Pocket (2), side (a))\nG0 X1 Y2 Z3 (in (1))\nG1 X5 F60\n")
    assert "lines 1, 2: a comment: has brackets in it" in lines
    with pytest.raises(ProgramError, match="not closed"):
        parse_gcode("G0 X1 (a (b)\n")


def test_control_characters_do_not_reach_the_terminal(tmp_path, capsys):
    file = tmp_path / "part.src"
    file.write_text("DEF a()\nLIN {X 1}\x1b[2J\x9b\u202e\nEND\n")
    assert main(["check", str(file)]) == 2
    shown = capsys.readouterr().err
    assert "\\x1b[2J" in shown
    assert not {"\x1b", "\x9b", "\u202e"} & set(shown)
    file = tmp_path / "part.ngc"
    file.write_text("O12 \x1b[2J(a)\nG0 X1\nG1 X2 F60\n")
    main(["check", str(file)])
    assert "\x1b" not in "".join(capsys.readouterr())
