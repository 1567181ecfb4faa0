"""Orientations of a tool: angles and quaternions by hand, and what is written again."""

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diffmill.io import ProgramError, ProgramSetup, read_program, write_program
from diffmill.toolpath import Path, reduce_path, sample_program

LIMITS = {"acceleration": 2.0, "rapid_feed": 0.2, "corner_tolerance": 0.0}
# Direction from the shank to the tip of an upright cutter.
DOWN = np.array([0.0, 0.0, -1.0])


def krl(*angles):
    """Return a program that goes from one orientation to the next."""
    rows = [
        f"{'LIN' if place else 'PTP'} {{X {10 * place},Y 0,Z 0,A {a},B {b},C {c}}}"
        for place, (a, b, c) in enumerate(angles)
    ]
    return "\n".join(["DEF part( )", "$VEL.CP=0.05", *rows, "END"])


def written_angles(text):
    number = r"(-?[\d.]+)"
    found = re.findall(rf"A {number},B {number},C {number}\}}", text)
    return [tuple(float(angle) for angle in one) for one in found]


def controller(angles):
    """Axes of a controller's tool, R = Rz(A) Ry(B) Rx(C), as scipy has them."""
    return Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()


@pytest.mark.parametrize(
    ("angles", "tool_axis", "axis", "tool_x"),
    [
        # z of the tool points down, x along x of the work; then half a turn about z.
        ((0, 0, 180), "z", (0, 0, 1), (1, 0, 0)),
        ((0, 180, 0), "z", (0, 0, 1), (-1, 0, 0)),
        ((90, 0, 180), "z", (0, 0, 1), (0, 1, 0)),
        # The usual tool of KUKA: x of the tool points down where B is 90 degrees.
        ((0, 90, 0), "x", (0, 0, 1), (1, 0, 0)),
        ((0, 90, 0), "z", (-1, 0, 0), (0, 0, -1)),
        ((0, -90, 0), "-x", (0, 0, 1), (1, 0, 0)),
        ((0, 0, -90), "y", (0, 0, 1), (1, 0, 0)),
        ((0, 0, 90), "-y", (0, 0, 1), (1, 0, 0)),
        ((30, 0, 0), "-z", (0, 0, 1), (math.cos(math.pi / 6), 0.5, 0)),
    ],
)
def test_orientations_by_hand(read, angles, tool_axis, axis, tool_x):
    move = read(krl(angles, angles), tool_axis=tool_axis).moves[1]
    assert move.axis == pytest.approx(axis, abs=1e-12)
    assert move.tool_x == pytest.approx(tool_x, abs=1e-12)


def test_a_quaternion_of_rapid_by_hand(read):
    # Half a turn about y: z points down, x against x of the work.
    target = "[[{},0,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    moves = "".join(f"MoveL {target.format(x)},v50,z0,tool0;" for x in (0, 10))
    move = read(f"MODULE m\nPROC main()\n{moves}\nENDPROC\nENDMODULE", ".mod").moves[1]
    assert move.axis == pytest.approx((0, 0, 1))
    assert move.tool_x == pytest.approx((-1, 0, 0))


