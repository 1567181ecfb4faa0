"""KUKA Robot Language: motion from a .src file and the .dat file beside it.

Read are routines with parameters, loops and branches on what the program itself knows,
PTP, LIN, CIRC, their spline forms and SPLINE blocks with SPL, $BASE, $TOOL, $VEL.CP,
C_DIS and the like, WAIT SEC. A spline is a cubic one in time through its points.
"""

import dataclasses
import functools
import itertools
import math
import pathlib
import re
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ....toolpath import Point, Program
from ..expressions import (
    NUMBER,
    ExpressionError,
    Name,
    Value,
    split_arguments,
)
from ..faults import SHOWN_FAULTS, ProgramError
from ..geometry import (
    ToolAxis,
    ToolPlace,
    abc_of_rotation,
    controller_matrix,
    rotation_of_abc,
    tool_place,
)
from ..limits import (
    LARGEST_NUMBER,
    bounded_number,
    fault_of_length,
    fault_of_statement,
)
from ..setup import ProgramSetup
from ..sources import Folder
from ..text import read_text, split_lines
from .krl_frames import KrlFrames, is_known, numbered_base
from .krl_values import KrlValues
from .language import Language, Statement
from .reader import ExternalAxes

# Speed of the tip, alone or with the speeds at which the tool turns.
_VELOCITY = re.compile(r"\$VEL\s*(?:\.CP\s*)?=\s*(.+)", re.IGNORECASE)
_VELOCITIES = re.compile(
    r"\{\s*(?:\w+\s*:\s*)?(?:[^{}]*,)?\s*CP\s+([^{},]+)(?:,[^{}]*)?\}", re.IGNORECASE
)
_CP_OF_DATA = re.compile(r"SVEL_CP\s*\((.*)\)", re.IGNORECASE)
_BAS = re.compile(r"BAS\s*\(\s*#(\w+)\s*(?:,\s*(.*?)\s*)?\)", re.IGNORECASE)
_GLOBAL = re.compile(r"(?:DECL\s+)?GLOBAL\b", re.IGNORECASE)
# Data of inline forms: numbers of tool and base, and how the tool turns along a line.
_INLINE_DATA = re.compile(
    r"(?:GLOBAL\s+)?(?:DECL\s+)?(?:GLOBAL\s+)?[FL]DAT\s+(\w+)\s*=\s*(\{.*\})",
    re.IGNORECASE,
)
_DATA_IN_FORCE = re.compile(r"([LP])DAT_ACT\s*=\s*(.+)", re.IGNORECASE)
_ORIENTATION = re.compile(r"ORI_TYPE?\s+#(\w+)", re.IGNORECASE)
_OF_LINE_DATA = re.compile(r"S(ORI|CIRC)_TYP\s*\(\s*(\w+)\s*\)", re.IGNORECASE)
# Where the arm is, such as in PTP $AXIS_ACT: the motion goes nowhere.
_IN_PLACE = re.compile(r"\$(?:AXIS_ACT|POS_ACT)\b", re.IGNORECASE)
_HOME = re.compile(r"X?HOME\d*|\$H_POS|\$AXIS_HOME(?:\[\d+\])?", re.IGNORECASE)
_MOTION = re.compile(
    r"(PTP|LIN|CIRC|SPL|SPTP|SLIN|SCIRC)(_REL)?\s+(.*)", re.IGNORECASE | re.DOTALL
)
# A relative motion counts along the axes of the base, or of the tool.
_RELATIVE_TO = re.compile(r"\s*#(BASE|TOOL)\b", re.IGNORECASE)
_ANGLE = re.compile(rf"CA\s*=?\s*({NUMBER})", re.IGNORECASE)
_APPROXIMATION = re.compile(r"\s+C_(?:DIS|VEL|ORI|PTP|SPL)\b.*$", re.IGNORECASE)
_WITH = re.compile(r"(?:^|\s)WITH\s+", re.IGNORECASE)
_ASSIGNED = re.compile(r"\$(\w+(?:\.\w+)?)\s*=\s*(.+)", re.IGNORECASE)
_TIME = re.compile(
    rf"TIME_BLOCK\s+(START|PART\s*=\s*({NUMBER})|END\s*=\s*({NUMBER}))",
    re.IGNORECASE,
)
_WAIT = re.compile(r"WAIT\s+SEC\s+(.+)", re.IGNORECASE)
_CALL = re.compile(r"([A-Z_]\w*)\s*(?:\((.*)\))?", re.IGNORECASE)
_CALLED = re.compile(r"([A-Z_]\w*)\s*\(", re.IGNORECASE)
_ROUTINE = re.compile(
    r"(?:GLOBAL\s+)?DEF(?:FCT\s+[A-Z]\w*(?:\[\d*\])?)?\s+([A-Z_]\w*)\s*\((.*)\)",
    re.IGNORECASE,
)
_FOR = re.compile(r"FOR\s+([^=]+)=(.+?)\s+TO\s+(.+?)(?:\s+STEP\s+(.+))?", re.IGNORECASE)
_CONDITION = re.compile(
    r"(IF|WHILE|UNTIL|SWITCH|CASE|GOTO|RETURN)(?:\s+|(?=\())(.+?)(?:\s*\bTHEN)?",
    re.IGNORECASE,
)
# Where a routine can put a value back.
_PLACE = re.compile(r"[A-Z_]\w*(?:\s*[\[.][^()]*)?", re.IGNORECASE)
_CONTROL = {
    **dict.fromkeys(("END", "ENDFCT"), "end routine"),
    **{word: word.lower() for word in ("RETURN", "IF", "WHILE", "ELSE", "GOTO")},
    **{f"END{word}": f"end {word.lower()}" for word in ("IF", "WHILE", "FOR")},
    **dict.fromkeys(("CASE", "DEFAULT"), "case"),
    **{"SWITCH": "choice", "ENDSWITCH": "end choice", "ENDLOOP": "end do"},
}
_LABEL = re.compile(r"([A-Z_]\w*)\s*:", re.IGNORECASE)
# What cannot change tool, place or arm; whatever is not among it is refused.
_QUIET_DATA = (
    r"ACC|APO|VEL|ADVANCE|VEL_AXIS|ACC_AXIS|VEL_EXTAX|ACC_EXTAX|BWDSTART|H_POS|LOAD"
    r"|JERK|GEAR_JERK|OUT|ANOUT|FLAG|CYCFLAG|TIMER|TIMER_STOP"
)
_QUIET = re.compile(
    r"&.*|DEFDAT\b.*|ENDDAT|(?:EXT|EXTFCT|ENUM|SIGNAL|IMPORT)\b.*|INI|DECL\b.*"
    r"|(?:GLOBAL\s+)?INTERRUPT\b.*"
    r"|BAS\s*\(\s*#(?:INITMOV|ACC_CP|ACC_PTP|VEL_PTP|PTP_DAT|PTP_PARAMS|CP_DAT|FRAMES)"
    rf"\b.*\)|\$(?:{_QUIET_DATA})\b.*|PULSE\s*\(.*\)"
    r"|TRIGGER\b.*\bDO\s+\$(?:OUT|ANOUT)\b.*|CONTINUE|SET_CD_PARAMS\s*\(.*\)"
    r"|WAIT\s+FOR\b.*|ANOUT\s+(?:ON|OFF)\b.*|WAIT\s*\(.*\)",
    re.IGNORECASE,
)
_QUIET_WITH = re.compile(
    r"\$(?:ACC|APO|JERK|GEAR_JERK|VEL_AXIS|ACC_AXIS|VEL_EXTAX|ACC_EXTAX|LOAD"
    r"|COLLMON_TOL_PRO)\b.*",
    re.IGNORECASE,
)
_FRAMES = frozenset(["BASE", "TOOL", "IPO_MODE"])
# How the tool turns along a motion.
_TURNS = frozenset(["ORI_TYPE", "CIRC_TYPE"])
_EXTERNAL = frozenset(["E1", "E2", "E3", "E4", "E5", "E6"])
_CHOSEN_BY_BAS = frozenset(["VEL_CP", "CP_PARAMS", "BASE", "TOOL"])
_JOINTS = frozenset(["A1", "A2", "A3", "A4", "A5", "A6"])
# A spline is read as so many straight pieces between two of its points at most.
_MOST_PIECES = 64
_SPLINE_TOLERANCE = 0.1e-6
_KNOTS_AT_ONCE = 1000
# What a point may take on average, however many there are.
_FREE_PIECES = 4
_PLAIN, _NO_FOLDER = ProgramSetup(), Folder()


