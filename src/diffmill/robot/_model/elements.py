"""The elements of a robot: combined in any order they make a tree.

Elements are data of the host (floats, sequences, NumPy); `build` compiles them into
the arrays of a `Robot`, which are those to differentiate by.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._types import RealScalarLike

Vector3: TypeAlias = (
    tuple[RealScalarLike, RealScalarLike, RealScalarLike]
    | Sequence[RealScalarLike]
    | Float[np.ndarray, "3"]
)
Matrix3: TypeAlias = Float[np.ndarray, "3 3"]

# A vector that is not longer than this has no direction.
_SHORTEST = 1e-9


class AbstractElement(eqx.Module):
    """A part of the robot's structure; it continues from the frame before it."""


class FixedRotation(AbstractElement):
    """Turn the frame.

    Attributes:
        rotation: Maps the new frame's coordinates to the old one's, shape (3, 3).
    """

    rotation: Matrix3

    def __check_init__(self):
        if not is_rotation(self.rotation):
            raise ValueError(
                "Argument `rotation` must be a rotation matrix (orthonormal, "
                f"determinant 1), but is {np.asarray(self.rotation).tolist()}."
            )


class FixedTranslation(AbstractElement):
    """Shift the frame.

    Attributes:
        position: New origin in the old frame [m], shape (3,).
    """

    position: Vector3

    def __check_init__(self):
        check_vector("position", self.position)


class Mimic(eqx.Module):
    """Mimicry of another joint: the position is multiplier * q + offset of it.

    Attributes:
        joint: Name of the other joint, which may itself follow a third.
        multiplier: [-, rad/m or m/rad].
        offset: [rad or m].
    """

    joint: str = eqx.field(static=True)
    multiplier: RealScalarLike = 1.0
    offset: RealScalarLike = 0.0

    def __check_init__(self):
        if not np.all(np.isfinite([float(self.multiplier), float(self.offset)])):
            raise ValueError(
                "Arguments `multiplier` and `offset` must be finite, but are "
                f"{self.multiplier} and {self.offset}."
            )


class Drive(eqx.Module):
    """Options of a drive beyond spring and damper, all off by default.

    See `with_backlash`, `with_friction` and `with_motors` of `Robot`.

    Attributes:
        backlash: Gap of the gear [rad or m].
        coulomb_friction: Of the joint [N m or N].
        viscous_friction: Of the joint [N m s/rad or N s/m].
        friction_speed: Above it the joint slides [rad/s or m/s].
        presliding: By which the joint yields before it slides [rad or m]; None for a
            joint that creeps instead of sticking.
        motor_inertia: Of the motor on the joint's side of the gear [kg m^2 or kg];
            None for a motor that stands at its command.
        servo_stiffness: Stiffness of the servo that holds the motor [N m/rad or N/m].
        servo_damping: [N m s/rad or N s/m].
    """

    backlash: RealScalarLike = 0.0
    coulomb_friction: RealScalarLike = 0.0
    viscous_friction: RealScalarLike = 0.0
    friction_speed: RealScalarLike = 1e-3
    presliding: RealScalarLike | None = None
    motor_inertia: RealScalarLike | None = None
    servo_stiffness: RealScalarLike | None = None
    servo_damping: RealScalarLike = 0.0

    def __check_init__(self):
        if (self.motor_inertia is None) != (self.servo_stiffness is None):
            raise ValueError(
                "Arguments `motor_inertia` and `servo_stiffness` must come together, "
                f"but are {self.motor_inertia} and {self.servo_stiffness}."
            )


class RevoluteJoint(AbstractElement):
    """Turn about an axis, driven through a spring and a damper.

    Attributes:
        name: Name of the joint.
        axis: Axis in the current frame, of any length but 0, shape (3,).
        stiffness: K [N m/rad]; infinite if not known.
        damping: D [N m s/rad].
        lower: Lower limit [rad].
        upper: Upper limit [rad].
        home: Angle in the home pose [rad].
        speed: Fastest turn of the joint [rad/s]; infinite if not known.
        is_virtual: No motor: the spring rests at 0 (an elasticity of the structure).
        mimic: The joint that this one follows; it is then no joint of the joint
            vector, and has no spring, limits or home of its own.
        drive: More about its drive, or None.
    """

    name: str = eqx.field(static=True)
    axis: Vector3 = (0.0, 0.0, 1.0)
    stiffness: RealScalarLike = math.inf
    damping: RealScalarLike = 0.0
    lower: RealScalarLike = -math.inf
    upper: RealScalarLike = math.inf
    home: RealScalarLike = 0.0
    is_virtual: bool = eqx.field(static=True, default=False)
    mimic: Mimic | None = None
    drive: Drive | None = None
    speed: RealScalarLike = math.inf

    def __check_init__(self):
        check_joint(self)


class PrismaticJoint(AbstractElement):
    """Slide along an axis, driven through a spring and a damper.

    Attributes:
        name: Name of the joint.
        axis: Direction in the current frame, of any length but 0, shape (3,).
        stiffness: K [N/m]; infinite if not known.
        damping: D [N s/m].
        lower: Lower limit [m].
        upper: Upper limit [m].
        home: Position in the home pose [m].
        speed: Fastest slide of the joint [m/s]; infinite if not known.
        is_virtual: No motor: the spring rests at 0 (an elasticity of the structure).
        mimic: The joint that this one follows; it is then no joint of the joint
            vector, and has no spring, limits or home of its own.
        drive: More about its drive, or None.
    """

    name: str = eqx.field(static=True)
    axis: Vector3 = (0.0, 0.0, 1.0)
    stiffness: RealScalarLike = math.inf
    damping: RealScalarLike = 0.0
    lower: RealScalarLike = -math.inf
    upper: RealScalarLike = math.inf
    home: RealScalarLike = 0.0
    is_virtual: bool = eqx.field(static=True, default=False)
    mimic: Mimic | None = None
    drive: Drive | None = None
    speed: RealScalarLike = math.inf

    def __check_init__(self):
        check_joint(self)


