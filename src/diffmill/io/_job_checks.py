"""Checks of a job that need more than one value: memory, rapid moves, depth."""

import math
import os

import numpy as np

from ..cutter import AbstractCutter
from ..toolpath import Path
from ._job_schema import SimulationTable, StockTable
from ._rapid_check import rigid_pass

# Empty rays on each side of a box, as `diffmill.workpiece.box` adds them.
_MARGIN = 4
# Above this share of the radius the chip's entry is too coarse to trust.
_COARSE = 0.05


def stock_bytes(table: StockTable, precision: str) -> float:
    """Return the memory that a stock will take [byte], before it is made."""
    size = np.asarray(table.upper) - np.asarray(table.lower)
    counts = np.maximum(np.round(size / table.spacing), 1) + 2 * _MARGIN
    number = 8 if precision == "float64" else 4
    total = 0.0
    for family, slots in enumerate(table.intervals):
        rays = float(counts[(family + 1) % 3]) * float(counts[(family + 2) % 3])
        # Two ends as numbers, and for each the index of the pose that cut it.
        total += rays * slots * 2 * (number + 4)
    return total


def _physical_memory() -> float:
    """Return the memory of this machine [byte]; infinite where it does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return math.inf


def check_stock(
    table: StockTable | None, simulation: SimulationTable | None, problems: list[str]
) -> None:
    """Note an empty box, and one too large for this machine."""
    if table is None:
        return
    is_box = True
    for axis, low, high in zip("xyz", table.lower, table.upper, strict=True):
        if high <= low:
            is_box = False
            problems.append(
                f"[stock] upper: found {high * 1e3:g} mm in {axis}, but more than "
                f"lower ({low * 1e3:g} mm) is required"
            )
    precision = "float64" if simulation is None else simulation.precision
    needed, limit = stock_bytes(table, precision), _physical_memory() / 2
    if is_box and needed > limit:
        problems.append(
            f"[stock] spacing: found {table.spacing * 1e3:g} mm, for which the stock "
            f"takes {needed / 1e9:.3g} GB; at most half of the physical memory, "
            f"{limit / 1e9:.3g} GB, is allowed: take a larger spacing, a smaller box "
            "or float32"
        )


def _is_box_usable(table: StockTable, precision: str) -> bool:
    is_box = all(h > l for l, h in zip(table.lower, table.upper, strict=True))
    return is_box and stock_bytes(table, precision) <= _physical_memory() / 2


def check_rapids(
    path: Path, cutter: AbstractCutter, table: StockTable, problems: list[str]
) -> None:
    """Note rapid moves that go through stock, once per program line."""
    if not _is_box_usable(table, "float64"):
        return
    found = rigid_pass(
        path,
        cutter.nominal_radius,
        np.asarray(table.lower),
        np.asarray(table.upper),
        table.spacing,
    )
    lines = np.asarray(path.line)
    rows = np.flatnonzero(found.is_crash)
    _, first = np.unique(lines[rows], return_index=True)
    for k in rows[np.sort(first)]:
        x, y, z = np.asarray(path.positions)[k] * 1e3
        place = f"line {int(lines[k])}, " if lines[k] else ""
        problems.append(
            f"[program] file: {place}time {float(path.time[k]):.3f} s: found a rapid "
            f"move through the stock at ({x:.3f}, {y:.3f}, {z:.3f}) mm, "
            f"{found.depth[k] * 1e3:.3f} mm deep; rapid moves are allowed only clear "
            "of the stock"
        )


def immersion(path: Path, cutter: AbstractCutter, stock: StockTable) -> float:
    """Return how deep the path takes the tip below the top of the stock [m]."""
    tips, radius = np.asarray(path.positions), cutter.nominal_radius
    low, high = np.asarray(stock.lower), np.asarray(stock.upper)
    is_over = ((tips > low - radius) & (tips < high + radius))[:, :2].all(axis=1)
    return float(np.max(high[2] - tips[is_over, 2], initial=0.0))


def notes(stock: StockTable, path: Path, cutter: AbstractCutter) -> tuple[str, ...]:
    """Return what is worth knowing but no fault."""
    notes = []
    coarse = _COARSE * cutter.nominal_radius
    if stock.spacing > coarse:
        notes.append(
            f"[stock] spacing is {stock.spacing * 1e3:g} mm; above 0.05 of the radius "
            f"({coarse * 1e3:g} mm) forces lose accuracy"
        )
    depth = immersion(path, cutter, stock)
    if depth > cutter.flute_length:
        notes.append(
            f"the path goes {depth * 1e3:g} mm below the top of the stock, deeper than "
            f"the flutes ({cutter.flute_length * 1e3:g} mm); the shank is not checked"
        )
    if depth <= 0:
        notes.append("the path never goes below the top of the stock: nothing is cut")
    return tuple(notes)