class _Krl(Language):
    """State of the reader of KRL."""

    def __init__(self, name: str, setup: ProgramSetup) -> None:
        super().__init__(name, setup)
        self.known = KrlValues(self._missing, self.result_of)
        self.use(self.known.texts, lambda row, line: _statement(row, line, self), "==")
        # An upright tool, until the program states an orientation.
        upright = controller_matrix(self.axis, None, self.tool_axis)
        self.upright = dict(zip("ABC", abc_of_rotation(upright), strict=True))
        self.values: dict[str, float] = dict.fromkeys("XYZ", 0.0) | self.upright
        self.is_turned = False
        self.first_angles: Point | None = None
        self.first_status: tuple[float, ...] = ()
        self.turns = {"ORI_TYPE": "VAR", "CIRC_TYPE": "BASE"}
        self.external, self.external_axes = dict[str, float](), ExternalAxes()
        self.base_and_tool = KrlFrames(self.known)
        self.spline: list[_Knot] | None = None
        # Feed, frames and turns outside of the spline block.
        self.outer_feed: float | None = None
        self.outer_frames = self.base_and_tool.chosen
        self.outer_turns = self.turns

    def _missing(self, name: Name) -> Value:
        """Value of a variable of the controller."""
        chosen = self.base_and_tool.chosen
        tool = None if chosen.tool is None else chosen.tool.frame
        frame = {"$BASE": chosen.base, "$TOOL": tool}.get(str(name))
        if name == "$POS_ACT" and self.is_placed:
            return {**self.values, **self.external}
        if name == "$VEL" and self.feed is not None:
            return {"CP": self.feed}
        if frame is not None and is_known(frame):
            return dict(frame)
        raise ExpressionError(str(name), "the program does not state its value.")


