"""Sizes of what machines are off by from their model, which several tables state."""

from dataclasses import fields

from .base import Settings, key
from .fields import Tolerance, TurnTolerance, Uncertainty


class MachineErrorSettings(Settings):
    """Sizes of the errors of a machine about its model, each drawn on its own.

    Which draws a size stands for its table says: half the width of an interval or a
    standard deviation; of friction, gaps and run-out, which are not negative, the upper
    end of an interval from 0, or the parameter of a half-normal distribution.

    Attributes:
        stiffness: Relative error of each joint's stiffness.
        damping: Relative error of each joint's damping.
        force: Relative error of each force coefficient.
        bandwidth: Relative error of the bandwidth of each joint's servo.
        links: Displacement of each joint along each axis [m].
        link_angles: Rotation of each joint about each axis [rad].
        backlash: Gap of each joint [rad].
        friction: Coulomb friction of each joint, as the angle by which it bends the
            spring [rad].
        presliding: By which a joint yields before it slides [rad], no error itself.
        registration: Displacement of the part along each axis, which touching off does
            not see [m].
        registration_angles: Rotation of the part about each axis [rad].
        runout: Run-out of the cutter [m].
    """

    stiffness: Uncertainty = key(
        "relative error of the stiffness of each joint, such as 0.2", default=0.0
    )
    damping: Uncertainty = key(
        "relative error of the damping of each joint, such as 0.2", default=0.0
    )
    force: Uncertainty = key(
        "relative error of each force coefficient, such as 0.1", default=0.0
    )
    bandwidth: Uncertainty = key(
        "relative error of the bandwidth of the servo of each joint, such as 0.1",
        default=0.0,
    )
    links: Tolerance = key(
        'displacement of each joint along each axis, such as "0.2 mm"; the work is '
        "touched off anew",
        default=0.0,
    )
    link_angles: TurnTolerance = key(
        'rotation of each joint about each axis, such as "0.2 mrad"', default=0.0
    )
    backlash: TurnTolerance = key('gap of each joint, such as "30 urad"', default=0.0)
    friction: TurnTolerance = key(
        "Coulomb friction of each joint, as the angle by which it bends the spring of "
        'the joint, such as "20 urad"',
        default=0.0,
    )
    presliding: TurnTolerance = key(
        'angle by which a joint with friction yields before it slides, such as "5 '
        'urad"',
        default=5e-6,
    )
    registration: Tolerance = key(
        "displacement of the part along each axis, which touching off does not see, "
        'such as "20 um"',
        default=0.0,
    )
    registration_angles: TurnTolerance = key(
        "rotation of the part about each axis through the points that are touched "
        'off, such as "0.1 mrad"',
        default=0.0,
    )
    runout: Tolerance = key('run-out of the cutter, such as "5 um"', default=0.0)

    @property
    def robot_errors(self) -> tuple[str, ...]:
        """Names of the sizes above 0 of errors that are known of robots alone."""
        others = {"stiffness", "damping", "force", "presliding"}
        names = [field.name for field in fields(MachineErrorSettings)]
        return tuple(n for n in names if n not in others and getattr(self, n) > 0)
