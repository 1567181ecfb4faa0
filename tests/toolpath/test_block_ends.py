"""Programs whose block ends are moved."""

import numpy as np
import pytest

from diffmill import io
from diffmill.toolpath import BlockEnds, sample_program

PROGRAM = """G21 G90 G94 F1200
G0 X0 Y0 Z1
G1 Z-1
X30
G3 X40 Y10 I0 J10
G1 Y30 X42
G2 I5 J0
G4 P0.1
G1 Y50
G0 Z5
M2
"""
LIMITS = {"acceleration": 2.0, "rapid_feed": 0.2}


@pytest.fixture(scope="module")
def timed():
    program = io.parse_gcode(PROGRAM)
    path = sample_program(program, 2e-3, corner_tolerance=1e-5, **LIMITS)
    return program, path, BlockEnds.of(program, path)


def test_a_row_is_on_the_block_of_its_line(timed):
    program, path, ends = timed
    moves = program.moves[program.approach_count :]
    assert np.all(np.diff(ends.place) >= 0)
    assert ends.place[0] == 0 and ends.place[-1] == pytest.approx(len(moves))
    # But for the rounded corners, of which half counts as the next block.
    along = np.flatnonzero(path.line == 4)[1:-1]
    share = ends.place[along] - 1
    np.testing.assert_allclose(path.positions[along, 0], 30e-3 * share, atol=5e-5)


@pytest.mark.parametrize(
    ("second", "far"),
    [
        ("G1 Y20", lambda p: p[:, 1]),
        ("G1 X10 Y10", lambda p: p[:, 1] * 2**0.5),
        ("G3 X0 Y20 I-20", lambda p: 0.02 * np.arctan2(p[:, 1], p[:, 0])),
    ],
    ids=["square", "acute", "arc"],
)
def test_rows_behind_a_rounded_corner_are_where_they_are(second, far):
    program = io.parse_gcode(f"G21 G90 F1200\nG0 X0 Y0 Z0\nG1 X20\n{second}\nM2\n")
    limits = {**LIMITS, "corner_tolerance": 1e-3}
    path = sample_program(program, 2e-3, **limits)
    ends, length = BlockEnds.of(program, path), program.moves[-1].length
    behind = far(np.asarray(path.positions))
    is_behind = (path.line == 4) & (behind > 5e-3)
    expected = 1 + behind[is_behind] / length
    np.testing.assert_allclose(ends.place[is_behind], expected, atol=1e-5)
    assert np.all(np.diff(ends.place)[:-1] > 0)
    np.testing.assert_allclose(ends.positions(ends, path), path.positions, atol=1e-15)
    # From the corner on an offset grows evenly.
    offsets = 1e-3 * np.maximum(ends.place - 1, 0)[:, None] * np.eye(3)[2]
    moved = ends.with_offsets(offsets)
    found = [move.end[2] for move in moved.moves[-3:]]
    np.testing.assert_allclose(found, [0, 0, 1e-3], atol=2e-7)


def test_a_shift_moves_every_block(timed):
    program, path, ends = timed
    shift = np.array([3e-5, -2e-5, 1e-5])
    moved = ends.with_offsets(np.broadcast_to(shift, path.positions.shape))
    for before, after in zip(program.moves, moved.moves, strict=True):
        np.testing.assert_allclose(after.end, np.array(before.end) + shift, atol=1e-15)
        if before.centre is not None:
            centre = np.array(before.centre) + shift
            np.testing.assert_allclose(after.centre, centre, atol=1e-15)
    again = sample_program(moved, 2e-3, corner_tolerance=1e-5, **LIMITS)
    np.testing.assert_allclose(again.positions, path.positions + shift, atol=1e-12)


def test_offsets_that_change_evenly_along_blocks_are_met(timed):
    program, _, ends = timed
    count = len(program.moves) - program.approach_count
    at_ends = 1e-5 * np.random.default_rng(2).normal(size=(count + 1, 3))
    # The full circle moves as a whole.
    at_ends[5] = at_ends[4]
    offsets = np.stack(
        [np.interp(ends.place, np.arange(count + 1), at_ends[:, k]) for k in range(3)],
        axis=1,
    )
    moved = ends.with_offsets(offsets)
    found = np.array([move.end for move in moved.moves[program.approach_count - 1 :]])
    old = np.array([move.end for move in program.moves[program.approach_count - 1 :]])
    # Each end also wants the offset of its own place, which between two rows is near.
    np.testing.assert_allclose(found - old, at_ends, atol=1e-8)


def test_moved_arcs_are_arcs_in_the_written_program(timed):
    _, path, ends = timed
    way = ends.place[:, None] / ends.place[-1]
    offsets = 1e-4 * np.concatenate([way, way**2, -way], axis=1)
    moved = ends.with_offsets(offsets)
    for move in moved.moves:
        if move.centre is not None:
            assert move.radii[1] == pytest.approx(move.radii[0], rel=1e-12)
    read = io.parse_gcode(io.write_program(moved, ".ngc"))
    again = sample_program(read, 2e-3, corner_tolerance=1e-5, **LIMITS)
    places = BlockEnds.of(read, again)
    back = ends.positions(places, again)
    # In a block of ends alone an offset can only change evenly.
    assert np.abs(back - path.positions - offsets).max() < 2e-5
    uncorrected = np.abs(offsets).max()
    assert np.abs(back - path.positions - offsets).mean() < 0.05 * uncorrected


def test_rows_of_another_program_are_refused(timed):
    _, path, _ = timed
    other = io.parse_gcode("G0 X0 Y0 Z0\nG1 X10 F1000\n")
    with pytest.raises(ValueError, match=r"`path`.*line"):
        BlockEnds.of(other, path)
