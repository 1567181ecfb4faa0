"""The text of a program's file, of a bounded size."""

import pathlib

from .faults import Fault, ProgramError

# Two million lines of a program in space have less.
MOST_BYTES = 250_000_000
MOST_LINES = 2_000_000


def read_text(path: pathlib.Path) -> str:
    """Return the text of a file; bytes that are no UTF-8 may stand in comments.

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
    return data.decode("utf-8-sig", errors="replace")


def split_lines(text: str, name: str) -> list[str]:
    """Return the lines of a program, their number bounded."""
    # A lone carriage return ends a line only where there is no line feed at all.
    end = "\n" if "\n" in text else "\r"
    if text.count(end) > MOST_LINES:
        message = f"the program has more than {MOST_LINES} lines."
        raise ProgramError(name, [Fault(0, "", message)])
    return text.split(end)
