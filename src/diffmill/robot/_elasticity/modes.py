"""Modes of the arm with its motors locked: frequencies, damping, shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
from jaxtyping import Array, Bool, Float

from ...numerics import CachedJit
from .._dynamics.crba import mass_matrix
from .._dynamics.mass_inverse import factor, refuse_singular
from .._kinematics.forward import jacobian
from .._model.robot import JointVector, Robot, joint_vector


class Modes(eqx.Module):
    """The natural modes at one pose, the slowest first.

    A mode of which no joint is soft, but for rounding, has an infinite frequency.

    Attributes:
        frequencies: Undamped natural frequencies [Hz], shape (joint,).
        damping_ratios: phi^T D phi / (2 omega); dampers that couple modes are
            neglected, which `damped_modes` does not: where one is much stronger than
            the others it can be many times too large [-], shape (joint,); 0 for a
            rigid joint.
        joint_shapes: phi: joint motion per mode, phi^T M phi = 1 [kg^-1/2 / m or
            kg^-1/2], shape (joint, joint), a row per mode; the entry that is largest
            in `energy_shares` is positive.
        tool_shapes: J phi: motion of the tool at its origin in base axes, linear part
            first [kg^-1/2, kg^-1/2 / m], shape (joint, 6).
        energy_shares: Share of each joint's spring in the energy of the bent arm, a
            row per mode that adds up to 1, or 0 for a mode that bends no spring [-],
            shape (joint, joint).
    """

    frequencies: Float[Array, " joint"]
    damping_ratios: Float[Array, " joint"]
    joint_shapes: Float[Array, "joint joint"]
    tool_shapes: Float[Array, "joint 6"]
    energy_shares: Float[Array, "joint joint"]


def mode_shapes(robot: Robot, q: JointVector) -> Modes:
    """Natural modes with the motors locked.

    Springs only: the change of the torques of gravity with the pose, some per mille
    of K on an industrial arm, is left out.

    Args:
        robot: The robot; every joint must carry mass.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        The modes; batches by `vmap`.

    Raises:
        ValueError: If the mass matrix is singular because joints move no mass; under
            `jit` and `vmap` the modes are not a number instead.

    **Differentiability**: smooth where no two frequencies coincide, those of two
    rigid joints included.
    """
    modes = _mode_shapes(robot, joint_vector(robot, q, "q"))
    refuse_singular(robot, modes.joint_shapes, "natural modes")
    return modes


def natural_frequencies(robot: Robot, q: JointVector) -> Float[Array, " joint"]:
    """Undamped natural frequencies with the motors locked.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Frequencies [Hz], ascending, shape (joint,); infinite for a rigid joint.

    Raises:
        ValueError: As for `mode_shapes`.

    **Differentiability**: smooth where no two frequencies coincide.
    """
    frequencies = _natural_frequencies(robot, joint_vector(robot, q, "q"))
    return refuse_singular(robot, frequencies, "natural frequencies")


@jax.jit
def _natural_frequencies(
    robot: Robot, q: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    softness = _softness(robot, factor(mass_matrix(robot, q)))
    # No vectors: the derivative of values alone asks for fewer distinct modes.
    return _omega(jnp.linalg.eigvalsh(softness)[::-1]) / (2.0 * jnp.pi)


@CachedJit
def _mode_shapes(robot: Robot, q: Float[Array, " joint"]) -> Modes:
    # symbols: y column of an orthonormal basis, phi = L^-T y, so phi^T M phi = 1
    L = factor(mass_matrix(robot, q))
    values, y = jnp.linalg.eigh(_softness(robot, L))
    values, y = values[::-1], y[:, ::-1]
    omega = _omega(values)
    phi = jsl.solve_triangular(L.T, y, lower=False)
    # K phi = omega^2 M phi = omega^2 L y gives the energy phi^T K phi without K, so
    # that a rigid joint counts with 0; divided by the sum, omega drops out.
    energy = (L @ y) ** 2 / robot.joint_stiffness[:, None]
    is_soft = _is_soft(values)[None]
    total = jnp.sum(energy, axis=0, keepdims=True)
    shares = jnp.where(is_soft, energy / jnp.where(is_soft, total, 1.0), 0.0)
    largest = jnp.argmax(shares, axis=0)
    sign = jnp.where(jnp.take_along_axis(phi, largest[None], axis=0) < 0.0, -1.0, 1.0)
    phi = phi * sign
    damping = jnp.sum(phi**2 * robot.joint_damping[:, None], axis=0)
    return Modes(
        frequencies=omega / (2.0 * jnp.pi),
        damping_ratios=damping / (2.0 * omega),
        joint_shapes=phi.T,
        tool_shapes=(jacobian(robot, q) @ phi).T,
        energy_shares=shares.T,
    )


def _softness(
    robot: Robot, L: Float[Array, "joint joint"]
) -> Float[Array, "joint joint"]:
    """Softness L^T K^-1 L, where M = L L^T.

    Its eigenvalues are 1 / omega^2: an infinite stiffness is an ordinary number.
    """
    return L.T @ (L / robot.joint_stiffness[:, None])


def _is_soft(softness: Float[Array, " joint"]) -> Bool[Array, " joint"]:
    """True for the descending softnesses that are no rounding of the first."""
    least = 8 * softness.size * jnp.finfo(softness.dtype).eps * softness[0]
    # NaN stays NaN.
    return ~(softness <= least)


def _omega(softness: Float[Array, " joint"]) -> Float[Array, " joint"]:
    is_soft = _is_soft(softness)
    omega = jax.lax.rsqrt(jnp.where(is_soft, softness, 1.0))
    return jnp.where(is_soft, omega, jnp.inf)
