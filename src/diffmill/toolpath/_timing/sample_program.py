"""Timing of a program under feed and acceleration limits.

The moves become smooth pieces (corners rounded, or exact stops), each with the largest
speed that the feed and the centripetal acceleration allow. A backward and a forward
pass over the pieces give the speeds at their ends that a bounded tangential
acceleration can reach, and each piece is then travelled by speeding up, cruising and
slowing down, smoothed over a time if asked for. The path is read off at the tooth
instants.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._types import RealScalarLike
from .._moves import Move, Point, Program
from .._path import MOST_STEPS, Path, check_steps
from .corners import REVERSAL_ANGLE, TANGENT_ANGLE, Corner, corner_angle, round_corner
from .pieces import Arc, Blend, Piece, Segment, arc_positions, piece_of_move
from .smoothing import WayInTime, mean_way, slow_ranges

# Pieces shorter than this are numerical crumbs of a trimmed move.
_SHORTEST = 1e-12
# Below a nanometre a rounded corner is an exact stop in all but name.
_FINEST_TOLERANCE = 1e-9
# Fraction of a tooth period by which sums of durations may miss a tooth instant.
_SAME_INSTANT = 1e-6


class _Leg(NamedTuple):
    """A piece with what limits its speed; `is_stop`: at rest at its end.

    The tool axis turns evenly from `first_axis` to `last_axis`.
    """

    piece: Piece
    speed: float
    duration: float | None
    is_rapid: bool
    line: int
    is_stop: bool = True
    first_axis: Point = (0.0, 0.0, 1.0)
    last_axis: Point = (0.0, 0.0, 1.0)


class _Profile(NamedTuple):
    """Trapezoidal speed over the pieces, one entry per piece."""

    length: Float[np.ndarray, " piece"]
    speed_in: Float[np.ndarray, " piece"]
    speed_peak: Float[np.ndarray, " piece"]
    speed_out: Float[np.ndarray, " piece"]
    time_rise: Float[np.ndarray, " piece"]
    time_fall: Float[np.ndarray, " piece"]
    duration: Float[np.ndarray, " piece"]


def sample_program(
    program: Program,
    tooth_period: RealScalarLike,
    *,
    acceleration: RealScalarLike,
    rapid_feed: RealScalarLike,
    corner_tolerance: RealScalarLike,
    feed: RealScalarLike | None = None,
    smoothing: RealScalarLike = 0.0,
    most_steps: RealScalarLike = MOST_STEPS,
) -> Path:
    """Return where the tool is at every tooth instant.

    The tangential and the centripetal acceleration each stay within the limit. The
    tool starts and ends at rest and stops where a rapid move begins or ends, where it
    turns back, and, without a corner tolerance, at every corner. Moves that give a
    duration (inverse time) take exactly that, at a constant speed, unrounded and not
    smoothed; one of them without a displacement holds the tool for its duration.

    Args:
        program: The program; its approach is left out.
        tooth_period: Time between rows T [s].
        acceleration: Largest acceleration along and across the path [m/s^2].
        rapid_feed: Speed of rapid moves [m/s].
        corner_tolerance: Largest distance from a corner [m]; 0 stops exactly there.
        feed: Speed of feed moves that state none [m/s].
        smoothing: Time over which the way along the path is averaged [s]: the tool
            stays on the path and within the limits, the tangential acceleration changes
            by 2 acceleration / smoothing at most, and the way from one stop to the next
            takes so much longer. Where the curvature jumps, the centripetal
            acceleration still does.
        most_steps: Largest number of tooth periods.

    Returns:
        The path. Its last row is the end point, at or just after the end of the
        motion. A row carries the line and the kind of the move that ends there or
        passes there.

    Raises:
        ValueError: If a limit is not positive, a feed is missing, nothing moves, or
            the motion takes more than `most_steps`.
    """
    limits = {
        "tooth_period": tooth_period,
        "acceleration": acceleration,
        "rapid_feed": rapid_feed,
    }
    if feed is not None:
        limits["feed"] = feed
    for name, value in limits.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(
                f"Argument `{name}` must be positive and finite, but is {value}."
            )
    if not (math.isfinite(corner_tolerance) and corner_tolerance >= 0):
        raise ValueError(
            "Argument `corner_tolerance` must be zero or positive, but is "
            f"{corner_tolerance}."
        )
    if not (math.isfinite(smoothing) and smoothing >= 0):
        raise ValueError(
            f"Argument `smoothing` must be zero or positive, but is {smoothing}."
        )
    default = None if feed is None else float(feed)
    moves = program.timed_moves
    approach = program.moves[: program.approach_count]
    axis = approach[-1].axis if approach else moves[0].axis if moves else None
    legs = []
    for move in moves:
        if move.length > 0 or move.duration is not None:
            leg = _leg(move, float(rapid_feed), default, program.name)
            legs.append(leg._replace(first_axis=axis, last_axis=move.axis))
            axis = move.axis
        elif move.axis != axis:
            raise ValueError(
                f"{program.name}, line {move.line}: the tool turns on the spot, which "
                "has no time."
            )
    legs = _rounded(legs, float(corner_tolerance))
    if not legs:
        raise ValueError(
            f"{program.name}: the program moves nothing after its approach."
        )
    if smoothing > 0:
        legs = _slowed(legs, float(acceleration), float(smoothing))
    profile = _speeds(legs, float(acceleration))
    check_steps(float(profile.duration.sum() / float(tooth_period)), float(most_steps))
    return _sampled(legs, profile, float(tooth_period), float(smoothing))


def _leg(move: Move, rapid_feed: float, feed: float | None, name: str) -> _Leg:
    """Return a move with its speed limit."""
    piece = piece_of_move(move)
    speed = rapid_feed if move.is_rapid else move.feed
    if move.duration is not None:
        speed = piece.length / move.duration
    elif speed is None:
        speed = feed
    if speed is None:
        raise ValueError(
            f"{name}, line {move.line}: the move has no feed, and none was given "
            "(argument `feed`; in a job: [program] feed)."
        )
    return _Leg(piece, speed, move.duration, move.is_rapid, move.line)


def _rounded(legs: list[_Leg], tolerance: float) -> list[_Leg]:
    """Return the legs with rounded corners between them and stops marked."""
    out: list[_Leg] = []
    head = 0.0
    for before, after in zip(legs, [*legs[1:], None], strict=False):
        corner, is_stop = _joint(before, after, tolerance)
        tail = 0.0 if corner is None else corner.trim
        piece = before.piece
        if head + tail > 0 and not isinstance(piece, Blend):
            piece = piece.trimmed(head, tail)
        if piece.length > _SHORTEST or before.duration is not None:
            out.append(before._replace(piece=piece, is_stop=is_stop))
        elif out and is_stop:
            out[-1] = out[-1]._replace(is_stop=True)
        if corner is not None and after is not None:
            speed = min(before.speed, after.speed)
            leg = _Leg(corner.piece, speed, None, False, after.line, False)
            axis = before.last_axis
            out.append(leg._replace(first_axis=axis, last_axis=axis))
        head = tail
    return out


def _joint(
    before: _Leg, after: _Leg | None, tolerance: float
) -> tuple[Corner | None, bool]:
    """Return how one leg goes over into the next: a rounding, and whether it stops."""
    if after is None or _is_exact(before) or _is_exact(after):
        return None, True
    if isinstance(before.piece, Blend) or isinstance(after.piece, Blend):
        return None, False
    angle = corner_angle(before.piece, after.piece)
    if angle < TANGENT_ANGLE:
        return None, False
    if tolerance > _FINEST_TOLERANCE and angle < REVERSAL_ANGLE:
        return round_corner(before.piece, after.piece, angle, tolerance), False
    return None, True


def _is_exact(leg: _Leg) -> bool:
    """Whether the leg's ends are kept as they are: rapid and inverse-time moves."""
    return leg.is_rapid or leg.duration is not None


