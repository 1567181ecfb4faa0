"""TOML of an untrusted file: one reader with one kind of error for all of them."""

import re
import tomllib
from typing import Any

# Deeper than any table of ours, and shallower than what recursion over it endures.
_DEEPEST = 50
# Of a dotted key the standard library copies each beginning: a long one takes hours.
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{_DEEPEST}}}")
_LARGEST = 2**63
_TOO_DEEP = f"it is nested deeper than {_DEEPEST} levels"


def parse_toml(data: bytes) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Args:
        data: The file, in UTF-8 with or without a byte order mark.

    Raises:
        ValueError: If it is not valid TOML, is nested deeper than 50 levels, or holds a
            whole number beyond 64 bits. The message says what was found.
    """
    try:
        text = data.decode("utf-8-sig")
        if _LONG_KEY.search(text):
            raise ValueError(f"a key has more than {_DEEPEST} parts")
        tables = tomllib.loads(text)
        _check(tables)
    except RecursionError:
        raise ValueError(f"found invalid TOML: {_TOO_DEEP}") from None
    except ValueError as error:
        raise ValueError(f"found invalid TOML: {error}") from error
    return tables


def _check(tables: dict[str, Any]) -> None:
    """Refuse what is nested too deep, and whole numbers beyond 64 bits."""
    level: list[Any] = [tables]
    for _ in range(_DEEPEST):
        values = [
            value
            for one in level
            for value in (one.values() if isinstance(one, dict) else one)
        ]
        if any(isinstance(v, int) and not -_LARGEST <= v < _LARGEST for v in values):
            raise ValueError("a whole number has more than 64 bits")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP)
