"""Reading a file for `diffmill identify`: all of its faults and its data at once."""

import os
import pathlib
from typing import TypeAlias

import numpy as np

from .._toml import JobError, read_toml
from ..identification import (
    ControllerStudy,
    CoupledStudy,
    ForceRecord,
    ForceRecordStudy,
    ForceSettings,
    LoadTestStudy,
    MeanForceStudy,
    ModeStudy,
)
from ._identification.air_path import read_air_path
from ._identification.context import Context
from ._identification.coupled import read_coupled
from ._identification.force_records import read_force_record
from ._identification.load_tests import read_load_tests
from ._identification.mean_forces import mean_force_task
from ._identification.modal import read_frequency_response, read_ring_down
from ._identification.robot import read_tool_robot
from ._identification.schema import (
    FitTable,
    IdentificationTables,
    RecordTable,
    read_identification_tables,
)
from ._load_job import load_job
from ._schema.cutter import make_cutter

Study: TypeAlias = (
    MeanForceStudy
    | ForceRecordStudy
    | LoadTestStudy
    | ModeStudy
    | CoupledStudy
    | ControllerStudy
)


def load_identification(
    file: str | os.PathLike[str],
    forces: str | os.PathLike[str] | None = None,
    *,
    allow_outside: bool = False,
) -> Study:
    """Return the study that a TOML file asks for, its measurements read.

    Args:
        file: The file, with `kind = "mean_forces"`, "force_records", "load_tests",
            "ring_down", "frequency_response", "coupled" or "controller"; or a job,
            if `forces` is given.
        forces: A record of forces of the job, wherever it lies.
        allow_outside: Whether the file may name files outside its own folder.

    Returns:
        The study in SI units; see its `run`.

    Raises:
        JobError: If anything is wrong with the file or with a measurement. All is
            listed at once.
    """
    path = pathlib.Path(file)
    raw = read_toml(path).tables
    if forces is not None:
        return _of_job(path, raw, pathlib.Path(forces), allow_outside=allow_outside)
    if "kind" not in raw and "program" in raw:
        raise JobError(
            path,
            [
                "kind: found a job; give the file of its measured forces after it, or "
                'a file with kind = "force_records" that names both'
            ],
        )
    problems: list[str] = []
    tables = read_identification_tables(raw, problems)
    kind = tables.kind
    context = Context(path.parent, allow_outside, problems, {})
    study: Study | None = None
    if kind in ("mean_forces", "force_records"):
        study = _forces(path.stem, tables, context)
    elif kind == "load_tests":
        study = _loads(path.stem, tables, context)
    elif tables.coupled is not None:
        study = read_coupled(path.stem, tables.coupled, context)
    elif tables.air_path is not None:
        study = read_air_path(path.stem, tables.air_path, context)
    elif kind in ("ring_down", "frequency_response"):
        study = _modes(path.stem, tables, context)
    if problems or study is None:
        raise JobError(path, problems)
    return study


def _of_job(
    path: pathlib.Path,
    raw: dict[str, object],
    forces: pathlib.Path,
    *,
    allow_outside: bool,
) -> ForceRecordStudy:
    """Return the study of one record of a job."""
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
    # The record may lie anywhere, and the job has been read.
    context = Context(forces.parent, True, [], {path.resolve(): job})
    table = RecordTable(file=forces.name, job=os.fspath(path.resolve()))
    record = read_force_record(table, "record", context)
    if record is None or context.problems:
        raise JobError(forces, context.problems)
    return ForceRecordStudy(path.stem, (record,), _settings(FitTable()))


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
        force_on=table.force_on,
    )


def _forces(
    name: str, tables: IdentificationTables, context: Context
) -> MeanForceStudy | ForceRecordStudy | None:
    """Return the study of mean forces or of whole records."""
    cutter, spindle = tables.cutter, tables.spindle
    are_means = tables.kind == "mean_forces"
    context = context._replace(
        cutter=None if cutter is None else make_cutter(cutter),
        speed=None if spindle is None else spindle.speed,
        cut=tables.cut,
    )
    records: list[ForceRecord] = []
    for number, entry in enumerate(tables.record or (), 1):
        place = f"[[record]] {number}"
        _check_speed(entry, context, place, are_means=are_means)
        record = read_force_record(entry, place, context)
        if record is not None:
            records.append(record)
    fit = FitTable() if tables.fit is None else tables.fit
    settings = _settings(fit)
    if settings.force_on == "workpiece":
        records = [one.reversed() for one in records]
    if not are_means:
        return ForceRecordStudy(name, tuple(records), settings)
    context.problems.extend(
        f"[fit] {key}: found beside mean forces, which it does not change; "
        'allowed with kind = "force_records"'
        for key in ("loss", "refine", "shift_range", "lowpass")
        if key in fit.model_fields_set
    )
    if tables.means is not None and "refine_speed" in fit.model_fields_set:
        context.problems.append(
            "[fit] refine_speed: found beside [means], which has no record to take the "
            "speed from; allowed with [[record]]"
        )
    given = None if tables.record is None else tuple(records)
    study = mean_force_task(name, tables.means, given, settings, context)
    if study is not None and given is None and settings.force_on == "workpiece":
        study = study._replace(mean_force=-study.mean_force)
    return study


def _check_speed(
    entry: RecordTable, context: Context, place: str, *, are_means: bool
) -> None:
    """Note a straight cut without a spindle speed, or a job beside mean forces."""
    if are_means and entry.job is not None:
        context.problems.append(
            f"{place} job: found beside mean forces, which are those of straight cuts; "
            'allowed with kind = "force_records"'
        )
    elif entry.job is None and (entry.speed or context.speed) is None:
        context.problems.append(
            f"{place} speed: found nothing, but it is required here or in [spindle] "
            'for a straight cut, such as "6000 rpm"'
        )


def _loads(
    name: str, tables: IdentificationTables, context: Context
) -> LoadTestStudy | None:
    """Return the study of load tests."""
    notes: list[str] = []
    robot = None
    if tables.robot is not None:
        robot = read_tool_robot(tables.robot, context, notes, needs_mass=False)
    if robot is None or tables.load_tests is None:
        return None
    return read_load_tests(name, tables.load_tests, robot, notes, context)


def _modes(
    name: str, tables: IdentificationTables, context: Context
) -> ModeStudy | None:
    """Return the study of ring-downs or frequency responses."""
    robot = None
    if tables.robot is not None:
        robot = read_tool_robot(tables.robot, context, [], needs_mass=True)
        if robot is None:
            return None
        if np.isinf(np.asarray(robot.joint_stiffness)).all():
            context.problems.append(
                "[robot]: found no joint stiffness, but dampers follow from modes only "
                "with it: by joint_stiffness, or a file named by drives"
            )
    rings = [
        read_ring_down(entry, f"[[ring_down]] {number}", robot, context)
        for number, entry in enumerate(tables.ring_down or (), 1)
    ]
    responses = [
        read_frequency_response(
            entry, f"[[frequency_response]] {number}", robot, context
        )
        for number, entry in enumerate(tables.frequency_response or (), 1)
    ]
    # A file has entries of one of these kinds.
    measured = tuple(one for one in rings if one is not None) or tuple(
        one for one in responses if one is not None
    )
    if not measured or context.problems:
        return None
    return ModeStudy(name, robot, measured)
