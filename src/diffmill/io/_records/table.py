"""Table of measurements: named columns as written, and the error of a faulty one."""

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..._messages import shown
from ...units import FREQUENCY, TIME, QuantityKind, quantity

_SHOWN_FAULTS = 20


class RecordError(ValueError):
    """A measured record that cannot be read, with everything wrong in it.

    Attributes:
        name: The file.
        faults: What is wrong; at most 20.
    """

    def __init__(self, name: str, faults: list[str]):
        self.name = name
        self.faults = tuple(shown(faults, _SHOWN_FAULTS))
        super().__init__("\n".join(f"{name}: {fault}" for fault in self.faults))


class Column(NamedTuple):
    """A column of a file as it stands there.

    Attributes:
        name: Its name without the unit.
        unit: Its unit, or "" if none is given.
        values: Returns the numbers in that unit, shape (sample,); NaN where a cell
            holds none. A function, so that no unused column is read.
        rate: Sampling rate of this column [Hz], or None if none is given.
    """

    name: str
    unit: str
    values: Callable[[], Float[np.ndarray, " sample"]]
    rate: float | None = None


class Table(NamedTuple):
    """The columns of a file, and what its header says about all of them.

    Attributes:
        columns: The columns, in the order of the file.
        rate: Sampling rate that the header gives [Hz], or None.
        notes: What was left out while reading, one sentence each.
        header: Line of the names, from 1; 0 where it is not known.
        lines: Lines of the rows, from 1; empty where they are not known.
    """

    columns: list[Column]
    rate: float | None = None
    notes: tuple[str, ...] = ()
    header: int = 0
    lines: tuple[int, ...] = ()


# Longer texts are no names and say no rate; on them the patterns below would look for
# hours at where to begin.
_LONGEST_LABEL, _LONGEST_LINE = 200, 1000
# A unit in square brackets may hold round ones: `Re [(m/s^2)/N]`.
_BRACKETS = re.compile(
    r"(.*?)[\s_]*(?:\[\s*([^\[\]]*?)\s*\]|[({<]\s*([^\[\](){}<>]*?)\s*[)}>])\s*"
)
_NUMERATOR = re.compile(r"\(([^()]*)\)(?=/)")
_SUFFIX = re.compile(r"(.*?)(?:_|\s*/\s*|\s*,\s*|\s+in\s+|\s+)([^\s_/,]+)")
# Words for units that the unit library does not know or takes for something else,
# whatever their case.
_WORDS = {
    "s": "sec secs second seconds sek sekunde sekunden",
    "ms": "msec millisecond milliseconds millisekunde millisekunden",
    "us": "usec microsecond microseconds mikrosekunde mikrosekunden",
    "N": "newton newtons",
    "kN": "kilonewton kilonewtons",
    "kgf": "kp kgf",
    "lbf": "lbf",
    "Hz": "hz hertz",
    "kHz": "khz khertz kilohertz",
    "deg": "° deg degs degree degrees grad",
    "rad": "rad rads radian radians",
    "turn": "rev revs",
    "m": "meter meters metre metres",
    "mm": "mm millimeter millimeters millimetre millimetres",
    "um": "um micrometer micrometers mikrometer",
    "inch": "inch inches zoll",
    "standard_gravity/N": "g/n",
    "standard_gravity/lbf": "g/lbf g/lb",
    "lbf*inch": "lbf-in in-lbf lb-in in-lb",
    "lbf*foot": "lbf-ft ft-lbf lb-ft ft-lb",
}
_SPELLINGS = {word: unit for unit, words in _WORDS.items() for word in words.split()}
# Units of amplifiers, for which the user says what they stand for.
ELECTRIC = ("V", "mV", "pC")
# Units that headers in capitals spell so; tried if they mean something else.
_CAPITALS = {"S": "s", "MS": "ms", "US": "us", "KN": "kN", "DAN": "daN", "NM": "N*m"}
# Moments without a sign between their parts, which the unit library reads as a yarn's
# fineness, or with one that it does not know.
_MOMENT = re.compile(r"((?:da|[kmM])?N)[.\-]?(mm|cm|m)")


