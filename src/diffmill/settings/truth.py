"""A machine that is not its model, for checks of a command: `[truth]` of a job file."""

from typing import Annotated

from pydantic import Field, StrictInt

from .base import key
from .fields import Tolerance, TurnTolerance, Uncertainty
from .machine_errors import MachineErrorSettings


class TruthSettings(MachineErrorSettings, table="truth"):
    """Sizes of what a real arm has and its model has not, of which machines are drawn.

    Errors are uniform within their sizes; friction, gaps and run-out have theirs.

    The defaults are those of an arm as it comes: reversals of the size that secondary
    encoders show of a KUKA KR 300 (Weigand et al., data set `Robot_Identification`),
    links as after a calibration by the maker, and what is usually known of stiffness
    and forces.

    Attributes:
        force_bias: Share by which all force coefficients are larger.
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
    draws: Annotated[StrictInt, Field(ge=0, le=1000)] = key(
        "how many machines are drawn; 0: none is run", default=4
    )
    seed: Annotated[StrictInt, Field(ge=0)] = key("seed of the draws", default=0)
