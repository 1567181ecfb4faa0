"""Measured records as text: tables of numbers below headers of any length."""

import codecs
import csv
import datetime
import io
import pathlib
import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._quantity import TIME
from ._record_columns import looks_named
from ._record_error import RecordError
from ._record_table import FORCE, Column, Table, header_rate, is_unit, split_unit

_HEAD_BYTES = 1 << 20
_BLOCK_BYTES = 1 << 24
# Consecutive rows after which a table needs no further evidence.
_CERTAIN = 50
# None stands for any number of blanks. A blank within a cell must not be one before
# the other signs were tried.
_DELIMITERS = ("\t", ";", ",", None)
_CLOCK = re.compile(
    r"(?:(\d{4})-(\d\d)-(\d\d)[T ])?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d*)?)"
)
_COMMENT_SIGNS = "#%"


class _Layout(NamedTuple):
    """How the rows of a table are written."""

    start: int  # index of the first row among the lines of the head
    delimiter: str | None
    width: int
    has_decimal_comma: bool
    has_closing_delimiter: bool


def read_text(path: pathlib.Path) -> Table:
    """Return the columns of a text file.

    Raises:
        RecordError: If no table with a header is in it.
        OSError: If the file cannot be read.
    """
    with path.open("rb") as file:
        stream, encoding = _decoded(file, str(path))
        head = stream.read(_HEAD_BYTES)
        if b"\n" not in head:
            # Old Macintosh programs end lines with a carriage return alone.
            stream = io.BytesIO((head + stream.read()).replace(b"\r", b"\n"))
            head = stream.read(_HEAD_BYTES)
        lines = head.decode(encoding, errors="replace").split("\n")
        if len(head) == _HEAD_BYTES:
            lines.pop()
        lines = [line.rstrip("\r") for line in lines]
        layout = _layout(lines)
        if layout is None:
            raise RecordError(
                str(path),
                [
                    "found no table of numbers; needed are rows of at least two "
                    "columns, separated by tabs, semicolons, commas or blanks."
                ],
            )
        labels, start, fault = _labels(lines, layout)
        if fault:
            raise RecordError(str(path), [fault])
        # Odd rows may stand between the names and the longest run of good rows.
        start = start or layout.start
        stream.seek(sum(len(line) + 1 for line in head.split(b"\n")[:start]))
        values, notes = _values(stream, layout)
    columns = [
        Column(name, unit, lambda place=place: values[:, place])
        for place, (name, unit) in enumerate(labels)
    ]
    return Table(columns, header_rate(lines[:start]), notes=tuple(notes))


def _decoded(file: io.BufferedIOBase, name: str) -> tuple[io.BufferedIOBase, str]:
    """Return a stream whose rows are ASCII, without a byte order mark."""
    begin = file.read(4096)
    file.seek(0)
    for mark, encoding in (
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
    ):
        if begin.startswith(mark):
            text = file.read()[len(mark) :].decode(encoding, errors="replace")
            return io.BytesIO(text.encode()), "utf-8"
    # Half of plain text in UTF-16 is zero, and always the same half.
    for encoding, zero, text in (
        ("utf-16-le", begin[1::2], begin[::2]),
        ("utf-16-be", begin[::2], begin[1::2]),
    ):
        if zero.count(b"\0") > 0.9 * len(zero) > 0 and b"\0" not in text:
            rows = file.read().decode(encoding, errors="replace")
            return io.BytesIO(rows.encode()), "utf-8"
    if b"\0" in begin:
        raise RecordError(
            name,
            [
                "found a binary file; allowed are text, .tdms, .mat and .nc (export "
                "DynoWare's .dwd as text)."
            ],
        )
    if begin.startswith(codecs.BOM_UTF8):
        return io.BytesIO(file.read()[len(codecs.BOM_UTF8) :]), "utf-8"
    # A character may be cut at the end of what was looked at.
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        return file, "latin-1"
    return file, "utf-8"


def _layout(lines: list[str]) -> _Layout | None:
    """Return where the longest table in the head starts and how it is written."""
    best: _Layout | None = None
    most = 0
    for delimiter in _DELIMITERS:
        start, count, width = 0, 0, 0
        for index, line in enumerate(lines):
            now = _numeric_width(line, delimiter)
            if now and count and now == width:
                count += 1
            else:
                start, count, width = index, int(now > 0), now
            # The sign tried first wins if a later one does not do better.
            if count > most and (width >= 2):
                most = count
                best = _Layout(start, delimiter, width, False, False)
            if count >= _CERTAIN:
                break
        if most >= _CERTAIN:
            break
    if best is None:
        return None
    rows = lines[best.start : best.start + most]
    return best._replace(
        has_decimal_comma=best.delimiter != "," and any("," in row for row in rows),
        has_closing_delimiter=best.delimiter is not None
        and all(row.rstrip(" ").endswith(best.delimiter) for row in rows),
    )


