"""A record of a robot's cut: forces, or how far the tool was off its path."""

import functools
from typing import Literal

import numpy as np
from pydantic import Field, StrictBool, StrictStr

from ..._job import Job
from ...identification import CoupledStudy
from ...io import Quantity, TableReader
from ...settings.fields import Time
from ...units import FORCE, LENGTH
from .context import Context
from .fields import File
from .kind import IdentificationKind
from .schema import MeasuredTable

_VECTORS = {
    "force": Quantity.vector("F", "f|force|kraft", FORCE, "force"),
    "deviation": Quantity.vector("d", r"d|u|delta|dev\w*|defl\w*", LENGTH, "deviation"),
}


class CoupledTable(MeasuredTable):
    """`[coupled]`."""

    job: File = Field(description='job that was run, such as "part.toml"')
    file: File = Field(description='forces or deviations over time, such as "run.csv"')
    fit: list[StrictStr] | None = Field(
        default=None,
        description='parameters that are fitted, such as ["K", "D"], "K axis_1" or '
        '"K_tc"; if left out stiffness and damping of all joints, and with forces the '
        "coefficients",
    )
    has_offset: StrictBool = Field(
        default=False,
        description="true: a constant deviation is fitted too, as of a tracker",
    )
    has_time_shift: StrictBool = Field(
        default=False, description="true: a small shift of the clock is fitted too"
    )
    time_shift: Time | None = Field(
        default=None,
        description='known time of the job minus time of the record, such as "1.2 s"; '
        "0 if left out",
    )
    loss: Literal["squares", "huber"] = Field(
        default="huber",
        description="how errors count; huber is for records with gross errors",
    )


def _read(
    name: str, context: Context, *, coupled: CoupledTable | None = None
) -> CoupledStudy | None:
    """Study of a record of a robot's cut, or None with problems noted.

    Args:
        name: The file that asks for it.
        context: Folder and problems.
        coupled: `[coupled]`.
    """
    table = coupled
    if table is None:
        return None
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
    build = functools.partial(_study, name=name, table=table, job=job)
    study = context.read(table, "[coupled]", build)
    return None if context.problems else study


def _study(
    reader: TableReader, name: str, table: CoupledTable, job: Job | None
) -> CoupledStudy | None:
    """Study of the times, forces and deviations of a record; None without a job.

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
    if job is None:
        return None
    force, deviation = (None if v is None else v[good] for v in parts.values())
    return CoupledStudy(
        name=name,
        job=job,
        time=time[good] + (table.time_shift or 0.0),
        force=force,
        deviation=deviation,
        fit=None if table.fit is None else tuple(table.fit),
        has_offset=table.has_offset,
        has_time_shift=table.has_time_shift,
        loss=table.loss,
        notes=tuple(reader.notes),
        channels=tuple(reader.read),
    )


KIND = IdentificationKind(
    "coupled", required={"coupled": CoupledTable}, optional={}, read=_read
)
