"""Reading a file for `diffmill learn`: the job, the parts, and their measurements."""

import functools
import os
import pathlib
from typing import NamedTuple

import numpy as np

from .. import units as q
from .._job import Job
from .._toml import JobError, read_toml
from .._types import FloatRows3
from ..io import Quantity, TableReader
from ..learning import (
    AbstractMeasurement,
    AbstractTrial,
    LinkEncoders,
    MachinePosterior,
    MachinePrior,
    MeasuredForces,
    Part,
    TrackedRun,
    TrackedTips,
    WallPoints,
    usual_trials,
)
from ..settings.tables import validated
from ._build.learnt import read_learnt
from ._build.program import read_command
from ._identification.context import Context
from ._identification.robot import joint_quantities
from ._learning.schema import (
    EncodersTable,
    ForcesTable,
    LearningTable,
    MachinePriorTable,
    PartTable,
    PointsTable,
    TrackerTable,
)

_PLACE = Quantity.vector(
    "", "|p|pos|position|tip|tcp|point|actual|measured", q.LENGTH, "position"
)
_NORMAL = tuple(Quantity(f"n{a}", f"n_?{a}|normal_?{a}") for a in "xyz")
_FORCES = Quantity.vector("F", "f|force|kraft", q.FORCE, "force")


class MeasuredJob(NamedTuple):
    """A job with parts that were cut and measured.

    Attributes:
        name: Name of the file, for file names.
        source: Text of the file.
        job: The job.
        parts: The parts, in the order in which they were cut.
        part_names: Their names.
        prior: How far the machine may be off, or what another program has shown of it.
        steps: Steps of the next correction at most; 0 for none.
        trials: Measurements that could be made, by name.
        notes: What the user should know.
    """

    name: str
    source: str
    job: Job
    parts: tuple[Part, ...]
    part_names: tuple[str, ...]
    prior: MachinePrior | MachinePosterior
    steps: int
    trials: dict[str, AbstractTrial]
    notes: tuple[str, ...]


def load_learning(
    file: str | os.PathLike[str],
    *,
    allow_outside: bool = False,
    needs_parts: bool = True,
) -> MeasuredJob:
    """Job and measured parts that a TOML file names.

    Args:
        file: The file, for `diffmill learn`.
        allow_outside: Whether it may name files outside its own folder.
        needs_parts: Whether a part must have been measured.

    Returns:
        The job and its parts in SI units; see `dm.learn`.

    Raises:
        JobError: If anything is wrong with the file, the job or a measurement. All is
            listed at once.
    """
    path = pathlib.Path(file)
    text, raw = read_toml(path)
    problems: list[str] = []
    if "program" in raw and "job" not in raw:
        fault = f'found a job; a file for learn names it, as job = "{path.name}"'
        raise JobError(path, [f"{fault}, beside the measured parts (docs/learn.md)"])
    table = validated(LearningTable, raw, "learning:", problems)
    if table is None:
        raise JobError(path, problems)
    context = Context(path.parent, allow_outside, problems, {})
    job, notes = context.job(table.job, "job"), []
    if job is None:
        raise JobError(path, problems)
    if job.robot is None:
        problems.append("job: found a machine without joints, but a robot is required")
    if "learnt" in read_toml(path.parent / table.job).tables:
        problems.append(
            f"job: found [learnt] in {table.job}, but the machine as modelled is "
            "required: name that file as learnt in [prior] instead"
        )
    if needs_parts and not table.part:
        problems.append("[[part]]: found none, but a measured part is required")
    if problems:
        raise JobError(path, problems)
    prior = _prior(table.prior, context, notes)
    names = [one.name or f"part {k}" for k, one in enumerate(table.part, 1)]
    parts = [
        _part(one, name, job, context, notes)
        for one, name in zip(table.part, names, strict=True)
    ]
    tracker, gauge = table.advice.tracker, table.advice.gauge
    trials = usual_trials(job, tracker=tracker, gauge=gauge)
    for one in table.trial:
        other = context.job(one.job, "[[trial]] job")
        if other is not None:
            trials[one.name or one.job] = TrackedRun(other, tracker)
    if problems:
        raise JobError(path, problems)
    assert prior is not None
    return MeasuredJob(
        path.stem,
        text,
        job,
        tuple(part for part in parts if part is not None),
        tuple(names),
        prior,
        table.steps,
        trials,
        tuple(notes),
    )


def _prior(
    table: MachinePriorTable, context: Context, notes: list[str]
) -> MachinePrior | MachinePosterior | None:
    """Prior of the machine; None with problems noted."""
    if table.learnt is None:
        return MachinePrior(**table.model_dump(exclude={"learnt"}))
    others = sorted(table.model_fields_set - {"learnt"})
    if others:
        context.problems.append(
            f"[prior] learnt: found beside {', '.join(others)}, which it replaces"
        )
    return read_learnt(table.learnt, "[prior] learnt", context.with_notes(notes))


