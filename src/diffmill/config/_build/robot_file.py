"""The robot that a job names: built in or from a file, with its drives' springs."""

import pathlib
import warnings

import numpy as np

from ...robot import (
    Robot,
    RobotFileWarning,
    built_in_models,
    drive_classes,
    load,
    spindle_note,
)
from .._schema.job import RobotTable
from .context import FileContext

_SUFFIXES = (".toml", ".urdf", ".xml")


def load_robot(
    table: RobotTable,
    context: FileContext,
    *,
    needs_mass: bool = True,
) -> Robot | None:
    """Robot of a job's `model` or `file`; None after a fault.

    Args:
        table: The `[robot]` table, not of a rigid machine.
        context: The file with the table.
        needs_mass: Whether every joint must move a mass.
    """
    source, drives = _source(table, context), None
    if table.drives in drive_classes():
        drives = table.drives
        context.notes.append(f"[robot] drives: {drive_classes()[drives].note()}")
    elif table.drives is not None and table.drives.startswith("class "):
        context.problems.append(
            f"[robot] drives: found {table.drives!r}; allowed: "
            f"{', '.join(drive_classes())}, or a file"
        )
        return None
    elif table.drives is not None:
        drives = context.file(table.drives, "[robot] drives")
    if source is None or (drives is None and table.drives is not None):
        return None
    key = "model" if table.model else "file"
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", RobotFileWarning)
            robot = load(source, tool=table.tool, drives=drives)
    except ValueError as error:
        context.problems.extend(
            f"[robot] {key}: {line}" for line in str(error).splitlines()
        )
        return None
    idle = robot.massless_joints
    if idle and needs_mass:
        context.problems.append(
            f"[robot] {key}: found no mass on the joints {', '.join(idle)}, but a "
            "simulation needs the masses and inertias of the links"
        )
        return None
    context.notes.extend(f"[robot] {key}: {warning.message}" for warning in caught)
    note = spindle_note(source, drives)
    if note is not None and needs_mass and table.flange_spring is None:
        context.notes.append(f"[robot] {key}: {note}")
    return robot


def check_springs(robot: Robot, problems: list[str]) -> None:
    """Faults of joints without a spring: nothing would move them."""
    rigid = np.isinf(np.asarray(robot.joint_stiffness))
    if rigid.any():
        names = [n for n, r in zip(robot.joint_names, rigid, strict=True) if r]
        problems.append(
            f"[robot]: found no stiffness for the joints {', '.join(names)}, but every "
            "joint needs one: by joint_stiffness, one per joint, or in a file named by "
            "drives"
        )


def _source(table: RobotTable, context: FileContext) -> str | pathlib.Path | None:
    """Name of a model or path of a file; None after a fault."""
    if table.model is not None:
        if table.model in built_in_models():
            return table.model
        context.problems.append(
            f"[robot] model: found {table.model!r}; allowed: "
            f"{', '.join(built_in_models())}"
        )
        return None
    assert table.file is not None
    if pathlib.PurePath(table.file).suffix.lower() not in _SUFFIXES:
        allowed = ", ".join(_SUFFIXES)
        context.problems.append(
            f"[robot] file: found {table.file!r}; allowed: {allowed}"
        )
        return None
    return context.file(table.file, "[robot] file")
