"""Occupancy of the discs of a vertical cutter, angle by angle.

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

With `track` given, an end that is read here is derived by the pose that it remembers,
through the slope of the cutter's surface at that end, or by the raw stock; else through
the ends of the rays.
"""

import functools
from typing import Any, Literal, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import (
    Rematerialised,
    ShortAxis,
    clamp,
    hat_integral,
    materialise,
    ramp,
    with_derivative_of,
)
from .mean_step import hat_moment, mean_step
from .nearest_interval import gather, nearest_interval
from .stock import Stock
from .tooth_pass import PoseTrack

# Distances along a ray are cut off here, in units of the spacing.
REACH = 4.0
# Share of the band across a wall that an edge does not cross on its way.
_FOLLOWED = 0.3
# Bounds of that width are rounded off over this share of the band.
_CORNER = 0.2
# Where walls are sure enough, rounded off over this.
_CONFIDENCE_ROUNDING = 0.3
# A chip that crosses less of a wall than this, in widths of its band, counts as this.
_SHORT = 1e-2
# What a ray without a surface in reach still counts for.
_BLIND = 1e-6


class ChipsInStock(NamedTuple):
    """How much of chips is in the material.

    Attributes:
        occupancy: The share of each disc or piece of edge that has a chip in the
            material, exactly 0 and 1 away from surfaces.
        chip_share: The share of that chip's thickness that is in the material.
    """

    occupancy: Float[Array, "*point"]
    chip_share: Float[Array, "*point"]


class Discs(eqx.Module):
    """The discs of a cutter, from the tip up.

    Attributes:
        count: Number of discs.
        height: Height of a disc dz [m].
        band: Greatest half-width of the transition from 0 to 1 across a wall [m]:
            half the spacing of the rays, or of the samples on the rim if that is more.
    """

    count: int = eqx.field(static=True)
    height: float
    band: float

    def centers(self, dtype: jnp.dtype) -> Float[Array, " element"]:
        """Return the height of the middle of each disc above the tip [m]."""
        return self.height * (jnp.arange(self.count, dtype=dtype) + 0.5)

    def filled_below(
        self, height: Float[Array, "*end disc point"]
    ) -> Float[Array, "*end element point"]:
        """Return the share of each disc that lies below a height above the tip.

        The shares of all discs sum to height / dz at any height between zero and the
        middle of the last disc. The lowest disc ends at the tip: it has no share in
        material below.

        Args:
            height: Above the tip [m], of each disc or the same for all: shape
                (..., disc, point), where the axis disc has length 1 or that of all.

        Differentiability: continuous; at the height of the tip, where the floor of an
        earlier pass of the same height lies, half the slope above it.
        """
        place = jnp.arange(self.count, dtype=height.dtype)[:, None]
        place = place.reshape((1,) * (height.ndim - 2) + place.shape)
        height = _at_discs(height, self.count)
        above = jnp.maximum(height, 0)
        share = hat_integral(above / self.height - (place + 0.5))
        below_tip = hat_integral(-above / self.height - 0.5)
        return jnp.where(place == 0, share - below_tip, share)

    def occupancy(
        self,
        stock: Stock,
        points: Float[Array, "point disc 3"],
        moves: Float[Array, "point disc 2"],
        chips: Float[Array, "point disc 2"],
        cutter: AbstractCutter,
        *,
        growth: Float[Array, "point disc"] | None = None,
        track: PoseTrack | None = None,
        slots: Int[Array, " 3"] | None = None,
    ) -> ChipsInStock:
        """Return how much of the chips at points on the rim is in the material.

        Args:
            stock: The workpiece.
            points: Points in `work` at the height of the tip [m], shape (point, disc,
                3); the axis disc has length 1 if all discs share their points.
            moves: From each point to the next sample [m], across the axis, shape
                (point, disc, 2).
            chips: From each point to the inner side of its chip [m], as `moves`.
            cutter: The cutter that cut the stock; used only with `track`.
            growth: How much thicker a chip is at the next sample [-], shape (point,
                disc): beside a wall it counts as thick as in the middle of the part
                that is in the material. None for chips of constant thickness.
            track: All poses so far, to which the derivative goes; None differentiates
                through the stock.
            slots: How many slots of each family hold anything, shape (3,); counted if
                not given.

        Returns:
            Of every disc at every point, shape (point, element).

        Differentiability: continuous; kinks where a point crosses a grid line.
        """
        # Points in the last axis: arrays are long there, nothing is summed over it.
        ways = materialise((points, moves, chips))
        place, move, chip = materialise([jnp.unstack(x.T) for x in ways])
        place, move, chip = _Place(*place), _Across(*move), _Across(*chip)
        columns = _find_columns(stock, place)
        if track is not None:
            columns = _with_column_derivatives(cutter, columns, track)
        columns = _read_ends(columns)
        heights = _wall_heights(stock, place, self, columns)
        slots = stock.slots_in_use() if slots is None else slots
        walls = tuple(_find_walls(stock, f, place, heights, slots[f]) for f in (0, 1))
        if track is not None:
            walls = _with_wall_derivatives(cutter, walls, track)
        walls = tuple(_read_ends(wall) for wall in walls)
        if growth is None:
            growth = jnp.zeros_like(points[..., 0])
        rim = _Rim(place, move, chip, materialise(growth.T), heights)
        found = _combine(self, stock.spacing, stock.origin, rim, columns, walls)
        return materialise(ChipsInStock(*(share.T for share in materialise(found))))


