"""A sampled or recorded path as CSV, with the units in its header."""

import os
import pathlib
import re

import numpy as np
from jaxtyping import Float, Int

from .._messages import shown
from ..toolpath import Path
from ._path_record import read_recorded_path
from ._programs.faults import Fault, ProgramError
from ._programs.limits import FARTHEST
from ._programs.text import read_text

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "inch": 0.0254}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_SPEEDS = {
    f"{length}_per_{time}": scale / _TIMES[time]
    for length, scale in _LENGTHS.items()
    for time in ("s", "min")
}
_UNITS = {"time": _TIMES, "x": _LENGTHS, "y": _LENGTHS, "z": _LENGTHS, "feed": _SPEEDS}
_PLAIN = ("rapid", "line", "i", "j", "k")


def read_path_csv(
    file: str | os.PathLike[str], *, is_axis_to_tip: bool = False
) -> Path:
    """Return a path from a CSV file, its rows as recorded.

    The header names the columns with their units: `time_s,x_mm,y_mm,z_mm` are needed
    (or `time_ms`, `x_m`, `x_in` and so on), `rapid` (0 or 1), `feed_mm_per_min`,
    `line` and the tool axis `i,j,k` may follow in any order. Columns are separated by
    semicolons, tabs or commas; between semicolons or tabs, numbers may have a decimal
    comma. Empty lines and lines that start with # are left out. A table with another
    header is read as a record of measurements: `Time [ms];X [mm];...`, with A, B, C or
    a quaternion, a clock, stamps that repeat.

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
    text = read_text(path)
    if text.strip() and not _is_own(text):
        return read_recorded_path(path)
    return _path_of_text(text, path.name, is_axis_to_tip=is_axis_to_tip)


def _is_own(text: str) -> bool:
    """True if a text has the header of a path, with a fault or without."""
    rows = (row for row in text.splitlines() if row.strip())
    header = next((row for row in rows if not row.lstrip().startswith("#")), "")
    names = re.findall(r"\b(time|[xyz])_[a-z]+\b", header.lower())
    return len(set(names)) >= 2 and "[" not in header


def _refused(name: str, faults: list[str]) -> ProgramError:
    lines = shown(faults, len(faults))
    return ProgramError(name, [Fault(0, "", line) for line in lines])


def _path_of_text(text: str, name: str, *, is_axis_to_tip: bool) -> Path:
    """Path of CSV text; `name` is the file's, for messages."""
    rows = {
        number: line.strip()
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    }
    if not rows:
        raise _refused(name, ["the file is empty; needed is a header and 2 rows."])
    number = next(iter(rows))
    header = rows.pop(number)
    delimiter = next((sign for sign in ";\t" if sign in header), ",")
    labels = [label.strip(' "').lower() for label in header.split(delimiter)]
    faults: list[str] = []
    scales = _scales(labels, number, faults)
    body = _with_points(rows, delimiter, len(labels), faults)
    if faults:
        raise _refused(name, faults)
    values = _values(body, labels, delimiter, faults)
    if len(rows) < 2:
        faults.append(f"found {len(rows)} rows after the header; needed are 2.")
    if faults:
        raise _refused(name, faults)
    lines = np.array(list(rows), dtype=np.int32)
    with np.errstate(over="ignore"):
        columns = zip(scales.items(), values.T, strict=True)
        data = {key: column * scale for (key, scale), column in columns}
    _check(data, lines, faults)
    if faults:
        raise _refused(name, faults)
    if is_axis_to_tip and "i" in data:
        data |= {key: -data[key] for key in "ijk"}
    return _path(data, lines)


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


def _scales(labels: list[str], number: int, faults: list[str]) -> dict[str, float]:
    """Scales of the columns to SI by quantity, in their order.

    Args:
        labels: Names of the columns.
        number: Line of the header.
        faults: Receives faults of the header; without any, each column has a scale.
    """
    scales: dict[str, float] = {}
    for index, label in enumerate(labels):
        quantity, _, unit = label.partition("_")
        place = f"line {number}, column {index + 1}: found `{label}`"
        if label in _PLAIN:
            quantity, scale = label, 1.0
        elif quantity in _UNITS and unit in _UNITS[quantity]:
            scale = _UNITS[quantity][unit]
        elif quantity in _UNITS:
            allowed = ", ".join(f"{quantity}_{u}" for u in _UNITS[quantity])
            faults.append(f"{place}; allowed are {allowed}.")
            # Named with a wrong unit, it is not reported again as missing.
            scales.setdefault(quantity, np.nan)
            continue
        else:
            faults.append(
                f"{place}; allowed are time, x, y, z and feed with their units "
                "(as in time_s, x_mm, feed_mm_per_min), rapid, line, and i, j, k."
            )
            continue
        if quantity in scales:
            faults.append(f"{place}; only one column of {quantity} is allowed.")
        scales[quantity] = scale
    missing = [key for key in ("time", "x", "y", "z") if key not in scales]
    axes = [key for key in "ijk" if key in scales]
    if missing:
        faults.append(
            f"line {number}: found no column for {', '.join(missing)}; needed are "
            "columns such as time_s, x_mm, y_mm, z_mm."
        )
    if axes and len(axes) < 3:
        faults.append(
            f"line {number}: found only {', '.join(axes)} of the tool axis; allowed "
            "are all of i, j, k or none."
        )
    return scales


