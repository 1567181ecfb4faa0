"""Modes from measured vibrations: their table, and the study of them all."""

from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import Field, StrictInt, StrictStr

from ...identification import FrequencyResponse, ModeStudy, RingDown
from ...io import TableReader, parse_pose
from ...robot import Robot
from ...settings.fields import Frequency
from .context import Context
from .robot import StudiedRobotTable, read_tool_robot
from .schema import MeasuredTable


class ModesTable(MeasuredTable):
    """Keys of a table of modes.

    They stand in `[[ring_down]]` and `[[frequency_response]]`.
    """

    modes: Annotated[StrictInt, Field(ge=1, le=20)] | None = Field(
        default=None,
        description="number of modes; 1 if left out, and with frequencies their number",
    )
    frequencies: list[Frequency] | None = Field(
        default=None,
        description='rough frequencies of the modes, such as ["11 Hz", "15 Hz"]; '
        "looked for if left out",
    )
    joint_positions: list[StrictStr] | None = Field(
        default=None,
        description='pose of the robot, such as ["0 deg", "-90 deg", ...]; required to '
        "fit the damping of joints",
    )

    @property
    def mode_count(self) -> int:
        """Number of modes that are sought."""
        return len(self.frequencies or ()) or self.modes or 1

    @property
    def guesses(self) -> Float[np.ndarray, " mode"] | None:
        """Rough frequencies of the modes [Hz], ascending, or None."""
        return np.sort(np.array(self.frequencies)) if self.frequencies else None


Table = TypeVar("Table", bound=ModesTable)
Vibration = TypeVar("Vibration", RingDown, FrequencyResponse)
Pose = Float[np.ndarray, " joint"]


def read_modes(
    name: str,
    kind: str,
    robot: StudiedRobotTable | None,
    entries: Sequence[Table] | None,
    build: Callable[[TableReader, Table, Pose | None], Vibration],
    context: Context,
) -> ModeStudy | None:
    """Study of the modes of measured vibrations, or None with problems noted.

    Args:
        name: The file that asks for it.
        kind: Name of the tables of the measurements.
        robot: `[robot]`.
        entries: These tables.
        build: Reads a measurement, in the pose of the robot if that is known.
        context: Folder and problems.
    """
    arm = None
    if robot is not None:
        arm = read_tool_robot(robot, context, [], needs_mass=True)
        if arm is None:
            return None
        if np.isinf(np.asarray(arm.joint_stiffness)).all():
            context.problems.append(
                "[robot]: found no joint stiffness, but dampers follow from modes only "
                "with it: by joint_stiffness, or a file named by drives"
            )
    measured = []
    for number, entry in enumerate(entries or (), 1):
        place = f"[[{kind}]] {number}"
        pose = _joint_positions(entry.joint_positions, arm, place, context.problems)
        one = context.read(
            entry, place, lambda reader, e=entry, q=pose: build(reader, e, q)
        )
        if one is not None:
            measured.append(one)
    if not measured or context.problems:
        return None
    return ModeStudy(name, arm, tuple(measured))


def _joint_positions(
    texts: list[str] | None, robot: Robot | None, place: str, problems: list[str]
) -> Float[np.ndarray, " joint"] | None:
    """Joint positions that the file gives; None if it gives none, or faulty ones."""
    if texts is None:
        return None
    if robot is None:
        problems.append(
            f"{place} joint_positions: found beside no [robot], but it is required then"
        )
        return None
    try:
        return np.asarray(parse_pose(", ".join(texts), robot), np.float64)
    except ValueError as error:
        problems.append(f"{place} joint_positions: {error}")
        return None
