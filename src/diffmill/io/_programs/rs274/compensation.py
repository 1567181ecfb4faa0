"""Compensation of the cutter's radius (G41, G42), on the path that LinuxCNC takes.

The tool runs beside the programmed path, a radius off. At an outside corner it goes
round the corner on an arc; at an inside corner it stops where it touches both sides.
The first move leads beside its end, the one behind G40 from there to where it ends.
Points of the working plane are complex numbers [m].
"""

import cmath
import math
from typing import NamedTuple

from ....toolpath import Move, Point
from ..faults import Fault
from ..move_list import MoveList

# LinuxCNC, interp_internal.hh: directions that differ by less go on straight [rad].
_STRAIGHT = 0.05
# An arc that is cut short may turn by so much more than programmed [rad].
_LONGER = 0.0254


class _Side(NamedTuple):
    """Path of the tool's centre along one programmed move.

    Attributes:
        begin: Programmed start.
        end: Programmed end.
        first: Unit direction at its start.
        last: Unit direction at its end.
        centre: Centre of an arc; None of a line.
        radius: Radius of the arc of the tool's centre [m].
        turn: 1 for a counter-clockwise arc, -1 for a clockwise one.
    """

    begin: complex
    end: complex
    first: complex
    last: complex
    centre: complex | None = None
    radius: float = 0.0
    turn: float = 0.0

    def travel(self, begin: complex, end: complex) -> float:
        """Angle from a point of the arc to another, the way it turns [rad]."""
        centre = self.centre or 0j
        angle = self.turn * cmath.phase((end - centre) / (begin - centre))
        # Rounding must not turn a short way into a whole turn.
        return angle if angle > -_STRAIGHT else angle + 2 * math.pi


class _PendingMove(NamedTuple):
    """Move whose end follows from the next corner, and the axes that it states."""

    move: Move
    axes: str


