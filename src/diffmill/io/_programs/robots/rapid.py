"""ABB RAPID: motion of a module, and of those beside it that it uses.

Read are routines with parameters, loops and branches on what the program itself knows,
MoveL, MoveC, MoveJ and MoveAbsJ, Offs, RelTool, speeds with V or T and under VelSet,
zones, tools and work objects, WaitTime.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ....toolpath import Point, Program
from ..expressions import (
    ExpressionError,
    Name,
    Value,
    Variable,
    Variables,
    split_arguments,
)
from ..faults import ProgramError
from ..geometry import (
    ToolAxis,
    ToolPlace,
    point_of,
    rotation_of_quaternion,
    rpy_of_rotation,
    tool_place,
    tool_rotation,
)
from ..limits import LARGEST_NUMBER, fault_of_length, fault_of_statement
from ..setup import ProgramSetup
from .language import Language, Statement
from .rapid_values import (
    LEAST_QUATERNION,
    Records,
    numbers_of,
    texts_of_rapid,
)
from .reader import ExternalAxes

_DECLARED = re.compile(
    r"(?:(?:LOCAL|TASK)\s+)*(?:CONST|PERS|VAR)\s+(\w+)\s+(\w+)\s*(?:\{([^{}]*)\})?"
    r"\s*(?::=\s*(.*))?",
    re.IGNORECASE | re.DOTALL,
)
_MOVE = re.compile(
    r"(Move[LJC](?:DO|AO|GO)?|MoveAbsJ|Trigg[LJC])\b\s*(?:\\Conc\s*,)?\s*(.*)",
    re.IGNORECASE | re.DOTALL,
)
_ASSIGNED = re.compile(r"(\w+(?:\s*[{.][^:]*)?)\s*:=\s*(.*)", re.DOTALL)
# Data may be long, other statements are as long as a line.
_LONG = re.compile(
    r"(?:(?:LOCAL|TASK)\s+)*(?:CONST|PERS|VAR)\b|\w+(?:\{[^{}]{,99}\})?\s*:=",
    re.IGNORECASE,
)
_COUNTED = re.compile(r"(Incr|Decr|Clear|Add)\s+([^,]+)(?:,\s*(.+))?", re.IGNORECASE)
_CALL = re.compile(r"([A-Z]\w*)\s*(.*)", re.IGNORECASE | re.DOTALL)
_FOR = re.compile(
    r"FOR\s+(\w+)\s+FROM\s+(.+?)\s+TO\s+(.+?)(?:\s+STEP\s+(.+?))?\s+DO", re.IGNORECASE
)
_HEAD = re.compile(
    r"(?:IF|ELSEIF|WHILE|TEST|CASE)\b\s*(.+?)\s*(?:THEN|DO|:)?"
    r"|(?:RETURN|GOTO)\b\s*(.+)",
    re.IGNORECASE,
)
_ROUTINE = re.compile(
    r"(?:LOCAL\s+)?(PROC|FUNC\s+\w+|TRAP)\s+(\w+)\s*(?:\((.*)\))?",
    re.IGNORECASE | re.DOTALL,
)
_RECORD = re.compile(r"(?:LOCAL\s+)?RECORD\b", re.IGNORECASE)
_CONTROL = {
    **dict.fromkeys(("ENDPROC", "ENDFUNC", "ENDTRAP"), "end routine"),
    **{word: word.lower() for word in ("RETURN", "IF", "WHILE", "ELSE", "GOTO")},
    **{f"END{word}": f"end {word.lower()}" for word in ("IF", "WHILE", "FOR")},
    **dict.fromkeys(("CASE", "DEFAULT"), "case"),
    **{"TEST": "choice", "ENDTEST": "end choice", "ELSEIF": "else if"},
}
# What a statement without a sign assigns.
_COUNTS = {"INCR": "{}+1", "DECR": "{}-1", "CLEAR": "0", "ADD": "{}+"}
_SPEED = re.compile(r"v(\d+)", re.IGNORECASE)
_ZONE = re.compile(r"Z\d+|FINE", re.IGNORECASE)
_OPTION = re.compile(r"\\(V|T)\s*:=\s*([^\\]*)", re.IGNORECASE)
_OVERRIDE = re.compile(r"VelSet\s+(.*)", re.IGNORECASE | re.DOTALL)
_WORK_OBJECT = re.compile(r"\\WObj\s*:=\s*(\w+)", re.IGNORECASE)
_STRING = re.compile(r'"[^"]*"')
# What no semicolon ends; a statement may follow it in its line.
_FRAME = re.compile(
    r"\s*(?:%%%|VERSION\s*:\s*1\b|LANGUAGE\s*:\s*ENGLISH\b|MODULE\s+\w+(?:\s*\([^()]*\))?"
    r"|(?:LOCAL\s+)?(?:PROC|FUNC\s+\w+)\s+\w+\s*\([^()]*\)|TRAP\s+\w+"
    r"|(?:LOCAL\s+)?RECORD\s+\w+"
    r"|(?:END(?:MODULE|PROC|FUNC|TRAP|IF|WHILE|FOR|TEST|RECORD)|ELSE|ERROR|UNDO|BACKWARD)\b"
    r"|(?:IF|ELSEIF)\b[^;]*?\bTHEN\b|(?:WHILE|FOR)\b[^;]*?\bDO\b"
    r"|(?:CASE\b[^:]*|DEFAULT|\w+)\s*:(?!=)|TEST\b[^;]*?(?=\s*$|\bCASE\b))\s*",
    re.IGNORECASE,
)
# What cannot change tool, place or arm; whatever is not among it is refused. That the
# controller may choose another way for its joints is left to the robot of a job.
_QUIET = re.compile(
    r"(SetDO|SetGO|SetAO|Set|Reset|PulseDO|TPWrite|TPErase|ConfL|ConfJ|SingArea"
    r"(?=\s*\\(?:Off|Wrist)\b)|AccSet|WaitRob|Stop|ClkReset|ClkStart|ClkStop|SyncMoveOn"
    r"|SyncMoveOff|WaitSyncTask|WaitDI|WaitDO|WaitUntil|TPReadFK|GripLoad|Break"
    r"|CirPathMode|PathAccLim|ActUnit|DeactUnit|EOffsOff|PDispOff|MotionSup"
    r"|Trigg(?:IO|Equip|Int))\b.*",
    re.IGNORECASE | re.DOTALL,
)
_WRIST = re.compile(r"SingArea\s*\\Wrist", re.IGNORECASE)
_EXTERNAL = tuple(f"external axis {letter}" for letter in "abcdef")
_WAIT = re.compile(r"WaitTime\s*(?:\\InPos\s*,\s*)?(.+)", re.IGNORECASE)
# Types of what a motion needs.
_OF_MOTION = frozenset(
    ["ROBTARGET", "SPEEDDATA", "NUM", "DNUM", "POS", "POSE", "ORIENT"]
)
# Speed of the predefined vmax [mm/s].
_VMAX = 5000.0
_PLAIN = ProgramSetup()


class _Rapid(Language):
    """State of the reader of RAPID."""

    def __init__(self, name: str, setup: ProgramSetup) -> None:
        super().__init__(name, setup)
        texts = texts_of_rapid(self._missing, self.result_of)
        self.use(texts, lambda row, line: _statement(row, line, self), "=")
        # Types of variables by name, and sizes of arrays.
        self.kinds: dict[str, str] = {}
        self.sizes: dict[str, list[float]] = {}
        self.records = Records()
        # Components of the record that is defined now; None outside of any.
        self.components: dict[str, str] | None = None
        # Counters of the loops that are open while the program is compiled.
        self.counters: list[str] = []
        self.frame: str | None = None
        # The work object that motions name.
        self.work_object: str | None = None
        self.tool_data: dict[str, _Data] = {}
        self.work_objects: dict[str, _Data] = {"wobj0": _Data(True, _IDENTITY_FRAME)}
        self.external_axes = ExternalAxes()
        # Numbers of tools by name, in the order in which motions use them.
        self.tools: dict[str, int] = {}
        self.first_tool, self.first_line = "", 0
        self.first_status: tuple[float, ...] = ()
        # Share of a programmed speed, and the largest that is left of it [m/s].
        self.override, self.fastest = 1.0, math.inf

    def _missing(self, name: Name) -> Value:
        """Value of a predefined speed or zone."""
        word = str(name)
        speed = _SPEED.fullmatch(word)
        if speed is not None or word == "VMAX":
            values = [_VMAX if speed is None else float(speed[1]), 500.0, 5e3, 1e3]
            return self.records.of("SPEEDDATA", values)
        if _ZONE.fullmatch(word):
            return word
        raise ExpressionError(word, "the program does not state its value.")


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
    text: str,
    *,
    name: str = "program.mod",
    setup: ProgramSetup = _PLAIN,
    modules: Mapping[str, str] = MappingProxyType({}),
) -> Program:
    """Return the moves of a RAPID module.

    Args:
        text: The module.
        name: Its name.
        setup: What the program does not say.
        modules: Texts of other modules of the task, by the names of their files.

    Raises:
        ProgramError: If anything but plain motion is found; up to 20 faults.
    """
    reader = _Rapid(name, setup)
    try:
        for file, more in {name: text, **modules}.items():
            before = reader.sources.count
            rows = reader.sources.lines(more, file, reader.out)
            reader.compile(
                _statements(rows, before), lambda row, line: _compile(row, line, reader)
            )
        reader.run(reader.sources.count, "MAIN")
        return _finished(text, reader)
    except ProgramError as error:
        raise reader.sources.located(error) from None


def _finished(text: str, reader: _Rapid) -> Program:
    """Program with the poses of its work object and its tools."""
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
            rpy = rpy_of_rotation(tool_rotation(R, reader.tool_axis))
            part = part._replace(tool_position=position, tool_rpy=rpy)
        sections.append(part)
    return dataclasses.replace(
        program,
        sections=tuple(sections),
        first_status=reader.first_status,
        tool_axis=reader.tool_axis,
    )


def _mask(match: re.Match[str]) -> str:
    return "_" * len(match[0])


def _statements(rows: list[str], before: int) -> Iterator[Statement]:
    """Yield the first line and the text of every statement.

    Args:
        rows: Lines of a module.
        before: Number of the lines before them.
    """
    begun, parts = 0, []
    for number, row in enumerate(rows, before + 1):
        pieces = [row.strip()]
        if "!" in row or ";" in row:
            # Signs in a string are none.
            masked = row if '"' not in row else _STRING.sub(_mask, row)
            bare, pieces = row[: (masked + "!").index("!")], []
            for piece in masked[: len(bare)].split(";"):
                pieces.append(bare[: len(piece)].strip())
                bare = bare[len(piece) + 1 :]
        for place, piece in enumerate(pieces):
            at = 0
            # Most are motions, which no frame is.
            is_inside = parts or piece.lstrip()[:4] == "Move"
            while not is_inside and (frame := _FRAME.match(piece, at)):
                yield Statement(number, frame[0].strip())
                at = frame.end()
            begun = begun if parts else number
            if text := piece[at:].strip():
                parts.append(text)
            if place < len(pieces) - 1:
                yield Statement(begun, " ".join(parts))
                parts = []
    if parts:
        yield Statement(begun, " ".join(parts))


def _compile(row: str, line: int, reader: _Rapid) -> None:
    """Append a statement to the code."""
    code, texts = reader.code, reader.texts
    word = re.match(r"\w*", row)[0].upper()  # pyright: ignore[reportOptionalSubscript]
    if (message := fault_of_length(row)) and not _LONG.match(row):
        reader.refuse(line, row, message)
    elif _MOVE.match(row):
        reader.let_matter()
        reader.add(line, row)
    elif reader.components is not None or _RECORD.match(row):
        _compile_record(row, line, reader)
    elif (
        not row
        or word in ("MODULE", "ENDMODULE", "VERSION", "LANGUAGE")
        or row.startswith("%%%")
    ):
        return
    elif routine := _ROUTINE.fullmatch(row):
        _compile_routine(routine, line, reader)
    elif word in ("ERROR", "UNDO", "BACKWARD"):
        # Handlers, up to the end of their routine, wait for what does not happen here.
        code.give_back(line)
    elif word == "EXIT":
        reader.let_matter()
        code.plain(line, lambda machine: machine.stop())
    elif loop := _FOR.fullmatch(row):
        _compile_loop(loop, line, reader)
    elif word == "IF" and not row.upper().endswith("THEN"):
        try:
            condition, rest = texts.split(row[2:])
        except ExpressionError as error:
            reader.refuse(line, row, str(error))
            return
        if re.match(r"IF\b", rest, re.IGNORECASE):
            reader.refuse(line, row, "an IF of one line has no other one in it.")
            return
        reader.compile_control("if", condition, line)
        if rest[:4].upper() == "THEN":
            # A condition of several lines goes on with the statement behind it.
            _compile(rest[4:].strip(), line, reader)
            return
        _compile(rest, line, reader)
        reader.branches.pop()
        code.end(line, ("if",))
    elif reader.compile_control(_CONTROL.get(word, ""), _value_of(row), line):
        if word == "ENDFOR" and reader.counters:
            name = reader.counters.pop()
            code.plain(line, lambda machine: machine.variables.show(name))
    elif re.fullmatch(r"\w+\s*:", row):
        reader.let_matter()
        code.label(reader.label(row[:-1].strip()))
    elif not reader.routine and _DECLARED.fullmatch(row):
        reader.attempt(line, row)
    else:
        if not (_QUIET.fullmatch(row) or word in ("WAITTIME", *reader.pass_over)):
            reader.let_matter()
        reader.add(line, row)


def _value_of(row: str) -> str:
    """Condition, values or label of a statement of control flow; "" without any."""
    head = _HEAD.fullmatch(row)
    return "" if head is None else head[1] or head[2]


def _compile_record(row: str, line: int, reader: _Rapid) -> None:
    """Begin or end a record, or take one of its components."""
    words = row.upper().removeprefix("LOCAL").split()
    if words[:1] == ["ENDRECORD"]:
        reader.components = None
    elif reader.components is None and len(words) == 2:
        reader.components = {}
        reader.records.define(words[1], reader.components)
    elif reader.components is not None and len(words) == 2:
        reader.components[words[1]] = words[0]
    else:
        reader.refuse(line, row, "a component of a record is a type and a name.")


def _compile_routine(match: re.Match[str], line: int, reader: _Rapid) -> None:
    """Append the begin of a PROC, FUNC or TRAP with its parameters."""
    name = match[2].upper()
    names: list[str] = []
    returned: list[str] = []
    for part in split_arguments((match[3] or "").upper().replace("\\", ",\\")):
        words = re.sub(r"\{[^{}]*\}", "", part).replace("\\", " ").split()
        if not words:
            continue
        names.append(words[-1])
        if words[0].startswith(("VAR", "PERS", "INO")):
            returned.append(words[-1])
        reader.kinds[words[-1]] = words[-2] if len(words) > 1 else ""
    reader.routine, reader.returned[name] = name, tuple(returned)
    reader.code.begin_routine(line, name, tuple(names))


def _compile_loop(match: re.Match[str], line: int, reader: _Rapid) -> None:
    """Append the begin of a FOR with a counter of its own; without STEP it is by 1."""
    texts, name = reader.texts, match[1].upper()
    first, last = texts.expression(match[2]), texts.expression(match[3])
    step = texts.expression(match[4]) if match[4] else None

    def one(variables: Variables) -> Value:
        a, b = first(variables), last(variables)
        is_back = isinstance(a, int | float) and isinstance(b, int | float) and b < a
        return -1 if is_back else 1

    # The counter hides a variable of its name, up to the end of the loop.
    reader.counters.append(name)
    reader.code.plain(line, lambda machine: machine.variables.hide(name))
    reader.code.begin_for(line, texts.place(name), first, last, step or one)


def _statement(row: str, line: int, reader: _Rapid) -> None:
    """Carry out one statement."""
    if message := fault_of_statement(row):
        reader.refuse(line, row, message)
    elif match := _MOVE.fullmatch(row):
        _move(match[1].lower(), match[2], line, reader)
    elif match := _DECLARED.fullmatch(row):
        _declare(match, line, reader)
    elif match := _ASSIGNED.fullmatch(row):
        _assign(match[1], match[2], line, reader)
    elif match := _COUNTED.fullmatch(row):
        place = match[2].strip()
        value = f"{place}+({match[3]})" if match[3] else _COUNTS[match[1].upper()]
        _assign(place, value.format(place), line, reader)
    elif match := _WAIT.fullmatch(row):
        reader.dwell(match[1], row, line)
    elif match := _OVERRIDE.fullmatch(row):
        _set_override(match[1], row, line, reader)
    elif match := _QUIET.fullmatch(row):
        sentence = "changes no path"
        if _WRIST.match(row):
            sentence = "where the wrist is straight, the controller may turn the tool"
        reader.out.note(match[1], sentence, line)
    elif not ((match := _CALL.fullmatch(row)) and _call(match, line, reader)):
        reader.refuse_statement(row, line, None if match is None else match[1])


def _call(match: re.Match[str], line: int, reader: _Rapid) -> bool:
    """Call a routine, or pass over what a job names; False if it is unknown."""
    name, texts = match[1].upper(), reader.texts
    routine = reader.code.routines.get(name)
    if routine is None:
        return reader.passes(match[1], line)
    own: dict[Name, Value] = dict.fromkeys(routine.parameters)
    back: dict[str, Variable] = {}
    places = list(routine.parameters)
    for part in split_arguments(match[2].replace("\\", ",\\")):
        option, _, value = part.partition(":=")
        if part.startswith("\\"):
            parameter, text = option[1:].strip().upper(), value
        elif part and places:
            parameter, text = places[0], part
        else:
            if part:
                reader.refuse_count(match[0], line, len(routine.parameters))
                return True
            continue
        places = [one for one in places if one != parameter]
        given = texts.value(text) if text.strip() else True
        own[parameter] = reader.records.of(reader.kinds.get(parameter, ""), given)
        if parameter in reader.returned[name]:
            back[parameter] = texts.place(text)

    def done(values: dict[Name, Value]) -> None:
        for parameter, place in back.items():
            place.set(texts.variables, values[parameter])

    reader.machine.call(name, own, done)
    return True


def _assign(place: str, value: str, line: int, reader: _Rapid) -> None:
    """Carry out an assignment.

    Raises:
        ExpressionError: If the value has a fault, or nothing can take it.
    """
    name, *parts = re.split(r"\s*[.{]", place.lower())
    for kind, known in (
        ("tooldata", reader.tool_data),
        ("wobjdata", reader.work_objects),
    ):
        if name not in known:
            continue
        before = known[name]
        if not parts:
            _store_data(kind, name, value, line, reader)
        if parts or (reader.out.moves and known[name] != before):
            message = (
                "a tool or a work object that changes is not supported; needed is "
            )
            reader.refuse(line, place, f"{message}another one, with its own name.")
        return
    texts, found = reader.texts, reader.texts.place(place)
    name = str(found.name(texts.variables))
    kind = reader.records.kind_of(reader.kinds.get(name, ""), found.path)
    # An index or a component takes a dimension away.
    sizes = reader.sizes.get(name, [])[len(found.path) :]
    new = reader.records.array_of(kind, sizes, texts.value(value))
    found.set(texts.variables, new)


def _declare(match: re.Match[str], line: int, reader: _Rapid) -> None:
    """Keep a variable; what is no value for a motion is left out."""
    kind, name, value = match[1].upper(), match[2].upper(), match[4]
    if kind in ("TOOLDATA", "WOBJDATA"):
        if value is not None:
            _store_data(kind.lower(), name.lower(), value, line, reader)
        return
    reader.kinds[name] = kind
    # Sizes may be constants.
    sizes = [reader.number(one) for one in (match[3] or "").split(",") if one.strip()]
    variables, reader.sizes[name] = reader.texts.variables, sizes
    shared = None if reader.is_running else variables.shared
    try:
        if value is None:
            variables.declare_array(name, sizes, reader.records.made(kind), shared)
            return
        start = reader.records.array_of(kind, sizes, reader.texts.value(value))
    except ExpressionError:
        if kind in _OF_MOTION:
            raise
        start = None
    variables.declare(name, start, shared)


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


def _pose(text: str, line: int, reader: _Rapid) -> list[float]:
    """Return the numbers of a target: a name, numbers, or one that is moved."""
    text, message = text.split("\\ID")[0].strip(), ""
    try:
        value = reader.records.of("ROBTARGET", reader.texts.value(text))
        numbers = numbers_of(value)
        if len(numbers) == 17 and max(map(abs, numbers)) <= LARGEST_NUMBER:
            return numbers
    except ExpressionError as error:
        message = f": {error}"
    needed = f"needed is a robtarget, 17 numbers up to {LARGEST_NUMBER:g}"
    reader.refuse(line, text, f"{needed}{message or '.'}")
    x, y, z = (1e3 * value for value in reader.position)
    return [x, y, z, 0.0, 1.0, *[0.0] * 12]


def _target(text: str, line: int, reader: _Rapid) -> ToolPlace:
    values = _pose(text, line, reader)
    x, y, z = (1e-3 * value for value in values[:3])
    if math.hypot(*values[3:7]) < LEAST_QUATERNION:
        reader.refuse(line, text, "the quaternion has no length.")
        return ToolPlace((x, y, z), reader.axis)
    axes = dict(zip(_EXTERNAL, values[11:17], strict=True))
    reader.external_axes.take(axes, line, reader)
    if not reader.first_status:
        reader.first_status = tuple(values[7:11])
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
    values = [reader.number(part) for part in split_arguments(text)]
    if len(values) != 2 or not all(0 < value < math.inf for value in values):
        message = "needed are percent and mm/s above 0, in numbers or declared ones."
        reader.refuse(line, row, message)
        return
    reader.override, reader.fastest = 1e-2 * values[0], 1e-3 * values[1]


def _pace(text: str, line: int, reader: _Rapid) -> float | None:
    """Set the feed of a motion; return its duration [s] if it states one."""
    option = _OPTION.search(text)
    name = text.split("\\")[0].strip().lower()
    value = math.nan if option is None else reader.number(option[2].strip())
    if option is not None and not 0 < value < math.inf:
        message = f"{option[1]} is above 0, in numbers or declared ones with + - * /."
        reader.refuse(line, text, message)
        return None
    if option is not None and option[1].upper() == "T":
        # VelSet leaves the time of a motion as it is.
        return value
    if option is not None:
        feed = 1e-3 * value
    elif (match := _SPEED.fullmatch(name)) and name.upper() not in reader.kinds:
        feed = 1e-3 * float(match[1])
    else:
        try:
            record = reader.records.of("SPEEDDATA", reader.texts.value(name))
            feed = 1e-3 * numbers_of(record)[0]
        except ExpressionError:
            message = "no speeddata of this name is declared as numbers."
            reader.refuse(line, text, message)
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
    if kind.startswith("trigg"):
        # What it sets off stands before the zone.
        kind = kind.replace("trigg", "move")
        del arguments[-3:-2]
    elif kind[5:] in ("do", "ao", "go"):
        # A signal and its value stand behind the tool.
        kind = kind[:5]
        del arguments[-2:]
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
        message = "a stationary tool while the robot holds the work is not supported."
        reader.refuse(line, name if not data.is_usual else frame, message)
    if work.moves_with_unit:
        sentence = "moves with a mechanical unit, which is taken to stand still"
        reader.out.note(frame, sentence, line)
