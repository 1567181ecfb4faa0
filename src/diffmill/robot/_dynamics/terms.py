"""Terms of the equation of motion at one state, with shared work."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import sum_rows
from .._kinematics.forward import (
    joint_frames,
    link_inertia_rows,
    tool_jacobian,
    tool_transform,
)
from .._model.robot import JointVector, Robot, joint_vector
from .aba import articulated_inverse, check_algorithm
from .crba import composite_mass_matrix, gravity_stiffness, mass_matrix
from .mass_inverse import refuse_singular, spd_inverse
from .rnea import newton_euler


class ArmTerms(eqx.Module):
    """The terms of M qdd + C + G = tau + J^T F at one state.

    Attributes:
        joint_positions: q [rad or m], shape (joint,).
        T_base_tool: Pose of the tool, shape (4, 4).
        jacobian: At the tool's origin, base axes, linear rows first, (6, joint).
        mass_matrix: M [kg m^2], shape (joint, joint).
        bias_forces: C + G [N m], shape (joint,).
        gravity_stiffness: dG/dq [N m/rad], symmetric, shape (joint, joint).
    """

    joint_positions: Float[Array, " joint"]
    T_base_tool: Float[Array, "4 4"]
    jacobian: Float[Array, "6 joint"]
    mass_matrix: Float[Array, "joint joint"]
    bias_forces: Float[Array, " joint"]
    gravity_stiffness: Float[Array, "joint joint"]

    def augmented_inverse(
        self, diagonal: Float[Array, " joint"] | None = None
    ) -> Float[Array, "joint joint"]:
        """(M + diag(d))^-1, shape (joint, joint), differentiated as an inverse.

        Args:
            diagonal: d [kg m^2], shape (joint,); 0 if not given.
        """
        M = self.mass_matrix
        return spd_inverse(M if diagonal is None else M + jnp.diag(diagonal))

    @staticmethod
    def articulated_inverse(
        robot: Robot, q: JointVector, diagonal: JointVector
    ) -> Float[Array, "joint joint"]:
        """(M + diag(d))^-1 by articulated bodies, without M.

        Args:
            robot: The robot, without mimic joints.
            q: Joint positions [rad or m], shape (joint,).
            diagonal: d, added to the inertia of each joint [kg m^2 or kg], shape
                (joint,).

        Returns:
            The inverse, symmetric, shape (joint, joint).

        Raises:
            ValueError: If the robot has mimic joints, or if the matrix is singular;
                under `jit` and `vmap` it is not a number instead.
        """
        check_algorithm(robot, "aba")
        inverse = _articulated_inverse(
            robot,
            joint_vector(robot, q, "q"),
            joint_vector(robot, diagonal, "diagonal"),
        )
        return refuse_singular(robot, inverse, "inverse mass matrix")

    @staticmethod
    def of_state(robot: Robot, q: JointVector, qd: JointVector) -> "ArmTerms":
        """Terms at one state.

        The reverse mode recomputes the terms from q and qd: inside a scan that is twice
        as fast as storing some thirty intermediates per step.

        Args:
            robot: The robot.
            q: Joint positions [rad or m], shape (joint,).
            qd: Joint velocities [rad/s or m/s], shape (joint,).
        """
        return _arm_terms(
            robot, joint_vector(robot, q, "q"), joint_vector(robot, qd, "qd")
        )


@jax.jit
@jax.checkpoint
def _arm_terms(
    robot: Robot, q: Float[Array, " joint"], qd: Float[Array, " joint"]
) -> ArmTerms:
    frames = joint_frames(robot, q)
    inertias = link_inertia_rows(robot, frames)
    return ArmTerms(
        joint_positions=q,
        T_base_tool=tool_transform(frames),
        jacobian=tool_jacobian(robot, frames),
        mass_matrix=composite_mass_matrix(robot, frames, inertias),
        bias_forces=newton_euler(robot, frames, inertias, qd),
        gravity_stiffness=gravity_stiffness(robot, frames, inertias),
    )


@jax.custom_jvp
def _inverse(
    robot: Robot, q: Float[Array, " joint"], diagonal: Float[Array, " joint"]
) -> Float[Array, "joint joint"]:
    return articulated_inverse(robot, q, diagonal)


@_inverse.defjvp
def _inverse_jvp(
    primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Array, Array]:
    inverse = _inverse(*primals)
    augmented = lambda robot, q, diagonal: mass_matrix(robot, q) + jnp.diag(diagonal)
    _, change = jax.jvp(augmented, primals, tangents)
    return inverse, -sum_rows(inverse, sum_rows(change, inverse))


_articulated_inverse = jax.jit(_inverse)