class CutterCompensation:
    """Moves of the tool beside programmed ones.

    Attributes:
        out: Takes the moves.
        side: 1 where the tool is on the left of the path, -1 on the right.
        radius: Radius of the cutter [m], not negative.
        plane: Index of the axis across the working plane.
        place: Where the tool is [m]; None before the first move.
    """

    def __init__(self, out: MoveList, side: int, radius: float, plane: int):
        self.out, self.side, self.radius, self.plane = out, side, radius, plane
        self.place: Point | None = None
        self._before: _Side | None = None
        self._is_entry = False
        self._pending: list[_PendingMove] = []
        self._is_lost = False

    def add(self, move: Move, axes: str) -> None:
        """Add a programmed move."""
        if self._is_lost or self.radius == 0 or any(map(math.isnan, move.end)):
            self.out.add(move, axes)
            return
        self.place = move.start if self.place is None else self.place
        if move.duration is not None:
            move = move._replace(feed=move.length / move.duration, duration=None)
        if move.centre is None and self._flat(move.start) == self._flat(move.end):
            # Up or down: where the move before it ends.
            self._pending.append(_PendingMove(move, axes))
            if self._before is None:
                self._release(self._flat(move.end))
            return
        try:
            move, side = self._offset_move(move)
        except ValueError as error:
            self._is_lost = True
            self.out.faults.append(Fault(move.line, "", str(error)))
            return
        self._pending.append(_PendingMove(move, axes))
        self._is_entry, self._before = self._before is None, side

    def dwell(self, duration: float, line: int, word: str) -> None:
        """Let the tool rest behind the last programmed move [s]."""
        if not self._pending:
            self.out.dwell(duration, line, word)
            return
        last = self._pending[-1]
        rested = self.out.rested(last.move, duration, line, word)
        self._pending[-1] = last._replace(move=rested)

    def finish(self) -> Point | None:
        """Make the last move; return where the tool is then [m]."""
        if self._before is not None and not self._is_lost:
            try:
                self._release(self._before.end + self._offset(self._before.last))
            except ValueError as error:
                line = self._pending[0].move.line
                self.out.faults.append(Fault(line, "", str(error)))
        return None if self._before is None else self.place

    def _flat(self, point: Point) -> complex:
        first, second = (self.plane + 1) % 3, (self.plane + 2) % 3
        return complex(point[first], point[second])

    def _lifted(self, point: complex, height: float) -> Point:
        values = [0.0, 0.0, 0.0]
        values[self.plane] = height
        values[(self.plane + 1) % 3] = point.real
        values[(self.plane + 2) % 3] = point.imag
        return values[0], values[1], values[2]

    def _offset(self, direction: complex) -> complex:
        """From the path to the centre of the tool, where the path has a direction."""
        return self.side * 1j * direction * self.radius

    def _offset_move(self, move: Move) -> tuple[Move, _Side]:
        """The move beside a programmed one, and its side, behind its corner."""
        begin, end = self._flat(move.start), self._flat(move.end)
        centre = None if move.centre is None else self._flat(move.centre)
        first = last = _unit(end - begin)
        distance = sign = 0.0
        if centre is not None:
            sign = math.copysign(1, move.turn)
            first, last = (sign * 1j * _unit(p - centre) for p in (begin, end))
            distance = abs(end - centre) - sign * self.side * self.radius
            if distance <= 0:
                raise ValueError("the cutter does not fit inside this arc.")
        side = _Side(begin, end, first, last, centre, distance, sign)
        if self._before is None:
            centre = self._entered(side)
            side = side._replace(radius=abs(end + self._offset(last) - (centre or 0)))
            side = side._replace(centre=centre)
        else:
            self._turn(self._before, side, move)
        if centre is not None:
            move = move._replace(centre=self._lifted(centre, move.start[self.plane]))
        return move, side

    def _entered(self, side: _Side) -> complex | None:
        """Centre of an arc that leads from the path beside its end; None of a line."""
        if abs(side.end - side.begin) <= self.radius:
            message = "the first move of G41 and G42 is longer than the radius of the "
            raise ValueError(message + f"cutter, {self.radius * 1e3:g} mm here.")
        if side.centre is None:
            return None
        end = side.end + self._offset(side.last)
        inward, way = _unit(side.centre - side.end), side.begin - end
        along = (inward.conjugate() * way).real
        if abs(along) < 1e-4 * abs(way):
            raise ValueError("no arc leads from here beside the path.")
        return end + inward * abs(way) ** 2 / (2 * along)

    def _turn(self, before: _Side, side: _Side, move: Move) -> None:
        """Make the moves before a corner, and round it if it is an outside one."""
        corner, angle = side.begin, -self.side * cmath.phase(side.first / before.last)
        if abs(angle) > math.pi - _STRAIGHT:
            # Back again: into the cusp of arcs, else round the end of the path.
            bulge = side if side.centre is not None else before
            is_inside = bulge.turn * self.side < 0
        else:
            is_inside = angle < -_STRAIGHT
        if is_inside:
            self._release(self._meeting(before, side))
            return
        self._release(corner + self._offset(before.last))
        if abs(angle) <= _STRAIGHT:
            return
        place = self.place or move.start
        height = place[self.plane]
        end = self._lifted(corner + self._offset(side.first), height)
        # There is no rapid arc.
        round_it = Move(place, end, feed=move.feed, is_rapid=move.is_rapid)
        round_it = round_it._replace(line=move.line, normal=move.normal)
        if not move.is_rapid:
            middle = self._lifted(corner, height)
            round_it = round_it._replace(centre=middle, turn=-self.side)
            round_it = round_it._replace(normal=self._lifted(0j, 1.0))
        self.out.add(round_it, "")
        self.place = end

    def _meeting(self, before: _Side, side: _Side) -> complex:
        """Intersection of the tool's paths along two moves, next to their corner."""
        corner = side.begin
        a, b = corner + self._offset(before.last), corner + self._offset(side.first)
        if before.centre is None and side.centre is None:
            across = (before.last.conjugate() * side.first).imag
            along = ((b - a).conjugate() * side.first).imag / across
            return a + along * before.last
        shift = 0j
        if before.centre is None or side.centre is None:
            line, circle = (before, side) if before.centre is None else (side, before)
            point, way = (a, before.last) if line is before else (b, side.first)
            centre = circle.centre or 0j
            if line is before:
                # As if the arc, whose ends are rounded, began at its end's radius.
                shift = corner - centre
                shift -= _unit(shift) * abs(circle.end - centre)
                centre += shift
            foot = point + way * (way.conjugate() * (centre - point)).real
            square = circle.radius**2 - abs(centre - foot) ** 2
        else:
            between = side.centre - before.centre
            if between == 0:
                raise ValueError("two arcs of one centre have no corner.")
            way = 1j * _unit(between)
            along = before.radius**2 - side.radius**2 + abs(between) ** 2
            foot = before.centre + between * along / (2 * abs(between) ** 2)
            square = before.radius**2 - abs(foot - before.centre) ** 2
        if square < 0:
            raise ValueError(
                "the cutter does not fit into the corner before this move."
            )
        root, foot = math.sqrt(square) * way, foot - shift
        both = (foot + root, foot - root)
        # The point that is met first, back along the one arc or along the other.
        if before.centre is not None:
            return min(both, key=lambda point: before.travel(point, a))
        return min(both, key=lambda point: side.travel(b, point))

    def _release(self, end: complex) -> None:
        """Make the moves that wait, which all end at a point of the plane."""
        for index, (move, axes) in enumerate(self._pending):
            place = self.place or move.start
            made = move._replace(start=place)
            height = move.end[self.plane]
            made = made._replace(end=self._lifted(end, height))
            if move.centre is not None:
                middle = self._lifted(self._flat(move.centre), place[self.plane])
                made = made._replace(centre=middle)
            if index == 0 and self._is_reversed(made, move):
                message = "the cutter does not reach the corner behind this move "
                raise ValueError(message + f"(line {move.line}) without a gouge.")
            self.out.add(made, axes)
            self.place = made.end
        self._pending = []

    def _is_reversed(self, made: Move, move: Move) -> bool:
        """True if a move that is cut short goes backwards."""
        if self._before is None:
            return False
        if move.centre is not None:
            return abs(made.sweep) > abs(move.sweep) + _LONGER
        way = self._before.last
        if self._is_entry:
            way = self._offset(way)
        shift = self._flat(made.end) - self._flat(made.start)
        return (way.conjugate() * shift).real < -1e-12


def _unit(value: complex) -> complex:
    return value / abs(value) if value else 1.0 + 0j
