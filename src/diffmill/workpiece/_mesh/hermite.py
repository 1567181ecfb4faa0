"""Crossings of the surface with the grid, and its normals there.

A node of the grid is inside where at least two of its three rays say so. The surface
crosses an edge of the grid between an inside and an outside node, at the end of the ray
along the edge. The normal comes from the ends beside it on the same sheet: the slope
across the rays, taken from the side that is smoothest, so that no difference reaches
over a sharp edge. A ray that meets the surface at a shallow angle knows its slope
badly; it takes the normal of the head-on crossing nearby in whose plane it lies.
"""

from typing import TYPE_CHECKING, TypeAlias

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from .._memory import check_memory

if TYPE_CHECKING:
    from .._dexel.stock import Stock

# Ends on the next ray belong to the same sheet within this many spacings.
_SHEET_SPACINGS = 2.0
# A slope is sure if the sheet bends less than this from ray to ray, in spacings.
_SURE_BEND = 0.1
# Above this squared slope a family sees a plane less head-on than another one does.
_HEAD_ON_SQUARE = 3.0
# Neighbours to borrow a normal from: how many, within how many spacings.
_NEIGHBOURS, _REACH = 16, 3.0
# A normal is borrowed if the crossing is within this many spacings of the plane; on a
# plane that two neighbours share within these spacings and this cosine, even where
# the crossing has a fair normal of its own.
_OFF_PLANE = 0.15
_SAME_OFF, _SAME_COSINE = 0.02, 0.9999
# Arrays on the nodes of the grid, their temporaries included [byte per node].
_NODE_BYTES = 32

# One for each of n rays.
_Mask: TypeAlias = Bool[np.ndarray, " n"]
_Values: TypeAlias = Float[np.ndarray, " n"]


class Crossings(eqx.Module):
    """Crossings of the surface with the edges of the grid, padded by one.

    Attributes:
        points: Points on the surface [m], shape (crossing, 3).
        normals: Outward unit normals, shape (crossing, 3).
        edge: First node of the edge on the padded grid, shape (crossing, 3).
        axis: Axis of the edge, shape (crossing,).
        is_upper: True if the material is below along the axis, shape (crossing,).
    """

    points: Float[np.ndarray, "crossing 3"]
    normals: Float[np.ndarray, "crossing 3"]
    edge: Int[np.ndarray, "crossing 3"]
    axis: Int[np.ndarray, " crossing"]
    is_upper: Bool[np.ndarray, " crossing"]


def inside_nodes(stock: "Stock") -> Bool[np.ndarray, "x y z"]:
    """Nodes of the grid that are in the material.

    Args:
        stock: The workpiece.

    Returns:
        Booleans with one layer of outside nodes around the grid.

    Raises:
        ValueError: The grid is too large for the memory.
    """
    counts = stock.grid_shape
    node_count = float(np.prod([c + 2.0 for c in counts]))
    check_memory(_NODE_BYTES * node_count, "The surface of the stock")
    votes = np.zeros([c + 2 for c in counts], np.int8)
    for f in range(3):
        b, c = (f + 1) % 3, (f + 2) % 3
        votes[1:-1, 1:-1, 1:-1] += np.transpose(
            _filled(stock, f, counts[f]), np.argsort([b, c, f])
        )
    return votes >= 2


def _filled(stock: "Stock", family: int, count: int) -> Int[np.ndarray, "u v node"]:
    """Counts of 1 where a node lies within an interval of its ray."""
    ends = np.asarray(stock.families[family].ends, np.float64)
    at = (ends - float(np.asarray(stock.origin)[family])) / stock.spacing
    start = np.clip(np.ceil(at[:, :, 0]), 0, count).astype(np.int64)
    stop = np.clip(np.floor(at[:, :, 1]) + 1, 0, count).astype(np.int64)
    u, v, slot = np.nonzero(stop > start)
    change = np.zeros((*ends.shape[:2], count + 1), np.int8)
    np.add.at(change, (u, v, start[u, v, slot]), 1)
    np.add.at(change, (u, v, stop[u, v, slot]), -1)
    # Intervals that touch within rounding may share a node.
    return np.minimum(np.cumsum(change, axis=-1, dtype=np.int8)[..., :-1], 1)


