"""Universal files of modal analysis: functions of nodes, dataset 58, as text.

The format is that of SDRC I-DEAS, which most analysers write: five lines of text, four
of numbers that say what the function is of, and its values in fixed or free columns.
Dataset 164 gives the units of all that follows, which must be those of SI.
"""

import pathlib
import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from .table import Column, RecordError, Table

_DELIMITER = re.compile(r"^ {4}-1\s*$")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?")
# Lines of a dataset 58 before its values.
_HEAD_LINE_COUNT = 11
# By the type of the ordinate.
_IS_COMPLEX = {2: False, 4: False, 5: True, 6: True}
# Units by the type of the data [IDEAS].
_UNITS = {8: "m", 9: "N", 11: "m/s", 12: "m/s^2", 13: "N", 17: "s", 18: "Hz"}
_TIME_TYPE = 17
_AXES = {0: "", 1: "x", 2: "y", 3: "z"}


class _Function(NamedTuple):
    """A function of a dataset 58.

    Attributes:
        name: Its points and directions, such as `4x/7x`.
        abscissa: Instants [s] or frequencies [Hz], shape (row,).
        is_time: Whether these are instants.
        values: In the unit, shape (row,).
        unit: Of the values; "" if the file does not say it.
        is_opposed: Whether response and force point in opposite directions.
    """

    name: str
    abscissa: Float[np.ndarray, " row"]
    is_time: bool
    values: Complex[np.ndarray, " row"] | Float[np.ndarray, " row"]
    unit: str
    is_opposed: bool


def read_uff(path: pathlib.Path) -> Table:
    """Return the functions of a universal file, which share one abscissa.

    A complex one gives two columns, its real and imaginary part.

    Raises:
        RecordError: If no function can be read, or several differ in their abscissa.
        OSError: If the file cannot be read.
    """
    lines = path.read_bytes().decode("latin-1").splitlines()
    edges = [i for i, line in enumerate(lines) if _DELIMITER.match(line)]
    functions: list[_Function] = []
    others: set[str] = set()
    for first, last in zip(edges[::2], [*edges[1::2], len(lines)], strict=False):
        kind, block = lines[first + 1].strip(), lines[first + 2 : last]
        try:
            if kind == "164":
                _check_units(block)
            elif kind == "58":
                functions.append(_function(block))
            else:
                others.add(kind.split()[0])
        except (ValueError, IndexError) as error:
            reason = f"dataset {kind} at line {first + 2} cannot be read: {error}."
            raise RecordError(str(path), [reason]) from error
    if not functions:
        shown = f" (found: {', '.join(sorted(others))})" if others else ""
        raise RecordError(
            str(path),
            [f"found no function, dataset 58 as text, in the universal file{shown}."],
        )
    return _table(path, functions)


def _table(path: pathlib.Path, functions: list[_Function]) -> Table:
    """Return the columns of functions, beside what they are of."""
    one = functions[0]
    if any(not np.array_equal(f.abscissa, one.abscissa) for f in functions):
        raise RecordError(
            str(path),
            ["has functions of different lines: write each to a file of its own."],
        )
    label, unit = ("time", "s") if one.is_time else ("frequency", "Hz")
    columns, notes = [Column(label, unit, lambda: one.abscissa)], []
    for f in functions:
        parts = {f.name: f.values}
        if np.iscomplexobj(f.values):
            parts = {
                f"{f.name} real": np.real(f.values),
                f"{f.name} imaginary": np.imag(f.values),
            }
        columns += [
            Column(name, f.unit, lambda part=part: np.asarray(part, np.float64))
            for name, part in parts.items()
        ]
        if f.is_opposed:
            notes.append(
                f"Response and force of {f.name} point in opposite directions."
            )
    rate = None
    if one.is_time and len(one.abscissa) > 1:
        rate = 1.0 / float(one.abscissa[1] - one.abscissa[0])
    return Table(columns, rate, tuple(notes))


def _check_units(block: list[str]) -> None:
    """Refuse units that are not those of SI.

    The factors of dataset 164 are those by which a value is divided to be one in SI;
    labels of a function may contradict them, and nobody would see it.
    """
    length, force = _numbers(block[1:])[:2]
    if (length, force) != (1.0, 1.0):
        raise ValueError(
            f"its factors of length and force are {length:g} and {force:g}, but SI, 1 "
            "and 1, is required"
        )


def _numbers(lines: list[str]) -> list[float]:
    """Return all numbers of lines, which may stand without a blank between them."""
    texts = _NUMBER.findall("\n".join(lines))
    return [float(text.upper().replace("D", "E")) for text in texts]


def _function(block: list[str]) -> _Function:
    """Return the function of a dataset 58."""
    if len(block) <= _HEAD_LINE_COUNT:
        raise ValueError(f"{_HEAD_LINE_COUNT} lines and values are required")
    kind, count, is_even, start, step = _numbers(block[6:7])[:5]
    if kind not in _IS_COMPLEX:
        raise ValueError(f"its values are of type {kind:g}; allowed are 2, 4, 5 and 6")
    abscissa, numerator, denominator = (int(block[i].split()[0]) for i in (7, 8, 9))
    is_complex, values = (
        _IS_COMPLEX[int(kind)],
        np.array(_numbers(block[_HEAD_LINE_COUNT:])),
    )
    count, width = int(count), 1 + _IS_COMPLEX[int(kind)] + (not is_even)
    if values.size != count * width or count < 1:
        raise ValueError(f"found {values.size} numbers, but {count * width} belong")
    rows = values.reshape(count, width)
    labels = [block[i][46:67].strip() for i in (8, 9)]
    unit = _unit(numerator, denominator, labels)
    # In columns of fixed width: name, number and direction of response and force.
    ends = [block[5][first : first + 25] for first in (30, 55)]
    directions = [int(end[21:25].strip() or 0) for end in ends]
    signs = ["-" if direction < 0 else "" for direction in directions]
    return _Function(
        "/".join(
            f"{end[11:21].strip() or 0}{sign}{_AXES.get(abs(direction), '')}"
            for end, sign, direction in zip(ends, signs, directions, strict=True)
        ),
        start + step * np.arange(count) if is_even else rows[:, 0],
        abscissa == _TIME_TYPE,
        rows[:, -2] + 1j * rows[:, -1] if is_complex else rows[:, -1],
        unit,
        directions[0] * directions[1] < 0,
    )


def _unit(numerator: int, denominator: int, labels: list[str]) -> str:
    """Return the unit of a quotient, "" if neither labels nor types say it.

    Args:
        numerator: Type of what was measured.
        denominator: Type of what it is divided by; 0 for nothing.
        labels: Units of both as written, "NONE" or blank for none.
    """
    upper, lower = (
        _UNITS.get(kind, "") if label.upper() in ("", "NONE") else label
        for kind, label in zip((numerator, denominator), labels, strict=True)
    )
    is_quotient = denominator != 0
    if not upper or (is_quotient and not lower):
        return ""
    return f"{upper}/{lower}" if is_quotient else upper
