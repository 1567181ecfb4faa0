"""A spring between the flange and the spindle: bracket, bearings, tool changer."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..._arrays import check_known
from ..._types import RealScalarLike
from .._algebra.spatial import apply_matrix, matrix_product
from .elements import Vector3
from .robot import Robot
from .series_springs import Body, Spring, with_series_springs

_AXES = "xyz"
# Mass left of a link over its mass, below which it is rounding.
_LEAST_MASS_SHARE = 1e-9
# Distance of two centres that are the same [m].
_SAME_CENTER = 1e-6


class FlangeSpring(eqx.Module):
    """Springs at the origin of the flange and the spindle that hangs on them.

    Attributes:
        mass: Of the spindle [kg].
        center_of_mass: Its centre in the flange's frame [m], shape (3,).
        inertia: Its moments about that centre and the flange's axes [kg m^2],
            shape (3,).
        linear_stiffness: Along the flange's axes [N/m], shape (3,); None for rigid.
        rotary_stiffness: About them [N m/rad], shape (3,); None for rigid.
        damping_ratio: Share of critical damping of each spring alone [-].
        is_in_link: True if the robot's last link already holds the spindle, which then
            moves behind the springs; else it is added.
    """

    mass: RealScalarLike
    center_of_mass: Vector3
    inertia: Vector3
    linear_stiffness: Vector3 | None = None
    rotary_stiffness: Vector3 | None = None
    damping_ratio: RealScalarLike = 0.02
    is_in_link: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        """Refuse springs that are not there, and what no spindle is."""
        check_known("mass", self.mass, least=0.0)
        check_known("damping_ratio", self.damping_ratio, least=0.0)
        check_known("center_of_mass", self.center_of_mass, shapes=((3,),))
        check_known("inertia", self.inertia, least=0.0, shapes=((3,),))
        for name in ("linear_stiffness", "rotary_stiffness"):
            value = getattr(self, name)
            if value is not None:
                check_known(name, value, least=0.0, is_open=True, shapes=((3,),))
        if self.linear_stiffness is None and self.rotary_stiffness is None:
            raise ValueError(
                "Arguments `linear_stiffness` and `rotary_stiffness` must not both be "
                "None: one of them is the spring."
            )

    def mounted_on(self, robot: Robot) -> Robot:
        """Robot with springs at its flange, in series with the arm.

        Virtual joints `flange_x`, ... slide along and `flange_rx`, ... turn about the
        flange's axes, in this order.

        Args:
            robot: The robot.

        Returns:
            The robot with three or six more joints.

        Raises:
            ValueError: If the robot has such a spring already, or its last link is
                lighter than the spindle that it should hold.

        **Differentiability**: smooth in robot and spring; in mass and inertia where
        every spring moves some of it.
        """
        dtype = robot.dtype
        m = jnp.asarray(self.mass, dtype)
        c = jnp.asarray(self.center_of_mass, dtype)
        moments = jnp.asarray(self.inertia, dtype)
        body = Body(m, c, jnp.diag(moments))
        # Inertia that a turning spring moves if all else stands still.
        swung = moments + m * (jnp.sum(c**2)[None] - c**2)
        zeta = jnp.asarray(self.damping_ratio, dtype)
        springs = []
        for values, masses, kind, prefix in (
            (self.linear_stiffness, jnp.broadcast_to(m, (3,)), "prismatic", "flange_"),
            (self.rotary_stiffness, swung, "revolute", "flange_r"),
        ):
            if values is None:
                continue
            K = jnp.asarray(values, dtype)
            # A spring that moves nothing has no damper; the root's slope is infinite.
            is_moved = masses > 0
            root = jnp.sqrt(K * jnp.where(is_moved, masses, 1))
            D = 2 * zeta * jnp.where(is_moved, root, 0)
            springs += [
                Spring(K[i], D[i], prefix + _AXES[i], kind, i) for i in range(3)
            ]
        if self.is_in_link:
            robot = _without(robot, body)
        return with_series_springs(robot, springs, body, jnp.eye(4, dtype=dtype))


def _without(robot: Robot, body: Body) -> Robot:
    """Robot with a body taken out of the link that carries the flange."""
    link = robot.flange_joint
    if link < 0:
        raise ValueError(
            "Argument `spring` must say is_in_link=False: the flange is at the base, "
            "which has no mass to take the spindle from."
        )
    R, p = robot.T_joint_flange[:3, :3], robot.T_joint_flange[:3, 3]
    center = apply_matrix(R, body.center) + p
    turned = matrix_product(matrix_product(R, body.inertia), R.T)
    mass, old = robot.link_masses[link], robot.link_centers[link]
    left = mass - body.mass
    _check_link_mass(robot, left, body.mass)
    # A link that is the spindle and nothing else leaves no mass to have a centre.
    has_left = left > _LEAST_MASS_SHARE * mass
    _check_whole(robot, body, left, center)
    safe = jnp.where(has_left, left, 1.0)
    new = jnp.where(has_left, (mass * old - body.mass * center) / safe, 0.0)
    inertia = (
        robot.link_inertias[link]
        - turned
        + _steiner(mass, old - new)
        - _steiner(body.mass, center - new)
    )
    inertia = jnp.where(has_left, inertia, 0.0)
    _check_inertia(robot, inertia)
    return dataclasses.replace(
        robot,
        link_masses=robot.link_masses.at[link].set(left),
        link_centers=robot.link_centers.at[link].set(new),
        link_inertias=robot.link_inertias.at[link].set(inertia),
    )


def _steiner(mass: Float[Array, ""], arm: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Inertia of a point mass at the end of an arm."""
    eye = jnp.eye(3, dtype=arm.dtype)
    return mass * (jnp.sum(arm**2) * eye - arm[:, None] * arm[None, :])


