"""Checks of the whole tool along the path: rapid moves, holder, shank."""

import numpy as np
from jaxtyping import Bool, Float

from ...cutter import AbstractCutter, ToolHolder
from ...sim import ToolContacts
from ...toolpath import Path
from .._build.context import FileContext
from .._build.stock import StockPlan
from .._schema.cutter import CutterTable
from .._schema.job import RobotTable
from .reach import at_row

# Lengths that a job states twice [m], and volumes that are rounding [m^3].
_SAME_LENGTH, _NO_VOLUME = 1e-9, 1e-15


def check_overhang(
    tool: CutterTable | None, robot: RobotTable | None, problems: list[str]
) -> None:
    """Fault of a cutter with two different overhangs."""
    own = None if tool is None else tool.overhang
    bending = None if robot is None else robot.bending_tool
    if own is not None and bending is not None:
        if abs(own - bending.overhang) > _SAME_LENGTH:
            problems.append(
                f"[cutter] overhang: found {own * 1e3:g} mm, but [robot.bending_tool] "
                f"overhang is {bending.overhang * 1e3:g} mm; make them equal"
            )


def check_rapids(
    path: Path,
    cutter: AbstractCutter,
    holder: ToolHolder | None,
    plan: StockPlan,
    context: FileContext,
) -> None:
    """Faults of rapid moves through the stock, notes of a start in it and a holder."""
    contacts = ToolContacts.along(path, plan.make(), cutter, holder)
    if holder is not None:
        # A holder that is drawn straight back goes into nothing new.
        is_rapid = np.asarray(path.is_rapid) & ~_draws_back(path)
        in_rapid = np.where(is_rapid, contacts.holder_depth, 0)
        _note_rapids(path, in_rapid, " of the tool holder", context.problems)
        context.notes.extend(holder_notes(path, contacts))
    in_rapid = contacts.rapid_depth.copy()
    if (depth := float(in_rapid[0])) > 0:
        context.notes.append(
            f"[program] file: {at_row(path, 0)}: the tool starts in the material, "
            f"{depth * 1e3:.3f} mm deep; what it overlaps there is gone without a "
            "force: start it clear of the stock"
        )
    in_rapid[0] = 0
    in_rapid[_ends_feed(path, in_rapid)] = 0
    _note_rapids(path, in_rapid, "", context.problems)


def _ends_feed(
    path: Path, depth: Float[np.ndarray, " step"]
) -> Bool[np.ndarray, " step"]:
    """True in first rows of rapid moves no deeper than the feed before them goes.

    Part of the way to such a row is the end of a feed, as at the bottom of a hole.
    """
    tips = np.asarray(path.positions, float)
    lengths = np.linalg.norm(np.diff(tips, axis=0, prepend=tips[:1]), axis=1)
    is_first = np.diff(path.is_rapid, prepend=False) & path.is_rapid
    return is_first & (depth <= np.roll(lengths, 1) + _SAME_LENGTH)


def _draws_back(path: Path) -> Bool[np.ndarray, " step"]:
    """True in rows to which the tool moves along its axis, or not at all.

    The first row of a rapid move counts too: part of the way to it is a feed.
    """
    tips, axes = np.asarray(path.positions, float), np.asarray(path.axes, float)
    moves = np.diff(tips, axis=0, prepend=tips[:1])
    turns = np.diff(axes, axis=0, prepend=axes[:1])
    along = np.sum(moves * axes, axis=1)
    away = np.linalg.norm(moves, axis=1) - along
    is_back = (away < _SAME_LENGTH) & (np.abs(turns).max(axis=1) < _SAME_LENGTH)
    return is_back | (np.diff(path.is_rapid, prepend=False) & path.is_rapid)


def _note_rapids(
    path: Path, depth: Float[np.ndarray, " step"], what: str, problems: list[str]
) -> None:
    """Faults of rapid moves through the stock: the first row of each program line."""
    lines = np.asarray(path.line)
    rows = np.flatnonzero(depth > 0)
    _, first = np.unique(lines[rows], return_index=True)
    for k in rows[np.sort(first)]:
        x, y, z = np.asarray(path.positions)[k] * 1e3
        place = f"line {int(lines[k])}, " if lines[k] else ""
        problems.append(
            f"[program] file: {place}time {float(path.time[k]):.3f} s: found a rapid "
            f"move{what} through the stock at ({x:.3f}, {y:.3f}, {z:.3f}) mm, "
            f"{depth[k] * 1e3:.3f} mm deep; rapid moves are allowed only clear "
            "of the stock"
        )


def tool_notes(
    path: Path, shank_volume: Float[np.ndarray, " step"], contacts: ToolContacts | None
) -> tuple[str, ...]:
    """Notes of the shank and the holder in the stock.

    Args:
        path: The path.
        shank_volume: Volume of stock within the shank [m^3], shape (step,).
        contacts: Contacts of the holder along the path; None without a holder.

    Returns:
        Nothing, or one line each for the shank and for the holder.
    """
    shank = _shank_notes(path, shank_volume)
    return shank if contacts is None else shank + holder_notes(path, contacts)


def holder_notes(path: Path, contacts: ToolContacts) -> tuple[str, ...]:
    """Note of the tool holder in the stock.

    Args:
        path: The path.
        contacts: Contacts of the holder along it.

    Returns:
        Nothing, or one line: the first place, the deepest contact, how many rows, and
        how deep the holder is in what is left after the path.
    """
    depth = contacts.holder_depth
    rows = np.flatnonzero(depth > 0)
    if rows.size == 0:
        return ()
    left = float(contacts.holder_part_depth.max())
    after = (
        f"{left * 1e3:.3f} mm deep in what is left at the end"
        if left > 0
        else "all of it in stock that is removed later"
    )
    return (
        f"[cutter] holder: {at_row(path, int(rows[0]))}: the tool holder is in "
        f"the stock, first here, in {rows.size} of {path.step_count} rows, up to "
        f"{float(depth.max()) * 1e3:.3f} mm deep; {after}",
    )


def _shank_notes(path: Path, volume: Float[np.ndarray, " step"]) -> tuple[str, ...]:
    """Note of the shank above the flutes in the stock.

    Args:
        path: The path.
        volume: Volume of stock within the shank [m^3], shape (step,).

    Returns:
        Nothing, or one line: the first place, the volume, and how many rows.
    """
    rows = np.flatnonzero(volume > _NO_VOLUME)
    if rows.size == 0:
        return ()
    return (
        f"[cutter] flute_length: {at_row(path, int(rows[0]))}: the shank above "
        f"the flutes is in the stock, first here, in {rows.size} of {path.step_count} "
        f"rows; it would have to take {float(volume.sum()) * 1e9:.3g} mm^3",
    )