class _Place(NamedTuple):
    """Points in `work` [m]."""

    x: Float[Array, "disc point"]
    y: Float[Array, "disc point"]
    z: Float[Array, "disc point"]


class _Across(NamedTuple):
    """Ways across the axis [m]."""

    x: Float[Array, "disc point"]
    y: Float[Array, "disc point"]


class _Rim(eqx.Module):
    """Points on the rim, what is taken there, and the heights at which to look.

    Attributes:
        place: In `work`, at the height of the tip [m].
        move: To the next sample [m].
        chip: To the inner side of the chip [m].
        growth: Of the chip from sample to sample [-].
        heights: At which walls are looked for [m].
    """

    place: _Place
    move: _Across
    chip: _Across
    growth: Float[Array, "disc point"]
    heights: Float[Array, "element point"]


class _Columns(eqx.Module):
    """All ends of the 3 x 3 rays along z around each point.

    Attributes:
        ends: Lower and upper ends [m].
        poses: What cut them, as `Rays.poses` has it.
        at: Where in memory they are.
        across: Where the rays stand along x and y [m].
    """

    ends: Float[Array, "2 slot 9 disc point"]
    poses: Int[Array, "2 slot 9 disc point"]
    at: Int[Array, "2 slot 9 disc point"]
    across: Float[Array, "2 1 1 9 disc point"]


class _Walls(eqx.Module):
    """The end that decides the distance on rays around each point.

    They stand on the three nearest lines to the side, and below and above.
    """

    ends: Float[Array, "3 2 element point"]
    is_upper: Bool[Array, "3 2 element point"]
    is_empty: Bool[Array, "3 2 element point"]
    pose: Int[Array, "3 2 element point"]
    at: Int[Array, "3 2 element point"]
    across: Float[Array, "3 1 disc point"]


_Rays = TypeVar("_Rays", _Columns, _Walls)


