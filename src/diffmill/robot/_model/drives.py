"""Options of drives beyond spring and damper, each switched on by its data.

Backlash: the gear carries nothing within a gap. Friction: of the joint, on its own side
of the gear. Motors: a mass behind the gear that a servo holds, instead of one that
stands where the controller says. What is None is absent from the compiled program.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from .elements import Drive
from .robot import (
    Backlash,
    Friction,
    JointVector,
    Motors,
    Robot,
    check_drives,
    joint_vector,
)


def with_backlash(
    robot: Robot, gap: JointVector, *, corner: RealScalarLike = 0.2
) -> Robot:
    """Return the robot with backlash in its gears.

        tau = K s(x) + D s'(x) x',   x = theta - q

    s is 0 in the middle of the gap, has slope 1 outside of it, and goes from one to the
    other along a parabola; without a gap it is x.

    Args:
        robot: The robot.
        gap: b, by which a joint moves freely with its motor locked [rad or m],
            shape (joint,); 0 for none.
        corner: Width of the parabola at either end as a share of the gap, above 0 and
            at most 1 [-].

    Returns:
        The changed robot.

    Raises:
        ValueError: If a gap is negative.

    **Differentiability**: smooth for a gap above 0.
    """
    b = joint_vector(robot, gap, "gap")
    check_drives("gap", b, b >= 0.0, "not negative")
    share = jnp.asarray(corner, robot.dtype)
    check_drives("corner", share, (share > 0.0) & (share <= 1.0), "above 0, at most 1")
    return dataclasses.replace(robot, backlash=Backlash(b, share))


def with_friction(
    robot: Robot, coulomb: JointVector, viscous: JointVector, speed: JointVector
) -> Robot:
    """Return the robot with friction in its joints.

        tau_f = F_c tanh(v / v_s) + F_v v

    Args:
        robot: The robot.
        coulomb: F_c [N m or N], shape (joint,); 0 for none.
        viscous: F_v [N m s/rad or N s/m], shape (joint,); 0 for none.
        speed: v_s, above which a joint slides [rad/s or m/s], shape (joint,). Below
            it the joint creeps where a real one would stick.

    Returns:
        The changed robot.

    Raises:
        ValueError: If a friction is negative or a speed not positive.
    """
    F_c = joint_vector(robot, coulomb, "coulomb")
    F_v = joint_vector(robot, viscous, "viscous")
    v_s = joint_vector(robot, speed, "speed")
    check_drives("coulomb", F_c, F_c >= 0.0, "not negative")
    check_drives("viscous", F_v, F_v >= 0.0, "not negative")
    check_drives("speed", v_s, v_s > 0.0, "positive")
    return dataclasses.replace(robot, friction=Friction(F_c, F_v, v_s))


def with_motors(
    robot: Robot, inertia: JointVector, stiffness: JointVector, damping: JointVector
) -> Robot:
    """Return the robot with motors that have a mass and are held by a servo.

        J_m theta'' = K_s (theta_c - theta) + D_s (theta_c' - theta') - tau

    theta_c is what the controller commands, tau what the gear carries. All numbers are
    behind the gear, on the joint's side: a rotor's inertia times the ratio squared.

    Args:
        robot: The robot.
        inertia: J_m [kg m^2 or kg], shape (joint,); not used for virtual joints.
        stiffness: K_s of the servo [N m/rad or N/m], shape (joint,).
        damping: D_s of the servo [N m s/rad or N s/m], shape (joint,).

    Returns:
        The changed robot.

    Raises:
        ValueError: If an inertia or a stiffness of a joint with a motor is not
            positive, or a damping negative.
    """
    has_motor = robot.motor_mask()
    values = []
    for name, given in (("inertia", inertia), ("stiffness", stiffness)):
        value = joint_vector(robot, given, name)
        # Virtual joints have no motor: any number does, and 1 divides safely.
        value = jnp.where(has_motor, value, 1.0)
        is_good = (value > 0.0) & jnp.isfinite(value)
        check_drives(name, value, is_good, "positive and finite")
        values.append(value)
    D_s = jnp.where(has_motor, joint_vector(robot, damping, "damping"), 0.0)
    check_drives("damping", D_s, D_s >= 0.0, "not negative")
    return dataclasses.replace(robot, motors=Motors(values[0], values[1], D_s))


def with_joint_drives(robot: Robot, drives: Sequence[Drive | None]) -> Robot:
    """Return the robot with the options that its joints' elements ask for.

    Args:
        robot: The robot.
        drives: One per joint.

    Returns:
        The robot, the same if none asks for any.

    Raises:
        ValueError: If some of the motors have a mass, but not all of them, or a
            virtual joint has one.
    """
    if not any(drives):
        return robot
    filled = [drive or Drive() for drive in drives]
    column = lambda name: [float(getattr(drive, name)) for drive in filled]
    if any(column("backlash")):
        robot = with_backlash(robot, column("backlash"))
    coulomb, viscous = column("coulomb_friction"), column("viscous_friction")
    if any(coulomb + viscous):
        robot = with_friction(robot, coulomb, viscous, column("friction_speed"))
    has_mass = [drive.motor_inertia is not None for drive in filled]
    if not any(has_mass):
        return robot
    if has_mass != robot.motor_mask().tolist():
        names = [n for n, m in zip(robot.joint_names, has_mass, strict=True) if m]
        raise ValueError(
            "Either all motors or none must have a `motor_inertia`, and virtual joints "
            f"have no motor, but those of {', '.join(names)} have one."
        )
    inertia = [drive.motor_inertia or 1.0 for drive in filled]
    stiffness = [drive.servo_stiffness or 1.0 for drive in filled]
    return with_motors(robot, inertia, stiffness, column("servo_damping"))


class GearTorque(eqx.Module):
    """Torque of the gears.

    Attributes:
        torque: tau [N m or N], shape (joint,).
        stiffness: Its slope in x, K s'(x) [N m/rad or N/m], shape (joint,).
        damping: Its slope in x', D s'(x) [N m s/rad or N s/m], shape (joint,).
    """

    torque: Float[Array, " joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]


def gear_torque(
    robot: Robot, stretch: Float[Array, " joint"], rate: Float[Array, " joint"]
) -> GearTorque:
    """Return what the gears carry at a stretch x = theta - q.

    Args:
        robot: The robot.
        stretch: x [rad or m], shape (joint,).
        rate: x' [rad/s or m/s], shape (joint,).

    Returns:
        Torque and slopes. The damper works where the spring does: its torque is that
        of D d s(x) / dt.

    **Differentiability**: smooth; slopes have kinks at the corners of a gap.
    """
    K, D = robot.joint_stiffness, robot.joint_damping
    if robot.backlash is None:
        return GearTorque(K * stretch + D * rate, K, D)
    s, slope = dead_zone(stretch, robot.backlash)
    return GearTorque(K * s + D * slope * rate, K * slope, D * slope)


def dead_zone(
    x: Float[Array, " joint"], backlash: Backlash
) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
    """Return s(x) of a gap, and its slope; see `with_backlash`."""
    # symbols: b gap, w width of a corner, u how far x is into the corner
    b, w = backlash.gap, backlash.corner * backlash.gap
    has_gap = b > 0.0
    size, safe = jnp.abs(x), jnp.where(has_gap, w, 1.0)
    u = jnp.maximum(size - (b - w) / 2, 0.0)
    is_beyond = u > w
    s = jnp.sign(x) * jnp.where(is_beyond, size - b / 2, u**2 / (2 * safe))
    slope = jnp.where(is_beyond, 1.0, u / safe)
    return jnp.where(has_gap, s, x), jnp.where(has_gap, slope, 1.0)


def drive_deflection(
    robot: Robot, torque: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return theta_c - q of drives at rest: gear, gap and servo in series.

    Args:
        robot: The robot.
        torque: What the gears carry [N m or N], shape (joint,).

    Returns:
        s^-1(tau / K) + tau / K_s [rad or m], shape (joint,). A gear that carries
        nothing is in the middle of its gap.

    **Differentiability**: smooth, but where a gear with a gap carries nothing.
    """
    stretch = backlash_deflection(robot, torque / robot.joint_stiffness)
    if robot.motors is None:
        return stretch
    return stretch + servo_deflection(robot, torque)


