"""The robot that a job names: built in or from a file, with its drives' springs."""

import pathlib
import warnings

import numpy as np

from ...robot import Robot, RobotFileWarning, built_in_models, load, massless_joints, spindle_note
from .program import file_in_folder
from .._schema.job import RobotTable

_SUFFIXES = (".toml", ".urdf", ".xml")


def load_robot(
    table: RobotTable,
    folder: pathlib.Path,
    problems: list[str],
    notes: list[str],
    *,
    allow_outside: bool,
    needs_mass: bool = True,
) -> Robot | None:
    """Return the robot of a job's `model` or `file`, or None with problems noted.

    Args:
        table: The `[robot]` table, not of a rigid machine.
        folder: Folder of the job.
        problems: Receives what is wrong.
        notes: Receives what is doubtful in a robot file.
        allow_outside: Whether files may lie outside that folder.
        needs_mass: Whether every joint must move a mass.
    """
    source, drives = _source(table, folder, problems, allow_outside=allow_outside), None
    if table.drives is not None:
        drives = file_in_folder(
            table.drives,
            "[robot] drives",
            folder,
            problems,
            allow_outside=allow_outside,
        )
    if source is None or (drives is None and table.drives is not None):
        return None
    key = "model" if table.model else "file"
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", RobotFileWarning)
            robot = load(source, tool=table.tool, drives=drives)
    except ValueError as error:
        problems.extend(f"[robot] {key}: {line}" for line in str(error).splitlines())
        return None
    idle = massless_joints(robot)
    if idle and needs_mass:
        problems.append(
            f"[robot] {key}: found no mass on the joints {', '.join(idle)}, but a "
            "simulation needs the masses and inertias of the links"
        )
        return None
    notes.extend(f"[robot] {key}: {warning.message}" for warning in caught)
    note = spindle_note(source, drives)
    if note is not None and needs_mass and table.flange_spring is None:
        notes.append(f"[robot] {key}: {note}")
    return robot


def check_springs(robot: Robot, problems: list[str]) -> None:
    """Note joints without a spring: nothing would move them."""
    rigid = np.isinf(np.asarray(robot.joint_stiffness))
    if rigid.any():
        names = [n for n, r in zip(robot.joint_names, rigid, strict=True) if r]
        problems.append(
            f"[robot]: found no stiffness for the joints {', '.join(names)}, but every "
            "joint needs one: by joint_stiffness, one per joint, or in a file named by "
            "drives"
        )


def _source(
    table: RobotTable, folder: pathlib.Path, problems: list[str], *, allow_outside: bool
) -> str | pathlib.Path | None:
    """Return a model's name or a file's path, None with a problem noted."""
    if table.model is not None:
        if table.model in built_in_models():
            return table.model
        problems.append(
            f"[robot] model: found {table.model!r}; allowed: "
            f"{', '.join(built_in_models())}"
        )
        return None
    assert table.file is not None
    if pathlib.PurePath(table.file).suffix.lower() not in _SUFFIXES:
        allowed = ", ".join(_SUFFIXES)
        problems.append(f"[robot] file: found {table.file!r}; allowed: {allowed}")
        return None
    return file_in_folder(
        table.file, "[robot] file", folder, problems, allow_outside=allow_outside
    )
