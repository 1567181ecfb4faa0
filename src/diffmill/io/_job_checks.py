"""Checks of a job that need more than one value: rapid moves, depth."""

import numpy as np

from ..cutter import AbstractCutter
from ..toolpath import Path
from ._job_stock import StockPlan
from ._rapid_check import rigid_pass, rigid_pass_of_stock

# Above this share of the radius the chip's entry is too coarse to trust.
_COARSE = 0.05


def check_rapids(
    path: Path, cutter: AbstractCutter, plan: StockPlan, problems: list[str]
) -> None:
    """Note rapid moves that go through stock, once per program line."""
    radius = cutter.nominal_radius
    if plan.stock is None:
        found = rigid_pass(path, radius, plan.lower, plan.upper, plan.spacing)
    else:
        found = rigid_pass_of_stock(path, radius, plan.stock)
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


def immersion(path: Path, cutter: AbstractCutter, stock: StockPlan) -> float:
    """Return how deep the path takes the tip below the top of the stock [m]."""
    tips, radius = np.asarray(path.positions), cutter.nominal_radius
    low, high = stock.lower, stock.upper
    is_over = ((tips > low - radius) & (tips < high + radius))[:, :2].all(axis=1)
    return float(np.max(high[2] - tips[is_over, 2], initial=0.0))


def notes(stock: StockPlan, path: Path, cutter: AbstractCutter) -> tuple[str, ...]:
    """Return what is worth knowing but no fault."""
    notes = []
    coarse = _COARSE * cutter.nominal_radius
    if stock.spacing > coarse:
        notes.append(
            f"[stock] spacing is {stock.spacing * 1e3:g} mm; above 0.05 of the radius "
            f"({coarse * 1e3:g} mm) forces lose accuracy"
        )
    if not np.allclose(path.axes, [0.0, 0.0, 1.0], atol=1e-6):
        notes.append(
            "the tool axis tilts; rapid moves were checked as if the tool stood upright"
        )
    depth = immersion(path, cutter, stock)
    if depth > cutter.flute_length:
        notes.append(
            f"the path goes {depth * 1e3:g} mm below the top of the stock, deeper than "
            f"the flutes ({cutter.flute_length * 1e3:g} mm): shank_volume in the "
            "result says what its shank would have to take"
        )
    if depth <= 0:
        notes.append("the path never goes below the top of the stock: nothing is cut")
    return tuple(notes)
