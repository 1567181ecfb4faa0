"""The tables of a file for `diffmill identify`: which keys there are, what they hold.

`kind` says what was measured; it decides which tables there are. Every table is
checked on its own, so that a fault in one does not hide those of the others.
"""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import Field, StrictBool, StrictInt, StrictStr

from .._schema.cutter import CutterTable
from .._schema.fields import (
    Angle,
    Damping,
    Force,
    Frequency,
    PositiveLength,
    PositiveTime,
    SpindleSpeed,
    Stiffness,
    Time,
)
from .._schema.job import PoseTable, SpindleTable
from .._schema.machine import Direction
from .._schema.table import TomlTable, validated
from .fields import Axes, AxesOrProposed, Channels, CutNumber, File, Side, Span

_Toml = TypeVar("_Toml", bound=TomlTable)


class MeasuredTable(TomlTable):
    """Keys of a table that names a file of measurements.

    They stand in `[[record]]`, `[means]`, `[load_tests]`, `[[ring_down]]`,
    `[[frequency_response]]` and `[coupled]`.
    """

    file: File | None = Field(
        default=None,
        description='file of the measurements, such as "means.csv"; [means] may hold '
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
        "records those on the workpiece, which are reversed before axes are looked at; "
        "not told if left out, and the recorded axes may then be reversed",
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
        description='how far a time shift is looked for either way, such as "5 ms"; if '
        "left out a revolution, or less where tooth_angle is known",
    )
    lowpass: Frequency | None = Field(
        default=None,
        description="cut-off frequency of a low-pass for both measured and simulated "
        'forces, such as "2 kHz"; none if left out',
    )
    refine_speed: StrictBool = Field(
        default=True,
        description="true: the speed in straight cuts is taken from the record",
    )


class MeansTable(MeasuredTable):
    """`[means]`: mean forces over the feed, in the file or in another one."""

    feed_per_tooth: list[PositiveLength] | None = Field(
        default=None,
        description='feeds per tooth, such as ["0.05 mm", ...]; with Fx, Fy and Fz '
        "required without file",
    )
    Fx: list[Force] | None = Field(
        default=None,
        description='mean forces along x at the feeds, such as ["107 N", ...]',
    )
    Fy: list[Force] | None = Field(
        default=None,
        description='mean forces along y at the feeds, such as ["107 N", ...]',
    )
    Fz: list[Force] | None = Field(
        default=None,
        description='mean forces along z at the feeds, such as ["107 N", ...]',
    )


class StudiedRobotTable(TomlTable):
    """`[robot]` of a measurement: no place of a workpiece."""

    model: StrictStr | None = Field(
        default=None,
        description='name of a built-in robot, such as "kuka_kr210_like"; required '
        "without file",
    )
    file: StrictStr | None = Field(
        default=None,
        description='file of a robot of your own, such as "arm.toml" or "arm.urdf", '
        "instead of model",
    )
    tool: StrictStr | None = Field(
        default=None,
        description='link of a URDF that is the flange, such as "tool0"; required if '
        "several could be",
    )
    drives: File | None = Field(
        default=None,
        description="file with what the robot lacks (springs, drives, spindle), such "
        'as "drives.toml"; nothing is added if left out',
    )
    joint_stiffness: list[Stiffness] | None = Field(
        default=None,
        description='stiffness of every joint, such as ["3.5 MN*m/rad", ...]; that of '
        "the robot and drives if left out",
    )
    joint_damping: list[Damping] | None = Field(
        default=None,
        description='damping of every joint, such as ["1825 N*m*s/rad", ...]; that of '
        "the robot and drives if left out",
    )
    tool_in_flange: PoseTable | None = Field(
        default=None,
        description="pose of the tool, where it is loaded and measured, in the flange; "
        "that of the robot if left out",
    )


