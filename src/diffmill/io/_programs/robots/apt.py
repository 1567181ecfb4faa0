"""APT source and CLDATA as text: GOTO with a tool axis, feeds, tools and circles."""

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ....toolpath import Move, Point, Program
from ..expressions import NUMBER
from ..faults import SHOWN_FAULTS, Fault
from ..geometry import MM_PER_INCH, point_of
from ..limits import (
    LARGEST_NUMBER,
    LARGEST_SPEED_RPM,
    fault_of,
    fault_of_statement,
)
from ..text import split_lines
from .reader import Reader

_QUIET = frozenset(
    "PARTNO PPRINT INSERT REMARK $$ MACHIN MULTAX INTOL OUTTOL TOLER CUTTER COOLNT "
    "SELECT STOP OPSTOP CLEARP PREFUN AUXFUN LINTOL DISPLAY "
    "SEQNO LEADER TPRINT ARCSLP MODE SET CLRSRF THICK REWIND PLABEL TOOL TLDATA PAINT "
    "END-OF-PATH CSI_SET_FLUTE_LENGTH CSI_SET_EXTENSION_LENGTH".split()
)
# What follows is text to the end of the line, whatever signs it has.
_TEXT = re.compile(r"\s*(?:PARTNO|PPRINT|REMARK|INSERT|TPRINT)\b", re.IGNORECASE)
_DRILLS = frozenset(["DRILL", "FACE", "CDRILL", "SPOT"])
_DEEP = frozenset(["DEEP", "DEEP2"])
# What else a cycle may say.
_OF_CYCLES = frozenset(["FEDTO", "RAPTO", "RTRCTO", "AUTO", "DWELL", "REV"])
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
# Frames that change nothing; one that all motion shares is `work`.
_FRAMES = {
    "CSYS": (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    "MSYS": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    "TRNTYP": (math.nan, 0.0, 0.0, 0.0),
}
# Creo writes the frame in a comment; its lines go on as statements do.
_CREO = re.compile(r"\s*\$\$->")
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


class _Apt(Reader):
    """State of the reader of APT."""

    def __init__(self, scale: float) -> None:
        super().__init__()
        # Millimetres per unit of length.
        self.scale = scale
        self.frames: dict[str, tuple[float | str, ...]] = dict(_FRAMES)
        self.is_rapid = False
        self.spindle = 0.0
        self.feed_per_turn: float | None = None
        self.circle: list[float] | None = None
        self.cycle: dict[str, float] | None = None
        self.cycle_feed: float | None = None

    def reject(self, statement: _Statement, message: str) -> None:
        """Report a fault of a statement."""
        self.refuse(statement.line, statement.row, message)


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
        if not text and (mark := _CREO.match(row)):
            row, is_comment = row[mark.end() :], True
        bare = row.split("$$")[0]
        # A $ goes on in the next line; what stands behind it is a comment.
        bare, dollar, _ = bare.partition("$")
        begun = begun if text else number
        text += bare.strip()
        if dollar:
            continue
        statement, text = _Statement(text.strip(), begun), ""
        if is_comment and statement.word not in _FRAMES:
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
    if message := fault_of_statement(statement.row):
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
    elif word == "LOADTL" or (word == "LOAD" and parts[:1] == ["TOOL"]):
        if not statement.numbers:
            reader.reject(statement, "needed is the number of a tool.")
            return
        reader.out.change_tool(round(statement.numbers[0]), line)
    elif word == "DELAY" and parts and _is_number(parts[0]):
        reader.out.dwell(float(parts[0]), line)
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
    """Apply CSYS, MSYS or TRNTYP: one frame for all motion is `work`."""
    word, parts = statement.word, statement.parts
    frame = tuple(float(part) if _is_number(part) else part for part in parts)
    plain = _FRAMES[word]
    is_plain = len(frame) == len(plain) and all(
        math.isnan(default) or value == default
        for value, default in zip(frame, plain, strict=True)
    )
    frame = plain if is_plain else frame
    if frame != reader.frames[word] and reader.out.moves:
        message = "another frame than that of the motion before it is not supported."
        reader.reject(statement, message)
    reader.frames[word] = frame
    sentence = "is the frame of all motion, which is taken to be work"
    sentence = "changes no motion here" if is_plain else sentence
    reader.out.note(word, sentence, statement.line)


def _set_axis(statement: _Statement, reader: _Apt) -> None:
    """Apply TLAXIS: the tool axis of the points that state none."""
    numbers = statement.numbers
    if len(numbers) == 3 and math.hypot(*numbers) > 0:
        length = math.hypot(*numbers)
        reader.axis = point_of(value / length for value in numbers)
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
    """Carry out a motion, or keep the circle of the next."""
    word, parts, line = statement.word, statement.parts, statement.line
    # A circle also tells its radius, tolerances and the cutter.
    counts = (6, 7, 8, 9, 10, 11) if word == "CIRCLE" else (3, 6, 7)
    if not all(_is_number(part) for part in parts) or len(parts) not in counts:
        message = f"needed are 3 numbers up to {LARGEST_NUMBER:g}, or 6 with the tool "
        reader.reject(statement, message + "axis.")
        return
    numbers = [float(part) for part in parts]
    if word == "CIRCLE":
        reader.circle = numbers
        return
    if word == "GOHOME":
        reader.reject(statement, "where home is, the program does not say.")
        return
    x, y, z = (1e-3 * reader.scale * value for value in numbers[:3])
    point, axis = (x, y, z), reader.axis
    if word == "GODLTA":
        if not reader.is_placed:
            message = "it needs a motion to a stated place before it."
            reader.reject(statement, message)
        a, b, c = reader.position
        point = (a + x, b + y, c + z)
    elif len(numbers) >= 6:
        length = math.hypot(*numbers[3:6])
        if abs(length - 1) > 1e-2:
            reader.reject(statement, "the tool axis is a unit vector.")
            return
        axis = point_of(value / length for value in numbers[3:6])
    if word == "FROM":
        if reader.out.has_section and point != reader.position:
            message = "it tells where the tool is before a program or a tool begins; "
            reader.reject(statement, message + "a motion stands before it.")
        if message := fault_of(Move(point, point)):
            reader.reject(statement, message)
        reader.position, reader.axis, reader.is_placed = point, axis, True
        reader.out.known.update("XYZ")
        return
    if reader.circle is not None:
        _circle(point, axis, line, reader)
    elif reader.cycle is not None:
        _drill(point, axis, reader.cycle, line, reader)
    else:
        reader.line_to(point, axis, line, is_rapid=reader.is_rapid)
    # RAPID holds for one motion.
    reader.is_rapid = False


def _circle(point: Point, axis: Point, line: int, reader: _Apt) -> None:
    """Make an arc about the circle of the statement before, to a point."""
    numbers, reader.circle = reader.circle, None
    assert numbers is not None
    if len(numbers) < 6:
        reader.refuse(line, "CIRCLE", "needed are centre and axis of the circle.")
        return
    x, y, z = (1e-3 * reader.scale * value for value in numbers[:3])
    i, j, k = numbers[3:6]
    length = math.hypot(i, j, k)
    if abs(length - 1) > 1e-2 or not reader.is_placed:
        message = "needed are a unit vector as the axis, and a place to start from."
        reader.refuse(line, "CIRCLE", message)
        return
    normal = (i / length, j / length, k / length)
    start = reader.position
    height = sum((a - b) * n for a, b, n in zip(start, (x, y, z), normal, strict=True))
    centre = (
        x + height * normal[0],
        y + height * normal[1],
        z + height * normal[2],
    )
    if reader.feed is None:
        reader.refuse(line, "CIRCLE", "there is no FEDRAT before it.")
    move = Move(start, point, centre, 1, reader.feed, line=line, normal=normal)
    first, last = move.radii
    if min(first, last) == 0 or abs(first - last) > _RADIUS_TOLERANCE:
        message = f"its radius is {first * 1e3:.6g} mm at the start, "
        reader.refuse(line, "CIRCLE", message + f"{last * 1e3:.6g} mm at the end.")
        return
    reader.out.add(move._replace(axis=axis), "")
    reader.position, reader.axis = point, axis


def _set_cycle(statement: _Statement, reader: _Apt) -> None:
    """Apply CYCLE: drilling as plunges."""
    parts = statement.parts
    kind = parts[0] if parts else ""
    if kind in ("OFF", "INIT"):
        reader.cycle = None
        return
    words = {a: float(b) for a, b in itertools.pairwise(parts) if _is_number(b)}
    reader.cycle, reader.cycle_feed = words, reader.feed
    needed = ["FEDTO", "RAPTO", *(["1STPECK", "SUBPECK"] if kind in _DEEP else [])]
    depths = [words.get(word, 1.0) for word in _DEPTHS]
    if kind not in _DRILLS | _DEEP or 0 in depths or set(needed) - set(words):
        message = f"allowed are OFF, INIT, {', '.join(sorted(_DRILLS))} with FEDTO and "
        message += f"RAPTO, and {', '.join(sorted(_DEEP))} with 1STPECK and SUBPECK "
        message += "too, depths other than 0."
        reader.reject(statement, message)
        reader.cycle = {"FEDTO": 0.0, "RAPTO": 0.0}
        reader.cycle_feed = 1.0
        return
    for word in _DEPTHS:
        if words.get(word, 1.0) < 0:
            words[word] = -words[word]
            sentence = "is negative, and taken as so far below the point"
            reader.out.note(word, sentence, statement.line)
    known = {*_OF_CYCLES, *_DEPTHS, *_FEED_UNITS, *_FEEDS_OF_TURN}
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
    **dict.fromkeys(("GOTO", "FROM", "GODLTA", "GOHOME", "CIRCLE"), _move),
    **dict.fromkeys(_FRAMES, _set_frame),
    "FEDRAT": _set_feed,
    "SPINDL": _set_speed,
    "TLAXIS": _set_axis,
    "CYCLE": _set_cycle,
}
