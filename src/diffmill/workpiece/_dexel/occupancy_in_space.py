"""Occupancy of a small piece of edge, its surface in any direction.

Every family of rays gives, around a point, one plane: of four rays, each measures the
distance along itself to the nearest end; those that meet no end within reach are left
out, the others are interpolated, and with g the slope of the interpolant the distance
to the plane is s / sqrt(1 + g^2).

The three planes are then one and the same (a face that all families see), two faces
of an edge that sticks out (what is inside of both is inside), or two of an edge that
goes in (inside of one is enough). The share inside the plane that leaves the least,
times the shares of planes at right angles to it, answers all three cases. A family that
sees the face at a flat angle, or whose rays partly meet nothing, knows less and counts
less.

A piece of edge is not a point: what counts is the mean of the smooth step over it and
over its way to the next sample, so that pieces in a row add up to the length in the
material. The chip, which begins at the edge and ends inward, counts with its mean in
the same way, so that a surface cuts off its inner or its outer side. Where the surface
is not crossed but followed the edge says little: one that slides over what an earlier
pass left is half in and half out, however it is smoothed. There the chip decides: with
next to no material in it, the edge is out.
"""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import Rematerialised, clamp, with_derivative_of
from .._pose import Pose
from .mean_step import hat_moment, mean_step
from .nearest_interval import gather, nearest_interval
from .occupancy import REACH, ChipsInStock
from .stock import Stock
from .tooth_pass import PoseTrack

# A family counts fully from this share of the best one's trust, and not at all below
# the second.
_FULL_TRUST, _NO_TRUST = 0.3, 0.1
_TINY = 1e-6
# Share of the rays around a point, by their weights, with which a family has half of
# the trust.
_HALF_TRUST_SHARE = 1e-2
# Shorter ways across a surface count as this share of the band: what the rays resolve
# of a smooth surface.
_SHORTEST_WAY = 0.03
# Shares of a chip in the material up to which its edge is out, and from which it is in.
_NO_CHIP, _CHIP = 0.02, 0.1
# Slope of a cut end against the motion of its pose is cut off at grazing rays.
_GRAZING = 1e-2


# The rays around a point are (row, column) 00, 01, 10, 11; pairs of neighbours.
_ACROSS_ROWS = ((0, 2), (1, 3))
_ACROSS_COLUMNS = ((0, 1), (2, 3))


class _Cells(eqx.Module):
    """Cells of pieces of edge by their edges [m], and growth of the chips [-]."""

    edges: Float[Array, "point edge 3"]
    growth: Float[Array, " point"]


class _Near(eqx.Module):
    """Nearest end on each of 2 x 2 rays around each point."""

    ends: Float[Array, "point 4"]
    is_upper: Bool[Array, "point 4"]
    is_empty: Bool[Array, "point 4"]
    pose: Int[Array, "point 4"]
    at: Int[Array, "point 4"]
    places: Float[Array, "point 4 3"]


class _Grid(eqx.Module):
    """Origin [m] and spacing [m] of the rays, and their resolution [m]."""

    origin: Float[Array, " 3"]
    spacing: float = eqx.field(static=True)
    band: float | Float[Array, ""]


class _Face(eqx.Module):
    """The plane that a family sees."""

    distance: Float[Array, " point"]
    normal: Float[Array, "point 3"]
    trust: Float[Array, " point"]
    full: Float[Array, " point"]
    empty: Float[Array, " point"]


