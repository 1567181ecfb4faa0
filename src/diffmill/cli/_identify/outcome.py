"""Outcome of an identification for the command line."""

import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple


class Outcome(NamedTuple):
    """Outcome of an identification.

    Attributes:
        lines: The summary for the terminal.
        toml: Lines of job tables.
        facts: Everything as numbers and texts, for `identified.json`.
        draw: Writes the figures to a folder.
    """

    lines: list[str]
    toml: list[str]
    facts: dict[str, Any]
    draw: Callable[[pathlib.Path], None]
