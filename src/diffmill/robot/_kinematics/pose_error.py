"""Pose error: the rows that inverse kinematics solves, and the free rotation.

With the rotation about the tool axis fixed, the tool's frame is to be that of the
pose: six rows. With it free, only the tip and the direction of the tool axis count: a
rotating cutter does not care how its spindle is turned. Where that leaves a family of
solutions, the one nearest to the middle of the joints' ranges is taken. It belongs to
the pose and not to the way there, so that a closed path closes in the joints too.
"""

from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...numerics import clamp, small_inverse
from .._algebra.rotations import rotation_between
from .._model.robot import Robot
from .forward import JointFrames, joint_frames, tool_jacobian

# The rotation about the tool axis: fixed by the pose, or free to be chosen.
ToolRotation: TypeAlias = Literal["fixed", "free"]

# The pull towards the middle is x + x^15 in half ranges: gentle inside, a wall beyond.
_WALL_POWER = 15
# Half ranges at which the wall stops rising, far beyond any limit: a power must not
# overflow.
_HIGHEST_WALL = 10.0
# Number of repetitions of an undamped step for the error that its floor leaves.
_REPEATS = 3
# cos^2(angle / 2) below which a tilt counts as half a turn.
_HALF_TURN_COSINE = 1e-4
# Half a range of a joint without limits [rad or m], and the least half of any.
_UNLIMITED_HALF, _LEAST_HALF = 3.0, 1e-6


class PoseTask(eqx.Module):
    """Residual of a pose with its Jacobian.

    Attributes:
        error: From the tool to the pose: position in base [m], then rotation [rad];
            shape (row,), 6 rows if the tool's rotation is fixed, else 5.
        jacobian: Motion of these rows by the motors, shape (row, joint); 0 for
            virtual joints.
    """

    error: Float[Array, " row"]
    jacobian: Float[Array, "row joint"]


def pose_task(
    robot: Robot,
    T_base_tool: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> PoseTask:
    """Task of a pose at given joint positions."""
    frames = joint_frames(robot, q)
    J = motor_jacobian(robot, frames, tool_rotation)
    shift = T_base_tool[:3, 3] - frames.tool_position
    turn = (
        rotation_between(T_base_tool[:3, :3], frames.tool_rotation)
        if tool_rotation == "fixed"
        else _tilt(frames.tool_rotation.T @ T_base_tool[:3, 2])
    )
    return PoseTask(jnp.concatenate([shift, turn]), J)


def motor_jacobian(
    robot: Robot, frames: JointFrames, tool_rotation: ToolRotation
) -> Float[Array, "row joint"]:
    """Jacobian of the rows of a task by the motors; free rows are in tool axes."""
    J = jnp.where(robot.motor_mask()[None, :], tool_jacobian(robot, frames), 0.0)
    if tool_rotation == "fixed":
        return J
    across = frames.tool_rotation[:, :2].T
    return jnp.concatenate([J[:3], across @ J[3:]])


def _tilt(axis: Float[Array, " 3"]) -> Float[Array, " 2"]:
    """Rotation about x and y that turns z to an axis: 2 sin(angle / 2) long."""
    # |z + axis| / 2 = cos(angle / 2), and |z x axis| = sin(angle); the floor keeps half
    # a turn finite.
    cross = jnp.stack([-axis[1], axis[0]])
    half_cosine = jnp.sqrt(jnp.maximum(0.5 * (1.0 + axis[2]), _HALF_TURN_COSINE))
    # There the cross product vanishes: its length is that of the rotation, and where it
    # is only rounding any direction will do.
    sine = jnp.sum(cross**2)
    is_known = sine > jnp.finfo(axis.dtype).eps ** 2
    along = cross / jnp.sqrt(jnp.where(is_known, sine, 1.0))
    along = jnp.where(is_known, along, jnp.eye(2, dtype=axis.dtype)[0])
    length = jnp.sqrt(2.0 - 2.0 * jnp.minimum(axis[2], 0.0))
    is_half_turn = 0.5 * (1.0 + axis[2]) < _HALF_TURN_COSINE
    return jnp.where(is_half_turn, length * along, cross / half_cosine)


def damped_step(
    J: Float[Array, "row joint"],
    error: Float[Array, " row"],
    damping: Float[Array, ""] | None,
    weights: Float[Array, " joint"] | None = None,
) -> Float[Array, " joint"]:
    """Step W J^T (J W J^T + damping I)^-1 error, finite everywhere; W = 1 if None.

    A floor of the damping keeps it finite. Without damping (None) the step is repeated
    for the error that the floor leaves, so that the error is met to rounding in every
    direction in which the joints can move at all.
    """
    scaled = J if weights is None else J * weights[None]
    gram = scaled @ J.T
    # The floor is far above rounding and far below any useful singular value.
    floor = jnp.asarray(jnp.finfo(J.dtype).eps ** 0.75, J.dtype) * jnp.trace(gram)
    shift = floor if damping is None else damping + floor
    eye = jnp.eye(J.shape[0], dtype=J.dtype)
    inverse = scaled.T @ small_inverse(gram + shift * eye)
    step = inverse @ error
    if damping is None:
        for _ in range(_REPEATS):
            step = step + inverse @ (error - J @ step)
    return step


def has_choice(robot: Robot, tool_rotation: ToolRotation) -> bool:
    """True if a pose may leave a family of solutions to choose from."""
    return tool_rotation == "free" or len(robot.motor_joints) > 6


def chosen_step(
    robot: Robot,
    T_base_tool: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    damping: Float[Array, ""] | None,
    share: float = 1.0,
) -> Float[Array, " joint"]:
    """Step to the pose and, where that leaves a choice, to the middle [rad or m].

    A Gauss-Newton step for the pose, in the metric of the pull's slope; in its null
    space a share of a Newton step for the pull. It vanishes at the solution.
    """
    task = pose_task(robot, T_base_tool, q, tool_rotation)
    lower, upper = robot.joint_lower, robot.joint_upper
    is_limited = jnp.isfinite(lower) & jnp.isfinite(upper)
    low, high = (jnp.where(is_limited, limit, 0.0) for limit in (lower, upper))
    half = jnp.where(is_limited, (high - low) / 2, _UNLIMITED_HALF)
    half = jnp.maximum(half, _LEAST_HALF)
    middle = jnp.where(is_limited, (low + high) / 2, robot.home)
    x = clamp(-_HIGHEST_WALL, (q - middle) / half, _HIGHEST_WALL)
    slope = 1.0 + _WALL_POWER * x ** (_WALL_POWER - 1)
    pull = -share * half * (x + x**_WALL_POWER) / slope
    pull = jnp.where(robot.motor_mask(), pull, -q)
    error = task.error - task.jacobian @ pull
    return pull + damped_step(task.jacobian, error, damping, half**2 / slope)


def choice_slope(
    robot: Robot,
    T_base_tool: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> Float[Array, "joint joint"]:
    """Derivative of the undamped `chosen_step` by the joint positions."""
    step = lambda x: chosen_step(robot, T_base_tool, x, tool_rotation, None)
    return jax.jacfwd(step)(q)
