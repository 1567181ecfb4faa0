"""APT source and CLDATA as text: GOTO with a tool axis, feeds, tools and circles."""

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ....toolpath import Move, Point, Program
from ..expressions import NUMBER
from ..faults import SHOWN_FAULTS, Fault
from ..geometry import MM_PER_INCH, point_of
from ..limits import (
    LARGEST_NUMBER,
    LARGEST_SPEED_RPM,
    fault_of,
    fault_of_length,
    fault_of_statement,
)
from ..text import split_lines
from .apt_frames import AptFrames, catia_rows
from .reader import Reader

_QUIET = frozenset(
    "PARTNO PPRINT INSERT REMARK $$ MACHIN INTOL OUTTOL TOLER CUTTER COOLNT "
    "SELECT STOP OPSTOP CLEARP PREFUN AUXFUN LINTOL DISPLAY "
    "SEQNO LEADER TPRINT ARCSLP MODE SET CLRSRF THICK REWIND PLABEL TOOL TLDATA PAINT "
    "END-OF-PATH CSI_SET_FLUTE_LENGTH CSI_SET_EXTENSION_LENGTH SETUP AUTOPS PSIS "
    "START_OP END_OP".split()
)
# What follows is text to the end of the line, whatever signs it has.
_TEXT = re.compile(r"\s*(?:PARTNO|PPRINT|REMARK|INSERT|TPRINT)\b", re.IGNORECASE)
_DRILLS = frozenset(["DRILL", "FACE", "CDRILL", "SPOT"])
_DEEP = frozenset(["DEEP", "DEEP2"])
# What else a cycle may say, and as what makers write it.
_OF_CYCLES = frozenset(["FEDTO", "RAPTO", "RTRCTO", "AUTO", "DWELL", "REV"])
_OF_MAKERS = {
    "DEPTH": ("FEDTO",),
    "CLEAR": ("RAPTO",),
    "RETURN": ("RTRCTO",),
    **dict.fromkeys(("STEP", "STEP1", "INCR"), ("1STPECK", "SUBPECK")),
}
# Some systems write them as coordinates below the point, with a minus.
_DEPTHS = ("FEDTO", "1STPECK", "SUBPECK")
# How far above the last depth a peck goes by rapid [m]: the program does not say.
_PECK_CLEARANCE = 0.254e-3
_FEED_UNITS = {"MMPM": 1.0, "IPM": MM_PER_INCH, "PERMIN": None}
_FEEDS_OF_TURN = {"MMPR": 1.0, "IPR": MM_PER_INCH, "PERREV": None}
_UNITS = {"MM": 1.0, "INCHES": MM_PER_INCH, "INCH": MM_PER_INCH}
_UNIT_NAMES = {1.0: "millimetres", MM_PER_INCH: "inches"}
_UNITS_OF_FEEDS = {
    unit: scale
    for unit, scale in (_FEED_UNITS | _FEEDS_OF_TURN).items()
    if scale is not None
}
_PLAIN_CSYS = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_UPRIGHT = (0.0, 0.0, 1.0)
# Creo writes the frame in a comment; its lines go on as statements do.
_CREO = re.compile(r"\s*\$\$->")
_CATIA = re.compile(r"\s*\$\$\s*\*CATIA0\s*", re.IGNORECASE)
# A circle of CATIA about centre or axis, with its radius, up to a line or a point.
_ROUND = re.compile(r"\(\s*(CIRCLE|CYLNDR)\s*/([^()]*)\)", re.IGNORECASE)
_UP_TO = re.compile(r"\(\s*(?:LINE|POINT)\s*/([^()]*)\)", re.IGNORECASE)
# How far the radii at the ends of a circle may differ [m].
_RADIUS_TOLERANCE = 5e-5


class _Statement(NamedTuple):
    """A statement, with the line on which it begins."""

    row: str = ""
    line: int = 0

    @property
    def word(self) -> str:
        """The major word, in upper case."""
        return self.row.partition("/")[0].strip().upper()

    @property
    def parts(self) -> list[str]:
        """Words and numbers behind the slash, in upper case."""
        minor = self.row.partition("/")[2]
        return [part.strip().upper() for part in minor.split(",") if part.strip()]

    @property
    def numbers(self) -> list[float]:
        """Numbers behind the slash."""
        return [float(part) for part in self.parts if _is_number(part)]


