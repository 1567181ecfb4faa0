"""Measured records from files."""

import os
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .quantity import FORCES, OTHERS
from .reader import Channel, TableReader
from .table import Column, RecordError

if TYPE_CHECKING:
    from ...identification import Record

_SAME_RATE = 0.01


def load_record(
    path: str | os.PathLike[str],
    channels: Mapping[str, Channel] | None = None,
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
) -> "Record":
    """Return a record of measured forces from a file.

    Text with any header and delimiter is read, DynoWare's export among it, and TDMS,
    MAT and NetCDF (TDMS and MAT 7.3 need the extra `forces`). Units come from the file,
    in text in brackets, after the name, or in a row of their own; a column without one
    is taken in SI and said so in `notes`. Forces are neither turned nor
    mirrored, and a saturated or missing sample is marked, not replaced.

    Args:
        path: Path of the file.
        channels: Column of `time`, `Fx`, `Fy`, `Fz`, `tacho` or `angle`, by its name
            in the file or its number from 1; a list of them for a force that is the sum
            of several; None for no such column, or a force that was not measured. What
            is not in it is looked for by name.
        rate: Sampling rate [Hz], needed if neither a time column nor the header has it.
        units: Unit of `time`, `angle`, `Fx`, `Fy`, `Fz`, or `force` for all three,
            before what the file says; or what its number 1 stands for, "100 N"; or
            the sensitivity of a column of volts or charges, "100 N/V" or "4 pC/N".

    Returns:
        The record in SI units.

    Raises:
        RecordError: If the file cannot be read; all that is wrong is listed.
    """
    file = pathlib.Path(path)
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise RecordError(
            str(file), [f"the rate must be positive and finite, but is {rate}."]
        )
    try:
        reader = TableReader.of_file(file, str(file), channels, units)
    except OSError as error:
        reason = error.strerror or str(error)
        raise RecordError(str(file), [f"cannot be read: {reason}."]) from None
    columns, values = _columns(reader)
    rates = [columns[q.key].rate for q in FORCES if q.key in columns]
    nothing = np.zeros(max(len(one) for one in values.values()))
    force = np.stack([values.get(q.key, nothing) for q in FORCES], axis=1)
    is_valid = np.asarray(np.isfinite(force).all(axis=1))
    given = rate or rates[0] or reader.table.rate
    line = reader.timeline(values.get("time"), is_valid, given)
    if line is not None and rate is not None and abs(line.rate / rate - 1) > _SAME_RATE:
        reader.faults.append(
            f"the rate is given as {rate:g} Hz, but the time column has {line.rate:g} "
            "Hz; leave out the rate, or set the channel time to None."
        )
    reader.check()
    assert line is not None
    is_measured = [q.key in columns for q in FORCES]
    names = [columns[q.key].name if q.key in columns else q.key for q in FORCES]
    force = np.ascontiguousarray(force[line.rows], dtype=np.float64)
    # It takes a third of a second to import, which a job does not need.
    from ...identification import Record, find_saturated

    is_saturated = np.asarray(find_saturated(force).any(axis=1))
    if is_saturated.any():
        reader.notes.append(
            f"{np.count_nonzero(is_saturated)} samples are at the end of a channel's "
            "range and were marked."
        )
    other = {q.key: values[q.key][line.rows] for q in OTHERS if q.key in values}
    return Record(
        time=np.asarray(line.time, dtype=np.float64),
        force=force,
        rate=float(line.rate),
        is_saturated=is_saturated,
        is_after_gap=line.is_after_gap,
        tacho=other.get("tacho"),
        angle=other.get("angle"),
        names=(names[0], names[1], names[2]),
        is_measured=(is_measured[0], is_measured[1], is_measured[2]),
        notes=tuple(reader.notes),
        source=reader.name,
        channels=tuple(reader.read),
    )


def _columns(
    reader: TableReader,
) -> tuple[dict[str, Column], dict[str, Float[np.ndarray, " row"]]]:
    """Columns of a record as written, and their values in SI units, by quantity.

    Raises:
        RecordError: A force is missing, or columns do not go together.
    """
    quantities = (*OTHERS[:1], *FORCES, *OTHERS[1:])
    reader.allow(quantities)
    columns = {
        q.key: column for q in quantities if (column := reader.find(q)) is not None
    }
    forces = [q.key for q in FORCES if q.key in columns]
    missing = [
        q.key for q in FORCES if q.key not in columns and not reader.is_excluded(q.key)
    ]
    if missing and not reader.faults:
        reader.faults.append(
            f"found no column for {', '.join(missing)} among {reader.listed()}; "
            "name it with `channels`, where a force that was not measured is left out "
            f'by {{ {missing[0]} = "none" }}, and the sum of several is a list.'
        )
    if not forces and not reader.faults:
        reader.faults.append(
            "found no force that was measured; one of the three is needed."
        )
    values = {}
    for quantity in quantities:
        key = quantity.key
        array = reader.in_si(quantity, columns[key]) if key in columns else None
        if array is None:
            continue
        values[key] = array
        finite = array[np.isfinite(array)]
        if key in forces and finite.min() == finite.max():
            reader.notes.append(
                f"The column `{columns[key].name}` ({key}) is {finite[0]:g} in all "
                "rows: a dead channel, unless there is no such force; `channels = "
                f'{{ {key} = "none" }}` leaves it out.'
            )
    sizes = {key: array.size for key, array in values.items()}
    if not reader.faults and len(set(sizes.values())) > 1:
        shown = ", ".join(f"{key} {size}" for key, size in sizes.items())
        reader.faults.append(
            f"the channels differ in their number of samples: {shown}."
        )
    # A rate of the forces' own comes before one of the whole file.
    if len({columns[key].rate for key in forces}) > 1:
        reader.faults.append("the forces differ in their sampling rates.")
    reader.check()
    return columns, values
