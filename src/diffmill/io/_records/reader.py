"""Columns of a table by quantity: found by name, in SI units, with what was assumed."""

import pathlib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from ...units import ANGLE, FORCE, TIME, QuantityKind
from .binary import read_mat, read_netcdf, read_tdms
from .quantity import TIME_COLUMN, Quantity
from .table import (
    ELECTRIC,
    Column,
    RecordError,
    Table,
    given_scale,
    is_sensitivity,
    is_unit,
    scale,
    split_unit,
)
from .text import read_text
from .timeline import Timeline, timeline
from .uff import read_uff

if TYPE_CHECKING:
    from ...identification import Record

# Name or number (from 1) of a column, those of a force that is their sum, or None for
# no such column.
Channel: TypeAlias = str | int | Sequence[str | int] | None


class TableReader:
    """A table of which columns are asked for by quantity.

    Attributes:
        name: The file.
        table: Its columns as written.
        channels: Names or numbers (from 1) of columns that the user gives by quantity,
            several for a force that is their sum, None for no such column.
        units: What a number stands for, as the user says, before what the file says.
        faults: What is wrong, told at once by `check`.
        notes: What was assumed.
        read: The columns that were read, in SI units.
        TIME: The quantity of a column of the time.
    """

    TIME = TIME_COLUMN

    def __init__(
        self,
        name: str,
        table: Table,
        channels: Mapping[str, Channel] | None = None,
        units: Mapping[str, str] | None = None,
    ):
        self.name, self.table = name, table
        self.channels, self.units = dict(channels or {}), dict(units or {})
        self.faults: list[str] = []
        self.notes: list[str] = list(table.notes)
        self.read: list[Record.Channel] = []

    @classmethod
    def of_file(
        cls,
        file: pathlib.Path,
        name: str,
        channels: Mapping[str, Channel] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> "TableReader":
        """Return the table of a file.

        Args:
            file: The file.
            name: What messages call it.
            channels: Columns that the user gives.
            units: Units that the user gives.

        Raises:
            RecordError: If no columns are in it.
            OSError: If the file cannot be read.
        """
        return cls(name, read_table(file), channels, units)

    def timeline(
        self,
        time: Float[np.ndarray, " row"] | None,
        is_valid: Bool[np.ndarray, " row"],
        rate: float | None,
    ) -> Timeline | None:
        """Return increasing instants for some rows, or None with a fault.

        Args:
            time: The time column [s], NaN where it has none, or None without a column.
            is_valid: Whether a row has all that is needed.
            rate: Sampling rate that the user or the header gives [Hz], or None.
        """
        return timeline(time, is_valid, rate, self.faults, self.notes)

    def check(self) -> None:
        """Raise `RecordError` with all faults, if there are any."""
        if self.faults:
            raise RecordError(self.name, self.faults)

    def allow(self, quantities: Iterable[Quantity]) -> None:
        """Note channels and units that the user gives for what there is not."""
        all_of_them = tuple(quantities)
        for what, given, allowed in (
            ("channel", self.channels, [q.key for q in all_of_them]),
            ("unit of", self.units, [key for q in all_of_them for key in q.units]),
        ):
            known = ", ".join(dict.fromkeys(allowed))
            self.faults += [
                f"found the {what} `{key}`; allowed are {known}."
                for key in given
                if key not in allowed
            ]

    def is_excluded(self, key: str) -> bool:
        """True if the user says that there is no such column."""
        return key in self.channels and self.channels[key] is None

    def values(self, quantity: Quantity) -> Float[np.ndarray, " row"] | None:
        """Return a column in SI units, or None if there is none or it has a fault."""
        column = self.find(quantity)
        return None if column is None else self.in_si(quantity, column)

    def find(self, quantity: Quantity) -> Column | None:
        """Return the column of a quantity as written, or None."""
        key = quantity.key
        if key in self.channels:
            label = self.channels[key]
            if label is None or isinstance(label, str | int):
                return self._named(key, label)
            return self._sum(quantity, label)
        hits = self.named(quantity)
        is_whole = bool(hits) or not quantity.loose
        if not is_whole:
            hits = [
                c
                for c in self.table.columns
                if re.search(quantity.loose, c.name, re.IGNORECASE)
            ]
            hits = self._suited(quantity, hits)
        if len(hits) > 1:
            self.faults.append(
                f"found {len(hits)} columns that may be {key} ({self.listed(hits)}); "
                "name one with `channels`."
            )
        if len(hits) != 1:
            return None
        if not is_whole:
            self.notes.append(f"The column `{hits[0].name}` was taken for {key}.")
        return hits[0]

    def named(self, quantity: Quantity) -> list[Column]:
        """Return the columns with the name of a quantity and, of several, its unit."""
        hits = [c for c in self.table.columns if _is_named(c, quantity)]
        return self._suited(quantity, hits)

    def _suited(self, quantity: Quantity, hits: list[Column]) -> list[Column]:
        """Return those of several columns whose unit suits a quantity, if any does."""
        if len(hits) < 2:
            return hits
        # `fz_mm` beside `Fz_N`: the unit tells which of them is meant.
        return [c for c in hits if self._suits(quantity, c)] or hits

    def in_si(
        self, quantity: Quantity, column: Column
    ) -> Float[np.ndarray, " row"] | None:
        """Return the numbers of a column in SI units, or None with a fault."""
        key, kinds = quantity.key, quantity.kinds
        values = column.values()
        if not np.isfinite(values).any():
            self.faults.append(f"the column `{column.name}` ({key}) has no number.")
            return None
        if not kinds:
            return self._as_read(quantity, column, None, values)
        unit = self.unit_of(quantity, column)
        if not unit:
            self.notes.append(
                f"The column `{column.name}` has no unit and was taken in "
                f"{kinds[0].unit}."
            )
            return self._as_read(quantity, column, kinds[0], values)
        messages = []
        for kind in kinds:
            try:
                factor = self._scale(quantity, column, kind)
            except ValueError as error:
                messages.append(str(error))
            else:
                return self._as_read(quantity, column, kind, values * factor)
        by_user = self._unit_key(quantity)
        fault = f"the unit of `{by_user}`: {messages[0]}."
        if by_user is None:
            example = {TIME: '"ms"', ANGLE: '"deg"'}.get(kinds[0])
            example = example or _sensitivity_example(unit, kinds[0])
            fault = (
                f"the unit of the column `{column.name}` ({key}): {messages[0]}; or "
                "say what a number means by `units`, such as "
                f"{{ {quantity.units[0]} = {example} }}."
            )
        elif unit in ELECTRIC:
            fault = (
                f"the unit of `{by_user}`: found {unit!r}, but the sensitivity of the "
                f"column is required, such as {_sensitivity_example(unit, kinds[0])}."
            )
        # Of the unit of a whole vector it is told once.
        self.faults += [] if fault in self.faults else [fault]
        return None

    def _scale(self, quantity: Quantity, column: Column, kind: QuantityKind) -> float:
        """Factor from the numbers of a column to SI units.

        Raises:
            ValueError: The unit is unknown, or of another kind.
        """
        by_user = self._unit_key(quantity)
        unit = self.unit_of(quantity, column)
        if by_user is None:
            return scale(unit, kind)
        written = self._written_unit(quantity, column)
        if is_sensitivity(unit) and not written:
            self.notes.append(
                f"The column `{column.name}` has no unit and was taken in the electric "
                f"unit of its sensitivity, {unit}."
            )
        return given_scale(unit, kind, written)

    def _as_read(
        self,
        quantity: Quantity,
        column: Column,
        kind: QuantityKind | None,
        values: Float[np.ndarray, " row"],
    ) -> Float[np.ndarray, " row"]:
        """Return the numbers of a column, which is noted as read."""
        # It takes a third of a second to import, which a job does not need.
        from ...identification import Record

        known = values[np.isfinite(values)]
        self.read.append(
            Record.Channel(
                quantity.key,
                column.name,
                self.unit_of(quantity, column),
                "" if kind is None else kind.unit,
                float(known.min()),
                float(known.max()),
            )
        )
        return values

    def unit_of(self, quantity: Quantity, column: Column) -> str:
        """Return the unit of a column, "" if neither the user nor the file says it."""
        by_user = self._unit_key(quantity)
        given = "" if by_user is None else self.units[by_user]
        return given or self._written_unit(quantity, column)

    def _written_unit(self, quantity: Quantity, column: Column) -> str:
        """Return the unit of a column by the file, "" if it has none."""
        return column.unit or split_unit(column.name, *quantity.kinds).unit

    def _suits(self, quantity: Quantity, column: Column) -> bool:
        """True if a column has no unit by the file, or one of the quantity."""
        unit = self._written_unit(quantity, column)
        return not unit or not quantity.kinds or is_unit(unit, *quantity.kinds)

    def _unit_key(self, quantity: Quantity) -> str | None:
        """Return the key under which the user gives the unit of a quantity."""
        return next((name for name in quantity.units if name in self.units), None)

    def listed(self, only: list[Column] | None = None) -> str:
        """Return numbers and names of the columns, or of some, 20 at most."""
        shown = [
            f"{place} `{column.name}`"
            for place, column in enumerate(self.table.columns, 1)
            if only is None or any(column is other for other in only)
        ]
        return ", ".join(shown[:20]) + (", ..." if len(shown) > 20 else "")

    def _sum(self, quantity: Quantity, labels: Sequence[str | int]) -> Column | None:
        """Return the sum of the columns that the user names, or None with a fault."""
        key = quantity.key
        if FORCE not in quantity.kinds:
            self.faults.append(
                f"the channel {key} = {list(labels)!r} names several columns; only "
                "those of a force are summed."
            )
            return None
        columns = [
            column
            for label in labels
            if (column := self._named(key, label)) is not None
        ]
        if len(columns) < len(labels):
            return None
        names = [column.name for column in columns]
        if len({id(column) for column in columns}) < len(columns):
            self.faults.append(
                f"the channel {key} = {list(labels)!r} names one column twice."
            )
            return None
        by_user = self._unit_key(quantity)
        is_stated = by_user is not None and not is_sensitivity(self.units[by_user])
        units = [
            "" if is_stated else self._written_unit(quantity, column)
            for column in columns
        ]
        for what, values in (
            ("unit", [unit or "none" for unit in units]),
            ("sampling rate", [column.rate for column in columns]),
            ("number of samples", [column.values().size for column in columns]),
        ):
            if len(set(values)) > 1:
                shown = ", ".join(
                    f"{name} {value}" for name, value in zip(names, values, strict=True)
                )
                self.faults.append(
                    f"the channel {key} = {list(labels)!r} sums columns that differ in "
                    f"their {what}: {shown}."
                )
                return None
        return Column(
            " + ".join(names),
            units[0],
            lambda: np.sum([column.values() for column in columns], axis=0),
            columns[0].rate,
        )

    def _named(self, key: str, label: str | int | None) -> Column | None:
        """Return the column that the user names."""
        columns = self.table.columns
        if label is None:
            return None
        if isinstance(label, int):
            if 1 <= label <= len(columns):
                return columns[label - 1]
            hits = []
        else:
            plain = label.strip()
            hits = [c for c in columns if c.name == plain]
            hits = hits or [c for c in columns if c.name.lower() == plain.lower()]
            hits = hits or [
                c for c in columns if _squeezed(c.name + c.unit) == _squeezed(label)
            ]
        if len(hits) == 1:
            return hits[0]
        self.faults.append(
            f"the channel {key} = {label!r} names {len(hits) or 'no'} columns; there "
            f"are {self.listed()}, and a number from 1 to {len(columns)} is allowed."
        )
        return None


def _is_named(column: Column, quantity: Quantity) -> bool:
    """True if a column has the name of a quantity, its unit aside."""
    return any(
        re.fullmatch(quantity.pattern, name.strip(), re.IGNORECASE)
        for name in (column.name, split_unit(column.name, *quantity.kinds).name)
    )


def _sensitivity_example(unit: str, kind: QuantityKind) -> str:
    """Return a sensitivity of a column in an electric unit, as an example."""
    return f'"4 pC/{kind.unit}"' if unit.endswith("C") else f'"100 {kind.unit}/V"'


def _squeezed(text: str) -> str:
    return re.sub(r"[\W_]", "", text.lower())


def read_table(file: pathlib.Path) -> Table:
    """Return the columns of a file; what it begins with decides, then its suffix.

    Raises:
        RecordError: If no columns are in it.
        OSError: If the file cannot be read.
    """
    with file.open("rb") as stream:
        begin = stream.read(128)
    suffix = file.suffix.lower()
    if begin.startswith(b"TDSm") or suffix == ".tdms":
        return read_tdms(file)
    if begin.startswith(b"MATLAB") or suffix == ".mat":
        return read_mat(file)
    if begin.startswith((b"\x89HDF", b"CDF")) or suffix in (".nc", ".nc4", ".cdf"):
        return read_netcdf(file)
    if re.match(rb"\s*-1\r?\n *\d+", begin) or suffix in (".uff", ".unv"):
        return read_uff(file)
    return read_text(file)