class _Circle(NamedTuple):
    """A circle that the next motion goes round.

    Attributes:
        centre: A point of its axis [m].
        normal: Its axis, about which the motion is counter-clockwise.
        angle: The angle [rad] that it goes over, if it is stated; it decides which way.
    """

    centre: Point
    normal: Point
    angle: float | None


class _Apt(Reader):
    """State of the reader of APT."""

    def __init__(self, scale: float) -> None:
        super().__init__()
        # Millimetres per unit of length.
        self.scale = scale
        self.frames = AptFrames()
        # Where other statements say that the machine or a clamping is.
        self.zeros: dict[str, tuple[float | str, ...]] = {"CSYS": _PLAIN_CSYS}
        self.is_world = False
        # Axis of points that state none: the last one, or else that of TLAXIS.
        self.local_axis = self.fixed_axis = _UPRIGHT
        self.is_rapid = False
        self.spindle = 0.0
        self.feed_per_turn: float | None = None
        # Numbers of the last FROM.
        self.home: list[float] = []
        self.circle: _Circle | None = None
        self.forward: Point | None = None
        self.cycle: dict[str, float] | None = None
        self.cycle_feed: float | None = None

    def reject(self, statement: _Statement, message: str) -> None:
        """Report a fault of a statement."""
        self.refuse(statement.line, statement.row, message)

    def point(self, numbers: Sequence[float]) -> Point:
        """Place of three numbers in `work` [m]."""
        x, y, z = (1e-3 * self.scale * value for value in numbers)
        return self.frames.place((x, y, z))

    def set_local_axis(self, axis: Point) -> None:
        """Set the tool axis, stated in the frame of the points."""
        self.local_axis = axis
        self.axis = self.frames.direction(axis)


def parse_apt(text: str, *, name: str = "program.apt") -> Program:
    """Return the moves of an APT program.

    Raises:
        ProgramError: If anything but plain motion is found; up to 20 faults.
    """
    statements = list(_statements(split_lines(text, name)))
    faults: list[Fault] = []
    scale, source = _length_unit(statements, faults)
    reader = _Apt(scale)
    reader.out.name, reader.out.faults = name, faults
    for statement in statements:
        _carry_out(statement, reader)
        if len(reader.faults) > SHOWN_FAULTS:
            break
    if source.word not in ("UNITS", "UNIT"):
        sentence = f"as {source.word} says; there is no UNITS"
        if not source.word:
            sentence = "there is no UNITS, and no unit of a feed says otherwise"
        word = f"lengths are {_UNIT_NAMES[scale]}"
        reader.out.note(word, sentence, max(source.line, 1))
    return reader.out.finish(text)


def _statements(rows: list[str]) -> Iterator[_Statement]:
    """Yield the statements up to FINI."""
    text, begun, is_comment = "", 0, False
    for number, row in enumerate(rows, 1):
        if not text and (word := _TEXT.match(row)):
            yield _Statement(word[0].strip(), number)
            continue
        if not text and _CATIA.fullmatch(row):
            yield _Statement(f"CATIA0/{catia_rows(rows, number)}", number)
            continue
        # A comment may be written anew in each line that it goes on in.
        if (mark := _CREO.match(row)) and (is_comment or not text):
            row, is_comment = row[mark.end() :], True
        bare = row.split("$$")[0]
        # A $ goes on in the next line; what stands behind it is a comment.
        bare, dollar, _ = bare.partition("$")
        begun = begun if text else number
        text += bare.strip()
        if dollar:
            continue
        statement, text = _Statement(text.strip(), begun), ""
        if is_comment and statement.word != "CSYS":
            statement = _Statement("", begun)
        is_comment = False
        if statement.word in ("FINI", "END"):
            return
        if statement.row:
            yield statement


def _length_unit(
    statements: Sequence[_Statement], faults: list[Fault]
) -> tuple[float, _Statement]:
    """Millimetres per unit of length, and the statement that tells it, if one does.

    It is that of UNITS, or else of the feeds: systems write inches per minute in
    programs whose lengths are inches. Statements of both units are refused.
    """
    first: tuple[float, _Statement] | None = None
    for word in (("UNITS", "UNIT"), ("FEDRAT", "CYCLE")):
        for statement in statements:
            if statement.word not in word:
                continue
            known = _UNITS if "UNITS" in word else _UNITS_OF_FEEDS
            scales = {known[part] for part in statement.parts if part in known}
            for scale in sorted(scales):
                first = (scale, statement) if first is None else first
                if first[0] != scale:
                    message = f"{_UNIT_NAMES[scale]} contradict the "
                    message += f"{_UNIT_NAMES[first[0]]} of {first[1].word} in line "
                    message += f"{first[1].line}."
                    faults.append(Fault(statement.line, statement.row[:40], message))
    return (1.0, _Statement()) if first is None else first


