"""Fewer rows for a path that stays within a tolerance, in position at every time."""

import math

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
        rows = fit.fewest_knots()
        corners = fit.fitted(rows)[rows]
    else:
        rows, corners = _corners(path, points, float(tolerance))
    directions, tool_x = axes[rows], None
    if np.ptp(axes, axis=0).any():
        directions = corners[:, 3:6]
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    if path.tool_x is not None:
        across = corners[:, 6:]
        along = np.sum(across * directions, axis=1, keepdims=True)
        tool_x = across - along * directions
        tool_x = tool_x / np.linalg.norm(tool_x, axis=1, keepdims=True)
    return Path(
        time=time[rows],
        positions=corners[:, :3],
        axes=directions,
        is_rapid=np.asarray(path.is_rapid)[rows],
        line=np.asarray(path.line)[rows],
        tool_x=tool_x,
    )


def _corners(
    path: Path, points: Float[np.ndarray, "row component"], tolerance: float
) -> tuple[Int[np.ndarray, " corner"], Float[np.ndarray, "corner component"]]:
    """Rows and corners [m] of lines that are as long as the tolerance allows."""
    time, is_rapid = np.asarray(path.time), np.asarray(path.is_rapid)
    row, corner = 0, points[0]
    rows, corners = [row], [corner]
    while row < time.size - 1:
        end = min(row + _MOST_ROWS, time.size - 1)
        # A row carries the kind of the motion that leads to it.
        other = np.flatnonzero(is_rapid[row + 2 : end + 1] != is_rapid[row + 1])
        end = row + 1 + int(other[0]) if other.size else end
        span = time[row + 1 : end + 1] - time[row]
        way = points[row + 1 : end + 1] - corner
        count, speed = _longest_line(span, way, tolerance)
        row += count
        corner = corner + speed * span[count - 1]
        rows.append(row)
        corners.append(corner)
    return np.array(rows), np.array(corners)


def _longest_line(
    span: Float[np.ndarray, " row"],
    way: Float[np.ndarray, "row component"],
    tolerance: RealScalarLike,
) -> tuple[int, Float[np.ndarray, " component"]]:
    """Number of rows that the longest line from the origin serves, and its speed.

    Args:
        span: Times since the start of the line [s].
        way: Positions of the rows relative to it [m].
        tolerance: Largest distance of a row [m].

    Returns:
        The number of rows, and the speed [m/s], shape (component,).
    """
    least = np.maximum.accumulate((way - tolerance) / span[:, None], axis=0)
    most = np.minimum.accumulate((way + tolerance) / span[:, None], axis=0)
    is_open = np.all(least <= most, axis=1)
    count = is_open.size if is_open.all() else int(np.argmin(is_open))
    for last in range(count, 1, -1):
        speed = 0.5 * (least[last - 1] + most[last - 1])
        gap = way[:last] - speed * span[:last, None]
        if np.linalg.norm(gap.reshape(last, -1, 3), axis=2).max() <= tolerance:
            return last, speed
    return 1, way[0] / span[0]
