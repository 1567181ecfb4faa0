"""Base and tool of a program beside those of the job."""

import math

import numpy as np
from jaxtyping import Float

from ...robot import rpy_matrix
from ...toolpath import Path, Point, Program

# Frames that differ by less are the same [m, rad].
_SAME_PLACE, _SAME_ANGLE = 1e-5, 2e-4


def program_base(program: Program | Path | None) -> Float[np.ndarray, "4 4"] | None:
    """Pose of `work` in the base of the robot that a program states, if any."""
    if not isinstance(program, Program):
        return None
    return _matrix(program.work_position, program.work_rpy)


def base_note(
    T_base_work: Float[np.ndarray, "4 4"],
    program: Program | Path | None,
    *,
    is_stated: bool,
) -> list[str]:
    """Note of the workpiece's pose beside the base that the program states.

    Args:
        T_base_work: Pose of the workpiece in the base, shape (4, 4).
        program: The program.
        is_stated: Whether the job states the pose, which is the program's if not.
    """
    stated = program_base(program)
    if stated is None:
        return []
    if not is_stated:
        assert isinstance(program, Program) and program.work_rpy is not None
        x, y, z = stated[:3, 3] * 1e3
        roll, pitch, yaw = (math.degrees(angle) for angle in program.work_rpy)
        return [
            "[robot] work_in_base: taken from the base that the program states: "
            f"position {x:g}, {y:g}, {z:g} mm, rpy {roll:g}, {pitch:g}, {yaw:g} deg"
        ]
    gap, turn = _distance(T_base_work, stated), _angle(T_base_work, stated)
    if gap < _SAME_PLACE and turn < _SAME_ANGLE:
        return []
    return [
        f"[robot] work_in_base: its origin lies {gap * 1e3:.4g} mm from that of the "
        "base that the program states, and it is turned by "
        f"{math.degrees(turn):.4g} deg against it"
    ]


def tool_note(
    T_flange_tool: Float[np.ndarray, "4 4"] | None, program: Program | Path | None
) -> list[str]:
    """Note of the job's tool beside the tool that the program states.

    Args:
        T_flange_tool: Pose of the tool in the flange, shape (4, 4).
        program: The program of one tool.
    """
    if T_flange_tool is None or not isinstance(program, Program):
        return []
    part = program.sections[0]
    stated = _matrix(part.tool_position, part.tool_rpy)
    if stated is None:
        return []
    gap, turn = _distance(T_flange_tool, stated), _angle(T_flange_tool, stated)
    if gap < _SAME_PLACE and turn < _SAME_ANGLE:
        return []
    cosine = float(T_flange_tool[:3, 2] @ stated[:3, 2])
    lean = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    return [
        f"[robot] tool_in_flange: the tip lies {gap * 1e3:.4g} mm from that of the "
        f"tool that the program states; their axes differ by {lean:.4g} deg, and one "
        f"frame is turned by {math.degrees(turn):.4g} deg against the other"
    ]


def _matrix(
    position: Point | None, rpy: Point | None
) -> Float[np.ndarray, "4 4"] | None:
    """Pose of a position [m] and roll, pitch and yaw [rad]."""
    if position is None or rpy is None:
        return None
    T = np.eye(4)
    T[:3, :3] = np.asarray(rpy_matrix(*rpy))
    T[:3, 3] = position
    return T


def _distance(one: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]) -> float:
    """Distance of two origins [m]."""
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]))


def _angle(one: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]) -> float:
    """Angle by which one frame is turned against another [rad]."""
    gap = float(np.linalg.norm(one[:3, :3] - other[:3, :3]))
    return 2 * math.asin(min(gap / math.sqrt(8), 1.0))