def scale(unit: str, kind: QuantityKind) -> float:
    """Factor from a unit to SI.

    Raises:
        ValueError: If the unit is unknown or of another kind.
    """
    plain = _NUMERATOR.sub(r"\1", unit.rstrip(".") or unit)
    moment = _MOMENT.fullmatch(plain)
    other = f"{moment[1]}*{moment[2]}" if moment else _CAPITALS.get(plain)
    try:
        return quantity(f"1 {_SPELLINGS.get(plain.lower(), plain)}", kind)
    except ValueError:
        if other is None:
            raise
    return quantity(f"1 {other}", kind)


def given_scale(text: str, kind: QuantityKind, column_unit: str = "") -> float:
    """Factor from the numbers of a column to SI, as the user states it.

    Args:
        text: A unit, an amount of one, or a sensitivity of a column of voltages or
            charges: "kN", "100 N", "100 N/V", or "4 pC/N".
        kind: What it must be.
        column_unit: Unit of the column by the file; "" for the electric unit of the
            sensitivity.

    Raises:
        ValueError: The unit is unknown or of another kind, the amount is not above
            zero, or a sensitivity does not suit the unit of the column.
    """
    plain = text.strip()
    if _SENSITIVITY.search(plain):
        return _sensitivity_scale(plain, kind, column_unit)
    if not plain[:1].isdigit():
        return scale(plain, kind)
    return _above_zero(quantity(plain, kind), text)


def is_sensitivity(text: str) -> bool:
    """True if a text has the form of a sensitivity, such as "100 N/V"."""
    return _SENSITIVITY.search(text) is not None


# A sensitivity has an electric unit on one side of its stroke.
_ELECTRIC_UNIT = r"(?P<{}>[munp\u00b5]?[VC])"
_SENSITIVITY = re.compile(
    rf"/\s*{_ELECTRIC_UNIT.format('below')}\s*$"
    rf"|(?:^|[\s\d]){_ELECTRIC_UNIT.format('above')}\s*/"
)
_VOLTAGE = QuantityKind("a voltage", "V", "10 mV")
_CHARGE = QuantityKind("a charge", "C", "4 pC")


def _sensitivity_scale(text: str, kind: QuantityKind, column_unit: str) -> float:
    """Factor from the numbers of a column to SI, by its sensitivity."""
    match = _SENSITIVITY.search(text)
    assert match is not None
    unit = match["below"] or match["above"]
    electric = _CHARGE if unit.endswith("C") else _VOLTAGE
    is_inverse = match["below"] is None
    ratio = f"{electric.unit}/({kind.unit})" if is_inverse else ""
    whole = QuantityKind(
        "a sensitivity",
        ratio or f"{kind.unit}/{electric.unit}",
        f"4 pC/{kind.unit}" if is_inverse else f"100 {kind.unit}/V",
        kind.angle,
    )
    amount = text if re.match(r"[+\-.\d]", text) else f"1 {text}"
    value = _above_zero(quantity(amount, whole), text)
    try:
        number = quantity(f"1 {column_unit or unit}", electric)
    except ValueError:
        raise ValueError(
            f"found {text!r} for a column in {column_unit}, but a sensitivity per "
            f"{electric.unit} is for a column in {unit} or another unit of "
            f"{electric.noun}"
        ) from None
    return number / value if is_inverse else number * value


def _above_zero(value: float, text: str) -> float:
    if not value > 0:
        raise ValueError(
            f"found {text!r}, but a number above 0 is required; a reversed channel has "
            "a sign in `axes`"
        )
    return value


def is_unit(text: str, *kinds: QuantityKind) -> bool:
    """True if a text is a unit of one of the kinds."""
    for kind in kinds:
        try:
            scale(text, kind)
        except ValueError:
            continue
        return True
    return False


class Label(NamedTuple):
    """Name of a column, and its unit, "" if none is given."""

    name: str
    unit: str