class _Knot:
    """A point of a spline block: where, how and how fast it is reached, which share."""

    __slots__ = ("feed", "kind", "line", "place", "share", "through")

    def __init__(self, place: ToolPlace, line: int, kind: str):
        self.place, self.line, self.kind = place, line, kind
        self.through, self.share = place.tip, math.nan
        self.feed: float | None = None


def parse_krl(
    text: str,
    *,
    name: str = "program.src",
    setup: ProgramSetup = _PLAIN,
    folder: Folder = _NO_FOLDER,
) -> Program:
    """Return the moves of a KRL program.

    Args:
        text: The .src file.
        name: Its name.
        setup: What the program does not say.
        folder: Folder with its .dat file, and with the files of routines that it calls.

    Raises:
        ProgramError: If anything but plain motion is found; up to 20 faults.
    """
    reader = _Krl(name, setup)
    try:
        _take_file(text, name, reader, folder)
        known = reader.code.routines.keys() | reader.pass_over
        # What is called may be in another file, which calls others in turn.
        while missing := reader.called.keys() - known:
            for routine in sorted(missing):
                file = folder.find([routine], [".src"])
                if file is not None and routine not in reader.code.routines:
                    _take_file(read_text(file), file.name, reader, folder)
            known |= missing | reader.code.routines.keys()
        reader.run(reader.sources.count, None)
        frames = reader.base_and_tool
        reader.note_upright_axis()
        program = reader.out.finish(text)
    except ProgramError as error:
        raise reader.sources.located(error) from None
    sections = []
    for part in program.sections:
        position, rpy = frames.tool_pose(part.tool, reader) or (None, None)
        sections.append(part._replace(tool_position=position, tool_rpy=rpy))
    position, rpy = frames.base_pose() or (None, None)
    return dataclasses.replace(
        program,
        sections=tuple(sections),
        work_position=position,
        work_rpy=rpy,
        first_angles=reader.first_angles,
        first_status=reader.first_status,
        tool_axis=reader.tool_axis,
    )


def _take_file(text: str, name: str, reader: _Krl, folder: Folder) -> None:
    """Read the data beside a file, and append its routines to the code.

    Raises:
        ProgramError: If the data have a fault, or there are more than are shown.
    """
    variables, before = reader.known.variables, reader.known.variables.file
    if reader.sources.count:
        variables.file = {}
    reader.code.file = variables.file
    stem = pathlib.PurePath(name).stem
    beside = folder.find([stem], [".dat"])
    rows = [] if beside is None else split_lines(read_text(beside), beside.name)
    for number, row in enumerate(rows, 1):
        bare = _bare(row)
        if message := fault_of_length(bare) or fault_of_statement(bare):
            reader.refuse(number, bare, message)
        elif not _declare_data(bare, number, reader):
            _assign(bare, number, reader)
        if len(reader.faults) > SHOWN_FAULTS:
            break
    if reader.faults:
        name = f"{stem}.dat" if beside is None else beside.name
        raise ProgramError(name, [one._replace(file=name) for one in reader.faults])
    begun = reader.sources.count + 1
    rows = reader.sources.lines(text, name, reader.out)
    bare = (Statement(number, _bare(row)) for number, row in enumerate(rows, begun))
    reader.compile(
        (one for one in bare if one.text), lambda row, line: _compile(row, line, reader)
    )
    if reader.routine:
        reader.code.end_routine(reader.sources.count)
    reader.routine, variables.file = "", before


