"""Complex modes of the arm, with dampers that may couple them."""

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from .._dynamics.crba import mass_matrix
from .._dynamics.mass_inverse import factor, refuse_singular
from .._kinematics.forward import jacobian
from .._model.robot import JointVector, Robot, joint_vector

# Least imaginary part over the size of a pole that rings.
_LEAST_IMAGINARY_SHARE = 1e-6
# Least time constant over the slowest that is no rounding of a rigid joint's.
_LEAST_TIME_SHARE = 1e-6


class DampedModes(eqx.Module):
    """The modes that ring at one pose, the slowest first.

    Attributes:
        frequencies: Frequencies of ringing, |Im lambda| / (2 pi) [Hz], shape (mode,).
        damping_ratios: -Re lambda / |lambda| [-], shape (mode,).
        joint_shapes: Joint motion per mode, phi^H M phi = 1, complex as the joints need
            not move in step [kg^-1/2 / m or kg^-1/2], shape (mode, joint).
        tool_shapes: J phi: motion of the tool at its origin in base axes, linear part
            first [kg^-1/2, kg^-1/2 / m], shape (mode, 6).
        energy_shares: Share of each joint's spring in the greatest energies of all
            springs; a row per mode that adds up to 1 [-], shape (mode, joint).
    """

    frequencies: Float[np.ndarray, " mode"]
    damping_ratios: Float[np.ndarray, " mode"]
    joint_shapes: Complex[np.ndarray, "mode joint"]
    tool_shapes: Complex[np.ndarray, "mode 6"]
    energy_shares: Float[np.ndarray, "mode joint"]


def damped_modes(robot: Robot, q: JointVector) -> DampedModes:
    """Modes that ring, with the motors locked, dampers and all.

        (lambda^2 M + lambda D + K) phi = 0

    Solved for 1 / lambda with the softness K^-1, so that a rigid joint needs no case
    of its own. An overdamped motion does not ring and is left out. Gravity is left out
    as in `mode_shapes`.

    Args:
        robot: The robot; every joint must carry mass.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        The modes: at most as many as there are joints with a spring.

    Raises:
        ValueError: If the mass matrix is singular because joints move no mass.

    **Differentiability**: none, runs on the host.
    """
    # symbols: mu = 1 / lambda, S = K^-1, t unit of time
    position = joint_vector(robot, q, "q")
    matrix = mass_matrix(robot, position)
    refuse_singular(robot, factor(matrix), "natural modes")
    M = np.asarray(matrix, np.float64)
    S = 1.0 / np.asarray(robot.joint_stiffness, np.float64)
    D = np.asarray(robot.joint_damping, np.float64)
    t = float(np.sqrt(np.max(np.diagonal(M) * S))) or 1.0
    joints = len(S)
    step = np.zeros((2 * joints, 2 * joints))
    step[:joints, joints:] = np.eye(joints)
    step[joints:, :joints] = -S[:, None] * M / t**2
    step[joints:, joints:] = -np.diag(S * D) / t
    mu, vectors = np.linalg.eig(step)
    # Of a pair of conjugates the one whose lambda has a positive imaginary part.
    rings = np.flatnonzero(-np.imag(mu) > _LEAST_IMAGINARY_SHARE * np.abs(mu))
    rings = rings[np.abs(mu[rings]) > _LEAST_TIME_SHARE]
    poles = 1.0 / (mu[rings] * t)
    order = np.argsort(poles.imag)
    poles, phi = poles[order], vectors[:joints, rings[order]]
    phi = phi / np.sqrt(np.real(np.einsum("im,ij,jm->m", phi.conj(), M, phi)))
    # K phi from the equation of motion: a rigid joint has a force, but no energy.
    force = (M @ phi) * poles**2 + D[:, None] * phi * poles
    energy = np.abs(force) ** 2 * S[:, None]
    J = np.asarray(jacobian(robot, position), np.float64)
    return DampedModes(
        frequencies=poles.imag / (2 * np.pi),
        damping_ratios=-poles.real / np.abs(poles),
        joint_shapes=phi.T,
        tool_shapes=(J @ phi).T,
        energy_shares=(energy / energy.sum(axis=0, keepdims=True)).T,
    )
