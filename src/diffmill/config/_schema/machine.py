"""`[machine]`: a machine given by its modes at the tool tip, instead of a robot."""

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from pydantic import Field, StrictFloat, StrictInt, StrictStr

from .fields import Angles3, Frequency, LinearStiffness, Mass, Ratio
from .table import TomlTable

_AXES = ("x", "y", "z")


Direction: TypeAlias = Annotated[
    list[StrictFloat | StrictInt], Field(min_length=3, max_length=3)
]


class ModeTable(TomlTable):
    """An entry of `[[machine.modes]]`: one mode as the tool tip shows it."""

    frequency: Frequency = Field(description='the natural one, such as "922 Hz"')
    damping_ratio: Ratio = Field(description="the damping ratio, such as 0.02")
    direction: Direction = Field(
        description="in which the tip moves, such as [1, 0, 0]; of any length"
    )
    stiffness: LinearStiffness | None = None
    mass: Mass | None = None

    def shape(self) -> Float[np.ndarray, " 3"]:
        """Return the motion of the tip for a modal mass of 1 kg [kg^-1/2]."""
        way = np.asarray(self.direction, np.float64)
        way = way / np.linalg.norm(way)
        if self.mass is not None:
            return way / np.sqrt(self.mass)
        assert self.stiffness is not None
        return way * (2 * np.pi * self.frequency) / np.sqrt(self.stiffness)

    def check(self, place: str, problems: list[str]) -> None:
        """Note what is wrong with the mode as a whole."""
        if (self.stiffness is None) == (self.mass is None):
            found = "nothing" if self.mass is None else "both"
            problems.append(
                f"{place}: found {found} of stiffness and mass, but exactly one is "
                "required: of the mode along its direction"
            )
        if not np.linalg.norm(np.asarray(self.direction, np.float64)) > 0:
            problems.append(
                f"{place} direction: found {self.direction}, but a direction is "
                "required, such as [1, 0, 0]"
            )
        if not self.damping_ratio < 1:
            problems.append(
                f"{place} damping_ratio: found {self.damping_ratio}, but a number from "
                "0 to less than 1 is required"
            )


class MachineTable(TomlTable):
    """`[machine]`."""

    modes: Annotated[list[ModeTable], Field(min_length=1)] | None = None
    file: Annotated[StrictStr, Field(min_length=1)] | None = None
    rpy: Angles3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    tool_axes: list[Literal["x", "y", "z"]] = Field(default_factory=lambda: [*_AXES])

    def carries(self) -> Float[np.ndarray, " 3"]:
        """Return 1 for the axes along which the tool is moved, 0 for the workpiece."""
        return np.array([float(axis in self.tool_axes) for axis in _AXES])


class ModesFile(TomlTable):
    """A file with `[[machine.modes]]` alone, as `diffmill identify` writes it."""

    modes: Annotated[list[ModeTable], Field(min_length=1)]


def is_machine(raw: Mapping[str, object]) -> bool:
    """Return whether a job has a machine of modes and no robot."""
    return "machine" in raw and "robot" not in raw
