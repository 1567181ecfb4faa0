"""Parameters, O-words, macros and subprograms: values by hand, bounds, refusals."""

import pytest

from diffmill.io import ProgramError, ProgramSetup, parse_gcode

MM = 1e-3


def ends(text, **setup):
    """Return the ends of all moves [mm], by axis."""
    moves = parse_gcode(text, setup=ProgramSetup(**setup)).moves
    return [tuple(round(v / MM, 6) for v in move.end) for move in moves]


def last(expression, dialect="linuxcnc"):
    """Return the value of an expression as an X."""
    text = f"#2=5\n#3=-7\nG0 X1 Y1\nX[{expression}]"
    return ends(text, dialect=dialect)[-1][0]


@pytest.mark.parametrize(
    ("expression", "linuxcnc", "fanuc"),
    [
        ("1+2*3", 7, 7),
        ("-[#2-8]/2", 1.5, 1.5),
        ("FIX[-2.5]", -3, -2),
        ("FUP[-2.5]", -2, -3),
        ("ROUND[-2.5]", -3, -3),
        ("#3 MOD 4", 1, -3),
        ("6 AND 3", 1, 2),
        ("6 OR 1", 1, 7),
        ("6 XOR 2", 0, 4),
        ("#9 EQ 0", 1, 0),
        ("#9 EQ #10", 1, 1),
        ("1 EQ 1.00001", 1, 0),
        ("ATAN[1]/[-1]", 135, 135),
        ("SQRT[9]+ABS[-1]", 4, 4),
        ("COS[60]+SIN[30]*TAN[45]", 1, 1),
        ("LN[EXP[2]]", 2, 2),
        ("1 AND ABS[-1]", 1, 1),
        ("9 MOD SQRT[16] OR ROUND[0]", 1, 1),
        ("##2+1", 1, 1),
    ],
)
def test_expression_has_its_value_in_either_dialect(expression, linuxcnc, fanuc):
    assert last(expression) == pytest.approx(linuxcnc, abs=1e-6)
    assert last(expression, "fanuc") == pytest.approx(fanuc, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "points"),
    [
        # A hexagon by GOTO, as macros were written before WHILE.
        (
            "O0001\n#1=0\nN10 IF [#1 GE 3] GOTO 20\nG0 X[10*COS[#1*60]]\n"
            "#1=#1+1\nGOTO 10\nN20 G0 Z5\nM30",
            [(10, 0, 0), (5, 0, 0), (-5, 0, 0), (-5, 0, 5)],
        ),
        (
            "#1=1\nWHILE [#1 LE 2] DO 1\n#2=1\nWHILE [#2 LE 2] DO 2\nG0 X#1 Y#2\n"
            "#2=#2+1\nEND 2\n#1=#1+1\nEND 1\nM30",
            [(1, 1, 0), (1, 2, 0), (2, 1, 0), (2, 2, 0)],
        ),
        (
            "#1=4\nIF [#1 EQ 4] THEN #2=7\nIF [#1 LT 4] THEN\nG0 X1\nELSE\nG0 X#2\n"
            "ENDIF\nM30",
            [(7, 0, 0)],
        ),
        # A word of a parameter without a value is left out.
        (
            "G0 X1 Y#5\nIF [#5 EQ #0] GOTO 9\nG0 X2\nN9 G0 Z3\nM30",
            [(1, 0, 0), (1, 0, 3)],
        ),
        (
            "G0 Z5\nG65 P9000 A2 B3 L2\nG0 X#24\nG0 X0\nM30\n%\n",
            None,
        ),
        (
            "O1\nG0 X5 M98 P20 L2\nM30\nO20\nG91 G0 Y1\nG90\nM99\n",
            [(5, 0, 0), (5, 1, 0), (5, 2, 0)],
        ),
        (
            "O1\n#24=9\nG0 Z1\nG65 P20 X2 Y3.5 A-1\nG0 X#24\nM30\n"
            "O20\n#24=#24+#1\nG0 X#24 Y#25\nM99\n",
            [(0, 0, 1), (1, 3.5, 1), (9, 3.5, 1)],
        ),
        (
            "O1\nM98 P00030020\nM30\nO20\nG91 G0 Y1\nM99\n",
            [(0, 1, 0), (0, 2, 0), (0, 3, 0)],
        ),
    ],
)
def test_macros_of_fanuc(text, points):
    if points is None:
        with pytest.raises(ProgramError, match="is not in the program's file"):
            ends(text)
        return
    assert ends(text) == points


def test_parameter_without_a_value_is_noted_with_its_line():
    notes = parse_gcode("G0 X1\no1 if [#50 EQ 0]\nG0 X2\no1 endif\nG0 X#60").notes
    assert "line 2: #50: has no value in the program, and is 0" in notes
    assert "line 5: #60: has no value in the program, and is 0" in notes


def test_dialect_is_noted_and_may_be_chosen():
    text = "#1=[7 AND 3]\nG0 X#1"
    assert ends(text) == [(1, 0, 0)]
    assert ends(text, dialect="fanuc") == [(3, 0, 0)]
    notes = parse_gcode(text).notes
    assert any("as LinuxCNC does" in note for note in notes)
    notes = parse_gcode("G0 X1\nIF [1 EQ 1] GOTO 5\nN5 G0 X2").notes
    assert any("as Fanuc controls do" in note for note in notes)


