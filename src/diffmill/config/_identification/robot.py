"""The robot of a measurement, and its poses."""

import numpy as np
from jaxtyping import Float

from ... import units as q
from ...io import parse_pose
from ...robot import Robot
from .._build.robot import pose_matrix
from .._build.robot_file import load_robot
from .._schema.job import RobotTable
from .context import Context
from .schema import StudiedRobotTable

_STIFFNESS = (q.ROTARY_STIFFNESS, q.LINEAR_STIFFNESS)
_DAMPING = (q.ROTARY_DAMPING, q.LINEAR_DAMPING)


def read_tool_robot(
    table: StudiedRobotTable, context: Context, notes: list[str], *, needs_mass: bool
) -> Robot | None:
    """Return the robot of a measurement, or None with problems noted.

    Args:
        table: `[robot]`.
        context: Folder and problems.
        notes: Receives what is doubtful in a robot file.
        needs_mass: Whether every joint must move a mass.
    """
    problems = context.problems
    if (table.model is None) == (table.file is None):
        problems.append(
            "[robot]: exactly one of model and file (.toml or .urdf) is required"
        )
        return None
    robot = load_robot(
        RobotTable(
            model=table.model, file=table.file, tool=table.tool, drives=table.drives
        ),
        context.with_notes(notes),
        needs_mass=needs_mass,
    )
    if robot is None:
        return None
    values = {}
    for key, kinds in (("joint_stiffness", _STIFFNESS), ("joint_damping", _DAMPING)):
        texts = getattr(table, key)
        if texts is None:
            continue
        values[key] = np.zeros(robot.joint_count)
        if len(texts) != robot.joint_count:
            problems.append(
                f"[robot] {key}: found {len(texts)} values, but one per joint is "
                f"required: {', '.join(robot.joint_names)}"
            )
            return None
        for i, text in enumerate(texts):
            try:
                kind = kinds[int(robot.joint_kinds[i] == "prismatic")]
                values[key][i] = q.quantity(text, kind)
            except ValueError as error:
                problems.append(f"[robot] {key}.{i} ({robot.joint_names[i]}): {error}")
    robot = robot.with_drives(
        stiffness=values.get("joint_stiffness"),
        damping=values.get("joint_damping"),
    )
    if table.tool_in_flange is not None:
        robot = robot.with_tool(pose_matrix(table.tool_in_flange))
    return robot


def joint_positions(
    texts: list[str] | None, robot: Robot | None, place: str, problems: list[str]
) -> Float[np.ndarray, " joint"] | None:
    """Return joint positions that the file gives, None if none or faulty."""
    if texts is None:
        return None
    if robot is None:
        problems.append(
            f"{place} joint_positions: found beside no [robot], but it is required then"
        )
        return None
    try:
        return np.asarray(parse_pose(", ".join(texts), robot), np.float64)
    except ValueError as error:
        problems.append(f"{place} joint_positions: {error}")
        return None
