"""Poses of tools as robot programs write them, the moves to write, arcs in pieces.

An axis of a controller's tool frame points from the shank to the tip, z in most cells;
z of ours from the tip to the shank. Where z is the axis, the frames differ by half a
turn about x. Where a program leaves the rotation about the axis open, x of our tool is
as near to x of `work` as the axis allows.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from ...toolpath import Move, Point, Program

ToolAxis: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]
MM_PER_INCH = 25.4
_MOST_PIECES = 100_000
# Half a turn, or a quarter of one, from our tool frame to the controller's: of their
# axes the one of the name points from the shank to the tip, as columns.
_CONTROLLER_IN_TOOL: Mapping[ToolAxis, Float[np.ndarray, "3 3"]] = {
    "x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "z": np.diag([1.0, -1.0, -1.0]),
    "-x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-z": np.eye(3),
}
# Nearer to B = 90 deg than this, A and C turn about the same axis [rad].
_GIMBAL_LOCK = 1e-7


def point_of(values: Iterable[float]) -> Point:
    """Point of three numbers, an array's as plain ones."""
    x, y, z = values.tolist() if isinstance(values, np.ndarray) else values
    return x, y, z


class ToolPlace(NamedTuple):
    """Tip of the tool [m], its axis from tip to shank, and its x across that."""

    tip: Point
    axis: Point
    tool_x: Point | None = None


def controller_matrix(
    axis: Point, tool_x: Point | None, tool_axis: ToolAxis = "z"
) -> Float[np.ndarray, "3 3"]:
    """Axes of a controller's tool frame in `work`, as columns.

    Args:
        axis: Our tool axis, tip to shank.
        tool_x: Our x of the tool; None for one as near to x of `work` as can be.
        tool_axis: Axis of the controller's tool that points from the shank to the tip.
    """
    z = np.array(axis) / math.hypot(*axis)
    x = np.array([1.0, 0.0, 0.0]) if tool_x is None else np.array(tool_x)
    x = x - (x @ z) * z
    if np.linalg.norm(x) < 1e-6:
        x = np.array([0.0, 0.0, -z[0]])
    x = x / np.linalg.norm(x)
    tool = np.stack([x, np.cross(z, x), z], axis=1)
    return tool @ _CONTROLLER_IN_TOOL[tool_axis]


def tool_rotation(
    controller: Float[np.ndarray, "3 3"], tool_axis: ToolAxis = "z"
) -> Float[np.ndarray, "3 3"]:
    """Axes of our tool frame, as columns, of those of a controller's."""
    return controller @ _CONTROLLER_IN_TOOL[tool_axis].T


def tool_place(
    tip: Point, controller: Float[np.ndarray, "3 3"], tool_axis: ToolAxis
) -> ToolPlace:
    """Place of the tool of a tip [m] and the axes of a controller's tool frame."""
    tool = tool_rotation(controller, tool_axis)
    return ToolPlace(tip, point_of(tool[:, 2]), point_of(tool[:, 0]))


def abc_of_rotation(
    R: Float[np.ndarray, "3 3"], near: Point = (0.0, 0.0, 0.0)
) -> Point:
    """Angles A, B, C [deg] of R = Rz(A) Ry(B) Rx(C).

    Two triples state a rotation: (A, B, C) and (A + 180, 180 - B, C + 180). Where B is
    90 deg, A and C turn about the same axis, and any A does.

    Args:
        R: The rotation.
        near: Angles [deg] of which the nearer triple is returned.
    """
    b = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    a = math.atan2(R[1, 0], R[0, 0])
    if math.pi / 2 - abs(b) < _GIMBAL_LOCK:
        a = math.radians(near[0])
    # Rx(C) = (Rz(A) Ry(B))^T R, so that C fits whatever A is.
    z = rotation_of_abc(math.degrees(a), 0.0, 0.0)
    y = rotation_of_abc(0.0, math.degrees(b), 0.0)
    x = (z @ y).T @ R
    c = math.atan2(x[2, 1], x[1, 1])
    first = (math.degrees(a), math.degrees(b), math.degrees(c))
    other = (first[0] + 180, 180 - first[1], first[2] + 180)
    second = point_of(math.remainder(angle, 360) for angle in other)
    gaps = [
        sum(abs(math.remainder(u - v, 360)) for u, v in zip(one, near, strict=True))
        for one in (first, second)
    ]
    return second if gaps[1] < gaps[0] - 1e-6 else first


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


def quaternion_of_rotation(
    R: Float[np.ndarray, "3 3"],
) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of a rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def rotation_of_quaternion(
    w: float, x: float, y: float, z: float
) -> Float[np.ndarray, "3 3"]:
    """Rotation of a quaternion of any length above 0."""
    size = math.hypot(w, x, y, z)
    w, x, y, z = w / size, x / size, y / size, z / size
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rpy_of_rotation(R: Float[np.ndarray, "3 3"]) -> Point:
    """Angles roll, pitch and yaw [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    a, b, c = (math.radians(angle) for angle in abc_of_rotation(R))
    return c, b, a


def circle_through(first: Point, middle: Point, last: Point) -> tuple[Point, Point]:
    """Centre [m] and unit normal of the circle through three points.

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
    return point_of(centre), point_of(normal)


def rotated(point: Point, centre: Point, normal: Point, angle: float) -> Point:
    """Return a point of a circle turned about its normal [rad]."""
    if math.isclose(angle % (2 * math.pi), 0.0, abs_tol=1e-9):
        return point
    n, spoke = np.array(normal), np.array(point) - np.array(centre)
    turned = math.cos(angle) * spoke + math.sin(angle) * np.cross(n, spoke)
    return point_of(np.array(centre) + turned)


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
    return approach._replace(axis=first.axis, tool_x=first.tool_x), *program.moves


def straight_pieces(
    move: Move, tolerance: float, *, before: Move | None = None
) -> list[Move]:
    """Return a move as straight ones that leave an arc by a tolerance at most [m].

    Args:
        move: The move.
        tolerance: How far the pieces may lie beside it [m].
        before: The move before, from whose orientation the tool turns evenly over the
            pieces; None for that at its end.

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
    for one in arc_parts(move, count, before=before):
        pieces.append(one._replace(centre=None, turn=0, duration=duration))
    return pieces


def arc_parts(move: Move, count: int, *, before: Move | None = None) -> list[Move]:
    """Return an arc in equal parts, over which the tool turns evenly."""
    parts, start, before = [], move.start, before or move
    share = np.arange(1, count + 1) / count
    axes = move.axes_at(share, before.axis)
    sides = move.tool_x_at(share, before, axes)
    for index, row in enumerate(arc_points(move, count)):
        end, axis = point_of(row), point_of(axes[index])
        part = move._replace(start=start, end=end, axis=axis, rest=0.0)
        side = None if sides is None else point_of(sides[index])
        parts.append(part._replace(tool_x=side))
        start = end
    parts[-1] = parts[-1]._replace(axis=move.axis, tool_x=move.tool_x, rest=move.rest)
    return parts
