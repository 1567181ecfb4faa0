"""Measured records from files."""

import os
import pathlib
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ...identification import Record, find_saturated
from .binary import read_mat, read_netcdf, read_tdms
from .channels import Channels, channels_of
from .errors import RecordError
from .table import Table
from .text import read_text
from .timeline import Timeline, timeline

_SAME_RATE = 0.01


def load_record(
    path: str | os.PathLike[str],
    channels: Mapping[str, str | int | None] | None = None,
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
) -> Record:
    """Return a record of measured forces from a file.

    Text with any header and delimiter is read, DynoWare's export among it, and TDMS,
    MAT and NetCDF (TDMS and MAT 7.3 need the extra `forces`). Units come from the file,
    in text in brackets, after the name, or in a row of their own; a column without one
    is taken in SI and said so in `notes`. Forces are neither turned nor
    mirrored, and a saturated or missing sample is marked, not replaced.

    Args:
        path: Path of the file.
        channels: Column of `time`, `Fx`, `Fy`, `Fz`, `tacho` or `angle`, by its name
            in the file or its number from 1; None for no such column, or a force that
            was not measured. What is not in it is looked for by name.
        rate: Sampling rate [Hz], needed if neither a time column nor the header has it.
        units: Unit of `time`, `angle`, `Fx`, `Fy`, `Fz`, or `force` for all three,
            before what the file says; or what its number 1 stands for: "100 N" for
            volts of an amplifier set so.

    Returns:
        The record in SI units.

    Raises:
        RecordError: If the file cannot be read; all that is wrong is listed.

    **Differentiability**: none, it runs on the host.
    """
    file = pathlib.Path(path)
    faults: list[str] = []
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise RecordError(
            str(file), [f"the rate must be positive and finite, but is {rate}."]
        )
    try:
        table = read_table(file)
    except OSError as error:
        reason = error.strerror or str(error)
        raise RecordError(str(file), [f"cannot be read: {reason}."]) from None
    notes = list(table.notes)
    found = channels_of(table, channels or {}, faults, notes, units)
    line = None
    if found is not None:
        is_valid = np.asarray(np.isfinite(found.force).all(axis=1))
        line = timeline(found.time, is_valid, rate or found.rate, faults, notes)
    if line is not None and rate is not None and abs(line.rate / rate - 1) > _SAME_RATE:
        faults.append(
            f"the rate is given as {rate:g} Hz, but the time column has {line.rate:g} "
            "Hz; leave out the rate, or set the channel time to None."
        )
    if found is None or line is None or faults:
        raise RecordError(str(file), faults)
    return _record(found, line, notes, str(file))


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
    return read_text(file)


def _record(found: Channels, line: Timeline, notes: list[str], source: str) -> Record:
    force = np.ascontiguousarray(found.force[line.rows], dtype=np.float64)
    is_saturated = np.asarray(find_saturated(force).any(axis=1))
    if is_saturated.any():
        notes.append(
            f"{np.count_nonzero(is_saturated)} samples are at the end of a channel's "
            "range and were marked."
        )

    def kept(
        values: Float[np.ndarray, " row"] | None,
    ) -> Float[np.ndarray, " kept"] | None:
        return None if values is None else np.asarray(values, float)[line.rows]

    return Record(
        time=np.asarray(line.time, dtype=np.float64),
        force=force,
        rate=float(line.rate),
        is_saturated=is_saturated,
        is_after_gap=line.is_after_gap,
        tacho=kept(found.tacho),
        angle=kept(found.angle),
        names=found.names,
        is_measured=found.is_measured,
        notes=tuple(notes),
        source=source,
    )
