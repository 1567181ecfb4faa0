"""Geometric errors of a robot: `[robot.calibration]`."""

from pydantic import Field, StrictStr

from ...settings.fields import Angles3, Angles4, Lengths3, PositiveAngle
from ...settings.tables import TomlTable


class CalibrationTable(TomlTable):
    """`[robot.calibration]`: the geometric errors of this robot.

    They are what `identify` finds from measured poses; the arm stands where they say.
    """

    displacement: list[Lengths3] | None = Field(
        default=None,
        description="of every joint the displacement of its frame, whose z is the "
        'joint\'s axis, in that frame, such as [["0.12 mm", "0 mm", "-0.05 mm"], ...]; '
        "none if left out",
    )
    rotation: list[Angles3] | None = Field(
        default=None,
        description="of every joint the rotation vector of its frame, in that frame, "
        'such as [["0.3 mrad", "-0.1 mrad", "0 mrad"], ...]; none if left out',
    )
    joint_offsets: list[StrictStr] | None = Field(
        default=None,
        description="what is added to the position of every joint, such as "
        '["0.2 mrad", ...]; nothing if left out',
    )
    waves: list[Angles4] | None = Field(
        default=None,
        description="of every joint the amplitudes of sin and cos of its angle, over "
        "the period, and of twice that, by which the gear turns unevenly, such as "
        '[["0.1 mrad", "0 mrad", "0 mrad", "0 mrad"], ...]; none if left out',
    )
    wave_period: PositiveAngle | None = Field(
        default=None,
        description="turn of a joint in which its waves repeat; 360 deg if left out",
    )
    tool: Lengths3 | None = Field(
        default=None,
        description="displacement of the tool in its own axes; none if left out",
    )
