"""Mass matrix by composite rigid bodies (Walker and Orin, 1982).

Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2, with all spatial
quantities about one point: the composite inertia is a plain sum over descendants.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import apply_inertia, cross, sum_rows
from .._kinematics.forward import JointFrames, joint_frames, link_inertia_rows
from .._model.mimic import fold
from .._model.robot import JointVector, Robot, joint_vector


def mass_matrix(robot: Robot, q: JointVector) -> Float[Array, "joint joint"]:
    """Mass matrix M(q), links only (rotors are not modelled).

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        M [kg m^2, kg m or kg], symmetric, shape (joint, joint).
    """
    return _mass_matrix(robot, joint_vector(robot, q, "q"))


@jax.jit
def _mass_matrix(
    robot: Robot, q: Float[Array, " joint"]
) -> Float[Array, "joint joint"]:
    frames = joint_frames(robot, q)
    return composite_mass_matrix(robot, frames, link_inertia_rows(robot, frames))


def composite_mass_matrix(
    robot: Robot, frames: JointFrames, inertias: Float[Array, "body 13"]
) -> Float[Array, "joint joint"]:
    """Mass matrix M from known frames and link inertias."""
    force = _composite_force(robot, frames, inertias)
    return _between_joints(robot, sum_rows(force, frames.screws.T))


def gravity_stiffness(
    robot: Robot, frames: JointFrames, inertias: Float[Array, "body 13"]
) -> Float[Array, "joint joint"]:
    """Slope dG/dq, symmetric, from known frames and link inertias.

    A joint i before joint j turns all that j carries against gravity as if gravity
    turned the other way, by w_i x g: this is the derivative of the torque of j.
    """
    force = _composite_force(robot, frames, inertias)[:, :3]
    turned = cross(
        frames.screws[:, 3:], jnp.broadcast_to(robot.gravity[None], force.shape)
    )
    return _between_joints(robot, sum_rows(force, turned.T))


def _composite_force(
    robot: Robot, frames: JointFrames, inertias: Float[Array, "body 13"]
) -> Float[Array, "body 6"]:
    """Force that moves all behind each joint at its unit acceleration."""
    composite = sum_rows(robot.ancestry().T, inertias)
    S = frames.screws
    force, moment = apply_inertia(composite, S[:, :3], S[:, 3:])
    return jnp.concatenate([force, moment], axis=-1)


def _between_joints(
    robot: Robot, torques: Float[Array, "body body"]
) -> Float[Array, "joint joint"]:
    """Symmetric matrix of the joints from the torques at the ancestors of bodies.

    Args:
        robot: The robot.
        torques: Row j, column i: torque at joint i from body j; it holds where i is an
            ancestor of j.
    """
    moves = robot.ancestry()
    strictly = moves - jnp.eye(robot.body_count, dtype=torques.dtype)
    whole = moves * torques + (strictly * torques).T
    return fold(robot, fold(robot, whole).T)
