"""Base of the readers of robot programs: pose, moves from it, axes beside the arm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ....toolpath import Move, Point
from ..expressions import Expression, ExpressionError, Value, Variables, evaluated
from ..faults import Fault
from ..geometry import ToolAxis, circle_through, controller_matrix, rotated
from ..move_list import MoveList

# Height of a unit axis from tip to shank that lies flat, and of one from shank to tip
# that leans from -z by less than 45 degrees.
_FLAT_HEIGHT, _STEEP_HEIGHT = 0.17, -0.7
# As controllers write an axis that is not there, and above.
_UNUSED = 8.9e9
# Two places of an axis are one [mm or deg].
_SAME_PLACE = 1e-6


@dataclass
class Branch:
    """A block that is carried out on a condition: its line, and whether it matters.

    Attributes:
        line: Line at which it begins.
        has_effect: Whether anything in it may move, or change what moves.
    """

    line: int
    has_effect: bool = False


@dataclass
class Reader:
    """Place of the tool while a program is read, and the moves so far.

    Attributes:
        out: The moves so far.
        position: Tool tip [m].
        axis: Tool axis, tip to shank.
        tool_x: X of the tool; None where the program states none.
        tool_axis: Axis of the controller's tool that points from the shank to the tip.
        is_placed: Whether a motion has brought the tip to its position.
        feed: Feed [m/s], or None before the first.
        branches: Blocks on a condition that are open while the program is compiled.
    """

    out: MoveList = field(default_factory=MoveList)
    position: Point = (0.0, 0.0, 0.0)
    axis: Point = (0.0, 0.0, 1.0)
    tool_x: Point | None = None
    tool_axis: ToolAxis = "z"
    is_placed: bool = False
    feed: float | None = None
    branches: list[Branch] = field(default_factory=list)

    def let_matter(self) -> None:
        """Let what is compiled now have an effect in all branches that are open."""
        for branch in self.branches:
            branch.has_effect = True

    def condition_of(self, line: int, value: Expression) -> Expression:
        """Condition of a branch that begins; it may be unknown where nothing moves."""
        self.branches.append(Branch(line))
        return self.condition(value)

    def condition(self, value: Expression) -> Expression:
        """Condition of the innermost branch, as `condition_of`."""
        branch = self.branches[-1]

        def known(variables: Variables) -> Value:
            try:
                return evaluated(value, variables)
            except ExpressionError as error:
                if branch.has_effect:
                    raise
                sentence = "is not known, and decides on nothing that moves"
                self.out.note(error.word or "a condition", sentence, branch.line)
                return False

        return known

    @property
    def faults(self) -> list[Fault]:
        """The faults so far."""
        return self.out.faults

    def refuse(self, line: int, word: str, message: str) -> None:
        """Report a fault."""
        # What a terminal would obey is shown as an escape.
        begin = " ".join(word.split())[:40]
        plain = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in begin)
        self.faults.append(Fault(line, plain, message))

    def set_feed(self, feed: float, word: str, line: int) -> None:
        """Set the feed [m/s], which is above 0."""
        if not 0 < feed < math.inf:
            message = "a speed is above 0, in numbers or declared ones with + - * /."
            self.refuse(line, word, message)
        self.feed = feed

    def note_upright_axis(self) -> None:
        """Note the axis of the tool along which the cutter would stand upright.

        It is said where the cutter lies flat or points up in a cut.
        """
        cuts = [move for move in self.out.moves if not move.is_rapid]
        if not cuts or min(move.axis[2] for move in cuts) > _FLAT_HEIGHT:
            return
        axis = self.tool_axis
        places = {(move.axis, move.tool_x) for move in cuts}
        turned = [controller_matrix(*place, axis)[2] for place in places]
        # Largest z of a direction from the shank to the tip, by its name.
        highest = {
            f"{sign}{name}": max(
                (-row[place] if sign else row[place]) for row in turned
            )
            for place, name in enumerate("xyz")
            for sign in ("", "-")
        }
        best = min(highest, key=lambda name: float(highest[name]))
        if best != self.tool_axis and highest[best] < _STEEP_HEIGHT:
            low = min(cuts, key=lambda move: move.axis[2])
            sentence = (
                f"the cutter, along {self.tool_axis} of the tool, does not stand "
                f'upright; along {best} it would: [program] tool_axis = "{best}"'
            )
            self.out.note("tool axis", sentence, low.line)

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
        tool_x: Point | None = None,
    ) -> None:
        """Make a straight move; from an unknown place it is an approach."""
        is_rapid |= not self.is_placed
        feed = None if is_rapid else self._feed(line, duration)
        move = Move(
            self.position,
            end,
            feed=feed,
            duration=None if is_rapid else duration,
            is_rapid=is_rapid,
            line=line,
            axis=axis,
            tool_x=tool_x,
        )
        self.out.add(move, "XYZ")
        self.position, self.axis, self.tool_x = end, axis, tool_x
        self.is_placed = True

    def arc_to(
        self,
        through: Point,
        end: Point,
        axis: Point,
        line: int,
        *,
        angle: float | None = None,
        duration: float | None = None,
        tool_x: Point | None = None,
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
        self.out.add(move._replace(normal=normal, axis=axis, tool_x=tool_x), "")
        self.position, self.axis, self.tool_x = end, axis, tool_x

    def _feed(self, line: int, duration: float | None) -> float | None:
        """Return the feed of a motion that has no duration of its own."""
        if duration is not None:
            return None
        if self.feed is None:
            message = "there is no speed; needed is one before this line"
            self.refuse(line, "", f"{message}, in KRL or [program] feed.")
        return self.feed


class ExternalAxes:
    """Places of the external axes in the motions of a program.

    Work and robot stand where they are for a whole program. So each axis is to stand
    still; where it does, a note says so.
    """

    def __init__(self) -> None:
        self._places: dict[str, float] = {}
        self._has_moved = False

    def take(self, stated: Mapping[str, float], line: int, reader: Reader) -> None:
        """Use the places of a motion [mm or deg]: they are those of the first."""
        used = {name: at for name, at in stated.items() if abs(at) < _UNUSED}
        for name, at in used.items():
            # Inline forms of KUKA write 0 for an axis that is not there.
            if self._has_moved and name not in self._places and at != 0:
                message = "motions before this line do not state where this axis is."
                reader.refuse(line, name, message)
            before = self._places.setdefault(name, at)
            if abs(at - before) > _SAME_PLACE:
                message = (
                    f"the external axis goes from {before:g} to {at:g}, and takes the "
                    "robot or the work with it; it has to stand still."
                )
                reader.refuse(line, name, message)
        self._has_moved = True
        if used:
            sentence = "stand still, so that the work is at one place in the base"
            reader.out.note("external axes", sentence, line)