def _carry_out(statement: _Statement, reader: _Apt) -> None:
    """Carry out one statement."""
    row = statement.row
    if message := fault_of_length(row) or fault_of_statement(row):
        reader.reject(statement, message)
        return
    word, line = statement.word, statement.line
    if word in _STATEMENTS:
        _STATEMENTS[word](statement, reader)
        return
    parts = statement.parts
    if word == "RAPID":
        reader.is_rapid = True
    elif word in ("UNITS", "UNIT"):
        if not parts or parts[0] not in _UNITS:
            reader.reject(statement, f"allowed are {', '.join(_UNITS)}.")
    elif word in ("LOADTL", "TOOLNO") or (word == "LOAD" and parts[:1] == ["TOOL"]):
        if not statement.numbers:
            reader.reject(statement, "needed is the number of a tool.")
            return
        reader.out.change_tool(round(statement.numbers[0]), line)
    elif word == "DELAY" and parts and _is_number(parts[0]):
        reader.out.dwell(float(parts[0]), line)
    elif word == "MULTAX":
        if "OFF" in parts:
            reader.set_local_axis(reader.fixed_axis)
    elif word == "MODE" and "INCR" in parts:
        reader.reject(statement, "points as distances are not supported.")
    elif word == "CUTCOM":
        sentence = "the points are taken to be those of the tool's centre"
        reader.out.note(word, sentence, line)
    elif word.split(" ")[0] in _QUIET or not word:
        reader.out.note(word.split(" ")[0], "changes no motion here", line)
    else:
        reader.reject(statement, "is no plain motion and is not supported.")


def _set_speed(statement: _Statement, reader: _Apt) -> None:
    """Apply SPINDL: the speed of the spindle, if it states one."""
    speeds = statement.numbers
    if not speeds:
        return
    if not 0 <= speeds[0] <= LARGEST_SPEED_RPM:
        message = f"a spindle speed lies between 0 and {LARGEST_SPEED_RPM:g} rpm."
        reader.reject(statement, message)
    reader.spindle = speeds[0]
    if reader.feed_per_turn is not None:
        reader.feed = reader.feed_per_turn * reader.spindle
    reader.out.set_speed(speeds[0] * 2 * math.pi / 60)


def _set_frame(statement: _Statement, reader: _Apt) -> None:
    """Apply a frame in which the points that follow are."""
    numbers, line, word = statement.numbers, statement.line, statement.word
    if len(numbers) < len(statement.parts) - ("NOMORE" in statement.parts):
        reader.reject(statement, "a frame has numbers alone.")
    elif reader.frames.state(word, numbers, 1e-3 * reader.scale, line, reader):
        reader.fixed_axis = _UPRIGHT
        reader.set_local_axis(_UPRIGHT)


def _set_zero(statement: _Statement, reader: _Apt) -> None:
    """Apply what tells the place of the machine or of a clamping, but no motion.

    Behind TRNTYP/WORLD the points of all clampings (CSYS) are in one frame. Else a CSYS
    may be that of the points or of the machine, so all motion needs the same.
    """
    word, parts, line = statement.word, statement.parts, statement.line
    frame = tuple(float(part) if _is_number(part) else part for part in parts)
    if word == "TRNTYP":
        reader.is_world = parts[:1] == ["WORLD"]
        reader.set_local_axis(reader.fixed_axis)
    elif word == "CSYS" and reader.is_world:
        sentence = "states how the work is clamped; points are in one frame, the WORLD"
        is_plain = frame == _PLAIN_CSYS
        reader.out.note(word, "changes no motion here" if is_plain else sentence, line)
        return
    if word != "ORIGIN" and reader.out.moves:
        if reader.zeros.get(word, frame) != frame:
            message = "another frame than that of the motion before it is not supported"
            message += "; needed are points in one frame, or MSYS or TRACUT."
            reader.reject(statement, message)
    reader.zeros[word] = frame
    sentence = "is the frame of all motion, which is taken to be work"
    if word in ("ORIGIN", "TRANS"):
        sentence = "states where the machine's zero is; the points stay as they are"
    is_plain = word == "TRNTYP" or frame == _PLAIN_CSYS
    reader.out.note(word, "changes no motion here" if is_plain else sentence, line)


