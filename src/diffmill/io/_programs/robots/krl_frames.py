"""Base and tool of a KRL program: which are in force, and which a motion has used."""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ....toolpath import Point
from ..geometry import rotation_of_abc, rpy_of_rotation, tool_rotation
from .krl_values import KrlValues
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
_UNKNOWN = "its numbers are not in the program"
_NULL: Frame = dict.fromkeys("XYZABC", 0.0)


class FrameData(NamedTuple):
    """FDAT data of an inline form: numbers of tool and base, None where it states none.

    Attributes:
        tool: Number of the tool.
        base: Number of the base.
        is_external: Whether the work moves about a tool that stands.
    """

    tool: int | None
    base: int | None
    is_external: bool

    @classmethod
    def of(cls, text: str) -> "FrameData":
        """Return data such as {TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}."""
        tool, base = _TOOL.search(text), _BASE.search(text)
        return cls(
            None if tool is None else int(tool[1]),
            None if base is None else int(base[1]),
            _EXTERNAL.search(text) is not None,
        )


class ChosenFrames(NamedTuple):
    """The frames in force.

    Attributes:
        base: The base; None for that in force before the program.
        line: The line that chose it.
        tool: The tool; None before the first.
        is_external: Whether the work moves about a tool that stands.
    """

    base: Frame | None = None
    line: int = 0
    tool: "KrlTool | None" = None
    is_external: bool = False


class KrlTool(NamedTuple):
    """A tool of a program.

    Attributes:
        name: As the program writes it.
        number: Its number; None if it is written out.
        frame: Its components; None where they are not in the program. A tool is known
            by them, if they are there.
    """

    name: str
    number: int | None
    frame: Frame | None

    @property
    def key(self) -> str:
        """Key of the tool: two tools of one key are the same."""
        if self.frame is None:
            return self.name
        return ",".join(f"{self.frame.get(key, 0.0):.6f}" for key in "XYZABC")