def _speeds(legs: list[_Leg], acceleration: float) -> _Profile:
    """Return the speed profile of all pieces by a backward and a forward pass."""
    length = np.array([leg.piece.length for leg in legs])
    limit = np.array([_speed_limit(leg, acceleration) for leg in legs])
    is_stop = np.array([leg.is_stop for leg in legs[:-1]], dtype=bool)
    inner = np.where(is_stop, 0.0, np.minimum(limit[:-1], limit[1:]))
    gain = 2 * acceleration * length
    # Squares of the speeds where pieces meet: first what can slow down, then what can
    # speed up.
    square = [0.0, *(inner**2).tolist(), 0.0]
    gains = gain.tolist()
    for index in range(len(gains) - 1, -1, -1):
        square[index] = min(square[index], square[index + 1] + gains[index])
    for index, more in enumerate(gains):
        square[index + 1] = min(square[index + 1], square[index] + more)
    joint = np.sqrt(square)
    speed_in, speed_out = joint[:-1].copy(), joint[1:].copy()
    peak = np.sqrt(np.minimum(limit**2, (speed_in**2 + speed_out**2 + gain) / 2))
    rise, fall = (peak - speed_in) / acceleration, (peak - speed_out) / acceleration
    ramps = (speed_in + peak) / 2 * rise + (speed_out + peak) / 2 * fall
    cruise = np.maximum(length - ramps, 0.0) / np.where(peak > 0, peak, 1.0)
    duration = rise + cruise + fall
    for index, leg in enumerate(legs):
        if leg.duration is not None:
            speed = length[index] / leg.duration
            speed_in[index] = peak[index] = speed_out[index] = speed
            rise[index] = fall[index] = 0.0
            duration[index] = leg.duration
    return _Profile(length, speed_in, peak, speed_out, rise, fall, duration)


