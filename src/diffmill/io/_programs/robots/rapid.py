"""ABB RAPID: plain motion of one module.

Read are robtarget, speeddata and constants of them, MoveL, MoveC, MoveJ and MoveAbsJ,
Offs, speeds with V or T and under VelSet, zones, tools and work objects, WaitTime, and
comments.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ....toolpath import Point, Program
from ..expressions import NUMBER, split_arguments, value_of
from ..faults import SHOWN_FAULTS
from ..geometry import (
    ToolAxis,
    ToolPlace,
    point_of,
    rotation_of_quaternion,
    rpy_of_rotation,
    tool_place,
    tool_rotation,
)
from ..limits import bounded_number, fault_of_statement
from ..text import split_lines
from .reader import ExternalAxes, Reader

_DECLARED = re.compile(
    r"(?:(?:LOCAL|TASK)\s+)?(?:CONST|PERS|VAR)\s+(\w+)\s+(\w+)\s*(?:\{\s*(\d+)\s*\})?"
    r"\s*(?::=\s*(.*))?",
    re.IGNORECASE | re.DOTALL,
)
_MOVE = re.compile(r"(MoveL|MoveJ|MoveC|MoveAbsJ)\s+(.*)", re.IGNORECASE | re.DOTALL)
_OFFSET = re.compile(r"(Offs|RelTool)\s*\((.*)\)", re.IGNORECASE | re.DOTALL)
_TURN = re.compile(r"\\(R[xyz])\s*:=\s*([^\\,]+)", re.IGNORECASE)
_ASSIGNED = re.compile(r"(\w+(?:\{\d+\})?)\s*:=\s*(.*)", re.DOTALL)
_COMPONENT = re.compile(r"(\w+)\.trans\.([xyz])\s*:=\s*(.*)", re.IGNORECASE)
_SPEED = re.compile(r"v(\d+)", re.IGNORECASE)
_OPTION = re.compile(r"\\(V|T)\s*:=\s*([^\\]*)", re.IGNORECASE)
_OVERRIDE = re.compile(r"VelSet\s+(.*)", re.IGNORECASE | re.DOTALL)
_WORK_OBJECT = re.compile(r"\\WObj\s*:=\s*(\w+)", re.IGNORECASE)
# What no semicolon ends; a statement may follow it in its line.
_FRAME = re.compile(
    r"\s*(?:MODULE\s+\w+(?:\s*\([^()]*\))?|PROC\s+\w+\s*\([^()]*\)"
    r"|(?:ENDMODULE|ENDPROC)\b|%%%|VERSION\s*:\s*1\b|LANGUAGE\s*:\s*ENGLISH\b)\s*",
    re.IGNORECASE,
)
# What cannot change tool, place or arm; whatever is not among it is refused. That the
# controller may choose another way for its joints is left to the robot of a job.
_QUIET = re.compile(
    r"(SetDO|SetGO|SetAO|Set|Reset|PulseDO|TPWrite|TPErase|ConfL|ConfJ|SingArea"
    r"(?=\s*\\(?:Off|Wrist)\b)|AccSet|WaitRob|Stop|ClkReset|ClkStart|ClkStop)\b.*",
    re.IGNORECASE | re.DOTALL,
)
_WRIST = re.compile(r"SingArea\s*\\Wrist", re.IGNORECASE)
_EXTERNAL = tuple(f"external axis {letter}" for letter in "abcdef")
_WAIT = re.compile(rf"WaitTime\s*(?:\\InPos\s*,\s*)?({NUMBER})", re.IGNORECASE)
# Speed of the predefined vmax [m/s].
_VMAX = 5.0
# A controller wants a length of 1.
_LEAST_QUATERNION = 1e-3


class _Rapid(Reader):
    """State of the reader of RAPID."""

    def __init__(self, tool_axis: ToolAxis) -> None:
        super().__init__(tool_axis=tool_axis)
        self.targets: dict[str, list[float]] = {}
        self.speeds: dict[str, float] = {"vmax": _VMAX}
        self.numbers: dict[str, float] = {}
        self.frame: str | None = None
        # The work object that motions name.
        self.work_object: str | None = None
        self.tool_data: dict[str, _Data] = {}
        self.work_objects: dict[str, _Data] = {"wobj0": _Data(True, _IDENTITY_FRAME)}
        self.external_axes = ExternalAxes()
        self.procedures, self.has_returned = 0, False
        # Numbers of tools by name, in the order in which motions use them.
        self.tools: dict[str, int] = {}
        self.first_tool, self.first_line = "", 0
        # Share of a programmed speed, and the largest that is left of it [m/s].
        self.override, self.fastest = 1.0, math.inf


# Place and quaternion of a frame that is its parent.
_IDENTITY_FRAME = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class _Data(NamedTuple):
    """Data of a tool or a work object.

    Attributes:
        is_usual: Whether the robot holds the tool, and does not hold the work.
        frames: Place [mm] and quaternion of one frame or of two, one in the other;
            None where they are no numbers.
        moves_with_unit: True if the work object moves with a mechanical unit.
    """

    is_usual: bool
    frames: tuple[float, ...] | None
    moves_with_unit: bool = False

    def pose(self) -> tuple[Point, Float[np.ndarray, "3 3"]] | None:
        """Position [m] and rotation, None where they are no numbers."""
        if self.frames is None:
            return None
        at, R = np.zeros(3), np.eye(3)
        for first in range(0, len(self.frames), 7):
            place, turn = self.frames[first : first + 3], self.frames[first + 3 :][:4]
            if not any(turn):
                return None
            at = at + R @ np.array(place)
            R = R @ rotation_of_quaternion(turn[0], turn[1], turn[2], turn[3])
        return point_of(1e-3 * at), R


def parse_rapid(
    text: str, *, name: str = "program.mod", tool_axis: ToolAxis = "z"
) -> Program:
    """Return the moves of a RAPID module.

    Args:
        text: The module.
        name: Name for messages.
        tool_axis: Axis of the controller's tool that points from the shank to the tip.

    Raises:
        ProgramError: If anything but plain motion is found; up to 20 faults.
    """
    reader = _Rapid(tool_axis)
    reader.out.name = name
    for line, statement in _statements(split_lines(text, name)):
        _statement(statement, line, reader)
        if len(reader.faults) > SHOWN_FAULTS:
            break
    reader.note_upright_axis()
    program = reader.out.finish(text)
    if reader.work_object is not None:
        data = reader.work_objects.get(reader.work_object)
        pose = None if data is None or data.moves_with_unit else data.pose()
        if pose is not None:
            position, R = pose
            program = dataclasses.replace(
                program, work_position=position, work_rpy=rpy_of_rotation(R)
            )
    sections = []
    for part in program.sections:
        names = [one for one, n in reader.tools.items() if part.tool in (None, n)]
        data = reader.tool_data.get(names[0]) if names else None
        pose = None if data is None else data.pose()
        if pose is not None:
            position, R = pose
            rpy = rpy_of_rotation(tool_rotation(R, tool_axis))
            part = part._replace(tool_position=position, tool_rpy=rpy)
        sections.append(part)
    return dataclasses.replace(program, sections=tuple(sections))


def _statements(rows: list[str]) -> Iterator[tuple[int, str]]:
    """Yield the first line and the text of every statement."""
    begun, parts = 0, []
    for number, row in enumerate(rows, 1):
        bare = re.sub(r'"[^"]*"', '""', row).split("!")[0].strip()
        pieces = bare.split(";")
        for place, piece in enumerate(pieces):
            at = 0
            while not parts and (frame := _FRAME.match(piece, at)):
                yield number, frame[0].strip()
                at = frame.end()
            begun = begun if parts else number
            if text := piece[at:].strip():
                parts.append(text)
            if place < len(pieces) - 1:
                yield begun, " ".join(parts)
                parts = []
    if parts:
        yield begun, " ".join(parts)


def _statement(row: str, line: int, reader: _Rapid) -> None:
    """Carry out one statement."""
    if not row:
        return
    if message := fault_of_statement(row):
        reader.refuse(line, row, message)
    elif _FRAME.fullmatch(row):
        reader.procedures += row.upper().startswith("PROC")
        if reader.procedures > 1:
            reader.refuse(line, row, "one PROC per module is read; write calls out.")
    elif reader.has_returned:
        reader.out.note("RETURN", "ends the program before these lines", line)
    elif row.upper() == "RETURN":
        reader.has_returned = True
    elif match := _DECLARED.fullmatch(row):
        _declare(match, line, reader)
    elif match := _MOVE.fullmatch(row):
        _move(match[1].lower(), match[2], line, reader)
    elif match := _COMPONENT.fullmatch(row):
        _set_component(match, line, reader)
    elif (match := _ASSIGNED.fullmatch(row)) and match[1].lower() in reader.targets:
        reader.targets[match[1].lower()] = _pose(match[2], line, reader)
    elif match := _WAIT.fullmatch(row):
        reader.out.dwell(float(match[1]), line, row)
    elif match := _OVERRIDE.fullmatch(row):
        _set_override(match[1], row, line, reader)
    elif match := _QUIET.fullmatch(row):
        sentence = "changes no path"
        if _WRIST.match(row):
            sentence = "where the wrist is straight, the controller may turn the tool"
        reader.out.note(match[1], sentence, line)
    else:
        reader.refuse(line, row, "is no plain motion and is not supported.")


def _declare(match: re.Match[str], line: int, reader: _Rapid) -> None:
    """Keep a constant that a motion may name."""
    kind, name, value = match[1].lower(), match[2].lower(), match[4]
    if kind == "robtarget" and match[3] is not None:
        count = int(match[3])
        parts = split_arguments((value or "").strip()[1:-1])
        if value is not None and len(parts) != count:
            reader.refuse(line, name, f"needed are {count} robtargets.")
        for index, part in enumerate(parts, 1):
            if value is not None:
                target = _numbers(part, 17, line, reader)
                reader.targets[f"{name}{{{index}}}"] = target
    elif value is None:
        if kind == "robtarget":
            reader.targets[name] = [math.nan] * 17
    elif kind == "robtarget":
        reader.targets[name] = _pose(value, line, reader)
    elif kind == "speeddata":
        reader.speeds[name] = 1e-3 * _numbers(value, 4, line, reader)[0]
    elif kind in ("tooldata", "wobjdata"):
        _store_data(kind, name, value, line, reader)
    elif kind in ("num", "dnum"):
        reader.numbers[name.upper()] = value_of(value, reader.numbers)


def _store_data(kind: str, name: str, value: str, line: int, reader: _Rapid) -> None:
    """Keep the data of a tool or a work object: who holds it, and where it is."""
    parts = value.replace("[", " ").replace("]", " ").upper().split(",")
    parts = [part.strip() for part in parts]
    first, flags = (1, 1) if kind == "tooldata" else (3, 2)
    holder, *others = parts[:flags]
    if not {holder, *others} <= {"TRUE", "FALSE"}:
        reader.refuse(line, value, f"{kind} begins with TRUE or FALSE.")
        return
    numbers = parts[first : first + (7 if kind == "tooldata" else 14)]
    try:
        frames = tuple(float(part) for part in numbers)
    except ValueError:
        frames = ()
    is_known = len(frames) in (7, 14) and all(map(math.isfinite, frames))
    is_usual = (holder == "TRUE") == (kind == "tooldata")
    data = _Data(is_usual, frames if is_known else None, others == ["FALSE"])
    (reader.tool_data if kind == "tooldata" else reader.work_objects)[name] = data


def _set_component(match: re.Match[str], line: int, reader: _Rapid) -> None:
    """Set a coordinate of a declared target."""
    name, value = match[1].lower(), value_of(match[3], reader.numbers)
    if name not in reader.targets or math.isnan(value):
        reader.refuse(line, match[0], "needed are a declared robtarget and a number.")
        return
    target = list(reader.targets[name])
    target["xyz".index(match[2].lower())] = value
    reader.targets[name] = target


def _numbers(text: str, count: int, line: int, reader: Reader) -> list[float]:
    """Return the numbers of nested lists, brackets aside."""
    parts = text.replace("[", " ").replace("]", " ").split(",")
    numbers = [bounded_number(part) for part in parts]
    if len(numbers) != count or any(map(math.isnan, numbers)):
        reader.refuse(line, text, f"needed are {count} numbers in brackets.")
        return [0.0] * 3 + [0.0, 0.0, 1.0, 0.0] + [0.0] * (count - 7)
    return numbers


def _pose(text: str, line: int, reader: _Rapid) -> list[float]:
    """Return the numbers of a target: a name, numbers, or one that is moved."""
    text = text.split("\\ID")[0].strip()
    if match := _OFFSET.fullmatch(text):
        return _moved(match, line, reader)
    if text.startswith("["):
        return _numbers(text, 17, line, reader)
    values = reader.targets.get(text.replace(" ", "").lower())
    if values is None or math.isnan(values[0]):
        reader.refuse(line, text, "no robtarget of this name is declared as numbers.")
        x, y, z = (1e3 * value for value in reader.position)
        return [x, y, z, 0.0, 1.0, *[0.0] * 12]
    return values


def _moved(match: re.Match[str], line: int, reader: _Rapid) -> list[float]:
    """Return a target moved along the axes of the work object, or of the tool."""
    from scipy.spatial.transform import Rotation

    turns = [(name.lower(), value) for name, value in _TURN.findall(match[2])]
    first, *moved = split_arguments(_TURN.sub("", match[2]))
    values = list(_pose(first, line, reader))
    way = np.array([value_of(part, reader.numbers) for part in moved if part])
    angles = {name[1]: value_of(value, reader.numbers) for name, value in turns}
    if way.shape != (3,) or not np.isfinite([*way, *angles.values()]).all():
        reader.refuse(line, match[0], "needed are a robtarget and 3 numbers.")
        return values
    is_turned = math.hypot(*values[3:7]) >= _LEAST_QUATERNION
    if match[1].lower() == "offs" or not is_turned:
        return [*(np.array(values[:3]) + way), *values[3:]]
    w, x, y, z = values[3:7]
    pose = Rotation.from_quat([x, y, z, w])
    place = np.array(values[:3]) + pose.apply(way)
    for axis in "xyz":
        pose = pose * Rotation.from_euler(axis, angles.get(axis, 0.0), degrees=True)
    x, y, z, w = pose.as_quat()
    return [*place.tolist(), float(w), float(x), float(y), float(z), *values[7:]]


def _target(text: str, line: int, reader: _Rapid) -> ToolPlace:
    values = _pose(text, line, reader)
    x, y, z = (1e-3 * value for value in values[:3])
    if math.hypot(*values[3:7]) < _LEAST_QUATERNION:
        reader.refuse(line, text, "the quaternion has no length.")
        return ToolPlace((x, y, z), reader.axis)
    axes = dict(zip(_EXTERNAL, values[11:17], strict=True))
    reader.external_axes.take(axes, line, reader)
    turn = _orientation(*values[3:7], tool_axis=reader.tool_axis)
    return turn._replace(tip=(x, y, z))


# Most moves of a program have the orientation of the one before.
@functools.lru_cache(maxsize=256)
def _orientation(
    w: float, x: float, y: float, z: float, *, tool_axis: ToolAxis
) -> ToolPlace:
    """Axis and x of our tool of a quaternion, at no place."""
    return tool_place((0.0, 0.0, 0.0), rotation_of_quaternion(w, x, y, z), tool_axis)


def _set_override(text: str, row: str, line: int, reader: _Rapid) -> None:
    """Apply VelSet: percent of the programmed speeds, and the largest one [mm/s]."""
    values = [value_of(part, reader.numbers) for part in split_arguments(text)]
    if len(values) != 2 or not all(0 < value < math.inf for value in values):
        message = "needed are percent and mm/s above 0, in numbers or declared ones."
        reader.refuse(line, row, message)
        return
    reader.override, reader.fastest = 1e-2 * values[0], 1e-3 * values[1]


def _pace(text: str, line: int, reader: _Rapid) -> float | None:
    """Set the feed of a motion; return its duration [s] if it states one."""
    option = _OPTION.search(text)
    name = text.split("\\")[0].strip().lower()
    value = math.nan if option is None else value_of(option[2], reader.numbers)
    if option is not None and not 0 < value < math.inf:
        message = f"{option[1]} is above 0, in numbers or declared ones with + - * /."
        reader.refuse(line, text, message)
        return None
    if option is not None and option[1].upper() == "T":
        # VelSet leaves the time of a motion as it is.
        return value
    if option is not None:
        feed = 1e-3 * value
    elif name.startswith("["):
        feed = 1e-3 * _numbers(name, 4, line, reader)[0]
    elif name in reader.speeds:
        feed = reader.speeds[name]
    elif match := _SPEED.fullmatch(name):
        feed = 1e-3 * float(match[1])
    else:
        reader.refuse(line, text, "no speeddata of this name is declared as numbers.")
        return None
    reader.set_feed(min(feed * reader.override, reader.fastest), text, line)
    return None


def _take_tool(name: str, line: int, reader: _Rapid) -> None:
    """Use a tool for a motion: another one begins a section.

    RAPID has no numbers of tools, and a program with one tool needs none.
    """
    tools, key = reader.tools, name.lower()
    if not tools:
        reader.first_tool, reader.first_line = name, line
    is_new = key not in tools
    number = tools.setdefault(key, len(tools) + 1)
    if len(tools) == 1:
        return
    if is_new and number == 2:
        reader.out.name_tool(1)
        reader.out.note(reader.first_tool, "is tool 1", reader.first_line)
    if is_new:
        reader.out.note(name, f"is tool {number}", line)
    if number != reader.out.tool:
        reader.is_placed = reader.is_placed and not reader.out.moves
        reader.out.change_tool(number, line)


def _move(kind: str, words: str, line: int, reader: _Rapid) -> None:
    """Carry out a motion."""
    arguments = split_arguments(words)
    count = 5 if kind == "movec" else 4
    if len(arguments) != count:
        reader.refuse(
            line, words, f"needed are {count} arguments: to, speed, zone, tool."
        )
        return
    if kind == "moveabsj":
        message = "goes to joint angles; the motion is taken up at the next position"
        reader.out.note("MoveAbsJ", message, line)
        reader.lose_place(line)
        return
    named = _WORK_OBJECT.search(arguments[-1])
    frame = "wobj0" if named is None else named[1].lower()
    if named is not None:
        reader.work_object = frame
    _check_holders(arguments[-1], frame, line, reader)
    if reader.frame not in (None, frame):
        message = "several work objects are not supported; `work` is one of them."
        reader.refuse(line, frame, message)
    reader.frame = frame
    _take_tool(arguments[-1].split("\\")[0].strip(), line, reader)
    point, axis, tool_x = _target(arguments[-4], line, reader)
    duration = _pace(arguments[-3], line, reader)
    if kind == "movec":
        if duration is not None:
            reader.refuse(line, arguments[-3], "an arc with a time is not supported.")
        through = _target(arguments[0], line, reader).tip
        reader.arc_to(through, point, axis, line, tool_x=tool_x)
        return
    if kind == "movej":
        reader.out.note("MoveJ", "is taken as a straight rapid move", line)
    is_rapid = kind == "movej"
    reader.line_to(
        point, axis, line, is_rapid=is_rapid, duration=duration, tool_x=tool_x
    )


def _check_holders(tool: str, frame: str, line: int, reader: _Rapid) -> None:
    """Refuse a robot that holds the work, and note work that a unit could move."""
    name = tool.split("\\")[0].strip()
    data = reader.tool_data.get(name.lower(), _Data(True, None))
    work = reader.work_objects.get(frame, _Data(True, None))
    if not (data.is_usual and work.is_usual):
        message = "a tool that stands while the robot holds the work is not supported."
        reader.refuse(line, name if not data.is_usual else frame, message)
    if work.moves_with_unit:
        sentence = "moves with a mechanical unit, which is taken to stand still"
        reader.out.note(frame, sentence, line)