@pytest.mark.parametrize("suffix", [".src", ".mod"])
@pytest.mark.parametrize("tool_axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_what_is_read_and_written_keeps_every_orientation(read, suffix, tool_axis):
    given = [(0, 180, 0), (35, 90, -20), (-120, -90, 10), (170, 20, -170), (1, 91, 2)]
    program = read(krl(*given), tool_axis=tool_axis)
    back = read(
        write_program(program, suffix, tool_axis=tool_axis), suffix, tool_axis=tool_axis
    )
    for move, other in zip(program.moves, back.moves, strict=True):
        assert other.axis == pytest.approx(move.axis, abs=1e-7)
        assert other.tool_x == pytest.approx(move.tool_x, abs=1e-7)


@pytest.mark.parametrize(
    "angles", [(0, 180, 0), (180, 0, 180), (0, 90, 0), (12, 90, 0), (-30, 175, 5)]
)
def test_a_written_program_begins_with_the_angles_of_its_source(read, angles):
    text = write_program(read(krl(angles, angles)), ".src")
    for found in written_angles(text):
        assert found == pytest.approx(angles, abs=1e-6)


@pytest.mark.parametrize("tool_axis", ["x", "y", "z", "-x", "-y", "-z"])
@pytest.mark.parametrize("suffix", [".src", ".mod"])
def test_comment_and_positions_tell_the_same_tool(tool_axis, suffix):
    """A tool that is set up as the comment says points down at every position."""
    path = Path.upright(np.array([0.0, 1.0]), np.array([[0, 0, 0], [0.01, 0, 0]]))
    text = write_program(path, suffix, tool_axis=tool_axis)
    (said,) = re.findall(r"its tip, (-?[xyz]) of it pointing from the shank", text)
    direction = np.eye(3)["xyz".index(said[-1])] * (-1 if said[0] == "-" else 1)
    if suffix == ".src":
        turns = [controller(one) for one in written_angles(text)]
    else:
        found = re.findall(r"\],\[([-\d.,]+)\],\[0,0,0,0\]", text)
        numbers = [[float(x) for x in one.split(",")] for one in found]
        turns = [Rotation.from_quat([*q[1:], q[0]]).as_matrix() for q in numbers]
    assert len(turns) == 2
    for R in turns:
        np.testing.assert_allclose(R @ direction, DOWN, atol=1e-6)


def test_a_path_of_programmed_rotation_keeps_it_in_rows_and_blocks(read):
    # 60 degrees about the axis over a way at constant speed: even in time.
    program = read(krl((0, 0, 180), (60, 0, 180)))
    path = sample_program(program, 0.004, **LIMITS | {"acceleration": 1e6})
    assert path.tool_x is not None
    x = np.asarray(path.tool_x)
    share = np.asarray(path.positions)[:, 0] / 0.01
    turned = np.degrees(np.unwrap(np.arctan2(x[:, 1], x[:, 0])))
    np.testing.assert_allclose(turned, 60 * share, atol=1e-6)
    # Chords of 0.1 m that keep the tolerance: 2 acos(1 - e / 0.1 m) each, and better.
    few = reduce_path(path, 1e-4)
    assert few.tool_x is not None and 5 <= few.step_count <= 14
    for suffix in (".src", ".mod"):
        back = read(write_program(few, suffix), suffix)
        assert back.moves[-1].tool_x == pytest.approx(x[-1], abs=1e-3)
        assert back.moves[0].tool_x == pytest.approx(x[0], abs=1e-3)


def test_a_turn_of_axis_and_rotation_is_that_of_both_ends(read):
    first, last = (10, 5, 170), (40, 30, 150)
    program = read(krl(first, last))
    path = sample_program(program, 0.004, **LIMITS)
    axes, x = np.asarray(path.axes), np.asarray(path.tool_x)
    for row, angles in ((0, first), (-1, last)):
        R = controller(angles)
        np.testing.assert_allclose(x[row], R[:, 0], atol=1e-9)
        np.testing.assert_allclose(axes[row], -R[:, 2], atol=1e-9)
    np.testing.assert_allclose(np.sum(axes * x, axis=1), 0, atol=1e-12)
    # No row turns the tool by more than its share of 45 degrees.
    frames = np.stack([x, np.cross(axes, x), axes], axis=-1)
    steps = Rotation.from_matrix(frames[1:]) * Rotation.from_matrix(frames[:-1]).inv()
    assert np.degrees(steps.magnitude().sum()) < 50


def test_angles_that_are_not_stated_are_an_upright_tool_and_noted(read):
    text = "DEF a( )\n$VEL.CP=0.05\nPTP {X 0,Y 0,Z 0}\nLIN {X 9}\nEND"
    program = read(text)
    assert [move.axis for move in program.moves] == [pytest.approx((0, 0, 1))] * 2
    assert not program.states_rotation
    assert any(note.startswith("lines 3, 4: A, B, C: ") for note in program.notes)


DATA = "DECL LDAT L1={VEL 2.0,ACC 100.0,ORI_TYP #CONSTANT,CIRC_TYP #BASE}\n"


def test_constant_orientation_of_krl_is_that_of_the_start(read):
    rows = "PTP {X 0,Y 0,Z 0,A 0,B 10,C 180}\n{}LIN {X 9,Y 0,Z 0,A 0,B 40,C 180}{}\n"
    rows = f"DEF a( )\n$VEL.CP=0.05\n{rows}PTP {{X 0,Y 0,Z 0,A 0,B 40,C 180}}\nEND"
    start, end = (
        (math.sin(math.radians(b)), math.cos(math.radians(b))) for b in (10, 40)
    )
    for before, behind in (
        ("$ORI_TYPE=#CONSTANT\n", ""),
        ("LDAT_ACT={VEL 2,ORI_TYP #CONSTANT,JERK_FAC 50}\n", ""),
        ("S", " WITH $ORI_TYPE=#CONSTANT"),
        (f"{DATA}S", " WITH $ORI_TYPE=SORI_TYP(L1), $CIRC_TYPE=SCIRC_TYP(L1)"),
    ):
        text = rows.replace("{}", before, 1).replace("{}", behind, 1)
        moves = read(text).moves
        assert moves[1].axis == pytest.approx((start[0], 0, start[1]))
        assert moves[2].axis == pytest.approx((end[0], 0, end[1]))
    plain = rows.replace("{}", "", 1).replace("{}", "", 1)
    assert read(plain).moves[1].axis == pytest.approx((end[0], 0, end[1]))


@pytest.mark.parametrize("word", ["$ORI_TYPE=#IGNORE", "$ORI_TYPE=VALUE"])
def test_other_orientations_of_krl_are_refused(read, word):
    with pytest.raises(ProgramError, match="line 2"):
        read(krl((0, 0, 180), (0, 0, 180)).replace("$VEL", f"{word}\n$VEL", 1))


def test_the_note_of_a_flat_cutter_names_the_axis_that_stands_upright(read):
    given = krl((0, 90, 0), (0, 90, 0))
    (note,) = (note for note in read(given).notes if "tool axis" in note)
    assert 'tool_axis = "x"' in note and "line 4" in note
    assert not any("tool axis" in note for note in read(given, tool_axis="x").notes)


def test_a_tool_axis_is_refused_where_a_format_has_none(read, tmp_path):
    with pytest.raises(ProgramError, match='"x"; allowed for G-code: none'):
        read("G0 X0 Y0 Z0\nG1 X1 F9", ".ngc", tool_axis="x")
    file = tmp_path / "path.csv"
    file.write_text("time_s,x_mm,y_mm,z_mm,i,j,k\n0,0,0,0,0,0,-1\n1,1,0,0,0,0,-1\n")
    with pytest.raises(ProgramError, match="allowed for path as CSV: z, -z"):
        read_program(file, setup=ProgramSetup(tool_axis="x"))
    turned = read_program(file, setup=ProgramSetup(tool_axis="z"))
    assert isinstance(turned, Path) and turned.is_upright