def _compile(row: str, line: int, reader: _Krl) -> None:
    """Append a line to the code."""
    code, known = reader.code, reader.known
    if message := fault_of_length(row):
        reader.refuse(line, row, message)
        return
    if _MOTION.match(row):
        reader.let_matter()
        reader.add(line, row)
        return
    word = re.split(r"[\s(]", row, maxsplit=1)[0].upper()
    match = _CONDITION.fullmatch(row)
    value = match[2] if match else ""
    if routine := _ROUTINE.fullmatch(row):
        if reader.routine:
            code.end_routine(line)
        names = [
            part.split(":") for part in routine[2].upper().split(",") if part.strip()
        ]
        names = [[one.split("[")[0].strip() for one in part] for part in names]
        name = routine[1].upper()
        reader.returned[name] = tuple(one[0] for one in names if one[1:] != ["IN"])
        reader.routine = name
        code.begin_routine(line, name, tuple(one[0] for one in names))
    elif reader.compile_control(_CONTROL.get(word, ""), value, line):
        return
    elif loop := _FOR.fullmatch(row):
        try:
            counter = known.texts.place(loop[1])
        except ExpressionError as error:
            reader.refuse(line, row, str(error))
            return
        first, last, step = (
            known.texts.expression(one) if one else None for one in loop.groups()[1:]
        )
        assert first is not None and last is not None
        code.begin_for(line, counter, first, last, step)
    elif word in ("REPEAT", "LOOP"):
        code.begin_loop(line, kind="repeat" if word == "REPEAT" else "do")
    elif value and word == "UNTIL":
        code.end(line, ("repeat",), again=known.texts.expression(f"NOT ({value})"))
    elif word == "EXIT":
        reader.let_matter()
        code.leave(line)
    elif label := _LABEL.fullmatch(row):
        code.label(reader.label(label[1]))
    else:
        if not (_QUIET.fullmatch(row) or word in ("WAIT", "HALT", *reader.pass_over)):
            reader.let_matter()
            # Most statements of a program with parameters assign; few call.
            for name in _CALLED.findall(row) if "(" in row else ():
                reader.called.setdefault(name.upper())
        reader.add(line, row)


def _declare_data(row: str, line: int, reader: _Krl) -> bool:
    """Declare the data of a line; False if it declares nothing."""
    variables = reader.known.variables
    values = None if reader.is_running else variables.file
    if _GLOBAL.match(row):
        values = variables.shared
    try:
        if match := _INLINE_DATA.fullmatch(row):
            reader.known.declare_data(match[1], match[2], values)
            return True
        return reader.known.declare(row, values)
    except ExpressionError as error:
        reader.refuse(line, error.word or row, str(error))
        return True


def _assign(row: str, line: int, reader: _Krl) -> bool:
    """Carry out an assignment; False if a line is none."""
    try:
        return reader.known.assign(row)
    except ExpressionError as error:
        reader.refuse(line, row, str(error))
        return True


def _bare(row: str) -> str:
    """Return a line without its comment, with single blanks.

    A pattern that looks for blanks takes the square of their number otherwise.
    """
    return " ".join(row.split(";")[0].split())


def _statement(row: str, line: int, reader: _Krl) -> None:
    """Carry out one statement."""
    if message := fault_of_statement(row):
        reader.refuse(line, row, message)
        return
    # Most are motions.
    if match := _MOTION.fullmatch(row):
        _motion(match[1].upper(), match[3], line, reader, is_relative=bool(match[2]))
        return
    word = row.split()[0].split("(")[0].upper()
    if match := _VELOCITY.fullmatch(row):
        _set_speed(match[1], row, line, reader)
    elif (match := _ASSIGNED.fullmatch(row)) and match[1].upper() in _FRAMES:
        _set_frame(match[1].upper(), match[2], line, reader)
    elif match and match[1].upper() in _TURNS:
        _set_turn(match[1].upper(), match[2], line, reader)
    elif match := _DATA_IN_FORCE.fullmatch(row):
        data = reader.known.data(match[2]) or match[2]
        if turn := _ORIENTATION.search(data):
            _set_turn("ORI_TYPE", f"#{turn[1]}", line, reader)
    elif match := re.fullmatch(r"FDAT_ACT\s*=\s*(.+)", row, re.IGNORECASE):
        _set_frame("FDAT_ACT", match[1], line, reader)
    elif (match := _BAS.fullmatch(row)) and match[1].upper() in _CHOSEN_BY_BAS:
        _basic(match[1].upper(), match[2] or "", row, line, reader)
    elif word in ("SPLINE", "ENDSPLINE"):
        _spline(word, row, line, reader)
    elif match := _TIME.fullmatch(row):
        _time_block(match, line, reader)
    elif match := _WAIT.fullmatch(row):
        reader.dwell(match[1], row, line)
    elif _declare_data(row, line, reader) or _assign(row, line, reader):
        pass
    elif word == "HALT":
        reader.out.note("HALT", "waits for the operator, which takes no time", line)
    elif _QUIET.fullmatch(row):
        if not word.startswith(("&", "DEF", "END", "EXT", "INI", "DECL")):
            reader.out.note(re.split(r"[\s=(\[]", row)[0], "changes no path", line)
    elif not ((match := _CALL.fullmatch(row)) and _call(match, line, reader)):
        name = None if match is None else match[1].upper()
        reader.refuse_statement(row, line, name)