def _set_axis(statement: _Statement, reader: _Apt) -> None:
    """Apply TLAXIS: the tool axis of the points that state none."""
    numbers = statement.numbers
    if len(numbers) == 3 and math.hypot(*numbers) > 0:
        length = math.hypot(*numbers)
        reader.fixed_axis = point_of(value / length for value in numbers)
        reader.set_local_axis(reader.fixed_axis)
    elif len(numbers) > 1:
        reader.reject(statement, "the tool axis has 3 numbers.")


def _is_number(text: str) -> bool:
    """True if a text is a number that is not too large."""
    return re.fullmatch(NUMBER, text) is not None and abs(float(text)) <= LARGEST_NUMBER


def _set_feed(statement: _Statement, reader: _Apt) -> None:
    """Apply FEDRAT: it ends RAPID, and counts per minute unless it says otherwise."""
    numbers = statement.numbers
    units = [part for part in statement.parts if not _is_number(part)]
    unit = units[0] if units else "PERMIN"
    known = _FEED_UNITS | _FEEDS_OF_TURN
    if len(numbers) != 1 or unit not in known or not numbers[0] > 0:
        message = f"needed is a feed above 0, with one of {', '.join(known)}."
        reader.reject(statement, message)
        return
    reader.feed = numbers[0] * (known[unit] or reader.scale) * 1e-3 / 60
    reader.feed_per_turn = None
    if unit in _FEEDS_OF_TURN:
        reader.feed_per_turn = reader.feed
        reader.feed *= reader.spindle
        if reader.spindle == 0:
            message = "a feed per turn needs a SPINDL before it."
            reader.reject(statement, message)
    reader.is_rapid = False


def _move(statement: _Statement, reader: _Apt) -> None:
    """Carry out a motion."""
    word, parts, line = statement.word, statement.parts, statement.line
    numbers = statement.numbers
    if word == "GOHOME":
        reader.is_rapid = True
        parts = numbers = numbers or reader.home
    if not parts:
        message = "needed is a place; GOHOME alone goes to that of a FROM before it."
        reader.reject(statement, message)
        return
    if len(numbers) < len(parts) or len(parts) not in (3, 6, 7):
        message = f"needed are 3 numbers up to {LARGEST_NUMBER:g}, or 6 with the tool "
        reader.reject(statement, message + "axis.")
        return
    reader.frames.use()
    point = reader.point(numbers[:3])
    axis = local_axis = reader.local_axis
    if word == "GODLTA":
        if not reader.is_placed:
            message = "it needs a motion to a stated place before it."
            reader.reject(statement, message)
        x, y, z = (1e-3 * reader.scale * value for value in numbers[:3])
        step = reader.frames.direction((x, y, z))
        point = point_of(a + b for a, b in zip(reader.position, step, strict=True))
    elif len(numbers) >= 6:
        length = math.hypot(*numbers[3:6])
        if abs(length - 1) > 1e-2:
            reader.reject(statement, "the tool axis is a unit vector.")
            return
        local_axis = point_of(value / length for value in numbers[3:6])
    axis = reader.frames.direction(local_axis)
    reader.local_axis = local_axis
    if word == "FROM":
        if reader.out.has_section and point != reader.position:
            message = "it states where the tool is before a program or a tool begins; "
            reader.reject(statement, message + "a motion comes before it.")
        if message := fault_of(Move(point, point)):
            reader.reject(statement, message)
        reader.position, reader.axis, reader.is_placed = point, axis, True
        reader.home = numbers
        reader.out.known.update("XYZ")
        return
    if reader.circle is not None:
        _go_round(point, axis, line, reader)
    elif reader.cycle is not None:
        _drill(point, axis, reader.cycle, line, reader)
    else:
        reader.line_to(point, axis, line, is_rapid=reader.is_rapid)
    # RAPID holds for one motion.
    reader.is_rapid = False


def _set_circle(statement: _Statement, reader: _Apt) -> None:
    """Keep the circle of the next motion: centre, axis and radius, and an angle."""
    numbers, parts = statement.numbers, statement.parts
    words = {part for part in parts if not _is_number(part)}
    length = math.hypot(*numbers[3:6])
    reader.frames.use()
    # A circle also tells its radius, tolerances and the cutter.
    if words - {"CENTER", "AXIS", "RADIUS", "ANGLE"} or not 6 <= len(numbers) <= 11:
        message = "needed are 3 numbers of its centre, 3 of its axis and the radius."
        reader.reject(statement, message)
    elif abs(length - 1) > 1e-2 or not reader.is_placed:
        message = "needed are a unit vector as the axis, and a place to start from."
        reader.reject(statement, message)
    else:
        axis = point_of(value / length for value in numbers[3:6])
        angle = math.radians(abs(numbers[-1])) if "ANGLE" in words else None
        normal = reader.frames.direction(axis)
        reader.circle = _Circle(reader.point(numbers[:3]), normal, angle)


