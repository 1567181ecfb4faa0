"""Pieces of a program with what limits the speed on each, and why."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from .._moves import Move, Point, Program
from .._turned_axes import LEAST_SUM, turned_axes, turned_tool_x
from .corners import REVERSAL_ANGLE, TANGENT_ANGLE, Corner, corner_angle, round_corner
from .pieces import Blend, Piece, piece_of_move, scaled
from .smoothing import slow_ranges
from .way_limits import WayLimit

# Pieces shorter than this are numerical crumbs of a trimmed move.
SHORTEST_LENGTH = 1e-12
# Below a nanometre a rounded corner is an exact stop in all but name.
_FINEST_TOLERANCE = 1e-9
# Unit axes that are nearer to each other differ by rounding.
_SAME_AXIS = 1e-9
# What limits a motion, beside joints, which are named.
FEED, ACCELERATION, CURVE, JERK = "feed", "acceleration", "curves", "jerk"


class TimingLimits(NamedTuple):
    """Limits to which a controller keeps a motion.

    Attributes:
        acceleration: Largest acceleration along and across the path [m/s^2].
        rapid_feed: Speed of rapid moves [m/s].
        corner_tolerance: Largest distance from a corner [m]; 0 stops exactly there.
        feed: Speed of feed moves that state none [m/s].
        smoothing: Time over which the motion along the path is averaged [s].
    """

    acceleration: float
    rapid_feed: float
    corner_tolerance: float
    feed: float | None = None
    smoothing: float = 0.0

    def check(self) -> None:
        """Refuse limits that are none.

        Raises:
            ValueError: If one of them is not positive, or not zero where it may be.
        """
        for name, value in zip(self._fields, self, strict=True):
            if value is None:
                continue
            may_be_zero = name in ("corner_tolerance", "smoothing")
            if math.isfinite(value) and (value > 0 or (may_be_zero and value == 0)):
                continue
            allowed = "zero or positive" if may_be_zero else "positive and finite"
            raise ValueError(f"Argument `{name}` must be {allowed}, but is {value}.")


class Leg(NamedTuple):
    """A piece with what limits its speed.

    The tool turns evenly from `first_axis` to `last_axis`, and about its axis from
    `first_x` to `last_x`.

    Attributes:
        piece: Its shape.
        asked: Speed that the program asks for [m/s].
        speed: Largest speed on it [m/s].
        acceleration: Largest acceleration along it [m/s^2].
        duration: Time that the program states for it [s], or None.
        is_rapid: Whether it is a rapid move.
        line: Line of the program.
        cause: What keeps its speed below that asked for.
        ramp_cause: What keeps its acceleration within bounds.
        is_stop: Whether the tool is at rest at its end.
        first_axis: Unit tool axis at its start.
        last_axis: Unit tool axis at its end.
        first_x: Unit x of the tool at its start; None where the program states none.
        last_x: Unit x of the tool at its end.
    """

    piece: Piece
    asked: float
    speed: float
    acceleration: float
    duration: float | None
    is_rapid: bool
    line: int
    cause: str = FEED
    ramp_cause: str = ACCELERATION
    is_stop: bool = True
    first_axis: Point = (0.0, 0.0, 1.0)
    last_axis: Point = (0.0, 0.0, 1.0)
    first_x: Point | None = None
    last_x: Point | None = None

    @property
    def has_exact_ends(self) -> bool:
        """True if no corner at its ends is rounded: rapid and inverse-time moves."""
        return self.is_rapid or self.duration is not None

    def axis_at(self, distance: float) -> Point:
        """Return the unit tool axis at a distance from the start."""
        if self.first_axis == self.last_axis:
            return self.first_axis
        share = np.array([distance / self.piece.length])
        first, last = np.array([self.first_axis]), np.array([self.last_axis])
        x, y, z = turned_axes(first, last, share)[0].tolist()
        return x, y, z

    def tool_x_at(self, distance: float) -> Point | None:
        """Return the unit x of the tool at a distance from the start."""
        if self.first_x is None or self.last_x is None:
            return None
        share, axis = np.array([distance / self.piece.length]), self.axis_at(distance)
        first = np.array([[*self.first_axis, *self.first_x]])
        last = np.array([[*self.last_axis, *self.last_x]])
        x, y, z = turned_tool_x(first, last, share, np.array([axis]))[0].tolist()
        return x, y, z

    def slower(self, speed: float, cause: str) -> "Leg":
        """Return the leg with a smaller limit, the same if it is not smaller."""
        return self._replace(speed=speed, cause=cause) if speed < self.speed else self

    def within(self, limit: WayLimit) -> "Leg":
        """Return the leg within a limit of the way."""
        leg = self.slower(limit.speed, limit.cause)
        if limit.acceleration >= leg.acceleration:
            return leg
        return leg._replace(acceleration=limit.acceleration, ramp_cause=limit.cause)

    def split(self, lengths: list[float]) -> list["Leg"]:
        """Return the leg in parts of given lengths, which add up to its own."""
        out = []
        head, tail = 0.0, self.piece.length
        for length in lengths:
            tail -= length
            piece = self.piece
            assert not isinstance(piece, Blend)
            piece = piece.trimmed(head, max(tail, 0.0))
            first, first_x = self.axis_at(head), self.tool_x_at(head)
            head += length
            part = self._replace(piece=piece, is_stop=False)
            part = part._replace(first_axis=first, last_axis=self.axis_at(head))
            out.append(part._replace(first_x=first_x, last_x=self.tool_x_at(head)))
        out[-1] = out[-1]._replace(is_stop=self.is_stop)
        return out


def legs_of_program(
    program: Program, limits: TimingLimits, along: tuple[WayLimit, ...]
) -> list[Leg]:
    """Return the pieces of a program, corners rounded, speeds limited.

    Args:
        program: The program; its approach is left out.
        limits: The limits of the controller.
        along: Further limits along the way.

    Raises:
        ValueError: If a feed is missing, the tool turns on the spot or to the opposite
            axis, or nothing moves.
    """
    legs = _rounded(_sharp_legs(program, limits), limits.corner_tolerance)
    if not legs:
        raise ValueError(
            f"{program.name}: the program moves nothing after its approach."
        )
    legs = [_slower_in_curves(leg) for leg in legs]
    if along:
        legs = _limited(legs, along)
    if limits.smoothing > 0:
        legs = _slowed(legs, limits.smoothing)
    return legs


def rounded_corner_count(program: Program, limits: TimingLimits) -> int:
    """Number of the rounded corners of a program.

    Args:
        program: The program; its approach is left out.
        limits: The limits of the controller.

    Raises:
        ValueError: If a feed is missing, or the tool turns on the spot or to the
            opposite axis.
    """
    legs = _sharp_legs(program, limits)
    pairs = zip(legs, [*legs[1:], None], strict=False)
    joints = [_joint(*pair, limits.corner_tolerance) for pair in pairs]
    return sum(corner is not None for corner, _ in joints)


def _sharp_legs(program: Program, limits: TimingLimits) -> list[Leg]:
    """Return the moves of a program with their speeds, corners as they are."""
    moves = program.timed_moves
    if not moves:
        return []
    approach = program.moves[: program.approach_count]
    before = approach[-1] if approach else moves[0]
    axis, tool_x = before.axis, before.tool_x
    legs = []
    for move in moves:
        if move.length > 0 or move.duration is not None:
            if math.dist(move.axis, scaled(axis, -1.0)) < LEAST_SUM:
                raise ValueError(
                    f"{program.name}, line {move.line}: the tool turns to the opposite "
                    "axis, and nothing says which way round."
                )
            leg = _leg(move, limits, program.name)
            leg = leg._replace(first_axis=axis, last_axis=move.axis)
            legs.append(leg._replace(first_x=tool_x, last_x=move.tool_x))
            axis, tool_x = move.axis, move.tool_x
        elif math.dist(move.axis, axis) > _SAME_AXIS:
            raise ValueError(
                f"{program.name}, line {move.line}: the tool turns on the spot, which "
                "has no time."
            )
    return legs


def sections_of(legs: list[Leg]) -> Int[np.ndarray, " piece"]:
    """Return for every piece how many stops are before it."""
    return np.cumsum([0, *(leg.is_stop for leg in legs[:-1])])


def _leg(move: Move, limits: TimingLimits, name: str) -> Leg:
    """Return a move with its speed limit."""
    piece = piece_of_move(move)
    speed = limits.rapid_feed if move.is_rapid else move.feed
    if move.duration is not None:
        speed = piece.length / move.duration
    elif speed is None:
        speed = limits.feed
    if speed is None:
        raise ValueError(
            f"{name}, line {move.line}: the move has no feed, and none was given "
            "(argument `feed`; in a job: [program] feed)."
        )
    a = limits.acceleration
    return Leg(piece, speed, speed, a, move.duration, move.is_rapid, move.line)


def _rounded(legs: list[Leg], tolerance: float) -> list[Leg]:
    """Return the legs with rounded corners between them and stops marked."""
    out: list[Leg] = []
    head = 0.0
    for before, after in zip(legs, [*legs[1:], None], strict=False):
        corner, is_stop = _joint(before, after, tolerance)
        tail = 0.0 if corner is None else corner.trim
        piece = before.piece
        if head + tail > 0 and not isinstance(piece, Blend):
            piece = piece.trimmed(head, tail)
        if piece.length > SHORTEST_LENGTH or before.duration is not None:
            out.append(before._replace(piece=piece, is_stop=is_stop))
        elif out and is_stop:
            out[-1] = out[-1]._replace(is_stop=True)
        if corner is not None and after is not None:
            speed = min(before.speed, after.speed)
            leg = after._replace(piece=corner.piece, asked=speed, speed=speed)
            axis, x = before.last_axis, before.last_x
            leg = leg._replace(first_axis=axis, last_axis=axis, first_x=x, last_x=x)
            out.append(leg._replace(is_stop=False))
        head = tail
    return out


def _joint(
    before: Leg, after: Leg | None, tolerance: float
) -> tuple[Corner | None, bool]:
    """Rounded corner between two legs, None without one; true if the tool stops."""
    if after is None or before.has_exact_ends or after.has_exact_ends:
        return None, True
    if isinstance(before.piece, Blend) or isinstance(after.piece, Blend):
        return None, False
    angle = corner_angle(before.piece, after.piece)
    if angle < TANGENT_ANGLE:
        return None, False
    if tolerance > _FINEST_TOLERANCE and angle < REVERSAL_ANGLE:
        return round_corner(before.piece, after.piece, angle, tolerance), False
    return None, True


def _slower_in_curves(leg: Leg) -> Leg:
    """Leg whose centripetal acceleration is within its limit: v^2 kappa <= a."""
    curvature = leg.piece.curvature
    if leg.duration is not None or curvature == 0:
        return leg
    return leg.slower(math.sqrt(leg.acceleration / curvature), CURVE)


def _limited(legs: list[Leg], along: tuple[WayLimit, ...]) -> list[Leg]:
    """Return the legs, split where limits along the way begin and end."""
    out: list[Leg] = []
    way, index = 0.0, 0
    for leg in legs:
        end = way + leg.piece.length
        parts, crossed = [], [along[index]]
        while along[index].end < end and index + 1 < len(along):
            length = along[index].end - way - math.fsum(parts)
            index += 1
            if length > SHORTEST_LENGTH:
                parts.append(length)
                crossed.append(along[index])
            else:
                crossed[-1] = along[index]
        last = leg.piece.length - math.fsum(parts)
        way = end
        if leg.duration is not None:
            out.append(leg)
        elif isinstance(leg.piece, Blend) or not parts or last <= SHORTEST_LENGTH:
            for limit in crossed:
                leg = leg.within(limit)
            out.append(leg)
        else:
            pieces = leg.split([*parts, last])
            out += [p.within(limit) for p, limit in zip(pieces, crossed, strict=True)]
    return out


def _slowed(legs: list[Leg], smoothing: float) -> list[Leg]:
    """Return the legs, split where a slow one slows down its neighbours.

    Then speeds that are averaged in time keep the limit of every piece.
    """
    out = []
    ranges = slow_ranges(
        np.array([leg.piece.length for leg in legs]),
        np.array([leg.speed for leg in legs]),
        sections_of(legs),
        smoothing,
    )
    for leg, parts in zip(legs, ranges, strict=True):
        if len(parts) == 1 or isinstance(leg.piece, Blend):
            out.append(leg.slower(min(part.speed for part in parts), JERK))
            continue
        slowed = zip(leg.split([p.length for p in parts]), parts, strict=True)
        out += [piece.slower(part.speed, JERK) for piece, part in slowed]
    return out
