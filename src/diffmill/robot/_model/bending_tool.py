"""A slender tool: a cantilever that bends under the cut, as two hinges.

A force at the tip of a beam shifts it by delta and turns it by phi. A rigid tool on a
hinge at the height a = delta / phi above the tip, sprung by K = a / phi per unit force,
does the same; for a plain beam of length L it sits at a = 2 L / 3. Of the tool's mass
only the part counts that moves with the tip; it is put there as a point.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..._arrays import check_known
from ..._types import RealScalarLike
from .._algebra.spatial import matrix_product
from .robot import Robot
from .series_springs import Body, Spring, with_series_springs

# Gauss-Legendre nodes: four are exact for the square of the beam's cubic shape.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class TipSpring(eqx.Module):
    """Springs at the tip of a bending tool.

    Attributes:
        stiffness: Force per shift of the tip [N/m].
        hinge_height: Height of the hinge above the tip, shift per turn [m].
        mass: Mass that moves with the tip, by Rayleigh's quotient of the shape under
            a force at the tip; 33/140 of a plain beam [kg].
    """

    stiffness: Float[Array, ""]
    hinge_height: Float[Array, ""]
    mass: Float[Array, ""]


class BendingTool(eqx.Module):
    """Shape and material of a tool that sticks out of its holder.

    The fluted part is taken as a cylinder of a share of the cutter's diameter, an
    assumption that its users should measure; defaults are typical of cemented carbide.

    Attributes:
        overhang: From the holder to the tip [m].
        flute_length: Fluted part of it at the tip [m]; all of it if longer.
        cutter_diameter: Diameter of the fluted part [m].
        shank_diameter: Diameter above the flutes [m].
        young_modulus: E [Pa].
        density: [kg/m^3].
        flute_share: Diameter that bends like the fluted part, as a share of the
            cutter's [-].
        damping_ratio: Share of critical damping of the tool alone [-].
    """

    overhang: RealScalarLike
    flute_length: RealScalarLike
    cutter_diameter: RealScalarLike
    shank_diameter: RealScalarLike
    young_modulus: RealScalarLike = 600e9
    density: RealScalarLike = 14.5e3
    flute_share: RealScalarLike = 0.8
    damping_ratio: RealScalarLike = 0.02

    def __check_init__(self):
        """Refuse numbers that make no beam."""
        for name in (
            "overhang",
            "cutter_diameter",
            "shank_diameter",
            "young_modulus",
            "density",
            "flute_share",
        ):
            check_known(name, getattr(self, name), least=0.0, is_open=True)
        for name in ("flute_length", "damping_ratio"):
            check_known(name, getattr(self, name), least=0.0)

    def mounted_on(self, robot: Robot) -> Robot:
        """Robot with a tool that bends, in series with the arm.

        Two virtual joints, `tool_x` and `tool_y`, turn the tool about its own x and y
        axes. The tip and its direction follow a force at the tip as those of the beam
        do; a moment there is answered by the hinge alone. Its mode, at some kHz, is a
        fast joint's: an integrator that does not damp would let it ring in steps that
        cannot follow. The mass that moves with the tip is added to the robot's, which
        is taken to hold the rest of the tool. Place the tip (`Robot.with_tool`) and the
        `FlangeSpring` first.

        Args:
            robot: The robot; z of its tool points from the tip to the shank.

        Returns:
            The robot with two more joints.

        Raises:
            ValueError: If the robot has a bending tool already.

        **Differentiability**: smooth in robot and tool.
        """
        spring = self.tip_spring(robot.dtype)
        # symbols: a height of the hinge, K and D of the hinge, J its inertia
        a = spring.hinge_height
        K = spring.stiffness * a**2
        J = spring.mass * a**2
        D = 2 * jnp.asarray(self.damping_ratio, robot.dtype) * jnp.sqrt(K * J)
        up = jnp.zeros(3, robot.dtype).at[2].set(a)
        raised = jnp.eye(4, dtype=robot.dtype).at[:3, 3].set(up)
        springs = [
            Spring(K, D, "tool_x", "revolute", 0),
            Spring(K, D, "tool_y", "revolute", 1),
        ]
        body = Body(spring.mass, -up, jnp.zeros((3, 3), robot.dtype))
        bending = with_series_springs(
            robot, springs, body, matrix_product(robot.T_flange_tool, raised)
        )
        own = range(robot.joint_count, bending.joint_count)
        return dataclasses.replace(bending, fast_joints=(*robot.fast_joints, *own))

    def tip_spring(self, dtype: DTypeLike = float) -> TipSpring:
        """Stiffness, hinge and moving mass of a bending tool (Euler beam).

            1 / k = L_f^3 / (3 E I_f) + (L^3 - L_f^3) / (3 E I_s),  I = pi d^4 / 64

        Args:
            dtype: Floating point type of the result.

        Returns:
            The spring.

        **Differentiability**: smooth; kink where the flutes end at the holder.
        """
        # symbols: L lengths, d diameters, I second moments of area, A cross sections,
        # of the flutes (f) and the shank (s); w deflection per unit force at the tip
        number = lambda value: jnp.asarray(value, dtype)
        L, E = number(self.overhang), number(self.young_modulus)
        L_f = jnp.minimum(number(self.flute_length), L)
        L_s = L - L_f
        d_f = number(self.flute_share) * number(self.cutter_diameter)
        d_s = number(self.shank_diameter)
        I_f, I_s = jnp.pi * d_f**4 / 64, jnp.pi * d_s**4 / 64
        A_f, A_s = jnp.pi * d_f**2 / 4, jnp.pi * d_s**2 / 4
        shift = L_f**3 / (3 * E * I_f) + (L**3 - L_f**3) / (3 * E * I_s)
        turn = L_f**2 / (2 * E * I_f) + (L**2 - L_f**2) / (2 * E * I_s)
        share = jnp.asarray((_NODES + 1) / 2, dtype)
        x, y = share * L_s, share * L_f
        bend = lambda x, length, EI: (length * x**2 / 2 - x**3 / 6) / EI
        slope = (L * L_s - L_s**2 / 2) / (E * I_s)
        w_s = bend(x, L, E * I_s)
        w_f = bend(L_s, L, E * I_s) + slope * y + bend(y, L_f, E * I_f)
        weights = jnp.asarray(_WEIGHTS / 2, dtype)
        moving = A_s * L_s * (weights @ w_s**2) + A_f * L_f * (weights @ w_f**2)
        mass = number(self.density) * moving / shift**2
        return TipSpring(stiffness=1 / shift, hinge_height=shift / turn, mass=mass)