def _speed_limit(leg: _Leg, acceleration: float) -> float:
    """Return the largest speed on a piece [m/s]."""
    curvature = leg.piece.curvature
    if leg.duration is not None or curvature == 0:
        return leg.speed
    return min(leg.speed, math.sqrt(acceleration / curvature))


def _sections(legs: list[_Leg]) -> Int[np.ndarray, " piece"]:
    """Return for every piece how many stops are before it."""
    return np.cumsum([0, *(leg.is_stop for leg in legs[:-1])])


def _slowed(legs: list[_Leg], acceleration: float, smoothing: float) -> list[_Leg]:
    """Return the legs, split where a slow one slows down its neighbours.

    Then speeds that are averaged in time keep the limit of every piece.
    """
    out = []
    ranges = slow_ranges(
        np.array([leg.piece.length for leg in legs]),
        np.array([_speed_limit(leg, acceleration) for leg in legs]),
        _sections(legs),
        smoothing,
    )
    for leg, parts in zip(legs, ranges, strict=True):
        if len(parts) == 1 or isinstance(leg.piece, Blend):
            out.append(leg._replace(speed=min(leg.speed, *(v for _, v in parts))))
            continue
        head, tail = 0.0, leg.piece.length
        for length, speed in parts:
            tail -= length
            piece = leg.piece.trimmed(head, max(tail, 0.0))
            first = _axis_at(leg, head)
            head += length
            part = leg._replace(piece=piece, speed=speed, is_stop=False)
            out.append(part._replace(first_axis=first, last_axis=_axis_at(leg, head)))
        out[-1] = out[-1]._replace(is_stop=leg.is_stop)
    return out


def _sampled(
    legs: list[_Leg], profile: _Profile, tooth_period: float, smoothing: float
) -> Path:
    """Return the rows at the tooth instants."""
    margin = _SAME_INSTANT * tooth_period

    def at(ends: Float[np.ndarray, " part"], time: np.ndarray) -> np.ndarray:
        return np.minimum(np.searchsorted(ends, time - margin), ends.size - 1)

    ends = np.cumsum(profile.duration)
    section = _sections(legs)
    first = np.flatnonzero(np.diff(section, prepend=-1))
    stops = ends[np.append(first[1:], len(legs)) - 1]
    # Between two stops a smoothed motion takes so much longer; a move that states its
    # time does not, and no dwell.
    is_free = np.array([leg.duration is None for leg in legs])
    longer = smoothing * (np.bincount(section, profile.length * is_free) > 0)
    late = np.cumsum(longer)
    count = max(1, math.ceil((stops[-1] + late[-1]) / tooth_period - _SAME_INSTANT))
    time = tooth_period * np.arange(count + 1)
    if smoothing == 0:
        index = at(ends, time)
        distance = _travelled(profile, index, time - (ends - profile.duration)[index])
    else:
        part = at(stops + late, time)
        begun = np.append(0.0, stops[:-1])
        local = time - (begun + late - longer)[part]
        way = _way_in_time(profile)
        gone = mean_way(way, begun[part], stops[part], local, longer[part])
        lengths = np.cumsum(profile.length)
        before = (lengths - profile.length)[first]
        index = np.searchsorted(lengths, before[part] + gone - _SHORTEST)
        index = np.clip(index, first[part], np.append(first[1:], len(legs))[part] - 1)
        distance = before[part] + gone - (lengths - profile.length)[index]
        distance = np.clip(distance, 0.0, profile.length[index])
    return Path(
        time=time,
        positions=_positions(legs, index, distance),
        axes=_axes(legs, index, distance),
        is_rapid=np.array([leg.is_rapid for leg in legs])[index],
        line=np.array([leg.line for leg in legs], dtype=np.int32)[index],
    )


