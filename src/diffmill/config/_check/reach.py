"""Reach of a job's robot along its path: limits, configuration, singular poses."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..._padding import in_pieces
from ..._types import FloatRows
from ...numerics import CachedJit
from ...robot import (
    JointSolution,
    Robot,
    ToolRotation,
    inverse_kinematics_path,
    path_starts,
    singularity,
)
from ...toolpath import Path
from ...workpiece import Pose
from .._build.context import FileContext

# Rounding of a limit that the path touches [rad or m].
_LIMIT_SLACK = 1e-9
# Nearer to a singular pose than this share of the arm's length a note says so: for a
# wrist that is some 4 degrees from straight.
_NEAR_SINGULAR = 0.05
# Between two rows the tip may leave the straight line by this share of their distance,
# and this much [m]; an arm that changes its configuration leaves it by far more.
_STRAIGHT, _SLACK = 0.25, 1e-4
# A joint may turn by this much [rad], and by what an arm of this length [m] has to.
_TURN, _SHORTEST_ARM = 0.5, 0.3
# Where a start that is suggested is rounded to [rad or m].
_ROUNDING = {"revolute": np.deg2rad(0.1), "prismatic": 1e-3}
# Other configurations that are tried along the whole path.
_TRIED = 3
# Joints that move at least this much in the singular motion are named.
_TAKES_PART = 0.4


class ReachCheck(NamedTuple):
    """A robot that is to follow paths.

    Attributes:
        robot: The robot with its tool.
        T_base_work: Maps work coordinates to the robot's base, shape (4, 4).
        joint_start: Joint positions to begin from; None for the robot's home.
        tool_rotation: Whether the rotation about the tool axis is free.
        start_count: Joints that `joint_start` names.
    """

    robot: Robot
    T_base_work: Float[np.ndarray, "4 4"]
    joint_start: Float[np.ndarray, " joint"] | None
    tool_rotation: ToolRotation
    start_count: int

    def joints(
        self, path: Path, context: FileContext, *, is_slowed: bool = False
    ) -> Float[np.ndarray, "step joint"]:
        """Joint positions along a path; a fault where the robot cannot follow it.

        Args:
            path: Desired path.
            context: Receives what is wrong, the first place of each kind, and where a
                pose is nearly singular.
            is_slowed: Whether the path will be slowed down where joints are too slow.

        Returns:
            Joint positions along the path [rad or m], shape (step, joint).
        """
        robot, start = self.robot, self.joint_start
        T_work_tool = np.tile(np.eye(4), (path.step_count, 1, 1))
        frames = in_pieces(_frames, path.axes)
        if path.tool_x is not None:
            x, z = np.asarray(path.tool_x), np.asarray(path.axes)
            frames = np.stack([x, np.cross(z, x), z], axis=-1)
        T_work_tool[:, :3, :3] = frames
        T_work_tool[:, :3, 3] = path.positions
        Ts = np.asarray(self.T_base_work @ T_work_tool, dtype=np.dtype(robot.dtype))
        start = np.asarray(robot.home if start is None else start)

        found = _follow(robot, Ts, start, self.tool_rotation)
        faults = _faults(robot, path, Ts, found)
        if not is_slowed:
            _check_speed(robot, path, found, faults)
        if not faults:
            _note_singular(robot, path, found, self.tool_rotation, context.notes)
            return np.asarray(found.q)
        better = _better_start(robot, path, Ts, start, self.tool_rotation)
        if better is not None:
            faults[0] += f"; {_start_line(robot, better[: self.start_count])} avoids it"
        elif self.tool_rotation == "fixed":
            free = _follow(robot, Ts, start, "free")
            if free.converged.all() and not _faults(robot, path, Ts, free):
                faults[0] += '; tool_rotation = "free" would reach it'
        context.problems.extend(faults)
        return np.asarray(found.q)


def _follow(
    robot: Robot,
    Ts: Float[np.ndarray, "step 4 4"],
    start: Float[np.ndarray, " joint"],
    tool_rotation: ToolRotation,
) -> JointSolution:
    """Joints along a path, on the host."""
    return jax.device_get(
        inverse_kinematics_path(robot, Ts, start, tool_rotation=tool_rotation)
    )


def _faults(
    robot: Robot, path: Path, Ts: Float[np.ndarray, "step 4 4"], found: JointSolution
) -> list[str]:
    """Faults for which the robot cannot follow a path."""
    faults: list[str] = []
    if not found.converged.all():
        faults.append(_unreached(path, Ts, found))
    _check_limits(robot, path, found, faults)
    _check_branch(robot, path, Ts, found, faults)
    return faults


def _better_start(
    robot: Robot,
    path: Path,
    Ts: Float[np.ndarray, "step 4 4"],
    start: Float[np.ndarray, " joint"],
    tool_rotation: ToolRotation,
) -> Float[np.ndarray, " joint"] | None:
    """Joints, rounded, from which the robot can follow a path; None if not found."""
    grid = np.array([_ROUNDING[kind] for kind in robot.joint_kinds])
    for q in path_starts(robot, Ts, start, tool_rotation=tool_rotation)[:_TRIED]:
        rounded = np.round(q / grid) * grid
        found = _follow(robot, Ts, rounded, tool_rotation)
        if not _faults(robot, path, Ts, found):
            return rounded
    return None


def _start_line(robot: Robot, q: Float[np.ndarray, " joint"]) -> str:
    """Key of a job that lets the arm start at given joints."""
    kinds = robot.joint_kinds[: len(q)]
    values = [
        f'"{1e3 * x:.0f} mm"' if kind == "prismatic" else f'"{np.rad2deg(x):.1f} deg"'
        for x, kind in zip(q, kinds, strict=True)
    ]
    return f"joint_start = [{', '.join(values)}]"


def _unreached(
    path: Path, Ts: Float[np.ndarray, "step 4 4"], found: JointSolution
) -> str:
    """Fault of poses out of reach."""
    is_bad = ~np.asarray(found.converged)
    k = int(np.argmax(is_bad))
    x, y, z = Ts[k, :3, 3] * 1e3
    # What is less than a nanometre is rounding.
    away = round(float(found.position_residual[k]) * 1e3, 6)
    tilt = round(np.rad2deg(float(found.rotation_residual[k])), 6)
    return (
        f"[robot]: {at_row(path, k)}: outside the robot's reach, with the tip at "
        f"({x:.1f}, {y:.1f}, {z:.1f}) mm in base: the nearest pose found is {away:.2g} "
        f"mm and {tilt:.2g} deg away; so are {is_bad.sum()} of {path.step_count} rows; "
        "move the part with work_in_base, or look at the unit and zero of the program"
    )


def _check_limits(
    robot: Robot, path: Path, found: JointSolution, problems: list[str]
) -> None:
    """Faults of joints beyond their limits in rows within reach."""
    lower, upper = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
    is_over = np.asarray(found.limit_excess) > _LIMIT_SLACK
    is_over &= np.asarray(found.converged)[:, None]
    for i in np.flatnonzero(is_over.any(axis=0)):
        excess = np.where(is_over[:, i], found.limit_excess[:, i], 0.0)
        k, most = int(np.argmax(excess)), float(excess.max())
        is_slide = robot.joint_kinds[i] == "prismatic"
        scale, unit = (1e3, "mm") if is_slide else (180 / np.pi, "deg")
        problems.append(
            f"[robot]: {at_row(path, k)}: joint {robot.joint_names[i]} would be at "
            f"{found.q[k, i] * scale:.1f} {unit}; allowed is {lower[i] * scale:.1f} to "
            f"{upper[i] * scale:.1f} {unit}; that is {most * scale:.2g} {unit} more, "
            f"and too much in {is_over[:, i].sum()} of {path.step_count} rows"
        )


def _check_speed(
    robot: Robot, path: Path, found: JointSolution, problems: list[str]
) -> None:
    """Faults of joints that would have to move faster than they can."""
    if robot.joint_speed is None or path.step_count < 2:
        return
    allowed = np.asarray(robot.joint_speed)
    period = np.diff(np.asarray(path.time))[:, None]
    rate = np.abs(np.diff(np.asarray(found.q), axis=0)) / period
    is_reached = np.asarray(found.converged)
    is_fast = (rate > 1.001 * allowed) & (is_reached[1:] & is_reached[:-1])[:, None]
    for i in np.flatnonzero(is_fast.any(axis=0)).tolist():
        k = int(np.argmax(np.where(is_fast[:, i], rate[:, i], 0.0)))
        is_slide = robot.joint_kinds[i] == "prismatic"
        scale, unit = (1e3, "mm/s") if is_slide else (180 / np.pi, "deg/s")
        problems.append(
            f"[robot]: {at_row(path, k + 1)}: joint {robot.joint_names[i]} would move "
            f"at {rate[k, i] * scale:.1f} {unit}; allowed is {allowed[i] * scale:.1f} "
            f"{unit}; so in {is_fast[:, i].sum()} of {path.step_count} rows"
        )


def _check_branch(
    robot: Robot,
    path: Path,
    Ts: Float[np.ndarray, "step 4 4"],
    found: JointSolution,
    problems: list[str],
) -> None:
    """Fault of an arm that changes its configuration between two rows."""
    tips, is_reached = Ts[:, :3, 3], np.asarray(found.converged)
    q = np.asarray(found.q)
    length = np.linalg.norm(np.diff(tips, axis=0, prepend=tips[:1]), axis=1)
    is_far = np.asarray(found.midway_error) > _STRAIGHT * length + _SLACK
    turns = np.array([kind == "revolute" for kind in robot.joint_kinds])
    turn = np.abs(np.diff(q, axis=0, prepend=q[:1])) * turns
    is_far |= turn.max(axis=1) > _TURN + length / _SHORTEST_ARM
    is_jump = is_far & is_reached & np.roll(is_reached, 1)
    if is_jump.any():
        k = int(np.argmax(is_jump))
        i = int(np.argmax(turn[k]))
        problems.append(
            f"[robot]: {at_row(path, k)}: the arm would have to change its "
            "configuration within one tooth period, "
            f"joint {robot.joint_names[i]} turns by "
            f"{np.rad2deg(turn[k, i]):.1f} deg; start from another configuration with "
            "joint_start, or move the part with work_in_base"
        )


def _note_singular(
    robot: Robot,
    path: Path,
    found: JointSolution,
    tool_rotation: ToolRotation,
    notes: list[str],
) -> None:
    """Note of the pose nearest to a singular one, if it is near."""
    near = in_pieces(lambda q: _singularities(robot, q, tool_rotation), found.q)
    is_near = near.smallest < _NEAR_SINGULAR
    if not is_near.any():
        return
    k = int(np.argmin(near.smallest))
    moves = np.abs(near.joint_direction[k]) > _TAKES_PART
    names = [name for name, m in zip(robot.joint_names, moves, strict=True) if m]
    notes.append(
        f"[robot]: {at_row(path, k)}: nearly a singular pose, where a joint motion "
        f"({', '.join(names)}) hardly moves the tool: smallest singular value "
        f"{near.smallest[k]:.3g}, lengths in units of the arm's; below "
        f"{_NEAR_SINGULAR:g} in {is_near.sum()} of {path.step_count} rows"
    )


_frames = jax.jit(Pose.frame)


@CachedJit
def _singularities(robot: Robot, rows: FloatRows, tool_rotation: ToolRotation) -> Any:
    return jax.vmap(lambda q: singularity(robot, q, tool_rotation=tool_rotation))(rows)


def at_row(path: Path, k: int) -> str:
    """Line, time and position of a row of a path."""
    x, y, z = np.asarray(path.positions)[k] * 1e3
    line = int(np.asarray(path.line)[k])
    where = f"program line {line}, " if line else ""
    time = float(np.asarray(path.time)[k])
    return f"{where}time {time:.3f} s, position ({x:.3f}, {y:.3f}, {z:.3f}) mm"