def _find_columns(stock: Stock, place: _Place) -> _Columns:
    rays = stock.families[2]
    counts, slots = rays.ends.shape[:2], rays.ends.shape[-1]
    step = jnp.arange(-1, 2, dtype=jnp.int32)
    near = [_nearest_line(stock, a, place[a], counts[a])[None] for a in (0, 1)]
    i = near[0] + jnp.repeat(step, 3)[:, None, None]
    j = near[1] + jnp.tile(step, 3)[:, None, None]
    slot = jnp.arange(2 * slots, dtype=jnp.int32).reshape(2, slots, 1, 1, 1)
    ray = materialise((i * counts[1] + j) * (2 * slots))
    at = materialise(ray[None, None] + slot)
    poses = Rematerialised.read(gather(rays.poses, at))
    lines = jnp.stack([i, j])[:, None, None].astype(rays.ends.dtype)
    across = stock.origin[:2].reshape(2, *(1,) * 5) + stock.spacing * lines
    return _Columns(gather(rays.ends, at), poses, at, across)


def _nearest_line(
    stock: Stock, axis: int, x: Float[Array, "*point"], count: int
) -> Int[Array, "*point"]:
    """Return the nearest grid line that has a neighbour on each side."""
    at = jax.lax.stop_gradient((x - stock.origin[axis]) / stock.spacing)
    return jnp.clip(jnp.round(at).astype(jnp.int32), 1, count - 2)


def _wall_heights(
    stock: Stock,
    place: _Place,
    discs: Discs,
    columns: _Columns,
) -> Float[Array, "element point"]:
    """Return the height at which to look for walls, inside the material of a disc.

    A disc that only just reaches into the material from above has its middle in the
    air, where rays along x and y meet nothing; one spacing below the top they do.
    """
    centers = discs.centers(place.z.dtype)
    z = _at_discs(place.z, discs.count) + centers[:, None]
    low, high = (
        _at_discs(x.reshape(-1, *x.shape[2:]), discs.count)
        for x in materialise(jnp.unstack(columns.ends), backward_only=True)
    )
    reaches = (high > low) & (low < z[None] + discs.height)
    top = _largest(jnp.where(reaches, high, -jnp.inf))
    is_fringe = (top < z + stock.spacing) & (top > z - discs.height)
    return materialise(
        jnp.where(is_fringe, jnp.where(is_fringe, top, 0) - stock.spacing, z)
    )


def _find_walls(
    stock: Stock,
    family: Literal[0, 1],
    place: _Place,
    heights: Float[Array, "element point"],
    in_use: Int[Array, ""],
) -> _Walls:
    rays = stock.families[family]
    frozen = jax.lax.stop_gradient
    side = 1 - family
    # Family 0 is indexed (y, z), family 1 is indexed (z, x).
    counts = rays.ends.shape[:2] if family == 0 else rays.ends.shape[1::-1]
    middle = _nearest_line(stock, side, place[side], counts[0])
    at_height = frozen((heights - stock.origin[2]) / stock.spacing)
    below = jnp.clip(jnp.floor(at_height).astype(jnp.int32), 0, counts[1] - 2)
    step = jnp.arange(-1, 2, dtype=jnp.int32)[:, None, None, None]
    line = middle[None, None] + step
    level = below[None, None] + step[1:].reshape(1, 2, 1, 1)
    row, column = (line, level) if family == 0 else (level, line)
    slots = rays.ends.shape[-1]
    ray = (row * rays.ends.shape[1] + column) * (2 * slots)
    x = place[family][None, None]
    low, high, slot = nearest_interval(rays.ends, ray, x, in_use)
    x = frozen(x)
    is_upper = high - x < x - low
    at = Rematerialised.read(ray + is_upper.astype(jnp.int32) * slots + slot)
    # As they were found: to read them anew is for derivatives.
    found = materialise(jnp.where(is_upper, high, low))
    return _Walls(
        ends=with_derivative_of(found, gather, rays.ends, at),
        is_upper=Rematerialised.read(is_upper),
        is_empty=Rematerialised.read(high < low),
        pose=Rematerialised.read(gather(rays.poses, at)),
        at=at,
        across=stock.origin[side] + stock.spacing * line.astype(heights.dtype),
    )


def _read_ends(rays: _Rays) -> _Rays:
    """Return rays whose ends are marked as read, with the derivative that they have."""
    return eqx.tree_at(lambda r: r.ends, rays, Rematerialised.read(rays.ends))


