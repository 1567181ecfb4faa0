"""The shared programs: the motion that LinuxCNC gives, or a refusal that names why."""

import math
import os
import pathlib
import re

import pytest

from diffmill.io import GCodeError, read_gcode

ROOT = pathlib.Path(__file__).parents[2]
DATA = ROOT / os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data")
NC = DATA / "nc"

pytestmark = pytest.mark.skipif(not NC.is_dir(), reason="no reference data")

# LinuxCNC prints four decimals; half of the last one, and rounding.
PRINTED = 0.5001e-4

REFUSED = {
    "bcnc_sample.gcode": (8, "G4"),
    "camotics_heart.ngc": (3, "#<z_safe>=5"),
    "lcnc_3dtest.ngc": (23, "G18"),
    "lcnc_arcspiral.ngc": (1, "G64"),
    "lcnc_cam-nisley.ngc": (6, "#1000=75.00"),
    "lcnc_cds.ngc": (10, "M9"),
    "lcnc_comp.ngc": (1, "G64"),
    "lcnc_spiral.ngc": (1, "G64"),
    "tinyg_alpha_full.gcode": (8, "A10"),
    "ugs_g17-g18-g19.gcode": (7, "G18"),
    "ugs_no_spaces.gcode": (7, "G04"),
}
ACCEPTED = ["camotics_cds.gcode", "ugs_spiral.gcode"]


def canonical_motion(name):
    scale, feed, moves = 1.0, None, []
    for row in (NC / "expected" / f"{name}.canon").read_text().splitlines():
        match = re.match(r"\s*\d+\s+N\S+\s+(\w+)\((.*)\)", row)
        if not match:
            continue
        command, arguments = match[1], match[2]
        if command == "USE_LENGTH_UNITS":
            scale = 25.4e-3 if "INCH" in arguments else 1e-3
        elif command == "SET_FEED_RATE":
            feed = float(arguments) * scale / 60
        elif command in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            end = [float(a) for a in arguments.split(",")[:3]]
            rate = None if command == "STRAIGHT_TRAVERSE" else feed
            moves.append((command, scale, end, None, 0, rate))
        elif command == "ARC_FEED":
            x, y, cx, cy, turn, z = (float(a) for a in arguments.split(",")[:6])
            moves.append((command, scale, [x, y, z], [cx, cy], int(turn), feed))
    return moves


def assert_same_motion(program, expected):
    assert len(program.moves) == len(expected)
    pairs = zip(program.moves, expected, strict=True)
    for move, (command, scale, end, centre, turn, feed) in pairs:
        assert move.is_rapid == (command == "STRAIGHT_TRAVERSE")
        assert [v / scale for v in move.end] == pytest.approx(end, abs=PRINTED)
        assert move.turn == turn
        assert move.feed == (None if feed is None else pytest.approx(feed, rel=1e-9))
        if centre is not None:
            assert move.centre is not None
            found = [v / scale for v in move.centre[:2]]
            assert found == pytest.approx(centre, abs=PRINTED)


@pytest.mark.parametrize("name", ACCEPTED)
def test_accepted_program_has_the_motion_of_linuxcnc(name):
    assert_same_motion(read_gcode(NC / "gcode" / name), canonical_motion(name))


def supported_subset(name):
    """Return a program without the words that we refuse and that move nothing."""
    text = (NC / "gcode" / name).read_text()
    text = re.sub(r"(?i)\bg64\b|\bg0?4\s*p\d+|\bm9\b|\bg43\s*h1\b", "", text)
    return text


@pytest.mark.parametrize(
    "name", ["bcnc_sample.gcode", "lcnc_cds.ngc", "lcnc_arcspiral.ngc"]
)
def test_motion_without_the_refused_words(name, tmp_path):
    file = tmp_path / name
    file.write_text(supported_subset(name))
    expected = canonical_motion(name)
    assert_same_motion(read_gcode(file), expected)


@pytest.mark.parametrize("name", REFUSED)
def test_unsupported_program_names_line_and_word(name):
    with pytest.raises(GCodeError) as caught:
        read_gcode(NC / "gcode" / name)
    line, word = REFUSED[name]
    first = caught.value.faults[0]
    assert (first.line, first.word.upper()) == (line, word.upper())
    message = str(caught.value)
    assert f"{name}, line {line}" in message
    assert len(caught.value.faults) <= 20


def test_spiral_is_a_helix_of_full_circles():
    moves = read_gcode(NC / "gcode" / "ugs_spiral.gcode").moves
    arcs = [move for move in moves if move.turn]
    assert [move.sweep for move in arcs] == pytest.approx(
        [2 * math.pi] * 3 + [-2 * math.pi] * 3
    )
    assert arcs[1].length == pytest.approx(math.hypot(2 * math.pi * 0.02, 0.02))
