"""Quantities with units, converted to SI once, at the edge.

Files carry text such as "50 mm/s" or "989.8 N/mm^2". A number is split off by a
regular expression and only a plain unit goes to `pint`: its expression parser would
evaluate arithmetic (and a tower of powers for hours), and it treats angles as pure
numbers, so "0.5" would silently be half a radian and "50 Hz" 50 rad/s.
"""

import functools
import math
import re
from typing import Any, NamedTuple

_NUMBER = re.compile(
    r"(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)"
    r"(?![A-Za-z]))\s*(?P<unit>.*)",
    re.IGNORECASE,
)
# Products of names with one-digit powers: `mm**9**9**9` would keep pint busy for hours.
_TERM = (
    r"(?:[A-Za-z_\u00b0\u00b5\u03bc]+[\u00b2\u00b3]?(?:\s*(?:\^|\*\*)\s*-?[1-9])?|1)"
)
_UNIT = re.compile(rf"{_TERM}(?:(?:\s*[*/\u00b7]\s*|\s+){_TERM})*")
_MAX_UNIT_LENGTH, _MAX_LENGTH = 40, 200
# In SI. Nothing of a machine comes near it, and its powers are still numbers.
_LARGEST_VALUE = 1e20


class QuantityKind(NamedTuple):
    """A physical dimension as the files know it.

    Attributes:
        noun: What a message calls it, with its article.
        unit: The SI unit into which it is converted.
        example: A correct value, for messages.
        angle: "required" if one angle unit must stand in the numerator, "optional"
            if radians may be left out, "forbidden" otherwise.
    """

    noun: str
    unit: str
    example: str
    angle: str = "forbidden"


LENGTH = QuantityKind("a length", "m", "10 mm")
ANGLE = QuantityKind("an angle", "rad", "30 deg", "required")
TIME = QuantityKind("a time", "s", "30 ms")
FREQUENCY = QuantityKind("a frequency", "1/s", "10 kHz")
FORCE = QuantityKind("a force", "N", "12.5 N")
POWER = QuantityKind("a power", "W", "4 kW")
MOMENT = QuantityKind("a moment", "N*m", "3 N*m")
SPEED = QuantityKind("a speed", "m/s", "50 mm/s")
ANGULAR_SPEED = QuantityKind("a rotational speed", "rad/s", "8000 rpm", "required")
ACCELERATION = QuantityKind("an acceleration", "m/s^2", "2 m/s^2")
JERK = QuantityKind("a jerk", "m/s^3", "10 m/s^3")
PRESSURE = QuantityKind("a cutting coefficient (pressure)", "N/m^2", "989.8 N/mm^2")
EDGE_FORCE = QuantityKind("an edge coefficient (force per length)", "N/m", "3.0 N/mm")
ROTARY_STIFFNESS = QuantityKind(
    "a rotational stiffness", "N*m/rad", "2.2e6 N*m/rad", "optional"
)
ROTARY_DAMPING = QuantityKind(
    "a rotational damping", "N*m*s/rad", "3000 N*m*s/rad", "optional"
)
LINEAR_STIFFNESS = QuantityKind("a stiffness", "N/m", "20 N/um")
MASS = QuantityKind("a mass", "kg", "30 kg")
INERTIA = QuantityKind("a moment of inertia", "kg*m^2", "0.75 kg*m^2")
MODULUS = QuantityKind("Young's modulus", "N/m^2", "600 GPa")
DENSITY = QuantityKind("a density", "kg/m^3", "14.5 g/cm^3")
RECEPTANCE = QuantityKind("a receptance", "m/N", "1 um/N")
MOBILITY = QuantityKind("a mobility", "m/s/N", "1 mm/s/N")
ACCELERANCE = QuantityKind("an accelerance", "m/s^2/N", "1 m/s^2/N")
LINEAR_DAMPING = QuantityKind("a damping", "N*s/m", "2000 N*s/m")

# Units that most files are written in: their SI unit and factor. `pint` knows them all,
# but takes a third of a second to start, more than all else that reads a job file.
_USUAL = {
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "Hz": ("1/s", 1.0),
    "kHz": ("1/s", 1e3),
    "N": ("N", 1.0),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "mm/min": ("m/s", 1e-3 / 60),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "rpm": ("rad/s", math.pi / 30),
    "m/s^2": ("m/s^2", 1.0),
    "N/mm^2": ("N/m^2", 1e6),
    "MPa": ("N/m^2", 1e6),
    "GPa": ("N/m^2", 1e9),
    "N/m": ("N/m", 1.0),
    "N/mm": ("N/m", 1e3),
    "N/um": ("N/m", 1e6),
    "N*m": ("N*m", 1.0),
    "N*m/rad": ("N*m/rad", 1.0),
    "N*m*s/rad": ("N*m*s/rad", 1.0),
    "N*s/m": ("N*s/m", 1.0),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
    "kg*m^2": ("kg*m^2", 1.0),
}


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def _wanted(kind: QuantityKind) -> str:
    return f'{kind.noun} with its unit is required, such as "{kind.example}"'


