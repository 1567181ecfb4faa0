"""The robot of a job: loaded, fitted with drives and tool, and asked for the path."""

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..cutter import AbstractCutter
from ..robot import (
    Robot,
    built_in_models,
    inverse_kinematics_path,
    rpy_matrix,
    with_drives,
    with_tool,
)
from ..sim import tool_frame
from ..toolpath import Path
from . import _quantity as q
from ._job_compliance import with_bending_cutter, with_spring
from ._job_robot_file import check_springs, load_robot
from ._job_schema import PoseTable, RobotTable

_DRIVE_KINDS = {
    "joint_stiffness": (q.ROTARY_STIFFNESS, q.LINEAR_STIFFNESS),
    "joint_damping": (q.ROTARY_DAMPING, q.LINEAR_DAMPING),
    "joint_start": (q.ANGLE, q.LENGTH),
}
# Rounding of a limit that the path touches [rad or m].
_LIMIT_SLACK = 1e-9


def pose_matrix(pose: PoseTable | None) -> Float[np.ndarray, "4 4"]:
    """Return a pose as a homogeneous matrix; the identity for None."""
    T = np.eye(4)
    if pose is not None:
        T[:3, :3] = np.asarray(rpy_matrix(*pose.rpy))
        T[:3, 3] = pose.position
    return T


def read_robot(
    table: RobotTable,
    cutter: AbstractCutter | None,
    folder: pathlib.Path,
    problems: list[str],
    notes: list[str],
    *,
    allow_outside: bool,
) -> tuple[Robot | None, Float[np.ndarray, " joint"] | None]:
    """Return the robot of a job and where inverse kinematics starts.

    Args:
        table: The `[robot]` table.
        cutter: The cutter, None after a fault of its own; it bends if the table says.
        folder: Folder of the job.
        problems: Receives what is wrong.
        notes: Receives what is doubtful in a robot file.
        allow_outside: Whether a robot file may lie outside that folder.

    Returns:
        The robot, None for a rigid machine or after a fault; and the joint positions
        to start from, None for the robot's home.
    """
    chosen = [key for key in ("model", "file", "rigid") if getattr(table, key)]
    if len(chosen) != 1:
        found = " and ".join(chosen) or "nothing"
        problems.append(
            f"[robot]: found {found}, but exactly one is required of model (allowed: "
            f"{', '.join(built_in_models())}), file (.toml or .urdf) and rigid = true"
        )
        return None, None
    if table.rigid:
        _refuse_with_rigid(table, problems)
        return None, None
    if table.work_in_base is None:
        problems.append(
            "[robot] work_in_base: found nothing, but it is required: where the "
            'workpiece lies, such as { position = ["1500 mm", "0 mm", "800 mm"] }'
        )
    robot = load_robot(table, folder, problems, notes, allow_outside=allow_outside)
    if robot is None:
        return None, None
    stiffness = _per_joint(table, "joint_stiffness", robot, problems)
    damping = _per_joint(table, "joint_damping", robot, problems)
    start = _per_joint(table, "joint_start", robot, problems)
    if stiffness is not None and not (stiffness > 0).all():
        problems.append("[robot] joint_stiffness: found 0, but above 0 is required")
        return None, None
    robot = with_drives(robot, stiffness=stiffness, damping=damping)
    check_springs(robot, problems)
    if table.tool_in_flange is not None:
        robot = with_tool(robot, pose_matrix(table.tool_in_flange))
    robot = with_spring(robot, table.flange_spring, problems)
    robot = with_bending_cutter(robot, table.bending_tool, cutter)
    if start is not None:
        start = np.pad(start, (0, robot.joint_count - len(start)))
    return robot, start


def _refuse_with_rigid(table: RobotTable, problems: list[str]) -> None:
    for key in sorted(table.model_fields_set - {"rigid"}):
        problems.append(
            f"[robot] {key}: found beside rigid = true, which allows no other key"
        )


def _per_joint(
    table: RobotTable, key: str, robot: Robot, problems: list[str]
) -> Float[np.ndarray, " joint"] | None:
    """Return a list with one quantity per joint in SI, None if absent or faulty."""
    texts = getattr(table, key)
    if texts is None:
        return None
    names = robot.joint_names
    if len(texts) != len(names):
        problems.append(
            f"[robot] {key}: found {len(texts)} values, but one per joint is required: "
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
            problems.append(f"[robot] {key}.{i} ({names[i]}): {error}")
            is_good = False
    return values if is_good else None


def check_reach(
    robot: Robot,
    path: Path,
    T_base_work: Float[np.ndarray, "4 4"],
    joint_start: Float[np.ndarray, " joint"] | None,
    problems: list[str],
) -> None:
    """Note where a path leaves the robot's reach or its joint limits.

    Args:
        robot: The robot with its tool.
        path: Desired path.
        T_base_work: Maps work coordinates to the robot's base, shape (4, 4).
        joint_start: Joint positions to begin from; None for the robot's home.
        problems: Receives what is wrong, the first place of each kind.
    """
    T_work_tool = np.tile(np.eye(4), (path.step_count, 1, 1))
    T_work_tool[:, :3, :3] = np.asarray(tool_frame(jnp.asarray(path.axes)))
    T_work_tool[:, :3, 3] = path.positions
    Ts = np.asarray(T_base_work @ T_work_tool, dtype=np.dtype(robot.dtype))
    start = robot.home if joint_start is None else joint_start
    solution = jax.device_get(inverse_kinematics_path(robot, Ts, start))
    is_reached = np.asarray(solution.converged)
    if not is_reached.all():
        k = int(np.argmin(is_reached))
        x, y, z = Ts[k, :3, 3] * 1e3
        problems.append(
            f"[robot]: {_place(path, k)}: outside the robot's reach, with the tip at "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm in base; move the part with work_in_base"
        )
        return
    lower, upper = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
    positions = np.asarray(solution.q)
    excess = np.maximum(lower - positions, positions - upper)
    for i in np.flatnonzero((excess > _LIMIT_SLACK).any(axis=0)):
        k = int(np.argmax(excess[:, i] > _LIMIT_SLACK))
        scale, unit = (
            (1e3, "mm")
            if robot.joint_kinds[i] == "prismatic"
            else (
                180 / np.pi,
                "deg",
            )
        )
        problems.append(
            f"[robot]: {_place(path, k)}: joint {robot.joint_names[i]} would stand at "
            f"{positions[k, i] * scale:.1f} {unit}; allowed is "
            f"{lower[i] * scale:.1f} to {upper[i] * scale:.1f} {unit}"
        )


def _place(path: Path, k: int) -> str:
    """Return line, time and position of a row of a path."""
    x, y, z = np.asarray(path.positions)[k] * 1e3
    line = int(np.asarray(path.line)[k])
    where = f"program line {line}, " if line else ""
    time = float(np.asarray(path.time)[k])
    return f"{where}time {time:.3f} s, position ({x:.3f}, {y:.3f}, {z:.3f}) mm"
