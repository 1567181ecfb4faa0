"""Options of `diffmill new`, some of them of `check` and `convert`, too."""

import dataclasses
from typing import Annotated, Literal, TypeAlias

import tyro

ToolAxisOption: TypeAlias = Annotated[
    Literal["x", "y", "z", "-x", "-y", "-z"] | None,
    tyro.conf.arg(
        help="Axis of a robot's tool that points from the shank to the tip (KRL, "
        "RAPID); z if not given."
    ),
]
ProgramKeys: TypeAlias = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        metavar="KEY=VALUE",
        help='Keys of [program] as in a job, such as \'machine_zero = ["0 mm", "0 mm", '
        '"300 mm"]\' or \'tool_lengths = { 1 = "80 mm" }\', for what a program leaves '
        "to the control.",
    ),
]


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
        tool_axis: Axis of a robot's tool that points from the shank to the tip.
        program: Lines of `[program]` that the program leaves to the control.
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
    tool_axis: ToolAxisOption = None
    program: ProgramKeys = ()

    @property
    def program_lines(self) -> list[str]:
        """Lines of `[program]` that the options state; `program` counts first."""
        keys = [line.partition("=")[0].strip() for line in self.program]
        is_alone = self.tool_axis is not None and "tool_axis" not in keys
        return [*([f'tool_axis = "{self.tool_axis}"'] * is_alone), *self.program]
