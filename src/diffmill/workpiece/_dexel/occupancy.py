"""Occupancy of the discs of a vertical cutter, angle by angle.

The rays see what lies head-on to them exactly, and the rest only to their spacing. So
the question is split:

- along the axis, the columns (rays along z) around a point give the share of each
  disc's height that is material: a partition of unity over the discs, so that the
  shares add up to the depth of cut exactly, at any depth;
- across the axis, the rays along x and y give the signed distance to walls in the
  plane of the disc. Each of the two families is interpolated over three rays, by
  quadratic splines, whose slope g across the rays is continuous: s / sqrt(1 + g^2) is
  the distance to a straight wall, exactly, and (1 + g^2)^-2 is the family's weight.

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
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import (
    Rematerialised,
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

# Coordinates of points on the rim along x, y and z, or of ways along x and y [m].
Coordinates: TypeAlias = tuple[Float[Array, "disc point"], ...]


class WallSmoothing(eqx.Module):
    """Smoothing of the occupancy across a wall.

    All numbers are shares without unit and our own choice, held against exact geometry
    by `tests/workpiece/test_occupancy.py` and `experiments/cutting`.

    Attributes:
        narrowest_band: Least half-width of the transition, where an edge follows the
            wall, in half-widths of the band of a disc.
        band_rounding: Both bounds of that width are rounded off over so much of the
            band.
        confidence_rounding: A confidence near 1 is rounded off over so much.
        shortest_chip: Least way of a chip across a wall, in half-widths of the
            transition.
        blind_weight: Weight of a ray without a surface within reach.
    """

    narrowest_band: float = eqx.field(static=True, default=0.3)
    band_rounding: float = eqx.field(static=True, default=0.2)
    confidence_rounding: float = eqx.field(static=True, default=0.3)
    shortest_chip: float = eqx.field(static=True, default=1e-2)
    blind_weight: float = eqx.field(static=True, default=1e-6)

    def half_width(
        self, crossed: Float[Array, "element point"], band: float | Float[Array, ""]
    ) -> Float[Array, "element point"]:
        """Half-width of the transition across a wall [m].

        A wall that an edge follows rather than crosses is not blurred along its way.

        Args:
            crossed: Way of the edge across the wall to the next sample [m].
            band: Greatest half-width [m].

        Differentiability: smooth.
        """
        least, corner = self.narrowest_band * band, self.band_rounding * band
        width = least + ramp(crossed - least, corner)
        return materialise(width - ramp(width - band, corner))

    def confidence(
        self, weight: Float[Array, "element point"]
    ) -> Float[Array, "element point"]:
        """Confidence in the walls, from the weights of both families, 0 to 1 [-].

        It is 1 for a wall that both families see at 45 degrees.
        """
        rounding = self.confidence_rounding
        confidence = 2 * (1 + rounding) * weight
        return confidence - ramp(confidence - 1, rounding)


_SMOOTHING = WallSmoothing()


class ChipsInStock(NamedTuple):
    """Shares of chips that are in the material.

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
        """Height of the middle of each disc above the tip [m], shape (element,)."""
        return self.height * (jnp.arange(self.count, dtype=dtype) + 0.5)

    def filled_below(
        self, height: Float[Array, "*end disc point"]
    ) -> Float[Array, "*end element point"]:
        """Share of each disc that lies below a height above the tip [-].

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
        """Shares of the chips at points on the rim that are in the material.

        Args:
            stock: The workpiece.
            points: Points in `work` at the height of the tip [m], shape (point, disc,
                3); the axis disc has length 1 if all discs share their points.
            moves: From each point to the next sample [m], across the axis, shape
                (point, disc, 2).
            chips: From each point to the inner side of its chip [m], as `moves`.
            cutter: The cutter that cut the stock; used only with `track`.
            growth: Growth of a chip to the next sample [-], shape (point,
                disc): beside a wall it counts as thick as in the middle of the part
                that is in the material. None for chips of constant thickness.
            track: All poses so far, to which the derivative goes; None differentiates
                through the stock.
            slots: Number of slots in use of each family, shape (3,); counted if not
                given.

        Returns:
            Of every disc at every point, shape (point, element).

        Differentiability: continuous; kinks where a point crosses a grid line.
        """
        # Points in the last axis: arrays are long there, nothing is summed over it.
        rim_arrays = materialise((points, moves, chips))
        place, move, chip = materialise([jnp.unstack(x.T) for x in rim_arrays])
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
        shares = materialise(
            _combine(self, stock.spacing, stock.origin, rim, columns, walls)
        )
        occupancy, chip_share = materialise(tuple(share.T for share in shares))
        return ChipsInStock(occupancy, chip_share)


class _Rim(eqx.Module):
    """Points on the rim with their chips, and the heights of the walls.

    Attributes:
        place: Points in `work`, at the height of the tip [m].
        move: Way to the next sample across the axis [m].
        chip: Way to the inner side of the chip across the axis [m].
        growth: Growth of the chip from sample to sample [-].
        heights: Heights of the rays to the walls [m].
    """

    place: Coordinates
    move: Coordinates
    chip: Coordinates
    growth: Float[Array, "disc point"]
    heights: Float[Array, "element point"]


class _Columns(eqx.Module):
    """All ends of the 3 x 3 rays along z around each point.

    Attributes:
        ends: Lower and upper ends [m].
        poses: Ticks at which they were cut, as in `Rays.poses`.
        at: Indices of the ends in memory.
        across: Coordinates of the rays along x and y [m].
    """

    ends: Float[Array, "2 slot 9 disc point"]
    poses: Int[Array, "2 slot 9 disc point"]
    at: Int[Array, "2 slot 9 disc point"]
    across: Float[Array, "2 1 1 9 disc point"]


class _Walls(eqx.Module):
    """Ends of rays that are nearest to each point.

    The rays stand on the three nearest lines to the side, and below and above.
    """

    ends: Float[Array, "3 2 element point"]
    is_upper: Bool[Array, "3 2 element point"]
    is_empty: Bool[Array, "3 2 element point"]
    pose: Int[Array, "3 2 element point"]
    at: Int[Array, "3 2 element point"]
    across: Float[Array, "3 1 disc point"]


_Rays = TypeVar("_Rays", _Columns, _Walls)


def _find_columns(stock: Stock, place: Coordinates) -> _Columns:
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
    """Index of the nearest grid line that has a neighbour on each side."""
    at = jax.lax.stop_gradient((x - stock.origin[axis]) / stock.spacing)
    return jnp.clip(jnp.round(at).astype(jnp.int32), 1, count - 2)


def _wall_heights(
    stock: Stock,
    place: Coordinates,
    discs: Discs,
    columns: _Columns,
) -> Float[Array, "element point"]:
    """Height of the rays to the walls, inside the material of a disc [m].

    A disc that only just reaches into the material from above has its middle in the
    air, where rays along x and y meet nothing; one spacing below the top they do.
    """
    centers = discs.centers(place[2].dtype)
    z = _at_discs(place[2], discs.count) + centers[:, None]
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
    place: Coordinates,
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
    # The values of the search: to read them anew is for derivatives.
    ends = materialise(jnp.where(is_upper, high, low))
    return _Walls(
        ends=with_derivative_of(ends, gather, rays.ends, at),
        is_upper=Rematerialised.read(is_upper),
        is_empty=Rematerialised.read(high < low),
        pose=Rematerialised.read(gather(rays.poses, at)),
        at=at,
        across=stock.origin[side] + stock.spacing * line.astype(heights.dtype),
    )


def _read_ends(rays: _Rays) -> _Rays:
    """Rays whose ends are marked as read, with the derivative that they have."""
    return eqx.tree_at(lambda r: r.ends, rays, Rematerialised.read(rays.ends))


def _with_column_derivatives(
    cutter: AbstractCutter, columns: _Columns, track: PoseTrack
) -> _Columns:
    """Columns whose ends have the derivative of the pose that cut them."""
    frozen = jax.lax.stop_gradient(columns)
    frozen = eqx.tree_at(lambda c: c.across, frozen, columns.across)
    ends = with_derivative_of(frozen.ends, _column_ends, cutter, frozen, track)
    return eqx.tree_at(lambda c: c.ends, columns, ends)


def _column_ends(
    cutter: AbstractCutter, columns: _Columns, track: PoseTrack
) -> Float[Array, "2 slot 9 disc point"]:
    """Ends of columns that follow from their poses: the cutter's end there [m].

    An upright tool takes all that is above it, so that lower ends are those of the raw
    stock.
    """
    x, y = columns.across[0], columns.across[1]
    upper = columns.poses[1:]
    height = track.floor_by(upper, cutter, x, y)
    low, high = jnp.split(track.raw_ends(2, columns.at, columns.poses), 2)
    return jnp.concatenate([low, jnp.where(upper >= 0, height, high)])


def _with_wall_derivatives(
    cutter: AbstractCutter, walls: tuple[_Walls, ...], track: PoseTrack
) -> tuple[_Walls, ...]:
    """Walls of both families whose ends have the derivatives of their poses."""
    frozen = jax.lax.stop_gradient(walls)
    across = lambda ws: tuple(wall.across for wall in ws)
    frozen = eqx.tree_at(across, frozen, across(walls))
    old = tuple(wall.ends for wall in frozen)
    ends = with_derivative_of(old, _wall_ends, cutter, frozen, track)
    return eqx.tree_at(lambda ws: tuple(w.ends for w in ws), walls, ends)


def _wall_ends(
    cutter: AbstractCutter, walls: tuple[_Walls, ...], track: PoseTrack
) -> tuple[Float[Array, "3 2 element point"], ...]:
    """Ends of both families that move with their poses, but for a constant [m]."""
    frozen = jax.lax.stop_gradient
    # One gather for both: its transpose then adds into the table only once.
    both = Rematerialised.read(
        _tips_of_walls(jnp.stack([w.pose for w in walls]), track)
    )
    tips, ends = materialise(jnp.unstack(both), backward_only=True), []
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
        ends.append(jnp.where(wall.pose >= 0, end, raw))
    return tuple(ends)


def _tips_of_walls(
    poses: Int[Array, "2 3 2 element point"], track: PoseTrack
) -> Float[Array, "2 3 2 element point 3"]:
    """Tips that cut the walls [m]; of raw ends, any.

    A straight tooth makes an upright wall at once from floor to top: mostly one pose
    stands for all heights of all walls of a tooth period, and reverse mode adds into
    the track one by one.
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
) -> tuple[Float[Array, "element point"], Float[Array, "element point"]]:
    """Occupancy of the discs and share of their chips in the material [-].

        ledge = sum w f (F - f) / sum w (F - f),  mean = sum w f,
        solid = sum w f^2 / sum w f
        occupancy = c ledge + (c (solid - ledge) + (1 - c) mean) touched

    The share of the chip has `filled` in the place of `touched`, over the occupancy.
    """
    # symbols: w weights of the columns, f share of a disc that a column fills, F the
    # largest of these, c confidence in the walls.
    touched, filled_chip, wall_confidence = materialise(
        _wall_occupancy(spacing, discs.band, origin, rim, walls)
    )
    least = _SMOOTHING.blind_weight
    low, high = columns.ends
    z = jnp.broadcast_to(rim.place[2], (2, len(low), 9, *rim.place[2].shape))
    below = discs.filled_below(columns.ends - z)
    signs = jnp.array([-1.0, 1.0], below.dtype).reshape(2, 1, 1, 1, 1)
    lengths = jnp.where((high > low)[None], signs * below, 0)
    filled = jnp.sum(lengths, axis=(0, 1))
    weights = _column_weights(rim.place, origin, spacing)
    weights = _at_discs(weights, discs.count)
    # Beside a wall the columns in the air must not thin the disc: walls do that.
    # Before a higher wall the disc stands on what its lower columns hold.
    fullest = _largest(filled)
    filled, fullest, weights = materialise((filled, fullest, weights))
    weighted = weights * filled
    gap = fullest[None] - filled
    mean = jnp.sum(weighted, axis=0)
    solid = jnp.sum(weighted * filled, axis=0) / (mean + least)
    ledge = jnp.sum(weighted * gap, axis=0) / (jnp.sum(weights * gap, axis=0) + least)
    ground = wall_confidence * ledge
    rise = wall_confidence * (solid - ledge) + (1 - wall_confidence) * mean
    ground, rise = materialise((ground, rise))
    occupancy = materialise(ground + rise * touched)
    return occupancy, (ground + rise * filled_chip) / (occupancy + least)


