"""Rigid pass along a path: where it cuts, and where a rapid would hit the stock.

A height map of the stock is swept by the tool before anything is simulated. The tool
that removes has its full radius, the one that tests rapid moves is a ray spacing
smaller, so that a rapid along a wall that was just cut is no false alarm; what is
missed is a touch of less than one spacing.
"""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ...toolpath import Path
from ...workpiece import Stock, height_map, ray_ends

# A tip on the very surface does not cut: rounding of a program in inches or with
# four decimals stays below this [m].
_TOUCH = 1e-6


class RigidPass(eqx.Module):
    """Cut of a rigid tool along a path.

    Attributes:
        is_cutting: Whether the motion to a row removes stock, shape (step,).
        is_crash: Whether it does so in a rapid move, shape (step,).
        depth: Deepest penetration of stock by the rapid of a row [m], shape (step,).
    """

    is_cutting: Bool[np.ndarray, " step"]
    is_crash: Bool[np.ndarray, " step"]
    depth: Float[np.ndarray, " step"]


def rigid_pass(
    path: Path,
    radius: float,
    lower: Float[np.ndarray, " 3"],
    upper: Float[np.ndarray, " 3"],
    spacing: float,
) -> RigidPass:
    """Sweep a flat tool along a path through a block, without any robot.

    Args:
        path: Desired path with a vertical tool.
        radius: Radius of the tool [m].
        lower: Least x, y, z of the block [m], shape (3,).
        upper: Greatest x, y, z of the block [m], shape (3,).
        spacing: Distance of the points of the height map [m].

    Returns:
        Where the tool cuts and where a rapid move goes through stock.

    Differentiability: not applicable, a host function on NumPy arrays.
    """
    counts = np.maximum(np.round((upper - lower)[:2] / spacing), 1).astype(int)
    cell = (upper - lower)[:2] / counts
    x = lower[0] + (np.arange(counts[0]) + 0.5) * cell[0]
    y = lower[1] + (np.arange(counts[1]) + 0.5) * cell[1]
    heights = np.full(tuple(counts), float(upper[2]))
    return _sweep(path, radius, (x, y, heights), float(lower[2]), spacing)


def rigid_pass_of_stock(path: Path, radius: float, stock: Stock) -> RigidPass:
    """Sweep a flat tool along a path through any stock, seen from above.

    Args:
        path: Desired path with a vertical tool.
        radius: Radius of the tool [m].
        stock: The stock; what lies below an overhang counts as material.

    Returns:
        Where the tool cuts and where a rapid move goes through stock.

    Differentiability: not applicable, a host function on NumPy arrays.
    """
    x, y, heights = height_map(stock)
    lowest = float(ray_ends(stock, 2)[0][:, 2].min(initial=stock.top))
    heights = np.where(np.isnan(heights), -np.inf, heights).astype(float)
    return _sweep(path, radius, (x, y, heights), lowest, stock.spacing)


def _sweep(
    path: Path,
    radius: float,
    grid: tuple[
        Float[np.ndarray, " x"], Float[np.ndarray, " y"], Float[np.ndarray, "x y"]
    ],
    bottom: float,
    spacing: float,
) -> RigidPass:
    """Sweep the tool through a height map, which is used up."""
    x, y, heights = grid
    top = float(heights.max(initial=-np.inf))
    tips = np.asarray(path.positions, float)
    is_rapid = np.asarray(path.is_rapid)
    is_cutting = np.zeros(len(tips), dtype=bool)
    depth = np.zeros(len(tips))
    _remove(heights, x, y, tips[0], radius, bottom)
    # A motion beside the map or above it meets nothing.
    low = np.array([x[0] - radius, y[0] - radius])
    high = np.array([x[-1] + radius, y[-1] + radius, top - _TOUCH])
    is_near = np.all(np.maximum(tips[:-1], tips[1:])[:, :2] >= low, axis=1)
    is_near &= np.all(np.minimum(tips[:-1], tips[1:]) <= high, axis=1)
    for k in np.flatnonzero(is_near) + 1:
        pieces = max(1, math.ceil(np.linalg.norm(tips[k] - tips[k - 1]) / spacing))
        for piece in range(1, pieces + 1):
            tip = tips[k - 1] + (tips[k] - tips[k - 1]) * (piece / pieces)
            if tip[2] > top - _TOUCH:
                continue
            if not is_rapid[k]:
                is_cutting[k] |= _remove(heights, x, y, tip, radius, bottom)
                continue
            # A rapid removes nothing: its full disc would clear the way, by less
            # than a spacing at a time, for the smaller one that tests.
            inner = max(radius - spacing, 0.5 * radius)
            into = _highest(heights, x, y, tip, inner) - max(tip[2], bottom)
            depth[k] = max(depth[k], into)
    is_crash = is_rapid & (depth > _TOUCH)
    is_cutting |= is_crash
    return RigidPass(is_cutting=is_cutting, is_crash=is_crash, depth=depth)


def _window(
    x: Float[np.ndarray, " x"],
    y: Float[np.ndarray, " y"],
    tip: Float[np.ndarray, " 3"],
    radius: float,
) -> tuple[slice, slice, Bool[np.ndarray, "a b"]]:
    """Return the part of the map around the tool, and what of it the tool covers."""
    i0, i1 = np.searchsorted(x, (tip[0] - radius, tip[0] + radius))
    j0, j1 = np.searchsorted(y, (tip[1] - radius, tip[1] + radius))
    dx, dy = x[i0:i1, None] - tip[0], y[None, j0:j1] - tip[1]
    return slice(i0, i1), slice(j0, j1), dx**2 + dy**2 < radius**2


def _remove(
    heights: Float[np.ndarray, "x y"],
    x: Float[np.ndarray, " x"],
    y: Float[np.ndarray, " y"],
    tip: Float[np.ndarray, " 3"],
    radius: float,
    bottom: float,
) -> bool:
    """Lower the map under the tool in place; return whether anything was there."""
    rows, columns, is_covered = _window(x, y, tip, radius)
    part = heights[rows, columns]
    level = max(float(tip[2]), float(bottom))
    is_cut = is_covered & (part > level + _TOUCH)
    part[is_cut] = level
    return bool(is_cut.any())


def _highest(
    heights: Float[np.ndarray, "x y"],
    x: Float[np.ndarray, " x"],
    y: Float[np.ndarray, " y"],
    tip: Float[np.ndarray, " 3"],
    radius: float,
) -> float:
    """Return the highest stock under the tool [m], minus infinity if none."""
    rows, columns, is_covered = _window(x, y, tip, radius)
    return float(np.max(heights[rows, columns][is_covered], initial=-np.inf))
