"""Programs with the motion that the interpreter of LinuxCNC gives them."""

import json
import math
import os
import pathlib
import re

import pytest

from diffmill.io import ProgramError, ProgramSetup, parse_gcode, read_program
from diffmill.toolpath import Program

ROOT = pathlib.Path(__file__).parents[2]
DATA = ROOT / os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data")
NC = DATA / "nc"
# Programs made at random and by hand, and what LinuxCNC 2.9 did with them, its zeros
# added; no motion where it refuses them.
MADE = [
    case
    for kind in ("motion", "parameters", "compensation")
    for case in json.loads(
        (ROOT / f"tests/references/linuxcnc_{kind}.json").read_text()
    )
]

needs_data = pytest.mark.skipif(not NC.is_dir(), reason="no reference data")

# LinuxCNC prints four decimals; half of the last one, and rounding.
PRINTED = 0.5001e-4
# The position, the zero of the system and that of G92 are printed one by one.
PRINTED_THREE = 3 * PRINTED
INCH = 25.4e-3
# In-plane axes of an arc, and the one across.
PLANES = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}

REFUSED = {
    "tinyg_alpha_full.gcode": (8, "A10"),
}
ACCEPTED = [
    "bcnc_sample.gcode",
    "camotics_cds.gcode",
    "camotics_heart.ngc",
    "lcnc_3dtest.ngc",
    "lcnc_arcspiral.ngc",
    "lcnc_cam-nisley.ngc",
    "lcnc_cds.ngc",
    "lcnc_comp.ngc",
    "lcnc_spiral.ngc",
    "ugs_g17-g18-g19.gcode",
    "ugs_no_spaces.gcode",
    "ugs_spiral.gcode",
]


# Radii of the table of tools beside the expected motion.
RADII = {1: 0.0625 * INCH, 2: 0.03125 * INCH, 3: 0.1005 * INCH}


def read(name):
    program = read_program(NC / "gcode" / name, setup=ProgramSetup(tool_radii=RADII))
    assert isinstance(program, Program)
    return program


def canonical_motion(name):
    scale, feed, plane, moves = 1.0, None, "XY", []
    for row in (NC / "expected" / f"{name}.canon").read_text().splitlines():
        match = re.match(r"\s*\d+\s+N\S+\s+(\w+)\((.*)\)", row)
        if not match:
            continue
        command, arguments = match[1], match[2]
        if command == "USE_LENGTH_UNITS":
            scale = INCH if "INCH" in arguments else 1e-3
        elif command == "SET_FEED_RATE":
            feed = float(arguments) * scale / 60
        elif command == "SELECT_PLANE":
            plane = arguments[-2:]
        elif command in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            end = [float(a) for a in arguments.split(",")[:3]]
            rate = None if command == "STRAIGHT_TRAVERSE" else feed
            moves.append((command, scale, end, None, 0, plane, rate))
        elif command == "ARC_FEED":
            numbers = [float(a) for a in arguments.split(",")[:6]]
            first, second, across = PLANES[plane]
            end = [0.0] * 3
            end[first], end[second], end[across] = *numbers[:2], numbers[5]
            centre, turn = numbers[2:4], int(numbers[4])
            moves.append((command, scale, end, centre, turn, plane, feed))
    return moves


def assert_same_move(move, scale, end, centre, turn, plane, error):
    assert [v / scale for v in move.end] == pytest.approx(end, abs=error)
    assert move.turn == turn
    if centre:
        first, second, across = PLANES[plane]
        found = [move.centre[first] / scale, move.centre[second] / scale]
        assert found == pytest.approx(centre, abs=error)
        assert move.normal[across] == 1.0


@needs_data
@pytest.mark.parametrize("name", ACCEPTED)
def test_accepted_program_has_the_motion_of_linuxcnc(name):
    program, expected = read(name), canonical_motion(name)
    assert len(program.moves) == len(expected)
    pairs = zip(program.moves, expected, strict=True)
    for move, (command, scale, end, centre, turn, plane, feed) in pairs:
        assert move.is_rapid == (command == "STRAIGHT_TRAVERSE")
        assert_same_move(move, scale, end, centre, turn, plane, PRINTED)
        rounding = PRINTED * INCH / 60
        assert move.feed == (
            None if feed is None else pytest.approx(feed, rel=1e-9, abs=rounding)
        )


@needs_data
@pytest.mark.parametrize("name", REFUSED)
def test_unsupported_program_names_line_and_word(name):
    with pytest.raises(ProgramError) as caught:
        read(name)
    line, word = REFUSED[name]
    first = caught.value.faults[0]
    assert (first.line, first.word.upper()) == (line, word.upper())
    message = str(caught.value)
    assert f"{name}, line {line}" in message
    assert len(caught.value.faults) <= 20


@pytest.mark.parametrize("case", MADE, ids=range(len(MADE)))
def test_made_program_has_the_motion_of_linuxcnc(case):
    systems = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
    origin = (0.0, 0.0, 0.0)
    setup = ProgramSetup(offsets=dict.fromkeys(systems, origin), machine_zero=origin)
    if not case["motion"]:
        with pytest.raises(ProgramError, match="cutter"):
            parse_gcode(case["program"], setup=setup)
        return
    moves = parse_gcode(case["program"], setup=setup).moves
    assert len(moves) == len(case["motion"])
    for move, expected in zip(moves, case["motion"], strict=True):
        scale = INCH if expected["inch"] else 1e-3
        assert move.is_rapid == expected["rapid"]
        end, centre = expected["end"], expected["centre"]
        turn, plane = expected["turn"], expected["plane"]
        assert_same_move(move, scale, end, centre, turn, plane, PRINTED_THREE)


@needs_data
def test_spiral_is_a_helix_of_full_circles():
    moves = read("ugs_spiral.gcode").moves
    arcs = [move for move in moves if move.turn]
    assert [move.sweep for move in arcs] == pytest.approx(
        [2 * math.pi] * 3 + [-2 * math.pi] * 3
    )
    assert arcs[1].length == pytest.approx(math.hypot(2 * math.pi * 0.02, 0.02))
