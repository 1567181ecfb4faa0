"""Compliance of the arm: stiffness, static deflection and sag of the tool."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.rotations import rotation_between
from .._kinematics.forward import forward_kinematics, jacobian
from .._model.robot import JointVector, Robot, Wrench, joint_vector
from .static_balance import loaded_equilibrium, motor_positions


def cartesian_compliance(robot: Robot, q: JointVector) -> Float[Array, "6 6"]:
    """Compliance of the tool: J K^-1 J^T.

    Springs only: the change of the torques of gravity and load with the pose, some
    per mille of K on an industrial arm, is left out.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Displacement and rotation of the tool per wrench, both at the tool's origin
        in base axes, linear part first [m/N, 1/N, rad/(N m)], shape (6, 6).
    """
    J = jacobian(robot, q)
    return (J / robot.joint_stiffness[None]) @ J.T


def principal_stiffness(robot: Robot, q: JointVector) -> Float[Array, " 3"]:
    """Stiffness of the tool's tip in its principal directions.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Eigenvalues of the inverse of the translational part of `cartesian_compliance`,
        so of a tool that is free to rotate [N/m], ascending, shape (3,); infinite where
        the tip is rigid.

    **Differentiability**: smooth where no two of them coincide.
    """
    softness = jnp.linalg.eigvalsh(cartesian_compliance(robot, q)[:3, :3])[::-1]
    # A softness within the rounding of the largest counts as none.
    least = 8.0 * jnp.finfo(softness.dtype).eps * softness[0]
    is_soft = softness > jax.lax.stop_gradient(least)
    return jnp.where(is_soft, 1.0 / jnp.where(is_soft, softness, 1.0), jnp.inf)


def static_deflection(
    robot: Robot, q: JointVector, wrench: Wrench
) -> Float[Array, " 6"]:
    """Displacement of the tool at rest by a wrench.

    From the balance under gravity to the balance under gravity and the wrench, which
    keeps its direction; the motors stand as for `motor_positions(robot, q)`. To first
    order it is `cartesian_compliance(robot, q) @ wrench`; virtual joints bend too.

    Args:
        robot: The robot.
        q: Joint positions of the unloaded robot [rad or m], shape (joint,).
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,).

    Returns:
        Displacement of the tool's origin and rotation of the tool in base axes
        [m, rad], shape (6,).

    **Differentiability**: smooth; first derivatives by the implicit function.
    """
    theta = motor_positions(robot, q)
    unloaded = loaded_equilibrium(robot, theta)
    return _motion(robot, unloaded, loaded_equilibrium(robot, theta, wrench))


def gravity_sag(robot: Robot, q: JointVector) -> Float[Array, " 6"]:
    """Displacement of the tool by the arm's own weight, if no motor makes up for it.

    Args:
        robot: The robot.
        q: Motor positions [rad or m], shape (joint,).

    Returns:
        Displacement of the tool's origin and rotation of the tool in base axes
        [m, rad], shape (6,).

    **Differentiability**: smooth; first derivatives by the implicit function.
    """
    start = jnp.where(robot.motor_mask(), joint_vector(robot, q, "q"), 0.0)
    return _motion(robot, start, loaded_equilibrium(robot, start))


def _motion(
    robot: Robot, start: Float[Array, " joint"], end: Float[Array, " joint"]
) -> Float[Array, " 6"]:
    """Displacement and rotation of the tool between two poses."""
    before, after = forward_kinematics(robot, start), forward_kinematics(robot, end)
    turn = rotation_between(after[:3, :3], before[:3, :3])
    return jnp.concatenate([after[:3, 3] - before[:3, 3], turn])