def quantity(value: object, kind: QuantityKind) -> float:
    """Return a quantity given as text in SI units.

    Args:
        value: What the file holds; only text of a number and a unit is accepted.
        kind: The dimension that is required.

    Returns:
        The value in `kind.unit`.

    Raises:
        ValueError: If the value is no text, has no unit, a unit that is not known or
            of another dimension, or is not finite or larger than anything of a
            machine. The message says what was found and what is allowed.

    Differentiability: not applicable, a host function.
    """
    number, unit = _split(value, _wanted(kind))
    return _convert(number, unit, kind, str(value))


class Amount(NamedTuple):
    """A number, and the unit in which it is; "" for none."""

    number: float
    unit: str


def base_quantity(value: object) -> Amount:
    """Return a quantity of any dimension in SI base units, and those units.

    Args:
        value: What the file holds: text of a number and a unit, or a plain number,
            whose unit is empty.

    Returns:
        The value, its unit one that `quantity` reads.

    Raises:
        ValueError: If the value is something else, or its unit is not known.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return Amount(float(value), "")
    wanted = 'a quantity with its unit is required, such as "10 mm"'
    number, unit = _split(value, wanted)
    try:
        in_base = _registry().Quantity(number, _units(unit)).to_base_units()
    except Exception as error:  # pint raises errors of its tokenizer, too
        raise ValueError(f"found {value!r}, but {wanted}") from error
    return Amount(float(in_base.magnitude), f"{in_base.units:~C}")


def scaled_quantity(value: object, factor: float) -> object:
    """Return a quantity of any dimension times a factor, in the unit that it has.

    A whole number stays one where the product is whole.

    Args:
        value: Text of a number and a unit, or a plain number.
        factor: A number.

    Raises:
        ValueError: If the value is something else, or its unit is not known.
    """
    number, unit = base_quantity(value)
    if not unit:
        # A count stays one, which a key that takes whole numbers asks for.
        product = number * factor
        if isinstance(value, int) and math.isclose(product, round(product)):
            return round(product)
        return product
    number, unit = _split(value, "a quantity is required")
    return f"{number * factor:.12g} {unit}"


def _split(value: object, wanted: str) -> Amount:
    """Return the number and the unit of a text."""
    if not isinstance(value, str):
        raise ValueError(f"found {value!r} without a unit, but {wanted}")
    if len(value) > _MAX_LENGTH:
        raise ValueError(f"found a text of {len(value)} characters, but {wanted}")
    match = _NUMBER.fullmatch(value.strip())
    if match is None:
        raise ValueError(f"found {value!r}, but {wanted}")
    unit = match["unit"]
    if not unit:
        raise ValueError(f"found {value!r} without a unit, but {wanted}")
    number = float(match["number"])
    if not math.isfinite(number):
        raise ValueError(f"found {value!r}, but a finite number is required")
    return Amount(number, unit)


def _units(unit: str) -> Any:
    """Return a unit as the registry has it."""
    if len(unit) > _MAX_UNIT_LENGTH or _UNIT.fullmatch(unit) is None:
        raise ValueError(unit)
    return _registry().parse_units(unit)


def _convert(number: float, unit: str, kind: QuantityKind, text: str) -> float:
    si, factor = _USUAL.get(unit, ("", 0.0))
    if si == kind.unit:
        magnitude = number * factor
    elif si and kind.angle != "optional":
        # Of another dimension: only radians may be left out.
        raise ValueError(f"found {text!r}, but {_wanted(kind)}")
    else:
        magnitude = _convert_by_registry(number, unit, kind, text)
    if not abs(magnitude) <= _LARGEST_VALUE:
        raise ValueError(
            f"found {text!r}, but at most {_LARGEST_VALUE:g} {kind.unit} is allowed"
        )
    return magnitude


def _convert_by_registry(
    number: float, unit: str, kind: QuantityKind, text: str
) -> float:
    import pint

    try:
        units = _units(unit)
        result = _registry().Quantity(number, units)
    except Exception as error:  # pint raises errors of its tokenizer, too
        raise ValueError(
            f"found {text!r} with the unknown unit {unit!r}, but {_wanted(kind)}"
        ) from error
    try:
        magnitude = float(result.to(kind.unit).magnitude)
    except (pint.PintError, OverflowError) as error:
        raise ValueError(f"found {text!r}, but {_wanted(kind)}") from error
    # pint itself counts an angle as a pure number.
    power = _registry().get_base_units(units)[1]._units.get("radian", 0)
    is_allowed = {
        "required": power == 1,
        "optional": power in (0, -1),
        "forbidden": power == 0,
    }[kind.angle]
    if not is_allowed:
        raise ValueError(f"found {text!r}, but {_wanted(kind)}")
    return magnitude
