"""Inverse kinematics by damped Newton steps, for one pose and for a path.

The search runs without derivatives. A last Newton step with a constant inverse of
the Jacobian then carries the derivative of the implicit function, exactly and at the
price of one forward kinematics. Virtual joints stay at 0.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from .._types import Transform
from ._kinematics import joint_frames
from ._pose_task import ToolRotation, damped_inverse, free_slope, free_step, pose_task
from ._robot import JointVector, Robot, joint_vector

_POSE_STEPS = 60
_PATH_STEPS = 4
# Longest step of the search [rad or m]: beyond it the linear picture misleads.
_LONGEST_STEP = 0.3
# Squared error below which the linear picture holds [m^2 + rad^2].
_NEAR = 1e-6
# Share of the step to the middle of the ranges that is safe far from it.
_PULL_SHARE = 0.3


class PoseSolution(eqx.Module):
    """The joint positions of one pose.

    Attributes:
        q: Joint positions [rad or m], shape (joint,).
        converged: Whether the tool is at the pose.
        position_residual: Distance of the tool's origin to the pose [m], shape ().
        rotation_residual: Angle from the tool to the pose; with a free rotation that
            of the tool axis [rad], shape ().
        within_limits: Whether all joints are within their limits.
        limit_excess: How far each joint is beyond its limits [rad or m], shape
            (joint,).
    """

    q: Float[Array, " joint"]
    converged: Bool[Array, ""]
    position_residual: Float[Array, ""]
    rotation_residual: Float[Array, ""]
    within_limits: Bool[Array, ""]
    limit_excess: Float[Array, " joint"]


class PathSolution(eqx.Module):
    """The joint positions of every pose of a path.

    Attributes:
        q: Joint positions [rad or m], shape (step, joint).
        converged: Whether the tool is at the pose, shape (step,).
        position_residual: Distance of the tool's origin to the pose [m], (step,).
        rotation_residual: Angle from the tool to the pose; with a free rotation that
            of the tool axis [rad], shape (step,).
        within_limits: Whether all joints are within their limits, shape (step,).
        limit_excess: How far each joint is beyond its limits [rad or m], shape
            (step, joint).
        midway_error: How far the tip is from the middle between two poses when every
            joint is half way between them [m], shape (step,); 0 in row 0. Of the order
            of (step length)^2 / arm length, but where the arm changes its
            configuration between two rows.
    """

    q: Float[Array, "step joint"]
    converged: Bool[Array, " step"]
    position_residual: Float[Array, " step"]
    rotation_residual: Float[Array, " step"]
    within_limits: Bool[Array, " step"]
    limit_excess: Float[Array, "step joint"]
    midway_error: Float[Array, " step"]


def inverse_kinematics(
    robot: Robot,
    T_base_tool: Transform,
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
) -> PoseSolution:
    """Return joint positions that bring the tool to a pose.

    Args:
        robot: The robot.
        T_base_tool: The pose, shape (4, 4).
        q_start: Where the search begins [rad or m], shape (joint,); it decides
            which of several solutions is found.
        tool_rotation: "fixed", or "free": of the pose's rotation only the tool axis
            counts, and a joint more than that needs stands near the middle of its
            range, or near home if it has no limits.

    Returns:
        The solution; check `converged` and `within_limits`.

    **Differentiability**: in the pose and the robot, first derivatives by the
    implicit function; none in `q_start`. Finite, but not meaningful, where the
    search did not converge or the pose is singular.
    """
    start = joint_vector(robot, q_start, "q_start")
    T = jnp.asarray(T_base_tool, dtype=robot.dtype)
    return _solve_pose(robot, T, start, tool_rotation)


def inverse_kinematics_path(
    robot: Robot,
    Ts_base_tool: Float[Array, "step 4 4"] | Float[np.ndarray, "step 4 4"],
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
) -> PathSolution:
    """Return joint positions along a path; each pose starts from the one before.

    Args:
        robot: The robot.
        Ts_base_tool: The poses, each near to the one before, shape (step, 4, 4).
        q_start: Where the search of the first pose begins [rad or m], (joint,).
        tool_rotation: As for `inverse_kinematics`.

    Returns:
        The solution; check `converged`, `within_limits` and, where the poses may be
        far apart, `midway_error`. Batches by `vmap`.

    **Differentiability**: as `inverse_kinematics`, pose by pose.
    """
    start = joint_vector(robot, q_start, "q_start")
    Ts = jnp.asarray(Ts_base_tool, dtype=robot.dtype)
    return _solve_path(robot, Ts, start, tool_rotation)


@functools.partial(jax.jit, static_argnames="tool_rotation")
def _solve_pose(
    robot: Robot,
    T: Float[Array, "4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> PoseSolution:
    q = _search(robot, T, _rest_virtual(robot, q_start), _POSE_STEPS, tool_rotation)
    return _finish(robot, T, q, tool_rotation)


@functools.partial(jax.jit, static_argnames="tool_rotation")
def _solve_path(
    robot: Robot,
    Ts: Float[Array, "step 4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> PathSolution:
    def follow(q, T):
        q = _search(robot, T, q, _PATH_STEPS, tool_rotation)
        return q, q

    start = _rest_virtual(robot, q_start)
    first = _search(robot, Ts[0], start, _POSE_STEPS, tool_rotation)
    _, qs = lax.scan(follow, first, lax.stop_gradient(Ts))
    found = jax.vmap(lambda T, q: _finish(robot, T, q, tool_rotation))(Ts, qs)
    return PathSolution(
        found.q,
        found.converged,
        found.position_residual,
        found.rotation_residual,
        found.within_limits,
        found.limit_excess,
        _midway_error(robot, Ts, found.q),
    )


def _rest_virtual(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, " joint"]:
    return jnp.where(robot.motor_mask(), q, 0.0)


def _midway_error(
    robot: Robot, Ts: Float[Array, "step 4 4"], qs: Float[Array, "step joint"]
) -> Float[Array, " step"]:
    """Return how far joints half way are from the middle of two poses."""
    robot, Ts, qs = lax.stop_gradient((robot, Ts, qs))
    tip = lambda q: joint_frames(robot, q).tool_position
    tips = jax.vmap(tip)((qs[1:] + qs[:-1]) / 2)
    away = tips - (Ts[1:, :3, 3] + Ts[:-1, :3, 3]) / 2
    return jnp.concatenate([jnp.zeros(1, qs.dtype), jnp.linalg.norm(away, axis=1)])


def _search(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    steps: int,
    tool_rotation: ToolRotation,
) -> Float[Array, " joint"]:
    """Return the end of a fixed number of damped Newton steps, without derivative."""
    robot, T, q = lax.stop_gradient((robot, T, q))

    def take(q):
        task = pose_task(robot, T, q, tool_rotation)
        # Damping by the squared error keeps the quadratic convergence.
        size = jnp.sum(task.error**2)
        if tool_rotation == "fixed":
            return damped_inverse(task.jacobian, 1e-2 * size) @ task.error
        return _free_search_step(robot, T, q, size, is_newton=steps == _PATH_STEPS)

    def step(q, _):
        dq = take(q)
        longest = jnp.max(jnp.abs(dq))
        return q + dq * jnp.minimum(1.0, _LONGEST_STEP / (longest + 1e-12)), None

    q, _ = lax.scan(step, q, length=steps)
    return q


def _free_search_step(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    size: Float[Array, ""],
    *,
    is_newton: bool,
) -> Float[Array, " joint"]:
    """Return a step with a free rotation; Newton steps only along a path.

    The self-motion curves, so that a whole plain step along it may go too far, and a
    Newton step from afar may end where the joints are farthest from the middle.
    """
    plain = free_step(robot, T, q, 1e-2 * size, _PULL_SHARE)
    if not is_newton:
        return plain
    whole = free_step(robot, T, q, jnp.zeros_like(size))
    newton = jnp.linalg.solve(free_slope(robot, T, q), -whole)
    return jnp.where((size < _NEAR) & jnp.all(jnp.isfinite(newton)), newton, plain)


def _finish(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> PoseSolution:
    """Take the step that carries the derivative, and judge the result."""
    q = lax.stop_gradient(q)
    none = jnp.zeros((), q.dtype)
    task = pose_task(robot, T, q, tool_rotation)
    # Where the search failed, a full step might go anywhere: keep its value out.
    is_near = jnp.sum(lax.stop_gradient(task.error) ** 2) < _NEAR
    if tool_rotation == "fixed":
        step = lax.stop_gradient(damped_inverse(task.jacobian, none)) @ task.error
    else:
        slope = lax.stop_gradient(free_slope(robot, T, q))
        step = jnp.linalg.solve(slope, -free_step(robot, T, q, none))
    step = jnp.where(is_near, step, step - lax.stop_gradient(step))
    q = q + step
    left = lax.stop_gradient(pose_task(robot, T, q, tool_rotation).error)
    excess = jnp.maximum(robot.joint_lower - q, q - robot.joint_upper)
    tolerance = 100.0 * jnp.finfo(q.dtype).eps ** 0.75
    return PoseSolution(
        q=q,
        converged=jnp.max(jnp.abs(left)) < tolerance,
        position_residual=jnp.linalg.norm(left[:3]),
        rotation_residual=_angle(left[3:]),
        within_limits=jnp.all((q >= robot.joint_lower) & (q <= robot.joint_upper)),
        limit_excess=lax.stop_gradient(jnp.maximum(excess, 0.0)),
    )


def _angle(turn: Float[Array, " row"]) -> Float[Array, ""]:
    """Return the angle of a rotation given as 2 sin(angle / 2) times its axis."""
    return 2.0 * jnp.arcsin(jnp.minimum(0.5 * jnp.linalg.norm(turn), 1.0))
