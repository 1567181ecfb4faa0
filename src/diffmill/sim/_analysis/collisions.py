"""Collisions: contact of holder and shank with the stock, and of all in rapids.

The whole tool goes through its poses, leaning as it does, in a stock that is cut on the
way: what is found is in the stock as it is at that time. The shank above the flutes
removes what it meets, as in the simulation, whose `shank_volume` reports it.
"""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ..._types import FloatRows3
from ...cutter import (
    AbstractCutter,
    ToolHolder,
    ball_end_mill,
    bull_nose,
    flat_end_mill,
)
from ...toolpath import Path
from ...workpiece import Stock
from .contact import Box, Columns, Samples, columns_of, sweep, window_of
from .contact_depth import ContactTest

if TYPE_CHECKING:
    import xarray

# Rays closer than this share of the tool's radius are more than a check needs.
_FINEST = 0.1
# Share of the spacing of the rays that is no contact: poses leave a scalloped wall.
_TOUCH = 0.02
# Slots for intervals of a ray: to begin with, and at most.
_SLOTS, _MOST_SLOTS = 4, 64
# A tool whose axis rises less than this leaves the stock at its side.
_LEVEL = 1e-6


class ToolContacts(eqx.Module):
    """Depth of the parts of a tool that do not cut in the material, row by row.

    Attributes:
        rapid_depth: Depth of the tool in the stock at the first row and in rapid moves
            [m], shape (step,); zero where it was not checked.
        holder_depth: Depth of the holder in the stock as it is then [m], shape
            (step,).
        holder_part_depth: Depth of the holder in what is left after the last row [m],
            shape (step,): even if all else were cut before.
        spacing: Distance between the rays that were checked [m]: contact that is
            narrower may be missed.
    """

    rapid_depth: Float[np.ndarray, " step"]
    holder_depth: Float[np.ndarray, " step"]
    holder_part_depth: Float[np.ndarray, " step"]
    spacing: float = eqx.field(static=True)

    def to_dataset(self) -> "xarray.Dataset":
        """Return the holder's rows as an `xarray.Dataset` on the dimension step."""
        import xarray

        rows = {
            "holder_depth": "depth of the tool holder in the stock as it is then",
            "holder_part_depth": "depth of the tool holder in what is left at the end",
        }
        return xarray.Dataset(
            {
                name: ("step", getattr(self, name), {"units": "m", "long_name": text})
                for name, text in rows.items()
            }
        )

    @staticmethod
    def along(
        path: Path,
        stock: Stock,
        cutter: AbstractCutter,
        holder: ToolHolder | None = None,
        *,
        positions: FloatRows3 | None = None,
        checks_rapids: bool = True,
    ) -> "ToolContacts":
        """Look for a tool and its holder in the stock, along a path.

        Args:
            path: The path; its axes are the tool's.
            stock: The stock before the first row.
            cutter: The cutter. In rapid moves all of it counts, with a shank without
                end.
            holder: The holder; None to look for none.
            positions: Tool tips instead of those of the path [m], shape (step, 3).
            checks_rapids: Whether to look for the cutter at the first row and in rapid
                moves. It is looked for with a radius smaller by one spacing of the
                rays, so that a rapid move along a wall that was just cut is none
                through it.

        Returns:
            The depths.

        Differentiability: not applicable, a host function.
        """
        tips = np.asarray(path.positions if positions is None else positions, float)
        finest = _FINEST * cutter.nominal_radius
        is_upright = np.allclose(path.axes, [0.0, 0.0, 1.0], atol=1e-9)
        slot_count = 1 if is_upright else _SLOTS
        while True:
            columns = columns_of(stock, finest, slot_count)
            depths, has_overflow = _depths(
                path, tips, columns, cutter, holder, checks_rapids
            )
            slot_count = 2 * columns.ends.shape[-1]
            if not has_overflow or slot_count > _MOST_SLOTS:
                rapid, held, part = depths
                return ToolContacts(rapid, held, part, columns.spacing)


def _depths(
    path: Path,
    tips: Float[np.ndarray, "step 3"],
    columns: Columns,
    cutter: AbstractCutter,
    holder: ToolHolder | None,
    checks_rapids: bool,
) -> tuple[Float[np.ndarray, "3 step"], bool]:
    """Depths at the rows of a path, and whether a ray ran out of slots.

    The depths are those of the tool, of the holder, and of it in what is left [m].
    """
    d = columns.spacing
    row, tip, axis = _between_rows(tips, np.asarray(path.axes, float), holder, d)
    # The first row is one that the tool has come to, not one that it cuts.
    is_rapid = np.asarray(path.is_rapid)[row] | (row == 0)
    bounds = columns.bounds()
    box = _reach(tip, axis, cutter.nominal_radius, np.inf, bounds)
    is_near = _overlaps(box, bounds)
    holder_box, is_held = box, np.zeros(len(row), bool)
    is_looked = is_held
    if holder is not None:
        foot = tip + holder.overhang * axis
        holder_box = _reach(foot, axis, holder.radius, holder.length, bounds)
        is_held = _overlaps(holder_box, bounds)
        # Between two looks the holder moves by half a spacing at most.
        travel, line = _travel(tip, axis, holder), np.asarray(path.line)[row]
        is_next = np.diff(np.floor(2 * travel / d), prepend=-1) > 0
        # Ends of lines too, and the first sample near the stock.
        is_next[:-1] |= line[1:] != line[:-1]
        is_looked = is_held & (is_next | ~np.roll(is_held, 1))
    is_tool = is_near & is_rapid & checks_rapids
    samples = Samples(
        tip,
        axis,
        # What the tool stands in at the start is gone.
        is_cut=is_near & (~is_rapid | (row == 0)),
        is_tool=is_tool,
        is_holder=is_looked,
        tool=window_of(columns, box, is_near),
        holder=window_of(columns, holder_box, is_looked),
    )
    depths = np.zeros((3, len(tips)))
    is_full = False
    if is_tool.any() or is_looked.any():
        inner, lift = _inner_cutter(cutter, d)
        test = ContactTest(cutter, inner, lift, holder, _TOUCH * d)
        sampled, is_full = _sampled_depths(columns, test, samples)
        # A sample where it was not looked for has the depths of the last before.
        last = np.maximum.accumulate(np.where(is_looked, np.arange(len(row)), 0))
        sampled[1:] = sampled[1:, last] * is_held[None]
        for depth, values in zip(depths, sampled, strict=True):
            np.maximum.at(depth, row, values)
    return depths, is_full


