"""Reading a file for `diffmill identify`: all of its faults and its data at once."""

import os
import pathlib

import numpy as np

from ._identification.coupled import read_coupled
from ._identification.force_records import Context, read_force_record
from ._identification.load_tests import read_load_tests
from ._identification.mean_forces import mean_force_task
from ._identification.modal import read_frequency_response, read_ring_down
from ._identification.robot import read_tool_robot
from ._identification.schema import (
    CutTable,
    FitTable,
    MeansTable,
    RecordTable,
    read_identification_tables,
)
from ._identification.tasks import (
    ForceRecord,
    ForceRecordTask,
    ForceSettings,
    LoadTestTask,
    MeanForceTask,
    ModeTask,
    Task,
)
from ._load_job import JobError, load_job, read_toml
from ._schema.cutter import make_cutter


def load_identification(
    file: str | os.PathLike[str],
    forces: str | os.PathLike[str] | None = None,
    *,
    allow_outside: bool = False,
) -> Task:
    """Return what a TOML file asks to be identified, its measurements read.

    Args:
        file: The file, with `kind = "mean_forces"`, "force_records", "load_tests",
            "ring_down", "frequency_response" or "coupled"; or a job, if `forces` is
            given.
        forces: A record of forces of the job, wherever it lies.
        allow_outside: Whether the file may name files outside its own folder.

    Returns:
        The task in SI units.

    Raises:
        JobError: If anything is wrong with the file or with a measurement. All is
            listed at once.

    **Differentiability**: not applicable, a host function.
    """
    path = pathlib.Path(file)
    _, raw = read_toml(path)
    if forces is not None:
        return _of_job(path, raw, pathlib.Path(forces), allow_outside=allow_outside)
    problems: list[str] = []
    if "kind" not in raw and "program" in raw:
        raise JobError(
            path,
            [
                "kind: found a job; give the file of its measured forces after it, or "
                'a file with kind = "force_records" that names both'
            ],
        )
    kind, tables = read_identification_tables(raw, problems)
    task: Task | None = None
    if kind in ("mean_forces", "force_records"):
        task = _forces(path, kind, tables, problems, allow_outside)
    elif kind == "load_tests":
        task = _loads(path, tables, problems, allow_outside)
    elif kind == "coupled" and "coupled" in tables:
        task = read_coupled(
            path.stem,
            tables["coupled"],
            path.parent,
            problems,
            allow_outside=allow_outside,
        )
    elif kind in ("ring_down", "frequency_response"):
        task = _modes(path, kind, tables, problems, allow_outside)
    if problems or task is None:
        raise JobError(path, problems)
    return task


def _of_job(
    path: pathlib.Path,
    raw: dict[str, object],
    forces: pathlib.Path,
    *,
    allow_outside: bool,
) -> ForceRecordTask:
    """Return the task of one record of a job."""
    if "kind" in raw:
        raise JobError(
            path,
            [
                f"kind: found beside the argument {forces.name}; with a file of forces "
                "a job is required"
            ],
        )
    if not forces.is_file():
        raise JobError(
            path, [f"found no file {forces}, but measured forces are needed"]
        )
    job = load_job(path, allow_outside=allow_outside)
    context = Context(forces.parent, True, None, None, None, {path.resolve(): job})
    problems: list[str] = []
    table = RecordTable(file=forces.name, job=os.fspath(path.resolve()))
    record = read_force_record(table, "record", context, problems)
    if record is None or problems:
        raise JobError(forces, problems)
    return ForceRecordTask(path.stem, (record,), _settings(FitTable()))


def _settings(table: FitTable) -> ForceSettings:
    """Return how forces are fitted."""
    axes = table.axes
    is_named = isinstance(axes, list)
    return ForceSettings(
        axes=(axes[0], axes[1], axes[2]) if is_named and axes is not None else None,
        takes_proposed=axes == "proposed",
        loss=table.loss,
        refine=tuple(table.refine),
        shift_range=table.shift_range,
        lowpass=table.lowpass,
        refines_speed=table.refine_speed,
    )


