"""A sampled or recorded path as CSV, read as a table of which every row counts."""

import os
import pathlib
import re
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from .._messages import shown
from ..toolpath import Path
from ..units import ANGLE, LENGTH
from ._programs.faults import SHOWN_FAULTS, Fault, ProgramError
from ._programs.geometry import rotation_of_abc, rotation_of_quaternion, tool_rotation
from ._programs.limits import FARTHEST
from ._programs.text import read_text
from ._records.quantity import TIME_COLUMN, Quantity
from ._records.reader import TableReader
from ._records.table import RecordError
from ._records.text import strict_table
from ._records.timeline import past_midnight

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
_RAPID, _LINE = Quantity("rapid", "rapid"), Quantity("line", "line")
_ALL = (
    *(TIME_COLUMN, *_PLACE, *_AXES, *_ANGLES, *_QUATERNIONS[0], *_QUATERNIONS[1]),
    *(*_QUATERNIONS[2][:1], _RAPID, _LINE, Quantity("feed", r"feed(?:_\w+)?")),
)
_LEAST_QUATERNION = 1e-3
# How far from 1 the length of a tool axis may be.
_UNIT_TOLERANCE = 1e-3
# A name that only a path has.
_PLAIN = re.compile(r"[xyz]_[a-z]+")
_NEEDED = (
    "needed are columns of the time and of x, y and z with units, such as time_s and "
    "x_mm, or x [mm]."
)


def read_path_csv(
    file: str | os.PathLike[str], *, is_axis_to_tip: bool = False
) -> Path:
    """Return a path from a table, its rows as recorded.

    Names, units, separators and decimal signs are those of measured records: a header
    of any length above the rows, `time_s,x_mm,y_mm,z_mm` or `Time [ms];X [mm];...`, a
    row of units, a clock. Beside time, x, y and z, a path may have the tool axis
    `i,j,k`, angles A, B, C (KUKA) or a quaternion, which state where z of the tool
    points, from the shank to the tip; `rapid` (0 or 1), `feed` and `line`. No row is
    left out but one that repeats the row before it, and no cell may be empty. Lines
    that are empty or begin with # are no rows.

    Where the header is `time_s,x_mm,...`, further columns are refused and instants
    stay as written; else further columns are left out, and the first row is at 0.

    Args:
        file: Path of the file.
        is_axis_to_tip: Whether i, j, k point from the shank to the tip, as the tool's
            z of most controllers; else from tip to shank.

    Returns:
        The path in SI units, with the instants as recorded: bring it to the tooth
        instants with its `resampled`. Rows without a `line` column carry
        their line in the file.

    Raises:
        ProgramError: If anything in the file is wrong; up to 20 faults are listed.
    """
    path = pathlib.Path(file)
    faults: list[str] = []
    try:
        table = strict_table(read_text(path), path.name, faults)
        reader = TableReader(path.name, table)
        reader.faults = faults
        made = _path(reader, is_axis_to_tip=is_axis_to_tip)
    except RecordError as error:
        faults, made = list(error.faults), None
    if made is None or faults:
        lines = shown(faults, len(faults))
        raise ProgramError(path.name, [Fault(0, "", line) for line in lines])
    return made


def write_path_csv(path: Path) -> str:
    """Return a path as CSV text with the columns of `read_path_csv`.

    Positions have 1e-9 mm, times 1e-12 s, so that the text reads back to the path.
    The feed of a row is the mean speed since the row before it, of the first row 0.

    Args:
        path: The path.

    Returns:
        The text.
    """
    time, positions = np.asarray(path.time), np.asarray(path.positions)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(time)
    feed = np.concatenate([[0.0], steps * 6e4])
    lines = ["time_s,x_mm,y_mm,z_mm,rapid,feed_mm_per_min,i,j,k,line"]
    columns = zip(
        time,
        positions * 1e3,
        np.asarray(path.is_rapid),
        feed,
        np.asarray(path.axes),
        np.asarray(path.line),
        strict=True,
    )
    for t, (x, y, z), is_rapid, rate, (i, j, k), line in columns:
        lines.append(
            f"{t:.12f},{x:.9f},{y:.9f},{z:.9f},{int(is_rapid)},{rate:.6f},"
            f"{i:.12g},{j:.12g},{k:.12g},{int(line)}"
        )
    return "\n".join(lines) + "\n"


def _path(reader: TableReader, *, is_axis_to_tip: bool) -> Path | None:
    """Path of a table, or None with a fault."""
    faults, lines = reader.faults, np.array(reader.table.lines, dtype=np.int32)
    is_plain = _check_names(reader)
    if faults:
        return None
    time, place = _columns((TIME_COLUMN,), reader), _columns(_PLACE, reader)
    axes = _tool_axes(reader, lines, is_axis_to_tip=is_axis_to_tip)
    others = [_columns((one,), reader) for one in (_RAPID, _LINE)]
    rapid, number = (
        np.zeros(lines.size) if one is None else one[:, 0] for one in others
    )
    if lines.size < 2:
        faults.append(f"found {lines.size} rows after the header; needed are 2.")
    # What the reader of a record would assume.
    faults += [f"{note} A path states it." for note in reader.notes]
    if faults or time is None or place is None:
        return None
    instants = past_midnight(time[:, 0])
    same = [np.diff(one, axis=0) == 0 for one in (place, axes)]
    is_repeat = (np.diff(instants) == 0) & np.hstack(same).all(axis=1)
    kept = np.concatenate([[True], ~is_repeat])
    instants, place, axes, rapid = (one[kept] for one in (instants, place, axes, rapid))
    lines, number = lines[kept], number[kept]
    _check(instants, place, lines, faults)
    _report(
        (number < 0) | (number >= 2**31) | (number % 1 != 0),
        lambda row: (
            f"line {lines[row]}: found {number[row]:g} for line; allowed is a "
            "whole number from 0."
        ),
        faults,
    )
    _report(
        (rapid != 0) & (rapid != 1),
        lambda row: (
            f"line {lines[row]}: found {rapid[row]:g} for rapid; allowed are 0 and 1."
        ),
        faults,
    )
    if faults:
        return None
    return Path(
        time=instants if is_plain else instants - instants[0],
        positions=place,
        axes=axes,
        is_rapid=rapid == 1,
        line=lines if others[1] is None else number.astype(np.int32),
    )


