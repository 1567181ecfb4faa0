"""Layout of a text table: its rows, and the names of its columns."""

import csv
import datetime
import re
from typing import NamedTuple

import numpy as np

from ...units import (
    ACCELERANCE,
    ANGLE,
    FORCE,
    FREQUENCY,
    LENGTH,
    MOBILITY,
    RECEPTANCE,
    TIME,
)
from .quantity import has_quantity_names
from .table import ELECTRIC, Label, is_unit, split_unit

# Consecutive rows after which a table needs no further evidence: a header may hold
# tables of its own.
_CERTAIN_ROW_COUNT = 1000
# None stands for any number of blanks. A blank within a cell must not be one before
# the other signs were tried.
_DELIMITERS = ("\t", ";", ",", "|", None)
# A date with the year first or last, a time of day, or both.
_DATE = re.compile(
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
    r"|(?P<one>\d\d?)(?P<sign>[-/.])(?P<two>\d\d?)[-/.](?P<last>\d{4}))"
    r"(?:[T ]\s*(?=\d)|$)"
)
_CLOCK = re.compile(
    r"(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d*)?))?(?:\s*([AaPp])\.?[Mm]\.?)?"
    r"(?:Z|([+-])(\d\d):?(\d\d))?"
)
# Signs that part thousands: before the decimal sign, every three digits.
_THOUSANDS = {
    ",": re.compile(r"[+-]?\d{1,3}(?:,\d{3})+\.\d*"),
    ".": re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d*"),
}
_COMMENT_SIGNS = "#%"


class Layout(NamedTuple):
    """Layout of the rows of a table."""

    start: int  # index of the first row among the lines of the head
    delimiter: str | None
    width: int
    has_decimal_comma: bool
    has_closing_delimiter: bool
    thousands: str = ""  # what parts thousands, or nothing
    text: tuple[int, ...] = ()  # columns that hold words, from 0


def layout_of(lines: list[str]) -> Layout | None:
    """Layout of the longest table in the head of a file, None without a table."""
    best: Layout | None = None
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
            if count > most and width >= 2:
                most = count
                best = Layout(start, delimiter, width, False, False)
            if count >= _CERTAIN_ROW_COUNT:
                break
        if most >= _CERTAIN_ROW_COUNT:
            break
    if best is None:
        return None
    rows = lines[best.start : best.start + most]
    thousands = _thousands_in(rows, best.delimiter)
    return best._replace(
        has_decimal_comma=thousands != ","
        and best.delimiter != ","
        and any("," in row for row in rows),
        has_closing_delimiter=best.delimiter is not None
        and all(row.rstrip(" ").endswith(best.delimiter) for row in rows),
        thousands=thousands,
        text=_text_columns(rows, best),
    )


def _text_columns(rows: list[str], layout: Layout) -> tuple[int, ...]:
    """Return the columns in which no cell is a number, but some are words."""
    table = [cells_of(row, layout.delimiter)[: layout.width] for row in rows]
    return tuple(
        place
        for place, column in enumerate(zip(*table, strict=True))
        if any(column) and not any(_is_number(cell) for cell in column)
    )


