"""Subtracting a tool from the intervals of rays, in windows of fixed size.

A window is sliced from the stock, trimmed, and written back at the same place; XLA
does this in place as long as nothing else reads the old arrays in the same step, so
a step removes first and looks at the stock afterwards.
"""

import functools
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from .._pose import Pose
from .interval import CutInterval
from .stock import Rays, Stock
from .tooth_pass import ToothPass, cut_interval, standing

# A tool that leans less than this out of the horizontal lies flat.
_LEVEL = 1e-6
# Slots that a removal looks at, if more are not in use.
_WIDTHS = (3, 8)


class RemovalWindow(eqx.Module):
    """Number of rays that a removal reads and writes.

    Attributes:
        sizes: Grid lines along x, y and z.
        slack: How far the second pose may stand from the first [m].
        length: Length of the tool from the tip that can be in the stock [m]; used
            for tools in any direction, whose window stands around this length.
        has_shank: Whether the shank above the flutes can be in the stock.
    """

    sizes: tuple[int, int, int] = eqx.field(static=True)
    slack: float
    length: float = 0.0
    has_shank: bool = eqx.field(static=True, default=False)

    @classmethod
    def upright(
        cls, stock: Stock, cutter: AbstractCutter, axial_depth: float, reach: float
    ) -> "RemovalWindow":
        """Return the window for a cutter that stands along +z.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            axial_depth: Deepest immersion of the tip below the top of the stock [m].
            reach: Distance between two poses that one window should hold [m].

        Returns:
            The window; never larger than the grid.
        """
        nx, ny, nz = stock.grid_shape
        d = stock.spacing
        slack = min(reach, cutter.nominal_radius)
        across = int((2 * cutter.nominal_radius + 2 * slack) / d) + 4
        # From the row below the tip to that above the top, wherever the tip is.
        height = int(axial_depth / d) + 4
        return cls(
            (min(across, nx), min(across, ny), min(height, nz)),
            slack,
            has_shank=bool(axial_depth > cutter.flute_length),
        )

    @classmethod
    def tilted(
        cls,
        stock: Stock,
        cutter: AbstractCutter,
        axes: Float[np.ndarray, "pose 3"] | None,
        axial_depth: float,
        reach: float,
    ) -> "RemovalWindow":
        """Return the window for a cutter in any direction.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            axes: Directions that will occur, shape (pose, 3); None if they are not
                known beforehand: the window is then the whole grid.
            axial_depth: Deepest immersion of the tip below the top of the stock [m].
            reach: Distance between two poses that one window should hold [m].

        Returns:
            The window; never larger than the grid.
        """
        shape = stock.grid_shape
        d, R = stock.spacing, cutter.nominal_radius
        slack = min(reach, R)
        diagonal = d * math.sqrt(sum(n**2 for n in shape)) + 2 * R
        if axes is None:
            return cls(shape, slack, diagonal, diagonal > cutter.flute_length)
        least = float(axes[:, 2].min())
        # Where the lowest point of the rim of the highest disc leaves the stock.
        sink = R * math.sqrt(max(0.0, 1 - least**2))
        leaves = (axial_depth + sink) / least if least > 0 else math.inf
        length = min(diagonal, leaves + 2 * d)
        across = np.sqrt(np.maximum(1 - axes**2, 0))
        extent = (length * np.abs(axes) + 2 * R * across).max(axis=0) + 2 * slack
        counts = [min(int(extent[a] / d) + 4, shape[a]) for a in range(3)]
        has_shank = length > cutter.flute_length
        return cls((counts[0], counts[1], counts[2]), slack, length, has_shank)

    def remove_poses(
        self,
        stock: Stock,
        cutter: AbstractCutter,
        poses: Pose,
        indices: Int[Array, " pose"],
        is_due: Bool[Array, " pose"],
        *,
        slots: Int[Array, " 3"] | None = None,
    ) -> "CutStock":
        """Subtract the cutter at a few close poses, where it stands still.

        The window stands around the first of them.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            poses: Tool poses in `work`, shape (pose, 3).
            indices: Index of each pose, kept with the ends that it cuts, shape (pose,).
            is_due: Which of the poses to subtract, shape (pose,).
            slots: How many slots of each family hold anything, shape (3,), so that no
                more are looked at; all are if not given.

        Returns:
            The stock, what was taken, and what went wrong.

        Differentiability: in the ends of the stock, through the poses.
        """
        passes = [standing(poses[i], indices[i]) for i in range(indices.shape[0])]
        return self.remove_passes(stock, cutter, passes, is_due, slots=slots)

    def remove_passes(
        self,
        stock: Stock,
        cutter: AbstractCutter,
        passes: Sequence[ToothPass],
        is_due: Bool[Array, " pass"],
        *,
        slots: Int[Array, " 3"] | None = None,
    ) -> "CutStock":
        """Subtract what teeth take as they go around, at a few close places.

        The window stands around the first pass.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            passes: The passes, each of one tooth.
            is_due: Which of them to subtract, shape (pass,).
            slots: How many slots of each family hold anything, shape (3,), so that no
                more are looked at; all are if not given.

        Returns:
            The stock, what was taken, and what went wrong.

        Differentiability: in the ends of the stock, through the poses.
        """
        centers = [tooth.center().frozen() for tooth in passes]
        grid = window_grid(stock, cutter, self, centers[0])
        d = stock.spacing
        has_overflow = jnp.zeros((), bool)
        volumes = jnp.zeros(len(passes), stock.origin.dtype)
        has_cut = jnp.zeros((), bool)
        due = [_DuePass(each, is_due[i]) for i, each in enumerate(passes)]
        families, in_use = [], []
        for f in (0, 1, 2):
            removed = _remove_family(
                stock.families[f],
                cutter,
                f,
                grid,
                due,
                None if slots is None else slots[f],
            )
            in_use.append(removed.in_use)
            has_overflow = has_overflow | removed.has_overflow
            has_cut = has_cut | jnp.any(removed.length > 0)
            if stock.volume_weights[f]:
                volumes = volumes + removed.length * stock.volume_weights[f] * d**2
            families.append(removed.rays)
        new_stock = eqx.tree_at(lambda s: s.families, stock, tuple(families))
        by_shank = jnp.zeros_like(volumes)
        if self.has_shank:
            by_shank = _shank_volume(stock, cutter, grid, passes, is_due) * d**2
        return CutStock(
            new_stock,
            volumes,
            by_shank,
            jnp.stack(in_use),
            has_overflow,
            grid.is_beyond & has_cut,
        )


