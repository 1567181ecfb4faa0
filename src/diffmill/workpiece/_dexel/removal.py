"""Subtracting a tool from the intervals of rays, in windows of fixed size.

A window is sliced from the stock, trimmed, and written back at the same place; XLA
does this in place as long as nothing else reads the old arrays in the same step, so
a step removes first and looks at the stock afterwards.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import is_traced
from ...cutter import AbstractCutter
from ...numerics import materialise
from .._pose import Pose
from .interval import CutInterval
from .stock import Rays, Stock
from .tooth_pass import ToothPass, cut_interval, standing

# A tool lies flat where the sine of its lean out of the horizontal is less [-].
_FLAT_SINE = 1e-6
# Scallop f^2 / (8 R) that may go with the passes beside it [m].
_SCALLOP = 1.5e-6
# Slots that a removal searches, if more are not in use.
_SLOT_COUNTS = (3, 8)


class RemovalWindow(eqx.Module):
    """Number of rays that a removal reads and writes.

    Attributes:
        sizes: Grid lines along x, y and z.
        slack: Largest distance of the second pose from the first [m].
        length: Length of the tool from the tip that can be in the stock [m]; used
            for tools in any direction, whose window is around this length.
        has_shank: True if the shank above the flutes can be in the stock.
    """

    sizes: tuple[int, int, int] = eqx.field(static=True)
    slack: float
    length: float = 0.0
    has_shank: bool = eqx.field(static=True, default=False)

    @classmethod
    def upright(
        cls, stock: Stock, cutter: AbstractCutter, axial_depth: float, reach: float
    ) -> "RemovalWindow":
        """Window of an upright cutter.

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
        across = int((2 * _widest_radius(cutter) + 2 * slack) / d) + 4
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
        """Window of a cutter in any direction.

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
        d, R = stock.spacing, _widest_radius(cutter)
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

    def reach(self, spacing: float) -> Float[np.ndarray, " 3"]:
        """Distance from a tip along each axis beyond which it meets no ray [m], (3,).

        Args:
            spacing: Distance between rays [m].
        """
        sizes = np.array(self.sizes)
        if self.length == 0:
            # An upright tool stands in the middle of its window.
            sizes[:2] //= 2
        return spacing * (sizes + 2)

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
        """Subtract the cutter at a few close poses, where it rests.

        The window is around the first of them.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            poses: Tool poses in `work`, shape (pose, 3).
            indices: Index of each pose, stored with the ends that it cuts, shape
                (pose,).
            is_due: Which of the poses to subtract, shape (pose,).
            slots: Number of slots in use of each family, shape (3,); all slots are
                searched if not given.

        Returns:
            The stock, the removed volumes, and flags of trouble.

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
        """Subtract the ways of teeth around the tool, at a few close places.

        The window is around the first pass.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            passes: The passes, each of one tooth.
            is_due: Which of them to subtract, shape (pass,).
            slots: Number of slots in use of each family, shape (3,); all slots are
                searched if not given.

        Returns:
            The stock, the removed volumes, and flags of trouble.

        Differentiability: in the ends of the stock, through the poses.
        """
        centers = [each.center().frozen() for each in passes]
        grid = window_grid(stock, cutter, self, centers)
        in_use = stock.slots_in_use() if slots is None else slots
        places = [grid.of_family(f) for f in (0, 1, 2)]
        windows = tuple(
            _Window.of(stock.families[f], places[f], in_use[f]) for f in (0, 1, 2)
        )
        subtract = _PassRemoval(cutter, places, slots is None, self.has_shank)
        if len(passes) == 1:
            windows, removed = subtract(windows, passes[0], is_due[0])
            removed = jax.tree.map(lambda x: x[None], removed)
        else:
            # One body for all passes is compiled once.
            each = jax.tree.map(lambda *x: jnp.stack(x), *passes)
            # JAX wants a function that it can refer to weakly.
            windows, removed = jax.lax.scan(
                lambda windows, due: subtract(windows, *due), windows, (each, is_due)
            )
        is_beyond = jnp.any(grid.has_left_window & is_due) & jnp.any(removed.length > 0)
        return self._cut_stock(stock, places, windows, removed, is_beyond)

    def remove_together(
        self,
        stock: Stock,
        cutter: AbstractCutter,
        pass_of: Callable[[Int[Array, ""]], ToothPass],
        count: Int[Array, ""],
        *,
        slots: Int[Array, " 3"],
    ) -> tuple["CutStock", Int[Array, ""]]:
        """Subtract the ways of teeth around the tool that overlap, in one interval.

        From each ray it takes the interval from the lowest to the highest place that
        any of them reaches; up to the first pass that leaves more between itself and
        those before than a scallop of 1.5 um, which goes with them.

        Args:
            stock: The workpiece.
            cutter: The cutter.
            pass_of: Returns a pass by its number.
            count: How many passes there are, shape ().
            slots: Number of slots in use of each family, shape (3,).

        Returns:
            The stock with what the passes took and flags of trouble; and the number of
            passes that are taken, at least 1 if there is one.

        **Differentiability**: in the ends of the stock, in forward mode.
        """
        one = pass_of(jnp.zeros((), jnp.int32))
        first = one.center().frozen()
        last = pass_of(jnp.maximum(count - 1, 0)).center().frozen()
        grid = window_grid(stock, cutter, self, [first, last])
        places = [grid.of_family(f) for f in (0, 1, 2)]
        windows = tuple(
            _Window.of(stock.families[f], places[f], slots[f]) for f in (0, 1, 2)
        )
        # Apart from the stock: read in one kernel with the cut it would be copied.
        windows = materialise(windows)
        removal = _PassRemoval(cutter, places, False, self.has_shank)

        def add(gathered: _Gathered) -> _Gathered:
            tooth = pass_of(gathered.count)
            cuts = [
                cut_interval(cutter, f, places[f].b, places[f].c, tooth)
                for f in (0, 1, 2)
            ]
            tip = tooth.center().tip
            square = jnp.sum((tip - gathered.tip) ** 2)
            is_low = square <= 8 * cutter.nominal_radius * _SCALLOP
            gap = jnp.where(is_low, jnp.sqrt(square), 0)
            pairs = list(zip(gathered.cuts, cuts, strict=True))
            apart = [old.is_apart(new, gap) for old, new in pairs]
            is_apart = jnp.any(jnp.stack(apart))
            joined = tuple(old.joined(new, ~is_apart) for old, new in pairs)
            number = gathered.count + (~is_apart).astype(jnp.int32)
            return _Gathered(joined, tip, number, is_apart | (number >= count))

        begun = _Gathered(
            tuple(CutInterval.none(place.b) for place in places),
            first.tip,
            jnp.zeros((), jnp.int32),
            count <= 0,
        )
        gathered = jax.lax.while_loop(lambda g: ~g.is_whole, add, begun)
        windows, removed = removal.take(windows, gathered.cuts, one)
        removed = jax.tree.map(lambda x: x[None], removed)
        is_beyond = jnp.any(grid.has_left_window) & jnp.any(removed.length > 0)
        cut = self._cut_stock(stock, places, windows, removed, is_beyond)
        return cut, gathered.count

    def _cut_stock(
        self,
        stock: Stock,
        places: Sequence["RayPlaces"],
        windows: Sequence["_Window"],
        removed: "_RemovedLengths",
        has_left_window: Bool[Array, ""],
    ) -> "CutStock":
        """Stock with the rays of a window put back, and what was removed."""
        d = stock.spacing
        volumes = jnp.zeros(removed.length.shape[0], stock.origin.dtype)
        for f, weight in enumerate(stock.volume_weights):
            if weight:
                volumes = volumes + removed.length[:, f] * weight * d**2
        families = tuple(
            window.put_back(rays, place)
            for window, rays, place in zip(windows, stock.families, places, strict=True)
        )
        new_stock = eqx.tree_at(lambda s: s.families, stock, families)
        return CutStock(
            new_stock,
            volumes,
            removed.by_shank * d**2,
            jnp.stack([window.in_use for window in windows]),
            jnp.any(removed.is_full),
            has_left_window,
        )


