"""Contact of a tool with the stock as it is when the tool gets there.

The rays along z alone carry the stock through the poses, in order: at each the tool
is looked for in them, then cuts, then its holder is looked for. Nothing here is
differentiated, so no other family and no record of the poses is kept.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import on_device
from ...numerics import CachedJit
from ...workpiece import CutInterval, Pose, Rays, Stock
from .contact_depth import ContactTest, holder_depth, tool_depth

# Poses that one call of the compiled loop takes.
_CHUNK = 512
# Windows come in multiples of this many rays, so that few are compiled.
_BLOCK = 8


class Columns(eqx.Module):
    """The rays along z of a stock.

    Attributes:
        ends: Lower and upper ends [m], shape (x, y, 2, slot).
        origin: Where the first ray stands in x and y [m], shape (2,).
        spacing: Distance between rays [m].
    """

    ends: Float[Array, "x y 2 slot"]
    origin: Float[np.ndarray, " 2"]
    spacing: float = eqx.field(static=True)

    def bounds(self) -> "Box":
        """Return the least and greatest x, y, z of the material [m].

        Both are far away, and reversed, if there is none.
        """
        ends = np.asarray(self.ends)
        is_live = ends[:, :, 1] > ends[:, :, 0]
        if not is_live.any():
            return Box(np.full(3, Rays.DEAD), np.full(3, -Rays.DEAD))
        columns = np.argwhere(is_live.any(axis=-1))
        half = self.spacing / 2
        low = self.origin + self.spacing * columns.min(axis=0) - half
        high = self.origin + self.spacing * columns.max(axis=0) + half
        floor = np.where(is_live, ends[:, :, 0], np.inf).min()
        top = np.where(is_live, ends[:, :, 1], -np.inf).max()
        return Box(np.array([*low, floor]), np.array([*high, top]))


class Box(NamedTuple):
    """Least and greatest x, y, z, of one block or of one at each pose [m]."""

    low: Float[np.ndarray, "... 3"]
    high: Float[np.ndarray, "... 3"]


class Window(eqx.Module):
    """Rays around a solid at each pose.

    Attributes:
        first: First ray in x and y, shape (sample, 2).
        size: How many rays in x and y, the same for all poses.
    """

    first: Int[np.ndarray, "sample 2"]
    size: tuple[int, int] = eqx.field(static=True)


class Samples(eqx.Module):
    """Poses in order, and what to do at each.

    Attributes:
        tip: Tool tips [m], shape (sample, 3).
        axis: Tool axes, shape (sample, 3).
        is_cut: Whether the cutter removes there, shape (sample,).
        is_tool: Whether the cutter is looked for, shape (sample,).
        is_holder: Whether the holder is looked for, shape (sample,).
        tool: Rays around the cutter.
        holder: Rays around the holder.
    """

    tip: Float[np.ndarray, "sample 3"]
    axis: Float[np.ndarray, "sample 3"]
    is_cut: Bool[np.ndarray, " sample"]
    is_tool: Bool[np.ndarray, " sample"]
    is_holder: Bool[np.ndarray, " sample"]
    tool: Window
    holder: Window

    def __getitem__(self, item) -> "Samples":
        """Return some of the samples."""
        return jax.tree.map(lambda x: x[item], self)


def columns_of(stock: Stock, finest: float, slot_count: int) -> Columns:
    """Return the rays along z of a stock, on the host.

    Args:
        stock: The stock.
        finest: Rays closer than this are thinned out to about it [m].
        slot_count: Slots for intervals of a ray; the stock's if it has more.

    Returns:
        The rays.
    """
    stride = max(1, int(finest / stock.spacing + 1e-6))
    ends = np.asarray(stock.families[2].ends)[::stride, ::stride]
    more = max(0, slot_count - ends.shape[-1])
    dead = np.array([Rays.DEAD, -Rays.DEAD], ends.dtype)[None, None, :, None]
    dead = np.broadcast_to(dead, (*ends.shape[:3], more))
    return Columns(
        on_device(np.concatenate([ends, dead], axis=-1)),
        np.asarray(stock.origin, float)[:2],
        stride * stock.spacing,
    )


def window_of(
    columns: Columns, box: Box, is_used: Bool[np.ndarray, " sample"]
) -> Window:
    """Return the rays around boxes.

    Args:
        columns: The stock.
        box: Least and greatest x, y, z at each pose [m].
        is_used: The poses that count for the size, shape (sample,).

    Returns:
        The window; never larger than the grid.
    """
    shape = np.array(columns.ends.shape[:2])
    low, high = (
        np.clip((side[:, :2] - columns.origin) / columns.spacing, -1, shape)
        for side in box
    )
    first = np.clip(np.floor(low), 0, shape - 1).astype(np.int32)
    last = np.clip(np.ceil(high), 0, shape - 1).astype(np.int32)
    most = np.where(is_used[:, None], last - first + 1, 1).max(axis=0, initial=1)
    size = np.minimum(-(-most // _BLOCK) * _BLOCK, shape)
    start = np.minimum(first, shape - size).astype(np.int32)
    return Window(start, (int(size[0]), int(size[1])))


class Swept(NamedTuple):
    """Sweep of a tool along poses: stock that is left, depths, flags.

    Attributes:
        columns: The stock after the last pose.
        tool: How deep the tool is in material where it is looked for [m].
        holder: How deep the holder is [m], likewise.
        has_overflow: Whether a ray ran out of slots.
    """

    columns: Columns
    tool: Float[np.ndarray, " sample"]
    holder: Float[np.ndarray, " sample"]
    has_overflow: bool


def sweep(columns: Columns, test: ContactTest, samples: Samples) -> Swept:
    """Take a tool through poses, in order.

    Args:
        columns: The stock before the first pose.
        test: What removes and what is looked for.
        samples: The poses.

    Differentiability: not applicable, a host function.
    """
    count = len(samples.tip)
    depths = np.zeros((2, count))
    has_overflow = False
    ends, dtype = columns.ends, columns.ends.dtype
    origin = jnp.asarray(columns.origin, dtype)

    def padded(x: np.ndarray) -> Array:
        # A short chunk is filled with poses that do nothing.
        rest = np.zeros((_CHUNK - len(x), *x.shape[1:]), x.dtype)
        is_real = np.issubdtype(x.dtype, np.floating)
        return jnp.asarray(np.concatenate([x, rest]), dtype if is_real else x.dtype)

    for first in range(0, count, _CHUNK):
        part = jax.tree.map(padded, samples[first : first + _CHUNK])
        found = _chunk(ends, origin, columns.spacing, test, part)
        ends, size = found.ends, min(_CHUNK, count - first)
        depths[:, first : first + size] = np.asarray(found.depths).T[:, :size]
        has_overflow |= bool(found.has_overflow)
    left = eqx.tree_at(lambda c: c.ends, columns, ends)
    return Swept(left, depths[0], depths[1], has_overflow)


class _Chunk(eqx.Module):
    """Sweep of a tool along a fixed number of poses.

    Attributes:
        ends: Ends of the rays after the last pose [m], shape (x, y, 2, slot).
        depths: Of the tool and of the holder [m], shape (sample, 2).
        has_overflow: Whether a ray ran out of slots, shape ().
    """

    ends: Float[Array, "x y 2 slot"]
    depths: Float[Array, "sample 2"]
    has_overflow: Bool[Array, ""]


@CachedJit
def _chunk(
    ends: Float[Array, "x y 2 slot"],
    origin: Float[Array, " 2"],
    spacing: float,
    test: ContactTest,
    samples: Samples,
) -> _Chunk:
    """Take a tool through a fixed number of poses."""
    slots = ends.shape[-1]
    zero = jnp.zeros((), jnp.int32)
    nothing = jnp.zeros((), ends.dtype)

    def seen(ends: Array, window: Window) -> Array:
        at = (*jnp.asarray(window.first), zero, zero)
        return jax.lax.dynamic_slice(ends, at, (*window.size, 2, slots))

    def step(ends: Array, sample: Samples) -> tuple[Array, tuple[Array, Array]]:
        tip, axis = jnp.asarray(sample.tip), jnp.asarray(sample.axis)
        pose, first = Pose(tip, axis), jnp.asarray(sample.tool.first)
        part = seen(ends, sample.tool)
        x, y = _places(origin, spacing, sample.tool)
        in_tool = jax.lax.cond(
            sample.is_tool, lambda: tool_depth(part, x, y, pose, test), lambda: nothing
        )

        def cut() -> tuple[Array, Array]:
            start, stop, is_hit = test.cutter.intersect_pose(2, x, y, tip, axis)
            when = jnp.zeros(start.shape, jnp.int32)
            interval = CutInterval(start, stop, is_hit, when, when)
            unknown = jnp.zeros(part.shape, jnp.int32)
            pieces = interval.subtract_from(part, unknown)
            return pieces.ends, jnp.any(pieces.is_full)

        whole = lambda: (part, jnp.zeros((), bool))
        part, is_full = jax.lax.cond(sample.is_cut, cut, whole)
        ends = jax.lax.dynamic_update_slice(
            ends, part, (first[0], first[1], zero, zero)
        )
        if test.holder is None:
            return ends, (jnp.stack([in_tool, nothing]), is_full)

        def holder_contact() -> Array:
            near = seen(ends, sample.holder)
            x, y = _places(origin, spacing, sample.holder)
            return holder_depth(near, x, y, pose, test)

        in_holder = jax.lax.cond(sample.is_holder, holder_contact, lambda: nothing)
        return ends, (jnp.stack([in_tool, in_holder]), is_full)

    ends, (depths, is_full) = jax.lax.scan(step, ends, samples)
    return _Chunk(ends, depths, jnp.any(is_full))


def _places(
    origin: Float[Array, " 2"], spacing: float, window: Window
) -> tuple[Float[Array, "x y"], Float[Array, "x y"]]:
    """Places of the rays of a window."""
    first, size = jnp.asarray(window.first), window.size
    lines = [
        origin[a]
        + spacing
        * (first[a] + jnp.arange(size[a], dtype=jnp.int32)).astype(origin.dtype)
        for a in (0, 1)
    ]
    return (
        jnp.broadcast_to(lines[0][:, None], size),
        jnp.broadcast_to(lines[1][None], size),
    )
