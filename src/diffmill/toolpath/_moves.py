"""The moves of a program in SI units, before they are timed."""

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from ._path import Path
from ._turned_axes import stand_upright, turned_axes, turned_tool_x

Point: TypeAlias = tuple[float, float, float]

_UP = (0.0, 0.0, 1.0)


# A program has up to a million of them: plain tuples are made ten times as fast as
# modules.
class Move(NamedTuple):
    """One motion of a program: a straight line, an arc or a helix.

    An arc keeps its programmed end exactly: a small difference between its radius at
    the start and at the end is spread over the angle.

    Attributes:
        start: Tool tip before the move, in `work` [m].
        end: Tool tip after the move, in `work` [m].
        centre: Centre of an arc in the plane of its start [m]; None for a line.
        turn: 0 for a line; the turns that an arc begins, positive counter-clockwise
            seen from the tip of `normal`: +1 and -1 for all arcs up to a full circle.
        feed: Speed along the move [m/s], or None if none applies.
        duration: Time of an inverse-time move [s], or None.
        is_rapid: Whether the machine moves as fast as it can.
        line: Line of the program, from 1.
        normal: Unit vector along the axis of an arc.
        axis: Unit tool axis at the end, tip to shank.
        rest: Time for which the tool stays at the end [s].
        tool_x: Unit x of the tool at the end, across its axis; None where the program
            leaves the rotation about the axis open.
    """

    start: Point
    end: Point
    centre: Point | None = None
    turn: int = 0
    feed: float | None = None
    duration: float | None = None
    is_rapid: bool = False
    line: int = 0
    normal: Point = _UP
    axis: Point = _UP
    rest: float = 0.0
    tool_x: Point | None = None

    @property
    def spokes(self) -> tuple[Point, Point]:
        """Vectors from the axis of an arc to its start and to its end [m]."""
        if self.centre is None:
            return ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        return _across(self.start, self.centre, self.normal), _across(
            self.end, self.centre, self.normal
        )

    @property
    def radii(self) -> tuple[float, float]:
        """Radius of an arc at its start and end [m]; zeros for a line."""
        first, last = self.spokes
        return math.hypot(*first), math.hypot(*last)

    @property
    def rise(self) -> float:
        """Way of a helix along `normal` [m]."""
        if self.centre is None:
            return 0.0
        return sum(
            (b - a) * n
            for a, b, n in zip(self.start, self.end, self.normal, strict=True)
        )

    @property
    def sweep(self) -> float:
        """Signed angle of an arc [rad], a full turn if it ends where it starts."""
        if self.centre is None:
            return 0.0
        (a, b, c), (x, y, z) = self.spokes
        u, v, w = self.normal
        sign = 1 if self.turn > 0 else -1
        across = u * (b * z - c * y) + v * (c * x - a * z) + w * (a * y - b * x)
        angle = sign * math.atan2(across, a * x + b * y + c * z)
        # Rounding of equal end points must not turn a full circle into no motion.
        if angle < 1e-9:
            angle += 2 * math.pi
        return sign * (angle + 2 * math.pi * (abs(self.turn) - 1))

    @property
    def length(self) -> float:
        """Length of the move [m]; of a spiral, to first order in its pitch."""
        if self.centre is None:
            return math.dist(self.start, self.end)
        first, last = self.radii
        along = 0.5 * (first + last) * self.sweep
        return math.hypot(along, self.rise, last - first)

    def points_at(
        self, share: Float[np.ndarray, " part"]
    ) -> Float[np.ndarray, "part 3"]:
        """Points at shares of the move [m], of an arc at shares of its angle.

        Args:
            share: Shares, shape (part,).
        """
        part = share[:, None]
        if self.centre is None:
            return np.array(self.start) + part * np.subtract(self.end, self.start)
        first, last = self.radii
        normal, radial = np.array(self.normal), np.array(self.spokes[0]) / first
        radius, angle = first + part * (last - first), part * self.sweep
        around = np.cos(angle) * radial + np.sin(angle) * np.cross(normal, radial)
        return np.array(self.centre) + radius * around + part * self.rise * normal

    @property
    def bounds(self) -> tuple[Point, Point]:
        """Least and greatest coordinates of all points of the move [m].

        A coordinate of an arc turns back where its derivative by the angle is zero;
        the slope of a spiral's radius is left out of that.
        """
        points = [self.start, self.end]
        if self.centre is not None and self.radii[0] > 0:
            points += self.points_at(np.array(self._turning_shares())).tolist()
        x, y, z = zip(*points, strict=True)
        return (min(x), min(y), min(z)), (max(x), max(y), max(z))

    def _turning_shares(self) -> list[float]:
        """Shares of an arc's angle at which a coordinate turns back."""
        # symbols: u radial at the start, v = normal x u, t angle from 0 to sweep;
        # a coordinate is r (u cos t + v sin t) + n rise t / sweep
        radius, sweep = self.radii[0], self.sweep
        u = np.array(self.spokes[0]) / radius
        v = np.cross(self.normal, u)
        shares = []
        for axis in range(3):
            r = radius * math.hypot(u[axis], v[axis])
            slope = self.rise * self.normal[axis] / sweep
            if r <= abs(slope) or r < 1e-12 * radius:
                continue
            # r sin(t - t_0) = slope, t_0 being where u cos t + v sin t is largest.
            t_0, lean = math.atan2(v[axis], u[axis]), math.asin(slope / r)
            for t in (t_0 + lean, t_0 + math.pi - lean):
                ends = sorted([-t / math.tau, (sweep - t) / math.tau])
                # Of several turns the first and the last reach farthest.
                turns = {math.ceil(ends[0]), math.floor(ends[1])}
                inside = [turn for turn in turns if ends[0] <= turn <= ends[1]]
                shares += [(t + turn * math.tau) / sweep for turn in inside]
        return shares

    def axes_at(
        self, share: Float[np.ndarray, " part"], start_axis: Point
    ) -> Float[np.ndarray, "part 3"]:
        """Return the unit tool axes at shares of the move, over which it turns evenly.

        Args:
            share: Shares of the length, shape (part,).
            start_axis: Tool axis before the move.

        Raises:
            ValueError: If the axis turns to the opposite one.
        """
        first, last = np.array([start_axis]), np.array([self.axis])
        try:
            return turned_axes(first, last, share)
        except ValueError as error:
            raise ValueError(f"line {self.line}: {error}") from error

    def tool_x_at(
        self,
        share: Float[np.ndarray, " part"],
        start: "Move",
        axes: Float[np.ndarray, "part 3"],
    ) -> Float[np.ndarray, "part 3"] | None:
        """Unit tool x at shares of the move, None where the program states none.

        Args:
            share: Shares of the length, shape (part,).
            start: The move before.
            axes: Tool axes there, as `axes_at` has them, shape (part, 3).
        """
        if self.tool_x is None:
            return None
        before = start.tool_x or self.tool_x
        first, last = (*start.axis, *before), (*self.axis, *self.tool_x)
        return turned_tool_x(np.array([first]), np.array([last]), share, axes)