def _call(match: re.Match[str], line: int, reader: _Krl) -> bool:
    """Call a routine, or pass over what a job names; False if it is unknown."""
    name, machine = match[1].upper(), reader.machine
    routine = reader.code.routines.get(name)
    if routine is None:
        return reader.passes(name, line)
    # U(A[]) hands over a whole array.
    given = split_arguments(match[2]) if match[2] else []
    texts = [one.removesuffix("[]") for one in given]
    if len(texts) > len(routine.parameters):
        reader.refuse_count(match[0], line, len(routine.parameters))
        return True
    own: dict[Name, Value] = dict.fromkeys(routine.parameters)
    back: dict[str, str] = {}
    for parameter, text in zip(routine.parameters, texts, strict=False):
        if not text:
            continue
        try:
            own[parameter] = reader.known.texts.value(text)
        except ExpressionError as error:
            # What a routine gives back needs no value before.
            if parameter not in reader.returned[name]:
                reader.refuse(line, text, str(error))
        if parameter in reader.returned[name] and _PLACE.fullmatch(text):
            back[text] = parameter

    def done(values: dict[Name, Value]) -> None:
        for text, parameter in back.items():
            if values.get(parameter) is not None:
                reader.known.put(text, values[parameter])

    machine.call(name, own, done)
    return True


def _set_speed(value: str, row: str, line: int, reader: _Krl) -> None:
    """Set the feed [m/s] by what $VEL is set to."""
    value = value.strip()
    if match := _VELOCITIES.fullmatch(value):
        value = match[1]
    elif match := _CP_OF_DATA.fullmatch(value):
        value = split_arguments(match[1])[0]
    reader.set_feed(reader.number(value), row, line)


def _set_turn(name: str, value: str, line: int, reader: _Krl) -> None:
    """Set how the tool turns along a motion: $ORI_TYPE or $CIRC_TYPE."""
    value = value.strip()
    if match := _OF_LINE_DATA.fullmatch(value):
        stated = reader.known.data(match[2])
        data = re.search(rf"{match[1]}_TYPE?\s+#(\w+)", stated, re.IGNORECASE)
        usual = "#VAR" if name == "ORI_TYPE" else "#BASE"
        value = usual if data is None else f"#{data[1]}"
    word = value.upper().removeprefix("#")
    if word not in ("VAR", "CONSTANT", "JOINT", "BASE", "PATH"):
        message = (
            "allowed are #VAR, #CONSTANT and #JOINT, for a circle #BASE and #PATH."
        )
        reader.refuse(line, f"${name}={value}", message)
    elif word == "CONSTANT":
        sentence = "#CONSTANT: the tool keeps the orientation of the start"
        reader.out.note(f"${name}", sentence, line)
    elif word != "BASE":
        sentence = "ends are as stated; between them the tool turns evenly here"
        reader.out.note(f"${name}", sentence, line)
    reader.turns = reader.turns | {name: word}


def _set_frame(kind: str, value: str, line: int, reader: _Krl) -> None:
    """Choose base, tool, or both by the data of an inline form."""
    frames, value = reader.base_and_tool, value.strip()
    data = frames.named(value)
    if re.match(r"EK\b", value, re.IGNORECASE):
        message = "a base on a table that turns is not supported; `work` stands still."
        reader.refuse(line, value, message)
    elif kind == "TOOL" and frames.is_undeclared(value):
        reader.out.note(value[:40], "is not declared, so the tool stays as it is", line)
    elif kind == "TOOL":
        is_name = re.fullmatch(
            r"[$\w\s]+|TOOL_DATA\s*\[\s*\d+\s*\]", value, re.IGNORECASE
        )
        written = None if is_name else reader.known.frame(value)
        frames.choose_tool(value, reader.known, written)
    elif kind == "IPO_MODE":
        is_external = value.upper() == "#TCP" or (data is not None and data.is_external)
        frames.choose_external(is_external)
    elif kind == "FDAT_ACT" and data is None:
        message = f"{value[:40]} is not declared, so tool and base stay as they are"
        reader.out.note("FDAT_ACT", message, line)
    elif kind == "FDAT_ACT" and data is not None:
        frames.choose_data(data, reader.known, line)
    elif data is not None and data.base is not None:
        frames.choose_base(numbered_base(data.base, reader.known), line)
    else:
        name = "".join(value.upper().split())
        frame = reader.known.frame(value)
        frames.choose_base({name: 0.0} if frame is None else frame, line)


