"""The blocks of a program with their ends moved, to make a path of offsets."""

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._moves import Move, Program, point_of
from .._path import Path
from .._timing.pieces import Segment, piece_of_move

# How much an end wants the offset at its own place, beside one row on a block: it
# decides where a block has no row.
_OWN_PLACE_WEIGHT = 1e-3
# An arc whose ends are nearer than this, in radii, moves as a whole: its centre follows
# from its ends badly.
_NEAR_ENDS_RADII = 1.0


class BlockEnds(NamedTuple):
    """Places of the rows of a timed program on its blocks.

    Attributes:
        program: The program.
        place: For every row the number of the move it is on, from 0 behind the
            approach, and the share of it that is travelled; it never decreases,
            shape (row,).
    """

    program: Program
    place: Float[np.ndarray, " row"]

    @classmethod
    def of(cls, program: Program, path: Path) -> "BlockEnds":
        """Find the places.

        Args:
            program: A program of one tool.
            path: The program as it was timed.

        Raises:
            ValueError: If the rows are not those of the program.
        """
        moves = _travelled(program)
        ends = np.append(0.0, np.cumsum([move.length for move in moves]))
        points, lines = np.asarray(path.positions), np.asarray(path.line)
        steps = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
        way, first = np.zeros(len(lines)), 0
        # Rows of one line in a row.
        bounds = [0, *(np.flatnonzero(np.diff(lines)) + 1).tolist(), len(lines)]
        for begin, stop in itertools.pairwise(bounds):
            while first < len(moves) and moves[first].line != lines[begin]:
                first += 1
            if first == len(moves):
                raise ValueError(
                    f"Argument `path` must be `program` as timed, but has line "
                    f"{lines[begin]} where the program has none."
                )
            gone = np.cumsum(steps[begin:stop]) - steps[begin]
            way[begin:stop] = ends[first] + _entered(
                moves[first], points[begin:stop], gone
            )
            while first < len(moves) and moves[first].line == lines[begin]:
                first += 1
        way = np.maximum.accumulate(way)
        return cls(program, np.interp(way, ends, np.arange(len(moves) + 1.0)))

    @property
    def block_count(self) -> int:
        """Number of moves behind the approach."""
        return len(_travelled(self.program))

    def with_offsets(self, offsets: Float[np.ndarray, "row 3"]) -> Program:
        """Return the program, its block ends moved to come near offsets of its rows.

        Along a block the offset goes evenly from that of its start to that of its end;
        all ends together are the best in the sense of least squares. An arc stays one
        around another centre; one that nearly closes moves as a whole.

        Args:
            offsets: What to add to every row [m], shape (row, 3).
        """
        moves = _travelled(self.program)
        ends = self._ends(moves, offsets)
        changed = [
            _moved(move, *pair)
            for move, pair in zip(moves, itertools.pairwise(ends), strict=True)
        ]
        count = self.program.approach_count
        approach = list(self.program.moves[:count])
        if approach:
            approach[-1] = approach[-1]._replace(end=changed[0].start)
        return dataclasses.replace(self.program, moves=(*approach, *changed))

    def positions(self, other: "BlockEnds", path: Path) -> Float[np.ndarray, "row 3"]:
        """Tool tips of another timing of the same blocks, at the places of the rows.

        Args:
            other: Places of the rows of `path`.
            path: A program of as many blocks, as timed.

        Returns:
            Tool tips [m], shape (row, 3).
        """
        points = np.asarray(path.positions)
        # Rows at rest share a place: any of them will do.
        place, rows = np.unique(other.place, return_index=True)
        return np.stack(
            [np.interp(self.place, place, points[rows, axis]) for axis in range(3)],
            axis=1,
        )

    def _ends(
        self, moves: tuple[Move, ...], offsets: Float[np.ndarray, "row 3"]
    ) -> Float[np.ndarray, "end 3"]:
        """Return the offset of every end, that of the first start before them [m]."""
        from scipy.linalg import solveh_banded

        count = len(moves)
        is_whole = [move.length == 0 or _is_near_closed(move) for move in moves]
        # The ends of a block that moves as a whole are one unknown.
        unknown = np.cumsum([0, *(not whole for whole in is_whole)])
        block = np.minimum(self.place.astype(int), count - 1)
        share = self.place - block
        size = int(unknown[-1]) + 1
        band, right = np.zeros((2, size)), np.zeros((size, 3))
        before, after = unknown[block], unknown[block + 1]
        np.add.at(band[1], before, (1 - share) ** 2)
        np.add.at(band[1], after, share**2)
        cross = np.where(before == after, 2.0, 1.0) * share * (1 - share)
        is_one = before == after
        np.add.at(band[1], before[is_one], cross[is_one])
        np.add.at(band[0], after[~is_one], cross[~is_one])
        np.add.at(right, before, (1 - share)[:, None] * offsets)
        np.add.at(right, after, share[:, None] * offsets)
        place, rows = np.unique(self.place, return_index=True)
        own = np.stack(
            [
                np.interp(np.arange(count + 1), place, offsets[rows, axis])
                for axis in range(3)
            ],
            axis=1,
        )
        np.add.at(band[1], unknown, _OWN_PLACE_WEIGHT)
        np.add.at(right, unknown, _OWN_PLACE_WEIGHT * own)
        return solveh_banded(band, right)[unknown]