def _at_discs(
    values: Float[Array, "*any own point"], count: int
) -> Float[Array, "*any disc point"]:
    """Values of all discs, which may share them."""
    if values.shape[-2] == count:
        return values
    shape = (*values.shape[:-2], count, values.shape[-1])
    return jnp.broadcast_to(values, shape)


@jax.custom_jvp
def _largest(values: Float[Array, " value *any"]) -> Float[Array, "*any"]:
    """Largest values over a short leading axis.

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
    return _largest(values), jnp.sum(jnp.where(is_first, changes, 0), axis=0)


_largest.defjvp(_largest_jvp)


def _wall_occupancy(
    d: float,
    band: float | Float[Array, ""],
    origin: Float[Array, " 3"],
    rim: _Rim,
    walls: tuple[_Walls, ...],
) -> tuple[Float[Array, "element point"], ...]:
    """Occupancy across the axis: a chip touches, fills; confidence in it [-].

        D = sum a (s / sqrt(1 + g^2)) / sum a,  a = (1 - (s / reach)^2)^2 / (1 + g^2)^2
        touched = H((D + (c + |c|) / 2) / b),  filled = mean of H over the chip

    The sums go over the families of rays along x and y.
    """
    # symbols: s distance to the wall along a ray, g its slope across the rays, a weight
    # of a family, D distance to the wall, c way across it to the inner side of the
    # chip, b half-width of the transition, H integral of the hat.
    reach, least = REACH * d, _SMOOTHING.blind_weight
    place, heights = rim.place, rim.heights
    q = (heights - origin[2]) / d
    q = q - jax.lax.stop_gradient(jnp.floor(q))
    total = jnp.zeros_like(heights)
    weight_sum = jnp.full_like(heights, least)
    surface_weight = jnp.zeros_like(heights)
    crossed_way = jnp.zeros_like(heights)
    entering = jnp.zeros_like(heights)
    inward = jnp.zeros_like(heights)
    for f, wall in enumerate(walls):
        # On three lines, below and above.
        x = _at_discs(place[f], len(heights))
        x = jnp.broadcast_to(x, (3, 2, *x.shape)).reshape(wall.ends.shape)
        s = jnp.where(wall.is_upper, wall.ends - x, x - wall.ends)
        s = jnp.where(wall.is_empty, -reach, clamp(-reach, s, reach))
        below, above = materialise(jnp.unstack(s, axis=1), backward_only=True)
        lower, upper = (
            share * ((1 - (s / reach) ** 2) ** 2 + least)
            for share, s in (
                (1 - q[None], below),
                (q[None], above),
            )
        )
        s = materialise((lower * below + upper * above) / (lower + upper))
        left, middle, right = materialise(jnp.unstack(s), backward_only=True)
        at = (place[1 - f] - origin[1 - f]) / d
        t = jnp.broadcast_to(at - jax.lax.stop_gradient(jnp.round(at)), heights.shape)
        slope = ((0.5 - t) * (middle - left) + (0.5 + t) * (right - middle)) / d
        s_here = jnp.sum(_spline(t) * s, axis=0)
        sees_here = (1 - (s_here / reach) ** 2) ** 2
        steepness = 1 + slope**2
        weight = sees_here / steepness**2
        sign = jnp.where(wall.is_upper[1, 0], 1, -1).astype(s.dtype)
        crossed, deeper = (
            slope * way[1 - f] - sign * way[f] for way in (rim.move, rim.chip)
        )
        family_weight = (weight + least) / jnp.sqrt(steepness)
        crossed_way = crossed_way + family_weight * jnp.abs(crossed)
        entering = entering + family_weight * crossed
        inward = inward + family_weight * deeper
        total = total + family_weight * s_here
        weight_sum = weight_sum + weight + least
        surface_weight = surface_weight + weight
    inside, crossed_way, entering, inward = materialise(
        [x / weight_sum for x in (total, crossed_way, entering, inward)]
    )
    width = _SMOOTHING.half_width(crossed_way, band)
    # From the rim to the inner side of the chip.
    length = jnp.sqrt(inward**2 + (_SMOOTHING.shortest_chip * width) ** 2)
    # To the nearer side of the chip, without the kink of a greatest one.
    touched = hat_integral((inside + (inward + length) / 2) / width)
    filled = mean_step(inside + inward / 2, width, length)
    moment = hat_moment((inside + inward / 2) / width) * entering / width
    filled = filled + _at_discs(rim.growth, len(heights)) * moment
    return touched, filled, _SMOOTHING.confidence(surface_weight)


def _column_weights(
    place: Coordinates, origin: Float[Array, " 3"], spacing: float
) -> Float[Array, "9 disc point"]:
    """Quadratic B-spline weights of the 3 x 3 columns [-]."""
    weights = []
    for a in (0, 1):
        at = (place[a] - origin[a]) / spacing
        weights.append(_spline(at - jax.lax.stop_gradient(jnp.round(at))))
    product = weights[0][:, None] * weights[1][None]
    return product.reshape(9, *product.shape[2:])


def _spline(t: Float[Array, "*point"]) -> Float[Array, " 3 *point"]:
    """Quadratic B-spline weights of three lines [-], `t` from the middle one."""
    return jnp.stack([0.5 * (0.5 - t) ** 2, 0.75 - t**2, 0.5 * (0.5 + t) ** 2])
