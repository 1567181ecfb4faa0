"""Modes as they are measured at the tool's tip, and those of a robot at one pose.

    u = Phi q,   q'' + 2 zeta omega q' + omega^2 q = Phi^T F - Gamma a

u deflection of the tip, F force on it, a acceleration of the structure's foundation.
Phi are the mode shapes at the tip, normalised to a modal mass of 1 kg: a mode with the
modal mass m, or the modal stiffness k, in the direction d has phi = d / sqrt(m) = omega
d / sqrt(k). Gamma are the participation factors: the part of a mode's mass that moves
along with the foundation.

Reference: Ewins, Modal Testing, 2000, chapter 2; for the participation factors Clough,
Penzien, Dynamics of Structures, chapter on support excitation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .._dynamics.crba import mass_matrix
from .._kinematics.forward import jacobian
from .._model.robot import JointVector, Robot, joint_vector
from .modes import mode_shapes

# Least singular value of Phi over the largest, of directions that have a mode.
_LEAST_SHAPE_SHARE = 1e-6

Rows = Float[Array, "mode 3"] | Float[np.ndarray, "mode 3"]
Numbers = Float[Array, " mode"] | Float[np.ndarray, " mode"]


class TipModes(eqx.Module):
    """Modes of a machine at the tip of its tool, in the axes of the work.

    Attributes:
        frequencies: Undamped natural frequencies omega / (2 pi) [Hz], shape (mode,).
        damping_ratios: zeta, from 0 to below 1 [-], shape (mode,).
        shapes: Phi^T: motion of the tip in each mode, mass-normalised [kg^-1/2], shape
            (mode, 3).
        participation: Gamma: the mass of each mode that the machine carries along each
            axis [kg^1/2], shape (mode, 3). If not given, that of the apparent mass (Phi
            Phi^T)^-1 of the tip, as if all that is carried were there; with zeros a
            motion of the machine excites nothing.
    """

    frequencies: Numbers
    damping_ratios: Numbers
    shapes: Rows
    participation: Rows

    def __init__(
        self,
        frequencies: Numbers,
        damping_ratios: Numbers,
        shapes: Rows,
        participation: Rows | None = None,
    ):
        self.frequencies = frequencies
        self.damping_ratios = damping_ratios
        self.shapes = shapes
        if participation is None:
            xp = np if isinstance(shapes, np.ndarray) else jnp
            participation = xp.linalg.pinv(shapes.T, rtol=_LEAST_SHAPE_SHARE)
        self.participation = participation

    def receptance(
        self, frequencies: Float[Array, " line"] | Float[np.ndarray, " line"]
    ) -> Complex[Array, "line 3 3"]:
        """Tip's displacement per oscillating force [m/N].

        Args:
            frequencies: [Hz], shape (line,); 0 gives the static compliance.

        **Differentiability**: smooth, but at a resonance without damping.
        """
        omega = 2 * jnp.pi * jnp.asarray(self.frequencies)
        at = 2 * jnp.pi * jnp.asarray(frequencies)[:, None]
        ratio = jnp.asarray(self.damping_ratios)
        stiffness = omega[None] ** 2 - at**2
        impedance = jax.lax.complex(stiffness, 2 * (ratio * omega)[None] * at)
        shapes = jnp.asarray(self.shapes)
        rank_one = shapes[:, :, None] * shapes[:, None, :]
        full = jax.lax.complex(rank_one, jnp.zeros_like(rank_one))
        return jnp.einsum("lm,mij->lij", 1 / impedance, full)

    @classmethod
    def of_robot(
        cls, robot: Robot, q: JointVector, T_base_work: np.ndarray
    ) -> "TipModes":
        """Modes of a robot at one pose, as its tip shows them.

        The motors carry the arm: they keep the orientation of the tool as far as they
        can. Dampers that couple modes are neglected, and so is the weight.

        Args:
            robot: The robot; rigid joints make no mode.
            q: Joint positions [rad or m], shape (joint,).
            T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).

        Returns:
            The modes of finite frequency.

        Raises:
            ValueError: As for `mode_shapes`.

        **Differentiability**: none, runs on the host.
        """
        at = joint_vector(robot, q, "q")
        modes = mode_shapes(robot, at)
        is_soft = np.isfinite(np.asarray(modes.frequencies))
        to_work = np.asarray(T_base_work, np.float64)[:3, :3].T
        # The motors' motion per motion of the tip, which M psi turns into a modal
        # force.
        motors = np.flatnonzero(np.asarray(robot.motor_mask()))
        J, M = (
            np.asarray(x, np.float64)
            for x in (jacobian(robot, at), mass_matrix(robot, at))
        )
        carried = np.zeros((robot.joint_count, 3))
        carried[motors] = np.linalg.pinv(J[:, motors])[:, :3]
        psi = np.asarray(modes.joint_shapes, np.float64)[is_soft]
        return cls(
            np.asarray(modes.frequencies, np.float64)[is_soft],
            np.asarray(modes.damping_ratios, np.float64)[is_soft],
            np.asarray(modes.tool_shapes, np.float64)[is_soft, :3] @ to_work.T,
            psi @ M @ carried @ to_work.T,
        )