class Section(NamedTuple):
    """Moves in a row that one tool makes.

    The first of them may be rapid moves from an unknown place, because not every axis
    had been programmed before them. They fix where the motion begins, and are no part
    of it.

    Attributes:
        tool: Number of the tool, or None if the program names none.
        first: Index of the first move.
        stop: Index behind the last move.
        approach_count: Number of leading rapid moves that come from an unknown place.
        spindle_speeds: Different speeds that are set, in order [rad/s].
        line: Line of the program with which it begins.
        tool_position: Tip of the tool in the flange [m], where the program states it.
        tool_rpy: Orientation of the tool in the flange, its z up the shank: roll,
            pitch and yaw [rad], where the program states it.
    """

    tool: int | None
    first: int
    stop: int
    approach_count: int = 0
    spindle_speeds: tuple[float, ...] = ()
    line: int = 1
    tool_position: Point | None = None
    tool_rpy: Point | None = None


@dataclasses.dataclass(frozen=True)
class Program:
    """A program as read: its moves in order and what else it says.

    Attributes:
        moves: The moves, zero-length ones included, each starting where the one
            before it ended; the first starts at the origin of `work`. Where the
            section changes, the tip may jump.
        approach_count: Number of leading rapid moves that come from an unknown place
            and are no part of the simulated motion.
        spindle_speeds: Different speeds that the program sets, in order [rad/s].
        source: The program's text.
        name: Name of its file, for messages.
        sections: Which tool makes which moves; empty if one makes all.
        notes: What the program says without an effect on the motion, or what was
            assumed, a sentence each.
        work_position: Origin of `work` in the base of the robot [m], where the program
            states it.
        work_rpy: Orientation of `work` in it: roll, pitch and yaw [rad].
        first_angles: Angles A, B, C with which the first position is written [deg]:
            two triples state the same orientation.
        first_status: Which way the joints of a robot reach the first position: status
            and turn (KRL), or the four numbers of a configuration (RAPID).
        tool_axis: Axis of the controller's tool in its source that points from the
            shank to the tip; None in a format without one.
    """

    moves: tuple[Move, ...]
    approach_count: int = 0
    spindle_speeds: tuple[float, ...] = ()
    source: str = ""
    name: str = "program"
    sections: tuple[Section, ...] = ()
    notes: tuple[str, ...] = ()
    work_position: Point | None = None
    work_rpy: Point | None = None
    first_angles: Point | None = None
    first_status: tuple[float, ...] = ()
    tool_axis: str | None = None

    def __post_init__(self):
        if not 0 <= self.approach_count <= len(self.moves):
            raise ValueError(
                "Argument `approach_count` must lie between 0 and the number of moves "
                f"({len(self.moves)}), but is {self.approach_count}."
            )

    @classmethod
    def of_path(cls, path: Path, *, name: str = "path") -> "Program":
        """Return a path as straight moves that take the time of its rows.

        Args:
            path: The path.
            name: Name for messages.
        """
        time, points = np.asarray(path.time), np.asarray(path.positions).tolist()
        axes, lines = np.asarray(path.axes).tolist(), np.asarray(path.line).tolist()
        sides = [None] * len(lines)
        if path.tool_x is not None:
            sides = [point_of(row) for row in np.asarray(path.tool_x).tolist()]
        start = point_of(points[0])
        first = Move((0.0, 0.0, 0.0), start, is_rapid=True, line=lines[0])
        moves = [first._replace(axis=point_of(axes[0]), tool_x=sides[0])]
        durations = np.diff(time).tolist()
        for row, duration in enumerate(durations, 1):
            end = point_of(points[row])
            move = Move(start, end, duration=duration, line=lines[row])
            moves.append(move._replace(axis=point_of(axes[row]), tool_x=sides[row]))
            start = end
        return cls(tuple(moves), approach_count=1, name=name)

    @property
    def spindle_speed(self) -> float | None:
        """The first speed that the program sets [rad/s], or None."""
        return self.spindle_speeds[0] if self.spindle_speeds else None

    @property
    def is_upright(self) -> bool:
        """True if the tool axis is +z after every move, to 1e-4."""
        axes = [move.axis for move in self.moves]
        return stand_upright(np.reshape(np.array(axes, np.float64), (-1, 3)))

    @property
    def states_rotation(self) -> bool:
        """True if every move states the rotation about the tool axis."""
        return all(move.tool_x is not None for move in self.moves)

    def without_rotation(self) -> "Program":
        """Return the program with the rotation about the tool axis left open."""
        moves = tuple(move._replace(tool_x=None) for move in self.moves)
        return dataclasses.replace(self, moves=moves, first_angles=None)

    @property
    def timed_moves(self) -> tuple[Move, ...]:
        """The moves that are simulated: all but the approach.

        A rest is a move of its own, without a length, that takes its time.
        """
        moves = self.moves[self.approach_count :]
        if not any(move.rest for move in moves):
            return moves
        out = []
        for move in moves:
            out.append(move._replace(rest=0.0))
            if move.rest:
                dwell = Move(move.end, move.end, duration=move.rest, line=move.line)
                out.append(dwell._replace(axis=move.axis, tool_x=move.tool_x))
        return tuple(out)

    @property
    def path_length(self) -> float:
        """Length of all simulated moves, corners not rounded [m]."""
        return math.fsum(move.length for move in self.timed_moves)

    @property
    def tools(self) -> tuple[int | None, ...]:
        """Numbers of the tools in the order of their first move; None for no number."""
        return tuple(dict.fromkeys(part.tool for part in self.sections)) or (None,)

    def cuts(self, tool: int | None) -> bool:
        """True if a tool makes a move at a feed."""
        if not self.sections:
            return any(not move.is_rapid for move in self.moves)
        return any(
            not move.is_rapid and move.length > 0
            for part in self.sections
            if part.tool == tool
            for move in self.moves[part.first : part.stop]
        )

    def of_tool(self, tool: int | None = None) -> "Program":
        """Return the program of one tool alone.

        Where other tools work in between, a rapid move goes straight from where the
        tool was left to where its place is known again.

        Args:
            tool: Number of the tool; None for the first that makes a move at a feed.

        Raises:
            ValueError: If the program has no such tool.
        """
        if len(self.sections) < 2 and tool in (None, *self.tools):
            return self
        if tool is None:
            tool = next((one for one in self.tools if self.cuts(one)), self.tools[0])
        parts = [part for part in self.sections if part.tool == tool]
        if not parts:
            names = ", ".join(f"T{one}" for one in self.tools if one is not None)
            raise ValueError(
                f"{self.name}: there is no tool {tool}; found: {names or 'no T word'}."
            )
        moves: list[Move] = []
        for part in parts:
            own = self.moves[part.first : part.stop]
            if moves and part.approach_count:
                own = own[part.approach_count - 1 :]
                own = (own[0]._replace(start=moves[-1].end), *own[1:])
            elif moves and own and own[0].start != moves[-1].end:
                first = own[0]
                bridge = Move(
                    moves[-1].end, first.start, is_rapid=True, line=first.line
                )
                moves.append(bridge._replace(axis=first.axis, tool_x=first.tool_x))
            moves.extend(own)
        speeds = dict.fromkeys(speed for part in parts for speed in part.spindle_speeds)
        return dataclasses.replace(
            self,
            moves=tuple(moves),
            approach_count=parts[0].approach_count,
            spindle_speeds=tuple(speeds),
            sections=(parts[0]._replace(first=0, stop=len(moves)),),
        )


def point_of(values: Iterable[float]) -> Point:
    """Point of three numbers, an array's as plain ones."""
    x, y, z = values.tolist() if isinstance(values, np.ndarray) else values
    return x, y, z


def _across(point: Point, centre: Point, normal: Point) -> Point:
    """Return the vector from a centre to a point, without its part along a normal."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    u, v, w = normal
    along = u * x + v * y + w * z
    return x - along * u, y - along * v, z - along * w