def occupancy_in_space(
    stock: Stock,
    points: Float[Array, "point 3"],
    cells: Float[Array, "point edge 3"],
    band: float | Float[Array, ""],
    cutter: AbstractCutter,
    track: PoseTrack | None = None,
    *,
    growth: Float[Array, " point"] | None = None,
    slots: Int[Array, " 3"] | None = None,
) -> ChipsInStock:
    """Shares of the chips at pieces of edge that are in the material.

    Args:
        stock: The workpiece.
        points: Middles of the pieces in `work` [m], shape (point, 3).
        cells: Edges of the cell that each piece takes: from one end to the other, its
            way to the next sample, and from the inner side of its chip outward [m],
            shape (point, 3, 3).
        band: Resolution of the rays and samples [m].
        cutter: The cutter that cut the stock; used only with `track`.
        track: All poses so far, to which the derivative goes; None differentiates
            through the stock.
        growth: Growth of a chip to the next sample [-], shape (point,), see
            `Discs.occupancy`; None for chips of constant thickness.
        slots: Number of slots in use of each family, shape (3,); counted if not given.

    Returns:
        Of every piece, shape (point,).

    Differentiability: continuous; kinks where a point crosses a grid line and where
    another family decides.
    """
    slots = stock.slots_in_use() if slots is None else slots
    near = tuple(_find(stock, f, points, slots[f]) for f in range(3))
    grid = _Grid(stock.origin, stock.spacing, band)
    ends = [n.ends for n in near]
    if track is not None:
        places = lambda near: [n.places for n in near]
        frozen = eqx.tree_at(places, jax.lax.stop_gradient(near), places(near))
        old = [n.ends for n in frozen]
        ends = with_derivative_of(old, _ends_from_poses, cutter, frozen, track)
    ends = Rematerialised.read(ends)
    growth = jnp.zeros_like(points[:, 0]) if growth is None else growth
    shares = _combine(points, _Cells(cells, growth), ends, near, grid)
    return ChipsInStock(shares[:, 0], shares[:, 1])


def _find(
    stock: Stock, family: int, points: Float[Array, "point 3"], slots: Int[Array, ""]
) -> _Near:
    rays = stock.families[family]
    d = stock.spacing
    frozen = jax.lax.stop_gradient(points)
    axes = ((family + 1) % 3, (family + 2) % 3)
    cell = [
        jnp.clip(
            jnp.floor((frozen[:, a] - stock.origin[a]) / d).astype(jnp.int32),
            0,
            rays.ends.shape[i] - 2,
        )
        for i, a in enumerate(axes)
    ]
    row = cell[0][:, None] + jnp.array([[0, 0, 1, 1]], jnp.int32)
    column = cell[1][:, None] + jnp.array([[0, 1, 0, 1]], jnp.int32)
    count = rays.ends.shape[-1]
    ray = (row * rays.ends.shape[1] + column) * (2 * count)
    x = frozen[:, family, None]
    low, high, slot = nearest_interval(rays.ends, ray, x, slots)
    is_upper = high - x < x - low
    at = Rematerialised.read(ray + is_upper.astype(jnp.int32) * count + slot)
    # The values of the search: to read them anew is for derivatives.
    ends = jnp.where(is_upper, high, low)
    ends = Rematerialised.read(with_derivative_of(ends, gather, rays.ends, at))
    lines = [
        stock.origin[a] + d * index.astype(points.dtype)
        for a, index in zip(axes, (row, column), strict=True)
    ]
    # An end moves with its ray, as the stock's origin does.
    placed: list[Array] = [jax.lax.stop_gradient(ends)] * 3
    placed[axes[0]], placed[axes[1]] = lines
    return _Near(
        ends=ends,
        is_upper=Rematerialised.read(is_upper),
        is_empty=Rematerialised.read(high < low),
        pose=Rematerialised.read(gather(rays.poses, at)),
        at=at,
        places=jnp.stack(placed, axis=-1),
    )


def _ends_from_poses(
    cutter: AbstractCutter, near: tuple[_Near, ...], track: PoseTrack
) -> list[Float[Array, "point 4"]]:
    """Ends that move with the poses that cut them, but for a constant [m].

    An end stays on the surface of its pose: level(end; pose) = 0, so it moves by
    -d(level) / n along its ray, n the slope of the level along the ray.
    """
    # One gather for all: its transpose then adds into the table only once.
    every = Rematerialised.read(track.cut_by(jnp.stack([n.pose for n in near], axis=1)))
    ends = []
    for f, n in enumerate(near):
        cut_by = every[:, f]
        tooth = _tooth_of_ends(cutter, n.places, cut_by.frozen())
        level = functools.partial(_level, cutter, pose=cut_by, tooth=tooth)
        along = jnp.zeros_like(n.places).at[..., f].set(1)
        _, slope = jax.jvp(level, (n.places,), (along,))
        slope = jax.lax.stop_gradient(slope)
        away = jnp.where(slope < 0, -_GRAZING, _GRAZING)
        slope = jnp.where(jnp.abs(slope) < _GRAZING, away, slope)
        end = -level(n.places) / slope
        ends.append(jnp.where(n.pose >= 0, end, track.raw_ends(f, n.at, n.pose)))
    return ends


