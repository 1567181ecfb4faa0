"""Options of `diffmill new`."""

import dataclasses
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class JobOptions:
    """Values of a new job; None for what is left to program or user.

    Attributes:
        robot: A built-in model, or a robot file.
        diameter: Of the cutter, with its unit.
        teeth: Number of teeth.
        material: Name of a material.
        speed: Of the spindle, with its unit.
        tool: Number of the tool, of several in the program.
    """

    robot: Annotated[
        str | None,
        tyro.conf.arg(help="A built-in model, or a robot file (.toml, .urdf)."),
    ] = None
    diameter: Annotated[
        str | None, tyro.conf.arg(help='Diameter of the cutter, such as "10 mm".')
    ] = None
    teeth: Annotated[int | None, tyro.conf.arg(help="Its number of teeth.")] = None
    material: Annotated[
        str | None, tyro.conf.arg(help="Material of the work, by name.")
    ] = None
    speed: Annotated[
        str | None, tyro.conf.arg(help='Spindle speed, such as "8000 rpm".')
    ] = None
    tool: Annotated[
        int | None, tyro.conf.arg(help="Number of the tool, of several.")
    ] = None
