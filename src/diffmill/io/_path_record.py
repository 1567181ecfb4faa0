"""A path as a robot or a tracker recorded it, read as a table of measurements."""

import pathlib

import numpy as np
from jaxtyping import Float

from ..toolpath import Path
from ..units import ANGLE, LENGTH
from ._programs.faults import Fault, ProgramError
from ._programs.geometry import rotation_of_abc, rotation_of_quaternion, tool_rotation
from ._programs.limits import FARTHEST
from ._records.quantity import TIME_COLUMN, Quantity
from ._records.reader import TableReader
from ._records.table import RecordError

_WORD = r"(?:(?:pos|position|tcp|tip|tool|robot|act|actual|meas|measured)[\s_.\-]*)*"
_BEHIND = r"(?:[\s_.\-]*(?:pos|position|act|actual|meas|tcp))*"
_PLACE = tuple(
    Quantity(name, rf"{_WORD}{name}{_BEHIND}", (LENGTH,), (name,)) for name in "xyz"
)
_ANGLES = tuple(
    Quantity(name.upper(), rf"{_WORD}{name}{_BEHIND}", (ANGLE,), (name,))
    for name in "abc"
)
# The real part first, as qw qx qy qz, q1 to q4 (ABB) or q0 to q3.
_QUATERNIONS = tuple(
    tuple(Quantity(name, rf"{_WORD}q[\s_.\-]*{name[1]}{_BEHIND}") for name in names)
    for names in (
        ("qw", "qx", "qy", "qz"),
        ("q1", "q2", "q3", "q4"),
        ("q0", "q1", "q2", "q3"),
    )
)
_AXES = tuple(Quantity(name, name) for name in "ijk")
_LEAST_QUATERNION = 1e-3
# Of the notes of a record, those on what a path may do without.
_LEFT_OUT = ("empty cell", "repeat the instant", "gaps in", "evenly spaced", "no rows")


def read_recorded_path(file: pathlib.Path) -> Path:
    """Return a path from a table with any header, its units in brackets or behind it.

    Rows with an empty cell and rows that repeat the instant before are left out; a
    clock begins at 0. A, B, C (KUKA) or a quaternion tell where z of the tool points,
    from the shank to the tip; i, j, k go from tip to shank.

    Args:
        file: Path of the file.

    Raises:
        ProgramError: If anything in the file is wrong.
    """
    try:
        reader = TableReader.of_file(file, file.name)
        path = _path(reader)
        reader.check()
    except RecordError as error:
        faults = [Fault(0, "", one) for one in error.faults]
        raise ProgramError(file.name, faults) from error
    except OSError as error:
        reason = error.strerror or "unknown reason"
        fault = Fault(0, "", f"the file cannot be read: {reason}.")
        raise ProgramError(file.name, [fault]) from error
    assert path is not None
    return path


def _path(reader: TableReader) -> Path | None:
    """Path of a table, or None with a fault."""
    time = reader.values(TIME_COLUMN)
    place = _columns(_PLACE, reader)
    if time is None or place is None:
        if not reader.faults:
            message = (
                "needed are columns of the time and of x, y and z with units, such "
            )
            message += f"as x [mm]; found {reader.listed()}."
            reader.faults.append(message)
        return None
    axes = _tool_axes(reader, len(place))
    is_valid = np.isfinite(place).all(axis=1) & np.isfinite(axes).all(axis=1)
    line = reader.timeline(time, np.asarray(is_valid), None)
    # A path has no notes: what is more than left out has to be put right by its owner.
    for note in reader.notes:
        if not any(word in note for word in _LEFT_OUT):
            reader.faults.append(f"{note} A path needs rows that are in order.")
    if line is None or reader.faults:
        return None
    positions = place[line.rows]
    if not np.all(np.abs(positions) <= FARTHEST):
        reader.faults.append(f"a place lies more than {FARTHEST:g} m from zero.")
        return None
    return Path(
        time=np.asarray(line.time - line.time[0]),
        positions=positions,
        axes=axes[line.rows],
        is_rapid=np.zeros(len(positions), dtype=bool),
        line=np.asarray(line.rows + 1, dtype=np.int32),
    )


def _columns(
    quantities: tuple[Quantity, ...], reader: TableReader
) -> Float[np.ndarray, "row part"] | None:
    """Columns of a vector in SI units; None if one of them is not there."""
    columns = [reader.find(quantity) for quantity in quantities]
    values: list[Float[np.ndarray, " row"]] = []
    for quantity, column in zip(quantities, columns, strict=True):
        if column is None:
            continue
        if quantity.kinds and not reader.unit_of(quantity, column):
            message = f"the column `{column.name}` has no unit; needed is one, such as "
            unit = "mm" if quantity.kinds[0] is LENGTH else "deg"
            reader.faults.append(f"{message}{column.name} [{unit}].")
            continue
        found = reader.in_si(quantity, column)
        if found is not None:
            values.append(found)
    if len(values) < len(quantities):
        if values and not reader.faults:
            keys = ", ".join(quantity.key for quantity in quantities)
            reader.faults.append(f"needed are all of {keys}, or none.")
        return None
    return np.stack(values, axis=1)


def _tool_axes(reader: TableReader, count: int) -> Float[np.ndarray, "row 3"]:
    """Tool axes, tip to shank; upright where the table states none."""
    angles = _columns(_ANGLES, reader)
    if angles is not None:
        degrees = np.degrees(angles).tolist()
        matrices = [rotation_of_abc(a, b, c) for a, b, c in degrees]
        return np.stack([tool_rotation(R)[:, 2] for R in matrices])
    for quantities in _QUATERNIONS:
        parts = [reader.find(quantity) for quantity in quantities]
        rows = _columns(quantities, reader) if all(parts) else None
        if rows is not None:
            out = np.full((count, 3), np.nan)
            sizes = np.linalg.norm(rows, axis=1)
            for index in np.flatnonzero(sizes > _LEAST_QUATERNION):
                w, x, y, z = rows[index].tolist()
                out[index] = tool_rotation(rotation_of_quaternion(w, x, y, z))[:, 2]
            return out
    axes = _columns(_AXES, reader)
    if axes is None:
        return np.tile(np.array([0.0, 0.0, 1.0]), (count, 1))
    size = np.linalg.norm(axes, axis=1, keepdims=True)
    return axes / np.where(size > _LEAST_QUATERNION, size, np.nan)