def _level(
    cutter: AbstractCutter,
    places: Float[Array, "point 4 3"],
    pose: Pose,
    tooth: Int[Array, "point 4"] | None,
) -> Float[Array, "point 4"]:
    """Signed distance of places to what an edge of the cutter sweeps [m]."""
    axis = pose.direction()
    if tooth is None:
        return cutter.level(places, pose.tip, axis)
    offset = jnp.take_along_axis(_offsets(cutter, places, pose), tooth[None], axis=0)
    return cutter.level(places, pose.tip, axis, offset[0])


def _offsets(
    cutter: AbstractCutter, places: Float[Array, "point 4 3"], pose: Pose
) -> Float[Array, "tooth point 4"]:
    """Run-out of each tooth at the height of places [m]."""
    height = jnp.sum((places - pose.tip) * pose.direction(), axis=-1)
    offsets = cutter.edge_offsets(height)
    return jnp.broadcast_to(offsets, (offsets.shape[0], *height.shape))


def _tooth_of_ends(
    cutter: AbstractCutter, places: Float[Array, "point 4 3"], cut_by: Pose
) -> Int[Array, "point 4"] | None:
    """Tooth that left each end: its edge comes nearest. None without run-out."""
    if not cutter.has_runout:
        return None
    axis = cut_by.direction()
    normal = cutter.normal(places, cut_by.tip, axis)
    sin_kappa = jnp.sqrt(jnp.maximum(1 - jnp.sum(normal * axis, axis=-1) ** 2, 0))
    off = cutter.level(places, cut_by.tip, axis)
    offsets = _offsets(cutter, places, cut_by)
    return jnp.argmin(jnp.abs(sin_kappa[None] * offsets - off[None]), axis=0)


def _combine(
    points: Float[Array, "point 3"],
    cells: _Cells,
    ends: list[Float[Array, "point 4"]],
    near: tuple[_Near, ...],
    grid: _Grid,
) -> Float[Array, "point 2"]:
    faces = [_face(points, ends[f], near[f], f, grid) for f in range(3)]
    trust = jnp.stack([f.trust for f in faces])
    share = trust / jnp.max(trust, axis=0, keepdims=True)
    doubt = clamp(0.0, (_FULL_TRUST - share) / (_FULL_TRUST - _NO_TRUST), 1.0)
    # Rays that meet nothing, of families that see a face, are in material or in air.
    full = jnp.sum(trust * jnp.stack([f.full for f in faces]), axis=0)
    empty = jnp.sum(trust * jnp.stack([f.empty for f in faces]), axis=0)
    goes_in = full / (full + empty + _HALF_TRUST_SHARE)
    shares = [_shares(face, cells, grid.band) for face in faces]
    touched, filled = (
        _inside(jnp.stack(each), faces, doubt, goes_in)
        for each in zip(*shares, strict=True)
    )
    filled = filled / (touched + _TINY)
    t = clamp(0.0, (filled - _NO_CHIP) / (_CHIP - _NO_CHIP), 1.0)
    return jnp.stack([touched * t**2 * (3 - 2 * t), filled], axis=-1)


def _shares(
    face: _Face, cells: _Cells, band: float | Float[Array, ""]
) -> tuple[Float[Array, " point"], Float[Array, " point"]]:
    """Shares of the pieces and of their chips that lie inside one plane [-]."""
    # Way out of the material along each edge of the cell.
    out = jnp.sum(face.normal[:, None] * cells.edges, axis=-1)
    shortest = _SHORTEST_WAY * band
    along = jnp.maximum(jnp.abs(out[:, 0]), shortest)
    width = jnp.maximum(jnp.abs(out[:, 1]), shortest)
    # From the edge to the inner side of the chip.
    inward = out[:, 2]
    touched = mean_step(face.distance + jnp.maximum(inward, 0), width, along)
    length = jnp.sqrt(along**2 + inward**2)
    middle = face.distance + inward / 2
    moment = hat_moment(middle / width) * out[:, 1] / width
    return touched, mean_step(middle, width, length) - cells.growth * moment


