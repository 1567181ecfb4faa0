"""Measured records as text: tables of numbers below headers of any length."""

import codecs
import functools
import io
import itertools
import pathlib

import numpy as np
from jaxtyping import Float

from .table import Column, Label, RecordError, Table, header_rate
from .text_layout import (
    Layout,
    cells_of,
    fault_of_header,
    first_block,
    header_of,
    layout_of,
    number_of,
)

_HEAD_BYTES = 1 << 20
_BLOCK_BYTES = 1 << 24
# Blocks with odd lines are halved down to this size.
_SLOW_BYTES = 1 << 16
_MOST_COLUMNS = 1000
# Of a table of which every row counts: comments above it in which names are looked
# for, and rows that decide on its layout.
_COMMENTS_ABOVE, _HEAD_ROWS = 20, 5000
_NEEDED = (
    "needed are 2 rows or more of at least two columns, separated by tabs, semicolons, "
    "commas, bars or blanks."
)


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
        layout = layout_of(lines)
        if layout is None:
            raise RecordError(str(path), [f"found no table of numbers; {_NEEDED}"])
        labels = _labels_of(lines, layout, str(path))
        # Odd rows may stand between the names and the longest run of good rows.
        start, unread_count = first_block(lines, layout)
        stream.seek(sum(len(line) + 1 for line in head.split(b"\n")[:start]))
        odd: list[str] = []
        blocks: list[np.ndarray] = []
        while block := stream.read(_BLOCK_BYTES):
            blocks += _tables(block + stream.readline(), layout, odd)
        values, notes = np.concatenate(blocks), []
        if odd:
            shown = ", ".join(f"`{line[:40]}`" for line in odd[:3])
            notes.append(f"{len(odd)} lines are no rows and were left out: {shown}.")
        if unread_count:
            notes.append(
                f"{unread_count} rows of numbers above the table were not read."
            )
    columns = [
        Column(label.name, label.unit, lambda place=place: values[:, place])
        for place, label in enumerate(labels)
    ]
    return Table(columns, header_rate(lines[:start]), notes=tuple(notes))


def _labels_of(lines: list[str], layout: Layout, name: str) -> list[Label]:
    """Labels of the columns of a table.

    Raises:
        RecordError: If there are too many, or rows that do not suit them.
    """
    if layout.width > _MOST_COLUMNS:
        fault = f"found {layout.width} columns; at most {_MOST_COLUMNS} are read."
        raise RecordError(name, [fault])
    labels, end = header_of(lines, layout)
    if not end and (fault := fault_of_header(lines, layout)):
        raise RecordError(name, [fault])
    return labels


def strict_table(text: str, name: str, faults: list[str]) -> Table:
    """Return the columns of a text of which no row and no cell is left out.

    Empty lines, and comments behind a #, are no rows.

    Args:
        text: The text of the file.
        name: What messages call it.
        faults: Receives the lines that are no rows and, as soon as the values of a
            column are taken, its cells that are no numbers.

    Raises:
        RecordError: If no table with a header is in it.
    """
    filled = [(n, row) for n, row in enumerate(text.splitlines(), 1) if row.strip()]
    is_row = [not row.lstrip().startswith("#") for _, row in filled]
    first = is_row.index(True) if True in is_row else len(filled)
    # The names may be in a comment above the rows.
    above = filled[max(first - _COMMENTS_ABOVE, 0) : first]
    rows = [*above, *itertools.compress(filled[first:], is_row[first:])]
    if len(rows) == len(above):
        raise RecordError(name, ["the file is empty; needed is a header and 2 rows."])
    head = [row for _, row in rows[:_HEAD_ROWS]]
    layout = layout_of(head)
    if layout is None:
        fault = f"found no table of numbers, 0 rows of it; {_NEEDED}"
        raise RecordError(name, [fault])
    try:
        labels = _labels_of(head, layout, name)
    except RecordError as error:
        line = rows[layout.start][0]
        raise RecordError(
            name, [f"line {line}: {one}" for one in error.faults]
        ) from None
    start, unread_count = first_block(head, layout)
    if unread_count:
        line = rows[start - 1][0]
        faults.append(f"line {line}: found {unread_count} rows above its names.")
    lines, table = list[int](), list[list[str]]()
    for line, row in rows[start:]:
        cells = cells_of(row, layout.delimiter)
        if len(cells) == layout.width + 1 and not cells[-1]:
            cells.pop()
        if len(cells) == layout.width:
            lines.append(line)
            table.append(cells)
        else:
            fault = f"line {line}: found {len(cells)} values; the header has "
            faults.append(f"{fault}{layout.width} columns.")
    columns = [
        Column(
            label.name,
            label.unit,
            functools.partial(
                _strict_column,
                [cells[place] for cells in table],
                lines,
                f"column {place + 1} ({label.name})",
                layout,
                faults,
            ),
        )
        for place, label in enumerate(labels)
    ]
    header = rows[start - 1][0] if start else 0
    return Table(columns, header=header, lines=tuple(lines))


