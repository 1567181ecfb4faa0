"""What readers of robot programs have in common: the pose, and moves from it."""

import math
from dataclasses import dataclass, field

from ....toolpath import Move, Point
from ..faults import Fault
from ..geometry import circle_through, rotated
from ..move_list import MoveList


@dataclass
class Reader:
    """Where the tool is while a program is read, and the moves so far.

    Attributes:
        position: Tool tip [m], and whether a motion has brought it there.
        axis: Tool axis, tip to shank.
        feed: Feed [m/s], or None before the first.
    """

    out: MoveList = field(default_factory=MoveList)
    position: Point = (0.0, 0.0, 0.0)
    axis: Point = (0.0, 0.0, 1.0)
    is_placed: bool = False
    feed: float | None = None

    @property
    def faults(self) -> list[Fault]:
        """The faults so far."""
        return self.out.faults

    def refuse(self, line: int, word: str, message: str) -> None:
        """Report a fault."""
        self.faults.append(Fault(line, " ".join(word.split())[:40], message))

    def lose_place(self, line: int) -> None:
        """Forget where the tool is, as after a motion of joints."""
        if self.out.moves:
            self.out.begin_section(line)
        self.is_placed = False

    def line_to(
        self,
        end: Point,
        axis: Point,
        line: int,
        *,
        is_rapid: bool = False,
        duration: float | None = None,
    ) -> None:
        """Make a straight move; from an unknown place it is an approach."""
        is_rapid |= not self.is_placed
        feed = None if is_rapid else self._feed(line, duration)
        move = Move(self.position, end, feed=feed, is_rapid=is_rapid, line=line)
        duration = None if is_rapid else duration
        self.out.add(move._replace(duration=duration, axis=axis), "XYZ")
        self.position, self.axis, self.is_placed = end, axis, True

    def arc_to(
        self,
        through: Point,
        end: Point,
        axis: Point,
        line: int,
        *,
        angle: float | None = None,
        duration: float | None = None,
    ) -> None:
        """Make an arc through a point, to another one or over an angle [rad]."""
        try:
            centre, normal = circle_through(self.position, through, end)
        except ValueError as error:
            self.refuse(line, "", str(error))
            return
        if not self.is_placed:
            self.refuse(line, "", "an arc needs a motion to a stated place before it.")
        turns = 1
        if angle is not None:
            if angle == 0 or math.isnan(angle):
                self.refuse(line, "", "an arc has an angle other than 0.")
                return
            if angle < 0:
                normal = (-normal[0], -normal[1], -normal[2])
            end = rotated(self.position, centre, normal, abs(angle))
            turns = max(1, math.ceil(abs(angle) / (2 * math.pi) - 1e-9))
        feed = self._feed(line, duration)
        move = Move(self.position, end, centre, turns, feed, duration, line=line)
        self.out.add(move._replace(normal=normal, axis=axis), "")
        self.position, self.axis = end, axis

    def _feed(self, line: int, duration: float | None) -> float | None:
        """Return the feed of a motion that has no duration of its own."""
        if duration is not None:
            return None
        if self.feed is None:
            self.refuse(line, "", "there is no speed; needed is one before this line.")
        return self.feed
