"""The tables of a file for `diffmill identify`: which keys there are, what they hold.

`kind` says what was measured; it decides which tables there are. Every table is
checked on its own, so that a fault in one does not hide those of the others.
"""

from typing import Annotated, Any, Literal

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


class MeasuredTable(TomlTable):
    """Keys of a table that names a file of measurements."""

    file: File | None = None
    channels: Channels | None = None
    units: dict[StrictStr, StrictStr] = Field(default_factory=dict)


class CutTable(TomlTable):
    """`[cut]`: the straight cuts that were made."""

    axial_depth: PositiveLength = Field(description='a length, such as "3 mm"')
    radial_depth: PositiveLength | None = None
    side: Side = "slot"


class RecordTable(MeasuredTable):
    """An entry of `[[record]]`."""

    file: File = Field(description='a file of measured forces, such as "cut1.csv"')
    rate: Frequency | None = None
    job: File | None = None
    feed_per_tooth: PositiveLength | None = None
    axial_depth: PositiveLength | None = None
    radial_depth: PositiveLength | None = None
    side: Side | None = None
    speed: SpindleSpeed | None = None
    start: Time | None = None
    stop: Time | None = None
    cut: CutNumber | None = None
    tare: Span | None = None
    tare_after: Span | None = None
    time_shift: Time | None = None
    pulses_per_turn: Annotated[StrictInt, Field(ge=1)] | None = None
    tooth_angle: Angle | None = None


class FitTable(TomlTable):
    """`[fit]`: how forces are fitted."""

    axes: AxesOrProposed | None = None
    loss: Literal["squares", "huber", "tukey"] = "huber"
    refine: list[Literal["runout", "radius"]] = Field(default_factory=list)
    shift_range: PositiveTime | None = None
    lowpass: Frequency | None = None
    refine_speed: StrictBool = True


class MeansTable(MeasuredTable):
    """`[means]`: mean forces over the feed, in the file or in another one."""

    feed_per_tooth: list[PositiveLength] | None = None
    Fx: list[Force] | None = None
    Fy: list[Force] | None = None
    Fz: list[Force] | None = None


class StudiedRobotTable(TomlTable):
    """`[robot]` of a measurement: no place of a workpiece."""

    model: StrictStr | None = None
    file: StrictStr | None = None
    tool: StrictStr | None = None
    drives: File | None = None
    joint_stiffness: list[Stiffness] | None = None
    joint_damping: list[Damping] | None = None
    tool_in_flange: PoseTable | None = None


class LoadTestsTable(MeasuredTable):
    """`[load_tests]`."""

    file: File = Field(description='a table with one pose per row, such as "loads.csv"')
    load_axes: Axes | None = None
    displacement_axes: Axes | None = None
    load_frame: Literal["base", "tool"] = "base"
    displacement_frame: Literal["base", "tool"] = "base"
    has_offset: StrictBool = False
    noise: Literal["absolute", "relative"] | None = None
    skip_rows: list[Annotated[StrictInt, Field(ge=1)]] = Field(default_factory=list)


class RingDownTable(MeasuredTable):
    """An entry of `[[ring_down]]`."""

    file: File = Field(description='a file of a free vibration, such as "hit1.csv"')
    rate: Frequency | None = None
    start: Time | None = None
    stop: Time | None = None
    modes: Annotated[StrictInt, Field(ge=1, le=20)] | None = None
    frequencies: list[Frequency] | None = None
    joint_positions: list[StrictStr] | None = None


class FrequencyResponseTable(MeasuredTable):
    """An entry of `[[frequency_response]]`."""

    file: File = Field(description='a file of a frequency response, such as "frf.csv"')
    quantity: Literal["receptance", "mobility", "accelerance"] = "receptance"
    lowest: Frequency | None = None
    highest: Frequency | None = None
    modes: Annotated[StrictInt, Field(ge=1, le=20)] | None = None
    frequencies: list[Frequency] | None = None
    joint_positions: list[StrictStr] | None = None
    direction: Direction | None = None


class CoupledTable(MeasuredTable):
    """`[coupled]`."""

    job: File = Field(description='the job that was run, such as "part.toml"')
    file: File = Field(description='forces or deviations over time, such as "run.csv"')
    fit: list[StrictStr] | None = None
    has_offset: StrictBool = False
    has_time_shift: StrictBool = False
    time_shift: Time | None = None
    loss: Literal["squares", "huber"] = "huber"


class AirPathTable(TomlTable):
    """`[air_path]`."""

    commanded: File = Field(description='a path as CSV, such as "commanded.csv"')
    actual: File = Field(description='a path as CSV on its clock, such as "actual.csv"')
    order: Literal["first", "second"] = "second"


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
_TABLES: dict[str, type[TomlTable]] = {
    "cutter": CutterTable,
    "spindle": SpindleTable,
    "cut": CutTable,
    "record": RecordTable,
    "fit": FitTable,
    "means": MeansTable,
    "robot": StudiedRobotTable,
    "load_tests": LoadTestsTable,
    "ring_down": RingDownTable,
    "frequency_response": FrequencyResponseTable,
    "coupled": CoupledTable,
    "air_path": AirPathTable,
}


def read_identification_tables(
    raw: dict[str, Any], problems: list[str]
) -> tuple[str | None, dict[str, Any]]:
    """Check all tables of a file for `diffmill identify`.

    Args:
        raw: The parsed TOML.
        problems: Receives a line for everything that is wrong.

    Returns:
        The kind, None if unknown; and the tables without a fault by name, lists of
        tables as lists.
    """
    kind = raw.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        found = "nothing" if kind is None else repr(kind)
        allowed = ", ".join(f'"{name}"' for name in KINDS)
        problems.append(
            f"kind: found {found}, but one of {allowed} is required: what was measured"
        )
        return None, {}
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
    tables: dict[str, Any] = {}
    for name in names:
        if name not in raw:
            if name in (one.rstrip("*") for one in required):
                problems.append(
                    f"{_shown(name, lists)}: found no such table, but it is required"
                )
            elif name == "fit":
                tables[name] = FitTable()
            continue
        if name not in lists:
            table = validated(_TABLES[name], raw[name], f"[{name}]", problems)
            if table is not None:
                tables[name] = table
            continue
        found = _entries(name, raw[name], problems)
        if found is not None:
            tables[name] = found
    return kind, tables


def _entries(name: str, raw: object, problems: list[str]) -> list[TomlTable] | None:
    """Return the entries of a list of tables, None if one has a fault."""
    if not isinstance(raw, list) or not raw:
        problems.append(
            f"[[{name}]]: found {raw!r}, but a list of tables is required, each headed "
            f"[[{name}]]"
        )
        return None
    entries = [
        validated(_TABLES[name], one, f"[[{name}]] {place}", problems)
        for place, one in enumerate(raw, 1)
    ]
    good = [one for one in entries if one is not None]
    return good if len(good) == len(entries) else None


def _shown(name: str, lists: set[str]) -> str:
    return f"[[{name}]]" if name in lists else f"[{name}]"