def _strict_column(
    cells: list[str], lines: list[int], name: str, layout: Layout, faults: list[str]
) -> Float[np.ndarray, " row"]:
    """Numbers of the cells of a column; what is none, or not finite, is a fault."""
    plain = cells
    if layout.thousands:
        plain = [cell.replace(layout.thousands, "") for cell in plain]
    if layout.has_decimal_comma:
        commas = [n for n, cell in zip(lines, plain, strict=True) if "," in cell]
        points = [
            n
            for n, cell in zip(lines, plain, strict=True)
            if "." in cell and "," not in cell
        ]
        if commas and points and not layout.thousands:
            faults.append(
                f"line {commas[0]}: found decimal commas, but points in line "
                f"{points[0]}; allowed is one of them."
            )
        plain = [cell.replace(",", ".") for cell in plain]
    try:
        values = np.array(plain, dtype=np.float64)
    except ValueError:
        values = np.array([number_of(cell) for cell in cells])
    for row in np.flatnonzero(~np.isfinite(values)):
        faults.append(
            f"line {lines[row]}, {name}: found `{cells[row]}`; allowed is a finite "
            "number such as 1.5."
        )
    return values


def _decoded(file: io.BufferedIOBase, name: str) -> tuple[io.BufferedIOBase, str]:
    """Stream whose rows are ASCII, without a byte order mark, and its encoding."""
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


def _tables(block: bytes, layout: Layout, odd: list[str]) -> list[np.ndarray]:
    """Rows of a block, read line by line only around lines that are no rows.

    Args:
        block: Whole lines of the file.
        layout: Layout of the rows.
        odd: Receives the lines that are no rows.
    """
    table = _fast(block, layout)
    if table is not None:
        return [table]
    middle = block.find(b"\n", len(block) // 2) + 1
    if len(block) <= _SLOW_BYTES or middle in (0, len(block)):
        return [_slow(block, layout, odd)]
    return _tables(block[:middle], layout, odd) + _tables(block[middle:], layout, odd)


def _fast(block: bytes, layout: Layout) -> Float[np.ndarray, "row column"] | None:
    """Return the rows of a block of numbers and columns of words, else None."""
    if layout.thousands:
        block = block.replace(layout.thousands.encode(), b"")
    if layout.has_decimal_comma:
        block = block.replace(b",", b".")
    if not block.strip():
        return np.zeros((0, layout.width))
    used = [place for place in range(layout.width) if place not in layout.text]
    try:
        table = np.loadtxt(
            io.BytesIO(block),
            delimiter=layout.delimiter,
            comments=None,
            quotechar='"',
            usecols=used if layout.has_closing_delimiter or layout.text else None,
            ndmin=2,
        )
    except ValueError:
        return None
    if table.shape[1] != len(used):
        return None
    whole = np.full((len(table), layout.width), np.nan)
    whole[:, used] = table
    return whole if layout.text else table


def _slow(
    block: bytes, layout: Layout, odd: list[str]
) -> Float[np.ndarray, "row column"]:
    """Return the rows of a block line by line; cells without a number are NaN."""
    rows = []
    for line in block.decode("latin-1").splitlines():
        if not line.strip():
            continue
        cells = cells_of(line, layout.delimiter)
        if len(cells) == layout.width + 1 and not cells[-1]:
            cells.pop()
        if layout.thousands:
            cells = [cell.replace(layout.thousands, "") for cell in cells]
        row = [number_of(cell) for cell in cells]
        if len(row) == layout.width and not np.all(np.isnan(row)):
            rows.append(row)
        else:
            odd.append(line.strip())
    return np.array(rows).reshape(-1, layout.width)
