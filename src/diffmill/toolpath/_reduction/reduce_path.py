"""Fewer rows for a path that stays within a tolerance, in position at every time."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..._types import RealScalarLike
from .._path import Path
from .spline import SplineFit

# Points of the tool keep the tolerance: the tip, one so far up its axis [m], and, where
# the program states the rotation about the axis, one so far along its x.
_LEVER = 0.1
# A block covers no more rows than this; it bounds the work for each.
_MOST_ROWS = 512


def reduce_path(
    path: Path, tolerance: RealScalarLike, *, is_spline: bool = False
) -> Path:
    """Return a path of few rows that are joined by straight lines or by a spline.

    At the time of every row the new path is within the tolerance of the old one. From
    each new row a line at constant speed goes on as long as one exists that keeps the
    tolerance at all rows on its way; it then ends where the middle of these lines ends.
    So the new rows lie beside the old ones, on either side of a bend, and one needs
    half of the blocks that a choice among the old rows would take. Rapid rows and
    others never share a block.

    The spline is the cubic one in time, without a bend at its ends, that lies nearest
    to all rows; it needs half of the rows again.

    Args:
        path: The path, at rest or moving at its ends; its time increases.
        tolerance: Largest distance at the time of a row [m]; 0 returns the path.
        is_spline: Whether a spline joins the new rows.

    Returns:
        The path at the ends of the blocks; the first and the last row are within the
        tolerance of the old ones, and their times are the same.

    Raises:
        ValueError: If the tolerance is negative or not finite.
    """
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise ValueError(
            f"Argument `tolerance` must be zero or positive, but is {tolerance}."
        )
    time, axes = np.asarray(path.time), np.asarray(path.axes)
    if tolerance == 0 or time.size < 3:
        return path
    points = np.concatenate([np.asarray(path.positions), _LEVER * axes], axis=1)
    if path.tool_x is not None:
        side = _LEVER * np.asarray(path.tool_x)
        points = np.concatenate([points, side], axis=1)
    if is_spline:
        # A row carries the kind of the motion that leads to it.
        changes = 1 + np.flatnonzero(np.diff(np.asarray(path.is_rapid)[1:]))
        fit = SplineFit(time, points, float(tolerance), changes)
        kept = fit.fewest_knots()
        found = fit.fitted(kept)[kept]
    else:
        corners = _corners(path, points, float(tolerance))
        kept, found = corners.rows, corners.points
    directions, tool_x = axes[kept], None
    if np.ptp(axes, axis=0).any():
        directions = found[:, 3:6]
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    if path.tool_x is not None:
        across = found[:, 6:]
        along = np.sum(across * directions, axis=1, keepdims=True)
        tool_x = across - along * directions
        tool_x = tool_x / np.linalg.norm(tool_x, axis=1, keepdims=True)
    return Path(
        time=time[kept],
        positions=found[:, :3],
        axes=directions,
        is_rapid=np.asarray(path.is_rapid)[kept],
        line=np.asarray(path.line)[kept],
        tool_x=tool_x,
    )


class _Corners(NamedTuple):
    """Rows at which lines end, shape (corner,), and where [m], (corner, component)."""

    rows: Int[np.ndarray, " corner"]
    points: Float[np.ndarray, "corner component"]


def _corners(
    path: Path, points: Float[np.ndarray, "row component"], tolerance: float
) -> _Corners:
    """Return the corners of lines that are as long as the tolerance allows."""
    time, is_rapid = np.asarray(path.time), np.asarray(path.is_rapid)
    kept, row, corner = [0], 0, points[0]
    corners = [corner]
    while row < time.size - 1:
        end = min(row + _MOST_ROWS, time.size - 1)
        # A row carries the kind of the motion that leads to it.
        other = np.flatnonzero(is_rapid[row + 2 : end + 1] != is_rapid[row + 1])
        end = row + 1 + int(other[0]) if other.size else end
        span = time[row + 1 : end + 1] - time[row]
        line = _longest_line(span, points[row + 1 : end + 1] - corner, tolerance)
        row += line.rows
        corner = corner + line.speed * span[line.rows - 1]
        kept.append(row)
        corners.append(corner)
    return _Corners(np.array(kept), np.array(corners))


class _Line(NamedTuple):
    """Rows that a line can serve, and its speed [m/s], shape (component,)."""

    rows: int
    speed: Float[np.ndarray, " component"]


def _longest_line(
    span: Float[np.ndarray, " row"],
    way: Float[np.ndarray, "row component"],
    tolerance: RealScalarLike,
) -> _Line:
    """Return the line from the origin that serves most rows.

    Args:
        span: Times since the start of the line [s].
        way: Where the rows are, from there [m].
        tolerance: Largest distance of a row [m].
    """
    least = np.maximum.accumulate((way - tolerance) / span[:, None], axis=0)
    most = np.minimum.accumulate((way + tolerance) / span[:, None], axis=0)
    is_open = np.all(least <= most, axis=1)
    count = is_open.size if is_open.all() else int(np.argmin(is_open))
    for last in range(count, 1, -1):
        speed = 0.5 * (least[last - 1] + most[last - 1])
        gap = way[:last] - speed * span[:last, None]
        if np.linalg.norm(gap.reshape(last, -1, 3), axis=2).max() <= tolerance:
            return _Line(last, speed)
    return _Line(1, way[0] / span[0])