class RigidBody(AbstractElement):
    """A mass fixed to the current frame; several in one place add up.

    Attributes:
        mass: [kg].
        center_of_mass: In the current frame [m], shape (3,).
        inertia: About the centre of mass, axes of the current frame [kg m^2],
            shape (3, 3), positive semidefinite: a mass may be a point.
        is_possible: False lets pass an inertia that no body has, as real robot files
            contain; their reader warns instead.
        name: Of the body; a user's own spindle replaces one called "spindle".
    """

    mass: RealScalarLike
    center_of_mass: Vector3
    inertia: Matrix3
    is_possible: bool = eqx.field(static=True, default=True)
    name: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check_vector("center_of_mass", self.center_of_mass)
        if not 0.0 <= float(self.mass) < math.inf:
            raise ValueError(
                f"Argument `mass` must be finite and not negative, but is {self.mass}."
            )
        fault = inertia_fault(self.inertia)
        if fault and self.is_possible:
            raise ValueError(f"Argument `inertia` must be {fault}")


class Fork(AbstractElement):
    """Branch off; what follows the fork continues from the fork's own frame.

    Attributes:
        branches: One sequence of elements per side branch.
    """

    branches: Sequence[Sequence[AbstractElement]]


class Tool(AbstractElement):
    """Mark the flange (the current frame) and place the tool on it.

    Attributes:
        name: Name of the tool.
        position: Tool tip in the flange frame [m], shape (3,).
        rotation: Maps tool coordinates to the flange's, shape (3, 3); tool +z points
            from the tip to the shank.
    """

    name: str = eqx.field(static=True, default="tool")
    position: Vector3 = (0.0, 0.0, 0.0)
    rotation: Matrix3 = eqx.field(default_factory=lambda: np.eye(3))

    def __check_init__(self):
        check_vector("position", self.position)
        if not is_rotation(self.rotation):
            raise ValueError(
                "Argument `rotation` must be a rotation matrix (orthonormal, "
                f"determinant 1), but is {np.asarray(self.rotation).tolist()}."
            )


class RobotDescription(NamedTuple):
    """A robot as its file describes it.

    Attributes:
        name: Name of the model.
        elements: From the base outwards.
        notes: Doubts about the file, one sentence each.
    """

    name: str
    elements: list[AbstractElement]
    notes: Sequence[str] = ()


def is_rotation(rotation: Matrix3) -> bool:
    """True if a matrix is orthonormal and right-handed."""
    gram = rotation.T @ rotation
    return bool(np.allclose(gram, np.eye(3), atol=1e-9) and np.linalg.det(rotation) > 0)


def check_vector(name: str, vector: Vector3) -> None:
    """Raise unless `vector` is three finite numbers."""
    if len(vector) != 3 or not np.all(np.isfinite(np.asarray(vector, float))):
        raise ValueError(
            f"Argument `{name}` must be 3 finite numbers, but is {vector}."
        )


def is_direction(vector: Vector3) -> bool:
    """True if a vector is long enough to be divided by its length."""
    return _SHORTEST < math.hypot(*map(float, vector)) < math.inf


def check_joint(joint: RevoluteJoint | PrismaticJoint) -> None:
    """Raise unless a joint's numbers make sense."""
    check_vector("axis", joint.axis)
    if not is_direction(joint.axis):
        raise ValueError(f"Argument `axis` of {joint.name!r} must not be 0.")
    if not float(joint.stiffness) > 0.0:
        raise ValueError(
            f"Argument `stiffness` of {joint.name!r} must be positive, but is "
            f"{joint.stiffness}."
        )
    if not 0.0 <= float(joint.damping) < math.inf:
        raise ValueError(
            f"Argument `damping` of {joint.name!r} must be finite and not negative, "
            f"but is {joint.damping}."
        )
    if not float(joint.speed) > 0.0:
        raise ValueError(
            f"Argument `speed` of {joint.name!r} must be positive, but is "
            f"{joint.speed}."
        )
    if not float(joint.lower) <= float(joint.home) <= float(joint.upper):
        raise ValueError(
            f"Arguments of {joint.name!r} must satisfy lower <= home <= upper, but "
            f"are {joint.lower}, {joint.home}, {joint.upper}."
        )


def inertia_fault(inertia: Matrix3) -> str:
    """Fault of an inertia that is no symmetric, positive matrix; empty for none."""
    if not np.all(np.isfinite(inertia)):
        return "finite."
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=0.0):
        return f"symmetric, but is {inertia.tolist()}."
    principal = np.linalg.eigvalsh(inertia)
    # The tolerance lets rounded data pass, such as a turned rod.
    if principal[0] < -1e-9 * abs(principal[2]):
        return (
            f"positive semidefinite, but its principal values are {principal.tolist()}."
        )
    return ""


def triangle_fault(inertia: Matrix3) -> str:
    """Fault of an inertia that no distribution of mass has; empty for none."""
    principal = np.linalg.eigvalsh(inertia)
    # Equality is a flat body; the tolerance lets rounded data pass.
    if principal[2] <= (principal[0] + principal[1]) * (1.0 + 1e-6):
        return ""
    return (
        "that of a body (no principal value above the sum of the other two), but its "
        f"principal values are {principal.tolist()}."
    )
