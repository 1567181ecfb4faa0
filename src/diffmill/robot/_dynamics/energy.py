"""Mechanical energy of an arm: kinetic, of its springs and of its weight."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import apply_matrix
from .._kinematics.forward import joint_frames, link_inertia_rows
from .._model.robot import JointVector, Robot, joint_vector
from .crba import composite_mass_matrix


def mechanical_energy(
    robot: Robot, q: JointVector, qd: JointVector, theta: JointVector
) -> Float[Array, ""]:
    """Energy of the arm with linear springs.

        E = qd^T M qd / 2 + (theta - q)^T K (theta - q) / 2 - sum m g . c

    Args:
        robot: The robot; its stiffness must be finite.
        q: Joint positions [rad or m], shape (joint,).
        qd: Joint velocities [rad/s or m/s], shape (joint,).
        theta: Motor positions [rad or m], shape (joint,); 0 for virtual joints.

    Returns:
        Energy [J], shape (); the weight counts from the base's origin.
    """
    return _mechanical_energy(
        robot,
        joint_vector(robot, q, "q"),
        joint_vector(robot, qd, "qd"),
        joint_vector(robot, theta, "theta"),
    )


@jax.jit
def _mechanical_energy(
    robot: Robot,
    q: Float[Array, " joint"],
    qd: Float[Array, " joint"],
    theta: Float[Array, " joint"],
) -> Float[Array, ""]:
    frames = joint_frames(robot, q)
    M = composite_mass_matrix(robot, frames, link_inertia_rows(robot, frames))
    centers = frames.positions + apply_matrix(frames.rotations, robot.link_centers)
    weight = -jnp.sum(robot.link_masses * (centers @ robot.gravity))
    springs = jnp.sum(robot.joint_stiffness * (theta - q) ** 2) / 2
    return qd @ (M @ qd) / 2 + springs + weight
