"""Columns of a table that is no record of forces: by pattern of name, in SI units."""

import re
from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from ...units import QuantityKind
from .channels import listed, named_column
from .table import Column, Table, given_scale, is_unit, scale, split_unit

# What a column of time may be called.
TIME_NAMES = r"t|time|zeit|x_?value|(rel\w*|elapsed)[ _]?time|seconds|sekunden"


def column_of(
    table: Table,
    key: str,
    kinds: tuple[QuantityKind, ...],
    pattern: str,
    wanted: Mapping[str, str | int | None],
    faults: list[str],
    notes: list[str],
    given: str | None = None,
) -> Float[np.ndarray, " row"] | None:
    """Return a column in SI units, or None if there is none or it has a fault.

    Args:
        table: The table.
        key: Name of the quantity.
        kinds: Dimensions that it may have; none takes the numbers as they are.
        pattern: Regular expression of the whole name, whatever its case.
        wanted: Names or numbers of columns that the user gives.
        faults: Receives what is wrong.
        notes: Receives what was assumed.
        given: What a number stands for, as the user says, before what the file says.
    """
    if key in wanted:
        column = named_column(key, wanted[key], list(table.columns), faults)
    else:
        column = _matching(table, key, kinds, pattern, faults)
    if column is None:
        return None
    return _in_si(column, key, kinds, given, faults, notes)


def check_keys(
    what: str, given: Iterable[str], allowed: Iterable[str], faults: list[str]
) -> None:
    """Note what the user gives for a quantity that there is not.

    Args:
        what: What is given: "channel", or "unit of".
        given: Its keys.
        allowed: Those that there are.
        faults: Receives what is wrong.
    """
    known = tuple(allowed)
    for key in given:
        if key not in known:
            faults.append(f"found the {what} `{key}`; allowed are {', '.join(known)}.")


def _matching(
    table: Table,
    key: str,
    kinds: tuple[QuantityKind, ...],
    pattern: str,
    faults: list[str],
) -> Column | None:
    """Return the column whose name fits."""
    hits = [
        column
        for column in table.columns
        if any(
            re.fullmatch(pattern, name.strip(), re.IGNORECASE)
            for name in (column.name, split_unit(column.name, *kinds)[0])
        )
    ]
    if len(hits) > 1:
        # `fz_mm` beside `Fz_N`: the unit tells which of them is meant.
        hits = [column for column in hits if _has_kind(column, kinds)] or hits
    if len(hits) > 1:
        faults.append(
            f"found {len(hits)} columns that may be {key} "
            f"({listed(list(table.columns), hits)}); name one with `channels`."
        )
    return hits[0] if len(hits) == 1 else None


def _has_kind(column: Column, kinds: tuple[QuantityKind, ...]) -> bool:
    unit = column.unit or split_unit(column.name, *kinds)[1]
    return not unit or not kinds or is_unit(unit, *kinds)


def _in_si(
    column: Column,
    key: str,
    kinds: tuple[QuantityKind, ...],
    given: str | None,
    faults: list[str],
    notes: list[str],
) -> Float[np.ndarray, " row"] | None:
    """Return the numbers of a column in SI units."""
    values = column.values()
    if not np.isfinite(values).any():
        faults.append(f"the column `{column.name}` ({key}) holds no number.")
        return None
    if not kinds:
        return values
    unit = given or column.unit or split_unit(column.name, *kinds)[1]
    if not unit:
        notes.append(
            f"The column `{column.name}` has no unit and was taken in {kinds[0].unit}."
        )
        return values
    messages = []
    for kind in kinds:
        try:
            return values * (scale if given is None else given_scale)(unit, kind)
        except ValueError as error:
            messages.append(str(error))
    hint = "; or say what a number stands for by `units`" if given is None else ""
    faults.append(
        f"the unit of the column `{column.name}` ({key}): {messages[0]}{hint}."
    )
    return None
