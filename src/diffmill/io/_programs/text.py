"""The text of a program's file, of a bounded size."""

import codecs
import pathlib

import numpy as np

from .faults import Fault, ProgramError
from .limits import MOST_LINES

# Two million lines of a program in space have less.
MOST_BYTES = 250_000_000
# Bytes that tell how a text is encoded.
_HEAD_BYTES = 256


def read_text(path: pathlib.Path) -> str:
    """Return the text of a file; bytes that are no Unicode may stand in comments.

    Raises:
        ProgramError: If the file cannot be read, or is too large; no more of it than
            the largest size is read.
    """
    try:
        # What is no plain file tells no size, so that reading is bounded too.
        is_large = path.stat().st_size > MOST_BYTES
        with path.open("rb") as file:
            data = b"" if is_large else file.read(MOST_BYTES + 1)
    except OSError as error:
        reason = error.strerror or "unknown reason"
        fault = Fault(0, "", f"the file cannot be read: {reason}.")
        raise ProgramError(str(path), [fault]) from error
    if is_large or len(data) > MOST_BYTES:
        message = f"the file has more than {MOST_BYTES / 1e6:g} MB."
        raise ProgramError(path.name, [Fault(0, "", message)])
    return decoded(data)


def decoded(data: bytes) -> str:
    """Return text in UTF-16, as Windows writes it, or in UTF-8."""
    head = data[:_HEAD_BYTES]
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    # Without a mark, letters of a program leave every other byte 0.
    for offset, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(head) > 1 and not any(head[offset::2]) and all(head[1 - offset :: 2]):
            return data.decode(name, errors="replace")
    return data.decode("utf-8-sig", errors="replace")


def plain_number(value: float, digits: int = 12) -> str:
    """Return a number without an exponent, which G-code does not know."""
    return np.format_float_positional(
        value + 0.0, precision=digits, unique=False, fractional=False, trim="-"
    )


def split_lines(text: str, name: str) -> list[str]:
    """Return the lines of a program, their number bounded."""
    # A lone carriage return ends a line only where there is no line feed at all.
    end = "\n" if "\n" in text else "\r"
    if text.count(end) > MOST_LINES:
        message = f"the program has more than {MOST_LINES} lines."
        raise ProgramError(name, [Fault(0, "", message)])
    return text.split(end)