def find_crossings(stock: "Stock", inside: Bool[np.ndarray, "x y z"]) -> Crossings:
    """All crossings with their normals.

    Args:
        stock: The workpiece.
        inside: The nodes in the material, as `inside_nodes` returns them.
    """
    families = [_family_crossings(stock, inside, f) for f in range(3)]
    joined = jax.tree.map(lambda *parts: np.concatenate(parts), *families)
    crossings, is_sure, is_fair = joined
    return _with_borrowed_normals(crossings, is_sure, is_fair, stock.spacing)


def _family_crossings(
    stock: "Stock", inside: Bool[np.ndarray, "x y z"], family: int
) -> tuple[Crossings, _Mask, _Mask]:
    """Crossings of a family; True if the normal needs no other one; if it is known."""
    b, c = (family + 1) % 3, (family + 2) % 3
    d, origin = stock.spacing, np.asarray(stock.origin, np.float64)
    nodes = np.moveaxis(inside, family, -1)
    is_crossed = np.moveaxis(nodes[..., 1:] != nodes[..., :-1], -1, family)
    edge = np.stack(np.nonzero(is_crossed), axis=-1)
    is_upper = inside[tuple(edge.T)]
    # Rays are not padded.
    u, v, node = edge[:, b] - 1, edge[:, c] - 1, edge[:, family] - 1
    rays = np.stack([u, v], axis=-1)
    ends = np.asarray(stock.families[family].ends, np.float64)
    first = origin[family] + node * d
    values, has_end = _nearest_end(ends, rays, is_upper, first + d / 2)
    # Families differ in rounding: keep the point on its edge.
    values = np.where(has_end, np.clip(values, first, first + d), first + d / 2)
    slopes = []
    is_sure = is_fair = has_end
    for axis in (0, 1):
        slope, is_sure_slope, is_known = _slope(ends, rays, axis, is_upper, values, d)
        slopes.append(slope)
        is_sure, is_fair = is_sure & is_sure_slope, is_fair & is_known
    points, normals = np.empty((len(u), 3)), np.empty((len(u), 3))
    points[:, family] = values
    points[:, b], points[:, c] = origin[b] + u * d, origin[c] + v * d
    side = np.where(is_upper, 1.0, -1.0)
    steepness = slopes[0] ** 2 + slopes[1] ** 2
    length = np.sqrt(1 + steepness)
    normals[:, family] = side / length
    normals[:, b], normals[:, c] = (
        -side * slopes[0] / length,
        -side * slopes[1] / length,
    )
    axis = np.full(len(u), family)
    is_head_on = steepness <= _HEAD_ON_SQUARE
    sure, fair = is_sure & is_head_on, is_fair & is_head_on
    return Crossings(points, normals, edge, axis, is_upper), sure, fair


def _nearest_end(
    ends: Float[np.ndarray, "u v 2 slot"],
    rays: Int[np.ndarray, "n 2"],
    is_upper: _Mask,
    value: _Values,
) -> tuple[_Values, _Mask]:
    """End of a ray on one side that is nearest to a value [m]; True if there is one."""
    u, v = rays.T
    is_ray = (u >= 0) & (v >= 0) & (u < ends.shape[0]) & (v < ends.shape[1])
    ray = ends[np.where(is_ray, u, 0), np.where(is_ray, v, 0)]
    is_live = (ray[:, 1] > ray[:, 0]) & is_ray[:, None]
    side = np.where(is_upper[:, None], ray[:, 1], ray[:, 0])
    away = np.where(is_live, np.abs(side - value[:, None]), np.inf)
    slot = np.argmin(away, axis=-1)[:, None]
    has_end = np.isfinite(np.take_along_axis(away, slot, axis=-1)[:, 0])
    nearest = np.take_along_axis(side, slot, axis=-1)[:, 0]
    return np.where(has_end, nearest, value), has_end


