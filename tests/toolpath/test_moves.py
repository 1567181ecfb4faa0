"""Angles and lengths of moves."""

import math

import pytest

from diffmill.toolpath import Move, Program


@pytest.mark.parametrize(
    ("end", "turn", "sweep"),
    [
        ((0.0, 1.0, 0.0), 1, math.pi / 2),
        ((0.0, 1.0, 0.0), -1, -3 * math.pi / 2),
        ((-1.0, 0.0, 0.0), 1, math.pi),
        ((1.0, 0.0, 0.0), 1, 2 * math.pi),
        ((1.0, 0.0, 0.0), -1, -2 * math.pi),
        ((1.0, 1e-17, 0.0), -1, -2 * math.pi),
    ],
)
def test_sweep(end, turn, sweep):
    move = Move((1.0, 0.0, 0.0), end, centre=(0.0, 0.0, 0.0), turn=turn)
    assert move.sweep == pytest.approx(sweep, rel=1e-12)
    assert move.length == pytest.approx(abs(sweep), rel=1e-12)


def test_line():
    move = Move((0.0, 0.0, 0.0), (1.0, 2.0, 2.0))
    assert (move.length, move.sweep, move.radii) == (3.0, 0.0, (0.0, 0.0))


def test_program_leaves_the_approach_out():
    moves = (
        Move((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), is_rapid=True),
        Move((1.0, 0.0, 0.0), (1.0, 2.0, 0.0), feed=1.0),
    )
    program = Program(moves, approach_count=1, spindle_speeds=(3.0, 4.0))
    assert program.path_length == 2.0
    assert program.spindle_speed == 3.0
    assert Program(moves).spindle_speed is None
    with pytest.raises(ValueError, match="approach_count"):
        Program(moves, approach_count=3)