def _cells(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, quotes removed."""
    if delimiter is None:
        return line.split()
    if '"' in line:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    else:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


def _numeric_width(line: str, delimiter: str | None) -> int:
    """Return the number of cells of a row of numbers, 0 for any other line."""
    cells = _cells(line, delimiter)
    if len(cells) > 1 and not cells[-1]:
        cells = cells[:-1]
    filled = [cell for cell in cells if cell]
    if len(filled) < 2 or not all(_is_number(cell, delimiter) for cell in filled):
        return 0
    return len(cells)


def _is_number(cell: str, delimiter: str | None) -> bool:
    return bool(cell) and (
        not np.isnan(_number(cell)) or cell.lower() in ("nan", "-nan", "n/a", "na")
    )


def _number(cell: str) -> float:
    """Return the number in a cell, a time of day in seconds, or NaN."""
    try:
        # Python allows 1_000, which no program writes.
        return float("nan") if "_" in cell else float(cell.replace(",", "."))
    except ValueError:
        pass
    match = _CLOCK.fullmatch(cell)
    if match is None:
        return float("nan")
    year, month, day, hour, minute, second = match.groups()
    days = 0
    if year:
        try:
            days = datetime.date(int(year), int(month), int(day)).toordinal()
        except ValueError:
            return float("nan")
        # Seconds since 2000 keep more digits than seconds since the year 1.
        days -= datetime.date(2000, 1, 1).toordinal()
    return (
        days * 86400.0
        + int(hour) * 3600.0
        + int(minute) * 60.0
        + float(second.replace(",", "."))
    )


def _labels(
    lines: list[str], layout: _Layout
) -> tuple[list[tuple[str, str]], int, str | None]:
    """Return names and units of the columns, the line after them, and a fault."""
    width = layout.width
    units, unit_row = [""] * width, None
    is_nearest = True
    for index in range(layout.start - 1, -1, -1):
        row = _label_row(lines[index], layout)
        if row is None or any(_is_number(cell, layout.delimiter) for cell in row):
            is_nearest = is_nearest and not lines[index].strip()
            continue
        bare = [cell.strip("[](){}<>") for cell in row]
        if unit_row is None and any(is_unit(cell, FORCE) for cell in bare):
            units, unit_row = bare, index
            continue
        labels = [split_unit(cell, FORCE, TIME) for cell in row]
        is_sure = looks_named([name for name, _ in labels])
        if unit_row is not None or is_sure or (is_nearest and layout.delimiter):
            named = zip(labels, units, strict=True)
            end = max(index, unit_row or 0) + 1
            return [(name, unit or other) for (name, unit), other in named], end, None
        is_nearest = False
    fault = None
    above = [len(_cells(line, ",")) for line in lines[: layout.start]]
    if layout.delimiter == "," and any(2 * w - width in (0, 1) for w in above if w > 2):
        fault = (
            f"the rows have {width} values, twice as many as the header has names: "
            "decimal commas need another sign between the columns."
        )
    return [(f"column {place}", "") for place in range(1, width + 1)], 0, fault


def _label_row(line: str, layout: _Layout) -> list[str] | None:
    """Return a line as one label per column, or None if it is not such a line."""
    text = line.strip().lstrip(_COMMENT_SIGNS).strip(" \r")
    if not text or _numeric_width(text, layout.delimiter):
        return None
    by_blanks = re.split(r"\s+(?![\[({<])", text)
    for cells in (
        _cells(text, layout.delimiter) if layout.delimiter else by_blanks,
        *(_cells(text, other) for other in ("\t", ";", ",")),
        re.split(r"\s{2,}", text),
        by_blanks,
    ):
        # A last column may be named but empty, or closed by a sign of its own.
        if len(cells) == layout.width + 1:
            cells = cells[:-1]
        if len(cells) == layout.width:
            return cells
    return None


def _values(
    stream: io.BufferedIOBase, layout: _Layout
) -> tuple[Float[np.ndarray, "row column"], list[str]]:
    """Return the table, and what of it was no row."""
    blocks: list[np.ndarray] = []
    odd: list[str] = []
    while block := stream.read(_BLOCK_BYTES):
        block += stream.readline()
        table = _fast(block, layout)
        if table is None:
            table = _slow(block, layout, odd)
        blocks.append(table)
    notes = []
    if odd:
        shown = ", ".join(f"`{line[:40]}`" for line in odd[:3])
        notes.append(f"{len(odd)} lines are no rows and were left out: {shown}.")
    return np.concatenate(blocks), notes


def _fast(block: bytes, layout: _Layout) -> Float[np.ndarray, "row column"] | None:
    """Return the rows of a block that holds nothing but numbers, else None."""
    if layout.has_decimal_comma:
        block = block.replace(b",", b".")
    if not block.strip():
        return np.zeros((0, layout.width))
    try:
        table = np.loadtxt(
            io.BytesIO(block),
            delimiter=layout.delimiter,
            comments=None,
            quotechar='"',
            usecols=range(layout.width) if layout.has_closing_delimiter else None,
            ndmin=2,
        )
    except ValueError:
        return None
    return table if table.shape[1] == layout.width else None


def _slow(
    block: bytes, layout: _Layout, odd: list[str]
) -> Float[np.ndarray, "row column"]:
    """Return the rows of a block line by line; cells without a number are NaN."""
    rows = []
    for line in block.decode("latin-1").splitlines():
        if not line.strip():
            continue
        cells = _cells(line, layout.delimiter)
        if len(cells) == layout.width + 1 and not cells[-1]:
            cells.pop()
        row = [_number(cell) for cell in cells]
        if len(row) == layout.width and not np.all(np.isnan(row)):
            rows.append(row)
        else:
            odd.append(line.strip())
    return np.array(rows).reshape(-1, layout.width)
