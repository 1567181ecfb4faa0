"""Slopes of the force in one period, from where the tool has been.

A quick look for chatter replays no removal: a point of an edge is in the material if it
lies in the raw stock and in no earlier pose of the tool, and its distance from the last
one is the chip. Rubbing edges are left out, and so is run-out.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import on_device
from ...cutter import AbstractCutter, EdgeElements
from ...numerics import CachedJit
from ...process import EdgeElementsInSpace, Process
from ...workpiece import Pose, Stock
from .monodromy import Regeneration

# Pieces of a tooth period, and earlier poses that are looked at in one go.
_PIECES, _CHUNK = 48, 64
# Parts of a disc, for a quick look and where the depth of the cut counts.
_PARTS, _LAYERS = 8, 40
# Older poses stand apart by this share of the radius.
_APART = 0.03


class LayerSlopes(NamedTuple):
    """Slopes of the force of each tooth by heights on its edge, over a turn.

    Attributes:
        slopes: In the tip now, of each layer [N/m], shape (piece, tooth, layer, 3, 3);
            in the tip when the tooth before passed they are the opposite.
        height: Of the layers above the tip, ascending [m], shape (layer,).
        lag: Angle by which the helix holds each back [rad], shape (layer,).
    """

    slopes: Float[np.ndarray, "piece tooth layer 3 3"]
    height: Float[np.ndarray, " layer"]
    lag: Float[np.ndarray, " layer"]


def quick_slopes(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"]
) -> list[list[Regeneration]]:
    """Return roughly the slopes of the force in the periods before some rows.

    Args:
        process: The process.
        path: Poses at the tooth instants, shape (step, 3).
        rows: The rows, from 1.

    Returns:
        The slopes in the tips now and when the tooth before passed, of the periods
        that repeat themselves, for each row.

    Differentiability: none, a host function.
    """
    found, delays, periods = [], np.ones(1), process.repeats_after
    if not process.cutter.has_even_pitch:
        delays = np.asarray(process.cutter.delays(np.float64))[0]
    for near in _near(process, path, rows):
        slopes = np.asarray(_slopes(process, near, periods), np.float64)
        slopes = slopes.reshape(periods, _PIECES, *slopes.shape[1:])
        if process.cutter.has_even_pitch:
            slopes = slopes.sum(axis=2, keepdims=True)
        found.append([Regeneration(x.sum(axis=1), -x, delays) for x in slopes])
    return found


def layer_slopes(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"], pieces: int
) -> list[LayerSlopes]:
    """Return the slopes of the force by layers of the edge, about some rows.

    Args:
        process: The process.
        path: Poses at the tooth instants, shape (step, 3).
        rows: The rows, from 1.
        pieces: Of a tooth period, in whose middles slopes are taken.

    Returns:
        The slopes over a turn, for each row.

    Differentiability: none, a host function.
    """
    edge = _edge(process, np.dtype(process.stock.origin.dtype), _LAYERS)
    height, lag = (np.asarray(x, np.float64) for x in (edge.height, edge.lag))
    return [
        LayerSlopes(np.asarray(_layers(process, near, pieces), np.float64), height, lag)
        for near in _near(process, path, rows)
    ]


class _Near(eqx.Module):
    """A pose of a path, and those before it that it may touch.

    Attributes:
        now: The pose.
        earlier: Poses before it, the newest first, shape (chunk, pose, 3).
        count: Chunks that are looked at, shape ().
    """

    now: Pose
    earlier: Pose
    count: Int[Array, ""]


def _near(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"]
) -> Iterator[_Near]:
    """Poses of some rows with those before them, all of one shape."""
    # Rows that are taken on the host compile nothing.
    path = jax.tree.map(np.asarray, path)
    tips = np.asarray(path.tip)
    near = [_near_rows(process, tips[: row + 1]) for row in rows]
    chunks = 2 ** math.ceil(math.log2(max(map(len, near)) / _CHUNK + 1))
    for row, kept in zip(rows, near, strict=True):
        at = kept[np.minimum(np.arange(chunks * _CHUNK), len(kept) - 1)]
        # What only fills the shape is not looked at.
        count = on_device(np.asarray(math.ceil(len(kept) / _CHUNK), np.int32))
        yield _Near(path[int(row)], path[at.reshape(chunks, _CHUNK)], count)


def _near_rows(
    process: Process, tips: Float[np.ndarray, "step 3"]
) -> Int[np.ndarray, " near"]:
    """Return rows before the last one whose pose it may touch, the newest first."""
    R, now, discs = process.cutter.nominal_radius, tips[-1], process.engagement.discs
    way = np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))
    # The last row of every piece of the way, so that the newest is among them.
    is_kept = np.append(np.diff(np.floor(way / (_APART * R))) > 0, True)
    reach = 2 * R + discs.count * discs.height
    is_near = np.linalg.norm(tips[:-1] - now, axis=1) < reach
    is_near[-1] = True
    return np.flatnonzero(is_kept & is_near)[::-1]


@CachedJit
def _slopes(
    process: Process, near: _Near, periods: int
) -> Float[Array, "piece tooth 3 3"]:
    """Return the slopes of each tooth's force in the tip, in `work` [N/m]."""
    push, normal = _pushes(process, near, periods, _PIECES, _PARTS)
    return jnp.einsum("pjea,pjeb->pjab", push, normal)


