"""The table `[cutter]` of a job file, and the end mill that it describes."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pydantic
from pydantic import Field, StrictInt

from ...settings.fields import Angle, PositiveLength, Tolerance
from ...settings.tables import TomlTable

if TYPE_CHECKING:
    from ...cutter import EndMill, ToolHolder

# Diameter of the largest cutters, as `EndMill` takes them [m].
_LARGEST = 1.0
# Steepest helix [rad], and how far angles between teeth may miss a whole turn [deg].
_STEEPEST = 1.4
# The most by which an end is ground hollow [rad].
_HOLLOWEST = math.radians(20)
_TURN = 1e-3


class HolderPartTable(TomlTable):
    """A part of `[cutter] holder`: a cylinder, or a cone to another diameter."""

    diameter: PositiveLength = Field(
        description='diameter at the lower end of the part, such as "32 mm"'
    )
    upper_diameter: PositiveLength | None = Field(
        default=None,
        description="diameter at the upper end of a cone; as at the lower end if left "
        "out",
    )
    length: PositiveLength = Field(
        description='length of the part along the tool axis, such as "40 mm"'
    )


class CutterTable(TomlTable):
    """`[cutter]`."""

    kind: Literal["flat", "ball", "bull"] = Field(
        default="flat", description="shape of the end; bull has a corner radius"
    )
    diameter: PositiveLength = Field(
        description='diameter of the cutter, such as "10 mm", 1 m at most'
    )
    corner_radius: PositiveLength | None = Field(
        default=None,
        validate_default=True,
        description='radius between side and end, such as "1 mm"; required for kind = '
        '"bull", which alone has one',
    )
    teeth: Annotated[StrictInt, Field(ge=1, le=100)] = Field(
        description="number of teeth, a whole number from 1 to 100"
    )
    helix_angle: Angle = Field(
        default=0.0,
        description="angle of the helix, at most 80 deg; above 0 for a right-hand "
        "helix",
    )
    flute_length: PositiveLength | None = Field(
        default=None,
        description='length of the flutes above the tip, such as "22 mm"; if left out '
        "three diameters, but at most overhang",
    )
    pitch: list[Angle] | None = Field(
        default=None,
        description="angles from each tooth to the next, such as "
        '["170 deg", "190 deg"]; equal if left out',
    )
    runout: Tolerance = Field(
        default=0.0,
        description='offset of the cutter from the axis of rotation, such as "5 um"',
    )
    runout_angle: Angle = Field(
        default=0.0, description="direction of the run-out, from the first tooth"
    )
    dish_angle: Angle = Field(
        default=0.0,
        description='angle by which a flat end is ground hollow, such as "2 deg"; at '
        "most 20 deg",
    )
    overhang: PositiveLength | None = Field(
        default=None,
        description='length from the tip to the holder, such as "45 mm"; given '
        "together with holder",
    )
    holder: Annotated[list[HolderPartTable], Field(min_length=1)] | None = Field(
        default=None,
        validate_default=True,
        description="cylinders and cones from the lower face of the holder up, whose "
        "contact with the stock is reported; given together with overhang",
    )

    @pydantic.field_validator("diameter")
    @classmethod
    def _not_in_metres(cls, value: float) -> float:
        if value > _LARGEST:
            raise ValueError(
                f"found {value:g} m, but {_LARGEST:g} m at most is allowed"
            )
        return value

    @pydantic.field_validator("corner_radius")
    @classmethod
    def _fitting(cls, value: float | None, info: Any) -> float | None:
        kind, diameter = info.data.get("kind"), info.data.get("diameter")
        if value is None:
            if kind == "bull":
                raise ValueError(
                    'found nothing, but a cutter of kind "bull" requires it: a length, '
                    'such as "1 mm"'
                )
            return None
        if kind in ("flat", "ball"):
            raise ValueError(
                f"found {value * 1e3:g} mm, but a cutter of kind {kind!r} has none to "
                'choose; kind = "bull" has'
            )
        if diameter is not None and value >= diameter / 2:
            raise ValueError(
                f"found {value * 1e3:g} mm, but less than half the diameter, "
                f'{diameter * 5e2:g} mm, is required; kind = "ball" is a full round'
            )
        return value

    @pydantic.field_validator("helix_angle")
    @classmethod
    def _steep(cls, value: float) -> float:
        if abs(value) > _STEEPEST:
            raise ValueError(
                f"found {math.degrees(value):g} deg, but an angle from "
                "-80 deg to 80 deg is required"
            )
        return value

    @pydantic.field_validator("pitch")
    @classmethod
    def _whole(cls, value: list[float] | None, info: Any) -> list[float] | None:
        if value is None:
            return None
        teeth = info.data.get("teeth")
        if teeth is not None and len(value) != teeth:
            raise ValueError(
                f"found {len(value)} angles, but {teeth} are required: from each tooth "
                "to the next, the last one back to the first"
            )
        if min(value, default=0) <= 0:
            raise ValueError(
                f"found {math.degrees(min(value, default=0)):g} deg, but angles above "
                "0 are required"
            )
        total = math.degrees(sum(value))
        if abs(total - 360) > _TURN:
            raise ValueError(
                f"found angles that sum to {total:.7g} deg, but 360 deg is required"
            )
        # Rounded text must not turn the last tooth away from the first.
        return [angle * 360 / total for angle in value]

    @pydantic.field_validator("runout")
    @classmethod
    def _small(cls, value: float, info: Any) -> float:
        diameter = info.data.get("diameter")
        if diameter is not None and value >= diameter / 2:
            raise ValueError(
                f"found {value * 1e3:g} mm, but less than half the diameter, "
                f"{diameter * 5e2:g} mm, is required"
            )
        return value

    @pydantic.field_validator("dish_angle")
    @classmethod
    def _hollow(cls, value: float, info: Any) -> float:
        kind = info.data.get("kind", "flat")
        if kind != "flat" and value != 0:
            raise ValueError(
                f"found {math.degrees(value):g} deg, but the end of a cutter of kind "
                f'{kind!r} is not hollow; kind = "flat" is'
            )
        if not 0 <= value <= _HOLLOWEST:
            raise ValueError(
                f"found {math.degrees(value):g} deg, but an angle from 0 deg to 20 deg "
                "is required"
            )
        return value

    @pydantic.field_validator("overhang")
    @classmethod
    def _above_flutes(cls, value: float | None, info: Any) -> float | None:
        flutes = info.data.get("flute_length")
        if value is not None and flutes is not None and value < flutes:
            raise ValueError(
                f"found {value * 1e3:g} mm, but at least the flute length, "
                f"{flutes * 1e3:g} mm, is required: from the tip to the holder"
            )
        return value

    @pydantic.field_validator("holder")
    @classmethod
    def _somewhere(
        cls, value: list[HolderPartTable] | None, info: Any
    ) -> list[HolderPartTable] | None:
        # A faulty overhang is not in the data, and has been reported.
        is_known = "overhang" in info.data
        if is_known and (value is None) != (info.data["overhang"] is None):
            raise ValueError(
                "found overhang without holder, or holder without overhang; both are "
                "required to know where the holder is, or none"
            )
        return value


def make_holder(table: CutterTable) -> "ToolHolder | None":
    """Tool holder of a checked table, if it has one."""
    from ...cutter import ToolHolder

    if table.holder is None or table.overhang is None:
        return None
    return ToolHolder.from_sizes(
        table.overhang,
        [part.diameter for part in table.holder],
        [part.length for part in table.holder],
        upper_diameters=[p.upper_diameter or p.diameter for p in table.holder],
    )


def make_cutter(table: CutterTable) -> "EndMill":
    """End mill of a checked table."""
    from ...cutter import ball_end_mill, bull_nose, flat_end_mill

    flute_length = table.flute_length
    if flute_length is None and table.overhang is not None:
        # The flutes that are assumed must not reach into the holder.
        flute_length = min(3 * table.diameter, table.overhang)
    options = {
        "helix_angle": table.helix_angle,
        "flute_length": flute_length,
        "pitch": table.pitch,
        "runout": table.runout,
        "runout_angle": table.runout_angle,
    }
    if table.corner_radius is not None:
        return bull_nose(table.diameter, table.teeth, table.corner_radius, **options)
    if table.kind == "ball":
        return ball_end_mill(table.diameter, table.teeth, **options)
    dish = table.dish_angle
    return flat_end_mill(table.diameter, table.teeth, dish_angle=dish, **options)