def _with_column_derivatives(
    cutter: AbstractCutter, columns: _Columns, track: PoseTrack
) -> _Columns:
    """Return the columns, each end with the derivative of the pose that cut it."""
    frozen = jax.lax.stop_gradient(columns)
    frozen = eqx.tree_at(lambda c: c.across, frozen, columns.across)
    ends = with_derivative_of(frozen.ends, _made_columns, cutter, frozen, track)
    return eqx.tree_at(lambda c: c.ends, columns, ends)


def _made_columns(
    cutter: AbstractCutter, columns: _Columns, track: PoseTrack
) -> Float[Array, "2 slot 9 disc point"]:
    """Return ends that follow from their poses: those of the cutter's end there."""
    x, y = columns.across[0], columns.across[1]
    height = track.floor_by(columns.poses, cutter, x, y)
    raw = track.raw_ends(2, columns.at, columns.poses)
    return jnp.where(columns.poses >= 0, height, raw)


def _with_wall_derivatives(
    cutter: AbstractCutter, walls: tuple[_Walls, ...], track: PoseTrack
) -> tuple[_Walls, ...]:
    """Return both families, their ends with the derivatives of their poses."""
    frozen = jax.lax.stop_gradient(walls)
    across = lambda ws: tuple(wall.across for wall in ws)
    frozen = eqx.tree_at(across, frozen, across(walls))
    old = tuple(wall.ends for wall in frozen)
    ends = with_derivative_of(old, _made_walls, cutter, frozen, track)
    return eqx.tree_at(lambda ws: tuple(w.ends for w in ws), walls, ends)


def _made_walls(
    cutter: AbstractCutter, walls: tuple[_Walls, ...], track: PoseTrack
) -> tuple[Float[Array, "3 2 element point"], ...]:
    """Return ends of both families that move with their poses, but for a constant."""
    frozen = jax.lax.stop_gradient
    # One gather for both: its transpose then adds into the table only once.
    both = Rematerialised.read(
        _tips_of_walls(jnp.stack([w.pose for w in walls]), track)
    )
    tips, made = materialise(jnp.unstack(both), backward_only=True), []
    for f in (0, 1):
        wall, tip = walls[f], tips[f]
        slopes = cutter.wall_slopes(f, wall.ends, wall.across, frozen(tip))
        by_aside, by_radius = frozen(Rematerialised.read(slopes))
        # One product: the derivative of a coordinate is an array of zeros around it.
        axis = jnp.arange(3, dtype=jnp.int32).reshape((1,) * by_aside.ndim + (3,))
        by_tip = jnp.where(
            axis == 1 - f, by_aside[..., None], jnp.where(axis == f, 1, 0)
        )
        end = jnp.sum(by_tip * tip, axis=-1) - by_aside * wall.across
        end = end + by_radius * (cutter.diameter / 2)
        raw = track.raw_ends(f, wall.at, wall.pose)
        made.append(jnp.where(wall.pose >= 0, end, raw))
    return tuple(made)


def _tips_of_walls(
    poses: Int[Array, "2 3 2 element point"], track: PoseTrack
) -> Float[Array, "2 3 2 element point 3"]:
    """Return the tips that cut walls; for raw ends, any.

    A straight tooth makes an upright wall at once from floor to top: mostly one pose
    stands for all heights of every wall of a look, and reverse mode adds into the track
    one by one.
    """
    newest = jnp.max(poses, axis=(2, 3), keepdims=True)
    is_one = jnp.all((poses == newest) | (poses < 0))
    shape = (*poses.shape, 3)
    return jax.lax.cond(
        is_one,
        lambda: jnp.broadcast_to(track.cut_by(newest).tip, shape),
        lambda: track.cut_by(poses).tip,
    )


