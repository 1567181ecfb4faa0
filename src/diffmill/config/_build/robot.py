"""The robot of a job: loaded, and fitted with drives and a tool."""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ... import units as q
from ...cutter import AbstractCutter
from ...robot import LinkErrors, Robot, built_in_models, rpy_matrix
from ...settings.tables import TomlTable
from .._schema.calibration import CalibrationTable
from .._schema.compliance import with_bending_cutter, with_spring
from .._schema.job import PoseTable, RobotTable
from .context import FileContext
from .reversal import with_reversal
from .robot_file import check_springs, load_robot

# A flange may lie so far below the tip by rounding [m].
_FLAT = 1e-6
_DRIVE_KINDS = {
    "joint_stiffness": (q.ROTARY_STIFFNESS, q.LINEAR_STIFFNESS),
    "joint_damping": (q.ROTARY_DAMPING, q.LINEAR_DAMPING),
    "joint_start": (q.ANGLE, q.LENGTH),
    "joint_offsets": (q.ANGLE, q.LENGTH),
}


def pose_matrix(pose: PoseTable | None) -> Float[np.ndarray, "4 4"]:
    """Homogeneous matrix of a pose, shape (4, 4); the identity for None."""
    T = np.eye(4)
    if pose is not None:
        T[:3, :3] = np.asarray(rpy_matrix(*pose.rpy))
        T[:3, 3] = pose.position
    return T


class FittedRobot(NamedTuple):
    """The robot of a job, and where its inverse kinematics starts.

    Attributes:
        robot: With its drives and tool; None for a rigid machine or after a fault.
        joint_start: Joint positions to start from [rad or m], shape (joint,); None for
            the robot's home.
        T_flange_tool: Pose of the tool in the flange, shape (4, 4).
        nominal: The robot as its controller knows it, without the errors of its
            `[robot.calibration]`; None if it has none.
    """

    robot: Robot | None = None
    joint_start: Float[np.ndarray, " joint"] | None = None
    T_flange_tool: Float[np.ndarray, "4 4"] | None = None
    nominal: Robot | None = None


def read_robot(
    table: RobotTable,
    cutter: AbstractCutter | None,
    context: FileContext,
    *,
    is_placed: bool = False,
) -> FittedRobot:
    """Robot of a job, with its drives and tool.

    Args:
        table: The `[robot]` table.
        cutter: The cutter, None after a fault of its own; it bends if the table says.
        context: The job file.
        is_placed: Whether the program states where the workpiece lies.
    """
    problems = context.problems
    chosen = [key for key in ("model", "file", "rigid") if getattr(table, key)]
    if len(chosen) != 1:
        found = " and ".join(chosen) or "nothing"
        problems.append(
            f"[robot]: found {found}, but exactly one is required of model (allowed: "
            f"{', '.join(built_in_models())}), file (.toml or .urdf) and rigid = true"
        )
        return FittedRobot()
    if table.rigid:
        problems.extend(
            f"[robot] {key}: found beside rigid = true, which allows no other key"
            for key in sorted(table.model_fields_set - {"rigid"})
        )
        return FittedRobot()
    if table.work_in_base is None and not is_placed:
        problems.append(
            "[robot] work_in_base: found nothing, but it is required: where the "
            'workpiece lies, such as { position = ["1500 mm", "0 mm", "800 mm"] }'
        )
    robot = load_robot(table, context)
    if robot is None:
        return FittedRobot()
    stiffness = per_joint(table, "joint_stiffness", robot, problems)
    damping = per_joint(table, "joint_damping", robot, problems)
    start = per_joint(table, "joint_start", robot, problems)
    if stiffness is not None and not (stiffness > 0).all():
        problems.append("[robot] joint_stiffness: found 0, but above 0 is required")
        return FittedRobot()
    for key, own, stated in (
        ("joint_stiffness", robot.joint_stiffness, stiffness),
        ("joint_damping", robot.joint_damping, damping),
    ):
        if stated is not None:
            context.notes.extend(_drive_notes(table, key, np.asarray(own), stated))
    robot = robot.with_drives(stiffness=stiffness, damping=damping)
    check_springs(robot, problems)
    robot = with_reversal(robot, table.reversal, context)
    if table.tool_in_flange is not None:
        T_flange_tool = pose_matrix(table.tool_in_flange)
        context.notes.extend(_tool_notes(T_flange_tool))
        robot = robot.with_tool(T_flange_tool)
    T_flange_tool = np.asarray(robot.T_flange_tool, np.float64)
    errors = _link_errors(table.calibration, robot, problems)
    robot = with_spring(robot, table.flange_spring, problems)
    robot = with_bending_cutter(robot, table.bending_tool, cutter)
    if table.flange_spring is not None:
        context.notes.extend(table.flange_spring.notes())
    if table.bending_tool is not None and cutter is not None:
        diameter = 2 * cutter.nominal_radius
        context.notes.extend(table.bending_tool.notes(diameter))
    if start is not None:
        start = np.pad(start, (0, robot.joint_count - len(start)))
    if errors is None:
        return FittedRobot(robot, start, T_flange_tool)
    calibrated = errors.with_more_joints(robot).applied_to(robot)
    return FittedRobot(calibrated, start, T_flange_tool, nominal=robot)


