"""A record of a robot's cut: forces, or how far the tool was off its path."""

from typing import NamedTuple

import numpy as np

from ...identification import CoupledStudy, Record
from ...io import Quantity, TableReader
from ...units import FORCE, LENGTH
from .context import Context
from .schema import CoupledTable

_VECTORS = {
    "force": Quantity.vector("F", "f|force|kraft", FORCE, "force"),
    "deviation": Quantity.vector("d", r"d|u|delta|dev\w*|defl\w*", LENGTH, "deviation"),
}


class _Columns(NamedTuple):
    """Time, forces and deviations of a record, and what was assumed."""

    time: np.ndarray
    force: np.ndarray | None
    deviation: np.ndarray | None
    notes: tuple[str, ...]
    channels: tuple[Record.Channel, ...]


def read_coupled(
    name: str, table: CoupledTable, context: Context
) -> CoupledStudy | None:
    """Return a record of a robot's cut, or None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[coupled]`.
        context: Folder and problems.
    """
    job = context.job(table.job, "[coupled] job")
    if job is not None and job.robot is None:
        context.problems.append(
            "[coupled] job: found rigid = true, but a robot is required"
        )
    elif job is not None:
        known = (*job.parameter_names, "K", "D")
        context.problems.extend(
            f"[coupled] fit: found {one!r}; allowed: {', '.join(known)}"
            for one in table.fit or ()
            if one not in known
        )
    found = context.read(table, "[coupled]", _columns)
    if job is None or found is None or context.problems:
        return None
    return CoupledStudy(
        name=name,
        job=job,
        time=found.time + (table.time_shift or 0.0),
        force=found.force,
        deviation=found.deviation,
        fit=None if table.fit is None else tuple(table.fit),
        has_offset=table.has_offset,
        has_time_shift=table.has_time_shift,
        loss=table.loss,
        notes=found.notes,
        channels=found.channels,
    )


def _columns(reader: TableReader) -> _Columns:
    """Return time, forces and deviations.

    Raises:
        RecordError: Nothing of it can be fitted.
    """
    reader.allow((reader.TIME, *_VECTORS["force"], *_VECTORS["deviation"]))
    time = reader.values(reader.TIME)
    parts: dict[str, np.ndarray | None] = {}
    for name, quantities in _VECTORS.items():
        columns = [reader.values(quantity) for quantity in quantities]
        given = [one for one in columns if one is not None]
        parts[name] = None
        if given:
            empty = np.full(len(given[0]), np.nan)
            both = [empty if one is None else one for one in columns]
            parts[name] = np.column_stack(both)
    if not reader.faults and (
        time is None or all(one is None for one in parts.values())
    ):
        reader.faults.append(
            "found no column for time, or neither forces Fx, Fy, Fz nor deviations dx, "
            f"dy, dz, among {reader.listed()}; name them with `channels`."
        )
    reader.check()
    assert time is not None
    good = np.isfinite(time)
    if good.sum() < 12 or not np.all(np.diff(time[good]) > 0):
        reader.faults.append(
            "the time must increase over at least 12 rows, but does not."
        )
    reader.check()
    force, deviation = (None if v is None else v[good] for v in parts.values())
    notes, channels = tuple(reader.notes), tuple(reader.read)
    return _Columns(time[good], force, deviation, notes, channels)
