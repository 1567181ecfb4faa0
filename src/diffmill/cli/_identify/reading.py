"""Measurements as they were read, in words: before a fit, and beside one."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, assert_never

import numpy as np
from jaxtyping import Float

from ...identification import (
    ControllerStudy,
    CoupledStudy,
    ForceRecord,
    ForceRecordStudy,
    FrequencyResponse,
    LoadTestStudy,
    MeanForceStudy,
    ModeStudy,
    Record,
    RingDown,
)

if TYPE_CHECKING:
    from ...config import Study

# Units of display and their factor from SI.
_DISPLAYED = {"m": ("mm", 1e3), "rad": ("deg", 180 / math.pi), "1/s": ("Hz", 1.0)}
# Lengths below that are displayed in micrometres [m].
_SMALL = 1e-4


def study_lines(study: "Study") -> list[str]:
    """Return what a file for `diffmill identify` holds, line by line.

    Args:
        study: The study, its measurements read.
    """
    if isinstance(study, ForceRecordStudy):
        return [line for one in study.records for line in _record_lines(one)]
    if isinstance(study, MeanForceStudy):
        return _mean_lines(study)
    if isinstance(study, LoadTestStudy):
        head = f"  {len(study.rows)} load tests of {study.robot.name}"
        return [head, *channel_lines(study.channels), *_notes(study.notes, 2)]
    if isinstance(study, ModeStudy):
        return [line for one in study.measured for line in _vibration_lines(one)]
    if isinstance(study, CoupledStudy):
        first, last = float(study.time[0]), float(study.time[-1])
        return [
            f"  {len(study.time)} rows from {first:.4g} to {last:.4g} s on the clock "
            "of the job",
            *channel_lines(study.channels),
            *_notes(study.notes, 2),
        ]
    if isinstance(study, ControllerStudy):
        return _controller_lines(study)
    assert_never(study)


def channel_lines(channels: Sequence[Record.Channel]) -> list[str]:
    """Return columns with their units and ranges, one a line.

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
            f"{_range_text(values, one.si_unit)}"
        )
    return lines


def tare_lines(record: ForceRecord) -> list[str]:
    """Return offset, drift and noise of a record by its channels, as recorded.

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
    """Return a number for each force that was measured."""
    seen = zip("xyz", values, record.record.is_measured, strict=True)
    return ", ".join(f"F{axis} {v:.3g}" for axis, v, is_seen in seen if is_seen)


def _range_text(values: Float[np.ndarray, "..."], unit: str) -> str:
    """Return the range of numbers in SI, in the unit that is displayed."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "no number"
    shown, factor = _DISPLAYED.get(unit, (unit, 1.0))
    if unit == "m" and np.abs(known).max() < _SMALL:
        shown, factor = "um", 1e6
    low, high = factor * float(known.min()) + 0.0, factor * float(known.max()) + 0.0
    return f"{low:.4g} to {high:.4g} {shown}".rstrip()


def _notes(notes: Sequence[str], indent: int) -> list[str]:
    return [f"{' ' * indent}note: {note}" for note in notes]


def _record_lines(one: ForceRecord) -> list[str]:
    """Return what a record of forces holds."""
    record = one.record
    return [
        f"  {one.name}: cut from {one.start:.4g} to {one.stop:.4g} s at "
        f"{record.rate:g} Hz, {int(one.is_used().sum())} of {len(record.time)} samples",
        *channel_lines(record.channels),
        *(f"  {line}" for line in tare_lines(one)),
        *_notes(one.notes, 4),
    ]


def _mean_lines(study: MeanForceStudy) -> list[str]:
    """Return what mean forces over the feed are of."""
    lines = [line for one in study.records for line in _record_lines(one)]
    lines.append(
        f"  mean forces at {len(study.feed_per_tooth)} feeds, "
        f"{_range_text(study.feed_per_tooth, 'm')} per tooth"
    )
    lines += channel_lines(study.channels)
    if not study.channels:
        lines += [
            f"    mean F{axis}: {_range_text(force, 'N')}"
            for axis, force in zip("xyz", study.mean_force.T, strict=True)
        ]
    return lines + _notes(study.notes, 2)


def _vibration_lines(one: RingDown | FrequencyResponse) -> list[str]:
    """Return what a ring-down or a frequency response holds."""
    if isinstance(one, RingDown):
        head = (
            f"  {one.name}: {len(one.time)} samples from {one.time[0]:.4g} to "
            f"{one.time[-1]:.4g} s"
        )
    else:
        low, high = one.frequency[[0, -1]].tolist()
        head = (
            f"  {one.name}: {one.quantity}, {len(one.frequency)} lines from {low:.4g} "
            f"to {high:.4g} Hz, {int(one.is_fitted.sum())} of them fitted"
        )
    head += f", modes sought: {one.mode_count}"
    return [head, *channel_lines(one.channels), *_notes(one.notes, 4)]


def _controller_lines(study: ControllerStudy) -> list[str]:
    """Return what two paths in the air hold."""
    rows, step = study.is_recorded, study.time_step
    lines = [
        f"  {int(rows.sum())} rows every {step * 1e3:.3g} ms, "
        f"{step * max(len(rows) - 1, 0):.4g} s"
    ]
    for what, tips in (
        ("commanded", study.commanded),
        ("actual", study.actual[rows]),
        ("actual less commanded", (study.actual - study.commanded)[rows]),
    ):
        parts = [
            f"{axis} {_range_text(values, 'm')}"
            for axis, values in zip("xyz", tips.T, strict=True)
        ]
        lines.append(f"    {what}: {', '.join(parts)}")
    return lines + _notes(study.notes, 2)
