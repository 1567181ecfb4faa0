"""The robot of a measurement."""

import math
import re

from pydantic import Field, StrictStr

from ... import units as q
from ...io import Quantity
from ...robot import Robot
from ...settings.fields import Damping, Stiffness
from ...settings.tables import TomlTable
from .._build.robot import per_joint, pose_matrix
from .._build.robot_file import load_robot
from .._schema.job import PoseTable, RobotTable
from .context import Context
from .fields import File

# No joint turns so far [rad].
LARGEST_ANGLE = 4 * math.pi


class StudiedRobotTable(TomlTable):
    """`[robot]` of a measurement: no place of a workpiece."""

    model: StrictStr | None = Field(
        default=None,
        description='name of a built-in robot, such as "kuka_kr210_like"; required '
        "without file",
    )
    file: StrictStr | None = Field(
        default=None,
        description='file of a robot of your own, such as "arm.toml" or "arm.urdf", '
        "instead of model",
    )
    tool: StrictStr | None = Field(
        default=None,
        description='link of a URDF that is the flange, such as "tool0"; required if '
        "several could be",
    )
    drives: File | None = Field(
        default=None,
        description="file with what the robot lacks (springs, drives, spindle), such "
        'as "drives.toml"; nothing is added if left out',
    )
    joint_stiffness: list[Stiffness] | None = Field(
        default=None,
        description='stiffness of every joint, such as ["3.5 MN*m/rad", ...]; that of '
        "the robot and drives if left out",
    )
    joint_damping: list[Damping] | None = Field(
        default=None,
        description='damping of every joint, such as ["1825 N*m*s/rad", ...]; that of '
        "the robot and drives if left out",
    )
    tool_in_flange: PoseTable | None = Field(
        default=None,
        description="pose of the tool, where it is loaded and measured, in the flange; "
        "that of the robot if left out",
    )


def read_tool_robot(
    table: StudiedRobotTable, context: Context, notes: list[str], *, needs_mass: bool
) -> Robot | None:
    """Robot of a measurement, or None with problems noted.

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
    robot = robot.with_drives(
        stiffness=per_joint(table, "joint_stiffness", robot, problems),
        damping=per_joint(table, "joint_damping", robot, problems),
    )
    if table.tool_in_flange is not None:
        robot = robot.with_tool(pose_matrix(table.tool_in_flange))
    return robot


def joint_quantities(robot: Robot) -> tuple[Quantity, ...]:
    """Columns of the joint positions of a table, one per joint.

    Args:
        robot: The robot.
    """
    joints = zip(robot.joint_names, robot.joint_kinds, strict=True)
    return tuple(
        Quantity(
            name,
            rf"{re.escape(name)}|(q|j|a|theta|axis|joint|achse)[\s_.\-]*{i}",
            (q.LENGTH,) if kind == "prismatic" else (q.ANGLE,),
            ("joint",),
        )
        for i, (name, kind) in enumerate(joints, 1)
    )