class WindowGrid(NamedTuple):
    """Grid lines of a window where it stands.

    Attributes:
        starts: First grid line on each axis.
        lines: Coordinates of its lines on each axis [m].
        is_beyond: Whether the tool reaches beyond the window, shape ().
    """

    starts: list[Int[Array, ""]]
    lines: list[Float[Array, " _"]]
    is_beyond: Bool[Array, ""]

    def of_family(
        self, family: int
    ) -> tuple[tuple[Int[Array, ""], ...], list[Float[Array, "u v"]]]:
        """Return where the rays of a family begin in their table, and stand [m]."""
        axes = ((family + 1) % 3, (family + 2) % 3)
        zero = jnp.zeros((), jnp.int32)
        places = jnp.meshgrid(*(self.lines[axis] for axis in axes), indexing="ij")
        return (*(self.starts[axis] for axis in axes), zero, zero), places


class _RemovedFamily(NamedTuple):
    """Rays of a family after a removal.

    Attributes:
        rays: The rays.
        in_use: How many slots hold anything, from the first on.
        length: What each pass took [m], shape (pass,).
        has_overflow: Whether a ray ran out of slots, shape ().
    """

    rays: Rays
    in_use: Int[Array, ""]
    length: Float[Array, " pass"]
    has_overflow: Bool[Array, ""]


class CutStock(eqx.Module):
    """Result of a removal.

    Attributes:
        stock: The stock without the poses.
        volume: What each pass took [m^3], shape (pass,).
        by_shank: What of it its shank took, above the flutes [m^3], shape (pass,).
        slots: How many slots of each family hold anything, shape (3,).
        has_overflow: Whether a ray ran out of slots, shape ().
        is_beyond: Whether a tool reached beyond the window, shape ().
    """

    stock: Stock
    volume: Float[Array, " pass"]
    by_shank: Float[Array, " pass"]
    slots: Int[Array, " 3"]
    has_overflow: Bool[Array, ""]
    is_beyond: Bool[Array, ""]


