"""Subtracting a tool from the intervals of rays, in windows of fixed size.

A window is sliced from the stock, trimmed, and written back at the same place; XLA
does this in place as long as nothing else reads the old arrays in the same step, so
a step removes first and looks at the stock afterwards.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..cutter import AbstractCutter
from ._stock import DEAD, Rays, Stock, grid_shape

# Pieces of a ray shorter than this are dropped and counted as removed [m].
SHORTEST = 1e-9


def subtract(
    ends: Float[Array, "*ray 2 slot"],
    poses: Int[Array, "*ray 2 slot"],
    cut: tuple[Float[Array, "*ray"], Float[Array, "*ray"], Bool[Array, "*ray"]],
    pose: Int[Array, ""],
) -> tuple[Float[Array, "*ray 2 slot"], Int[Array, "*ray 2 slot"], Bool[Array, "*ray"]]:
    """Remove one interval from each ray.

    Args:
        ends: Lower and upper ends [m], shape (..., 2, slot).
        poses: Poses that cut these ends, shape (..., 2, slot).
        cut: Start and end of the interval to remove [m] and whether there is one,
            each of shape (...).
        pose: Index of the pose that cuts, shape ().

    Returns:
        New ends, new poses, and whether a piece found no free slot, shape (...).

    Differentiability: smooth in ends and cut wherever the order of the ends does not
    change.
    """
    low, high = ends[..., 0, :], ends[..., 1, :]
    start, stop, is_cut = (x[..., None] for x in cut)
    is_live = high > low
    is_met = is_cut & is_live & (start < high) & (stop > low)
    keeps_low = is_met & (low < start - SHORTEST)
    keeps_high = is_met & (high > stop + SHORTEST)
    is_gone = is_met & ~keeps_low & ~keeps_high
    new_low = jnp.where(is_gone, DEAD, jnp.where(is_met & ~keeps_low, stop, low))
    new_high = jnp.where(is_gone, -DEAD, jnp.where(keeps_low, start, high))
    low_pose = jnp.where(is_met & ~keeps_low, pose, poses[..., 0, :])
    high_pose = jnp.where(keeps_low, pose, poses[..., 1, :])
    is_split = keeps_low & keeps_high

    def split() -> tuple[Array, Array, Array]:
        # The interval to remove lies inside at most one piece: one slot is enough.
        needs = jnp.any(is_split, axis=-1, keepdims=True)
        free = jnp.argmin(is_live, axis=-1)[..., None]
        slots = jnp.arange(low.shape[-1]).reshape((1,) * (low.ndim - 1) + (-1,))
        takes = needs & ~is_live & (slots == free)
        rest = jnp.max(jnp.where(is_split, high, -DEAD), axis=-1, keepdims=True)
        rest_pose = jnp.where(is_split, poses[..., 1, :], -1)
        rest_pose = jnp.max(rest_pose, axis=-1, keepdims=True)
        return (
            _two(jnp.where(takes, stop, new_low), jnp.where(takes, rest, new_high)),
            _two(
                jnp.where(takes, pose, low_pose), jnp.where(takes, rest_pose, high_pose)
            ),
            needs[..., 0] & jnp.all(is_live, axis=-1),
        )

    def keep() -> tuple[Array, Array, Array]:
        is_full = jnp.zeros(low.shape[:-1], bool)
        return _two(new_low, new_high), _two(low_pose, high_pose), is_full

    # Pieces to split are rare along the axis and the search for slots is dear.
    return jax.lax.cond(jnp.any(is_split), split, keep)


def _two(low: Float[Array, "*n"] | Int[Array, "*n"], high: Array) -> Array:
    return jnp.stack([low, high], axis=-2)


class RemovalWindow(eqx.Module):
    """How many rays a removal reads and writes (static).

    Attributes:
        across: Grid lines along x and along y.
        height: Grid lines along z, from below the tip upward.
        slack: How far the second pose may stand from the first [m].
    """

    across: tuple[int, int] = eqx.field(static=True)
    height: int = eqx.field(static=True)
    slack: float = eqx.field(static=True)


def removal_window(
    stock: Stock, cutter: AbstractCutter, axial_depth: float, reach: float
) -> RemovalWindow:
    """Return the window for a cutter.

    Args:
        stock: The workpiece.
        cutter: The cutter.
        axial_depth: Deepest immersion of the tip below the top of the stock [m].
        reach: Distance between two poses that one window should hold [m].

    Returns:
        The window; never larger than the grid.
    """
    nx, ny, nz = grid_shape(stock)
    d = stock.spacing
    slack = min(reach, cutter.nominal_radius)
    across = int((2 * cutter.nominal_radius + 2 * slack) / d) + 4
    # From the row below the tip to the row above the top.
    height = int(axial_depth / d) + 3
    return RemovalWindow((min(across, nx), min(across, ny)), min(height, nz), slack)


def remove_poses(
    stock: Stock,
    cutter: AbstractCutter,
    window: RemovalWindow,
    tips: Float[Array, "pose 3"],
    poses: Int[Array, " pose"],
    is_due: Bool[Array, " pose"],
) -> tuple[Stock, Float[Array, " pose"], Bool[Array, ""], Bool[Array, ""]]:
    """Subtract the cutter at a few close poses from the stock.

    Args:
        stock: The workpiece.
        cutter: The cutter, axis along +z.
        window: Size of the window; it stands around the first tip.
        tips: Tool tips in `work` [m], shape (pose, 3).
        poses: Index of each pose, kept with the ends that it cuts, shape (pose,).
        is_due: Which of the poses to subtract, shape (pose,).

    Returns:
        The stock; the volume that each pose removed [m^3], shape (pose,); whether a
        ray ran out of slots; whether a tool reached beyond the window.

    Differentiability: in the ends of the stock, through the tips.
    """
    origin, d = stock.origin, stock.spacing
    dtype = origin.dtype
    nx, ny, nz = grid_shape(stock)
    sizes = (window.across[0], window.across[1], window.height)
    center = jax.lax.stop_gradient(tips[0])
    grid = jnp.floor((center - origin) / d).astype(jnp.int32)
    starts = [
        jnp.clip(grid[0] - sizes[0] // 2 + 1, 0, nx - sizes[0]),
        jnp.clip(grid[1] - sizes[1] // 2 + 1, 0, ny - sizes[1]),
        jnp.clip(grid[2] - 1, 0, nz - sizes[2]),
    ]
    lines = [
        origin[a]
        + d * (starts[a] + jnp.arange(sizes[a], dtype=jnp.int32)).astype(dtype)
        for a in range(3)
    ]
    # Material above the window under the tool would stay uncut.
    is_beyond = (starts[2] + sizes[2] < nz) & (lines[2][-1] < stock.top)
    has_overflow = jnp.zeros((), bool)
    volumes = jnp.zeros(tips.shape[0], dtype)
    has_cut = jnp.zeros((), bool)
    families = []
    for f in (0, 1, 2):
        new, volume, full = _remove_family(
            stock.families[f], cutter, f, starts, lines, tips, poses, is_due
        )
        has_overflow = has_overflow | full
        has_cut = has_cut | jnp.any(volume > 0)
        if stock.volume_weights[f]:
            volumes = volumes + volume * stock.volume_weights[f] * d**2
        families.append(new)
    new_stock = eqx.tree_at(lambda s: s.families, stock, tuple(families))
    return new_stock, volumes, has_overflow, is_beyond & has_cut


def _remove_family(
    rays: Rays,
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    starts: list[Int[Array, ""]],
    lines: list[Float[Array, " _"]],
    tips: Float[Array, "pose 3"],
    poses: Int[Array, " pose"],
    is_due: Bool[Array, " pose"],
) -> tuple[Rays, Float[Array, " pose"], Bool[Array, ""]]:
    axis_b, axis_c = (family + 1) % 3, (family + 2) % 3
    slot_count = rays.ends.shape[-1]
    shape = (lines[axis_b].shape[0], lines[axis_c].shape[0], 2, slot_count)
    zero = jnp.zeros((), jnp.int32)
    at = (starts[axis_b], starts[axis_c], zero, zero)
    ends = jax.lax.dynamic_slice(rays.ends, at, shape)
    cut_by = jax.lax.dynamic_slice(rays.poses, at, shape)
    b = jnp.broadcast_to(lines[axis_b][:, None], shape[:2])
    c = jnp.broadcast_to(lines[axis_c][None, :], shape[:2])
    removed, has_overflow = [], jnp.zeros((), bool)
    for i in range(tips.shape[0]):

        def cut(
            ends: Array, cut_by: Array, tip: Array = tips[i], pose: Array = poses[i]
        ) -> tuple[Array, Array, Array, Array]:
            start, stop, is_hit = cutter.intersect(family, b, c, tip)
            new, by, full = subtract(ends, cut_by, (start, stop, is_hit), pose)
            return new, by, jnp.any(full), _total_length(ends) - _total_length(new)

        def skip(ends: Array, cut_by: Array) -> tuple[Array, Array, Array, Array]:
            return ends, cut_by, jnp.zeros((), bool), jnp.zeros((), ends.dtype)

        ends, cut_by, full, length = jax.lax.cond(is_due[i], cut, skip, ends, cut_by)
        has_overflow = has_overflow | full
        removed.append(length)
    volume = jnp.stack(removed)
    new = Rays(
        jax.lax.dynamic_update_slice(rays.ends, ends, at),
        jax.lax.dynamic_update_slice(rays.poses, cut_by, at),
    )
    return new, volume, has_overflow


def _total_length(ends: Float[Array, "u v 2 slot"]) -> Float[Array, ""]:
    return jnp.sum(jnp.maximum(ends[:, :, 1] - ends[:, :, 0], 0))