def _widest_radius(cutter: AbstractCutter) -> Any:
    """Radius of the cutter with a run-out whose value is known [m]."""
    is_known = cutter.has_runout and not is_traced(cutter.runout)
    return cutter.nominal_radius + (abs(float(cutter.runout)) if is_known else 0.0)


class WindowGrid(NamedTuple):
    """Grid lines of a window where it stands.

    Attributes:
        starts: First grid line on each axis.
        lines: Coordinates of its lines on each axis [m].
        has_left_window: True if the tool leaves the window, of an upright one for each
            pose, shape (pose,), of another at the first, shape ().
    """

    starts: list[Int[Array, ""]]
    lines: list[Float[Array, " _"]]
    has_left_window: Bool[Array, "*pose"]

    def of_family(self, family: int) -> "RayPlaces":
        """Places of the rays of a family in the window."""
        axes = ((family + 1) % 3, (family + 2) % 3)
        zero = jnp.zeros((), jnp.int32)
        b, c = jnp.meshgrid(*(self.lines[axis] for axis in axes), indexing="ij")
        return RayPlaces((*(self.starts[axis] for axis in axes), zero, zero), b, c)


class RayPlaces(NamedTuple):
    """Places of the rays of a family in a window.

    Attributes:
        at: Index at which the rays begin in their table.
        b: Their coordinates along axis (family + 1) % 3 [m].
        c: Their coordinates along axis (family + 2) % 3 [m].
    """

    at: tuple[Int[Array, ""], ...]
    b: Float[Array, "u v"]
    c: Float[Array, "u v"]