def _check_names(reader: TableReader) -> bool:
    """Report columns that are missing, or there twice.

    Returns:
        True if the header has names such as `time_s` and `x_mm`, which are a path's
        own: any other column of it has a fault.
    """
    columns, header = reader.table.columns, reader.table.header
    places = {id(column): n for n, column in enumerate(columns, 1)}
    known = {q.key: reader.named(q) for q in _ALL}
    is_plain = any(_PLAIN.fullmatch(c.name.lower()) and not c.unit for c in columns)
    for key, hits in known.items():
        for column in hits[1:]:
            reader.faults.append(
                f"line {header}, column {places[id(column)]}: found `{column.name}`; "
                f"only one column of {key} is allowed."
            )
    all_known = {id(column) for hits in known.values() for column in hits}
    for column in columns if is_plain else ():
        if id(column) not in all_known:
            reader.faults.append(
                f"line {header}, column {places[id(column)]}: found `{column.name}`; "
                "allowed are time, x, y, z and feed with their units (as in time_s, "
                "x_mm, z_mm, feed_mm_per_min), rapid, line, i, j, k, a, b, c, and "
                "qw, qx, qy, qz."
            )
    missing = [key for key in ("time", "x", "y", "z") if not known[key]]
    if missing:
        reader.faults.append(
            f"line {header}: found no column for {', '.join(missing)} among "
            f"{reader.listed()}; {_NEEDED}"
        )
    return is_plain


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
            place = next(
                n for n, one in enumerate(reader.table.columns, 1) if one is column
            )
            unit = {LENGTH: "mm", ANGLE: "deg"}.get(quantity.kinds[0], "s")
            reader.faults.append(
                f"line {reader.table.header}, column {place}: found `{column.name}`, "
                f"which has no unit; needed is one, such as {column.name}_{unit} or "
                f"{column.name} [{unit}]."
            )
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


def _tool_axes(
    reader: TableReader, lines: Int[np.ndarray, " row"], *, is_axis_to_tip: bool
) -> Float[np.ndarray, "row 3"]:
    """Tool axes, tip to shank; upright where the table states none."""
    angles = _columns(_ANGLES, reader)
    if angles is not None:
        rotations = (
            rotation_of_abc(a, b, c) for a, b, c in np.degrees(angles).tolist()
        )
        return _shank_axes(rotations, len(angles))
    for quantities in _QUATERNIONS:
        parts = [reader.find(quantity) for quantity in quantities]
        rows = _columns(quantities, reader) if all(parts) else None
        if rows is not None:
            is_none = ~(np.linalg.norm(rows, axis=1) > _LEAST_QUATERNION)
            _report(
                is_none,
                lambda row: f"line {lines[row]}: the quaternion has no length.",
                reader.faults,
            )
            rows = np.where(is_none[:, None], 1.0, rows)
            rotations = (rotation_of_quaternion(*row) for row in rows.tolist())
            return _shank_axes(rotations, len(rows))
    axes = _columns(_AXES, reader)
    if axes is None:
        return np.tile(np.array([0.0, 0.0, 1.0]), (lines.size, 1))
    length = np.linalg.norm(axes, axis=1)
    _report(
        ~(np.abs(length - 1) <= _UNIT_TOLERANCE),
        lambda row: (
            f"line {lines[row]}: found a tool axis of length "
            f"{length[row]:.6g}; i, j, k must be a unit vector."
        ),
        reader.faults,
    )
    return axes / np.where(length > 0, length, 1.0)[:, None] * (1 - 2 * is_axis_to_tip)


def _shank_axes(
    rotations: Iterable[Float[np.ndarray, "3 3"]], count: int
) -> Float[np.ndarray, "row 3"]:
    """Tool axes, tip to shank, of the axes of a controller's tool."""
    rows = [tool_rotation(R)[:, 2] for R in rotations]
    return np.reshape(rows, (count, 3))


def _check(
    time: Float[np.ndarray, " row"],
    place: Float[np.ndarray, "row 3"],
    lines: Int[np.ndarray, " row"],
    faults: list[str],
) -> None:
    """Report rows whose instants or places make no sense."""
    if time.size < 2:
        faults.append(f"found {time.size} row that is no copy; needed are 2.")
    _report(
        np.concatenate([[False], ~(np.diff(time) > 0)]),
        lambda row: (
            f"line {lines[row]}: found a time of {time[row]:.9g} s after "
            f"{time[row - 1]:.9g} s; the time must increase."
        ),
        faults,
    )
    for axis, values in zip("xyz", place.T, strict=True):
        _report(
            ~(np.abs(values) <= FARTHEST),
            lambda row, axis=axis, values=values: (
                f"line {lines[row]}: found {axis} at "
                f"{values[row]:g} m; at most {FARTHEST:g} m from zero is allowed."
            ),
            faults,
        )


def _report(
    is_wrong: Bool[np.ndarray, " row"],
    message: Callable[[int], str],
    faults: list[str],
) -> None:
    """Report rows that are wrong; one more than is shown says that there are more."""
    faults += map(message, np.flatnonzero(is_wrong)[: SHOWN_FAULTS + 1].tolist())