def _with_points(
    rows: dict[int, str], delimiter: str, count: int, faults: list[str]
) -> dict[int, str]:
    """Rows by line, with decimal points for commas; a file with both has a fault."""
    if delimiter == ",":
        counts = {row.count(",") + 1 for row in rows.values()}
        if counts == {2 * count}:
            faults.append(
                f"line {next(iter(rows))}: found {2 * count} values in every row, "
                f"which look like {count} with a decimal comma; allowed are decimal "
                "points, or columns that are separated by semicolons or tabs."
            )
        return rows
    commas = [number for number, row in rows.items() if "," in row]
    if not commas:
        return rows
    if points := [number for number, row in rows.items() if "." in row]:
        faults.append(
            f"line {commas[0]}: found decimal commas, but points in line "
            f"{points[0]}; allowed is one of them."
        )
    return {number: row.replace(",", ".") for number, row in rows.items()}


def _values(
    rows: dict[int, str], labels: list[str], delimiter: str, faults: list[str]
) -> Float[np.ndarray, "row column"]:
    """Table of numbers as written; wrong ones are reported and left 0."""
    out = np.zeros((len(rows), len(labels)))
    for index, (number, row) in enumerate(rows.items()):
        fields = row.split(delimiter)
        if len(fields) != len(labels):
            faults.append(
                f"line {number}: found {len(fields)} values; the header has "
                f"{len(labels)} columns."
            )
            continue
        for column, written in enumerate(fields):
            try:
                value = float(written.strip(' "'))
            except ValueError:
                value = np.nan
            if np.isfinite(value):
                out[index, column] = value
            else:
                faults.append(
                    f"line {number}, column {column + 1} ({labels[column]}): found "
                    f"`{written.strip()}`; allowed is a finite number such as 1.5."
                )
    return out


def _check(
    data: dict[str, Float[np.ndarray, " row"]],
    lines: Int[np.ndarray, " row"],
    faults: list[str],
) -> None:
    """Report rows whose numbers make no sense."""
    time = data["time"]
    for row in np.flatnonzero(np.diff(time) <= 0) + 1:
        faults.append(
            f"line {lines[row]}: found a time of {time[row]:.9g} s after "
            f"{time[row - 1]:.9g} s; the time must increase."
        )
    for axis in "xyz":
        for row in np.flatnonzero(~(np.abs(data[axis]) <= FARTHEST)):
            faults.append(
                f"line {lines[row]}: found {axis} at {data[axis][row]:g} m; at most "
                f"{FARTHEST:g} m is allowed."
            )
    number = data.get("line", np.zeros_like(time))
    for row in np.flatnonzero((number < 0) | (number >= 2**31) | (number % 1 != 0)):
        faults.append(
            f"line {lines[row]}: found {number[row]:g} for line; allowed is a whole "
            "number from 0."
        )
    rapid = data.get("rapid", np.zeros_like(time))
    for row in np.flatnonzero((rapid != 0) & (rapid != 1)):
        faults.append(
            f"line {lines[row]}: found {rapid[row]:g} for rapid; allowed are 0 and 1."
        )
    if "i" in data:
        length = np.linalg.norm(np.stack([data[key] for key in "ijk"]), axis=0)
        for row in np.flatnonzero(np.abs(length - 1) > 1e-3):
            faults.append(
                f"line {lines[row]}: found a tool axis of length {length[row]:.6g}; "
                "i, j, k must be a unit vector."
            )


def _path(
    data: dict[str, Float[np.ndarray, " row"]], lines: Int[np.ndarray, " row"]
) -> Path:
    """Return the path of checked columns."""
    rows = lines.size
    axes = np.tile(np.array([0.0, 0.0, 1.0]), (rows, 1))
    if "i" in data:
        axes = np.stack([data[key] for key in "ijk"], axis=1)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return Path(
        time=data["time"],
        positions=np.stack([data[key] for key in "xyz"], axis=1),
        axes=axes,
        is_rapid=data.get("rapid", np.zeros(rows)) == 1,
        line=data["line"].astype(np.int32) if "line" in data else lines,
    )
