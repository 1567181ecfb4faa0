"""The moves of a program in SI units, before they are timed."""

import dataclasses
import math
from typing import NamedTuple, TypeAlias

Point: TypeAlias = tuple[float, float, float]


# A program has up to a million of them: plain tuples are made ten times as fast as
# modules.
class Move(NamedTuple):
    """One motion of a program: a straight line, or an arc or helix about z.

    An arc keeps its programmed end exactly: a small difference between its radius at
    the start and at the end is spread over the angle.

    Attributes:
        start: Tool tip before the move, in `work` [m].
        end: Tool tip after the move, in `work` [m].
        centre: Centre of an arc at the height of its start [m]; None for a line.
        turn: +1 counter-clockwise seen from +z, -1 clockwise, 0 for a line.
        feed: Speed along the move [m/s], or None if none applies.
        duration: Time of an inverse-time move [s], or None.
        is_rapid: Whether the machine moves as fast as it can.
        line: Line of the program, from 1.
    """

    start: Point
    end: Point
    centre: Point | None = None
    turn: int = 0
    feed: float | None = None
    duration: float | None = None
    is_rapid: bool = False
    line: int = 0

    @property
    def radii(self) -> tuple[float, float]:
        """Radius of an arc at its start and end [m]; zeros for a line."""
        if self.centre is None:
            return (0.0, 0.0)
        x, y, _ = self.centre
        return (
            math.hypot(self.start[0] - x, self.start[1] - y),
            math.hypot(self.end[0] - x, self.end[1] - y),
        )

    @property
    def sweep(self) -> float:
        """Signed angle of an arc [rad], a full turn if it ends where it starts."""
        if self.centre is None:
            return 0.0
        x, y, _ = self.centre
        ax, ay = self.start[0] - x, self.start[1] - y
        bx, by = self.end[0] - x, self.end[1] - y
        angle = self.turn * math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        # Rounding of equal end points must not turn a full circle into no motion.
        if angle < 1e-9:
            angle += 2 * math.pi
        return self.turn * angle

    @property
    def length(self) -> float:
        """Length of the move [m]; of a spiral, to first order in its pitch."""
        if self.centre is None:
            return math.dist(self.start, self.end)
        first, last = self.radii
        along = 0.5 * (first + last) * self.sweep
        return math.hypot(along, self.end[2] - self.start[2], last - first)


@dataclasses.dataclass(frozen=True)
class Program:
    """A program as read: its moves in order and what else it says.

    Attributes:
        moves: The moves, zero-length ones included, each starting where the one
            before it ended; the first starts at the origin of `work`.
        approach_count: Number of leading rapid moves that come from an unknown place,
            because not every axis had been programmed before them. They fix where
            the simulated motion begins and are no part of it.
        spindle_speeds: Different speeds that the program sets, in order [rad/s].
        source: The program's text.
        name: Name of its file, for messages.
    """

    moves: tuple[Move, ...]
    approach_count: int = 0
    spindle_speeds: tuple[float, ...] = ()
    source: str = ""
    name: str = "program"

    def __post_init__(self):
        if not 0 <= self.approach_count <= len(self.moves):
            raise ValueError(
                "Argument `approach_count` must lie between 0 and the number of moves "
                f"({len(self.moves)}), but is {self.approach_count}."
            )

    @property
    def spindle_speed(self) -> float | None:
        """The first speed that the program sets [rad/s], or None."""
        return self.spindle_speeds[0] if self.spindle_speeds else None

    @property
    def timed_moves(self) -> tuple[Move, ...]:
        """The moves that are simulated: all but the approach."""
        return self.moves[self.approach_count :]

    @property
    def path_length(self) -> float:
        """Length of all simulated moves, corners not rounded [m]."""
        return math.fsum(move.length for move in self.timed_moves)
