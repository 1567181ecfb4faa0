"""A robot compiled to arrays: the model of every algorithm of this subpackage."""

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from ..._types import RealScalarLike, Transform
from .drives import Backlash, Friction, GearTorque, GearWaves, Motors

# Joint positions, velocities or torques as a user may pass them.
JointVector: TypeAlias = (
    Float[Array, " joint"] | Float[np.ndarray, " joint"] | Sequence[RealScalarLike]
)
Wrench: TypeAlias = (
    Float[Array, " 6"] | Float[np.ndarray, " 6"] | Sequence[RealScalarLike]
)


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
        is_virtual: True for a joint with a spring but no motor, per joint.
        flange_joint: Body that carries the flange, -1 for the base.
        mimics: Per body None, or for one whose joint mimics another: the index of
            that joint in the joint vector, multiplier, offset [rad or m].
        backlash: Gaps in the gears, or None.
        friction: Friction of the joints, or None.
        motors: Masses of the motors, or None: they stand at their commands.
        joint_speed: Fastest motion of each joint [rad/s or m/s], shape (joint,);
            infinite where it is not known, None for all of them.
        fast_joints: Indices of joints whose own mode is far too fast for the steps of
            a simulation; an implicit integrator lets it die out instead of ringing.
        gear_waves: Transmission errors of the gears, or None; see `transmitted`.
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
    gear_waves: GearWaves | None = None

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
        """True if some body's joint mimics another."""
        return self.body_count > self.joint_count

    @property
    def joint_kinds(self) -> tuple[str, ...]:
        """Kind of each joint, "revolute" or "prismatic"."""
        pairs = zip(self.body_kinds, self.mimics, strict=True)
        return tuple(kind for kind, mimic in pairs if mimic is None)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each joint, "rad" or "m"."""
        return tuple("m" if slides else "rad" for slides in self.joint_prismatic_mask())

    @property
    def dtype(self) -> DTypeLike:
        """Floating point type of the arrays."""
        return self.home.dtype

    @property
    def motor_joints(self) -> tuple[int, ...]:
        """Indices of the joints that have a motor."""
        return tuple(i for i, virtual in enumerate(self.is_virtual) if not virtual)

    def ancestry(self) -> Float[Array, "body body"]:
        """Matrix with 1 in row k, column i where body i carries body k."""
        moves = np.eye(self.body_count)
        for k, parent in enumerate(self.parents):
            if parent >= 0:
                moves[k] += moves[parent]
        return jnp.asarray(moves, self.dtype)

    def prismatic_mask(self) -> np.ndarray:
        """True for bodies that slide, shape (body,)."""
        return np.array([kind == "prismatic" for kind in self.body_kinds])

    def joint_prismatic_mask(self) -> np.ndarray:
        """True for joints that slide, shape (joint,)."""
        return self.prismatic_mask()[[mimic is None for mimic in self.mimics]]

    def motor_mask(self) -> np.ndarray:
        """True for joints with a motor, shape (joint,)."""
        return ~np.array(self.is_virtual)

    def tool_mask(self) -> np.ndarray:
        """True for bodies that carry the tool, shape (body,)."""
        moves = np.zeros(self.body_count, dtype=bool)
        joint = self.flange_joint
        while joint >= 0:
            moves[joint] = True
            joint = self.parents[joint]
        return moves

    @property
    def massless_joints(self) -> tuple[str, ...]:
        """Names of the joints that move no mass at all; their row of M is zero."""
        heavy = np.asarray(self.link_masses) > 0.0
        heavy |= np.asarray(self.link_inertias).any(axis=(1, 2))
        return self._not_moving(heavy)

    def light_joints(self, lightest: float) -> tuple[str, ...]:
        """Joints that move next to no mass, massless ones included.

        Args:
            lightest: Mass from which on a joint counts [kg].
        """
        masses = np.array(self.link_masses, float)
        for body in reversed(range(self.body_count)):
            if self.parents[body] >= 0:
                masses[self.parents[body]] += masses[body]
        return self._not_moving(masses >= lightest)

    def _not_moving(self, heavy: Bool[np.ndarray, " body"]) -> tuple[str, ...]:
        """Names of the joints that move none of the heavy bodies."""
        heavy = heavy.copy()
        for body in reversed(range(self.body_count)):
            if self.parents[body] >= 0:
                heavy[self.parents[body]] |= heavy[body]
        moves = np.zeros(self.joint_count, dtype=bool)
        own = 0
        for body, mimic in enumerate(self.mimics):
            joint = own if mimic is None else mimic[0]
            own += mimic is None
            moves[joint] |= heavy[body]
        return tuple(n for n, m in zip(self.joint_names, moves, strict=True) if not m)

    def with_tool(self, T_flange_tool: Transform) -> "Robot":
        """Robot with another tool tip; masses stay as they are.

        Args:
            T_flange_tool: Maps tool coordinates to the flange's, shape (4, 4); tool +z
                points from the tip to the shank.

        Returns:
            The changed robot.
        """
        tool = jnp.asarray(T_flange_tool, dtype=self.dtype)
        return eqx.tree_at(lambda r: r.T_flange_tool, self, tool)

    def with_drives(
        self,
        *,
        stiffness: JointVector | None = None,
        damping: JointVector | None = None,
    ) -> "Robot":
        """Robot with other springs or dampers; None keeps what is there.

        Args:
            stiffness: K per joint [N m/rad or N/m], shape (joint,).
            damping: D per joint [N m s/rad or N s/m], shape (joint,).

        Returns:
            The changed robot.

        Raises:
            ValueError: If a stiffness is not positive or a damping negative.
        """
        K, D = self.joint_stiffness, self.joint_damping
        if stiffness is not None:
            K = joint_vector(self, stiffness, "stiffness")
            _check_drives("stiffness", K, K > 0.0, "positive")
        if damping is not None:
            D = joint_vector(self, damping, "damping")
            _check_drives("damping", D, D >= 0.0, "not negative")
        return dataclasses.replace(self, joint_stiffness=K, joint_damping=D)

    def with_backlash(
        self, gap: JointVector, *, corner: RealScalarLike = 0.2
    ) -> "Robot":
        """Robot with backlash in its gears.

            tau = K s(x) + D s'(x) x',   x = theta - q

        s is 0 in the middle of the gap, has slope 1 outside of it, and goes from one to
        the other along a parabola; without a gap it is x.

        Args:
            gap: b, by which a joint moves freely with its motor locked [rad or m],
                shape (joint,); 0 for none.
            corner: Width of the parabola at either end as a share of the gap, above 0
                and at most 1 [-].

        Returns:
            The changed robot.

        Raises:
            ValueError: If a gap is negative.

        **Differentiability**: smooth for a gap above 0.
        """
        b = joint_vector(self, gap, "gap")
        _check_drives("gap", b, b >= 0.0, "not negative")
        share = jnp.asarray(corner, self.dtype)
        _check_drives(
            "corner", share, (share > 0.0) & (share <= 1.0), "above 0, at most 1"
        )
        return dataclasses.replace(self, backlash=Backlash(b, share))

    def with_friction(
        self,
        coulomb: JointVector,
        viscous: JointVector,
        speed: JointVector,
        *,
        presliding: JointVector | None = None,
    ) -> "Robot":
        """Robot with friction in its joints, which creeps or sticks.

            tau_f = F_c tanh(v / v_s) + F_v v                  without presliding
            tau_f = F_c z / z_s + F_v v,   |z| <= z_s          with it

        Below v_s the first law creeps where a real joint sticks. The second is that of
        an elastic and perfectly plastic bristle: z follows the joint, and stops at z_s,
        where the joint slides. A joint under a load below F_c stays where it is.

        Args:
            coulomb: F_c [N m or N], shape (joint,); 0 for none.
            viscous: F_v [N m s/rad or N s/m], shape (joint,); 0 for none.
            speed: v_s, above which a joint slides [rad/s or m/s], shape (joint,). With
                presliding it counts only for how a run begins: z = z_s tanh(v / v_s).
            presliding: z_s, by which a joint yields before it slides [rad or m], shape
                (joint,); 0 where there is no Coulomb friction. None for the first law.

        Returns:
            The changed robot.

        Raises:
            ValueError: If a friction is negative, a speed not positive, or a presliding
                not positive where there is Coulomb friction.

        **Differentiability**: the first law is smooth; the second has kinks where a
        joint begins to slide or turns round.
        """
        F_c = joint_vector(self, coulomb, "coulomb")
        F_v = joint_vector(self, viscous, "viscous")
        v_s = joint_vector(self, speed, "speed")
        _check_drives("coulomb", F_c, F_c >= 0.0, "not negative")
        _check_drives("viscous", F_v, F_v >= 0.0, "not negative")
        _check_drives("speed", v_s, v_s > 0.0, "positive")
        z_s = None
        if presliding is not None:
            z_s = joint_vector(self, presliding, "presliding")
            is_good = (z_s > 0.0) | ((z_s == 0.0) & (F_c == 0.0))
            allowed = "positive where there is Coulomb friction"
            _check_drives("presliding", z_s, is_good, allowed)
        return dataclasses.replace(self, friction=Friction(F_c, F_v, v_s, z_s))

    def with_motors(
        self, inertia: JointVector, stiffness: JointVector, damping: JointVector
    ) -> "Robot":
        """Robot with motors that have a mass and are held by a servo.

            J_m theta'' = K_s (theta_c - theta) + D_s (theta_c' - theta') - tau

        theta_c is the controller's command, tau the torque of the gear. All numbers
        are behind the gear, on the joint's side: a rotor's inertia times the ratio
        squared.

        Args:
            inertia: J_m [kg m^2 or kg], shape (joint,); not used for virtual joints.
            stiffness: K_s of the servo [N m/rad or N/m], shape (joint,).
            damping: D_s of the servo [N m s/rad or N s/m], shape (joint,).

        Returns:
            The changed robot.

        Raises:
            ValueError: If an inertia or a stiffness of a joint with a motor is not
                positive, or a damping negative.
        """
        has_motor = self.motor_mask()
        values = []
        for name, given in (("inertia", inertia), ("stiffness", stiffness)):
            value = joint_vector(self, given, name)
            # Virtual joints have no motor: any number does, and 1 divides safely.
            value = jnp.where(has_motor, value, 1.0)
            is_good = (value > 0.0) & jnp.isfinite(value)
            _check_drives(name, value, is_good, "positive and finite")
            values.append(value)
        D_s = jnp.where(has_motor, joint_vector(self, damping, "damping"), 0.0)
        _check_drives("damping", D_s, D_s >= 0.0, "not negative")
        return dataclasses.replace(self, motors=Motors(values[0], values[1], D_s))

    def gear_torque(
        self, stretch: Float[Array, " joint"], rate: Float[Array, " joint"]
    ) -> GearTorque:
        """Torque of the gears at a stretch x = theta - q, and its slopes.

        Args:
            stretch: x [rad or m], shape (joint,).
            rate: x' [rad/s or m/s], shape (joint,).

        Returns:
            Torque and slopes. The damper works where the spring does: its torque is
            that of D d s(x) / dt.

        **Differentiability**: smooth; slopes have kinks at the corners of a gap.
        """
        K, D = self.joint_stiffness, self.joint_damping
        if self.backlash is None:
            return GearTorque(K * stretch + D * rate, K, D)
        s, slope = self.backlash.dead_zone(stretch)
        return GearTorque(K * s + D * slope * rate, K * slope, D * slope)

    def transmitted(self, motor: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Position theta + w(theta) of the gears' output behind motors without load.

        Args:
            motor: theta as the motors' encoders count it [rad or m], shape (joint,).

        Returns:
            Where the gears hold the joints [rad or m], shape (joint,); kinematics and
            springs are those of these.
        """
        if self.gear_waves is None:
            return motor
        return motor + self.gear_waves.error(motor)

    def drive_deflection(
        self, torque: Float[Array, " joint"]
    ) -> Float[Array, " joint"]:
        """Deflection theta_c - q of drives at rest: gear, gap and servo in series.

        Args:
            torque: Torque of the gears [N m or N], shape (joint,).

        Returns:
            s^-1(tau / K) + tau / K_s [rad or m], shape (joint,). A gear that carries
            nothing, or no more than rounding, is in the middle of its gap.

        **Differentiability**: once; where a gear with a gap carries nothing, as steep
        as the way across the gap.
        """
        stretch = self.backlash_deflection(torque / self.joint_stiffness)
        if self.motors is None:
            return stretch
        return stretch + self.servo_deflection(torque)

    def backlash_deflection(self, y: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Stretch s^-1(y) of gears whose springs are stretched by y.

        Args:
            y: Stretch of the springs alone [rad or m], shape (joint,).

        Returns:
            Stretch with the gap [rad or m], shape (joint,).

        **Differentiability**: once in y but for kinks close to 0, between which it goes
        across the gap.
        """
        if self.backlash is None:
            return y
        return self.backlash.deflection(y)

    def servo_deflection(
        self, torque: Float[Array, " joint"]
    ) -> Float[Array, " joint"]:
        """Deflection of servos at rest by a torque, tau / K_s [rad or m].

        Args:
            torque: [N m or N], shape (joint,).

        **Differentiability**: linear in the torque.
        """
        if self.motors is None:
            return jnp.zeros_like(torque)
        return jnp.where(self.motor_mask(), torque / self.motors.stiffness, 0.0)

    def gravity_compensation(
        self, gravity: Float[Array, " joint"]
    ) -> Float[Array, " joint"]:
        """Compensation of gravity that a controller adds to the command [rad or m].

        The yielding of springs and servos; it knows of no gap.

        Args:
            gravity: Torque of the weight [N m or N], shape (joint,).

        **Differentiability**: linear in the torque.
        """
        lift = gravity / self.joint_stiffness
        if self.motors is None:
            return lift
        return lift + self.servo_deflection(gravity)

    def friction_torque(self, v: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Torque of friction against a steady motion [N m or N], shape (joint,).

        Args:
            v: Joint velocities [rad/s or m/s], shape (joint,).

        **Differentiability**: smooth; steep below the friction's speed.
        """
        if self.friction is None:
            return jnp.zeros_like(v)
        return self.friction.torque(v)


def joint_vector(
    robot: Robot, values: JointVector, name: str
) -> Float[Array, " joint"]:
    """User's joint vector as an array of the robot's type.

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
    """User's wrench as an array of the robot's type, 0 for None."""
    if wrench is None:
        return jnp.zeros(6, robot.dtype)
    vector = jnp.asarray(wrench, dtype=robot.dtype)
    if vector.shape != (6,):
        raise ValueError(
            "Argument `wrench` must have 6 numbers (force, then moment), but has "
            f"shape {vector.shape}."
        )
    return vector


def _check_drives(
    name: str,
    values: Float[Array, "*shape"],
    is_allowed: Bool[Array, "*shape"],
    allowed: str,
) -> None:
    """Raise if a known value is wrong; traced values have none to look at."""
    if not isinstance(is_allowed, Tracer) and not np.asarray(is_allowed).all():
        raise ValueError(
            f"Argument `{name}` must be {allowed}, but is {np.asarray(values)}."
        )
