"""Notes on a job before it runs, of what is unusual and no fault."""

import math

import numpy as np
from jaxtyping import Bool, Float

from ...cutter import AbstractCutter
from ...toolpath import Path
from .._build.stock import StockPlan

# Above this share of the radius the chip's entry is too coarse to trust.
_COARSE = 0.05
# Lean of the cutter from +z above which it lies flat [deg].
_FLAT = 80.0
# Usual cutting speeds [m/s], and feeds per tooth [m], the largest as a share of the
# diameter: those of cutters for small depths and large feeds.
_SLOWEST, _FASTEST = 2.0 / 60, 3000.0 / 60
_LEAST_FEED, _MOST_FEED = 0.05e-6, 0.15
# Usual lengths of flutes and tools in diameters.
_LONGEST_FLUTES, _SHORTEST_FLUTES = 20.0, 0.1


def immersion(path: Path, cutter: AbstractCutter, stock: StockPlan) -> float:
    """Largest depth of the tip below the top of the stock [m]."""
    tips = np.asarray(path.positions)
    over = tips[_is_over(tips, cutter, stock), 2]
    return float(np.max(stock.upper[2] - over, initial=0.0))


def _is_over(
    tips: Float[np.ndarray, "step 3"], cutter: AbstractCutter, stock: StockPlan
) -> Bool[np.ndarray, " step"]:
    """True in rows where the cutter is over or in the stock, shape (step,)."""
    radius, low, high = cutter.nominal_radius, stock.lower, stock.upper
    is_beside = (tips > low - radius) & (tips < high + radius)
    return np.all(is_beside[:, :2], axis=1)


def notes(stock: StockPlan, path: Path, cutter: AbstractCutter) -> tuple[str, ...]:
    """Notes on spacing, sizes, run-out and depth."""
    notes = _posture_notes(path)
    coarse = _COARSE * cutter.nominal_radius
    if stock.spacing > coarse:
        notes.append(
            f"[stock] spacing is {stock.spacing * 1e3:g} mm; above 0.05 of the radius "
            f"({coarse * 1e3:g} mm) forces lose accuracy"
        )
    diameter = 2 * cutter.nominal_radius
    if diameter > max(stock.upper - stock.lower):
        spans = _span_mm(np.array([stock.lower, stock.upper]))
        notes.append(
            f"the cutter's diameter of {diameter * 1e3:g} mm is larger than the whole "
            f"stock, {spans}"
        )
    if cutter.has_runout:
        most = float(np.max(np.asarray(cutter.runout_offsets())))
        notes.append(
            "[cutter] runout: the tooth with the largest radius cuts "
            f"{most * 1e6:.3g} um farther at its tip; the machined surface shows it, "
            "but contour error and correction are those of the tool's axis"
        )
    depth = immersion(path, cutter, stock)
    if depth > cutter.flute_length:
        notes.append(
            f"the path goes {depth * 1e3:g} mm below the top of the stock, deeper than "
            f"the flutes ({cutter.flute_length * 1e3:g} mm): where the shank meets "
            "stock no force counts it, and errors come out too small; shank_volume in "
            "the result says where"
        )
    low = float(stock.lower[2])
    if depth > float(stock.upper[2]) - low:
        notes.append(
            f"the path goes {(depth - float(stock.upper[2]) + low) * 1e3:g} mm below "
            "the bottom of the stock, into what it lies on"
        )
    if depth <= 0:
        spans = [
            _span_mm(np.asarray(path.positions)),
            _span_mm(np.array([stock.lower, stock.upper])),
        ]
        notes.append(
            "nothing is cut: nowhere over the stock does the tip go below its top; the "
            f"path spans {spans[0]}, the stock {spans[1]}"
        )
    return tuple(notes)


def rate_notes(
    stock: StockPlan, path: Path, cutter: AbstractCutter, tooth_period: float
) -> tuple[str, ...]:
    """Notes on an unusual cutting speed, feed per tooth or flute length.

    Args:
        stock: The stock; moves beside and above it may be fast.
        path: The path, a row per tooth period.
        cutter: The cutter.
        tooth_period: Tooth period [s].
    """
    notes = []
    diameter = 2 * cutter.nominal_radius
    speed = math.pi * diameter / (tooth_period * cutter.flute_count)
    if not _SLOWEST <= speed <= _FASTEST:
        notes.append(
            f"[spindle] speed: a diameter of {diameter * 1e3:.4g} mm cuts at "
            f"{speed * 60:.4g} m/min; {_SLOWEST * 60:g} to {_FASTEST * 60:g} m/min are "
            "usual"
        )
    tips = np.asarray(path.positions, np.float64)
    is_feed = _is_over(tips, cutter, stock) & (tips[:, 2] < stock.upper[2])
    is_feed &= ~np.asarray(path.is_rapid, bool)
    # Part of the way to the first row of a move is one of the move before.
    feeds = np.linalg.norm(np.diff(tips, axis=0), axis=1)[is_feed[1:] & is_feed[:-1]]
    most = float(np.max(feeds, initial=0.0))
    largest = _MOST_FEED * diameter
    if feeds.size and not _LEAST_FEED <= most <= largest:
        notes.append(
            f"[program] file: the feed per tooth is up to {most * 1e3:.4g} mm; "
            f"{_LEAST_FEED * 1e3:g} mm to {largest * 1e3:.4g} mm are usual of a cutter "
            f"of {diameter * 1e3:.4g} mm: are feed, spindle speed and teeth what is "
            "meant?"
        )
    length = cutter.flute_length / diameter
    if not _SHORTEST_FLUTES <= length <= _LONGEST_FLUTES:
        notes.append(
            f"[cutter] flute_length: {length:.3g} times the diameter; "
            f"{_SHORTEST_FLUTES:g} to {_LONGEST_FLUTES:g} times are usual"
        )
    return tuple(notes)


def _posture_notes(path: Path) -> list[str]:
    """Note of a cutter that lies flat or points up where it moves at a feed."""
    is_cut = ~np.asarray(path.is_rapid, bool)
    axes = np.asarray(path.axes, np.float64)[is_cut if is_cut.any() else ~is_cut]
    lean = np.degrees(np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2]))
    most = float(lean.max())
    if most < _FLAT:
        return []
    posture = "lies flat" if most < 180 - _FLAT else "points up, its tip on top,"
    return [
        f"[program] file: the cutter {posture} where its axis, from tip to shank, "
        f"leans by {most:.1f} deg from +z of work; tool_axis says which axis of the "
        "tool points from the shank to the tip"
    ]


def _span_mm(points: Float[np.ndarray, "point 3"]) -> str:
    """Extents of points in mm, as text."""
    low, high = np.min(points, axis=0) * 1e3, np.max(points, axis=0) * 1e3
    spans = zip("xyz", low, high, strict=True)
    return ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in spans) + " mm"