def _thousands_in(rows: list[str], delimiter: str | None) -> str:
    """Return the sign that parts thousands in some cell, or nothing."""
    for sign, pattern in _THOUSANDS.items():
        other = ({",", "."} - {sign}).pop()
        for row in rows:
            if sign in row and other in row and sign != delimiter:
                if any(pattern.fullmatch(cell) for cell in cells_of(row, delimiter)):
                    return sign
    return ""


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, quotes removed."""
    if delimiter is None:
        return line.split()
    cells = line.split(delimiter)
    # The standard library refuses a longer one.
    if '"' in line and len(line) <= csv.field_size_limit():
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def _numeric_width(line: str, delimiter: str | None) -> int:
    """Return the number of cells of a row of numbers, 0 for any other line.

    Up to half of them may be words, such as a name or a state: of blanks nobody knows
    whether they part two cells or the words of one.
    """
    cells = cells_of(line, delimiter)
    if len(cells) > 1 and not cells[-1]:
        cells = cells[:-1]
    filled = [cell for cell in cells if cell]
    words = [cell for cell in filled if not _is_number(cell)]
    # Several numbers in a cell tell that the delimiter is another one.
    if words and (
        delimiter is None or any(all(map(_is_number, cell.split())) for cell in words)
    ):
        return 0
    count = len(filled) - len(words)
    return len(cells) if count >= max(2, len(words)) else 0


def _is_number(cell: str) -> bool:
    return bool(cell) and (
        not np.isnan(number_of(cell)) or cell.lower() in ("nan", "-nan", "n/a", "na")
    )


def number_of(cell: str) -> float:
    """Return the number in a cell, a date or a time of day in seconds, or NaN."""
    for sign, pattern in _THOUSANDS.items():
        if sign in cell and pattern.fullmatch(cell):
            cell = cell.replace(sign, "")
    try:
        # Python allows 1_000, which no program writes.
        return float("nan") if "_" in cell else float(cell.replace(",", "."))
    except ValueError:
        return _seconds_of(cell)


def _seconds_of(cell: str) -> float:
    """Return a date, a time of day or both in seconds, or NaN."""
    days, time_of_day = 0, cell
    date = _DATE.match(cell)
    if date is not None:
        first, second = date["one"], date["two"]
        if date["sign"] == "/":
            # With slashes the month comes first; if it cannot, the day does.
            month, day = (first, second) if int(first) <= 12 else (second, first)
        else:
            month, day = second, first
        parts = (date["last"] or date["year"], date["month"] or month)
        try:
            days = datetime.date(*map(int, (*parts, date["day"] or day))).toordinal()
        except ValueError:
            return float("nan")
        # Seconds since 2000 keep more digits than seconds since the year 1.
        days -= datetime.date(2000, 1, 1).toordinal()
        time_of_day = cell[date.end() :]
        if not time_of_day:
            return days * 86400.0
    clock = _CLOCK.fullmatch(time_of_day)
    if clock is None:
        return float("nan")
    hour, minute, second, half, sign, zone_hours, zone_minutes = clock.groups()
    hours = int(hour)
    if half is not None:
        hours = hours % 12 + 12 * (half in "Pp")
    seconds = float((second or "0").replace(",", "."))
    if sign is not None:
        east = int(zone_hours) * 3600.0 + int(zone_minutes) * 60.0
        seconds -= float(f"{sign}1") * east
    return days * 86400.0 + hours * 3600.0 + int(minute) * 60.0 + seconds


def header_of(lines: list[str], layout: Layout) -> tuple[list[Label], int]:
    """Labels of the columns of a table, and the line after them.

    Columns without a name are numbered; the line is 0 then.
    """
    width = layout.width
    units, unit_row = [""] * width, None
    is_nearest = True
    for index in range(layout.start - 1, -1, -1):
        row = _label_row(lines[index], layout)
        if row is None or any(_is_number(cell) for cell in row):
            is_nearest = is_nearest and not lines[index].strip()
            continue
        bare = [c[1:-1].strip() if _is_bracketed(c) else c for c in row]
        if unit_row is None and _are_units(row, bare):
            units, unit_row = bare, index
            continue
        labels = [split_unit(cell, FORCE, TIME) for cell in row]
        has_known_name = has_quantity_names([label.name for label in labels])
        if unit_row is not None or has_known_name or (is_nearest and layout.delimiter):
            named = zip(labels, units, strict=True)
            end = max(index, unit_row or 0) + 1
            return [Label(a.name, a.unit or unit) for a, unit in named], end
        is_nearest = False
    return [Label(f"column {place}", "") for place in range(1, width + 1)], 0


def _is_bracketed(cell: str) -> bool:
    return cell != "" and cell[0] in "[({<" and cell[-1] in "])}>"


def fault_of_header(lines: list[str], layout: Layout) -> str:
    """Fault of a table with decimal commas between commas, "" of any other."""
    above = [len(cells_of(line, ",")) for line in lines[: layout.start]]
    if layout.delimiter != "," or not any(
        2 * width - layout.width in (0, 1) for width in above if width > 2
    ):
        return ""
    return (
        f"found {layout.width} values in every row, twice as many as the header has "
        "names: decimal commas need another sign between the columns."
    )


def first_block(lines: list[str], layout: Layout) -> tuple[int, int]:
    """First line of the first block of a table, and the number of rows above it.

    Programs write the names anew before every cycle, the longest of which decided on
    the layout.

    Args:
        lines: The head of the file.
        layout: Layout of the rows of the longest block.

    Returns:
        The line after the first labels that are those of the table; the number of rows
        of this width before it, which belong to another table.
    """
    labels, end = header_of(lines, layout)
    stop = end or layout.start
    is_row = [
        _numeric_width(line, layout.delimiter) == layout.width for line in lines[:stop]
    ]
    begins = np.flatnonzero(np.diff(np.array(is_row, np.int64), prepend=0) > 0)
    for index in begins if end else ():
        others, start = header_of(lines, layout._replace(start=int(index)))
        if start and others == labels:
            return start, sum(is_row[:start])
    return stop, sum(is_row)


def _are_units(row: list[str], bare: list[str]) -> bool:
    """True if a row of labels, also given without brackets, holds units."""
    if any(is_unit(cell, FORCE) for cell in bare):
        return True
    filled = [(cell, text) for cell, text in zip(row, bare, strict=True) if text]
    responses = (RECEPTANCE, MOBILITY, ACCELERANCE)
    kinds = (TIME, FREQUENCY, ANGLE, LENGTH, *responses)
    return bool(filled) and (
        all(_is_bracketed(cell) for cell, _ in filled)
        or all(text in (*ELECTRIC, "g") or is_unit(text, *kinds) for _, text in filled)
    )


def _label_row(line: str, layout: Layout) -> list[str] | None:
    """Return a line as one label per column, or None if it is not such a line."""
    text = line.strip().lstrip(_COMMENT_SIGNS).strip(" \r")
    if not text or _numeric_width(text, layout.delimiter):
        return None
    by_blanks = re.split(r"\s+(?![\[({<])", text)
    for cells in (
        cells_of(text, layout.delimiter) if layout.delimiter else by_blanks,
        *(cells_of(text, other) for other in ("\t", ";", ",")),
        re.split(r"\s{2,}", text),
        by_blanks,
    ):
        # A last column may be named but empty, or closed by a sign of its own.
        if len(cells) == layout.width + 1:
            cells = cells[:-1]
        if len(cells) == layout.width:
            return cells
    return None
