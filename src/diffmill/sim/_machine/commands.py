"""From the tips that a program commands to the motors of the job's robot."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._job import Job
from ...robot import PathSolution, inverse_kinematics_path, motor_positions
from ...workpiece import tool_frame


def path_axes(job: Job) -> Float[Array, "step 3"] | None:
    """Return the tool axes of the path, or None if the tool stands upright."""
    return jnp.asarray(job.path.axes) if job.simulation.axes else None


def command_joints(
    job: Job, commanded: Float[Array, "step 3"]
) -> tuple[Float[Array, "step joint"], Bool[Array, " step"]]:
    """Return the joint positions of tip positions, and which of them are reached.

    The tool axis is the path's, tool x as near to x of `work` as that allows, or as
    it suits the joints if the job leaves the tool's rotation free.

    Args:
        job: The job, in its precision; its machine must be a robot.
        commanded: Tip positions in `work` [m], shape (step, 3).

    Returns:
        Joint positions [rad or m], shape (step, joint), and whether each tip is
        reached, shape (step,).

    Raises:
        ValueError: The job has no robot.

    **Differentiability**: that of `inverse_kinematics_path`.
    """
    found = command_path(job, commanded)
    return found.q, found.converged


def command_path(job: Job, commanded: Float[Array, "step 3"]) -> PathSolution:
    """Return what inverse kinematics finds for tip positions, as `command_joints`."""
    robot = job.robot
    if robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    Ts = command_poses(job, commanded)
    start = robot.home if job.joint_start is None else jnp.asarray(job.joint_start)
    return inverse_kinematics_path(robot, Ts, start, tool_rotation=job.tool_rotation)


def command_poses(
    job: Job, commanded: Float[Array, "step 3"]
) -> Float[Array, "step 4 4"]:
    """Return the poses of the tool in the base for tip positions in `work`."""
    T_base_work = jnp.asarray(job.T_base_work)
    tips = commanded @ T_base_work[:3, :3].T + T_base_work[:3, 3][None]
    Ts = jnp.broadcast_to(T_base_work[None], (commanded.shape[0], 4, 4))
    axes = path_axes(job)
    if axes is not None:
        frames = tool_frame(axes.astype(Ts.dtype))
        Ts = Ts.at[:, :3, :3].set(T_base_work[None, :3, :3] @ frames)
    return Ts.at[:, :3, 3].set(tips)


def command_motors(
    job: Job, commanded: Float[Array, "step 3"]
) -> tuple[Float[Array, "step joint"], Bool[Array, " step"]]:
    """Return the motor positions of tip positions, and which of them are reached.

    Args:
        job: The job, in its precision; its machine must be a robot.
        commanded: Tip positions in `work` [m], shape (step, 3).

    Returns:
        As `command_joints`, for the motors.

    **Differentiability**: that of `inverse_kinematics_path`.
    """
    q, is_reached = command_joints(job, commanded)
    return joint_motors(job, q), is_reached


def joint_motors(
    job: Job, joints: Float[Array, "step joint"]
) -> Float[Array, "step joint"]:
    """Return the motor positions for commanded joints, sag added if compensated.

    Args:
        job: The job, in its precision.
        joints: Commanded joint positions [rad or m], shape (step, joint).

    Returns:
        Motor positions [rad or m], shape (step, joint).

    **Differentiability**: that of `motor_positions`.
    """
    robot = job.robot
    is_compensated = job.simulation.is_gravity_compensated
    return jax.vmap(
        lambda row: motor_positions(robot, row, is_gravity_compensated=is_compensated)  # pyright: ignore[reportArgumentType]
    )(joints)