def _travelled(program: Program) -> tuple[Move, ...]:
    """Return the moves behind the approach."""
    return program.moves[program.approach_count :]


def _entered(
    move: Move, points: Float[np.ndarray, "row 3"], gone: Float[np.ndarray, " row"]
) -> Float[np.ndarray, " row"]:
    """Distances of the rows of a line from the start of its move [m], shape (row,).

    A rounded corner counts to the line behind it, but begins before that; it takes half
    of the move at most. So the row nearest to the middle tells where they are.

    Args:
        move: The first move of the line.
        points: The rows [m], shape (row, 3).
        gone: Their way since the first of them [m], shape (row,).
    """
    if move.length == 0:
        return gone
    piece = piece_of_move(move)
    middle = piece.positions(np.array([piece.length / 2]))[0]
    gaps = points[gone <= piece.length] - middle
    row = int(np.argmin(np.linalg.norm(gaps, axis=1)))
    if isinstance(piece, Segment):
        beside = float(gaps[row] @ np.array(piece.tangent(at_end=False)))
    else:
        x, y = (points[row] - piece.centre) @ np.transpose(
            [piece.radial, piece.forward]
        )
        angle = math.remainder(math.atan2(y, x) - piece.sweep / 2, math.tau)
        beside = angle / piece.sweep * piece.length
    return piece.length / 2 + beside + gone - gone[row]


def _is_near_closed(move: Move) -> bool:
    """True if an arc ends so near its start that its ends tell no centre."""
    if move.centre is None:
        return False
    (a, b, c), (x, y, z) = move.spokes
    return math.hypot(x - a, y - b, z - c) < _NEAR_ENDS_RADII * move.radii[0]


def _moved(
    move: Move, first: Float[np.ndarray, " 3"], last: Float[np.ndarray, " 3"]
) -> Move:
    """Return a move whose start and end are elsewhere, an arc around a new centre."""
    start, end = np.array(move.start) + first, np.array(move.end) + last
    changed = move._replace(start=point_of(start), end=point_of(end))
    if move.centre is None:
        return changed
    normal = np.array(move.normal)
    flat = np.eye(3) - np.outer(normal, normal)
    centre = np.array(move.centre) + (first + last) / 2
    chord = flat @ (end - start)
    if not _is_near_closed(move):
        # As far from the one end as from the other.
        beside = (centre - (start + end) / 2) @ chord / (chord @ chord)
        centre = centre - beside * chord
    centre = flat @ centre + normal * (normal @ start)
    return changed._replace(centre=point_of(centre))