def _basic(kind: str, value: str, row: str, line: int, reader: _Krl) -> None:
    """Carry out BAS with a speed, a base or a tool."""
    if kind in ("VEL_CP", "CP_PARAMS"):
        _set_speed(value, row, line, reader)
        return
    number = reader.number(value)
    if not (number >= 0 and number == int(number)):
        reader.refuse(line, row, "needed is the number of a base or a tool.")
    elif kind == "BASE":
        base = numbered_base(int(number), reader.known)
        reader.base_and_tool.choose_base(base, line)
    else:
        name = f"TOOL_DATA[{number:.0f}]"
        reader.base_and_tool.choose_tool(name, reader.known)


def _set_with(text: str, line: int, reader: _Krl) -> None:
    """Apply what stands behind WITH, which holds for one motion or one block."""
    for part in split_arguments(text):
        match = _ASSIGNED.fullmatch(part)
        if match and match[1].upper() in ("VEL", "VEL.CP"):
            _set_speed(match[2], part, line, reader)
        elif match and match[1].upper() in _FRAMES:
            _set_frame(match[1].upper(), match[2], line, reader)
        elif match and match[1].upper() in _TURNS:
            _set_turn(match[1].upper(), match[2], line, reader)
        elif not _QUIET_WITH.fullmatch(part):
            reader.refuse(line, part, "is not supported behind WITH.")


def _pose(text: str, line: int, reader: _Krl) -> dict[str, float] | None:
    """Return the components of a position that is written out or declared."""
    pose = reader.known.frame(text)
    if not pose and _HOME.fullmatch(text):
        return dict.fromkeys(_JOINTS, 0.0)
    if not pose:
        reader.refuse(line, text, "no position of this name is declared as numbers.")
        return None
    if max(map(abs, pose.values())) > LARGEST_NUMBER:
        reader.refuse(line, text, f"a number is {LARGEST_NUMBER:g} at most.")
        return None
    return pose


def _motion(
    kind: str, words: str, line: int, reader: _Krl, *, is_relative: bool = False
) -> None:
    """Carry out a motion."""
    along = _RELATIVE_TO.search(words) if is_relative else None
    if along is not None:
        words = _RELATIVE_TO.sub("", words)
    words, *extra = _WITH.split(words, maxsplit=1)
    words = _APPROXIMATION.sub("", words).strip()
    parts = [words]
    if words.find("}") != len(words) - 1:
        parts = [part for part in split_arguments(words) if part]
    if len(parts) == 1 and _IN_PLACE.fullmatch(parts[0]):
        reader.out.note(parts[0], "stays where the arm is", line)
        return
    wanted = 2 if kind in ("CIRC", "SCIRC") else 1
    turn = _ANGLE.fullmatch(parts[-1]) if len(parts) == 3 and wanted == 2 else None
    parts = parts[:2] if turn is not None else parts
    if len(parts) != wanted:
        reader.refuse(line, words, f"{kind} needs {wanted} position(s).")
        return
    poses = [_pose(part, line, reader) for part in parts]
    stated = [pose for pose in poses if pose is not None]
    if len(stated) < wanted:
        return
    axes = {key: at for key, at in stated[-1].items() if key in _EXTERNAL}
    if is_relative and any(axes.values()):
        reader.refuse(line, words, "a relative motion of an external axis.")
    reader.external |= {} if is_relative else axes
    if not _JOINTS.isdisjoint(stated[-1]):
        message = "goes to joint angles; the motion is taken up at the next position"
        reader.out.note(kind, message, line)
        reader.lose_place(line)
        reader.is_turned = False
        reader.values |= reader.upright
        return
    if not reader.is_placed and not is_relative and {*"XYZ"} - set(stated[-1]):
        if reader.out.moves:
            message = "after a motion of joints or another tool, state X, Y and Z."
            reader.refuse(line, words, message)
    before = reader.feed, reader.base_and_tool.chosen, reader.turns
    if extra:
        _set_with(_APPROXIMATION.sub("", extra[0]), line, reader)
    reader.base_and_tool.take(line, reader)
    reader.external_axes.take(reader.external, line, reader)
    if is_relative:
        is_tool = along is not None and along[1].upper() == "TOOL"
        stated = [_moved(pose, is_tool, words, line, reader) for pose in stated]
    is_constant = reader.turns["ORI_TYPE"] == "CONSTANT" and reader.is_placed
    if kind not in ("PTP", "SPTP") and is_constant:
        if wanted == 2 and reader.turns["CIRC_TYPE"] == "PATH":
            message = "an orientation that follows the circle is not supported."
            reader.refuse(line, words, message)
        stated = [
            {key: value for key, value in pose.items() if key not in "ABC"}
            for pose in stated
        ]
    _take_orientation(stated[-1], line, reader)
    values = reader.values
    reader.values = values | stated[-1]
    place = _place(reader.values, reader)
    if reader.spline is not None:
        if turn is not None:
            reader.refuse(line, turn[0], "in a SPLINE block, leave CA out.")
        reader.spline.append(_Knot(place, line, kind))
        reader.spline[-1].through = _place(values | stated[0], reader).tip
        reader.spline[-1].feed = reader.feed
    elif kind in ("CIRC", "SCIRC"):
        angle = None if turn is None else math.radians(bounded_number(turn[1]))
        through, axis = _place(values | stated[0], reader).tip, place.axis
        reader.arc_to(through, place.tip, axis, line, angle=angle, tool_x=place.tool_x)
        x, y, z = (1e3 * value for value in reader.position)
        reader.values |= {"X": x, "Y": y, "Z": z}
    elif kind == "SPL":
        reader.refuse(line, kind, "SPL is allowed between SPLINE and ENDSPLINE.")
    else:
        if kind in ("PTP", "SPTP"):
            reader.out.note(kind, "is taken as a straight rapid move", line)
        is_rapid = kind in ("PTP", "SPTP")
        tip, axis, tool_x = place
        reader.line_to(tip, axis, line, is_rapid=is_rapid, tool_x=tool_x)
    reader.feed, reader.base_and_tool.chosen, reader.turns = before