def _combine(
    discs: Discs,
    spacing: float,
    origin: Float[Array, " 3"],
    rim: _Rim,
    columns: _Columns,
    walls: tuple[_Walls, ...],
) -> ChipsInStock:
    wall = materialise(_wall_occupancy(spacing, discs.band, origin, rim, walls))
    wall_confidence = wall.wall_confidence
    low, high = columns.ends
    z = ShortAxis.copies(ShortAxis.copies(rim.place.z, 9), 2 * len(low))
    below = discs.filled_below(columns.ends - z.reshape(2, len(low), *z.shape[1:]))
    signs = jnp.array([-1.0, 1.0], below.dtype).reshape(2, 1, 1, 1, 1)
    lengths = jnp.where((high > low)[None], signs * below, 0)
    filled = ShortAxis.sum(ShortAxis.sum(lengths))
    weights = _column_weights(rim.place, origin, spacing)
    weights = _at_discs(weights, discs.count)
    # Beside a wall the columns in the air must not thin the disc: walls do that.
    # Before a higher wall the disc stands on what its lower columns hold.
    fullest = _largest(filled)
    filled, fullest, weights = materialise((filled, fullest, weights))
    weighted = weights * filled
    gap = ShortAxis.copies(fullest, filled.shape[0]) - filled
    mean = ShortAxis.sum(weighted)
    solid = ShortAxis.sum(weighted * filled) / (mean + _BLIND)
    ledge = ShortAxis.sum(weighted * gap) / (ShortAxis.sum(weights * gap) + _BLIND)
    ground = wall_confidence * ledge
    rise = wall_confidence * (solid - ledge) + (1 - wall_confidence) * mean
    ground, rise = materialise((ground, rise))
    touching = materialise(ground + rise * wall.touched)
    return ChipsInStock(touching, (ground + rise * wall.filled) / (touching + _BLIND))


def _at_discs(
    values: Float[Array, "*any own point"], count: int
) -> Float[Array, "*any disc point"]:
    """Return values of all discs, which may share them."""
    if values.shape[-2] == count:
        return values
    return jnp.moveaxis(ShortAxis.copies(jnp.squeeze(values, -2), count), 0, -2)


@jax.custom_jvp
def _largest(values: Float[Array, " value *any"]) -> Float[Array, "*any"]:
    """Return the largest values over a short leading axis.

    The first of equal values has the whole derivative: shared by comparison, it would
    be lost to rounding in reverse.
    """
    return functools.reduce(jnp.maximum, jnp.unstack(values))


def _largest_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    (values,), (changes,) = primals, tangents
    largest, place = values[0], jnp.zeros(values.shape[1:], jnp.int32)
    for i, value in enumerate(jnp.unstack(values)):
        place = jnp.where(value > largest, i, place)
        largest = jnp.maximum(value, largest)
    each = jnp.arange(values.shape[0], dtype=jnp.int32)
    is_first = place[None] == each.reshape(-1, *(1,) * place.ndim)
    return _largest(values), ShortAxis.sum(jnp.where(is_first, changes, 0))


_largest.defjvp(_largest_jvp)


class _WallShares(NamedTuple):
    """Chips beside walls.

    Attributes:
        touched: Where a chip is in the material.
        filled: How much of it is.
        wall_confidence: How surely walls tell.
    """

    touched: Float[Array, "element point"]
    filled: Float[Array, "element point"]
    wall_confidence: Float[Array, "element point"]