def _part(
    table: PartTable, name: str, job: Job, context: Context, notes: list[str]
) -> Part | None:
    """A part that was cut and measured, or None with problems noted."""
    place, found = f'[[part]] "{name}"', len(context.problems)
    read: list[AbstractMeasurement | None] = []
    for key, build in _BUILDERS.items():
        own = getattr(table, key)
        if own is not None:
            make = functools.partial(build, table=own, job=job, notes=notes)
            read.append(context.read(own, f"{place} {key}", make))
    if not read:
        context.problems.append(
            f"{place}: found no measurement, but one of {', '.join(_BUILDERS)} is "
            "required"
        )
    commanded: FloatRows3 | None = np.asarray(job.path.positions)
    if table.commanded is not None:
        key = f"{place} commanded"
        commanded = read_command(
            table.commanded, key, job.path, context.with_notes(notes)
        )
    measured = tuple(one for one in read if one is not None)
    if commanded is None or len(context.problems) > found:
        return None
    return Part(commanded, measured)


def _rows(
    reader: TableReader, quantities: tuple[Quantity, ...], *, has_time: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Time, and the columns of some quantities, of complete rows; in SI units.

    Raises:
        RecordError: A column is missing.
    """
    times = (reader.TIME,) * has_time
    reader.allow((*times, *quantities))
    read = {one.key: reader.values(one) for one in (*times, *quantities)}
    missing = [key for key, values in read.items() if values is None]
    if missing and not reader.faults:
        reader.faults.append(
            f"found no column for {', '.join(missing)} among {reader.listed()}; name "
            "it with `channels`."
        )
    reader.check()
    columns = np.column_stack(
        [values for values in read.values() if values is not None]
    )
    good = np.isfinite(columns).all(axis=1)
    if not good.any():
        reader.faults.append("found no complete row.")
    elif not good.all():
        reader.notes.append(f"{(~good).sum()} rows have empty cells and were left out.")
    columns = columns[good]
    time = columns[:, 0] if has_time else np.zeros(0)
    if has_time and not np.all(np.diff(time) > 0):
        reader.faults.append("found instants that do not increase.")
    reader.check()
    return time, columns[:, has_time:]


def _noted(reader: TableReader, notes: list[str]) -> None:
    notes.extend(f"{reader.name}: {note}" for note in reader.notes)


def _tracked(
    reader: TableReader, table: TrackerTable, job: Job, notes: list[str]
) -> TrackedTips:
    time, tips = _rows(reader, _PLACE, has_time=True)
    _check_places(reader, tips, job)
    _check_times(reader, time, job)
    _noted(reader, notes)
    return TrackedTips(
        tips, table.noise, time, offset=table.offset, turn=table.turn, delay=table.delay
    )


def _probed(
    reader: TableReader, table: PointsTable, job: Job, notes: list[str]
) -> WallPoints:
    _, columns = _rows(reader, (*_PLACE, *_NORMAL), has_time=False)
    points, normals = columns[:, :3], columns[:, 3:]
    if not (np.linalg.norm(normals, axis=1) > 0).all():
        reader.faults.append("found a normal without length.")
    _check_places(reader, points, job)
    _noted(reader, notes)
    return WallPoints(points, normals, table.noise, table.offset)


def _encoded(
    reader: TableReader, table: EncodersTable, job: Job, notes: list[str]
) -> LinkEncoders:
    assert job.robot is not None
    motors = job.robot.motor_mask()
    if not motors.all() or "prismatic" in job.robot.joint_kinds:
        reader.faults.append(
            "found encoders beside a robot with slides or with springs that have no "
            "motor, but joints that all turn and have motors are required."
        )
    reader.check()
    time, joints = _rows(reader, joint_quantities(job.robot), has_time=True)
    _check_times(reader, time, job)
    _noted(reader, notes)
    return LinkEncoders(joints, table.noise, time, table.offset, table.delay)


def _forced(
    reader: TableReader, table: ForcesTable, job: Job, notes: list[str]
) -> MeasuredForces:
    time, force = _rows(reader, _FORCES, has_time=True)
    _check_times(reader, time, job)
    _noted(reader, notes)
    sign = 1.0 if table.on == "tool" else -1.0
    return MeasuredForces(sign * force, table.noise, time, table.offset)


_BUILDERS = {
    "tracker": _tracked,
    "points": _probed,
    "encoders": _encoded,
    "forces": _forced,
}
# Tips farther from the path than this have another unit or frame [m].
_FAR = 5e-3


def _check_places(reader: TableReader, places: np.ndarray, job: Job) -> None:
    """Refuse places that are not about the path: a unit or a frame is wrong.

    Raises:
        RecordError: They are not.
    """
    path = np.asarray(job.path.positions)
    reach = 2 * float(job.cutter.nominal_radius) + _FAR
    low, high = path.min(axis=0) - reach, path.max(axis=0) + reach
    outside = ~((places >= low) & (places <= high)).all(axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        x, y, z = 1e3 * places[row]
        reader.faults.append(
            f"found ({x:.6g}, {y:.6g}, {z:.6g}) mm in row {row + 1}, which is not "
            "about the program's path; give places in work, and their unit in the "
            'header or by `units`, such as { position = "mm" }.'
        )
    reader.check()


def _check_times(reader: TableReader, time: np.ndarray, job: Job) -> None:
    """Refuse instants of which none is within the program.

    Raises:
        RecordError: None is.
    """
    last = float(job.path.time[-1])
    if not ((time > 0) & (time < last)).any():
        reader.faults.append(
            f"found instants from {time[0]:.6g} to {time[-1]:.6g} s, but some within "
            f"the program's {last:.6g} s are required, counted from its begin."
        )
    reader.check()
