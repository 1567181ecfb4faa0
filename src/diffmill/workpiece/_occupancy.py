"""How much of each disc of a vertical cutter is in the material, angle by angle.

The rays see what lies head-on to them exactly, and the rest only to their spacing. So
the question is split:

- along the axis, the columns (rays along z) around a point give the share of each
  disc's height that is material: a partition of unity over the discs, so that the
  shares add up to the depth of cut exactly, at any depth;
- across the axis, the rays along x and y give the signed distance to walls in the
  plane of the disc. Each of the two families is interpolated over three rays, by
  quadratic splines, whose slope g across the rays is continuous: s / sqrt(1 + g^2) is
  the distance to a straight wall, exactly, and (1 + g^2)^-2 is the family's say.

Their product is the occupancy. A ray that meets no surface within reach says nothing
about where a surface is, so it hardly counts while another one does.

A chip is no point either: it reaches inward from the rim, and a wall may cut off its
inner side, or its outer one. Distance and slope of the wall at the rim tell what of it
is in the material.

Two ways to differentiate with respect to the poses that cut the stock: through the
ends of the rays (`pose_tips=None`), or through the poses that the ends remember
(`track` given), where the stock is a constant and each end that is read here is
tied to its pose by the slope of the cutter's surface at that end.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..cutter import AbstractCutter
from ..numerics import clamp, hat_integral, mean_step, tied
from ._stock import Stock
from ._tooth_pass import PoseTrack

# Distances along a ray are cut off here, in units of the spacing.
REACH = 4.0
# Share of the band across a wall that an edge does not cross on its way.
_FOLLOWED = 0.3
# A chip that crosses less of a wall than this, in widths of its band, counts as this.
_SHORT = 1e-2
# What a ray without a surface in reach still counts for.
_BLIND = 1e-6


class Discs(eqx.Module):
    """The discs of a cutter, from the tip up.

    Attributes:
        count: Number of discs.
        height: Height of a disc dz [m].
        band: Greatest half-width of the transition from 0 to 1 across a wall [m]:
            half the spacing of the rays, or of the samples on the rim if that is more.
    """

    count: int = eqx.field(static=True)
    height: float = eqx.field(static=True)
    band: float = eqx.field(static=True)

    def centers(self, dtype: jnp.dtype) -> Float[Array, " element"]:
        """Return the height of the middle of each disc above the tip [m]."""
        return self.height * (jnp.arange(self.count, dtype=dtype) + 0.5)

    def filled_below(
        self, height: Float[Array, "*end"]
    ) -> Float[Array, "*end element"]:
        """Return the share of each disc that lies below a height above the tip.

        The shares of all discs sum to height / dz at any height between zero and the
        middle of the last disc. The lowest disc ends at the tip: it has no share in
        material below.
        """
        # Disc by disc: the transpose of a broadcast over so short an axis is slow.
        below_tip = hat_integral(-height / self.height - 0.5)
        shares = [
            hat_integral(height / self.height - (e + 0.5)) for e in range(self.count)
        ]
        shares[0] = jnp.where(height > 0, shares[0] - below_tip, 0)
        return jnp.stack(shares, axis=-1)

    def filled_below_own(
        self, height: Float[Array, "point element *end"]
    ) -> Float[Array, "point element *end"]:
        """Return the share of each disc that lies below a height of its own.

        As `filled_below`, but every disc has its own heights above the tip [m], in
        the second axis: its cost grows with the discs, not with their square.
        """
        place = jnp.arange(self.count, dtype=height.dtype)
        place = place.reshape(1, -1, *(1,) * (height.ndim - 2))
        share = hat_integral(height / self.height - (place + 0.5))
        below_tip = hat_integral(-height / self.height - 0.5)
        lowest = jnp.where(height > 0, share - below_tip, 0)
        return jnp.where(place == 0, lowest, share)


def occupancy(
    stock: Stock,
    points: Float[Array, "point disc 3"],
    moves: Float[Array, "point disc 2"],
    chips: Float[Array, "point disc 2"],
    discs: Discs,
    cutter: AbstractCutter,
    track: PoseTrack | None = None,
) -> tuple[Float[Array, "point element"], Float[Array, "point element"]]:
    """Return how much of the chips at points on the rim is in the material.

    Args:
        stock: The workpiece.
        points: Points in `work` at the height of the tip [m], shape (point, disc, 3);
            the axis disc has length 1 if all discs share their points.
        moves: From each point to the next sample [m], across the axis, shape
            (point, disc, 2).
        chips: From each point to the inner side of its chip [m], as `moves`.
        discs: The discs.
        cutter: The cutter that cut the stock; used only with `track`.
        track: All poses so far, to which the derivative goes; None differentiates
            through the stock.

    Returns:
        The occupancy, the share of each disc that has a chip in the material, exactly
        0 and 1 away from surfaces; and the share of that chip's thickness that is in
        the material. Both of shape (point, element).

    Differentiability: continuous; kinks where a point crosses a grid line.
    """
    columns = _find_columns(stock, points)
    if track is not None:
        columns = _tie_columns(columns, track)
    heights = _wall_heights(stock, points, discs, columns)
    walls = tuple(_find_walls(stock, f, points, heights) for f in (0, 1))
    wall_ends = (walls[0].ends, walls[1].ends)
    if track is not None:
        wall_ends = _tie_walls(cutter, walls, track)
    facts = tuple((w.is_upper, w.is_empty) for w in walls)
    combine = jax.checkpoint(_combine, static_argnums=(6,))
    return combine(
        points,
        moves,
        chips,
        (columns.ends, *wall_ends),
        (facts, heights),
        stock.origin,
        (discs, stock.spacing),
    )


class _Columns(eqx.Module):
    """All ends of the 3 x 3 rays along z around each point."""

    ends: Float[Array, "point disc 9 2 slot"]
    poses: Int[Array, "point disc 9 2 slot"]


class _Walls(eqx.Module):
    """The end that decides the distance on rays around each point.

    They stand on the three nearest lines to the side, and below and above.
    """

    ends: Float[Array, "point element 6"]
    is_upper: Bool[Array, "point element 6"]
    is_empty: Bool[Array, "point element 6"]
    pose: Int[Array, "point element 6"]
    across: Float[Array, "point element 6"]


def _find_columns(stock: Stock, points: Float[Array, "point disc 3"]) -> _Columns:
    rays = stock.families[2]
    at = jax.lax.stop_gradient((points - stock.origin[None, None]) / stock.spacing)
    near = [
        jnp.clip(jnp.round(at[..., a]).astype(jnp.int32), 1, rays.ends.shape[a] - 2)
        for a in (0, 1)
    ]
    step = jnp.arange(-1, 2, dtype=jnp.int32)
    i = near[0][..., None] + jnp.repeat(step, 3)[None, None]
    j = near[1][..., None] + jnp.tile(step, 3)[None, None]
    return _Columns(rays.ends[i, j], rays.poses[i, j])


def _wall_heights(
    stock: Stock,
    points: Float[Array, "point disc 3"],
    discs: Discs,
    columns: _Columns,
) -> Float[Array, "point element"]:
    """Return the height at which to look for walls, inside the material of a disc.

    A disc that only just reaches into the material from above has its middle in the
    air, where rays along x and y meet nothing; one spacing below the top they do.
    """
    z = points[..., 2] + discs.centers(points.dtype)[None]
    low, high = columns.ends[..., 0, :], columns.ends[..., 1, :]
    reaches = (high > low) & (low < z[:, :, None, None] + discs.height)
    top = jnp.max(jnp.where(reaches, high, -jnp.inf), axis=(-2, -1))
    is_fringe = (top < z + stock.spacing) & (top > z - discs.height)
    return jnp.where(is_fringe, jnp.where(is_fringe, top, 0) - stock.spacing, z)


def _find_walls(
    stock: Stock,
    family: Literal[0, 1],
    points: Float[Array, "point disc 3"],
    heights: Float[Array, "point element"],
) -> _Walls:
    rays = stock.families[family]
    frozen = jax.lax.stop_gradient
    side = 1 - family
    at_side = frozen((points[..., side] - stock.origin[side]) / stock.spacing)
    at_height = frozen((heights - stock.origin[2]) / stock.spacing)
    at_side = jnp.broadcast_to(at_side, at_height.shape)
    counts = rays.ends.shape[:2] if family == 0 else rays.ends.shape[1::-1]
    middle = jnp.clip(jnp.round(at_side).astype(jnp.int32), 1, counts[0] - 2)
    below = jnp.clip(jnp.floor(at_height).astype(jnp.int32), 0, counts[1] - 2)
    line = middle[..., None] + jnp.array([[[-1, -1, 0, 0, 1, 1]]], jnp.int32)
    level = below[..., None] + jnp.array([[[0, 1, 0, 1, 0, 1]]], jnp.int32)
    # Family 0 is indexed (y, z), family 1 is indexed (z, x).
    row, column = (line, level) if family == 0 else (level, line)
    near = rays.ends[row, column]
    x = jnp.broadcast_to(frozen(points[..., family]), at_height.shape)[..., None]
    low, high, slot = nearest_interval(near, x)
    is_upper = frozen(high) - x < x - frozen(low)
    pose = rays.poses[row, column, is_upper.astype(jnp.int32), slot]
    return _Walls(
        ends=jnp.where(is_upper, high, low),
        is_upper=is_upper,
        is_empty=frozen(high) < frozen(low),
        pose=pose,
        across=stock.origin[side] + stock.spacing * line.astype(points.dtype),
    )


def nearest_interval(
    ends: Float[Array, "*ray 2 slot"], x: Float[Array, "*#ray"]
) -> tuple[Float[Array, "*ray"], Float[Array, "*ray"], Int[Array, "*ray"]]:
    """Return the interval of each ray that a coordinate lies in, or is nearest to.

    Args:
        ends: Lower and upper ends [m], shape (..., 2, slot).
        x: Coordinate along the ray [m], shape (...), broadcast.

    Returns:
        Lower end, upper end [m], and the slot, each of shape (...).

    Differentiability: in the ends.
    """
    low, high = ends[..., 0, 0], ends[..., 1, 0]
    slot = jnp.zeros(low.shape, jnp.int32)
    frozen = jax.lax.stop_gradient
    best = jnp.minimum(x - frozen(low), frozen(high) - x)
    # One pass over the slots in one loop: reductions over so short an axis are slow.
    for m in range(1, ends.shape[-1]):
        start, stop = ends[..., 0, m], ends[..., 1, m]
        inside = jnp.minimum(x - frozen(start), frozen(stop) - x)
        is_nearer = inside > best
        low = jnp.where(is_nearer, start, low)
        high = jnp.where(is_nearer, stop, high)
        slot = jnp.where(is_nearer, m, slot)
        best = jnp.maximum(best, inside)
    return low, high, slot


def _tie_columns(columns: _Columns, track: PoseTrack) -> _Columns:
    """Return the columns, each end with the derivative of the pose that cut it.

    A flat end cuts a column at the height of its tip.
    """
    tie = jnp.where(columns.poses >= 0, track.height_by(columns.poses), 0)
    ends = tied(jax.lax.stop_gradient(columns.ends), tie)
    return _Columns(ends, columns.poses)


def _tie_walls(
    cutter: AbstractCutter,
    walls: tuple[_Walls, ...],
    track: PoseTrack,
) -> tuple[Float[Array, "point element 6"], Float[Array, "point element 6"]]:
    """Return the ends of both families with the derivatives of their poses."""
    frozen = jax.lax.stop_gradient
    # One gather for both: its transpose then adds into the table only once.
    tips = track.cut_by(jnp.stack([w.pose for w in walls])).tip
    moving = []
    for f in (0, 1):
        wall, tip = walls[f], tips[f]
        slopes = cutter.wall_slopes(f, frozen(wall.ends), wall.across, frozen(tip))
        tie = tip[..., f] + frozen(slopes[0]) * tip[..., 1 - f]
        tie = tie + frozen(slopes[1]) * (cutter.diameter / 2)
        tie = jnp.where(wall.pose >= 0, tie, 0)
        moving.append(tied(frozen(wall.ends), tie))
    return moving[0], moving[1]


def _combine(
    points: Float[Array, "point disc 3"],
    moves: Float[Array, "point disc 2"],
    chips: Float[Array, "point disc 2"],
    ends: tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]],
    facts: tuple[tuple[tuple[Bool[Array, "..."], ...], ...], Float[Array, "..."]],
    origin: Float[Array, " 3"],
    sizes: tuple[Discs, float],
) -> tuple[Float[Array, "point element"], Float[Array, "point element"]]:
    discs, d = sizes
    sides, heights = facts
    touched, filled_chip, certainty = _wall_occupancy(
        points, moves, chips, ends[1:], sides, heights, origin, (d, discs.band)
    )
    # (point, disc, column, side, slot)
    above_tip = ends[0] - points[..., 2][..., None, None, None]
    is_live = ends[0][..., 1, :] > ends[0][..., 0, :]
    weights = _column_weights(points, origin, d)
    # (point, column, element)
    weights = jnp.moveaxis(weights, 1, 2)
    if points.shape[1] > 1:
        below = discs.filled_below_own(above_tip)
        filled = jnp.where(is_live, below[..., 1, :] - below[..., 0, :], 0)
        filled = jnp.moveaxis(jnp.sum(filled, -1), 1, 2)
    else:
        below = discs.filled_below(above_tip[:, 0])
        filled = below[..., 1, :, :] - below[..., 0, :, :]
        filled = jnp.sum(jnp.where(is_live[:, 0, ..., None], filled, 0), -2)
    mean = jnp.sum(weights * filled, axis=1)
    # Beside a wall the columns in the air must not thin the disc: walls do that.
    solid = jnp.sum(weights * filled**2, axis=1) / (mean + _BLIND)
    # Before a higher wall the disc stands on what its lower columns hold.
    # One of equal columns: a tie shared by comparison is lost to rounding in reverse.
    fullest = jnp.argmax(jax.lax.stop_gradient(filled), axis=1, keepdims=True)
    gap = jnp.take_along_axis(filled, fullest, axis=1) - filled
    ledge = jnp.sum(weights * filled * gap, axis=1)
    ledge = ledge / (jnp.sum(weights * gap, axis=1) + _BLIND)
    ground = certainty * ledge
    rise = certainty * (solid - ledge) + (1 - certainty) * mean
    touching = ground + rise * touched
    return touching, (ground + rise * filled_chip) / (touching + _BLIND)


def _wall_occupancy(
    points: Float[Array, "point disc 3"],
    moves: Float[Array, "point disc 2"],
    chips: Float[Array, "point disc 2"],
    ends: tuple[Float[Array, "..."], ...],
    sides: tuple[tuple[Bool[Array, "..."], ...], ...],
    heights: Float[Array, "point element"],
    origin: Float[Array, " 3"],
    sizes: tuple[float, float],
) -> tuple[
    Float[Array, "point element"],
    Float[Array, "point element"],
    Float[Array, "point element"],
]:
    """Return where a chip is in the material, how much of it, and how surely."""
    d, band = sizes
    reach = REACH * d
    q = (heights - origin[2]) / d
    q = (q - jax.lax.stop_gradient(jnp.floor(q)))[..., None]
    total = jnp.zeros_like(heights)
    says = jnp.full_like(heights, _BLIND)
    certainty = jnp.zeros_like(heights)
    ahead = jnp.zeros_like(heights)
    inward = jnp.zeros_like(heights)
    for f in (0, 1):
        is_upper, is_empty = sides[f]
        x = jnp.broadcast_to(points[..., f], heights.shape)[..., None]
        s = jnp.where(is_upper, ends[f] - x, x - ends[f])
        s = jnp.where(is_empty, -reach, clamp(-reach, s, reach))
        s = s.reshape(*s.shape[:-1], 3, 2)
        sees = (1 - (s / reach) ** 2) ** 2 + _BLIND
        level = jnp.concatenate([1 - q, q], axis=-1)[..., None, :] * sees
        seen = jnp.sum(level, axis=-1)
        s = jnp.sum(level * s, axis=-1) / seen
        at = (points[..., 1 - f] - origin[1 - f]) / d
        t = jnp.broadcast_to(at - jax.lax.stop_gradient(jnp.round(at)), heights.shape)
        slope = (0.5 - t) * (s[..., 1] - s[..., 0]) + (0.5 + t) * (
            s[..., 2] - s[..., 1]
        )
        slope = slope / d
        s_here = jnp.sum(_spline(t) * s, axis=-1)
        sees_here = (1 - (s_here / reach) ** 2) ** 2
        steepness = 1 + slope**2
        weight = sees_here / steepness**2
        root = jnp.sqrt(steepness)
        sign = jnp.where(is_upper[..., 2], 1, -1).astype(s.dtype)
        crossed, deeper = (
            slope * way[..., 1 - f] - sign * way[..., f] for way in (moves, chips)
        )
        ahead = ahead + (weight + _BLIND) * jnp.abs(crossed) / root
        inward = inward + (weight + _BLIND) * deeper / root
        total = total + (weight + _BLIND) * s_here / root
        says = says + weight + _BLIND
        certainty = certainty + weight
    # A wall that an edge follows rather than crosses is not blurred along its way.
    width = clamp(_FOLLOWED * band, ahead / says, band)
    # From the rim to the inner side of the chip.
    inside, inward = total / says, inward / says
    touched = hat_integral((inside + jnp.maximum(inward, 0)) / width)
    length = jnp.sqrt(inward**2 + (_SHORT * width) ** 2)
    filled = mean_step(inside + inward / 2, width, length)
    return touched, filled, clamp(0.0, 2 * certainty, 1.0)


def _column_weights(
    points: Float[Array, "point disc 3"], origin: Float[Array, " 3"], spacing: float
) -> Float[Array, "point disc 9"]:
    """Return the quadratic B-spline weights of the 3 x 3 columns."""
    weights = []
    for a in (0, 1):
        at = (points[..., a] - origin[a]) / spacing
        weights.append(_spline(at - jax.lax.stop_gradient(jnp.round(at))))
    product = weights[0][..., :, None] * weights[1][..., None, :]
    return product.reshape(*product.shape[:-2], 9)


def _spline(t: Float[Array, "*point"]) -> Float[Array, "*point 3"]:
    """Return the quadratic B-spline weights of three lines, `t` from the middle one."""
    return jnp.stack([0.5 * (0.5 - t) ** 2, 0.75 - t**2, 0.5 * (0.5 + t) ** 2], axis=-1)