def _link_errors(
    table: CalibrationTable | None, robot: Robot, problems: list[str]
) -> LinkErrors | None:
    """Geometric errors of a robot; None without a table or after a fault."""
    if table is None:
        return None
    place = "[robot.calibration]"
    names, before = robot.joint_names, len(problems)
    for key in ("displacement", "rotation", "waves"):
        rows = getattr(table, key)
        if rows is not None and len(rows) != len(names):
            problems.append(
                f"{place} {key}: found {len(rows)} rows, but one per joint is "
                f"required: {', '.join(names)}"
            )
    if table.wave_period is not None and table.waves is None:
        problems.append(f"{place} wave_period: found without waves, whose period it is")
    for joint, kind in enumerate(robot.joint_kinds):
        if kind == "prismatic" and table.waves is not None and before == len(problems):
            if any(table.waves[joint]):
                problems.append(
                    f"{place} waves.{joint} ({names[joint]}): found waves, but a slide "
                    "has none: 0 is required"
                )
    offsets = per_joint(table, "joint_offsets", robot, problems, place=place)
    if len(problems) > before:
        return None
    stated = {
        "displacement": table.displacement,
        "rotation": table.rotation,
        "joint_offsets": offsets,
        "tool_position": table.tool,
        "waves": table.waves,
    }
    return dataclasses.replace(
        LinkErrors.none(robot),
        waves_per_turn=2 * math.pi / (table.wave_period or 2 * math.pi),
        **{
            name: jnp.asarray(value, robot.dtype)
            for name, value in stated.items()
            if value is not None
        },
    )


def _drive_notes(
    table: RobotTable,
    key: str,
    own: Float[np.ndarray, " joint"],
    stated: Float[np.ndarray, " joint"],
) -> list[str]:
    """Note of the ratio of stated values to the robot's own, unless it is 1."""
    # A file without springs or dampers has infinite ones, or none.
    is_stated = (own > 0) & np.isfinite(own)
    ratio = stated[is_stated] / own[is_stated]
    if not ratio.size or np.allclose(ratio, 1.0):
        return []
    least, most = (f"{value:.3g}" for value in (ratio.min(), ratio.max()))
    times = least if least == most else f"{least} to {most}"
    source = table.model or table.file
    return [f"[robot] {key}: {times} times that of the robot's own file, {source}"]


def _tool_notes(T_flange_tool: Float[np.ndarray, "4 4"]) -> list[str]:
    """Note of a tool that points into the flange."""
    up = -float(T_flange_tool[:3, 2] @ T_flange_tool[:3, 3])
    if up > -_FLAT:
        return []
    return [
        f"[robot] tool_in_flange: the flange lies {-1e3 * up:.4g} mm below the tip; +z "
        "of the tool goes up its shank, so that a flange whose z points out needs a "
        'turn such as rpy = ["180 deg", "0 deg", "0 deg"]'
    ]


def per_joint(
    table: TomlTable,
    key: str,
    robot: Robot,
    problems: list[str],
    *,
    place: str = "[robot]",
) -> Float[np.ndarray, " joint"] | None:
    """Quantities of the joints in SI, shape (joint,); None if absent or faulty.

    Args:
        table: `[robot]` of a job or of a measurement, or a table within it.
        key: Its key, with a text per joint.
        robot: The robot.
        problems: Receives the faults.
        place: What a line calls the table.
    """
    texts = getattr(table, key)
    if texts is None:
        return None
    names = robot.joint_names
    if len(texts) != len(names):
        problems.append(
            f"{place} {key}: found {len(texts)} values, but one per joint is required: "
            f"{', '.join(names)}"
        )
        return None
    rotary, linear = _DRIVE_KINDS[key]
    values = np.zeros(len(names))
    is_good = True
    for i, text in enumerate(texts):
        kind = linear if robot.joint_kinds[i] == "prismatic" else rotary
        try:
            values[i] = q.quantity(text, kind)
        except ValueError as error:
            problems.append(f"{place} {key}.{i} ({names[i]}): {error}")
            is_good = False
    return values if is_good else None