def _go_round(point: Point, axis: Point, line: int, reader: _Apt) -> None:
    """Make an arc about the circle of the statement before, to a point."""
    circle, reader.circle = reader.circle, None
    assert circle is not None
    start, normal = reader.position, circle.normal
    height = sum(
        (a - b) * n for a, b, n in zip(start, circle.centre, normal, strict=True)
    )
    centre = point_of(
        c + height * n for c, n in zip(circle.centre, normal, strict=True)
    )
    if reader.feed is None:
        reader.refuse(line, "CIRCLE", "there is no FEDRAT before it.")
    move = Move(start, point, centre, 1, reader.feed, line=line, normal=normal)
    first, last = move.radii
    if min(first, last) == 0 or abs(first - last) > _RADIUS_TOLERANCE:
        message = f"its radius is {first * 1e3:.6g} mm at the start, "
        reader.refuse(line, "CIRCLE", message + f"{last * 1e3:.6g} mm at the end.")
        return
    if (angle := circle.angle) is not None:
        other = move._replace(normal=point_of(-n for n in normal))
        moves = (move, other)
        move = min(moves, key=lambda one: abs(abs(one.sweep) - angle))
    reader.out.add(move._replace(axis=axis), "")
    reader.position, reader.axis = point, axis


def _set_forward(statement: _Statement, reader: _Apt) -> None:
    """Apply INDIRV: the direction in which the next circle of CATIA begins."""
    numbers = statement.numbers
    if len(numbers) != 3 or not math.hypot(*numbers) > 0:
        reader.reject(statement, "needed are the 3 numbers of a direction.")
        return
    reader.forward = reader.frames.direction(point_of(numbers))


def _go_forward(statement: _Statement, reader: _Apt) -> None:
    """Carry out TLON,GOFWD of CATIA: round a circle or a cylinder, up to a point."""
    forward, reader.forward = reader.forward, None
    circle, ends = _ROUND.search(statement.row), _UP_TO.findall(statement.row)
    numbers = [] if circle is None else [float(one) for one in _numbers(circle[2])]
    end = [float(one) for one in _numbers(ends[-1])][-3:] if ends else []
    is_cylinder = circle is not None and circle[1].upper() == "CYLNDR"
    wanted = 7 if is_cylinder else 4
    if forward is None or len(numbers) != wanted or len(end) != 3:
        message = "needed are INDIRV, and a CIRCLE or CYLNDR up to a LINE or POINT."
        reader.reject(statement, message)
        return
    reader.frames.use()
    centre, point = reader.point(numbers[:3]), reader.point(end)
    normal = reader.frames.direction(
        point_of(numbers[3:6]) if is_cylinder else _UPRIGHT
    )
    spoke = np.array(reader.position) - np.array(centre)
    turn = float(np.cross(normal, spoke) @ np.array(forward))
    near = math.dist(reader.position, point) < _RADIUS_TOLERANCE
    # The line through centre and end is crossed twice; a whole circle says which.
    if turn == 0 or (near and "INTOF" not in statement.row.upper()):
        message = "which way round the circle it goes, and how far, is not stated."
        reader.reject(statement, message)
        return
    normal = point_of(math.copysign(1.0, turn) * n for n in normal)
    reader.circle = _Circle(centre, normal, None)
    _go_round(point, reader.axis, statement.line, reader)
    reader.is_rapid = False


def _numbers(text: str) -> list[str]:
    """Return the numbers of a list with commas."""
    return [part.strip() for part in text.split(",") if _is_number(part.strip())]


