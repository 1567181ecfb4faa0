"""The arm's own answer to a command, which makes Gauss-Newton converge.

Without the cut, a tip command c(t) moves the tip by T(omega) c(omega), with

    T = J (K + i omega D - omega^2 M)^-1 (K + i omega D) J^-1   (tip rows and columns).

Around the lowest modes it amplifies by twenty, above them it falls off with the square
of the frequency; conjugate gradients need a step for each of these scales. Scaled by
(T^H T)^-1 all frequencies look alike, and what is left is the cut.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._types import RealScalarLike
from ..robot import Robot, arm_terms
from ._spline.spline_offsets import SplineOffsets, adjoint_offsets
from ._spline.spline_window import SplineWindow

# Added to T^H T: what the arm hardly follows is not worth chasing.
_FLOOR = 1e-3
_Map = Callable[[np.ndarray], np.ndarray]


class TipResponse(eqx.Module):
    """Linear dynamics of an arm at one pose, motors commanded by tip positions.

    Attributes:
        jacobian: At the tip in base axes, shape (6, joint).
        mass_matrix: M [kg m^2], shape (joint, joint).
        stiffness: K [N m/rad], shape (joint,).
        damping: D [N m s/rad], shape (joint,).
        rotation: From `work` to `base`, shape (3, 3).
    """

    jacobian: Float[np.ndarray, "6 joint"]
    mass_matrix: Float[np.ndarray, "joint joint"]
    stiffness: Float[np.ndarray, " joint"]
    damping: Float[np.ndarray, " joint"]
    rotation: Float[np.ndarray, "3 3"]

    def transfer(
        self, frequency: Float[np.ndarray, " frequency"]
    ) -> Complex[np.ndarray, "frequency 3 3"]:
        """Return T at some frequencies.

        Args:
            frequency: [Hz], shape (frequency,).

        Returns:
            Tip motion per tip command in `work`, shape (frequency, 3, 3).
        """
        omega = 2 * np.pi * frequency[:, None, None]
        spring = np.diag(self.stiffness) + 1j * omega * np.diag(self.damping)
        motors = np.linalg.pinv(self.jacobian)[:, :3] @ self.rotation
        joints = np.linalg.solve(spring - omega**2 * self.mass_matrix, spring @ motors)
        return self.rotation.T @ self.jacobian[:3] @ joints


def tip_response(
    robot: Robot,
    q: Float[Array, " joint"],
    rotation: Float[Array, "3 3"] | Float[np.ndarray, "3 3"],
) -> TipResponse:
    """Return the response of an arm at one pose, on the host.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
        rotation: Rotation from `work` to `base`, shape (3, 3).

    Returns:
        The response.

    **Differentiability**: none, a host function.
    """
    terms = arm_terms(robot, q, jnp.zeros_like(q))
    return TipResponse(
        jacobian=np.asarray(terms.jacobian, np.float64),
        mass_matrix=np.asarray(terms.mass_matrix, np.float64),
        stiffness=np.asarray(robot.joint_stiffness, np.float64),
        damping=np.asarray(robot.joint_damping, np.float64),
        rotation=np.asarray(rotation, np.float64),
    )


def spline_preconditioner(
    response: TipResponse, spline: SplineOffsets, time_step: RealScalarLike
) -> _Map:
    """Return (T^H T)^-1 on the coefficients of a spline.

    Args:
        response: The arm.
        spline: The basis.
        time_step: Time between two rows [s].

    Returns:
        A symmetric, positive definite map on coefficients, on the host.

    **Differentiability**: none, a host function.
    """
    return banded_preconditioner(
        response, spline, lambda signal: adjoint_offsets(spline, signal), time_step
    )


def banded_preconditioner(
    response: TipResponse,
    spline: SplineOffsets | SplineWindow,
    transposed: _Map,
    time_step: RealScalarLike,
) -> _Map:
    """Return (T^H T)^-1 on the coefficients of a spline or of a window of one.

    Args:
        response: The arm.
        spline: The basis B.
        transposed: B^T, on the host.
        time_step: Time between two rows [s].

    Returns:
        A symmetric, positive definite map on coefficients, on the host.
    """
    from scipy.linalg import solveh_banded

    band = spline.normal_band()
    band[3] += 1e-12 * band[3].max()
    length = 2 * spline.step_count
    T = response.transfer(np.fft.rfftfreq(length, float(time_step)))
    normal = np.conj(np.swapaxes(T, 1, 2)) @ T
    inverse = np.linalg.inv(normal + _FLOOR * np.eye(3))

    def apply(gradient: np.ndarray) -> np.ndarray:
        curve = np.asarray(spline.offsets(jnp.asarray(solveh_banded(band, gradient))))
        waves = np.fft.rfft(curve, length, axis=0)
        waves = np.einsum("fij,fj->fi", inverse, waves)
        curve = np.fft.irfft(waves, length, axis=0)[: spline.step_count]
        return solveh_banded(band, transposed(curve))

    return apply
