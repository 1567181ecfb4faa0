"""The stock: three orthogonal families of rays, each ray a few intervals."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import on_device
from ..._types import RealScalarLike
from .._memory import StockMemory
from .._mesh.mesh import Mesh
from .._pose import gathered_rows

# A point as users pass it.
Point: TypeAlias = (
    Float[Array, " 3"] | Float[np.ndarray, " 3"] | Sequence[RealScalarLike]
)
# Rays without material around the stock, so that distances are known outside it.
MARGIN = 4


class Rays(eqx.Module):
    """One family of parallel rays on a square grid.

    A slot m of ray (u, v) is live where `ends[u, v, 0, m] < ends[u, v, 1, m]`; live
    slots never overlap and are in no particular order.

    Attributes:
        ends: Lower and upper ends along the ray [m], shape (u, v, 2, slot).
        poses: Tick from pose 0 at which each end was cut; negative for the raw stock,
            in a run -1 - m for an end that was in slot m at its start; shape
            (u, v, 2, slot).
        DEAD: Ends of a slot that holds nothing, reversed: far outside any workpiece
            [m].
        TICKS: Number of ticks in a tooth period.
    """

    DEAD: ClassVar[float] = 1e3
    TICKS: ClassVar[int] = 2048

    ends: Float[Array, "u v 2 slot"]
    poses: Int[Array, "u v 2 slot"]

    def lengths(self) -> Float[Array, "u v"]:
        """Length of material along each ray [m], shape (u, v)."""
        return jnp.sum(jnp.maximum(self.ends[:, :, 1] - self.ends[:, :, 0], 0), axis=-1)

    def numbered(self) -> "Rays":
        """Raw rays, whose ends remember the slots that they are in.

        The poses that cut them before a run mean nothing to it.
        """
        slot = jnp.arange(self.ends.shape[-1], dtype=self.poses.dtype)
        return Rays(self.ends, jnp.broadcast_to(-1 - slot, self.poses.shape))

    def places(
        self, u: Int[Array, "*ray"], v: Int[Array, "*ray"]
    ) -> Int[Array, "*ray 2 slot"]:
        """Indices in memory of the ends of some rays, shape (..., 2, slot)."""
        slots = self.ends.shape[-1]
        ray = (u * self.ends.shape[1] + v) * (2 * slots)
        own = jnp.arange(2 * slots, dtype=jnp.int32)
        own = own.reshape((1,) * ray.ndim + (2, slots))
        return ray[..., None, None] + own

    def ends_at(
        self, at: Int[Array, "*end"]
    ) -> tuple[Float[Array, "*end"], Int[Array, "*end"]]:
        """Ends at some indices in memory [m], and the ticks of their cuts.

        **Differentiability**: linear in the ends.
        """
        ends, ticks = self.ends.reshape(-1), self.poses.reshape(-1)
        return gathered_rows(ends, at), gathered_rows(ticks, at)

    def slots_in_use(self) -> Int[Array, ""]:
        """Number of slots that hold an interval on any ray, from the first on, ()."""
        is_live = jnp.any(self.ends[:, :, 1] > self.ends[:, :, 0], axis=(0, 1))
        place = jnp.arange(1, is_live.size + 1, dtype=jnp.int32)
        return jnp.max(jnp.where(is_live, place, 0))


class RayPieces(eqx.Module):
    """Pieces of the rays of one family, ray by ray.

    Attributes:
        ray: Number of the ray of each, in the order of memory, shape (piece,).
        ends: Lower and upper end [m], shape (piece, 2).
        poses: Ticks at which these ends were cut, as of `Rays`, same shape.
    """

    ray: Int[np.ndarray, " piece"]
    ends: Float[np.ndarray, "piece 2"]
    poses: Int[np.ndarray, "piece 2"]

    @classmethod
    def of(cls, rays: Rays) -> "RayPieces":
        """Pieces of a family of rays."""
        ends, poses = (
            np.asarray(x).reshape(-1, 2, x.shape[-1]) for x in (rays.ends, rays.poses)
        )
        ray, slot = np.nonzero(ends[:, 1] > ends[:, 0])
        return cls(ray.astype(np.int32), ends[ray, :, slot], poses[ray, :, slot])

    def __getitem__(
        self, which: Bool[np.ndarray, " piece"] | Int[np.ndarray, " some"]
    ) -> "RayPieces":
        """Return some of the pieces."""
        return jax.tree.map(lambda x: x[which], self)

    def joined(self, other: "RayPieces") -> "RayPieces":
        """These pieces and others of the same rays."""
        both = jax.tree.map(lambda *x: np.concatenate(x), self, other)
        return both[np.argsort(both.ray, kind="stable")]

    def most_on_a_ray(self) -> int:
        """Largest number of pieces of a ray."""
        return int(np.bincount(self.ray).max(initial=0))

    def rays(self, like: Rays, count: int) -> Rays:
        """Rays that hold the pieces in their first slots.

        Args:
            like: Rays on the same grid.
            count: Slots of a ray.
        """
        shape = (*like.ends.shape[:2], 2, count)
        ends = np.empty((shape[0] * shape[1], 2, count), self.ends.dtype)
        ends[:, 0], ends[:, 1] = Rays.DEAD, -Rays.DEAD
        poses = np.full(ends.shape, -1, self.poses.dtype)
        # How many of the pieces before are of the same ray.
        slot = np.arange(self.ray.size) - np.searchsorted(self.ray, self.ray)
        ends[self.ray, :, slot], poses[self.ray, :, slot] = self.ends, self.poses
        return Rays(on_device(ends.reshape(shape)), on_device(poses.reshape(shape)))


class RayEnds(eqx.Module):
    """Ends of the intervals of one family, on the host.

    Attributes:
        points: Points in `work` [m], shape (end, 3).
        signs: Outward direction along the ray, -1 for lower and +1 for upper ends,
            shape (end,).
        poses: Ticks at which a tool pose cut the ends, as in `Rays`, shape (end,).
    """

    points: Float[np.ndarray, "end 3"]
    signs: Float[np.ndarray, " end"]
    poses: Int[np.ndarray, " end"]

    @property
    def is_cut(self) -> Bool[np.ndarray, " end"]:
        """True if a tool pose cut the end; False on raw faces."""
        return self.poses >= 0


class Stock(eqx.Module):
    """A workpiece as a tri-dexel model.

    Family f runs along axis f and is indexed along the axes (f + 1) % 3 and
    (f + 2) % 3; grid line i of axis a is at `origin[a] + i * spacing`, the same for
    all families.

    Attributes:
        families: The rays along x, y and z.
        origin: First grid line of each axis [m], shape (3,).
        spacing: Distance between rays d [m].
        top: Upper face of the raw stock [m].
        volume_weights: Share of each family in the volume; the rays along the tool
            axis see floors head-on, so for a vertical tool they count alone.
    """

    families: tuple[Rays, Rays, Rays]
    origin: Float[Array, " 3"]
    spacing: float = eqx.field(static=True)
    top: float = eqx.field(static=True)
    volume_weights: tuple[float, float, float] = eqx.field(
        static=True, default=(0.0, 0.0, 1.0)
    )

    @functools.partial(jax.jit, inline=True)
    def volumes(self) -> Float[Array, " 3"]:
        """Volume that each family measures [m^3], shape (3,)."""
        totals = [jnp.sum(rays.lengths()) for rays in self.families]
        return jnp.stack(totals) * self.spacing**2

    @functools.partial(jax.jit, inline=True)
    def volume(self) -> Float[Array, ""]:
        """Volume [m^3], the weighted mean of the families, shape ().

        Differentiability: linear in the ends of the rays.
        """
        weights = jnp.asarray(self.volume_weights, self.origin.dtype)
        return jnp.sum(self.volumes() * weights)

    def ray_ends(self, family: int) -> "RayEnds":
        """Ends of all intervals of one family as points, on the host.

        Args:
            family: 0, 1 or 2: the rays along x, y or z.
        """
        ends, origin = np.asarray(self.families[family].ends), np.asarray(self.origin)
        is_live = (ends[:, :, 1] > ends[:, :, 0])[:, :, None]
        is_live = np.broadcast_to(is_live, ends.shape)
        u, v, side, _ = np.nonzero(is_live)
        points = np.empty((u.size, 3))
        points[:, family] = ends[is_live]
        for axis, index in (((family + 1) % 3, u), ((family + 2) % 3, v)):
            points[:, axis] = origin[axis] + index * self.spacing
        poses = np.asarray(self.families[family].poses)[is_live]
        return RayEnds(points, np.where(side == 0, -1.0, 1.0), poses)

    def as_raw(self) -> "Stock":
        """Machined stock as raw stock for another path.

        Returns:
            The same material. The ends forget the poses that cut them, which mean
            nothing to another path, and the top is the highest material that is left.

        Raises:
            ValueError: The stock has no material.
        """
        # Rays along z alone would miss a wall that stands between them.
        z_lines = np.asarray(self.origin)[2] + self.spacing * np.arange(
            self.families[0].ends.shape[1]
        )
        ends = [np.asarray(rays.ends) for rays in self.families]
        is_live = [e[:, :, 1] > e[:, :, 0] for e in ends]
        heights = (
            np.broadcast_to(z_lines[None, :, None], is_live[0].shape)[is_live[0]],
            np.broadcast_to(z_lines[:, None, None], is_live[1].shape)[is_live[1]],
            ends[2][:, :, 1][is_live[2]],
        )
        top = max(float(np.max(h, initial=-np.inf)) for h in heights)
        if not math.isfinite(top):
            raise ValueError("A raw stock must hold material, but this one is empty.")
        x, y, z = (Rays(r.ends, jnp.full_like(r.poses, -1)) for r in self.families)
        return dataclasses.replace(self, families=(x, y, z), top=top)

    def with_interval_counts(self, interval_counts: Sequence[int]) -> "Stock":
        """Same material in rays with another number of slots.

        Args:
            interval_counts: Slots for intervals of a ray along x, y and z.

        Raises:
            ValueError: The slots are not three numbers from 1, or too few for the
                intervals that there are.
        """
        check_interval_counts(interval_counts)
        pieces = StockPieces.of(self)
        needed = pieces.most_on_a_ray()
        if any(n > count for n, count in zip(needed, interval_counts, strict=True)):
            raise ValueError(
                f"Argument `interval_counts` is {interval_counts}, but rays of the "
                f"stock have up to {needed} intervals along x, y and z."
            )
        return pieces.stock(self, interval_counts)

    @staticmethod
    def memory_of_block(
        extent: Float[np.ndarray, " 3"],
        spacing: float,
        interval_counts: Sequence[int],
        item_size: int,
    ) -> StockMemory:
        """Memory of the stock of a block, before it is made.

        Args:
            extent: Edges of the block [m], shape (3,).
            spacing: Distance between rays [m].
            interval_counts: Slots for intervals of a ray along x, y and z.
            item_size: Size of a floating-point number [byte].
        """
        # In floating point: a tiny spacing would overflow whole numbers.
        counts = np.maximum(np.round(extent / spacing), 1) + 2 * MARGIN
        return StockMemory.of_grid(counts.tolist(), interval_counts, item_size)

    def memory_with(self, interval_counts: Sequence[int]) -> StockMemory:
        """Memory of the stock with other slots of a ray along x, y and z."""
        item_size = self.origin.dtype.itemsize
        return StockMemory.of_grid(self.grid_shape, interval_counts, item_size)

    def slots_in_use(self) -> Int[Array, " 3"]:
        """Number of slots in use of each family, from the first on, shape (3,)."""
        return jnp.stack([rays.slots_in_use() for rays in self.families])

    @property
    def grid_shape(self) -> tuple[int, int, int]:
        """Number of grid lines along x, y and z."""
        count_y, count_z = self.families[0].ends.shape[:2]
        return self.families[1].ends.shape[1], count_y, count_z

    @property
    def interval_counts(self) -> tuple[int, int, int]:
        """Number of slots of a ray along x, y and z."""
        x, y, z = (rays.ends.shape[-1] for rays in self.families)
        return x, y, z

    def to_mesh(self) -> Mesh:
        """Surface as a closed mesh, on the host.

        Returns:
            Triangles [m], sharp edges kept. Walls and gaps thinner than the spacing
            may be lost.

        Raises:
            ValueError: The stock has no material, or the grid is too large for the
                memory.
        """
        from .._mesh.dual_contour import surface_mesh

        return surface_mesh(self)

    def astype(self, dtype: jnp.dtype) -> "Stock":
        """Stock with all lengths in another floating type."""
        return jax.tree.map(
            lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x,
            self,
        )


class StockPieces(eqx.Module):
    """Pieces of all rays of a stock.

    Attributes:
        families: Those of the rays along x, y and z.
    """

    families: tuple[RayPieces, RayPieces, RayPieces]

    @classmethod
    def of(cls, stock: Stock) -> "StockPieces":
        """Pieces of a stock."""
        x, y, z = (RayPieces.of(rays) for rays in stock.families)
        return cls((x, y, z))

    @classmethod
    def none(cls, like: Stock) -> "StockPieces":
        """No pieces, of a stock on this grid."""
        end, tick = np.asarray(like.origin).dtype, np.int32
        one = RayPieces(
            np.zeros(0, tick), np.zeros((0, 2), end), np.zeros((0, 2), tick)
        )
        return cls((one, one, one))

    def parted(
        self,
        stock: Stock,
        lower: Float[np.ndarray, " 3"],
        upper: Float[np.ndarray, " 3"],
    ) -> tuple["StockPieces", "StockPieces"]:
        """Pieces that reach into a box, whole, and those that do not.

        Args:
            stock: A stock on the same grid.
            lower: Least x, y, z of the box [m], shape (3,).
            upper: Greatest x, y, z of the box [m], shape (3,).
        """
        origin, near, far = np.asarray(stock.origin), [], []
        for f, pieces in enumerate(self.families):
            b, c = (f + 1) % 3, (f + 2) % 3
            is_near = (pieces.ends[:, 0] <= upper[f]) & (pieces.ends[:, 1] >= lower[f])
            indices = np.divmod(pieces.ray, stock.grid_shape[c])
            for axis, index in zip((b, c), indices, strict=True):
                place = origin[axis] + stock.spacing * index
                is_near &= (lower[axis] <= place) & (place <= upper[axis])
            near.append(pieces[is_near])
            far.append(pieces[~is_near])
        return StockPieces(tuple(near)), StockPieces(tuple(far))

    def joined(self, other: "StockPieces") -> "StockPieces":
        """These pieces and others of the same rays."""
        pairs = zip(self.families, other.families, strict=True)
        x, y, z = (own.joined(more) for own, more in pairs)
        return StockPieces((x, y, z))

    def most_on_a_ray(self) -> tuple[int, int, int]:
        """Largest numbers of pieces of a ray along x, y and z."""
        x, y, z = (pieces.most_on_a_ray() for pieces in self.families)
        return x, y, z

    def stock(self, like: Stock, interval_counts: Sequence[int]) -> Stock:
        """Stock of the pieces.

        Args:
            like: A stock on the same grid.
            interval_counts: Slots of a ray along x, y and z, at least
                `most_on_a_ray`.
        """
        rays = zip(self.families, like.families, interval_counts, strict=True)
        x, y, z = (own.rays(other, count) for own, other, count in rays)
        return dataclasses.replace(like, families=(x, y, z))


def box(
    lower: Point,
    upper: Point,
    spacing: float,
    *,
    interval_counts: Sequence[int] = (8, 8, 1),
    dtype: type | jnp.dtype | None = None,
) -> Stock:
    """Block as stock.

    Args:
        lower: Least x, y, z [m], shape (3,).
        upper: Greatest x, y, z [m], shape (3,).
        spacing: Distance between rays [m].
        interval_counts: Slots for intervals of a ray along x, y and z; a cutter with
            its axis along z never splits a ray along z.
        dtype: Floating type; JAX's default if not given.

    Returns:
        The stock; rays stand in the middle of cells of side `spacing`.

    Raises:
        ValueError: The box is empty, not finite, or the spacing not positive, or the
            slots are not three numbers from 1.
    """
    low, high = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    if not (math.isfinite(spacing) and spacing > 0):
        raise ValueError(
            f"Argument `spacing` must be finite and positive, but is {spacing}."
        )
    if low.shape != (3,) or high.shape != (3,):
        raise ValueError("Arguments `lower` and `upper` must have three numbers each.")
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (high > low).all()):
        raise ValueError(
            f"Argument `upper` must be greater than `lower` on every axis, but they "
            f"are {high.tolist()} and {low.tolist()}."
        )
    check_interval_counts(interval_counts)
    origin, counts = block_grid(low, high, spacing)
    cells = counts - 2 * MARGIN
    lines = [origin[a] + spacing * np.arange(counts[a]) for a in range(3)]
    inside = [
        (np.arange(counts[a]) >= MARGIN) & (np.arange(counts[a]) < MARGIN + cells[a])
        for a in range(3)
    ]
    dtype = jnp.result_type(float) if dtype is None else jnp.dtype(dtype)
    families = []
    for f in range(3):
        b, c = (f + 1) % 3, (f + 2) % 3
        shape = (len(lines[b]), len(lines[c]), 2, interval_counts[f])
        ends = np.empty(shape)
        ends[:, :, 0], ends[:, :, 1] = Rays.DEAD, -Rays.DEAD
        filled = inside[b][:, None] & inside[c][None, :]
        ends[filled, 0, 0], ends[filled, 1, 0] = low[f], high[f]
        raw = np.full(shape, -1, np.int32)
        families.append(Rays(on_device(ends.astype(dtype)), on_device(raw)))
    return Stock(
        families=(families[0], families[1], families[2]),
        origin=on_device(origin.astype(dtype)),
        spacing=float(spacing),
        top=float(high[2]),
    )


def check_interval_counts(interval_counts: Sequence[int]) -> None:
    """Raise a `ValueError` if these are no slots of rays along x, y and z."""
    if len(interval_counts) != 3 or min(interval_counts) < 1:
        raise ValueError(
            "Argument `interval_counts` must be three numbers of slots from 1, for x, "
            f"y and z, but is {interval_counts}."
        )


def block_grid(
    lower: Float[np.ndarray, " 3"], upper: Float[np.ndarray, " 3"], spacing: float
) -> tuple[Float[np.ndarray, " 3"], Int[np.ndarray, " 3"]]:
    """Grid of rays for a block, its margin included, on the host.

    Args:
        lower: Least x, y, z [m], shape (3,).
        upper: Greatest x, y, z [m], shape (3,).
        spacing: Distance between rays [m].

    Returns:
        First grid line of each axis [m] and number of grid lines, each of shape (3,). A
        size that is no multiple of the spacing is shared out to both sides.
    """
    cells = np.maximum(np.round((upper - lower) / spacing), 1).astype(int)
    first = (lower + upper) / 2 - (cells - 1) / 2 * spacing
    return first - MARGIN * spacing, cells + 2 * MARGIN