def _set_cycle(statement: _Statement, reader: _Apt) -> None:
    """Apply CYCLE: drilling as plunges."""
    parts = statement.parts
    kind = parts[0] if parts else ""
    if kind in ("OFF", "INIT", "CLEAR"):
        reader.cycle = None
        return
    if parts[1:2] == ["DEEP"]:
        kind = parts.pop(1)
    words = {a: float(b) for a, b in itertools.pairwise(parts) if _is_number(b)}
    for maker in [word for word in words if word in _OF_MAKERS]:
        for word in _OF_MAKERS[maker]:
            words.setdefault(word, words[maker])
    reader.cycle, reader.cycle_feed = words, reader.feed
    needed = ["FEDTO", "RAPTO", *(["1STPECK", "SUBPECK"] if kind in _DEEP else [])]
    depths = [words.get(word, 1.0) for word in _DEPTHS]
    is_known = kind in _DRILLS | _DEEP and not set(needed) - set(words)
    if not is_known or 0 in depths or words["RAPTO"] < 0:
        message = f"allowed are OFF, INIT, {', '.join(sorted(_DRILLS))} with FEDTO and "
        message += f"RAPTO, and {', '.join(sorted(_DEEP))} with 1STPECK and SUBPECK "
        message += "too, depths other than 0, RAPTO above the point."
        reader.reject(statement, message)
        reader.cycle = {"FEDTO": 0.0, "RAPTO": 0.0}
        reader.cycle_feed = 1.0
        return
    for word in _DEPTHS:
        if words.get(word, 1.0) < 0:
            words[word] = -words[word]
            sentence = "is negative, and taken as so far below the point"
            reader.out.note(word, sentence, statement.line)
    known = {*_OF_CYCLES, *_OF_MAKERS, *_DEPTHS, *_FEED_UNITS, *_FEEDS_OF_TURN}
    for word in parts[1:]:
        if not (_is_number(word) or word in known):
            reader.reject(statement, f"{word} of a cycle is not supported.")
    for unit in _FEEDS_OF_TURN:
        if unit in words:
            reader.reject(statement, "a feed per turn is not supported in a cycle.")
    if "DWELL" in words and "REV" in parts:
        reader.reject(statement, "a rest in revolutions is not supported.")
    for unit, scale in _FEED_UNITS.items():
        if unit in words:
            reader.cycle_feed = words[unit] * (scale or reader.scale) * 1e-3 / 60


def _drill(
    point: Point, axis: Point, cycle: dict[str, float], line: int, reader: _Apt
) -> None:
    """Make a plunge along the tool axis below a point."""

    def at(height: float) -> Point:
        way = 1e-3 * reader.scale * height
        return (
            point[0] + way * axis[0],
            point[1] + way * axis[1],
            point[2] + way * axis[2],
        )

    above = max(cycle["RAPTO"], cycle.get("RTRCTO", cycle["RAPTO"]))
    feed, reader.feed = reader.feed, reader.cycle_feed
    reader.line_to(at(above), axis, line, is_rapid=True)
    reader.line_to(at(cycle["RAPTO"]), axis, line, is_rapid=True)
    for depth in _peck_depths(cycle, line, reader):
        reader.line_to(at(-depth), axis, line)
        reader.line_to(at(cycle["RAPTO"]), axis, line, is_rapid=True)
        clear = _PECK_CLEARANCE * 1e3 / reader.scale
        reader.line_to(at(clear - depth), axis, line, is_rapid=True)
    reader.line_to(at(-cycle["FEDTO"]), axis, line)
    if cycle.get("DWELL"):
        reader.out.dwell(cycle["DWELL"], line)
    reader.line_to(at(above), axis, line, is_rapid=True)
    reader.feed = feed


def _peck_depths(cycle: dict[str, float], line: int, reader: _Apt) -> list[float]:
    """Return the depths between which a deep hole is left, the last one aside."""
    if "1STPECK" not in cycle:
        return []
    first, step, last = cycle["1STPECK"], cycle["SUBPECK"], cycle["FEDTO"]
    pecks = max((last - first) / step, 0.0)
    reader.out.reserve(3 * pecks, line)
    count = math.ceil(pecks)
    if count:
        message = "each peck goes out to RAPTO and back to 0.254 mm above its depth"
        reader.out.note("CYCLE", message, line)
    return [first + step * index for index in range(count)]


_STATEMENTS = {
    **dict.fromkeys(("GOTO", "FROM", "GODLTA", "GOHOME"), _move),
    **dict.fromkeys(("CIRCLE", "MOVARC"), _set_circle),
    **dict.fromkeys(("MSYS", "TRACUT", "CATIA0"), _set_frame),
    **dict.fromkeys(("CSYS", "TRNTYP", "ORIGIN", "TRANS"), _set_zero),
    "INDIRV": _set_forward,
    "TLON,GOFWD": _go_forward,
    "FEDRAT": _set_feed,
    "SPINDL": _set_speed,
    "TLAXIS": _set_axis,
    "CYCLE": _set_cycle,
}