def _check_link_mass(
    robot: Robot, left: Float[Array, ""], mass: Float[Array, ""]
) -> None:
    """Raise if a known link is lighter than what is taken out of it."""
    if not isinstance(left, Tracer) and float(left) < -1e-9:
        raise ValueError(
            f"Argument `mass` must be at most that of the last link of {robot.name!r}, "
            f"{float(left + mass):.6g} kg, or is_in_link=False, but is "
            f"{float(np.asarray(mass)):.6g} kg."
        )


def _check_whole(
    robot: Robot, body: Body, left: Float[Array, ""], center: Float[Array, " 3"]
) -> None:
    """Raise if a body that is all of a known link has another centre than it."""
    if isinstance(left, Tracer) or isinstance(center, Tracer):
        return
    link = robot.flange_joint
    old = np.asarray(robot.link_centers[link])
    if float(left) > _LEAST_MASS_SHARE * float(robot.link_masses[link]):
        return
    if not np.allclose(center, old, rtol=0, atol=_SAME_CENTER):
        away = 1e3 * float(np.linalg.norm(np.asarray(center) - old))
        raise ValueError(
            f"Argument `center_of_mass` must be that of the last link of "
            f"{robot.name!r}, of which a spindle of {float(np.asarray(body.mass)):.6g} "
            f"kg is all, or is_in_link=False, but is {away:.3g} mm away from it."
        )


def _check_inertia(robot: Robot, inertia: Float[Array, "3 3"]) -> None:
    """Raise if what is left of a known link is no body."""
    if isinstance(inertia, Tracer):
        return
    least = np.linalg.eigvalsh(np.asarray(inertia))[0]
    scale = float(np.max(np.abs(robot.link_inertias)))
    if least < -1e-6 * scale:
        raise ValueError(
            "Argument `inertia` must be that of a part of the last link of "
            f"{robot.name!r}, or is_in_link=False, but what is left has the principal "
            f"value {least:.3g} kg m^2."
        )
