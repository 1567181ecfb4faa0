"""Configurations in which an arm can stand at a pose and follow a path."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._types import Transform
from .._model.robot import JointVector, Robot, joint_vector
from .inverse import (
    inverse_kinematics,
    inverse_kinematics_path,
    motor_limits,
    start_elsewhere,
    unwound,
)
from .pose_error import ToolRotation

# Numbers of searches for a pose, of rows of a path that are checked, and of
# configurations that are followed.
_SEARCH_COUNT, _ROW_COUNT, _FOLLOWED_COUNT = 64, 1000, 32
# Largest difference in every joint of two solutions that are the same [rad or m].
_SAME_SOLUTION = 1e-2


def configurations(
    robot: Robot,
    T_base_tool: Transform,
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
) -> Float[np.ndarray, "configuration joint"]:
    """Different joint positions within limits that bring the tool to a pose.

    An arm with more joints than the pose needs has endlessly many; some are returned.
    A joint that may turn by more than a whole turn counts once near the start and once
    near the middle of its range.

    Args:
        robot: The robot.
        T_base_tool: The pose, shape (4, 4).
        q_start: Present joint positions of the arm [rad or m], shape (joint,).
        tool_rotation: As for `inverse_kinematics`.

    Returns:
        Joint positions [rad or m], shape (configuration, joint), the nearest to the
        start first; none where the pose is out of reach.

    **Differentiability**: none, a search on the host.
    """
    start = joint_vector(robot, q_start, "q_start")
    T = jnp.asarray(T_base_tool, robot.dtype)
    ends, is_good = jax.device_get(_searches(robot, T, start, tool_rotation))
    rows = ends[is_good]
    lower, upper = (np.asarray(limit) for limit in motor_limits(robot))
    is_limited = np.isfinite(lower) & np.isfinite(upper)
    half = np.where(is_limited, (upper - lower) / 2, np.pi)
    apart = np.linalg.norm((rows - np.asarray(start)) / half, axis=1)
    rows = rows[np.argsort(apart)]
    solutions: list[Float[np.ndarray, " joint"]] = []
    for row in rows:
        if all(np.max(np.abs(row - x)) > _SAME_SOLUTION for x in solutions):
            solutions.append(row)
    return np.array(solutions).reshape(-1, robot.joint_count)


def path_starts(
    robot: Robot,
    Ts_base_tool: Float[Array, "step 4 4"] | Float[np.ndarray, "step 4 4"],
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
) -> Float[np.ndarray, "configuration joint"]:
    """Configurations of the first pose from which a path is followed in limits.

    Args:
        robot: The robot.
        Ts_base_tool: The poses, shape (step, 4, 4); of a long path, rows that are
            evenly spread are checked.
        q_start: Present joint positions of the arm [rad or m], shape (joint,).
        tool_rotation: As for `inverse_kinematics`.

    Returns:
        Joint positions [rad or m], shape (configuration, joint), the nearest to the
        start first; none if no configuration was found that follows the path.

    **Differentiability**: none, a search on the host.
    """
    Ts = np.asarray(Ts_base_tool, np.dtype(robot.dtype))
    starts = configurations(robot, Ts[0], q_start, tool_rotation=tool_rotation)
    if not len(starts):
        return starts
    starts = starts[:_FOLLOWED_COUNT]
    count = min(len(Ts), _ROW_COUNT)
    rows = np.unique(np.linspace(0, len(Ts) - 1, count).astype(int))
    # One size needs one compilation.
    filled = starts[np.arange(_FOLLOWED_COUNT) % len(starts)]
    is_good = np.asarray(
        _follow(robot, jnp.asarray(Ts[rows]), jnp.asarray(filled), tool_rotation)
    )
    return starts[is_good[: len(starts)]]


@functools.partial(jax.jit, static_argnames="tool_rotation")
def _searches(
    robot: Robot,
    T: Float[Array, "4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> tuple[Float[Array, "search joint"], Bool[Array, " search"]]:
    """Ends of searches from all over the joints' ranges [rad or m], True for good ones.

    Each search has two ends: near the start, and near the middle of the ranges.
    """
    lower, upper = motor_limits(robot)
    is_limited = jnp.isfinite(lower) & jnp.isfinite(upper)
    middle = jnp.where(is_limited, (lower + upper) / 2, q_start)

    def search(count):
        start = start_elsewhere(robot, q_start, count, _SEARCH_COUNT)
        solution = inverse_kinematics(
            robot, T, start, tool_rotation=tool_rotation, attempts=2
        )
        is_good = solution.converged & solution.within_limits
        near = jnp.stack([unwound(robot, solution.q, at) for at in (q_start, middle)])
        return near, jnp.stack([is_good, is_good])

    q, is_good = jax.vmap(search)(jnp.arange(_SEARCH_COUNT))
    return q.reshape(-1, q.shape[-1]), is_good.ravel()


@functools.partial(jax.jit, static_argnames="tool_rotation")
def _follow(
    robot: Robot,
    Ts: Float[Array, "step 4 4"],
    starts: Float[Array, "configuration joint"],
    tool_rotation: ToolRotation,
) -> Bool[Array, " configuration"]:
    """True for the starts from which a path is followed, within limits all the way."""

    def one(start):
        solution = inverse_kinematics_path(
            robot, Ts, start, tool_rotation=tool_rotation, attempts=1
        )
        return jnp.all(solution.converged & solution.within_limits)

    return jax.vmap(one)(starts)
