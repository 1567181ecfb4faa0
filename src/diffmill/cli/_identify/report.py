"""The report of an identification: what the command prints and writes."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 88


class Report(NamedTuple):
    """Report of an identification.

    Attributes:
        lines: The summary for the terminal.
        toml: Lines of job tables.
        facts: Everything as numbers and texts, for `identified.json`.
        figures: What draws each figure, by the name of its file without suffix.
    """

    lines: list[str]
    toml: list[str]
    facts: dict[str, object]
    figures: Mapping[str, Callable[[], "Figure"]]


def noted(text: str, mark: str = "note") -> list[str]:
    """Return a sentence as lines behind a mark."""
    return textwrap.wrap(
        text, _WIDTH, initial_indent=f"{mark}: ", subsequent_indent="  "
    )


def all_noted(texts: Sequence[str], mark: str = "note") -> list[str]:
    """Return sentences as lines, each behind a mark."""
    return [line for text in texts for line in noted(text, mark)]
