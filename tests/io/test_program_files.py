"""Programs in several files: subprograms and data beside the program."""

import numpy as np
import pytest

from diffmill.io import ProgramError, read_program


@pytest.fixture
def read(tmp_path):
    def read(*, name, **texts):
        folder = tmp_path / "programs"
        folder.mkdir(exist_ok=True)
        for file, text in texts.items():
            (folder / file.replace("__", ".")).write_text(text)
        return read_program(folder / name)

    return read


def ends(program):
    """Ends of the moves [mm]."""
    return np.round([[1e3 * x for x in move.end] for move in program.moves], 6).tolist()


MAIN = """DEF main()
$VEL.CP=0.1
PTP XP1
side(10)
LIN XP1
SIDE(20)
END
"""
MAIN_DATA = "DECL E6POS XP1={X 0,Y 0,Z 5,A 0,B 0,C 180}\nDECL REAL n=3\n"
SIDE = """DEF Side(d:IN)
REAL d
LIN XP1
n=n+1
XP1.Y=d
height(n)
END
"""
SIDE_DATA = "DECL E6POS XP1={X 1,Y 1,Z 5,A 0,B 0,C 180}\nDECL REAL n=100\n"
HEIGHT = "DEF height(z:IN)\nREAL z\nXP1.Z=z\nLIN XP1\nEND\n"
HEIGHT_DATA = "DECL E6POS XP1={X 2,Y 0,Z 0,A 0,B 0,C 180}\n"
KRL = {
    "main__src": MAIN,
    "main__dat": MAIN_DATA,
    "Side__SRC": SIDE,
    "side__DAT": SIDE_DATA,
    "height__src": HEIGHT,
    "height__dat": HEIGHT_DATA,
}


def test_routines_of_krl_are_found_beside_the_program_with_data_of_their_own(read):
    """Each file has its own XP1 and n, which keep what its routine has put."""
    program = read(name="main.src", **KRL)
    expected = [[0, 0, 5], [1, 1, 5], [2, 0, 101], [0, 0, 5], [1, 10, 5], [2, 0, 102]]
    assert ends(program) == expected
    notes = [note for note in program.notes if "is used too" in note]
    assert [note.split(": ")[1] for note in notes] == ["Side.SRC", "height.src"]
    # The first file has 8 lines, the last one empty.
    assert [move.line for move in program.moves][:2] == [3, 8 + 3]


def test_faults_tell_the_file_in_which_they_are(read):
    wrong = {"height__src": HEIGHT.replace("LIN XP1", "LIN XP2")}
    with pytest.raises(ProgramError) as caught:
        read(name="main.src", **(KRL | wrong))
    assert str(caught.value).startswith('height.src, line 4: found "XP2"')
    wrong = {"side__DAT": "DECL E6POS XP1={X 1,Y}\n"}
    with pytest.raises(ProgramError, match=r"side\.DAT, line 1"):
        read(name="main.src", **(KRL | wrong))


def test_a_file_that_calls_itself_or_is_missing_is_refused(read):
    with pytest.raises(ProgramError, match="more than 100 deep"):
        read(name="a.src", a__src="DEF a()\nb()\nEND\n", b__src="DEF b()\na()\nEND\n")
    with pytest.raises(ProgramError, match=r'c.src, line 2.*\["D"\]'):
        read(name="c.src", c__src="DEF c()\nd()\nEND\n")


def test_no_link_leads_out_of_the_folder(read, tmp_path):
    (tmp_path / "out.src").write_text("DEF out()\nEND\n")
    (tmp_path / "programs").mkdir()
    (tmp_path / "programs" / "out.src").symlink_to(tmp_path / "out.src")
    with pytest.raises(ProgramError, match='"OUT"'):
        read(name="c.src", c__src="DEF c()\nout()\nEND\n")


def test_no_link_leads_to_a_module_out_of_the_folder(read, tmp_path):
    place = "[[{},0,9],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    steps = [f"MoveL {place.format(x)},v50,fine,tool0;" for x in (0, 9)]
    rows = ["MODULE out", "PROC side()", *steps, "ENDPROC", "ENDMODULE"]
    side = "\n".join(rows)
    main = "MODULE m\nPROC main()\nside;\nENDPROC\nENDMODULE\n"
    (tmp_path / "out.mod").write_text(side)
    (tmp_path / "programs").mkdir()
    link = tmp_path / "programs" / "out.mod"
    link.symlink_to(tmp_path / "out.mod")
    with pytest.raises(ProgramError, match=r"m\.mod, line 3"):
        read(name="m.mod", m__mod=main)
    link.unlink()
    assert len(read(name="m.mod", m__mod=main, out__mod=side).moves) == 2


PART = "G21 G90 F600\nG0 X0 Y0 Z5\n{}\nG0 X9\nM2\n"


@pytest.mark.parametrize(
    ("call", "file", "text"),
    [
        ("M98 P1234 L2", "O1234__nc", "%\nO1234 (hole)\nG91 G1 X1\nG90\nM99\n%\n"),
        ("M98 P21234", "1234__tap", "O1234\nG91 G1 X1\nG90\nM99\n"),
        ("M98 P34 L2", "O0034__NC", "G91 G1 X1\nG90\nM99\n"),
        ("G65 P7 A1\nG65 P7 A1", "O0007__cnc", "O0007\nG91 G1 X#1\nG90\nM99\n"),
        (
            "o<step> call [1]\no<Step> call [1]",
            "step__ngc",
            "o<step> sub\nG91 G1 X#1\nG90\no<step> endsub\nM2\n",
        ),
    ],
)
def test_subprograms_of_gcode_are_found_beside_the_program(read, call, file, text):
    program = read(name="part.ngc", part__ngc=PART.format(call), **{file: text})
    assert ends(program) == [[0, 0, 5], [1, 0, 5], [2, 0, 5], [9, 0, 5]]
    assert any(file.replace("__", ".") in note for note in program.notes)


def test_a_subprogram_calls_another_file_and_tells_its_faults(read):
    text = "G0 Z7\no<deeper> call\nM99\n"
    files = {"part__ngc": PART.format("M98 P5"), "5__ngc": text}
    deeper = "o<deeper> sub\nG1 Y{}\no<deeper> endsub\n"
    program = read(name="part.ngc", **files, deeper__ngc=deeper.format(3))
    assert ends(program)[1:3] == [[0, 0, 7], [0, 3, 7]]
    with pytest.raises(ProgramError, match=r"^deeper\.ngc, line 2: "):
        read(name="part.ngc", **files, deeper__ngc=deeper.format("1 Q2"))
    with pytest.raises(ProgramError, match=r"^none.ngc, line 3: .*is not in"):
        read(name="none.ngc", none__ngc="G0 X1\nG0 X2\nM98 P6\n")