class CutStock(eqx.Module):
    """Result of a removal.

    Attributes:
        stock: The stock without the poses.
        volume: Volume that each pass takes [m^3], shape (pass,).
        by_shank: Part of it that the shank takes, above the flutes [m^3], shape
            (pass,).
        slots: Number of slots in use of each family, shape (3,).
        has_overflow: True if a ray ran out of slots, shape ().
        has_left_window: True if a tool left the window, shape ().
    """

    stock: Stock
    volume: Float[Array, " pass"]
    by_shank: Float[Array, " pass"]
    slots: Int[Array, " 3"]
    has_overflow: Bool[Array, ""]
    has_left_window: Bool[Array, ""]


def window_grid(
    stock: Stock, cutter: AbstractCutter, window: RemovalWindow, poses: Sequence[Pose]
) -> WindowGrid:
    """Grid lines of a window around the first of some poses.

    Args:
        stock: The workpiece.
        cutter: The cutter.
        window: Size of the window.
        poses: The poses, without derivative, each of shape (3,).
    """
    origin, d = stock.origin, stock.spacing
    place_window = _upright_window if poses[0].axis is None else _tilted_window
    starts, has_left_window = place_window(stock, cutter, window, poses)
    lines = []
    for a in range(3):
        index = starts[a] + jnp.arange(window.sizes[a], dtype=jnp.int32)
        lines.append(origin[a] + d * index.astype(origin.dtype))
    return WindowGrid(starts, lines, has_left_window)