class KrlFrames:
    """Frames as a program chooses them; only what moves to a place has used them.

    A home position of joints often has a base and a tool of its own.

    Attributes:
        chosen: The frames in force.
    """

    def __init__(self, values: KrlValues) -> None:
        self._values = values
        self.chosen = ChosenFrames()
        self._used: ChosenFrames | None = None
        # Tools that have moved by what they are known by, and their numbers.
        self._tools: dict[str, KrlTool] = {}
        self._numbers: dict[str, int | None] = {}
        self._tool_at_work: KrlTool | None = None

    def choose_base(self, base: Frame, line: int) -> None:
        """Let a base hold."""
        # A position that serves as a base has status, turn and external axes, too.
        frame = {key: value for key, value in base.items() if key in "XYZABC"}
        self.chosen = self.chosen._replace(base=frame or base, line=line)

    def choose_tool(
        self, value: str, frames: KrlValues, frame: Frame | None = None
    ) -> None:
        """Let a tool hold: by number, by FDAT data, by a name, or written out.

        Args:
            value: What the program says.
            frames: The variables of the program.
            frame: Components of a tool that is written out.
        """
        name = "".join(value.upper().split())
        if numbered := _NUMBERED.fullmatch(name):
            tool = _numbered_tool(int(numbered[1]), frames)
        elif (data := self.named(value)) is not None and data.tool is not None:
            tool = _numbered_tool(data.tool, frames)
        else:
            frame = frames.frame(name) if frame is None else frame
            tool = KrlTool(name, None, _NULL if name == "$NULLFRAME" else frame)
        self.chosen = self.chosen._replace(tool=tool)

    def choose_external(self, is_external: bool) -> None:
        """Let the tool stand while the work moves, or the other way round."""
        self.chosen = self.chosen._replace(is_external=is_external)

    def is_undeclared(self, value: str) -> bool:
        """True if a value names data of an inline form that nobody declares."""
        return bool(_OF_DATA.fullmatch(value.strip())) and self.named(value) is None

    def named(self, value: str) -> FrameData | None:
        """Return the data that a value such as SBASE(FP1.BASE_NO) or FP1 names."""
        value = value.strip()
        if value.startswith("{"):
            return FrameData.of(value)
        named = _OF_DATA.fullmatch(value)
        text = self._values.data(named[1] if named else value)
        return FrameData.of(text) if text else None

    def choose_data(self, data: FrameData, frames: KrlValues, line: int) -> None:
        """Let tool and base of FDAT data hold."""
        if data.base is not None:
            self.choose_base(numbered_base(data.base, frames), line)
        if data.tool is not None:
            tool = _numbered_tool(data.tool, frames)
            self.chosen = self.chosen._replace(tool=tool)
        self.choose_external(data.is_external)

    def take(self, line: int, reader: Reader) -> None:
        """Use the frames in force for a motion: another tool begins a section."""
        if self.chosen.is_external:
            message = "a stationary tool while the work moves is not supported."
            reader.refuse(line, "IPO_FRAME #TCP", message)
        base = self.chosen.base
        if self._used is None and base is not None and not is_known(base):
            reader.out.note(next(iter(base)), _UNKNOWN, line)
        used = self.chosen if self._used is None else self._used
        if used.base != self.chosen.base:
            message = "a program with several bases is not supported; `work` is one."
            if used.base is None:
                message += " What moves before it is in a base that nobody states."
            reader.refuse(self.chosen.line, "base", message)
        self._used = self.chosen
        tool, before = self.chosen.tool, self._tool_at_work
        if tool is None or (before is not None and tool.key == before.key):
            return
        self._tool_at_work = tool
        if tool.key not in self._tools and tool.frame is None:
            reader.out.note(tool.name, _UNKNOWN, line)
        self._tools.setdefault(tool.key, tool)
        if before is None:
            self._numbers[tool.key] = tool.number
            if reader.out.moves:
                message = f"what moves before it is taken to be {tool.name} too"
                reader.out.note("tool", message, line)
            if tool.number is not None:
                reader.out.name_tool(tool.number)
            return
        if self._numbers[before.key] is None:
            # RAPID and KRL have no numbers of tools that are written out.
            self._number(before, 1, line, reader)
            reader.out.name_tool(1)
        if tool.key not in self._numbers:
            used = self._numbers.values()
            number = tool.number
            if number is None or number in used:
                number = next(n for n in range(1, len(used) + 2) if n not in used)
            self._number(tool, number, line, reader)
        reader.is_placed = reader.is_placed and not reader.out.moves
        reader.out.change_tool(self._numbers[tool.key] or 0, line)

    def _number(self, tool: KrlTool, number: int, line: int, reader: Reader) -> None:
        """Give a tool its number, and say so where the program has another name."""
        self._numbers[tool.key] = number
        if number != tool.number:
            reader.out.note(f"tool {number}", f"is {tool.name}", line)

    def base_pose(self) -> tuple[Point, Point] | None:
        """Position [m] and roll, pitch, yaw [rad] of `work` in the base of the robot.

        None if the program does not state them.
        """
        base = None if self._used is None else self._used.base
        if base is None or not is_known(base):
            return None
        position, R = _pose(base)
        return position, rpy_of_rotation(R)

    def tool_pose(
        self, number: int | None, reader: Reader
    ) -> tuple[Point, Point] | None:
        """Position [m] and roll, pitch, yaw [rad] of a tool in the flange.

        Its z is up the shank. None if the program does not state them.
        """
        keys = [key for key, own in self._numbers.items() if own == number]
        frame = self._tools[keys[0]].frame if keys else None
        if frame is None or not is_known(frame):
            return None
        position, R = _pose(frame)
        return position, rpy_of_rotation(tool_rotation(R, reader.tool_axis))


def is_known(frame: Frame) -> bool:
    """True if a frame has numbers, and not only a name."""
    return set(frame) <= set("XYZABC")


def _pose(frame: Frame) -> tuple[Point, Float[np.ndarray, "3 3"]]:
    """Position [m] and rotation of a frame."""
    x, y, z, a, b, c = (frame.get(key, 0.0) for key in "XYZABC")
    return (1e-3 * x, 1e-3 * y, 1e-3 * z), rotation_of_abc(a, b, c)


def _numbered_tool(number: int, frames: KrlValues) -> KrlTool:
    """Tool of a number: as declared, else known by its name."""
    name = f"TOOL_DATA[{number}]"
    return KrlTool(name, number, frames.frame(name) or (None if number else _NULL))


def numbered_base(number: int, frames: KrlValues) -> Frame:
    """Return the base of a number: as declared, else by its name."""
    if not number:
        return _NULL
    name = f"BASE_DATA[{number}]"
    return frames.frame(name) or {name: 0.0}
