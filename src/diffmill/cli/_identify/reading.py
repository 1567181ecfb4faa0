"""Records and columns as they were read, in words."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...identification import ForceRecord, Record

# Units of display and their factor from SI.
_DISPLAYED = {"m": ("mm", 1e3), "rad": ("deg", 180 / math.pi), "1/s": ("Hz", 1.0)}
# Lengths below that are displayed in micrometres [m].
_SMALL = 1e-4


def channel_lines(channels: Sequence[Record.Channel]) -> list[str]:
    """Columns with their units and ranges, one a line.

    Args:
        channels: The columns that were read.
    """
    lines = []
    width = max((len(one.quantity) for one in channels), default=0)
    for one in channels:
        unit = one.unit or ("no unit" if one.si_unit else "any unit")
        values = np.array([one.lowest, one.highest])
        lines.append(
            f"    {one.quantity:{width}}  column `{one.column}` [{unit}]: "
            f"{range_text(values, one.si_unit)}"
        )
    return lines


def tare_lines(record: ForceRecord) -> list[str]:
    """Offset, drift and noise of a record by its channels, as recorded.

    Args:
        record: The record.
    """
    tare = record.tare
    if tare is None:
        return ["  offset taken away: none; the noise is not known"]
    lines = [
        f"  offset taken away: {_forces(record, tare.offset)} N at {tare.instant:.4g} s"
    ]
    if np.any(tare.drift):
        lines.append(f"  drift taken away: {_forces(record, tare.drift)} N/s")
    noise = _forces(record, tare.noise)
    return [*lines, f"  noise where nothing is cut: {noise} N rms"]


def _forces(record: ForceRecord, values: Float[np.ndarray, " 3"]) -> str:
    """Numbers of the forces that were measured."""
    seen = zip("xyz", values, record.record.is_measured, strict=True)
    return ", ".join(f"F{axis} {v:.3g}" for axis, v, is_seen in seen if is_seen)


def range_text(values: Float[np.ndarray, "..."], unit: str) -> str:
    """Range of numbers in SI, in the unit that is displayed."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "no number"
    shown, factor = _DISPLAYED.get(unit, (unit, 1.0))
    if unit == "m" and np.abs(known).max() < _SMALL:
        shown, factor = "um", 1e6
    low, high = factor * float(known.min()) + 0.0, factor * float(known.max()) + 0.0
    return f"{low:.4g} to {high:.4g} {shown}".rstrip()


def note_lines(notes: Sequence[str], indent: int = 2) -> list[str]:
    """Notes, one a line."""
    return [f"{' ' * indent}note: {note}" for note in notes]


def reading_lines(one: ForceRecord) -> list[str]:
    """Part, channels, tare and notes of a record of forces, line by line."""
    record = one.record
    return [
        f"  {one.name}: cut from {one.start:.4g} to {one.stop:.4g} s at "
        f"{record.rate:g} Hz, {int(one.is_used().sum())} of {len(record.time)} samples",
        *channel_lines(record.channels),
        *(f"  {line}" for line in tare_lines(one)),
        *note_lines(one.notes, 4),
    ]
