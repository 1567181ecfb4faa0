"""Channels of a table: the quantity of each column, and its values in SI units."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...units import ANGLE, FORCE, TIME, QuantityKind
from .table import Column, Table, given_scale, scale

KINDS: dict[str, QuantityKind | None] = {
    "time": TIME,
    "Fx": FORCE,
    "Fy": FORCE,
    "Fz": FORCE,
    "tacho": None,
    "angle": ANGLE,
}
FORCES = ("Fx", "Fy", "Fz")
_PARTS = r"[\s_.\-]*"
# Names that leave no doubt; compared with the whole name, whatever its case.
_EXACT = {
    # LabVIEW writes the device before the name: `Dev1/Time`.
    "time": r"([^/\\]+[/\\])?(t|time|zeit|x_?value|time ?stamp|"
    r"(abs\w*|rel\w*|elapsed)[ _]?time|temps|seconds|sekunden)",
    **{
        f"F{axis}": rf"f{_PARTS}{axis}|(force|kraft){_PARTS}{axis}|"
        rf"{axis}{_PARTS}(force|kraft)"
        for axis in "xyz"
    },
    "tacho": r"tacho\w*|trigger|pulses?|key ?phasor|once per rev\w*",
    "angle": r"((spindle|tool|rotation|encoder|spindel|dreh)[ _]?)?(angle|winkel)",
}
# Names that hold the force's name as a word: `Dyno Fx filtered`, `Ch1_Fx`.
_LOOSE = {f"F{axis}": rf"(?<![a-z])f[ _]?{axis}(?![a-z])" for axis in "xyz"}


class Channels(NamedTuple):
    """The quantities of a record in SI units, NaN where a cell held no number.

    Attributes:
        time: Instants [s], shape (sample,), or None.
        force: Forces [N], shape (sample, 3); zero where none was measured.
        tacho: Pulses as written, shape (sample,), or None.
        angle: Spindle angle [rad], shape (sample,), or None.
        names: What the file calls the forces.
        is_measured: Whether there is a column of each force.
        rate: Sampling rate that the file gives [Hz], or None.
    """

    time: Float[np.ndarray, " sample"] | None
    force: Float[np.ndarray, "sample 3"]
    tacho: Float[np.ndarray, " sample"] | None
    angle: Float[np.ndarray, " sample"] | None
    names: tuple[str, str, str]
    is_measured: tuple[bool, bool, bool]
    rate: float | None


def channels_of(
    table: Table,
    wanted: Mapping[str, str | int | None],
    faults: list[str],
    notes: list[str],
    units: Mapping[str, str] | None = None,
) -> Channels | None:
    """Return the quantities of a table, or None with faults.

    Args:
        table: The table as read.
        wanted: For a quantity, the name or number (from 1) of its column, or None for
            no such column; a quantity that is not in it is looked for by its name.
        faults: Where what is wrong is added.
        notes: Where what was assumed is added.
        units: What a number of a quantity stands for, before what the file says;
            `force` for all three.
    """
    for key in wanted:
        if key not in KINDS:
            faults.append(f"found the channel `{key}`; allowed are {', '.join(KINDS)}.")
    given = _given_units(units or {}, faults)
    found = {key: _find(key, table.columns, wanted, faults, notes) for key in KINDS}
    forces = [key for key in FORCES if found[key] is not None]
    missing = [key for key in FORCES if key not in forces and key not in wanted]
    if missing and not faults:
        faults.append(
            f"found no column for {', '.join(missing)} among {listed(table.columns)}; "
            "name it with `channels`, where a force that was not measured is left out "
            f'by {{ {missing[0]} = "none" }}.'
        )
    if not forces and not faults:
        faults.append("found no force that was measured; one of the three is needed.")
    values: dict[str, Float[np.ndarray, " sample"]] = {}
    for key, column in found.items():
        if column is not None:
            array = _in_si(key, column, given.get(key), faults, notes)
            if array is not None:
                values[key] = array
    sizes = {key: array.size for key, array in values.items()}
    if not faults and len(set(sizes.values())) > 1:
        found_sizes = ", ".join(f"{key} {size}" for key, size in sizes.items())
        faults.append(f"the channels differ in their number of samples: {found_sizes}.")
    # A rate of the forces' own comes before one of the whole file.
    columns = {key: column for key, column in found.items() if column is not None}
    own = {columns[key].rate for key in forces}
    if len(own) > 1:
        faults.append("the forces differ in their sampling rates.")
    if faults:
        return None
    names = [columns[key].name if key in forces else key for key in FORCES]
    nothing = np.zeros_like(values[forces[0]])
    return Channels(
        values.get("time"),
        np.stack([values.get(key, nothing) for key in FORCES], axis=1),
        values.get("tacho"),
        values.get("angle"),
        (names[0], names[1], names[2]),
        ("Fx" in forces, "Fy" in forces, "Fz" in forces),
        own.pop() or table.rate,
    )


def _given_units(units: Mapping[str, str], faults: list[str]) -> dict[str, float]:
    """Return how many SI units a number stands for, by quantity."""
    kinds = {key: kind for key, kind in KINDS.items() if kind is not None}
    factors: dict[str, float] = {}
    # One for all forces comes first, so that one of their own replaces it.
    for key in sorted(units, key=lambda key: key != "force"):
        if key != "force" and key not in kinds:
            allowed = ", ".join([*kinds, "force"])
            faults.append(f"found the unit of `{key}`; allowed are {allowed}.")
            continue
        try:
            factor = given_scale(units[key], kinds.get(key, FORCE))
        except ValueError as error:
            faults.append(f"the unit of `{key}`: {error}.")
            continue
        factors |= dict.fromkeys(FORCES if key == "force" else (key,), factor)
    return factors


def looks_named(names: list[str]) -> bool:
    """Return whether one of the names is that of a quantity of a record."""
    return any(_matches(key, name) for key in _EXACT for name in names)


def _matches(key: str, name: str) -> bool:
    pattern = _LOOSE.get(key)
    return re.fullmatch(_EXACT[key], name, re.IGNORECASE) is not None or (
        pattern is not None and re.search(pattern, name, re.IGNORECASE) is not None
    )


def _find(
    key: str,
    columns: list[Column],
    wanted: Mapping[str, str | int | None],
    faults: list[str],
    notes: list[str],
) -> Column | None:
    """Return the column of one quantity, or None."""
    if key in wanted:
        return named_column(key, wanted[key], columns, faults)
    exact = [c for c in columns if re.fullmatch(_EXACT[key], c.name, re.IGNORECASE)]
    if len(exact) == 1:
        return exact[0]
    loose = [] if exact else [c for c in columns if _matches(key, c.name)]
    if len(loose) == 1:
        notes.append(f"The column `{loose[0].name}` was taken for {key}.")
        return loose[0]
    if exact or loose:
        faults.append(
            f"found {len(exact or loose)} columns that may be {key} "
            f"({listed(columns, exact or loose)}); name one with `channels`."
        )
    return None


def named_column(
    key: str, label: str | int | None, columns: list[Column], faults: list[str]
) -> Column | None:
    """Return the column that the user names."""
    if label is None:
        return None
    if isinstance(label, int):
        if 1 <= label <= len(columns):
            return columns[label - 1]
        hits = []
    else:
        hits = [c for c in columns if c.name == label.strip()]
        hits = hits or [c for c in columns if c.name.lower() == label.strip().lower()]
        hits = hits or [
            c for c in columns if _squeezed(c.name + c.unit) == _squeezed(label)
        ]
    if len(hits) == 1:
        return hits[0]
    faults.append(
        f"the channel {key} = {label!r} names {len(hits) or 'no'} columns; there are "
        f"{listed(columns)}, and a number from 1 to {len(columns)} is allowed."
    )
    return None


def _squeezed(text: str) -> str:
    return re.sub(r"[\W_]", "", text.lower())


def listed(columns: list[Column], only: list[Column] | None = None) -> str:
    """Return numbers and names of columns, or of some of them, 20 at most."""
    shown = [
        f"{place} `{column.name}`"
        for place, column in enumerate(columns, 1)
        if only is None or any(column is other for other in only)
    ]
    return ", ".join(shown[:20]) + (", ..." if len(shown) > 20 else "")


def _in_si(
    key: str,
    column: Column,
    given: float | None,
    faults: list[str],
    notes: list[str],
) -> Float[np.ndarray, " sample"] | None:
    """Return a column in SI units, or None with a fault."""
    kind = KINDS[key]
    factor = 1.0 if given is None else given
    if given is not None:
        pass
    elif kind is not None and column.unit:
        try:
            factor = scale(column.unit, kind)
        except ValueError as error:
            example = "ms" if kind is TIME else "deg" if kind is ANGLE else "100 N"
            faults.append(
                f"the unit of the column `{column.name}` ({key}): {error}; or say what "
                f'a number stands for by `units`, such as {{ {key} = "{example}" }}.'
            )
            return None
    elif kind is not None:
        unit = "rad" if kind is ANGLE else kind.unit
        notes.append(f"The column `{column.name}` has no unit and was taken in {unit}.")
    values = column.values()
    finite = values[np.isfinite(values)]
    if not finite.size:
        faults.append(f"the column `{column.name}` ({key}) holds no number.")
        return None
    if kind is FORCE and finite.min() == finite.max():
        notes.append(
            f"The column `{column.name}` ({key}) holds {finite[0]:g} in all rows: a "
            "dead channel, unless there is no such force; `channels = "
            f'{{ {key} = "none" }}` leaves it out.'
        )
    return values * factor
