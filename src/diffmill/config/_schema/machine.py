"""`[machine]`: a machine given by its modes at the tool tip, instead of a robot."""

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from pydantic import Field, StrictFloat, StrictInt, StrictStr

from ...settings.fields import Angles3, DampingRatio, Frequency, LinearStiffness, Mass
from ...settings.tables import TomlTable

_AXES = ("x", "y", "z")
# Largest component of a direction: its length is a number that can be divided by.
_SHORTEST, _LONGEST = 1e-9, 1e9


Direction: TypeAlias = Annotated[
    list[StrictFloat | StrictInt], Field(min_length=3, max_length=3)
]


class ModeTable(TomlTable):
    """An entry of `[[machine.modes]]`: one mode as the tool tip shows it."""

    frequency: Frequency = Field(
        description='natural frequency of the mode, such as "922 Hz"'
    )
    damping_ratio: DampingRatio = Field(
        description="damping ratio of the mode, such as 0.02"
    )
    direction: Direction = Field(
        description="direction in which the tip moves, such as [1, 0, 0]; of any length"
    )
    stiffness: LinearStiffness | None = Field(
        default=None,
        description='stiffness of the mode along its direction, such as "1.34 N/um"; '
        "required without mass",
    )
    mass: Mass | None = Field(
        default=None,
        description='mass of the mode along its direction, such as "40 g"; required '
        "without stiffness",
    )

    def shape(self) -> Float[np.ndarray, " 3"]:
        """Mode shape at the tip for a modal mass of 1 kg [kg^-1/2], shape (3,)."""
        way = np.asarray(self.direction, np.float64)
        way = way / np.linalg.norm(way)
        if self.mass is not None:
            return way / np.sqrt(self.mass)
        assert self.stiffness is not None
        return way * (2 * np.pi * self.frequency) / np.sqrt(self.stiffness)

    def check(self, place: str, problems: list[str]) -> None:
        """Faults of the mode's keys together."""
        if (self.stiffness is None) == (self.mass is None):
            found = "nothing" if self.mass is None else "both"
            problems.append(
                f"{place}: found {found} of stiffness and mass, but exactly one is "
                "required: of the mode along its direction"
            )
        longest = np.abs(np.asarray(self.direction, np.float64)).max()
        if not _SHORTEST <= longest <= _LONGEST:
            problems.append(
                f"{place} direction: found {self.direction}, but a direction is "
                f"required whose largest number is {_SHORTEST:g} to {_LONGEST:g}, such "
                "as [1, 0, 0]"
            )


class MachineTable(TomlTable):
    """`[machine]`."""

    modes: Annotated[list[ModeTable], Field(min_length=1)] | None = Field(
        default=None, description="modes at the tool tip; required without file"
    )
    file: Annotated[StrictStr, Field(min_length=1)] | None = Field(
        default=None,
        description='file with the modes, such as "identified.toml"; required '
        "without modes",
    )
    rpy: Angles3 = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="how the axes of the measurement are turned in work: roll, pitch "
        "and yaw",
    )
    tool_axes: list[Literal["x", "y", "z"]] = Field(
        default_factory=lambda: ["x", "y", "z"],
        description="axes along which the machine moves the tool, not the workpiece",
    )

    def carries(self) -> Float[np.ndarray, " 3"]:
        """Weight of each axis, shape (3,): 1 if the tool moves there, 0 if the work."""
        return np.array([float(axis in self.tool_axes) for axis in _AXES])


class ModesFile(TomlTable):
    """A file with `[[machine.modes]]` alone, as `diffmill identify` writes it."""

    modes: Annotated[list[ModeTable], Field(min_length=1)] = Field(
        description="modes at the tool tip, each of them a table [[machine.modes]]"
    )


def is_machine(raw: Mapping[str, object]) -> bool:
    """True if a job has a machine of modes and no robot."""
    return "machine" in raw and "robot" not in raw
