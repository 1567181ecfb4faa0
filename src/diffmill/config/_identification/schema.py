"""Tables that several kinds of identification share: files and force records."""

from typing import Annotated, Literal

from pydantic import Field, StrictBool, StrictInt, StrictStr

from ...settings.fields import (
    Angle,
    Frequency,
    PositiveLength,
    PositiveTime,
    SpindleSpeed,
    Time,
)
from ...settings.tables import TomlTable
from .fields import AxesOrProposed, Channels, CutNumber, File, Side, Span


class MeasuredTable(TomlTable):
    """Keys of a table that names a file of measurements.

    They stand in `[[record]]`, `[means]`, `[load_tests]`, `[[ring_down]]`,
    `[[frequency_response]]`, `[coupled]` and `[poses]`.
    """

    file: File | None = Field(
        default=None,
        description='file of the measurements, such as "means.csv"; [means] may have '
        "lists instead",
    )
    channels: Channels | None = Field(
        default=None,
        description='columns by name or number, such as { time = "t", Fx = 3, Fz = '
        '"none" }; those left out are found by their names, and a list is the sum of '
        "several columns of a force",
    )
    units: dict[StrictStr, StrictStr] = Field(
        default_factory=dict,
        description='units that count before those of the file, such as { time = "ms", '
        'force = "kN" }',
    )


class CutTable(TomlTable):
    """`[cut]`: the straight cuts that were made."""

    axial_depth: PositiveLength = Field(
        description='axial depth of the cuts, such as "3 mm"'
    )
    radial_depth: PositiveLength | None = Field(
        default=None,
        description='radial depth of the cuts, such as "4 mm"; required for side = '
        '"up" and "down", none for a slot',
    )
    side: Side = Field(default="slot", description="a slot, or up or down milling")


class RecordTable(MeasuredTable):
    """An entry of `[[record]]`."""

    file: File = Field(description='file of measured forces, such as "cut1.csv"')
    rate: Frequency | None = Field(
        default=None,
        description='samples per time, such as "10 kHz"; required if neither a time '
        "column nor the header has it",
    )
    job: File | None = Field(
        default=None,
        description='job that was cut, such as "pocket.toml"; if left out, a straight '
        "cut as of [cut]",
    )
    feed_per_tooth: PositiveLength | None = Field(
        default=None,
        description='feed per tooth of a straight cut, such as "0.1 mm"; required '
        "without job",
    )
    axial_depth: PositiveLength | None = Field(
        default=None, description="axial depth of this cut; that of [cut] if left out"
    )
    radial_depth: PositiveLength | None = Field(
        default=None, description="radial depth of this cut; that of [cut] if left out"
    )
    side: Side | None = Field(
        default=None, description="slot, up or down milling; that of [cut] if left out"
    )
    speed: SpindleSpeed | None = Field(
        default=None, description="speed of the spindle; that of [spindle] if left out"
    )
    start: Time | None = Field(
        default=None,
        description='where the part to be fitted begins, such as "0.3 s"; if start and '
        "stop are left out, the cut is looked for",
    )
    stop: Time | None = Field(
        default=None, description='where the part to be fitted ends, such as "1.2 s"'
    )
    cut: CutNumber | None = Field(
        default=None,
        description="number of the cut in the record, from 1, or all; required if a "
        "record of straight cuts has several",
    )
    tare: Span | None = Field(
        default=None,
        description="section without a cut that shows the offset, such as "
        '["0 s", "0.2 s"], or none; looked for around the cut if left out',
    )
    tare_after: Span | None = Field(
        default=None,
        description="section behind the cut that, with tare, shows the drift too, such "
        'as ["1.3 s", "1.5 s"]; without it tare shows the offset alone',
    )
    time_shift: Time | None = Field(
        default=None,
        description='time of the job minus time of the record, such as "0.1 s"; found '
        "if left out",
    )
    pulses_per_turn: Annotated[StrictInt, Field(ge=1)] | None = Field(
        default=None,
        description="pulses of the channel tacho per revolution; 1 if left out",
    )
    tooth_angle: Angle | None = Field(
        default=None,
        description='immersion angle of the first tooth at a pulse, such as "12 deg"; '
        "found if left out",
    )


class FitTable(TomlTable):
    """`[fit]`: how forces are fitted."""

    axes: AxesOrProposed | None = Field(
        default=None,
        description="for x, y, z of the work the recorded axis, such as "
        '["-y", "x", "z"], or "proposed" for the likeliest; as recorded if left out',
    )
    force_on: Literal["workpiece", "tool"] | None = Field(
        default=None,
        description="on what the recorded forces act: a dynamometer below the part "
        "records those on the workpiece, which are reversed before axes are ranked; "
        "not known if left out, and the recorded axes may then be reversed",
    )
    loss: Literal["squares", "huber", "tukey"] = Field(
        default="huber", description="how errors count; tukey is for many gross errors"
    )
    refine: list[Literal["runout", "radius"]] = Field(
        default_factory=list,
        description="what is fitted besides the coefficients: the run-out and the "
        "radius of the cutter",
    )
    shift_range: PositiveTime | None = Field(
        default=None,
        description='largest time shift in either direction, such as "5 ms"; if '
        "left out a revolution, or less where tooth_angle is known",
    )
    lowpass: Frequency | None = Field(
        default=None,
        description="cut-off frequency of a low-pass for both measured and simulated "
        'forces, such as "2 kHz"; none if left out',
    )
    has_offset: StrictBool | None = Field(
        default=None,
        description="whether a constant force of every channel is fitted, too; if left "
        "out only of records without a tare",
    )
    has_drift: StrictBool | None = Field(
        default=None,
        description="whether a slope of every channel is fitted, too; if left out of "
        "records without tare_after, or a section found behind the cut",
    )
    refine_speed: StrictBool = Field(
        default=True,
        description="true: the speed in straight cuts is taken from the record",
    )
