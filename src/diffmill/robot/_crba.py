"""Mass matrix by composite rigid bodies (Walker and Orin, 1982).

Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2, with all spatial
quantities about one point: the composite inertia is a plain sum over descendants.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._kinematics import JointFrames, joint_frames, link_inertia_rows
from ._mimic import fold
from ._robot import JointVector, Robot, joint_vector
from ._spatial import apply_inertia, sum_rows


def mass_matrix(robot: Robot, q: JointVector) -> Float[Array, "joint joint"]:
    """Return the mass matrix M(q), links only (rotors are not modelled).

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        M [kg m^2, kg m or kg], symmetric, shape (joint, joint).

    **Differentiability**: smooth.
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
    """Return M from known frames and link inertias."""
    moves = robot.ancestry()
    composite = sum_rows(moves.T, inertias)
    S = frames.screws
    force, moment = apply_inertia(composite, S[:, :3], S[:, 3:])
    # Row j: the force that moves everything behind joint j at unit acceleration of
    # j, felt by joint i. It holds where i is an ancestor of j.
    felt = sum_rows(jnp.concatenate([force, moment], axis=-1), S.T)
    below = moves * felt
    strictly_below = (moves - jnp.eye(robot.body_count, dtype=S.dtype)) * felt
    M = below + strictly_below.T
    return fold(robot, fold(robot, M).T)