def backlash_deflection(
    robot: Robot, y: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return s^-1(y): the stretch of gears whose springs are stretched by y.

    Args:
        robot: The robot.
        y: Stretch of the springs alone [rad or m], shape (joint,).

    Returns:
        Stretch with the gap [rad or m], shape (joint,).

    **Differentiability**: once in y, but at 0 it jumps across the gap.
    """
    if robot.backlash is None:
        return y
    b, w = robot.backlash.gap, robot.backlash.corner * robot.backlash.gap
    size = jnp.abs(y)
    is_loaded = (b > 0.0) & (size > jnp.finfo(y.dtype).eps * b)
    in_corner = is_loaded & (size < w / 2)
    root = jnp.sqrt(jnp.where(in_corner, 2 * w * size, 1.0))
    edge = jnp.where(in_corner, (b - w) / 2 + root, b / 2 + size)
    return jnp.where(is_loaded, jnp.sign(y) * edge, y)


def servo_deflection(
    robot: Robot, torque: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return by how much servos at rest yield to a torque, tau / K_s [rad or m].

    Args:
        robot: The robot.
        torque: [N m or N], shape (joint,).

    **Differentiability**: linear in the torque.
    """
    if robot.motors is None:
        return jnp.zeros_like(torque)
    return jnp.where(robot.motor_mask(), torque / robot.motors.stiffness, 0.0)


def gravity_compensation(
    robot: Robot, gravity: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return what a controller adds to the command against gravity [rad or m].

    The yielding of springs and servos; it knows of no gap.

    Args:
        robot: The robot.
        gravity: Torque of the weight [N m or N], shape (joint,).

    **Differentiability**: linear in the torque.
    """
    lift = gravity / robot.joint_stiffness
    if robot.motors is None:
        return lift
    return lift + servo_deflection(robot, gravity)


def friction_torque(robot: Robot, v: Float[Array, " joint"]) -> Float[Array, " joint"]:
    """Return the torque of friction against a motion [N m or N], shape (joint,).

    Args:
        robot: The robot.
        v: Joint velocities [rad/s or m/s], shape (joint,).

    **Differentiability**: smooth; steep below the friction's speed.
    """
    if robot.friction is None:
        return jnp.zeros_like(v)
    f = robot.friction
    return f.coulomb * jnp.tanh(v / f.speed) + f.viscous * v


def coulomb_damping(
    friction: Friction, v: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return the damper that brakes like Coulomb friction does at v: F_c tanh / v.

    Args:
        friction: The friction of the joints.
        v: Joint velocities [rad/s or m/s], shape (joint,).

    Returns:
        Dampers [N m s/rad or N s/m], shape (joint,).

    **Differentiability**: smooth but for rounding where tanh is replaced by its slope.
    """
    x = v / friction.speed
    is_slow = jnp.abs(x) < 1e-4
    safe = jnp.where(is_slow, 1.0, x)
    return (
        friction.coulomb
        / friction.speed
        * jnp.where(is_slow, 1.0, jnp.tanh(safe) / safe)
    )
