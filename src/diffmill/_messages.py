"""Lists of faults that can be read, whatever the file is that they quote."""

from collections.abc import Sequence
from html import escape

# Characters of a line; a longer one loses what is in its middle.
_LONGEST = 600


def shown(faults: Sequence[str], most: int = 50) -> list[str]:
    """Return the first faults, long ones shortened, and a line if there are more.

    Args:
        faults: What is wrong, one line each.
        most: Number of faults that are shown.
    """
    lines = [_shortened(fault) for fault in faults[:most]]
    if len(faults) > most:
        lines.append("further faults are not listed.")
    return lines


def html_rows(text: str) -> str:
    """Table of lines as HTML, escaped: a name before a colon has a cell of its own."""
    rows = []
    for line in text.splitlines():
        name, colon, value = (part.strip() for part in line.partition(": "))
        cells = (name, value) if colon else ("", name)
        cells = "".join(f'<td style="text-align:left">{escape(x)}</td>' for x in cells)
        rows.append(f"<tr>{cells}</tr>")
    return f"<table>{''.join(rows)}</table>"


def printable(text: str) -> str:
    """Text for a terminal, which does not obey the control characters in it."""
    return "".join(
        letter
        if letter.isprintable() or letter in "\n\t"
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def _shortened(line: str) -> str:
    if len(line) <= _LONGEST:
        return line
    half = _LONGEST // 2
    return f"{line[:half]} ... {line[-half:]}"
