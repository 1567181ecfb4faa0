"""The tables of a job file: which keys there are and what each may hold.

Every table is checked on its own, so that a fault in one does not hide those of the
others. Quantities become SI numbers here and nowhere else.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeAlias

import pydantic
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictInt,
    StrictStr,
)

from . import _quantity as q


def _read(kind: q.QuantityKind, *, sign: str = "any") -> Callable[[object], float]:
    """Return a converter of text to SI that also checks the sign."""

    def convert(value: object) -> float:
        number = q.quantity(value, kind)
        if sign == "positive" and number <= 0:
            raise ValueError(f"found {value!r}, but {kind.noun} above 0 is required")
        if sign == "not negative" and number < 0:
            raise ValueError(
                f"found {value!r}, but {kind.noun} of at least 0 is required"
            )
        return number

    return convert


def _read_drive(kinds: tuple[q.QuantityKind, ...]) -> Callable[[object], str]:
    """Return a check of text that is a quantity of one of some kinds."""

    def check(value: object) -> str:
        messages = []
        for kind in kinds:
            try:
                number = q.quantity(value, kind)
            except ValueError as error:
                messages.append(str(error))
                continue
            if number < 0:
                raise ValueError(f"found {value!r}, but at least 0 is required")
            return str(value)
        raise ValueError(messages[0])

    return check


Length: TypeAlias = Annotated[float, BeforeValidator(_read(q.LENGTH))]
PositiveLength: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.LENGTH, sign="positive"))
]
Tolerance: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.LENGTH, sign="not negative"))
]
Angle: TypeAlias = Annotated[float, BeforeValidator(_read(q.ANGLE))]
PositiveTime: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.TIME, sign="positive"))
]
PositiveSpeed: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.SPEED, sign="positive"))
]
SpindleSpeed: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ANGULAR_SPEED, sign="positive"))
]
Acceleration: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ACCELERATION, sign="positive"))
]
PositivePressure: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.PRESSURE, sign="positive"))
]
Pressure: TypeAlias = Annotated[float, BeforeValidator(_read(q.PRESSURE))]
EdgeForce: TypeAlias = Annotated[float, BeforeValidator(_read(q.EDGE_FORCE))]
Stiffness: TypeAlias = Annotated[
    str, BeforeValidator(_read_drive((q.ROTARY_STIFFNESS, q.LINEAR_STIFFNESS)))
]
Damping: TypeAlias = Annotated[
    str, BeforeValidator(_read_drive((q.ROTARY_DAMPING, q.LINEAR_DAMPING)))
]
Lengths3: TypeAlias = Annotated[list[Length], Field(min_length=3, max_length=3)]
Angles3: TypeAlias = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Slots: TypeAlias = Annotated[StrictInt, Field(ge=1, le=64)]


class _Table(pydantic.BaseModel):
    """A table that refuses keys which it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class CutterTable(_Table):
    """`[cutter]`."""

    kind: Literal["flat"] = Field(default="flat", description='"flat"')
    diameter: PositiveLength = Field(description='a length, such as "10 mm"')
    teeth: Annotated[StrictInt, Field(ge=1, le=100)] = Field(
        description="a whole number from 1 to 100"
    )
    helix_angle: Angle = 0.0
    flute_length: PositiveLength | None = None

    @pydantic.field_validator("helix_angle")
    @classmethod
    def _steep(cls, value: float) -> float:
        if abs(value) > 1.4:
            raise ValueError(
                f"found {value * 180 / 3.141592653589793:g} deg, but an angle from "
                "-80 deg to 80 deg is required"
            )
        return value


class SpindleTable(_Table):
    """`[spindle]`."""

    speed: SpindleSpeed | None = None


class ForceTable(_Table):
    """`[force]`."""

    K_tc: PositivePressure = Field(description='such as "989.8 N/mm^2"')
    K_rc: Pressure = Field(description='such as "337.3 N/mm^2"')
    K_ac: Pressure = Field(description='such as "66.9 N/mm^2"')
    K_te: EdgeForce = 0.0
    K_re: EdgeForce = 0.0
    K_ae: EdgeForce = 0.0


class StockTable(_Table):
    """`[stock]`."""

    lower: Lengths3 = Field(description='three lengths, such as ["0 mm", ...]')
    upper: Lengths3 = Field(description='three lengths, such as ["80 mm", ...]')
    spacing: PositiveLength = Field(description='a length, such as "0.2 mm"')
    intervals: Annotated[list[Slots], Field(min_length=3, max_length=3)] = Field(
        default_factory=lambda: [8, 8, 1]
    )


class ProgramTable(_Table):
    """`[program]`."""

    file: StrictStr = Field(
        min_length=1, description='a file (.ngc, .nc, .gcode, .csv), such as "part.ngc"'
    )
    feed: PositiveSpeed | None = None
    acceleration: Acceleration = 2.0
    rapid_feed: PositiveSpeed = 0.2
    corner_tolerance: Tolerance = 1e-4


