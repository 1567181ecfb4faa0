"""TOML of an untrusted file: one reader, and the error that lists all faults of one.

Imports no JAX, so that a file that is no job is refused at once.
"""

import os
import pathlib
import re
import tomllib
from typing import Any, NamedTuple

from ._messages import shown

# Deeper than any table of ours, and shallower than what recursion over it endures.
_DEEPEST_LEVEL = 50
# Of a dotted key the standard library copies each beginning: a long one takes hours.
_KEY_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(
    rf"(?<![\w-])(?:{_KEY_PART}[ \t]*+\.[ \t]*+){{{_DEEPEST_LEVEL}}}"
)
_LARGEST_INTEGER = 2**63
_LARGEST_FILE = 1_000_000
# Messages of the reader of the standard library, and what the author of a file needs.
_PLACE = re.compile(r"(?P<fault>.*) \(at line (?P<line>\d+), column \d+\)")
_VALUE = (
    'a value is text in quotes such as "10 mm", a number, true, false, [...] or {...}'
)
_MEANINGS = {
    "Invalid value": _VALUE,
    "Expected newline or end of document after a statement": _VALUE,
    r"Illegal character '\n'": "a text ends with a quote in its own line",
    "Cannot overwrite a value": "a key may occur only once in its table",
    "Cannot declare": "a table may occur only once",
}
_TOO_DEEP = f"it is nested deeper than {_DEEPEST_LEVEL} levels"


class JobError(ValueError):
    """Raise when a job cannot be run; the message lists everything wrong with it.

    Attributes:
        file: The job file.
        problems: What is wrong, one line each: key or line, found, allowed.
    """

    def __init__(self, file: str | os.PathLike[str], problems: list[str]):
        self.file = os.fspath(file)
        self.problems = tuple(shown(problems))
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        lines = "".join(f"\n  - {problem}" for problem in self.problems)
        super().__init__(f"{self.file}: {count}:{lines}")


class TomlFile(NamedTuple):
    """Text and tables of a TOML file."""

    text: str
    tables: dict[str, object]


def read_toml(path: pathlib.Path) -> TomlFile:
    """Return a TOML file, read and checked."""
    try:
        if not path.is_file():
            found = "a folder" if path.is_dir() else "no such file"
            raise JobError(path, [f"found {found}; a job file (.toml) is required"])
        if path.stat().st_size > _LARGEST_FILE:
            raise JobError(
                path, ["found more than 1 MB; a job file (.toml) is required"]
            )
        data = path.read_bytes()
    except OSError as error:
        raise JobError(path, [f"cannot be read: {error}"]) from error
    try:
        tables = parse_toml(data)
    except ValueError as error:
        what = str(error)
        if path.suffix.lower() != ".toml":
            what = (
                f"found the suffix {path.suffix!r} and no TOML in it; a job file "
                "(.toml) is required, whose [program] file names the program"
            )
        raise JobError(path, [what]) from error
    return TomlFile(data.decode("utf-8-sig"), tables)


def parse_toml(data: bytes) -> dict[str, object]:
    """Return the tables of a TOML file.

    Args:
        data: The file, in UTF-8 with or without a byte order mark.

    Raises:
        ValueError: If it is not valid TOML, is nested deeper than 50 levels, or holds a
            whole number beyond 64 bits. The message says what was found.
    """
    text = ""
    try:
        text = data.decode("utf-8-sig")
        if _LONG_KEY.search(text):
            raise ValueError(f"a key has more than {_DEEPEST_LEVEL} parts")
        tables = tomllib.loads(text)
        _check(tables)
    except RecursionError:
        raise ValueError(f"found invalid TOML: {_TOO_DEEP}") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(_syntax_fault(text, str(error))) from error
    except ValueError as error:
        raise ValueError(f"found invalid TOML: {error}") from error
    return tables


def _syntax_fault(text: str, fault: str) -> str:
    """Fault of a text with its line, and the syntax that is allowed there.

    Args:
        text: The text.
        fault: Message of the reader of the standard library.
    """
    place = _PLACE.fullmatch(fault)
    if place is None:
        return f"found invalid TOML: {fault}"
    number = int(place["line"])
    line = text.split("\n")[number - 1].strip()
    meaning = next(
        (m for k, m in _MEANINGS.items() if place["fault"].startswith(k)), ""
    )
    return (
        f"line {number}: found invalid TOML, {line[:80]!r}; "
        f"{meaning or place['fault'][0].lower() + place['fault'][1:]}"
    )


def _check(tables: dict[str, Any]) -> None:
    """Refuse what is nested too deep, and whole numbers beyond 64 bits."""
    level: list[Any] = [tables]
    for _ in range(_DEEPEST_LEVEL):
        values = [
            value
            for one in level
            for value in (one.values() if isinstance(one, dict) else one)
        ]
        if any(
            isinstance(v, int) and not -_LARGEST_INTEGER <= v < _LARGEST_INTEGER
            for v in values
        ):
            raise ValueError("a whole number has more than 64 bits")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP)
