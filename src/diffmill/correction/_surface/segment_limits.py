"""Bounds of the machined surface for the rows of a segment.

Not to be too deep is a bound of every pose alone, so each segment holds it for its own.
To stay in the cut takes one pose that is deep enough: a segment holds it for the points
whose deepest pose, on the desired path, is among its rows.
"""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..._types import FloatRows3
from .finished_surface import SAME_DEPTH, FinishedSurface
from .surface_limits import SurfaceBounds


class BoundedRows(eqx.Module):
    """Rows of a segment in which bounds of the surface are held.

    Attributes:
        first: Its first row.
        hop: The first that the next segment may change.
        end: The first that is not held.
    """

    first: int
    hop: int
    end: int


def window_bounds(
    bounds: SurfaceBounds,
    deepest: Int[np.ndarray, " point"],
    rows: BoundedRows,
    *,
    shift: int,
    count: int,
) -> SurfaceBounds:
    """Bounds of the points that the rows of a segment cut, on its motion.

    Args:
        bounds: Bounds of the whole surface.
        deepest: Row whose desired pose is the deepest at each point, see
            `deepest_rows`, shape (point,).
        rows: Rows of the segment.
        shift: What is to be added to a row to have its place in the segment's motion.
        count: Number of points to return, at least as many as are cut; those that are
            too many are free. All segments then have the same shapes.

    **Differentiability**: none, a host function.
    """
    first, hop, end = rows.first, rows.hop, rows.end
    surface = bounds.surface
    poses = np.asarray(surface.poses)
    # A point that only the poses before the next segment can decide is decided here.
    is_kept = (deepest >= first) & (deepest < hop)
    last = np.where(is_kept, hop, end)[:, None]
    is_inside = (poses >= first) & (poses < last)
    is_cut = np.flatnonzero(is_inside.any(axis=1))
    place, inside = poses[is_cut], is_inside[is_cut]
    # The first stands in for those of other segments.
    some = np.argmax(inside, axis=1)[:, None]
    column = np.where(inside, np.arange(inside.shape[1]), some)
    place = np.take_along_axis(place, column, axis=1) + shift
    is_mine = (deepest[is_cut] >= first) & (deepest[is_cut] < end)
    free = count - is_cut.size
    fill = lambda x, value: np.concatenate(
        [x, np.full((free, *x.shape[1:]), value, x.dtype)]
    )
    instants = jax.tree.map(
        lambda x: fill(np.asarray(x)[is_cut[:, None], column], 0), surface.instants
    )
    return SurfaceBounds(
        FinishedSurface(
            fill(np.asarray(surface.points)[is_cut], 0),
            fill(np.asarray(surface.normals)[is_cut], 0),
            fill(np.asarray(surface.is_wall)[is_cut], False),
            fill(place.astype(np.int32), shift + first),
            surface.radius,
            instants,
        ),
        fill(bounds.lower[is_cut], -np.inf),
        fill(np.where(is_mine, bounds.upper[is_cut], np.inf), np.inf),
        bounds.gouge,
    )


def cut_points(
    bounds: SurfaceBounds, first: int, end: int
) -> Bool[np.ndarray, " point"]:
    """True at points that the poses of some rows may cut, shape (point,).

    **Differentiability**: none, a host function.
    """
    poses = np.asarray(bounds.surface.poses)
    return np.any((poses >= first) & (poses < end), axis=1)


def deepest_rows(
    bounds: SurfaceBounds, desired: FloatRows3
) -> Int[np.ndarray, " point"]:
    """Row whose desired pose is the deepest at each point, shape (point,).

    Of rows as deep the nearest: a rim may end short of the point on the actual path.

    **Differentiability**: none, a host function.
    """
    surface, tips = bounds.surface, np.asarray(desired)
    poses, depth = np.asarray(surface.poses), surface.host_depths(tips)
    off = tips[poses, :2] - np.asarray(surface.points)[:, None, :2]
    is_deepest = depth <= depth.min(axis=1, keepdims=True) + SAME_DEPTH
    off = np.where(is_deepest, np.linalg.norm(off, axis=2), np.inf)
    best = np.argmin(off, axis=1)[:, None]
    return np.take_along_axis(poses, best, axis=1)[:, 0]


def keeps_bounds(bounds: SurfaceBounds, errors: Float[np.ndarray, " point"]) -> bool:
    """True if errors of the surface keep the bounds, but for rounding.

    **Differentiability**: none, a host function.
    """
    slack = 1e-7
    is_within = (errors >= bounds.lower - slack) & (errors <= bounds.upper + slack)
    return bool(np.all(is_within))
