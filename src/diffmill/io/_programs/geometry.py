"""Poses of tools as robot programs write them, the moves to write, arcs in pieces.

A controller's tool axis points from the flange to the tip, ours from the tip to the
shank: the frames differ by half a turn about x. The turn about the axis is chosen so
that x of the tool is as near to x of `work` as the axis allows.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...toolpath import Move, Point, Program

_MOST_PIECES = 100_000


def tool_matrix(axis: Point) -> Float[np.ndarray, "3 3"]:
    """Return the axes of a controller's tool frame in `work`, as columns."""
    z = np.array(axis) / math.hypot(*axis)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    if np.linalg.norm(x) < 1e-6:
        x = np.array([0.0, 0.0, -z[0]])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(x, z), -z], axis=1)


def abc_of_axis(axis: Point) -> Point:
    """Return the angles A, B, C [deg] of a tool: R = Rz(A) Ry(B) Rx(C)."""
    R = tool_matrix(axis)
    a = math.atan2(R[1, 0], R[0, 0])
    b = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    c = math.atan2(R[2, 1], R[2, 2])
    return math.degrees(a), math.degrees(b), math.degrees(c)


def rotation_of_abc(a: float, b: float, c: float) -> Float[np.ndarray, "3 3"]:
    """Return the axes of a controller's tool frame, as columns, of A, B, C [deg]."""
    (ca, sa), (cb, sb), (cc, sc) = (
        (math.cos(angle), math.sin(angle)) for angle in map(math.radians, (a, b, c))
    )
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    )


def axis_of_abc(a: float, b: float, c: float) -> Point:
    """Return the tool axis, tip to shank, of angles A, B, C [deg]."""
    return _point(-rotation_of_abc(a, b, c)[:, 2])


def quaternion_of_axis(axis: Point) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of a tool."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(tool_matrix(axis)).as_quat()
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def axis_of_quaternion(w: float, x: float, y: float, z: float) -> Point:
    """Return the tool axis, tip to shank, of a quaternion of any length above 0."""
    square = w * w + x * x + y * y + z * z
    return (
        -2 * (x * z + w * y) / square,
        -2 * (y * z - w * x) / square,
        -(w * w - x * x - y * y + z * z) / square,
    )


class ToolPlace(NamedTuple):
    """Tip of the tool [m], and its axis from tip to shank."""

    tip: Point
    axis: Point


class Circle(NamedTuple):
    """Centre [m] and unit normal of a circle."""

    centre: Point
    normal: Point


def circle_through(first: Point, middle: Point, last: Point) -> Circle:
    """Return the circle through three points.

    The way from the first over the middle to the last is counter-clockwise about the
    normal.

    Raises:
        ValueError: If the points lie on a line.
    """
    a, b, c = np.array(first), np.array(middle), np.array(last)
    u, v = b - a, c - a
    across = np.cross(u, v)
    square = float(across @ across)
    if square < 1e-12 * float(u @ u) * float(v @ v) or square == 0:
        raise ValueError("the three points of the circle lie on a line.")
    to_centre = np.cross(across, u) * (v @ v) + np.cross(v, across) * (u @ u)
    centre, normal = a + to_centre / (2 * square), across / math.sqrt(square)
    return Circle(_point(centre), _point(normal))


def rotated(point: Point, centre: Point, normal: Point, angle: float) -> Point:
    """Return a point of a circle turned about its normal [rad]."""
    if math.isclose(angle % (2 * math.pi), 0.0, abs_tol=1e-9):
        return point
    n, spoke = np.array(normal), np.array(point) - np.array(centre)
    turned = math.cos(angle) * spoke + math.sin(angle) * np.cross(n, spoke)
    return _point(np.array(centre) + turned)


def arc_points(move: Move, count: int) -> Float[np.ndarray, "point 3"]:
    """Return points of an arc at equal parts of its angle, its start left out [m]."""
    points = move.points_at(np.arange(1, count + 1) / count)
    points[-1] = move.end
    return points


def program_moves(program: Program) -> tuple[Move, ...]:
    """Return the moves to write: a rapid one to where the motion begins, then all.

    From the program alone nobody knows where the machine stands before.
    """
    if program.approach_count:
        return program.moves[program.approach_count - 1 :]
    first = program.moves[0]
    approach = Move(first.start, first.start, is_rapid=True, line=first.line)
    return approach._replace(axis=first.axis), *program.moves


def straight_pieces(
    move: Move, tolerance: float, *, start_axis: Point | None = None
) -> list[Move]:
    """Return a move as straight ones that leave an arc by a tolerance at most [m].

    Args:
        move: The move.
        tolerance: How far the pieces may lie beside it [m].
        start_axis: Tool axis before the move; None for that at its end. It turns evenly
            over the pieces.

    Raises:
        ValueError: If the tolerance takes too many pieces.
    """
    if move.centre is None:
        return [move]
    radius = max(move.radii)
    ratio = min(max(1 - tolerance / radius, -1.0), 1.0)
    step = max(2 * math.acos(ratio), 1e-4)
    count = max(1, math.ceil(abs(move.sweep) / step))
    if count > _MOST_PIECES:
        raise ValueError(
            f"line {move.line}: the arc takes {count} straight pieces within "
            f"{tolerance * 1e3:g} mm; {_MOST_PIECES} are allowed. A larger tolerance "
            "takes less."
        )
    pieces = []
    duration = None if move.duration is None else move.duration / count
    for one in arc_parts(move, count, start_axis=start_axis):
        pieces.append(one._replace(centre=None, turn=0, duration=duration))
    return pieces


def arc_parts(move: Move, count: int, *, start_axis: Point | None = None) -> list[Move]:
    """Return an arc in equal parts, over which the tool axis turns evenly."""
    parts, start = [], move.start
    axes = move.axes_at(np.arange(1, count + 1) / count, start_axis or move.axis)
    for row, axis in zip(arc_points(move, count), axes, strict=True):
        end, axis = _point(row), _point(axis)
        parts.append(move._replace(start=start, end=end, axis=axis, rest=0.0))
        start = end
    parts[-1] = parts[-1]._replace(axis=move.axis, rest=move.rest)
    return parts


def _point(values: Float[np.ndarray, " 3"]) -> Point:
    """Return three numbers as a point."""
    x, y, z = values.tolist()
    return x, y, z
