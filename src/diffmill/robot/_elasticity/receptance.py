"""Receptance of the tool: displacement per oscillating force."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._dynamics.crba import mass_matrix
from .._kinematics.forward import jacobian
from .._model.robot import JointVector, Robot, joint_vector


def receptance(
    robot: Robot,
    q: JointVector,
    frequencies: Float[Array, " frequency"] | Float[np.ndarray, " frequency"],
) -> Complex[Array, "frequency 3 3"]:
    """Tip's displacement per oscillating force, with the motors locked.

        G(omega) = J (K + i omega D - omega^2 M)^-1 J^T

    Args:
        robot: The robot; rigid joints are allowed.
        q: Joint positions [rad or m], shape (joint,).
        frequencies: [Hz], shape (frequency,); 0 gives the static compliance.

    Returns:
        Displacement of the tool's origin per force on it, both in base axes
        [m/N], shape (frequency, 3, 3); time goes as exp(i omega t).

    **Differentiability**: smooth, but at a resonance of an undamped arm.
    Reference: the impedance of a linear system at one frequency; no modes are
    assumed, so dampers may couple them.
    """
    hertz = jnp.asarray(frequencies, dtype=robot.dtype)
    return _receptance(robot, joint_vector(robot, q, "q"), hertz)


@jax.jit
def _receptance(
    robot: Robot, q: Float[Array, " joint"], hertz: Float[Array, " frequency"]
) -> Complex[Array, "frequency 3 3"]:
    # With S = K^-1/2 on both sides the impedance is 1 where K was, and a rigid joint
    # (S = 0) needs no case of its own.
    S = jax.lax.rsqrt(robot.joint_stiffness)
    M = S[:, None] * mass_matrix(robot, q) * S[None]
    D = jnp.diag(S**2 * robot.joint_damping)
    J = jacobian(robot, q)[:3] * S[None]
    eye = jnp.eye(robot.joint_count, dtype=M.dtype)

    def at(omega):
        impedance = jax.lax.complex(eye - omega**2 * M, omega * D)
        full = jax.lax.complex(J, jnp.zeros_like(J))
        return full @ jnp.linalg.solve(impedance, full.T)

    return jax.vmap(at)(2.0 * jnp.pi * hertz)
