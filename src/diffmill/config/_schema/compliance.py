"""Springs behind the arm: `[robot.flange_spring]` and `[robot.bending_tool]`.

Without its table a spring is not there, and nothing of it is computed.
"""

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, StrictBool

from .fields import (
    Density,
    Inertia,
    Lengths3,
    LinearStiffness,
    Mass,
    Modulus,
    PositiveLength,
    Ratio,
    RotaryStiffness,
    Share,
)
from .table import TomlTable

if TYPE_CHECKING:
    from ...cutter import AbstractCutter
    from ...robot import Robot

_THREE = Field(min_length=3, max_length=3)


class FlangeSpringTable(TomlTable):
    """`[robot.flange_spring]`: what is soft between flange and spindle."""

    linear_stiffness: Annotated[list[LinearStiffness], _THREE] | None = None
    rotary_stiffness: Annotated[list[RotaryStiffness], _THREE] | None = None
    mass: Mass = Field(description='the spindle behind it, such as "30 kg"')
    center_of_mass: Lengths3 = Field(description="three lengths in the flange's frame")
    inertia: Annotated[list[Inertia], _THREE] = Field(
        description='three moments about its centre, such as ["0.75 kg*m^2", ...]'
    )
    in_last_link: StrictBool = True
    damping_ratio: Ratio = 0.02


class BendingToolTable(TomlTable):
    """`[robot.bending_tool]`: the cutter as a cantilever."""

    overhang: PositiveLength = Field(description='a length, such as "40 mm"')
    shank_diameter: PositiveLength | None = None
    young_modulus: Modulus = 600e9
    density: Density = 14.5e3
    flute_share: Share = 0.8
    damping_ratio: Ratio = 0.02


def with_spring(
    robot: "Robot", table: FlangeSpringTable | None, problems: list[str]
) -> "Robot":
    """Return the robot with the springs of a table at its flange.

    Args:
        robot: The robot.
        table: The table; None for a rigid flange.
        problems: Receives what is wrong.

    Returns:
        The robot, as it was after a fault.
    """
    from ...robot import FlangeSpring

    if table is None:
        return robot
    options = table.model_dump(exclude={"in_last_link"})
    try:
        spring = FlangeSpring(**options, is_in_link=table.in_last_link)
        return spring.mounted_on(robot)
    except ValueError as error:
        problems.append(f"[robot.flange_spring]: {error}")
        return robot


def with_bending_cutter(
    robot: "Robot", table: BendingToolTable | None, cutter: "AbstractCutter | None"
) -> "Robot":
    """Return the robot with a cutter that bends.

    Args:
        robot: The robot with its tool and the springs of its flange.
        table: The table; None for a rigid tool.
        cutter: The cutter, None after a fault of its own.

    Returns:
        The robot.
    """
    from ...robot import BendingTool

    if table is None or cutter is None:
        return robot
    diameter = 2 * cutter.nominal_radius
    shank = table.shank_diameter
    tool = BendingTool(
        overhang=table.overhang,
        flute_length=min(cutter.flute_length, table.overhang),
        cutter_diameter=diameter,
        shank_diameter=diameter if shank is None else shank,
        young_modulus=table.young_modulus,
        density=table.density,
        flute_share=table.flute_share,
        damping_ratio=table.damping_ratio,
    )
    return tool.mounted_on(robot)
