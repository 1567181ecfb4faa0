"""Base and tool of a KRL program: which are in force, and which a motion has used."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from .reader import Reader

_NUMBERED = re.compile(r"TOOL_DATA\s*\[\s*(\d+)\s*\]", re.IGNORECASE)
# Inline forms of spline motions name the data that hold their tool and base.
_OF_DATA = re.compile(
    r"(?:STOOL2|STOOL|SBASE|SIPO_MODE)\s*\(\s*(\w+)(?:\.\w+)?\s*\)", re.IGNORECASE
)
_TOOL = re.compile(r"TOOL_NO\s+(\d+)", re.IGNORECASE)
_BASE = re.compile(r"BASE_NO\s+(\d+)", re.IGNORECASE)
_EXTERNAL = re.compile(r"IPO_FRAME\s+#TCP\b", re.IGNORECASE)

Frame = dict[str, float]


class FrameData(NamedTuple):
    """What FDAT data of an inline form state: tool, base, and whether the tool stands.

    None where they state none.
    """

    tool: int | None
    base: int | None
    is_external: bool


class ChosenFrames(NamedTuple):
    """The frames in force.

    Attributes:
        base: The base; None before the first.
        line: The line that chose it.
        tool: Number of the tool; None if it has none.
        is_external: Whether the work moves about a tool that stands.
    """

    base: Frame | None = None
    line: int = 0
    tool: int | None = None
    is_external: bool = False


class KrlFrames:
    """Frames as a program chooses them; only what moves to a place has used them.

    A home position of joints often has a base and a tool of its own.

    Attributes:
        chosen: The frames in force.
    """

    def __init__(self) -> None:
        self.chosen = ChosenFrames()
        self._data: dict[str, FrameData] = {}
        self._used: Frame | None = None

    def declare(self, name: str, text: str) -> None:
        """Keep FDAT data, such as {TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}."""
        self._data[name.upper()] = _data(text)

    def choose_base(self, base: Frame, line: int) -> None:
        """Let a base hold."""
        self.chosen = self.chosen._replace(base=base, line=line)

    def choose_tool(self, value: str) -> None:
        """Let a tool hold, by number or by FDAT data; what is written out has none."""
        if found := _NUMBERED.fullmatch(value.strip()):
            self.chosen = self.chosen._replace(tool=int(found[1]))
        elif (data := self.named(value)) is not None and data.tool is not None:
            self.chosen = self.chosen._replace(tool=data.tool)

    def choose_external(self, is_external: bool) -> None:
        """Let the tool stand while the work moves, or the other way round."""
        self.chosen = self.chosen._replace(is_external=is_external)

    def named(self, value: str) -> FrameData | None:
        """Return the data that a value such as SBASE(FP1.BASE_NO) or FP1 names."""
        value = value.strip()
        if value.startswith("{"):
            return _data(value)
        found = _OF_DATA.fullmatch(value)
        return self._data.get((found[1] if found else value).upper())

    def choose_data(
        self, data: FrameData, frames: Mapping[str, Frame], line: int
    ) -> None:
        """Let tool and base of FDAT data hold."""
        if data.base is not None:
            self.choose_base(numbered_base(data.base, frames), line)
        if data.tool is not None:
            self.chosen = self.chosen._replace(tool=data.tool)
        self.choose_external(data.is_external)

    def take(self, line: int, reader: Reader) -> None:
        """Use the frames in force for a motion: another tool begins a section."""
        base, chosen_at, tool, is_external = self.chosen
        if is_external:
            message = "a tool that stands while the work moves is not supported."
            reader.refuse(line, "IPO_FRAME #TCP", message)
        if base is not None and self._used not in (None, base):
            message = "a program with several bases is not supported; `work` is one."
            reader.refuse(chosen_at, "base", message)
        self._used = self._used if base is None else base
        if tool is None or tool == reader.out.tool:
            return
        if reader.out.tool is None and reader.out.moves:
            message = f"what moves before it is taken to be tool {tool} too"
            reader.out.note("tool", message, line)
            reader.out.name_tool(tool)
            return
        reader.is_placed = reader.is_placed and not reader.out.moves
        reader.out.change_tool(tool, line)


def numbered_base(number: int, frames: Mapping[str, Frame]) -> Frame:
    """Return the base of a number: as declared, else by its name."""
    name = f"BASE_DATA[{number}]" if number else "$NULLFRAME"
    return frames.get(name, {name: 0.0})


def _data(text: str) -> FrameData:
    """Return what FDAT data state."""
    tool, base = _TOOL.search(text), _BASE.search(text)
    return FrameData(
        None if tool is None else int(tool[1]),
        None if base is None else int(base[1]),
        _EXTERNAL.search(text) is not None,
    )
