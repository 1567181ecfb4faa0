"""Types of values in a job file: text with a unit becomes an SI number here."""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, TypeAlias

from pydantic import BeforeValidator, Field, StrictInt

from .. import units as q


def _read(kind: q.QuantityKind, *, sign: str = "any") -> Callable[[object], float]:
    """Converter of text to SI that also checks the sign."""

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
    """Check of text that is a quantity of one of some kinds."""

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
TurnTolerance: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ANGLE, sign="not negative"))
]
PositiveAngle: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ANGLE, sign="positive"))
]
PositiveTime: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.TIME, sign="positive"))
]
Delay: TypeAlias = Annotated[float, BeforeValidator(_read(q.TIME, sign="not negative"))]
Time: TypeAlias = Annotated[float, BeforeValidator(_read(q.TIME))]
Frequency: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.FREQUENCY, sign="positive"))
]
Force: TypeAlias = Annotated[float, BeforeValidator(_read(q.FORCE))]
PositiveSpeed: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.SPEED, sign="positive"))
]
SpindleSpeed: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ANGULAR_SPEED, sign="positive"))
]
Acceleration: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ACCELERATION, sign="positive"))
]
Jerk: TypeAlias = Annotated[float, BeforeValidator(_read(q.JERK, sign="positive"))]
Stiffness: TypeAlias = Annotated[
    str, BeforeValidator(_read_drive((q.ROTARY_STIFFNESS, q.LINEAR_STIFFNESS)))
]
Damping: TypeAlias = Annotated[
    str, BeforeValidator(_read_drive((q.ROTARY_DAMPING, q.LINEAR_DAMPING)))
]
LinearStiffness: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.LINEAR_STIFFNESS, sign="positive"))
]
RotaryStiffness: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.ROTARY_STIFFNESS, sign="positive"))
]
Mass: TypeAlias = Annotated[float, BeforeValidator(_read(q.MASS, sign="positive"))]
Inertia: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.INERTIA, sign="positive"))
]
Modulus: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.MODULUS, sign="positive"))
]
Density: TypeAlias = Annotated[
    float, BeforeValidator(_read(q.DENSITY, sign="positive"))
]
# Share of their extent by which points must lie beside a line.
_LEAST_WIDTH = 1e-3


def fix_a_frame(points: Sequence[Sequence[float]]) -> bool:
    """True for points of which three are not on a line.

    Args:
        points: The points, each of three coordinates.
    """
    first = points[0]
    arms = [[x - y for x, y in zip(p, first, strict=True)] for p in points]
    longest = max(arms, key=lambda arm: math.hypot(*arm))
    length = math.hypot(*longest)
    x, y, z = longest

    def width(arm: Sequence[float]) -> float:
        a, b, c = arm
        across = (b * z - c * y, c * x - a * z, a * y - b * x)
        return math.hypot(*across)

    return max(map(width, arms)) > _LEAST_WIDTH * length**2


Lengths3: TypeAlias = Annotated[list[Length], Field(min_length=3, max_length=3)]
Angles3: TypeAlias = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Angles4: TypeAlias = Annotated[list[Angle], Field(min_length=4, max_length=4)]
# As many as a run that finds its own number goes up to.
Slots: TypeAlias = Annotated[StrictInt, Field(ge=1, le=128)]


def _read_each(
    convert: Callable[[object], float], owner: str = "tooth"
) -> Callable[[object], float | list[float]]:
    """Converter of one value, or of a list with one value per tooth."""

    def convert_all(value: object) -> float | list[float]:
        if not isinstance(value, list):
            return convert(value)
        if not value:
            raise ValueError(
                f"found an empty list, but one value per {owner} is required"
            )
        return [convert(entry) for entry in value]

    return convert_all


def _read_share(least: bool) -> Callable[[object], float]:
    """Check of a plain number up to 1, from 0 or above it."""

    def check(value: object) -> float:
        if isinstance(value, int | float) and not isinstance(value, bool):
            if 0 <= value <= 1 and (value > 0 or least):
                return float(value)
        low = "from 0" if least else "above 0"
        raise ValueError(f"found {value!r}, but a number {low} to 1 is required")

    return check


Ratio: TypeAlias = Annotated[float, BeforeValidator(_read_share(True))]
Share: TypeAlias = Annotated[float, BeforeValidator(_read_share(False))]


def _read_below_one(value: object) -> float:
    """Plain number from 0 to below 1."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if 0 <= value < 1:
            return float(value)
    raise ValueError(f"found {value!r}, but a number from 0 to less than 1 is required")


def _read_positive(value: object) -> float:
    """Plain finite number above 0."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if 0 < value < math.inf:
            return float(value)
    raise ValueError(f"found {value!r}, but a finite number above 0 is required")


# Of what swings.
DampingRatio: TypeAlias = Annotated[float, BeforeValidator(_read_below_one)]
PerTooth: TypeAlias = float | list[float]
JointFrequency: TypeAlias = Annotated[
    float | list[float],
    BeforeValidator(_read_each(_read(q.FREQUENCY, sign="positive"), "joint")),
]
JointRatio: TypeAlias = Annotated[
    float | list[float], BeforeValidator(_read_each(_read_positive, "joint"))
]
ToothPositivePressure: TypeAlias = Annotated[
    PerTooth, BeforeValidator(_read_each(_read(q.PRESSURE, sign="positive")))
]
ToothPressure: TypeAlias = Annotated[
    PerTooth, BeforeValidator(_read_each(_read(q.PRESSURE)))
]
ToothEdgeForce: TypeAlias = Annotated[
    PerTooth, BeforeValidator(_read_each(_read(q.EDGE_FORCE)))
]
ToothExponent: TypeAlias = Annotated[
    PerTooth, BeforeValidator(_read_each(_read_below_one))
]


def _uncertainty(value: object) -> float:
    """Relative uncertainty, a number of at least 0 and below 1."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if 0 <= value < 1:
            return float(value)
    raise ValueError(
        f"found {value!r}, but a number from 0 to less than 1, such as 0.2, is required"
    )


Uncertainty = Annotated[float, BeforeValidator(_uncertainty)]
