"""Inverse kinematics by damped Newton steps, for one pose and for a path.

The search runs without derivatives. A last Newton step with a constant inverse of
the Jacobian then carries the derivative of the implicit function, exactly and at the
price of one forward kinematics. Virtual joints stay at 0.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from .._types import Transform
from ._kinematics import joint_frames, tool_jacobian
from ._robot import JointVector, Robot, joint_vector
from ._rotations import rotation_between

_POSE_STEPS = 60
_PATH_STEPS = 4
# Longest step of the search [rad or m]: beyond it the linear picture misleads.
_LONGEST_STEP = 0.3


class PoseSolution(eqx.Module):
    """The joint positions of one pose.

    Attributes:
        q: Joint positions [rad or m], shape (joint,).
        converged: Whether the tool is at the pose.
        position_residual: Distance of the tool's origin to the pose [m], shape ().
        within_limits: Whether all joints are within their limits.
    """

    q: Float[Array, " joint"]
    converged: Bool[Array, ""]
    position_residual: Float[Array, ""]
    within_limits: Bool[Array, ""]


class PathSolution(eqx.Module):
    """The joint positions of every pose of a path.

    Attributes:
        q: Joint positions [rad or m], shape (step, joint).
        converged: Whether the tool is at the pose, shape (step,).
        position_residual: Distance of the tool's origin to the pose [m], (step,).
        within_limits: Whether all joints are within their limits, shape (step,).
    """

    q: Float[Array, "step joint"]
    converged: Bool[Array, " step"]
    position_residual: Float[Array, " step"]
    within_limits: Bool[Array, " step"]


def inverse_kinematics(
    robot: Robot, T_base_tool: Transform, q_start: JointVector
) -> PoseSolution:
    """Return joint positions that bring the tool to a pose.

    Args:
        robot: The robot.
        T_base_tool: The pose, shape (4, 4).
        q_start: Where the search begins [rad or m], shape (joint,); it decides
            which of several solutions is found.

    Returns:
        The solution; check `converged` and `within_limits`.

    **Differentiability**: in the pose and the robot, first derivatives by the
    implicit function; none in `q_start`. Finite, but not meaningful, where the
    search did not converge or the pose is singular.
    """
    start = joint_vector(robot, q_start, "q_start")
    return _solve_pose(robot, jnp.asarray(T_base_tool, dtype=robot.dtype), start)


def inverse_kinematics_path(
    robot: Robot,
    Ts_base_tool: Float[Array, "step 4 4"] | Float[np.ndarray, "step 4 4"],
    q_start: JointVector,
) -> PathSolution:
    """Return joint positions along a path; each pose starts from the one before.

    Args:
        robot: The robot.
        Ts_base_tool: The poses, each near to the one before, shape (step, 4, 4).
        q_start: Where the search of the first pose begins [rad or m], (joint,).

    Returns:
        The solution; check `converged` and `within_limits`.

    **Differentiability**: as `inverse_kinematics`, pose by pose.
    """
    start = joint_vector(robot, q_start, "q_start")
    return _solve_path(robot, jnp.asarray(Ts_base_tool, dtype=robot.dtype), start)


@jax.jit
def _solve_pose(
    robot: Robot, T: Float[Array, "4 4"], q_start: Float[Array, " joint"]
) -> PoseSolution:
    q = _search(robot, T, _rest_virtual(robot, q_start), _POSE_STEPS)
    return _finish(robot, T, q)


@jax.jit
def _solve_path(
    robot: Robot, Ts: Float[Array, "step 4 4"], q_start: Float[Array, " joint"]
) -> PathSolution:
    def follow(q, T):
        q = _search(robot, T, q, _PATH_STEPS)
        return q, q

    first = _search(robot, Ts[0], _rest_virtual(robot, q_start), _POSE_STEPS)
    _, qs = lax.scan(follow, first, lax.stop_gradient(Ts))
    found = jax.vmap(lambda T, q: _finish(robot, T, q))(Ts, qs)
    return PathSolution(
        found.q, found.converged, found.position_residual, found.within_limits
    )


def _rest_virtual(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, " joint"]:
    return jnp.where(robot.motor_mask(), q, 0.0)


def _pose_error(
    robot: Robot, T: Float[Array, "4 4"], q: Float[Array, " joint"]
) -> tuple[Float[Array, " 6"], Float[Array, "6 joint"]]:
    """Return the twist from the tool to the pose, and the motors' Jacobian."""
    frames = joint_frames(robot, q)
    error = jnp.concatenate(
        [
            T[:3, 3] - frames.tool_position,
            rotation_between(T[:3, :3], frames.tool_rotation),
        ]
    )
    J = jnp.where(robot.motor_mask()[None, :], tool_jacobian(robot, frames), 0.0)
    return error, J


def _damped_inverse(
    J: Float[Array, "6 joint"], damping: Float[Array, ""]
) -> Float[Array, "joint 6"]:
    """Return J^T (J J^T + damping I)^-1, finite at singular poses."""
    gram = J @ J.T
    # The floor is far above rounding and far below any useful singular value.
    floor = jnp.asarray(jnp.finfo(J.dtype).eps ** 0.75, J.dtype) * jnp.trace(gram)
    shift = (damping + floor) * jnp.eye(6, dtype=J.dtype)
    return jnp.linalg.solve(gram + shift, J).T


def _search(
    robot: Robot, T: Float[Array, "4 4"], q: Float[Array, " joint"], steps: int
) -> Float[Array, " joint"]:
    """Return the end of a fixed number of damped Newton steps, without derivative."""
    robot, T, q = lax.stop_gradient((robot, T, q))

    def step(q, _):
        error, J = _pose_error(robot, T, q)
        # Damping by the squared error keeps the quadratic convergence.
        dq = _damped_inverse(J, 1e-2 * jnp.sum(error**2)) @ error
        longest = jnp.max(jnp.abs(dq))
        return q + dq * jnp.minimum(1.0, _LONGEST_STEP / (longest + 1e-12)), None

    q, _ = lax.scan(step, q, length=steps)
    return q


def _finish(
    robot: Robot, T: Float[Array, "4 4"], q: Float[Array, " joint"]
) -> PoseSolution:
    """Take the step that carries the derivative, and judge the result."""
    q = lax.stop_gradient(q)
    error, J = _pose_error(robot, T, q)
    none = jnp.zeros((), q.dtype)
    # Where the search failed, a full step might go anywhere: keep its value out.
    is_near = jnp.sum(lax.stop_gradient(error) ** 2) < 1e-6
    step = lax.stop_gradient(_damped_inverse(J, none)) @ error
    step = jnp.where(is_near, step, step - lax.stop_gradient(step))
    q = q + step
    left, _ = _pose_error(robot, T, q)
    left = lax.stop_gradient(left)
    tolerance = 100.0 * jnp.finfo(q.dtype).eps ** 0.75
    return PoseSolution(
        q=q,
        converged=jnp.max(jnp.abs(left)) < tolerance,
        position_residual=jnp.linalg.norm(left[:3]),
        within_limits=jnp.all((q >= robot.joint_lower) & (q <= robot.joint_upper)),
    )
