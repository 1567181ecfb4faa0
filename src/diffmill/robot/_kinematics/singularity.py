"""Singularity of a pose: distance from one where the tool cannot move every way."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.robot import JointVector, Robot, joint_vector
from .forward import joint_frames
from .pose_error import ToolRotation, motor_jacobian


class Singularity(eqx.Module):
    """Singularity measures of one pose.

    Lengths count in units of the arm's, so that shifts and rotations compare: L is the
    longest distance, at right angles, from the tip to the axis of a motor that turns
    the tool, or 1 m without one.

    Attributes:
        smallest: Smallest singular value of the Jacobian of the motors in these units
            [-], shape (); 0 at a singular pose, of the order of 1 far from one.
        condition: Largest by smallest singular value [-], shape (); infinite at a
            singular pose.
        joint_direction: Motion of the joints that moves the tool least, of length 1
            in these units [rad or m / L], shape (joint,); its sign is arbitrary.
    """

    smallest: Float[Array, ""]
    condition: Float[Array, ""]
    joint_direction: Float[Array, " joint"]


def singularity(
    robot: Robot, q: JointVector, *, tool_rotation: ToolRotation = "fixed"
) -> Singularity:
    """Singularity measures of joint positions.

    An arm with fewer motors than a pose has numbers counts as singular only where two
    motions of its joints move the tool alike; one with more, only where it loses a
    direction of the tool.

    Args:
        robot: The robot; virtual joints are held.
        q: Joint positions [rad or m], shape (joint,).
        tool_rotation: "free" if the rotation about the tool axis need not be moved.

    Returns:
        The measure; batches by `vmap`.

    **Differentiability**: smooth where the smallest singular value is alone.
    """
    return _singularity(robot, joint_vector(robot, q, "q"), tool_rotation)


@functools.partial(jax.jit, static_argnames="tool_rotation")
def _singularity(
    robot: Robot, q: Float[Array, " joint"], tool_rotation: ToolRotation
) -> Singularity:
    # symbols: L length of the arm
    motors = list(robot.motor_joints)
    slides = robot.joint_prismatic_mask()[motors]
    is_slide = jnp.asarray(slides)
    J = motor_jacobian(robot, joint_frames(robot, q), tool_rotation)[:, motors]
    L = jnp.ones((), q.dtype)
    # Else a batch would be a large constant, which the compiler folds for seconds.
    if not slides.all():
        reach = jnp.max(jnp.where(is_slide, 0.0, jnp.sum(J[:3] ** 2, axis=0)))
        L = jnp.sqrt(jnp.where(reach > 0.0, reach, 1.0))
    rows = jnp.concatenate([J[:3] / L, J[3:]]) * jnp.where(is_slide, L, 1.0)[None]
    # A wide matrix has joint motions that do nothing; they are no loss.
    _, values, right = jnp.linalg.svd(rows, full_matrices=False)
    direction = jnp.zeros_like(q).at[jnp.asarray(motors)].set(right[-1])
    # A singular value within the rounding of the largest is 0.
    is_singular = values[-1] <= 8.0 * jnp.finfo(values.dtype).eps * values[0]
    safe = jnp.where(is_singular, 1.0, values[-1])
    return Singularity(
        smallest=jnp.where(is_singular, 0.0, values[-1]),
        condition=jnp.where(is_singular, jnp.inf, values[0] / safe),
        joint_direction=direction,
    )