def _take_orientation(pose: dict[str, float], line: int, reader: _Krl) -> None:
    """Note an orientation that is not stated, or keep the first that is."""
    if not reader.is_turned and not set("ABC") & set(pose):
        sentence = "are not stated; the tool is taken to stand upright"
        reader.out.note("A, B, C", sentence, line)
        return
    if reader.first_angles is None:
        angles = reader.values | pose
        reader.first_angles = (angles["A"], angles["B"], angles["C"])
        if "S" in pose and "T" in pose:
            reader.first_status = (pose["S"], pose["T"])
    reader.is_turned = True


def _moved(
    pose: dict[str, float], is_tool: bool, row: str, line: int, reader: _Krl
) -> dict[str, float]:
    """Components of the end of a relative motion [mm]."""
    values = reader.values
    step = [pose.get(key, 0.0) for key in "XYZ"]
    if pose.get("A") or pose.get("B") or pose.get("C"):
        reader.refuse(line, row, "a relative motion that turns is not supported.")
    if not reader.is_placed:
        reader.refuse(line, row, "a relative motion needs a stated place before it.")
    if is_tool:
        R = rotation_of_abc(values["A"], values["B"], values["C"])
        step = (R @ np.array(step)).tolist()
    return {key: values[key] + by for key, by in zip("XYZ", step, strict=True)}


def _place(values: dict[str, float], reader: _Krl) -> ToolPlace:
    point = (1e-3 * values["X"], 1e-3 * values["Y"], 1e-3 * values["Z"])
    turn = _orientation(values["A"], values["B"], values["C"], reader.tool_axis)
    return ToolPlace(point, turn.axis, turn.tool_x if reader.is_turned else None)


# Most moves of a program have the orientation of the one before.
@functools.lru_cache(maxsize=256)
def _orientation(a: float, b: float, c: float, tool_axis: ToolAxis) -> ToolPlace:
    """Axis and x of our tool of angles A, B, C [deg], at no place."""
    return tool_place((0.0, 0.0, 0.0), rotation_of_abc(a, b, c), tool_axis)


def _time_block(match: re.Match[str], line: int, reader: _Krl) -> None:
    """Apply TIME_BLOCK: shares of the segments, and the time of all."""
    if reader.spline is None:
        reader.refuse(line, match[0], "TIME_BLOCK is allowed in a SPLINE block.")
    elif match[2] is not None and reader.spline:
        reader.spline[-1].share = bounded_number(match[2])
    elif match[3] is not None and reader.spline:
        shares = [knot.share for knot in reader.spline]
        if math.isnan(shares[-1]) and len(shares) > 1:
            shares[-1] = 100.0 - sum(shares[:-1])
        elif len(shares) == 1:
            shares = [100.0]
        if not all(share > 0 for share in shares):
            message = "every segment before it needs TIME_BLOCK PART above 0."
            reader.refuse(line, match[0], message)
            return
        for knot, share in zip(reader.spline, shares, strict=True):
            knot.share = bounded_number(match[3]) * share / sum(shares)


def _spline(word: str, row: str, line: int, reader: _Krl) -> None:
    """Begin or end a SPLINE block."""
    if word == "SPLINE":
        reader.outer_feed, reader.spline = reader.feed, []
        reader.outer_frames = reader.base_and_tool.chosen
        reader.outer_turns = reader.turns
        for text in _WITH.split(row, maxsplit=1)[1:]:
            _set_with(text, line, reader)
        return
    knots, reader.spline = reader.spline, None
    reader.feed, reader.turns = reader.outer_feed, reader.outer_turns
    reader.base_and_tool.chosen = reader.outer_frames
    if not knots:
        reader.refuse(line, row, "the SPLINE block has no segment.")
        return
    if not reader.is_placed:
        reader.refuse(line, row, "a spline needs a motion to a stated place before it.")
        return
    for is_curve, run in itertools.groupby(knots, lambda knot: knot.kind == "SPL"):
        if is_curve:
            _spline_moves(list(run), line, reader)
            continue
        for knot in run:
            reader.feed = knot.feed
            pace = None if math.isnan(knot.share) else knot.share
            (tip, axis, tool_x), at = knot.place, knot.line
            if knot.kind in ("CIRC", "SCIRC"):
                through = knot.through
                reader.arc_to(through, tip, axis, at, duration=pace, tool_x=tool_x)
            else:
                reader.line_to(tip, axis, at, duration=pace, tool_x=tool_x)
    reader.feed = reader.outer_feed