def _shank_volume(
    stock: Stock,
    cutter: AbstractCutter,
    grid: WindowGrid,
    passes: Sequence[ToothPass],
    is_due: Bool[Array, " pose"],
) -> Float[Array, " pose"]:
    """Return how much of each pass's cut lies above its flutes, by the rays along z."""
    rays = stock.families[2]
    at, (x, y) = grid.of_family(2)
    shape = (*x.shape, 2, rays.ends.shape[-1])
    ends = jax.lax.stop_gradient(jax.lax.dynamic_slice(rays.ends, at, shape))
    lengths = []
    for i, each in enumerate(passes):
        pose = each.center()
        start, stop, is_hit, *_ = cut_interval(cutter, 2, x, y, each)
        a = pose.direction()
        foot = (x - pose.tip[0]) * a[0] + (y - pose.tip[1]) * a[1]
        left = cutter.flute_length - foot
        is_level = jnp.abs(a[2]) < _LEVEL
        above = pose.tip[2] + left / jnp.where(is_level, 1.0, a[2])
        never = jnp.where(left < 0, -Rays.DEAD, Rays.DEAD)
        above = jnp.where(is_level, never, above)
        # A shank that hangs down takes what lies below this height instead.
        low = jnp.where(a[2] >= 0, jnp.maximum(start, above), start)
        high = jnp.where(a[2] >= 0, stop, jnp.minimum(stop, above))
        piece = jnp.minimum(ends[:, :, 1], high[..., None]) - jnp.maximum(
            ends[:, :, 0], low[..., None]
        )
        taken = jnp.where((is_hit & is_due[i])[..., None], jnp.maximum(piece, 0), 0)
        lengths.append(jnp.sum(taken))
    return jnp.stack(lengths)


def window_grid(
    stock: Stock, cutter: AbstractCutter, window: RemovalWindow, pose: Pose
) -> WindowGrid:
    """Return the grid lines of a window around a pose.

    Args:
        stock: The workpiece.
        cutter: The cutter.
        window: Size of the window.
        pose: The pose, without derivative, shape (3,).
    """
    origin, d = stock.origin, stock.spacing
    place = _place(stock, cutter, window, pose)
    lines = [
        origin[a]
        + d
        * (place.starts[a] + jnp.arange(window.sizes[a], dtype=jnp.int32)).astype(
            origin.dtype
        )
        for a in range(3)
    ]
    return WindowGrid(place.starts, lines, place.is_beyond)


class _WindowPlace(NamedTuple):
    """First grid lines of a window, and whether it misses material, shape ()."""

    starts: list[Int[Array, ""]]
    is_beyond: Bool[Array, ""]