def _sampled_depths(
    columns: Columns, test: ContactTest, samples: Samples
) -> tuple[Float[np.ndarray, "3 sample"], bool]:
    """Depths at samples, as `_depths`."""
    depths = np.zeros((3, len(samples.tip)))
    used = samples.is_cut | samples.is_tool | samples.is_holder
    swept = sweep(columns, test, samples[used])
    depths[0, used], depths[1, used] = swept.tool, swept.holder
    # Only what is in the stock then can be in what is left of it.
    again = depths[1] > 0
    if again.any():
        none = np.zeros(int(again.sum()), bool)
        left = eqx.tree_at(
            lambda s: (s.is_cut, s.is_tool), samples[again], (none, none)
        )
        depths[2, again] = sweep(swept.columns, test, left).holder
    return depths, swept.has_overflow


def _between_rows(
    tips: Float[np.ndarray, "step 3"],
    axes: Float[np.ndarray, "step 3"],
    holder: ToolHolder | None,
    spacing: float,
) -> tuple[
    Int[np.ndarray, " sample"],
    Float[np.ndarray, "sample 3"],
    Float[np.ndarray, "sample 3"],
]:
    """Poses of a tool on its way from row to row, at most a spacing apart.

    Returns:
        The row that each leads to, tips [m] and axes.
    """
    moves = np.diff(_travel(tips, axes, holder))
    pieces = np.ceil(moves / spacing - 1e-9).astype(int)
    pieces = np.concatenate([[1], np.maximum(pieces, 1)])
    row = np.repeat(np.arange(len(tips)), pieces)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1
    share = (nth / pieces[row])[:, None]
    before = np.maximum(row - 1, 0)
    tip = tips[before] + share * (tips[row] - tips[before])
    axis = axes[before] + share * (axes[row] - axes[before])
    return row, tip, axis / np.linalg.norm(axis, axis=1, keepdims=True)


def _travel(
    tip: Float[np.ndarray, "pose 3"],
    axis: Float[np.ndarray, "pose 3"],
    holder: ToolHolder | None,
) -> Float[np.ndarray, " pose"]:
    """Travel from the start that no point of tool and holder exceeds [m]."""
    reach = 0.0 if holder is None else holder.overhang + holder.length
    steps = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    steps += reach * np.linalg.norm(np.diff(axis, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _reach(
    foot: Float[np.ndarray, "sample 3"],
    axis: Float[np.ndarray, "sample 3"],
    radius: float,
    length: float,
    block: Box,
) -> Box:
    """Boxes around the part of a cylinder that can be in a block, none above it."""
    low, high = block
    far = np.linalg.norm(np.maximum(np.abs(foot - low), np.abs(high - foot)), axis=1)
    across = radius * np.sqrt(np.maximum(1 - axis**2, 0))
    rise = axis[:, 2]
    leaves = (high[2] - foot[:, 2] + across[:, 2]) / np.where(rise > _LEVEL, rise, 1)
    most = np.where(rise > _LEVEL, np.maximum(leaves, 0), np.inf)
    end = foot + np.minimum(np.minimum(far, length), most)[:, None] * axis
    return Box(np.minimum(foot, end) - across, np.maximum(foot, end) + across)


def _overlaps(box: Box, block: Box) -> Bool[np.ndarray, " sample"]:
    return np.all((box.low < block.high) & (box.high > block.low), axis=1)


def _inner_cutter(
    cutter: AbstractCutter, margin: float
) -> tuple[AbstractCutter, float]:
    """Cutter inside another by a margin, and its tip's height above the other's [m]."""
    R, rc = cutter.nominal_radius, cutter.nominal_corner_radius
    radius = max(R - margin, R / 2)
    diameter, teeth = 2 * radius, cutter.flute_count
    if rc == 0:
        return flat_end_mill(diameter, teeth), 0.0
    if rc >= R:
        return ball_end_mill(diameter, teeth), R - radius
    return bull_nose(diameter, teeth, min(rc, 0.99 * radius)), 0.0