@CachedJit
def _layers(
    process: Process, near: _Near, pieces: int
) -> Float[Array, "piece tooth element 3 3"]:
    """Return the same by elements of the edge, over a turn."""
    push, normal = _pushes(process, near, process.cutter.flute_count, pieces, _LAYERS)
    return jnp.einsum("pjea,pjeb->pjeab", push, normal)


def _pushes(
    process: Process, near: _Near, periods: int, pieces: int, parts: int
) -> tuple[
    Float[Array, "piece tooth element 3"], Float[Array, "piece tooth element 3"]
]:
    """Slopes of the forces of elements in their chip [N/m], and their normals.

    Args:
        process: The process.
        near: The pose and those before it.
        periods: Tooth periods.
        pieces: Of each.
        parts: Of a disc.
    """
    cutter, now = process.cutter, near.now
    edge = _edge(process, now.tip.dtype, parts)
    places = jnp.asarray(cutter.pitch_angles, now.tip.dtype)
    teeth = places.shape[0]
    middles = jnp.arange(periods * pieces, dtype=places.dtype) + 0.5
    turn = 2 * math.pi / teeth / pieces * middles[:, None, None]
    phi = turn + places[None, :, None] - edge.lag[None, None]
    frame = Pose.frame(now.direction())
    e = jnp.stack([jnp.sin(phi), jnp.cos(phi), jnp.zeros_like(phi)], -1) @ frame.T
    t = jnp.stack([jnp.cos(phi), -jnp.sin(phi), jnp.zeros_like(phi)], -1) @ frame.T
    a = jnp.broadcast_to(frame[:, 2].reshape(1, 1, 1, 3), e.shape)
    column = lambda x: x[None, None, :, None]
    normal = column(edge.sin_kappa) * e - column(edge.cos_kappa) * a
    tip = now.tip.reshape(1, 1, 1, 3)
    points = tip + column(edge.radius) * e + column(edge.height) * a
    chip, clearance = _chip_and_clearance(cutter, points, near.earlier, near.count)
    h = jnp.clip(chip, 0, cutter.nominal_radius)
    tooth = jnp.broadcast_to(
        jnp.arange(teeth, dtype=jnp.int32)[None, :, None], phi.shape
    )
    # Edges touch wherever there is a chip, and their force does not change with it.
    force = lambda h: process.side_law.force_per_width(h, jnp.ones_like(h), tooth)
    _, (F_t, F_r, F_a) = jax.jvp(force, (h,), (jnp.ones_like(h),))
    cuts = (clearance > 0) & _is_inside(process.stock, points)
    width = jnp.where(cuts, edge.width[None, None], 0)
    third = jnp.cross(t, normal)
    along = zip((-F_t, -F_r, F_a), (t, normal, third), strict=True)
    push = jnp.zeros_like(normal)
    for F, way in along:
        push = push + (width * F)[..., None] * way
    return push, normal


def _edge(process: Process, dtype: jnp.dtype, parts: int) -> EdgeElements:
    """Return the edge elements of a tooth; those on a flat end cut no chip here.

    Args:
        process: The process.
        dtype: Type of the numbers.
        parts: Of a disc, in whose middles slopes are taken.
    """
    cutter, engagement = process.cutter, process.engagement
    if isinstance(engagement, EdgeElementsInSpace):
        return engagement.profile.elements(cutter, dtype)
    # A share of a disc in the material is a number of its parts.
    discs = engagement.discs
    return cutter.elements(0, 0, parts * discs.count, discs.height / parts, dtype)


def _chip_and_clearance(
    cutter: AbstractCutter,
    points: Float[Array, "piece tooth element 3"],
    earlier: Pose,
    count: Int[Array, ""],
) -> tuple[Float[Array, "piece tooth element"], Float[Array, "piece tooth element"]]:
    """Return the distance from the newest pose, and the least one from all [m]."""
    places = points.reshape(-1, 3)
    level = jax.vmap(lambda tip, axis: cutter.level(places, tip[None], axis[None]))
    axes = earlier.direction()

    def step(chunk: Array, least: Array) -> Array:
        return jnp.minimum(
            least, jnp.min(level(earlier.tip[chunk], axes[chunk]), axis=0)
        )

    chip = cutter.level(places, earlier.tip[0, :1], axes[0, :1])
    clearance = jax.lax.fori_loop(0, count, step, chip)
    shape = points.shape[:-1]
    return chip.reshape(shape), clearance.reshape(shape)


def _is_inside(stock: Stock, points: Float[Array, "*point 3"]) -> Bool[Array, "*point"]:
    """True where the nearest ray along z holds material at the points."""
    ends = stock.families[2].ends
    origin = stock.origin.reshape(1, 1, 1, 3)
    place = jnp.round((points - origin) / stock.spacing).astype(jnp.int32)
    x, y = (jnp.clip(place[..., a], 0, ends.shape[a] - 1) for a in range(2))
    lower, upper = ends[x, y, 0], ends[x, y, 1]
    z = points[..., 2:]
    return jnp.any((lower < z) & (z < upper), axis=-1)