def _place(
    stock: Stock, cutter: AbstractCutter, window: RemovalWindow, pose: Pose
) -> _WindowPlace:
    origin, d = stock.origin, stock.spacing
    shape, sizes = stock.grid_shape, window.sizes
    if pose.axis is None:
        grid = jnp.floor((pose.tip - origin) / d).astype(jnp.int32)
        starts = [
            jnp.clip(grid[0] - sizes[0] // 2 + 1, 0, shape[0] - sizes[0]),
            jnp.clip(grid[1] - sizes[1] // 2 + 1, 0, shape[1] - sizes[1]),
            jnp.clip(grid[2] - 1, 0, shape[2] - sizes[2]),
        ]
        # Material above the window under the tool would stay uncut.
        last = origin[2] + d * (starts[2] + sizes[2] - 1).astype(origin.dtype)
        is_beyond = (starts[2] + sizes[2] < shape[2]) & (last < stock.top)
        return _WindowPlace(starts, is_beyond)
    a, R = pose.axis, cutter.nominal_radius
    disc = R * jnp.sqrt(jnp.maximum(1 - a**2, 0))
    far = pose.tip + window.length * a
    lower = jnp.minimum(pose.tip, far) - disc
    upper = jnp.maximum(pose.tip, far) + disc
    first = jnp.floor((lower - window.slack - origin) / d).astype(jnp.int32)
    starts = [jnp.clip(first[i], 0, shape[i] - sizes[i]) for i in range(3)]
    end = origin + d * jnp.asarray(shape, origin.dtype)
    # Beyond its length the tool must be clear of the grid, or above the material.
    is_inside = jnp.all((far > origin - R) & (far < end + R))
    is_beyond = is_inside & (far[2] - disc[2] < stock.top)
    for i in range(3):
        last = origin[i] + d * (starts[i] + sizes[i] - 1).astype(origin.dtype)
        is_short = (starts[i] + sizes[i] < shape[i]) & (last < upper[i])
        if i == 2:
            is_short = is_short & (last < stock.top)
        is_beyond = is_beyond | is_short
    return _WindowPlace(starts, is_beyond)


class _DuePass(NamedTuple):
    """A pass, and whether it is removed now."""

    tooth: ToothPass
    is_due: Bool[Array, ""]


def _remove_family(
    rays: Rays,
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    grid: WindowGrid,
    due: Sequence[_DuePass],
    in_use: Int[Array, ""] | None,
) -> _RemovedFamily:
    at, (b, c) = grid.of_family(family)
    shape = (*b.shape, 2, rays.ends.shape[-1])
    ends = jax.lax.dynamic_slice(rays.ends, at, shape)
    cut_by = jax.lax.dynamic_slice(rays.poses, at, shape)
    subtract_from = _subtract_in_use if in_use is not None else _subtract_in_all
    if in_use is None:
        in_use = rays.slots_in_use()

    def remove(window: _Window, each: _DuePass) -> tuple[_Window, _Taken]:
        def cut(window: _Window) -> tuple[_Window, _Taken]:
            return subtract_from(window, cut_interval(cutter, family, b, c, each.tooth))

        def skip(window: _Window) -> tuple[_Window, _Taken]:
            return window, _Taken(jnp.zeros((), ends.dtype), jnp.zeros((), bool))

        return jax.lax.cond(each.is_due, cut, skip, window)

    window = _Window(ends, cut_by, in_use)
    if len(due) == 1:
        window, one = remove(window, due[0])
        taken = _Taken(one.length[None], one.is_full)
    else:
        # One body for all passes is compiled once.
        each = jax.tree.map(lambda *x: jnp.stack(x), *due)
        window, taken = jax.lax.scan(remove, window, each)
    new = Rays(
        jax.lax.dynamic_update_slice(rays.ends, window.ends, at),
        jax.lax.dynamic_update_slice(rays.poses, window.cut_by, at),
    )
    return _RemovedFamily(new, window.in_use, taken.length, jnp.any(taken.is_full))


class _Window(NamedTuple):
    """The rays of one family in a window.

    Attributes:
        ends: Lower and upper ends [m].
        cut_by: When they were cut, in ticks.
        in_use: How many slots hold anything, from the first on.
    """

    ends: Float[Array, "u v 2 slot"]
    cut_by: Int[Array, "u v 2 slot"]
    in_use: Int[Array, ""]


class _Taken(NamedTuple):
    """What each pass took [m], and whether a ray was full then."""

    length: Float[Array, "*pass"]
    is_full: Bool[Array, "*pass"]


def _subtract_in_use(window: _Window, interval: CutInterval) -> tuple[_Window, _Taken]:
    """Subtract an interval from each ray, in the slots in use and one more."""
    # A ray in a long run rarely holds more than two pieces, of many that it has room
    # for; the cost is that of the slots looked at.
    count = window.ends.shape[-1]
    widths = [width for width in _WIDTHS if width < count] + [count]

    fits = [window.in_use < width for width in widths[:-1]] + [window.in_use >= 0]
    branches = [functools.partial(_subtract_among, width) for width in widths]
    return jax.lax.switch(jnp.argmax(jnp.stack(fits)), branches, window, interval)


def _subtract_in_all(window: _Window, interval: CutInterval) -> tuple[_Window, _Taken]:
    """Subtract an interval from each ray, in all slots: less to compile."""
    return _subtract_among(window.ends.shape[-1], window, interval)


def _subtract_among(
    width: int, window: _Window, interval: CutInterval
) -> tuple[_Window, _Taken]:
    """Subtract an interval from each ray, in the first slots."""
    old = window.ends[..., :width]
    pieces = interval.subtract_from(old, window.cut_by[..., :width])
    corner = (0, 0, 0, 0)
    left = _Window(
        jax.lax.dynamic_update_slice(window.ends, pieces.ends, corner),
        jax.lax.dynamic_update_slice(window.cut_by, pieces.cut_by, corner),
        jnp.maximum(window.in_use, Rays(pieces.ends, pieces.cut_by).slots_in_use()),
    )
    return left, _Taken(_removed_length(old, pieces.ends), jnp.any(pieces.is_full))


def _removed_length(
    ends: Float[Array, "u v 2 slot"], new: Float[Array, "u v 2 slot"]
) -> Float[Array, ""]:
    # Slot by slot: a sum over so short an axis is four times as slow.
    removed = jnp.zeros(ends.shape[:2], ends.dtype)
    for m in range(ends.shape[-1]):
        for sign, of in ((1, ends), (-1, new)):
            length = of[:, :, 1, m] - of[:, :, 0, m]
            # Not `maximum`, of which reverse mode keeps numbers: of this, a flag.
            removed = removed + sign * jnp.where(length > 0, length, 0)
    return jnp.sum(removed)