def _slope(
    ends: Float[np.ndarray, "u v 2 slot"],
    rays: Int[np.ndarray, "n 2"],
    axis: int,
    is_upper: _Mask,
    value: _Values,
    spacing: float,
) -> tuple[_Values, _Mask, _Mask]:
    """Slope of the sheet across the rays [-]; True if it is sure; if it is known.

    The slope is that along one axis of the grid of the rays.
    Of the differences to both sides and the central one, that with the least second
    difference wins, for it does not reach over a sharp edge.
    """
    sides = []
    for sign in (-1, 1):
        step = sign * np.eye(2, dtype=np.int64)[axis]
        near, is_near = _next_end(ends, rays + step, is_upper, value, spacing)
        far, is_far = _next_end(ends, rays + 2 * step, is_upper, near, spacing)
        bend = np.abs(value - 2 * near + far)
        # With one neighbour only the flatter side is the safer one, but never sure.
        bend = np.where(is_far, bend, np.abs(near - value) + _SURE_BEND * spacing)
        slope = np.where(is_far, 3 * value - 4 * near + far, 2 * (value - near))
        sides.append(
            (
                near,
                is_near,
                np.where(is_near, bend, np.inf),
                -sign * slope / (2 * spacing),
            )
        )
    (low, is_low, bend_low, slope_low), (high, is_high, bend_high, slope_high) = sides
    bend = np.where(is_low & is_high, np.abs(low - 2 * value + high), np.inf)
    slope = np.where(bend_low <= bend_high, slope_low, slope_high)
    # On a smooth sheet all bend alike, and the central difference is the best.
    is_smooth = bend <= 2 * np.minimum(bend_low, bend_high) + 1e-6 * spacing
    slope = np.where(is_smooth, (high - low) / (2 * spacing), slope)
    is_known = is_low | is_high
    slope = np.where(is_known, slope, 0.0)
    least = np.minimum(bend, np.minimum(bend_low, bend_high))
    # Seen at an angle, the same curvature bends the sheet more.
    is_sure = least <= _SURE_BEND * spacing * (1 + slope**2) ** 1.5
    return slope, is_sure, is_known


def _next_end(
    ends: Float[np.ndarray, "u v 2 slot"],
    rays: Int[np.ndarray, "n 2"],
    is_upper: _Mask,
    value: _Values,
    spacing: float,
) -> tuple[_Values, _Mask]:
    """End of the same sheet on other rays [m]; True if there is one."""
    nearest, has_end = _nearest_end(ends, rays, is_upper, value)
    is_near = np.abs(nearest - value) <= _SHEET_SPACINGS * spacing
    return nearest, has_end & is_near


def _with_borrowed_normals(
    crossings: Crossings,
    is_sure: Bool[np.ndarray, " crossing"],
    is_fair: Bool[np.ndarray, " crossing"],
    spacing: float,
) -> Crossings:
    """Crossings whose unsure normals are replaced by those of a plane nearby."""
    from scipy.spatial import KDTree

    sure, unsure = np.flatnonzero(is_sure), np.flatnonzero(~is_sure)
    if not (sure.size and unsure.size):
        return crossings
    tree = KDTree(crossings.points[sure])
    distance, index = tree.query(
        crossings.points[unsure],
        k=min(_NEIGHBOURS, sure.size),
        distance_upper_bound=_REACH * spacing,
    )
    distance = np.reshape(distance, (unsure.size, -1))
    index = np.reshape(index, (unsure.size, -1))
    is_near = np.isfinite(distance)
    lender = sure[np.where(is_near, index, 0)]
    normals = crossings.normals[lender]
    away = crossings.points[unsure][:, None] - crossings.points[lender]
    off_plane = np.abs(np.sum(away * normals, axis=-1))
    side = np.where(crossings.is_upper[unsure], 1.0, -1.0)
    along = np.take_along_axis(normals, crossings.axis[unsure][:, None, None], axis=-1)[
        ..., 0
    ]
    # The ray leaves the material here, so a plane facing the other way is not this one.
    is_facing = along * side[:, None] > 0
    cost = off_plane + 0.02 * np.where(is_near, distance, 0)
    cost = np.where(is_near & is_facing, cost, np.inf)
    best = np.argmin(cost, axis=1)
    row = np.arange(unsure.size)
    is_lent = np.isfinite(cost[row, best])
    is_lent &= off_plane[row, best] <= _OFF_PLANE * spacing
    agree = np.einsum("nki,ni->nk", normals, normals[row, best]) > _SAME_COSINE
    agree &= is_near & (off_plane <= _SAME_OFF * spacing)
    is_lent &= (agree.sum(axis=1) >= 2) | ~is_fair[unsure]
    new = crossings.normals.copy()
    new[unsure[is_lent]] = normals[row, best][is_lent]
    return eqx.tree_at(lambda c: c.normals, crossings, new)