class LoadTestsTable(MeasuredTable):
    """`[load_tests]`."""

    file: File = Field(description='table with one pose per row, such as "loads.csv"')
    load_axes: Axes | None = Field(
        default=None,
        description="for x, y, z of load_frame the recorded axis, such as "
        '["-y", "x", "z"]; as recorded if left out',
    )
    displacement_axes: Axes | None = Field(
        default=None,
        description="for x, y, z of displacement_frame the recorded axis, such as "
        '["-y", "x", "z"]; as recorded if left out',
    )
    load_frame: Literal["base", "tool"] = Field(
        default="base", description="frame in which the load was recorded"
    )
    displacement_frame: Literal["base", "tool"] = Field(
        default="base", description="frame in which the displacement was recorded"
    )
    has_offset: StrictBool = Field(
        default=False,
        description="true: a constant displacement is fitted too, as of a tracker",
    )
    noise: Literal["absolute", "relative"] | None = Field(
        default=None,
        description="scatter of the poses: alike, or in proportion to the "
        "displacement; the likelier if left out",
    )
    skip_rows: list[Annotated[StrictInt, Field(ge=1)]] = Field(
        default_factory=list,
        description="numbers of rows that are left out, such as [7]",
    )


class RingDownTable(MeasuredTable):
    """An entry of `[[ring_down]]`."""

    file: File = Field(description='file of a free vibration, such as "hit1.csv"')
    rate: Frequency | None = Field(
        default=None,
        description='samples per time, such as "10 kHz"; required if neither a time '
        "column nor the header has it",
    )
    start: Time | None = Field(
        default=None,
        description='where the vibration begins, such as "0.1 s"; at its largest value '
        "if left out",
    )
    stop: Time | None = Field(
        default=None,
        description='where the vibration ends, such as "1.5 s"; with the file if left '
        "out",
    )
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


class FrequencyResponseTable(MeasuredTable):
    """An entry of `[[frequency_response]]`."""

    file: File = Field(description='file of a frequency response, such as "frf.csv"')
    quantity: Literal["receptance", "mobility", "accelerance"] = Field(
        default="receptance",
        description="what was measured per force: a displacement, a velocity or an "
        "acceleration",
    )
    lowest: Frequency | None = Field(
        default=None,
        description='lower end of the band that is fitted, such as "5 Hz"; that of the '
        "file if left out",
    )
    highest: Frequency | None = Field(
        default=None,
        description='upper end of the band that is fitted, such as "100 Hz"; that of '
        "the file if left out",
    )
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
    direction: Direction | None = Field(
        default=None,
        description="direction of hammer and sensor at the tool tip, such as "
        "[1, 0, 0], to write [[machine.modes]]; not written if left out",
    )


class CoupledTable(MeasuredTable):
    """`[coupled]`."""

    job: File = Field(description='job that was run, such as "part.toml"')
    file: File = Field(description='forces or deviations over time, such as "run.csv"')
    fit: list[StrictStr] | None = Field(
        default=None,
        description='parameters that are fitted, such as ["K", "D"], "K axis_1" or '
        '"K_tc"; if left out stiffness and damping of all joints, and with forces the '
        "coefficients",
    )
    has_offset: StrictBool = Field(
        default=False,
        description="true: a constant deviation is fitted too, as of a tracker",
    )
    has_time_shift: StrictBool = Field(
        default=False, description="true: a small shift of the clock is fitted too"
    )
    time_shift: Time | None = Field(
        default=None,
        description='known time of the job minus time of the record, such as "1.2 s"; '
        "0 if left out",
    )
    loss: Literal["squares", "huber"] = Field(
        default="huber",
        description="how errors count; huber is for records with gross errors",
    )


class AirPathTable(TomlTable):
    """`[air_path]`."""

    commanded: File = Field(
        description='commanded path as CSV, such as "commanded.csv"'
    )
    actual: File = Field(
        description="recorded path as CSV on the clock of the commanded one, such as "
        '"actual.csv"'
    )
    order: Literal["first", "second"] = Field(
        default="second",
        description="order of the servos; first for those with following error",
    )


# Tables of each kind: those required, and those allowed besides. A star marks lists.
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "mean_forces": (("cutter", "cut"), ("means", "record*", "spindle", "fit")),
    "force_records": (("record*",), ("cutter", "spindle", "cut", "fit")),
    "load_tests": (("robot", "load_tests"), ()),
    "ring_down": (("ring_down*",), ("robot",)),
    "frequency_response": (("frequency_response*",), ("robot",)),
    "coupled": (("coupled",), ()),
    "controller": (("air_path",), ()),
}