def _upright_window(
    stock: Stock, cutter: AbstractCutter, window: RemovalWindow, poses: Sequence[Pose]
) -> tuple[list[Int[Array, ""]], Bool[Array, " pose"]]:
    """First grid lines of a window around an upright tool; True if it leaves it."""
    tip, origin, d = poses[0].tip, stock.origin, stock.spacing
    shape, sizes = stock.grid_shape, window.sizes
    grid = jnp.floor((tip - origin) / d).astype(jnp.int32)
    starts = [
        jnp.clip(grid[0] - sizes[0] // 2 + 1, 0, shape[0] - sizes[0]),
        jnp.clip(grid[1] - sizes[1] // 2 + 1, 0, shape[1] - sizes[1]),
        jnp.clip(grid[2] - 1, 0, shape[2] - sizes[2]),
    ]
    # Lines beyond the window that a tool of its true radius reaches stay uncut, and
    # so does material above it. The tool ends at its tip.
    radius = cutter.diameter / 2
    if cutter.has_runout:
        radius = radius + jnp.abs(jnp.asarray(cutter.runout, origin.dtype))
    side = radius * jnp.asarray([1, 1, 0], origin.dtype)
    tips = jnp.stack([each.tip for each in poses])
    is_up = jnp.asarray([[False, False, True]])
    high = jnp.where(is_up, stock.top, tips + side[None])
    first = jnp.stack(starts)
    last = first + jnp.asarray(sizes, jnp.int32)
    before = origin + d * (first - 1).astype(origin.dtype)
    behind = origin + d * last.astype(origin.dtype)
    has_before, has_behind = first > 0, last < jnp.asarray(shape, jnp.int32)
    is_short = has_before[None] & (before[None] > tips - side[None])
    is_short |= has_behind[None] & (behind[None] < high)
    return starts, jnp.any(is_short, axis=1)


def _tilted_window(
    stock: Stock, cutter: AbstractCutter, window: RemovalWindow, poses: Sequence[Pose]
) -> tuple[list[Int[Array, ""]], Bool[Array, ""]]:
    """First grid lines of a window around a tilted tool; True if it leaves it."""
    pose, origin, d = poses[0], stock.origin, stock.spacing
    shape, sizes = stock.grid_shape, window.sizes
    a, R = pose.direction(), _widest_radius(cutter)
    disc = R * jnp.sqrt(jnp.maximum(1 - a**2, 0))
    far = pose.tip + window.length * a
    lower = jnp.minimum(pose.tip, far) - disc
    upper = jnp.maximum(pose.tip, far) + disc
    first = jnp.floor((lower - window.slack - origin) / d).astype(jnp.int32)
    starts = [jnp.clip(first[i], 0, shape[i] - sizes[i]) for i in range(3)]
    end = origin + d * jnp.asarray(shape, origin.dtype)
    # Beyond its length the tool must be clear of the grid, or above the material.
    is_inside = jnp.all((far > origin - R) & (far < end + R))
    has_left_window = is_inside & (far[2] - disc[2] < stock.top)
    for i in range(3):
        last = origin[i] + d * (starts[i] + sizes[i] - 1).astype(origin.dtype)
        is_short = (starts[i] + sizes[i] < shape[i]) & (last < upper[i])
        if i == 2:
            is_short = is_short & (last < stock.top)
        has_left_window = has_left_window | is_short
    return starts, has_left_window


class _Window(eqx.Module):
    """Rays of one family in a window.

    Attributes:
        ends: Lower and upper ends [m].
        cut_by: Ticks at which they were cut.
        in_use: Number of slots in use, from the first on.
    """

    ends: Float[Array, "u v 2 slot"]
    cut_by: Int[Array, "u v 2 slot"]
    in_use: Int[Array, ""]

    @staticmethod
    def of(rays: Rays, place: RayPlaces, in_use: Int[Array, ""]) -> "_Window":
        """Rays of a family that stand in the window."""
        shape = (*place.b.shape, 2, rays.ends.shape[-1])
        ends = jax.lax.dynamic_slice(rays.ends, place.at, shape)
        return _Window(ends, jax.lax.dynamic_slice(rays.poses, place.at, shape), in_use)

    def put_back(self, rays: Rays, place: RayPlaces) -> Rays:
        """Family with these rays."""
        return Rays(
            jax.lax.dynamic_update_slice(rays.ends, self.ends, place.at),
            jax.lax.dynamic_update_slice(rays.poses, self.cut_by, place.at),
        )


class _RemovedLengths(eqx.Module):
    """Lengths of rays that passes take.

    Attributes:
        length: Length of the rays of each family [m].
        by_shank: Length of the rays along z that the shank takes, above the flutes [m].
        is_full: True if a ray has no free slot.
    """

    length: Float[Array, "*pass 3"]
    by_shank: Float[Array, "*pass"]
    is_full: Bool[Array, "*pass 3"]

    @staticmethod
    def none(dtype: jnp.dtype) -> "_RemovedLengths":
        """Nothing, by one pass."""
        zero = jnp.zeros((), dtype)
        return _RemovedLengths(jnp.stack([zero] * 3), zero, jnp.zeros(3, bool))


class _PassRemoval(NamedTuple):
    """Removal of a pass from the rays of a window.

    Attributes:
        cutter: The cutter.
        places: Places of the rays of each family.
        searches_all_slots: True if all slots are searched: less to compile.
        has_shank: True if the shank above the flutes can be in the stock.
    """

    cutter: AbstractCutter
    places: list[RayPlaces]
    searches_all_slots: bool
    has_shank: bool

    def __call__(
        self, windows: tuple[_Window, ...], tooth: ToothPass, is_due: Bool[Array, ""]
    ) -> tuple[tuple[_Window, ...], _RemovedLengths]:
        """Windows without the pass, if it is due, and the lengths that it takes."""

        def cut() -> tuple[tuple[_Window, ...], _RemovedLengths]:
            cutter, places = self.cutter, self.places
            cuts = [
                cut_interval(cutter, f, places[f].b, places[f].c, tooth)
                for f in (0, 1, 2)
            ]
            return self.take(windows, cuts, tooth)

        def skip() -> tuple[tuple[_Window, ...], _RemovedLengths]:
            return windows, _RemovedLengths.none(windows[0].ends.dtype)

        return jax.lax.cond(is_due, cut, skip)

    def take(
        self,
        windows: tuple[_Window, ...],
        cuts: Sequence[CutInterval],
        tooth: ToothPass,
    ) -> tuple[tuple[_Window, ...], _RemovedLengths]:
        """Windows without an interval of each ray, and the lengths that are taken.

        Args:
            windows: The windows.
            cuts: The intervals of each family.
            tooth: A pass that cuts them, from which the shank is told.
        """
        subtract = _subtract_in_all if self.searches_all_slots else _subtract_in_use
        new, lengths, full = zip(*map(subtract, windows, cuts), strict=True)
        by_shank = jnp.zeros((), windows[2].ends.dtype)
        if self.has_shank:
            by_shank = self._shank_length(windows[2], cuts[2], tooth)
        return new, _RemovedLengths(jnp.stack(lengths), by_shank, jnp.stack(full))

    def _shank_length(
        self, window: _Window, interval: CutInterval, tooth: ToothPass
    ) -> Float[Array, ""]:
        """Length of a cut of rays along z that lies above the flutes [m]."""
        _, x, y = self.places[2]
        ends = jax.lax.stop_gradient(window.ends)
        start, stop, is_hit = interval.start, interval.stop, interval.is_cut
        pose = tooth.center()
        a = pose.direction()
        foot = (x - pose.tip[0]) * a[0] + (y - pose.tip[1]) * a[1]
        along = self.cutter.flute_length - foot
        is_level = jnp.abs(a[2]) < _FLAT_SINE
        above = pose.tip[2] + along / jnp.where(is_level, 1.0, a[2])
        never = jnp.where(along < 0, -Rays.DEAD, Rays.DEAD)
        above = jnp.where(is_level, never, above)
        # A shank that hangs down takes what lies below this height instead.
        low = jnp.where(a[2] >= 0, jnp.maximum(start, above), start)
        high = jnp.where(a[2] >= 0, stop, jnp.minimum(stop, above))
        piece = jnp.minimum(ends[:, :, 1], high[..., None]) - jnp.maximum(
            ends[:, :, 0], low[..., None]
        )
        return jnp.sum(jnp.where(is_hit[..., None], jnp.maximum(piece, 0), 0))


class _Gathered(eqx.Module):
    """Intervals that passes cut together.

    Attributes:
        cuts: From each ray, the interval of the passes so far.
        tip: Of the newest pass [m].
        count: How many passes, shape ().
        is_whole: True if no other pass comes in, shape ().
    """

    cuts: tuple[CutInterval, ...]
    tip: Float[Array, " 3"]
    count: Int[Array, ""]
    is_whole: Bool[Array, ""]


def _subtract_in_use(
    window: _Window, interval: CutInterval
) -> tuple[_Window, Float[Array, ""], Bool[Array, ""]]:
    """Subtract an interval from each ray, in the slots in use and one more."""
    # A ray in a long run rarely holds more than two pieces, of many that it has room
    # for; the cost is that of the slots that are searched.
    count = window.ends.shape[-1]
    widths = [width for width in _SLOT_COUNTS if width < count] + [count]
    fits = [window.in_use < width for width in widths[:-1]] + [window.in_use >= 0]
    branches = [functools.partial(_subtract_among, width) for width in widths]
    return jax.lax.switch(jnp.argmax(jnp.stack(fits)), branches, window, interval)


def _subtract_in_all(
    window: _Window, interval: CutInterval
) -> tuple[_Window, Float[Array, ""], Bool[Array, ""]]:
    """Subtract an interval from each ray, in all slots: less to compile."""
    return _subtract_among(window.ends.shape[-1], window, interval)


def _subtract_among(
    width: int, window: _Window, interval: CutInterval
) -> tuple[_Window, Float[Array, ""], Bool[Array, ""]]:
    """Subtract an interval from each ray, in the first slots.

    Returns:
        The rays, the length that the interval takes of them [m], and a flag: a ray was
        full.
    """
    old = window.ends[..., :width]
    pieces = interval.subtract_from(old, window.cut_by[..., :width])
    corner = (0, 0, 0, 0)
    remaining = _Window(
        jax.lax.dynamic_update_slice(window.ends, pieces.ends, corner),
        jax.lax.dynamic_update_slice(window.cut_by, pieces.cut_by, corner),
        jnp.maximum(window.in_use, Rays(pieces.ends, pieces.cut_by).slots_in_use()),
    )
    is_full = jnp.any(pieces.is_full)
    return remaining, _removed_length(old, pieces.ends), is_full


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