def _way_in_time(profile: _Profile) -> WayInTime:
    """Return the way along all pieces as a function of the time."""
    parts = np.stack(
        [
            np.zeros_like(profile.duration),
            profile.time_rise,
            profile.duration - profile.time_fall,
            profile.duration,
        ],
        axis=1,
    )
    begun = np.cumsum(profile.duration) - profile.duration
    speed = np.stack(
        [profile.speed_in, profile.speed_peak, profile.speed_peak, profile.speed_out],
        axis=1,
    )
    return WayInTime((begun[:, None] + parts).reshape(-1), speed.reshape(-1))


def _travelled(
    profile: _Profile, index: Int[np.ndarray, " step"], time: Float[np.ndarray, " step"]
) -> Float[np.ndarray, " step"]:
    """Return the distance within each row's piece at a time since its start."""
    length, speed_in, peak, speed_out, rise, fall, duration = (
        column[index] for column in profile
    )
    time = np.clip(time, 0.0, duration)
    left = duration - time
    # Mean speed over a ramp, taken from the end that it touches; the middle cruises.
    up = speed_in + (peak - speed_in) * time / np.where(rise > 0, 2 * rise, 1.0)
    down = speed_out + (peak - speed_out) * left / np.where(fall > 0, 2 * fall, 1.0)
    cruise = (speed_in + peak) / 2 * rise + peak * (time - rise)
    distance = np.where(
        time < rise, up * time, np.where(left < fall, length - down * left, cruise)
    )
    return np.clip(distance, 0.0, length)


def _axis_at(leg: _Leg, distance: float) -> Point:
    """Return the tool axis at a distance from the start of a leg, not normalised."""
    share = distance / leg.piece.length
    (a, b, c), (x, y, z) = leg.first_axis, leg.last_axis
    return a + share * (x - a), b + share * (y - b), c + share * (z - c)


def _axes(
    legs: list[_Leg],
    index: Int[np.ndarray, " step"],
    distance: Float[np.ndarray, " step"],
) -> Float[np.ndarray, "step 3"]:
    """Return the unit tool axes."""
    first, last = (
        np.array([getattr(leg, name) for leg in legs])[index]
        for name in ("first_axis", "last_axis")
    )
    length = np.array([leg.piece.length or 1.0 for leg in legs])[index]
    axes = first + (distance / length)[:, None] * (last - first)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _positions(
    legs: list[_Leg],
    index: Int[np.ndarray, " step"],
    distance: Float[np.ndarray, " step"],
) -> Float[np.ndarray, "step 3"]:
    """Return the tool tips, all straight pieces at once."""
    out = np.zeros((index.size, 3))
    is_straight = np.array([isinstance(leg.piece, Segment) for leg in legs])[index]
    _fill_straight(out, legs, index, distance, is_straight)
    is_arc = np.array([isinstance(leg.piece, Arc) for leg in legs])[index]
    if is_arc.any():
        arcs = [piece for i in index[is_arc] if isinstance(piece := legs[i].piece, Arc)]
        out[is_arc] = arc_positions(arcs, distance[is_arc])
    other = np.flatnonzero(~(is_straight | is_arc))
    if other.size:
        for rows in np.split(other, np.flatnonzero(np.diff(index[other])) + 1):
            out[rows] = legs[index[rows[0]]].piece.positions(distance[rows])
    return out


def _fill_straight(
    out: Float[np.ndarray, "step 3"],
    legs: list[_Leg],
    index: Int[np.ndarray, " step"],
    distance: Float[np.ndarray, " step"],
    is_straight: Bool[np.ndarray, " step"],
) -> None:
    """Write the rows on straight pieces; the end of a piece is met exactly."""
    ends = np.zeros((len(legs), 2, 3))
    length = np.ones(len(legs))
    for row, leg in enumerate(legs):
        if isinstance(leg.piece, Segment):
            ends[row] = leg.piece.start, leg.piece.end
            length[row] = leg.piece.length or 1.0
    fraction = (distance / length[index])[:, None]
    points = (1 - fraction) * ends[index, 0] + fraction * ends[index, 1]
    out[is_straight] = points[is_straight]
