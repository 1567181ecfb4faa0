"""Accelerations of the joints under given torques."""

import jax
import jax.scipy.linalg as jsl
from jaxtyping import Array, Float

from ._massless import factor, refuse_singular
from ._robot import JointVector, Robot, Wrench, joint_vector, wrench_vector
from ._terms import arm_terms


def forward_dynamics(
    robot: Robot,
    q: JointVector,
    qd: JointVector,
    tau: JointVector,
    wrench: Wrench | None = None,
    *,
    algorithm: str = "crba",
) -> Float[Array, " joint"]:
    """Return the joint accelerations: M^-1 (tau + J^T F - C - G).

    Gravity is included; springs and dampers of the drives are not.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
        qd: Joint velocities [rad/s or m/s], shape (joint,).
        tau: Torques that act on the joints [N m or N], shape (joint,).
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,); None for none.
        algorithm: "crba": mass matrix by composite bodies and a Cholesky factor.

    Returns:
        Accelerations [rad/s^2 or m/s^2], shape (joint,).

    Raises:
        ValueError: If M is singular because joints move no mass; under `jit` and
            `vmap` the accelerations are not a number instead.

    **Differentiability**: smooth.
    """
    if algorithm != "crba":
        raise ValueError(f"Argument `algorithm` must be 'crba', but is {algorithm!r}.")
    accelerations = _forward_dynamics(
        robot,
        joint_vector(robot, q, "q"),
        joint_vector(robot, qd, "qd"),
        joint_vector(robot, tau, "tau"),
        wrench_vector(robot, wrench),
    )
    return refuse_singular(robot, accelerations, "forward dynamics")


@jax.jit
def _forward_dynamics(
    robot: Robot,
    q: Float[Array, " joint"],
    qd: Float[Array, " joint"],
    tau: Float[Array, " joint"],
    wrench: Float[Array, " 6"],
) -> Float[Array, " joint"]:
    terms = arm_terms(robot, q, qd)
    load = tau + terms.jacobian.T @ wrench - terms.bias_forces
    return jsl.cho_solve((factor(terms.mass_matrix), True), load)
