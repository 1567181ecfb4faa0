"""A robot compiled to arrays: what every algorithm of this subpackage takes."""

from collections.abc import Sequence
from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from ..._types import RealScalarLike, Transform

# What a user may pass as joint positions, velocities or torques.
JointVector: TypeAlias = (
    Float[Array, " joint"] | Float[np.ndarray, " joint"] | Sequence[RealScalarLike]
)
Wrench: TypeAlias = (
    Float[Array, " 6"] | Float[np.ndarray, " 6"] | Sequence[RealScalarLike]
)


class Backlash(eqx.Module):
    """Gaps in the gears; see `with_backlash`.

    Attributes:
        gap: b [rad or m], shape (joint,).
        corner: Width of a rounded corner as a share of the gap [-], shape ().
    """

    gap: Float[Array, " joint"]
    corner: Float[Array, ""]


class Friction(eqx.Module):
    """Friction of the joints; see `with_friction`.

    Attributes:
        coulomb: F_c [N m or N], shape (joint,).
        viscous: F_v [N m s/rad or N s/m], shape (joint,).
        speed: v_s [rad/s or m/s], shape (joint,).
    """

    coulomb: Float[Array, " joint"]
    viscous: Float[Array, " joint"]
    speed: Float[Array, " joint"]


class Motors(eqx.Module):
    """Masses behind the gears, held by servos; see `with_motors`.

    Attributes:
        inertia: J_m [kg m^2 or kg], shape (joint,).
        stiffness: K_s [N m/rad or N/m], shape (joint,).
        damping: D_s [N m s/rad or N s/m], shape (joint,).
    """

    inertia: Float[Array, " joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]


class Robot(eqx.Module):
    """A tree of bodies, each on one joint; z of a joint's frame is its axis.

    Arrays differentiate; the topology is static. Change the tool with `with_tool`
    and the drives with `with_drives`, anything else with `eqx.tree_at`. A joint that
    mimics another moves a body but is no joint of the joint vector: there are as
    many bodies as joints, or more.

    Attributes:
        placement_rotations: Joint frame at q = 0 in its parent's, shape (body, 3, 3).
        placement_positions: Its origin there [m], shape (body, 3).
        link_masses: [kg], shape (body,).
        link_centers: Centres of mass in the joint frame [m], shape (body, 3).
        link_inertias: About the centres, axes of the joint frame [kg m^2],
            shape (body, 3, 3).
        T_joint_flange: Flange in the frame of `flange_joint`, shape (4, 4).
        T_flange_tool: Tool in the flange's frame, shape (4, 4).
        joint_stiffness: K [N m/rad or N/m], shape (joint,).
        joint_damping: D [N m s/rad or N s/m], shape (joint,).
        joint_lower: Lower limits [rad or m], shape (joint,).
        joint_upper: Upper limits [rad or m], shape (joint,).
        home: Joint positions of the home pose [rad or m], shape (joint,).
        gravity: Acceleration of free fall in `base` [m/s^2], shape (3,).
        name: Name of the model.
        joint_names: Order of the joint vector.
        body_kinds: "revolute" or "prismatic", the kind of each body's joint.
        parents: Index of each body's parent, -1 for the base; below its own index.
        is_virtual: Whether a joint has a spring but no motor, per joint.
        flange_joint: Body that carries the flange, -1 for the base.
        mimics: Per body None, or for one whose joint mimics another: the index of
            that joint in the joint vector, multiplier, offset [rad or m].
        backlash: Gaps in the gears, or None.
        friction: Friction of the joints, or None.
        motors: Masses of the motors, or None: they stand where the controller says.
        joint_speed: Fastest motion of each joint [rad/s or m/s], shape (joint,);
            infinite where it is not known, None for all of them.
        fast_joints: Indices of joints whose own mode is far too fast for the steps of
            a simulation; an implicit integrator lets it die out instead of ringing.
    """

    placement_rotations: Float[Array, "body 3 3"]
    placement_positions: Float[Array, "body 3"]
    link_masses: Float[Array, " body"]
    link_centers: Float[Array, "body 3"]
    link_inertias: Float[Array, "body 3 3"]
    T_joint_flange: Float[Array, "4 4"]
    T_flange_tool: Float[Array, "4 4"]
    joint_stiffness: Float[Array, " joint"]
    joint_damping: Float[Array, " joint"]
    joint_lower: Float[Array, " joint"]
    joint_upper: Float[Array, " joint"]
    home: Float[Array, " joint"]
    gravity: Float[Array, " 3"]
    name: str = eqx.field(static=True)
    joint_names: tuple[str, ...] = eqx.field(static=True)
    body_kinds: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    is_virtual: tuple[bool, ...] = eqx.field(static=True)
    flange_joint: int = eqx.field(static=True)
    mimics: tuple[tuple[int, float, float] | None, ...] = eqx.field(static=True)
    backlash: Backlash | None = None
    friction: Friction | None = None
    motors: Motors | None = None
    joint_speed: Float[Array, " joint"] | None = None
    fast_joints: tuple[int, ...] = eqx.field(static=True, default=())

    @property
    def joint_count(self) -> int:
        """Number of joints, virtual ones included, mimicking ones not."""
        return len(self.joint_names)

    @property
    def body_count(self) -> int:
        """Number of bodies: of joints, mimicking ones included."""
        return len(self.parents)

    @property
    def has_mimics(self) -> bool:
        """Whether some body's joint mimics another."""
        return self.body_count > self.joint_count

    @property
    def joint_kinds(self) -> tuple[str, ...]:
        """Return "revolute" or "prismatic" per joint."""
        pairs = zip(self.body_kinds, self.mimics, strict=True)
        return tuple(kind for kind, mimic in pairs if mimic is None)

    @property
    def dtype(self) -> DTypeLike:
        """Floating point type of the arrays."""
        return self.home.dtype

    @property
    def motor_joints(self) -> tuple[int, ...]:
        """Indices of the joints that have a motor."""
        return tuple(i for i, virtual in enumerate(self.is_virtual) if not virtual)

    def ancestry(self) -> Float[Array, "body body"]:
        """Return a matrix with 1 in row k, column i where body i carries body k."""
        moves = np.eye(self.body_count)
        for k, parent in enumerate(self.parents):
            if parent >= 0:
                moves[k] += moves[parent]
        return jnp.asarray(moves, self.dtype)

    def prismatic_mask(self) -> np.ndarray:
        """Return whether each body slides, shape (body,)."""
        return np.array([kind == "prismatic" for kind in self.body_kinds])

    def motor_mask(self) -> np.ndarray:
        """Return whether each joint has a motor, shape (joint,)."""
        return ~np.array(self.is_virtual)

    def tool_mask(self) -> np.ndarray:
        """Return whether each body carries the tool, shape (body,)."""
        moves = np.zeros(self.body_count, dtype=bool)
        joint = self.flange_joint
        while joint >= 0:
            moves[joint] = True
            joint = self.parents[joint]
        return moves


def joint_vector(
    robot: Robot, values: JointVector, name: str
) -> Float[Array, " joint"]:
    """Return a user's joint vector as an array of the robot's type.

    Args:
        robot: The robot.
        values: One number per joint.
        name: Name of the argument, for the message.

    Returns:
        The vector, shape (joint,).

    Raises:
        ValueError: If there is not one number per joint.
    """
    vector = jnp.asarray(values, dtype=robot.dtype)
    if vector.shape != (robot.joint_count,):
        raise ValueError(
            f"Argument `{name}` must have one number per joint of {robot.name!r} "
            f"({', '.join(robot.joint_names)}: {robot.joint_count}), but has shape "
            f"{vector.shape}."
        )
    return vector


def wrench_vector(robot: Robot, wrench: Wrench | None) -> Float[Array, " 6"]:
    """Return a user's wrench as an array of the robot's type, 0 for None."""
    if wrench is None:
        return jnp.zeros(6, robot.dtype)
    vector = jnp.asarray(wrench, dtype=robot.dtype)
    if vector.shape != (6,):
        raise ValueError(
            "Argument `wrench` must have 6 numbers (force, then moment), but has "
            f"shape {vector.shape}."
        )
    return vector


def with_tool(robot: Robot, T_flange_tool: Transform) -> Robot:
    """Return the robot with another tool tip; masses stay as they are.

    Args:
        robot: The robot.
        T_flange_tool: Maps tool coordinates to the flange's, shape (4, 4); tool +z
            points from the tip to the shank.

    Returns:
        The changed robot.
    """
    tool = jnp.asarray(T_flange_tool, dtype=robot.dtype)
    return eqx.tree_at(lambda r: r.T_flange_tool, robot, tool)


def with_drives(
    robot: Robot,
    *,
    stiffness: JointVector | None = None,
    damping: JointVector | None = None,
) -> Robot:
    """Return the robot with other springs or dampers; None keeps what is there.

    Args:
        robot: The robot.
        stiffness: K per joint [N m/rad or N/m], shape (joint,).
        damping: D per joint [N m s/rad or N s/m], shape (joint,).

    Returns:
        The changed robot.

    Raises:
        ValueError: If a stiffness is not positive or a damping negative.
    """
    if stiffness is not None:
        values = joint_vector(robot, stiffness, "stiffness")
        check_drives("stiffness", values, values > 0.0, "positive")
        robot = eqx.tree_at(lambda r: r.joint_stiffness, robot, values)
    if damping is not None:
        values = joint_vector(robot, damping, "damping")
        check_drives("damping", values, values >= 0.0, "not negative")
        robot = eqx.tree_at(lambda r: r.joint_damping, robot, values)
    return robot


def check_drives(
    name: str,
    values: Float[Array, "*shape"],
    is_allowed: Bool[Array, "*shape"],
    allowed: str,
) -> None:
    """Raise if a known value is wrong; traced values have none to look at."""
    if not isinstance(is_allowed, Tracer) and not np.all(is_allowed):
        raise ValueError(
            f"Argument `{name}` must be {allowed}, but is {np.asarray(values)}."
        )