@dataclasses.dataclass(frozen=True)
class IdentificationTables:
    """The checked tables of a file for `diffmill identify`.

    None stands for a table with a fault, and for one that the file has not.

    Attributes:
        kind: What was measured; None if unknown.
        cutter: `[cutter]`.
        spindle: `[spindle]`.
        cut: `[cut]`.
        record: All `[[record]]`.
        fit: `[fit]`.
        means: `[means]`.
        robot: `[robot]`.
        load_tests: `[load_tests]`.
        ring_down: All `[[ring_down]]`.
        frequency_response: All `[[frequency_response]]`.
        coupled: `[coupled]`.
        air_path: `[air_path]`.
    """

    kind: str | None = None
    cutter: CutterTable | None = None
    spindle: SpindleTable | None = None
    cut: CutTable | None = None
    record: list[RecordTable] | None = None
    fit: FitTable | None = None
    means: MeansTable | None = None
    robot: StudiedRobotTable | None = None
    load_tests: LoadTestsTable | None = None
    ring_down: list[RingDownTable] | None = None
    frequency_response: list[FrequencyResponseTable] | None = None
    coupled: CoupledTable | None = None
    air_path: AirPathTable | None = None


def read_identification_tables(
    raw: Mapping[str, object], problems: list[str]
) -> IdentificationTables:
    """Check all tables of a file for `diffmill identify`.

    Args:
        raw: The parsed TOML.
        problems: Receives a line for everything that is wrong.
    """
    kind = raw.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        found = "nothing" if kind is None else repr(kind)
        allowed = ", ".join(f'"{name}"' for name in KINDS)
        problems.append(
            f"kind: found {found}, but one of {allowed} is required: what was measured"
        )
        return IdentificationTables()
    required, optional = KINDS[kind]
    names = [name.rstrip("*") for name in (*required, *optional)]
    lists = {name.rstrip("*") for name in (*required, *optional) if "*" in name}
    for name in raw:
        if name != "kind" and name not in names:
            allowed = ", ".join(_shown(name, lists) for name in names)
            problems.append(
                f"{name}: found an unknown table or key; allowed for "
                f'kind = "{kind}": {allowed}'
            )
    for name in (one.rstrip("*") for one in required):
        if name not in raw:
            problems.append(
                f"{_shown(name, lists)}: found no such table, but it is required"
            )
    given = {name: raw[name] for name in names if name in raw}

    def table(name: str, cls: type[_Toml]) -> _Toml | None:
        if name not in given:
            return None
        return validated(cls, given[name], f"[{name}]", problems)

    def entries(name: str, cls: type[_Toml]) -> list[_Toml] | None:
        return _entries(name, cls, given[name], problems) if name in given else None

    return IdentificationTables(
        kind=kind,
        cutter=table("cutter", CutterTable),
        spindle=table("spindle", SpindleTable),
        cut=table("cut", CutTable),
        record=entries("record", RecordTable),
        fit=table("fit", FitTable),
        means=table("means", MeansTable),
        robot=table("robot", StudiedRobotTable),
        load_tests=table("load_tests", LoadTestsTable),
        ring_down=entries("ring_down", RingDownTable),
        frequency_response=entries("frequency_response", FrequencyResponseTable),
        coupled=table("coupled", CoupledTable),
        air_path=table("air_path", AirPathTable),
    )


def _entries(
    name: str, kind: type[_Toml], raw: object, problems: list[str]
) -> list[_Toml] | None:
    """Return the entries of a list of tables, None if one has a fault."""
    if not isinstance(raw, list) or not raw:
        problems.append(
            f"[[{name}]]: found {raw!r}, but a list of tables is required, each headed "
            f"[[{name}]]"
        )
        return None
    entries = [
        validated(kind, one, f"[[{name}]] {place}", problems)
        for place, one in enumerate(raw, 1)
    ]
    good = [one for one in entries if one is not None]
    return good if len(good) == len(entries) else None


def _shown(name: str, lists: set[str]) -> str:
    return f"[[{name}]]" if name in lists else f"[{name}]"
