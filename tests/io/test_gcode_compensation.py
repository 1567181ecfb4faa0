"""Compensation of the cutter's radius: corners by hand, its words, refusals."""

import math

import numpy as np
import pytest

from diffmill import load_job
from diffmill.io import ProgramError, ProgramSetup, parse_gcode
from small_job import write_job

MM = 1e-3
SETUP = ProgramSetup(tool_radii={1: 2 * MM, 2: -2 * MM, 3: 0.0})
START = "G21 G90 G17 F60\nG0 X0 Y0 Z0\n"


def moves(text, setup=SETUP):
    return parse_gcode(START + text, setup=setup).moves[1:]


def ends(text, setup=SETUP):
    return [tuple(round(v / MM, 6) + 0.0 for v in m.end) for m in moves(text, setup)]


def test_outside_corner_is_rounded_about_the_corner():
    out = moves("G42 D1 G1 X10\nX20\nY10\nG40 X30")
    corner = out[2]
    assert corner.centre == pytest.approx((20 * MM, 0, 0))
    assert (corner.turn, corner.length) == (1, pytest.approx(math.pi * MM))
    assert ends("G42 D1 G1 X10\nX20\nY10\nG40 X30") == [
        (10, -2, 0),
        (20, -2, 0),
        (22, 0, 0),
        (22, 10, 0),
        (30, 10, 0),
    ]


@pytest.mark.parametrize(
    ("text", "points"),
    [
        # At an inside corner the tool touches both walls.
        ("G41 D1 G1 X10\nX20\nY10", [(10, 2, 0), (18, 2, 0), (18, 10, 0)]),
        # Up and down in the corner, where the tool is.
        (
            "G41 D1 G1 X10\nX20\nZ5\nZ1\nY10",
            [(10, 2, 0), (18, 2, 0), (18, 2, 5), (18, 2, 1), (18, 10, 1)],
        ),
        # A negative radius is the other side, and none leaves the path.
        ("G41 D2 G1 X10\nX20", [(10, -2, 0), (20, -2, 0)]),
        ("G41 D3 G1 X10\nY20", [(10, 0, 0), (10, 20, 0)]),
        ("G41.1 D4 G1 X10\nX20", [(10, 2, 0), (20, 2, 0)]),
        # A program may state the data of its tools.
        ("G10 L1 P9 R3 Z80\nG41 D9 G1 X10\nX20", [(10, 3, 0), (20, 3, 0)]),
        ("G10 L12 P9 R3.\nG41 D9 G1 X10\nX20", [(10, 3, 0), (20, 3, 0)]),
        ("D1\nG41 G1 X10\nX20", [(10, 2, 0), (20, 2, 0)]),
        # The number of the tool is that of its radius, where D is not said.
        ("T1 M6\nG41 G1 X10\nX20", [(10, 2, 0), (20, 2, 0)]),
        # From the programmed place an incremental move counts.
        ("G41 D1 G1 X10\nG91 X10\nY8", [(10, 2, 0), (18, 2, 0), (18, 8, 0)]),
        ("G41 D1 G1 X10\nX20\nG40\nG91 X1 Y1", [(10, 2, 0), (20, 2, 0), (21, 1, 0)]),
        # Before the entry, the tool may go down.
        ("G41 D1\nG1 Z-1\nX10", [(0, 0, -1), (10, 2, -1)]),
        # A rapid move goes round a corner straight.
        ("G42 D1 G0 X10\nX20\nY9", [(10, -2, 0), (20, -2, 0), (22, 0, 0), (22, 9, 0)]),
        ("G18 G42 D1 G1 Z10\nX5", [(-2, 0, 10), (0, 0, 12), (5, 0, 12)]),
    ],
)
def test_ends_of_compensated_moves(text, points):
    assert ends(text) == points


def test_radius_of_an_arc_changes_with_the_side():
    inside, outside = (
        moves(f"G{code} D1 G1 X10\nG3 X20 Y10 J10\nG40 G1 X20 Y20")[1]
        for code in (41, 42)
    )
    assert inside.radii == pytest.approx((8 * MM, 8 * MM))
    assert outside.radii == pytest.approx((12 * MM, 12 * MM))


def test_rest_stays_at_its_corner_and_a_time_becomes_a_feed():
    out = moves("G41 D1 G1 X10\nX20\nG4 P2\nY10")
    assert [move.rest for move in out] == [0, 2, 0]
    out = moves("G41 D1\nG93 G1 X10 F6\nX20 F6")
    assert out[1].duration is None
    assert out[1].feed == pytest.approx(MM)


def test_radius_may_be_that_of_the_job():
    setup = ProgramSetup(radius=3 * MM)
    assert ends("G41 D7 G1 X10\nX20", setup) == [(10, 3, 0), (20, 3, 0)]
    notes = parse_gcode(START + "G41 D7 G1 X10", setup=setup).notes
    assert any("D7 has the radius of the job's cutter, 3 mm" in note for note in notes)


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("G41 D1 G1 X1", 3, "longer than the radius"),
        ("G41 D1 G1 X10\nX20\nY1\nX10", 6, "does not reach the corner"),
        ("G41 D1 G1 X10\nG3 X11 Y1 J1", 4, "does not fit inside this arc"),
        ("G41 D1 G1 X10\nG42 X20", 4, "is on already"),
        ("G19 G41 D1 G1 Y10", 3, "the XY plane or the XZ plane"),
        ("G41 D1 G1 X10\nG18 X20", 4, "does not go with G41"),
        ("G41 D1 G1 X10\nG81 X20 R1 Z-1", 4, "does not go with G41"),
        ("G41 D1 G1 X10\nT2 M6", 4, "a tool is changed behind G40"),
        ("G41 D1 G1 X10\nG40\nG2 X20 I5", 5, "first move behind G40 is straight"),
        ("G41 D9 G1 X10", 3, "tool_radii"),
    ],
)
def test_refusals_name_the_line(text, line, part):
    with pytest.raises(ProgramError, match=part) as caught:
        moves(text)
    assert caught.value.faults[0].line == line


def test_job_states_radii_or_has_a_cutter(tmp_path):
    program = "G21 G90 F600\nG0 X-10 Y5 Z-1\nG41 D1 G1 X0\nX10\nG40 Y20\nM2\n"
    own = load_job(write_job(tmp_path, program=program))
    assert any("D1 has the radius of the job's cutter" in note for note in own.notes)
    stated = {"program.tool_radii": {"1": "3 mm"}}
    job = load_job(write_job(tmp_path, stated, program=program))
    assert not any("D1 has the radius" in note for note in job.notes)
    y = np.asarray(job.path.positions)[:, 1]
    assert np.isclose(y, 8 * MM, atol=1e-6).any()