class PoseTable(_Table):
    """A pose: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position: Lengths3 = Field(description='three lengths, such as ["1500 mm", ...]')
    rpy: Angles3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])


class RobotTable(_Table):
    """`[robot]`."""

    model: StrictStr | None = None
    file: StrictStr | None = None
    rigid: StrictBool = False
    joint_stiffness: list[Stiffness] | None = None
    joint_damping: list[Damping] | None = None
    work_in_base: PoseTable | None = None
    tool_in_flange: PoseTable | None = None
    joint_start: list[StrictStr] | None = None


class SimulationTable(_Table):
    """`[simulation]`."""

    angles: Annotated[StrictInt, Field(ge=180, le=100_000)] | None = None
    substeps: Annotated[StrictInt, Field(ge=1, le=1000)] | None = None
    element_height: PositiveLength | None = None
    axial_depth: PositiveLength | None = None
    precision: Literal["float64", "float32"] = "float64"
    gravity_compensated: StrictBool = True


class CorrectionTable(_Table):
    """`[correction]`."""

    objective: Literal["path"] = "path"
    method: Literal["gauss_newton", "mirror", "mirror_iterated", "inverse_drive"] = (
        "gauss_newton"
    )
    command: Literal["tip", "joint"] = "tip"
    knot_spacing: PositiveTime = 30e-3
    max_offset: PositiveLength = 1e-3
    max_steps: Annotated[StrictInt, Field(ge=1, le=1000)] = 2
    max_products: Annotated[StrictInt, Field(ge=1, le=10_000)] = 30


TABLES: dict[str, type[_Table]] = {
    "cutter": CutterTable,
    "spindle": SpindleTable,
    "force": ForceTable,
    "stock": StockTable,
    "program": ProgramTable,
    "robot": RobotTable,
    "simulation": SimulationTable,
    "correction": CorrectionTable,
}
OPTIONAL_TABLES = frozenset({"spindle", "simulation", "correction"})


def read_tables(raw: dict[str, Any], problems: list[str]) -> dict[str, Any]:
    """Check all tables of a job.

    Args:
        raw: The parsed TOML.
        problems: Receives a line for everything that is wrong.

    Returns:
        The tables without a fault, by name; optional ones that are absent hold
        their defaults.
    """
    tables = {}
    allowed = ", ".join(f"[{name}]" for name in TABLES)
    for name in raw:
        if name not in TABLES:
            problems.append(
                f"{name}: found an unknown table or key; allowed: {allowed}"
            )
    for name, table in TABLES.items():
        if name not in raw and name not in OPTIONAL_TABLES:
            hint = " (rigid = true stands for no robot)" if name == "robot" else ""
            problems.append(f"[{name}]: found no such table, but it is required{hint}")
            continue
        try:
            tables[name] = table.model_validate(raw.get(name, {}))
        except pydantic.ValidationError as error:
            problems.extend(
                f"[{name}] {_describe(table, dict(fault))}"
                for fault in error.errors(include_url=False)
            )
    return tables


def _describe(table: type[_Table], fault: dict[str, Any]) -> str:
    """Return one fault: key, what was found, what is allowed."""
    # A choice of types adds their names to the place of the fault.
    keys = [str(part) for part in fault["loc"] if "[" not in str(part)]
    key = ".".join(keys)
    owner = _owner(table, keys)
    kind, found, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "missing":
        wanted = owner.model_fields[keys[-1]].description
        return f"{key}: found nothing, but it is required: {wanted}"
    if kind == "extra_forbidden":
        allowed = ", ".join(owner.model_fields)
        return f"{key}: found an unknown key; allowed: {allowed}"
    if kind == "value_error":
        return f"{key}: {context['error']}"
    if kind == "literal_error":
        return f"{key}: found {found!r}; allowed: {context['expected']}"
    wanted = {
        "int_type": "a whole number is required",
        "bool_type": "true or false is required",
        "string_type": "text is required",
        "list_type": "a list is required",
        "model_type": "a table is required",
        "greater_than_equal": f"at least {context.get('ge')} is required",
        "less_than_equal": f"at most {context.get('le')} is allowed",
        "too_short": f"{context.get('min_length')} values are required",
        "too_long": f"only {context.get('max_length')} values are allowed",
        "string_too_short": "a name is required",
    }.get(kind, fault["msg"])
    place = f"{key}: " if key else ""
    return f"{place}found {found!r}, but {wanted}"


def _owner(table: type[_Table], keys: list[str]) -> type[_Table]:
    """Return the table, or table within it, that holds the last key."""
    nested = {"work_in_base", "tool_in_flange"} & set(keys[:-1])
    return PoseTable if nested else table