def _inside(
    shares: Float[Array, "3 point"],
    faces: list[_Face],
    doubt: Float[Array, "3 point"],
    goes_in: Float[Array, " point"],
) -> Float[Array, " point"]:
    """Share inside an edge of the surface, from the shares inside each plane [-]."""
    normals = jnp.stack([f.normal for f in faces])
    out = _inside_all(shares + (1 - shares) * doubt, normals)
    # Where the edge goes in, a point outside of all planes is outside.
    into = 1 - _inside_all(1 - shares * (1 - doubt), normals)
    return (1 - goes_in) * out + goes_in * into


def _inside_all(
    shares: Float[Array, "3 point"], normals: Float[Array, "3 point 3"]
) -> Float[Array, " point"]:
    """Share inside all planes [-].

    Planes that are one and the same count once, planes at right angles as a product.
    """
    least = jax.lax.stop_gradient(jnp.argmin(shares, axis=0))[None]
    first = jnp.take_along_axis(normals, least[..., None], axis=0)
    apart = 1 - jnp.sum(normals * first, axis=-1) ** 2
    others = jnp.prod(1 - (1 - shares) * apart, axis=0)
    return jnp.take_along_axis(shares, least, axis=0)[0] * others


def _face(
    points: Float[Array, "point 3"],
    ends: Float[Array, "point 4"],
    near: _Near,
    family: int,
    grid: _Grid,
) -> _Face:
    d, origin = grid.spacing, grid.origin
    reach = REACH * d
    axes = ((family + 1) % 3, (family + 2) % 3)
    x = points[:, family, None]
    s = jnp.where(near.is_upper, ends - x, x - ends)
    s = jnp.where(near.is_empty, -reach, clamp(-reach, s, reach))
    p, q = (
        (at - jax.lax.stop_gradient(jnp.floor(at)))
        for at in ((points[:, a] - origin[a]) / d for a in axes)
    )
    # A ray that meets nothing says nothing of the slope of a face.
    meets = (1 - (s / reach) ** 2) ** 2
    sees = meets + _TINY
    row = jnp.stack([1 - p, 1 - p, p, p], axis=-1)
    column = jnp.stack([1 - q, q, 1 - q, q], axis=-1)
    share = row * column
    weight = share * sees
    total = jnp.sum(weight, axis=-1)
    here = jnp.sum(weight * s, axis=-1) / total
    slopes = [
        _slope(s, meets * other, pairs, d)
        for other, pairs in ((column, _ACROSS_ROWS), (row, _ACROSS_COLUMNS))
    ]
    steepness = 1 + slopes[0] ** 2 + slopes[1] ** 2
    root = jnp.sqrt(steepness)
    is_upper = jnp.sum(jnp.where(near.is_upper, weight, 0), axis=-1) > 0.5 * total
    sign = jnp.where(is_upper, 1.0, -1.0).astype(points.dtype)
    normal: list[Array] = [sign, sign, sign]
    normal[axes[0]], normal[axes[1]] = -slopes[0], -slopes[1]
    is_full = ~near.is_empty & (s >= reach)
    # Head-on, and one ray that meets an end is enough.
    trust = total / (total + _HALF_TRUST_SHARE) / steepness**2
    return _Face(
        distance=here / root,
        normal=jnp.stack(normal, axis=-1) / root[:, None],
        trust=trust,
        full=jnp.sum(jnp.where(is_full, share, 0), axis=-1),
        empty=jnp.sum(jnp.where(s <= -reach, share, 0), axis=-1),
    )


def _slope(
    s: Float[Array, "point 4"],
    weight: Float[Array, "point 4"],
    pairs: Sequence[Sequence[int]],
    d: float,
) -> Float[Array, " point"]:
    """Slope across rays, from those pairs of which both meet an end [-]."""
    up = jnp.zeros_like(s[:, 0])
    total = jnp.full_like(up, _TINY)
    for low, high in pairs:
        pair_weight = weight[:, low] * weight[:, high]
        up = up + pair_weight * (s[:, high] - s[:, low]) / d
        total = total + pair_weight
    return up / total