@pytest.mark.parametrize(
    ("text", "line", "word", "part"),
    [
        ("G0 X1\nG0 X#<a>", 2, "#<A>", "no line before sets"),
        ("G0 X#5063", 1, "#5063", "not known here"),
        ("#5221=3\nG0 X1", 1, "#5221", "is not set here"),
        ("#<_feed>=3\nG0 X1", 1, "#<_FEED>", "belongs to the control"),
        ("G0 X#<_hal[x]>", 1, "#<_HAL[X]>", "no line before sets"),
        ("G0 X#1.5", 1, "#1.5", "not whole"),
        ("G0 X[1/0]", 1, "", "divided by zero"),
        ("G0 X[ACOS[2]]", 1, "", "no value for its argument"),
        ("G0 X[1+]", 1, "]", "needed is a number"),
        ("G0 X[1", 1, "G0X[1", "needed is a ]"),
        ("#1 3\nG0 X1", 1, "#13", "needed is a ="),
        ("G0 X[1E9*1E9]", 1, "E9*1E9]", "needed is a ]"),
        ("#1=[9999999*99999]\nG0 X#1", 2, "X#1", "beyond"),
        ("o1 if [1]\nG0 X1", 1, "1", "this IF has no end"),
        ("G0 X1\no1 endwhile", 2, "1", "no WHILE that it belongs to"),
        ("G0 X1\no1 repeat [2] G0 X1", 2, "G0X1", "does not belong"),
        ("o1 sub\no2 sub\no2 endsub\no1 endsub\nG0 X1", 2, "2", "routine begins where"),
        ("#1=1\nG0 X1\nGOTO 7", 3, "", "no line N7"),
        ("#3000=1\nIF [1 EQ 1] GOTO 3\nN3", 1, "#3000", "raises an alarm"),
        ("IF [#1001 EQ 1] GOTO 3\nN3 G0 X1", 1, "#1001", "not known here"),
        ("G0 X1\nG41 D99999999999\nX2", 2, "D99999999999", "beyond"),
        ("#1=1\nO[#1+ call\nG0 X1", 2, "O[#1+CALL", "no O-word"),
        ("#1=1\nO[#1+2] call\nG0 X1", 2, "3", "is not in the program's file"),
        ("G0 X1\no[1E4] call", 2, "E4]", "needed is a ]"),
        ("G0 X1\nG65 P2 I1 J2 I3", 2, "G65P2I1J2I3", "each letter once"),
        ("G0 X1\nM98 P2 #1=5", 2, "M98P2#1=5", "assigns no parameter"),
        ("G0 X1\n#1=\u0663", 2, "\u0663", "needed is a number"),
        ("#1=1\nM98 X5\nG0 X1", 2, "M98X5", "has a P"),
    ],
)
def test_refusals_name_line_and_word(text, line, word, part):
    with pytest.raises(ProgramError) as caught:
        ends(text)
    first = caught.value.faults[0]
    assert (first.line, first.word) == (line, word)
    assert part in first.message


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("G0 X1\no1 while [1]\no1 endwhile", "more than 250000 lines"),
        ("G0 X1\nN1 GOTO 1", "more than 250000 lines"),
        (
            "o1 repeat [1000000000]\n(nothing)\no1 endrepeat",
            "more than 250000 lines",
        ),
        ("o1 sub\no1 call\no1 endsub\no1 call\nG0 X1", "more than 100 deep"),
        ("O1\nM98 P2\nM30\nO2\nM98 P2\nM99", "more than 100 deep"),
    ],
)
def test_program_without_an_end_is_ended_by_a_bound(text, part):
    with pytest.raises(ProgramError, match=part) as caught:
        ends(text)
    assert caught.value.faults[0].line > 0


def test_lines_behind_the_end_are_not_carried_out():
    text = "%\n#1=2\nG0 X#1\nM2\nG0 X#77 A5\n%"
    assert ends(text) == [(2, 0, 0)]
    # Comments may stand before a tape, and what ends it need not have begun it.
    assert ends("(made)\n\n%\n#1=2\nG0 X#1\n%\nG0 X3") == [(2, 0, 0)]
    for text in ("#1=2\nG0 X#1\n%\n\n", "G0 X2\n%\n"):
        assert ends(text) == [(2, 0, 0)]
    with pytest.raises(ProgramError, match="a % is allowed alone"):
        ends("G0 X2\n%\nG0 X3")
    # A line that is never reached may have what is not known.
    assert ends("G0 X1\no1 if [0]\nG0 X#<no>\no1 endif") == [(1, 0, 0)]
    with pytest.raises(ProgramError, match="cut off"):
        ends("%\n#1=2\nG0 X#1\n")


def test_block_delete_and_comments_are_as_in_plain_lines():
    text = "/#1=2 (a #2 [comment])\nG0 X[#1+1] ; [rest\n(#3=5)\nG0 Y#3"
    assert ends(text) == [(3, 0, 0), (3, 0, 0)]
    assert ends(text, skips_blocks=True) == [(1, 0, 0), (1, 0, 0)]
