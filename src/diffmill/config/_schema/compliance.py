"""Springs behind the arm: `[robot.flange_spring]` and `[robot.bending_tool]`.

Without its table a spring is not there, and nothing of it is computed.
"""

import math
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, StrictBool

from ...settings.fields import (
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
from ...settings.tables import TomlTable

if TYPE_CHECKING:
    from ...cutter import AbstractCutter
    from ...robot import Robot

_THREE = Field(min_length=3, max_length=3)
# Usual radii of gyration of spindles [m].
_LEAST_RADIUS, _MOST_RADIUS = 8e-3, 1.0
# Usual overhangs of cutters, and shanks, in diameters; small ones have shanks of up to
# this width [m].
_LEAST_OVERHANG, _MOST_OVERHANG = 0.5, 20.0
_LEAST_SHANK, _MOST_SHANK, _SHANK_OF_SMALL = 0.25, 3.0, 12e-3


class FlangeSpringTable(TomlTable):
    """`[robot.flange_spring]`: what is soft between flange and spindle.

    One of `linear_stiffness` and `rotary_stiffness`, or both, is required.
    """

    linear_stiffness: Annotated[list[LinearStiffness], _THREE] | None = Field(
        default=None,
        description='stiffness along the axes of the flange, such as ["20 N/um", ...]; '
        "rigid if left out",
    )
    rotary_stiffness: Annotated[list[RotaryStiffness], _THREE] | None = Field(
        default=None,
        description="stiffness about the axes of the flange, such as "
        '["2e6 N*m/rad", ...]; rigid if left out',
    )
    mass: Mass = Field(
        description='mass of the spindle behind the springs, such as "30 kg"'
    )
    center_of_mass: Lengths3 = Field(
        description="centre of mass of the spindle in the frame of the flange, such as "
        '["0 mm", "0 mm", "120 mm"]'
    )
    inertia: Annotated[list[Inertia], _THREE] = Field(
        description="three moments of inertia of the spindle about its centre of mass, "
        'such as ["0.75 kg*m^2", ...]'
    )
    in_last_link: StrictBool = Field(
        default=True,
        description="true: the last link of the robot already includes the spindle, "
        "which then moves behind the springs; false: the spindle is added",
    )
    damping_ratio: Ratio = Field(
        default=0.02, description="share of critical damping of each spring alone"
    )

    def notes(self) -> tuple[str, ...]:
        """Note of a mass and an inertia that are not those of one body."""
        radii = [math.sqrt(inertia / self.mass) for inertia in self.inertia]
        if _LEAST_RADIUS <= min(radii) and max(radii) <= _MOST_RADIUS:
            return ()
        found = ", ".join(f"{1e3 * radius:.3g}" for radius in radii)
        return (
            f"[robot.flange_spring] inertia: with a mass of {self.mass:g} kg the radii "
            f"of gyration are {found} mm; {1e3 * _LEAST_RADIUS:g} mm to "
            f"{1e3 * _MOST_RADIUS:g} mm are usual",
        )


class BendingToolTable(TomlTable):
    """`[robot.bending_tool]`: the cutter as a cantilever."""

    overhang: PositiveLength = Field(
        description='length from the holder to the tip, such as "40 mm"'
    )
    shank_diameter: PositiveLength | None = Field(
        default=None,
        description='diameter above the flutes, such as "10 mm"; that of the cutter if '
        "left out",
    )
    young_modulus: Modulus = Field(
        default=600e9, description="Young's modulus of the tool"
    )
    density: Density = Field(default=14.5e3, description="density of the tool")
    flute_share: Share = Field(
        default=0.8,
        description="diameter that bends like the fluted part, as a share of that of "
        "the cutter",
    )
    damping_ratio: Ratio = Field(
        default=0.02, description="share of critical damping of the tool alone"
    )

    def notes(self, diameter: float) -> tuple[str, ...]:
        """Notes of lengths that are unusual for a cutter of a diameter [m]."""
        shank = diameter if self.shank_diameter is None else self.shank_diameter
        widest = max(_MOST_SHANK, _SHANK_OF_SMALL / diameter)
        return tuple(
            f"[robot.bending_tool] {key}: {length / diameter:.3g} times the diameter "
            f"of the cutter; {least:.3g} to {most:.3g} times are usual"
            for key, length, least, most in (
                ("overhang", self.overhang, _LEAST_OVERHANG, _MOST_OVERHANG),
                ("shank_diameter", shank, _LEAST_SHANK, widest),
            )
            if not least <= length / diameter <= most
        )


def with_spring(
    robot: "Robot", table: FlangeSpringTable | None, problems: list[str]
) -> "Robot":
    """Robot with the springs of a table at its flange.

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
        text = str(error).replace("is_in_link=False", "in_last_link = false")
        problems.append(f"[robot.flange_spring]: {text}")
        return robot


def with_bending_cutter(
    robot: "Robot", table: BendingToolTable | None, cutter: "AbstractCutter | None"
) -> "Robot":
    """Robot with a cutter that bends.

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