def _spline_moves(knots: list[_Knot], line: int, reader: _Krl) -> None:
    """Make the moves of a cubic spline through points."""
    here = ToolPlace(reader.position, reader.axis, reader.tool_x)
    places = [here, *(knot.place for knot in knots)]
    is_turned = all(place.tool_x is not None for place in places)
    rows = np.array(
        [
            (*place.tip, *place.axis, *(place.tool_x or ()) * is_turned)
            for place in places
        ]
    )
    shares = np.array([knot.share for knot in knots])
    is_timed = not np.isnan(shares).any()
    chords = _lengths(np.diff(rows[:, :3], axis=0))
    steps = shares if is_timed else chords
    if not np.all(steps > 0) or not np.isfinite(rows).all():
        message = "two points of the spline are the same, or too far away."
        reader.refuse(line, "ENDSPLINE", message)
        return
    bends = _natural_bends(rows, steps)
    bend = _lengths(bends[:, :3])
    largest = np.maximum(bend[:-1], bend[1:])
    counts = np.ceil(steps * np.sqrt(largest / (8 * _SPLINE_TOLERANCE)))
    counts = np.clip(counts, 1, _MOST_PIECES).astype(int)
    beyond = int(counts.sum()) - _FREE_PIECES * len(knots)
    reader.out.reserve(max(beyond, 0), line, "the pieces of splines")
    for first in range(0, len(knots), _KNOTS_AT_ONCE):
        part = slice(first, first + _KNOTS_AT_ONCE)
        count = counts[part]
        segment = np.repeat(np.arange(count.size) + first, count)
        before = np.repeat(np.cumsum(count) - count, count)
        share = ((np.arange(segment.size) - before + 1) / counts[segment])[:, None]
        rest, step = 1 - share, steps[segment][:, None]
        made = rest * rows[segment] + share * rows[segment + 1]
        made += (rest**3 - rest) * step**2 / 6 * bends[segment]
        made += (share**3 - share) * step**2 / 6 * bends[segment + 1]
        unit = made[:, 3:6] / _lengths(made[:, 3:6])[:, None]
        sides = itertools.repeat(None)
        if is_turned:
            side = made[:, 6:]
            side = side - np.einsum("ij,ij->i", side, unit)[:, None] * unit
            sides = _points(side / _lengths(side)[:, None])
        pieces = zip(
            segment.tolist(), _points(made[:, :3]), _points(unit), sides, strict=False
        )
        for index, tip, axis, tool_x in pieces:
            knot = knots[index]
            reader.feed = knot.feed
            pace = float(steps[index] / counts[index]) if is_timed else None
            reader.line_to(tip, axis, knot.line, duration=pace, tool_x=tool_x)


def _points(rows: Float[np.ndarray, "row 3"]) -> Iterator[Point]:
    """Points of rows."""
    x, y, z = rows.T.tolist()
    return zip(x, y, z, strict=True)


def _lengths(rows: Float[np.ndarray, "row value"]) -> Float[np.ndarray, " row"]:
    """Lengths of rows."""
    return np.sqrt(np.einsum("ij,ij->i", rows, rows))


def _natural_bends(
    rows: Float[np.ndarray, "point value"], steps: Float[np.ndarray, " segment"]
) -> Float[np.ndarray, "point value"]:
    """Second derivatives of the natural cubic spline through rows at its points.

    Blocks of few points are many, for which a solver of equations takes longer to call
    than to solve them.
    """
    bends = np.zeros_like(rows)
    slopes = np.diff(rows, axis=0) / steps[:, None]
    sums, h = 6 * np.diff(slopes, axis=0), steps.tolist()
    ratio = [0.0] * len(rows)
    for at in range(1, len(h)):
        pivot = 2 * (h[at - 1] + h[at]) - h[at - 1] * ratio[at - 1]
        ratio[at] = h[at] / pivot
        bends[at] = (sums[at - 1] - h[at - 1] * bends[at - 1]) / pivot
    for at in range(len(h) - 1, 0, -1):
        bends[at] -= ratio[at] * bends[at + 1]
    return bends