def _wall_occupancy(
    d: float,
    band: float | Float[Array, ""],
    origin: Float[Array, " 3"],
    rim: _Rim,
    walls: tuple[_Walls, ...],
) -> _WallShares:
    reach = REACH * d
    place, heights = rim.place, rim.heights
    q = (heights - origin[2]) / d
    q = q - jax.lax.stop_gradient(jnp.floor(q))
    total = jnp.zeros_like(heights)
    says = jnp.full_like(heights, _BLIND)
    wall_confidence = jnp.zeros_like(heights)
    ahead = jnp.zeros_like(heights)
    entering = jnp.zeros_like(heights)
    inward = jnp.zeros_like(heights)
    for f, wall in enumerate(walls):
        # On three lines, below and above.
        x = ShortAxis.copies(_at_discs(place[f], len(heights)), 3 * 2)
        x = x.reshape(wall.ends.shape)
        s = jnp.where(wall.is_upper, wall.ends - x, x - wall.ends)
        s = jnp.where(wall.is_empty, -reach, clamp(-reach, s, reach))
        below, above = materialise(jnp.unstack(s, axis=1), backward_only=True)
        lower, upper = (
            share * ((1 - (s / reach) ** 2) ** 2 + _BLIND)
            for share, s in (
                (1 - ShortAxis.copies(q, 3), below),
                (ShortAxis.copies(q, 3), above),
            )
        )
        s = materialise((lower * below + upper * above) / (lower + upper))
        left, middle, right = materialise(jnp.unstack(s), backward_only=True)
        at = (place[1 - f] - origin[1 - f]) / d
        t = jnp.broadcast_to(at - jax.lax.stop_gradient(jnp.round(at)), heights.shape)
        slope = ((0.5 - t) * (middle - left) + (0.5 + t) * (right - middle)) / d
        s_here = ShortAxis.sum(_spline(t) * s)
        sees_here = (1 - (s_here / reach) ** 2) ** 2
        steepness = 1 + slope**2
        weight = sees_here / steepness**2
        sign = jnp.where(wall.is_upper[1, 0], 1, -1).astype(s.dtype)
        crossed, deeper = (
            slope * way[1 - f] - sign * way[f] for way in (rim.move, rim.chip)
        )
        say = (weight + _BLIND) / jnp.sqrt(steepness)
        ahead = ahead + say * jnp.abs(crossed)
        entering = entering + say * crossed
        inward = inward + say * deeper
        total = total + say * s_here
        says = says + weight + _BLIND
        wall_confidence = wall_confidence + weight
    inside, ahead, entering, inward = materialise(
        [x / says for x in (total, ahead, entering, inward)]
    )
    # A wall that an edge follows rather than crosses is not blurred along its way.
    width = _FOLLOWED * band + ramp(ahead - _FOLLOWED * band, _CORNER * band)
    width = materialise(width - ramp(width - band, _CORNER * band))
    # From the rim to the inner side of the chip.
    length = jnp.sqrt(inward**2 + (_SHORT * width) ** 2)
    # To the nearer side of the chip, without the kink of a greatest one.
    touched = hat_integral((inside + (inward + length) / 2) / width)
    filled = mean_step(inside + inward / 2, width, length)
    moment = hat_moment((inside + inward / 2) / width) * entering / width
    filled = filled + _at_discs(rim.growth, len(heights)) * moment
    # A wall that both families see at 45 degrees is sure, its corner rounded off below.
    sure = 2 * (1 + _CONFIDENCE_ROUNDING) * wall_confidence
    return _WallShares(touched, filled, sure - ramp(sure - 1, _CONFIDENCE_ROUNDING))


def _column_weights(
    place: _Place, origin: Float[Array, " 3"], spacing: float
) -> Float[Array, "9 disc point"]:
    """Return the quadratic B-spline weights of the 3 x 3 columns."""
    weights = []
    for a in (0, 1):
        at = (place[a] - origin[a]) / spacing
        weights.append(_spline(at - jax.lax.stop_gradient(jnp.round(at))))
    product = weights[0][:, None] * weights[1][None]
    return product.reshape(9, *product.shape[2:])


def _spline(t: Float[Array, "*point"]) -> Float[Array, " 3 *point"]:
    """Return the quadratic B-spline weights of three lines, `t` from the middle one."""
    return jnp.stack([0.5 * (0.5 - t) ** 2, 0.75 - t**2, 0.5 * (0.5 + t) ** 2])