def _forces(
    path: pathlib.Path,
    kind: str,
    tables: dict[str, object],
    problems: list[str],
    allow_outside: bool,
) -> MeanForceTask | ForceRecordTask | None:
    """Return the task of mean forces or of whole records."""
    cutter = tables.get("cutter")
    spindle, cut, fit = (tables.get(key) for key in ("spindle", "cut", "fit"))
    context = Context(
        path.parent,
        allow_outside,
        None if cutter is None else make_cutter(cutter),  # pyright: ignore[reportArgumentType]
        getattr(spindle, "speed", None),
        cut if isinstance(cut, CutTable) else None,
        {},
    )
    entries = tables.get("record")
    records: list[ForceRecord] = []
    for place, entry in enumerate(entries if isinstance(entries, list) else (), 1):
        name = f"[[record]] {place}"
        _check_speed(kind, entry, context, name, problems)
        record = read_force_record(entry, name, context, problems)
        if record is not None:
            records.append(record)
    settings = _settings(fit if isinstance(fit, FitTable) else FitTable())
    if kind == "mean_forces" and settings.lowpass is not None:
        problems.append(
            "[fit] lowpass: found beside mean forces, which it does not change; "
            'allowed with kind = "force_records"'
        )
    if kind == "force_records":
        return ForceRecordTask(path.stem, tuple(records), settings)
    means = tables.get("means")
    return mean_force_task(
        path.stem,
        means if isinstance(means, MeansTable) else None,
        tuple(records),
        (context, settings, isinstance(entries, list)),
        problems,
    )


def _check_speed(
    kind: str,
    entry: RecordTable,
    context: Context,
    place: str,
    problems: list[str],
) -> None:
    """Note a straight cut without a spindle speed, or a job beside mean forces."""
    if kind == "mean_forces" and entry.job is not None:
        problems.append(
            f"{place} job: found beside mean forces, which are those of straight cuts; "
            'allowed with kind = "force_records"'
        )
    elif entry.job is None and (entry.speed or context.speed) is None:
        problems.append(
            f"{place} speed: found nothing, but it is required here or in [spindle] "
            'for a straight cut, such as "6000 rpm"'
        )


def _loads(
    path: pathlib.Path,
    tables: dict[str, object],
    problems: list[str],
    allow_outside: bool,
) -> LoadTestTask | None:
    """Return the task of load tests."""
    notes: list[str] = []
    robot = None
    if "robot" in tables:
        robot = read_tool_robot(
            tables["robot"],  # pyright: ignore[reportArgumentType]
            path.parent,
            problems,
            notes,
            allow_outside=allow_outside,
            needs_mass=False,
        )
    if robot is None or "load_tests" not in tables:
        return None
    return read_load_tests(
        path.stem,
        tables["load_tests"],  # pyright: ignore[reportArgumentType]
        robot,
        path.parent,
        problems,
        notes,
        allow_outside=allow_outside,
    )


def _modes(
    path: pathlib.Path,
    kind: str,
    tables: dict[str, object],
    problems: list[str],
    allow_outside: bool,
) -> ModeTask | None:
    """Return the task of ring-downs or frequency responses."""
    robot = None
    if "robot" in tables:
        robot = read_tool_robot(
            tables["robot"],  # pyright: ignore[reportArgumentType]
            path.parent,
            problems,
            [],
            allow_outside=allow_outside,
            needs_mass=True,
        )
        if robot is None:
            return None
        if np.isinf(np.asarray(robot.joint_stiffness)).all():
            problems.append(
                "[robot]: found no joint stiffness, but dampers follow from modes only "
                "with it: by joint_stiffness, or a file named by drives"
            )
    read = read_ring_down if kind == "ring_down" else read_frequency_response
    entries = tables.get(kind)
    found = [
        read(
            entry,
            f"[[{kind}]] {place}",
            robot,
            path.parent,
            problems,
            allow_outside=allow_outside,
        )
        for place, entry in enumerate(entries if isinstance(entries, list) else (), 1)
    ]
    good = tuple(one for one in found if one is not None)
    if not good or problems:
        return None
    return ModeTask(path.stem, robot, good)  # pyright: ignore[reportArgumentType]