def split_unit(label: str, *kinds: QuantityKind) -> Label:
    """Return name and unit of a label such as `Fx [N]`, `Time (ms)` or `Fx_N`.

    What stands in brackets is the unit; what follows an underscore, a slash, a comma
    or a blank only if it is a unit of one of the kinds or of an amplifier.
    """
    text = label.strip().strip('"').strip()
    if len(text) > _LONGEST_LABEL:
        return Label(text, "")
    match = _BRACKETS.fullmatch(text)
    if match is not None:
        return Label(match[1].strip(), match[2] or match[3] or "")
    match = _SUFFIX.fullmatch(text)
    # The V of `F_V` may be the vertical.
    if match is not None and (
        (match[2] in ELECTRIC and re.search("[xyz]$", match[1], re.IGNORECASE))
        or is_unit(match[2], *kinds)
    ):
        return Label(match[1].strip(), match[2])
    return Label(text, "")


_RATE = re.compile(
    r"(?:sampl\w*[\s_-]*(?:rate|freq\w*)|scan[\s_-]*rate|abtast(?:rate|frequenz)|\bfs\b)",
    re.IGNORECASE,
)
_INTERVAL = re.compile(
    r"(?:sampl\w*[\s_-]*(?:interval|period|(?P<time>time))|delta_x|"
    r"abtast(?:intervall|(?P<zeit>zeit))|wf_increment|\bdt\b)",
    re.IGNORECASE,
)
_BLANK = " \u00a0\u202f"
_VALUE = re.compile(
    r"\s*(?:[\[(]\s*(?P<before>[^\])]+?)\s*[\])])?[\s:=;,\"]*"
    rf"(?P<number>\d{{1,3}}(?:[{_BLANK}]\d{{3}})+(?![{_BLANK}]?\d)(?:[.,]\d+)?"
    r"|\d+(?:[.,'\u2019]\d+)*(?:[eE][+-]?\d+)?)\s*(?P<after>[a-zA-Z\u00b5]*)"
)
# A number with a sign between its thousands, and with another one as its decimal sign.
_THOUSANDS = re.compile(
    rf"[1-9]\d{{0,2}}([.,'\u2019{_BLANK}])\d{{3}}(?:\1\d{{3}})*(?:(?!\1)[.,]\d+)?"
)
_UNCLEAR = re.compile(r"[1-9]\d{0,2}[.,]\d{3}")


def _number(text: str, is_decimal: bool) -> float:
    """Return the number of digits and signs between them; NaN where it is unclear.

    Args:
        text: Such as "51 200" or "10.000,0".
        is_decimal: Whether a lone sign before three digits is the decimal one: 51.200
            in kHz is none of thousands.
    """
    first, *others = re.split(f"[,{_BLANK}]", text)
    is_list = "." in first and any("." in one for one in others)
    if is_list or (len(others) > 1 and (len(first) > 3 or set(others) == {first})):
        # A rate for every channel.
        return _number(first, is_decimal)
    if _UNCLEAR.fullmatch(text):
        return float(text.replace(",", ".")) if is_decimal else math.nan
    if thousands := _THOUSANDS.fullmatch(text):
        text = text.replace(thousands[1], "")
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan


def header_rate(lines: list[str]) -> float | None:
    """Return the sampling rate [Hz] that a header's lines give, if they do.

    A number that may mean two rates, such as 10,000 Hz, gives none.
    """
    for line in lines:
        if len(line) > _LONGEST_LINE:
            continue
        for pattern, kind, default in (
            (_RATE, FREQUENCY, "Hz"),
            (_INTERVAL, TIME, "s"),
        ):
            name = pattern.search(line)
            value = name and _VALUE.match(line, name.end())
            if not name or not value:
                continue
            unit = value["before"] or value["after"] or default
            try:
                size = scale(unit, kind)
            except ValueError:
                continue
            is_decimal = kind is TIME or size > 1
            number = _number(value["number"], is_decimal) * size
            is_time = kind is TIME and (name["time"] or name["zeit"])
            if is_time and size >= 1 and number >= 1:
                # The time of the whole record is called so too.
                continue
            if math.isfinite(number) and number > 0:
                return number if kind is FREQUENCY else 1.0 / number
    return None
