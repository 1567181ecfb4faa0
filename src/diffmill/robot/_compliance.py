"""How soft the arm is, and how it rings, with its motors locked."""

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
from jaxtyping import Array, Float

from ._crba import mass_matrix
from ._kinematics import jacobian
from ._robot import JointVector, Robot, joint_vector


def cartesian_compliance(robot: Robot, q: JointVector) -> Float[Array, "6 6"]:
    """Return the compliance of the tool: J K^-1 J^T.

    Springs only: the change of the torques of gravity and load with the pose, some
    per mille of K on an industrial arm, is left out.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Displacement and rotation of the tool per wrench, both at the tool's origin
        in base axes, linear part first [m/N, 1/N, rad/(N m)], shape (6, 6).

    **Differentiability**: smooth.
    """
    J = jacobian(robot, q)
    return (J / robot.joint_stiffness[None]) @ J.T


def natural_frequencies(robot: Robot, q: JointVector) -> Float[Array, " joint"]:
    """Return the undamped natural frequencies with the motors locked.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Frequencies [Hz], ascending, shape (joint,); infinite for a rigid joint.

    **Differentiability**: smooth where no two frequencies coincide.
    """
    return _natural_frequencies(robot, joint_vector(robot, q, "q"))


def damping_ratios(robot: Robot, q: JointVector) -> Float[Array, " joint"]:
    """Return the damping ratio of each natural mode.

    The modal one, phi^T D phi / (2 omega): dampers that couple modes are neglected.

    Args:
        robot: The robot; its stiffness must be finite.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Damping ratios [-] in the order of `natural_frequencies`, shape (joint,).

    **Differentiability**: smooth where no two frequencies coincide.
    """
    return _damping_ratios(robot, joint_vector(robot, q, "q"))


@jax.jit
def _natural_frequencies(
    robot: Robot, q: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    # By compliance, so that an infinite stiffness is an ordinary number:
    # 1 / omega^2 are the eigenvalues of L^T K^-1 L, where M = L L^T.
    L = jnp.linalg.cholesky(mass_matrix(robot, q))
    softness = jnp.linalg.eigvalsh(L.T @ (L / robot.joint_stiffness[:, None]))[::-1]
    is_soft = softness > 0.0
    omega = jax.lax.rsqrt(jnp.where(is_soft, softness, 1.0))
    return jnp.where(is_soft, omega / (2.0 * jnp.pi), jnp.inf)


@jax.jit
def _damping_ratios(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, " joint"]:
    L = jnp.linalg.cholesky(mass_matrix(robot, q))
    scaled = lambda diagonal: jsl.solve_triangular(
        L, jsl.solve_triangular(L, jnp.diag(diagonal), lower=True).T, lower=True
    )
    squares, modes = jnp.linalg.eigh(scaled(robot.joint_stiffness))
    damping = jnp.sum(modes * (scaled(robot.joint_damping) @ modes), axis=0)
    return damping / (2.0 * jnp.sqrt(squares))
