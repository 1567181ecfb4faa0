"""A machine that is not its model, for checks of a command: `[truth]` of a job file."""

from typing import Annotated

from pydantic import Field, StrictInt

from .base import Settings, key
from .fields import Tolerance, TurnTolerance, Uncertainty


class TruthSettings(Settings, table="truth"):
    """Sizes of what a real arm has and its model has not, of which machines are drawn.

    The defaults are those of an arm as it comes: reversals of the size that secondary
    encoders show of a KUKA KR 300 (Weigand et al., data set `Robot_Identification`),
    links as after a calibration by the maker, and what is usually known of stiffness
    and forces.

    Attributes:
        stiffness: Largest share by which each joint's stiffness is off; uniform.
        damping: Largest share by which each joint's damping is off; uniform.
        force: Largest share by which each force coefficient is off; uniform.
        force_bias: Share by which all of them are larger.
        links: Largest displacement of each joint along each axis [m]; uniform.
        link_angles: Largest rotation of each joint about each axis [rad]; uniform.
        backlash: Gap of each joint [rad].
        friction: Coulomb friction of each joint, as the angle by which it bends the
            spring [rad].
        presliding: By which a joint yields before it slides [rad].
        runout: Run-out of the cutter [m].
        draws: How many machines; none are run for 0.
        seed: Seed of the draws.
    """

    stiffness: Uncertainty = key(
        "largest share by which the stiffness of each joint is off", default=0.1
    )
    damping: Uncertainty = key(
        "largest share by which the damping of each joint is off", default=0.2
    )
    force: Uncertainty = key(
        "largest share by which each force coefficient is off", default=0.1
    )
    force_bias: Uncertainty = key(
        "share by which all force coefficients are larger than modelled", default=0.2
    )
    links: Tolerance = key(
        "largest displacement of each joint along each axis, after touching off",
        default=0.5e-3,
    )
    link_angles: TurnTolerance = key(
        'largest rotation of each joint about each axis, such as "0.5 mrad"',
        default=0.5e-3,
    )
    backlash: TurnTolerance = key('gap of each joint, such as "30 urad"', default=30e-6)
    friction: TurnTolerance = key(
        "Coulomb friction of each joint, as the angle by which it bends the spring of "
        'the joint, such as "20 urad"',
        default=20e-6,
    )
    presliding: TurnTolerance = key(
        'angle by which a joint with friction yields before it slides, such as "5 '
        'urad"',
        default=5e-6,
    )
    runout: Tolerance = key("run-out of the cutter", default=0.0)
    draws: Annotated[StrictInt, Field(ge=0, le=1000)] = key(
        "how many machines are drawn; 0: none is run", default=4
    )
    seed: Annotated[StrictInt, Field(ge=0)] = key("seed of the draws", default=0)
