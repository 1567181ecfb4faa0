"""A record of a robot's cut: forces, or how far the tool was off its path."""

import pathlib

import numpy as np

from ... import units as q
from ...io import TIME_NAMES, RecordError, check_keys, column_of, read_table
from ...sim import parameter_names
from .._build.program import file_in_folder
from .._load_job import JobError, load_job
from .force_records import LARGEST_RECORD
from .schema import CoupledTable
from .tasks import CoupledTask

_PARTS = r"[\s_.\-]*"
_GROUPS = {
    "force": (q.FORCE, "F", "f|force|kraft"),
    "deviation": (q.LENGTH, "d", r"d|u|delta|dev\w*|defl\w*"),
}


def read_coupled(
    name: str,
    table: CoupledTable,
    folder: pathlib.Path,
    problems: list[str],
    *,
    allow_outside: bool,
) -> CoupledTask | None:
    """Return a record of a robot's cut, or None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[coupled]`.
        folder: Folder of the file.
        problems: Receives what is wrong.
        allow_outside: Whether files may lie outside that folder.
    """
    paths = [
        file_in_folder(
            text,
            f"[coupled] {key}",
            folder,
            problems,
            allow_outside=allow_outside,
            largest=LARGEST_RECORD,
        )
        for key, text in (("job", table.job), ("file", table.file))
    ]
    job = None
    if paths[0] is not None:
        try:
            job = load_job(paths[0], allow_outside=allow_outside)
        except JobError as error:
            problems.extend(f"[coupled] job: {table.job}: {x}" for x in error.problems)
    if job is not None and job.robot is None:
        problems.append("[coupled] job: found rigid = true, but a robot is required")
        job = None
    if job is not None:
        known = (*parameter_names(job), "K", "D")
        for one in table.fit or ():
            if one not in known:
                problems.append(
                    f"[coupled] fit: found {one!r}; allowed: {', '.join(known)}"
                )
    found = _columns(paths[1], table, problems)
    if job is None or found is None or problems:
        return None
    time, force, deviation, notes = found
    return CoupledTask(
        name=name,
        job=job,
        time=time + (table.time_shift or 0.0),
        force=force,
        deviation=deviation,
        fit=None if table.fit is None else tuple(table.fit),
        has_offset=table.has_offset,
        has_time_shift=table.has_time_shift,
        loss=table.loss,
        notes=tuple(notes),
    )


def _columns(
    path: pathlib.Path | None, table: CoupledTable, problems: list[str]
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, list[str]] | None:
    """Return time, forces, deviations and notes."""
    if path is None:
        return None
    faults: list[str] = []
    try:
        found = read_table(path)
    except (RecordError, OSError) as error:
        lines = error.faults if isinstance(error, RecordError) else (str(error),)
        problems.extend(f"[coupled] file: {table.file}: {line}" for line in lines)
        return None
    notes, wanted = list(found.notes), dict(table.channels or {})
    known = ["time", *(f"{g[1]}{a}" for g in _GROUPS.values() for a in "xyz")]
    check_keys("channel", wanted, known, faults)
    check_keys("unit of", table.units, ("time", *_GROUPS), faults)
    unit = table.units.get("time")
    time = column_of(found, "time", (q.TIME,), TIME_NAMES, wanted, faults, notes, unit)
    parts: dict[str, np.ndarray | None] = {}
    for name, (kind, letter, words) in _GROUPS.items():
        columns = [
            column_of(
                found,
                f"{letter}{a}",
                (kind,),
                rf"({words}){_PARTS}{a}|{a}{_PARTS}({words})",
                wanted,
                faults,
                notes,
                table.units.get(name),
            )
            for a in "xyz"
        ]
        given = [one for one in columns if one is not None]
        parts[name] = None
        if given:
            empty = np.full(len(given[0]), np.nan)
            both = [empty if one is None else one for one in columns]
            parts[name] = np.column_stack(both)
    if not faults and (time is None or all(one is None for one in parts.values())):
        names = ", ".join(f"`{column.name}`" for column in found.columns)
        faults.append(
            "found no column for time, or neither forces Fx, Fy, Fz nor deviations dx, "
            f"dy, dz, among {names}; name them with `channels`."
        )
    if time is not None and not faults:
        good = np.isfinite(time)
        if good.sum() < 12 or not np.all(np.diff(time[good]) > 0):
            faults.append("the time must increase over at least 12 rows, but does not.")
        time = time[good]
        parts = {k: None if v is None else v[good] for k, v in parts.items()}
    problems.extend(f"[coupled] file: {table.file}: {fault}" for fault in faults)
    if faults or time is None:
        return None
    return time, parts["force"], parts["deviation"], notes
