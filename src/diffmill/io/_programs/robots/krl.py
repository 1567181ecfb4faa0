"""KUKA Robot Language: plain motion from a .src file and the .dat file beside it.

Read are DEF and END, frames and positions that are declared in either file, PTP, LIN,
CIRC, their spline forms and SPLINE blocks with SPL, $BASE, $TOOL, $VEL.CP, C_DIS and
the like, WAIT SEC, and comments. A spline is a cubic one in time through its points.
"""

import math
import re

import numpy as np

from ....toolpath import Point, Program
from ..faults import SHOWN_FAULTS, ProgramError
from ..geometry import axis_of_abc
from ..text import split_lines
from .reader import Reader

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_COMPONENT = re.compile(rf"\s*([A-Z]\d?)\s+({_NUMBER})\s*", re.IGNORECASE)
_DECLARED = re.compile(
    r"(?:GLOBAL\s+)?(?:DECL\s+)?(?:GLOBAL\s+)?(?:E6POS|POS|FRAME|E6AXIS|AXIS)?\s*"
    r"([A-Z$_]\w*(?:\[\d+\])?)\s*=\s*(\{.*\})",
    re.IGNORECASE,
)
_SPEED = re.compile(rf"\$VEL\.CP\s*=\s*({_NUMBER})", re.IGNORECASE)
_BAS_SPEED = re.compile(rf"BAS\s*\(\s*#VEL_CP\s*,\s*({_NUMBER})\s*\)", re.IGNORECASE)
_MOTION = re.compile(
    r"(PTP|LIN|CIRC|SPL|SPTP|SLIN|SCIRC)\s+(.*)", re.IGNORECASE | re.DOTALL
)
_APPROXIMATION = re.compile(r"\s+C_(?:DIS|VEL|ORI|PTP|SPL)\b.*$", re.IGNORECASE)
_WITH = re.compile(rf"\s+WITH\s+\$VEL\.CP\s*=\s*({_NUMBER}).*$", re.IGNORECASE)
_TIME = re.compile(
    rf"TIME_BLOCK\s+(START|PART\s*=\s*({_NUMBER})|END\s*=\s*({_NUMBER}))",
    re.IGNORECASE,
)
_WAIT = re.compile(rf"WAIT\s+SEC\s+({_NUMBER})", re.IGNORECASE)
_QUIET = re.compile(
    r"&.*|DEFDAT\b.*|ENDDAT|EXT\b.*|INI|DECL\b.*|(?:GLOBAL\s+)?INTERRUPT\b.*"
    r"|BAS\s*\(.*\)|\$(?:ACC|APO|VEL|ORI_TYPE|CIRC_TYPE|ADVANCE|IPO_MODE|VEL_AXIS"
    r"|ACC_AXIS)\b.*|\$(?:OUT|ANOUT)\b.*",
    re.IGNORECASE,
)
_JOINTS = frozenset(["A1", "A2", "A3", "A4", "A5", "A6"])
# A spline is read as so many straight pieces between two of its points at most.
_MOST_PIECES = 64
_SPLINE_TOLERANCE = 0.1e-6


class _Krl(Reader):
    """State of the reader of KRL."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: dict[str, dict[str, float]] = {}
        self.values: dict[str, float] = dict.fromkeys("XYZABC", 0.0)
        self.base: dict[str, float] | None = None
        self.spline: list[_Knot] | None = None
        self.is_ended = False


class _Knot:
    """A point of a spline block: where, how it is reached, and in which share."""

    def __init__(self, point: Point, axis: Point, line: int, is_straight: bool):
        self.point, self.axis, self.line = point, axis, line
        self.is_straight, self.share = is_straight, math.nan


def parse_krl(text: str, data: str = "", *, name: str = "program.src") -> Program:
    """Return the moves of a KRL program.

    Args:
        text: The .src file.
        data: The .dat file beside it.
        name: Name for messages.

    Raises:
        ProgramError: If anything but plain motion is found; up to 20 faults.
    """
    reader = _Krl()
    for number, row in enumerate(split_lines(data, name), 1):
        found = _DECLARED.fullmatch(row.split(";")[0].strip())
        if found:
            reader.frames[found[1].upper()] = _components(found[2], number, reader)
    for number, row in enumerate(split_lines(text, name), 1):
        bare = row.split(";")[0].strip()
        if bare and not reader.is_ended:
            _statement(bare, number, reader)
        if len(reader.faults) > SHOWN_FAULTS:
            break
    if reader.faults:
        raise ProgramError(name, reader.faults)
    return reader.out.finish(text, name)


def _components(text: str, line: int, reader: Reader) -> dict[str, float]:
    """Return the components of {X 1,Y 2,...}, by upper-case name."""
    found: dict[str, float] = {}
    inside = text.strip()[1:-1]
    inside = inside.split(":", 1)[1] if ":" in inside else inside
    for part in inside.split(","):
        match = _COMPONENT.fullmatch(part)
        if match is None:
            reader.refuse(line, part, "a component is a name and a number.")
            return {}
        found[match[1].upper()] = float(match[2])
    return found


def _statement(row: str, line: int, reader: _Krl) -> None:
    """Carry out one statement."""
    word = row.split()[0].split("(")[0].upper()
    if word in ("DEF", "GLOBAL") and "DEF" in row.upper():
        if reader.out.moves:
            reader.refuse(line, row, "one DEF per file is read; write calls out.")
    elif word == "END":
        reader.is_ended = True
    elif found := _SPEED.fullmatch(row) or _BAS_SPEED.fullmatch(row):
        reader.feed = float(found[1])
        if not reader.feed > 0:
            reader.refuse(line, row, "a speed is above 0.")
    elif found := re.fullmatch(r"\$(BASE|TOOL)\s*=\s*(.+)", row, re.IGNORECASE):
        _set_frame(found[1].upper(), found[2], line, reader)
    elif found := _DECLARED.fullmatch(row):
        reader.frames[found[1].upper()] = _components(found[2], line, reader)
    elif word in ("SPLINE", "ENDSPLINE"):
        _spline(word, row, line, reader)
    elif found := _TIME.fullmatch(row):
        _time_block(found, line, reader)
    elif found := _WAIT.fullmatch(row):
        reader.out.rest(float(found[1]))
    elif found := _MOTION.fullmatch(row):
        _motion(found[1].upper(), found[2], line, reader)
    elif word == "HALT":
        reader.out.note("HALT", "waits for the operator, which takes no time", line)
    elif _QUIET.fullmatch(row):
        if not word.startswith(("&", "DEF", "END", "EXT", "INI", "DECL")):
            reader.out.note(re.split(r"[\s=(\[]", row)[0], "changes no path", line)
    else:
        reader.refuse(line, row, "is no plain motion and is not supported.")


def _set_frame(kind: str, value: str, line: int, reader: _Krl) -> None:
    """Apply $BASE and $TOOL: one base is `work`, another tool is another section."""
    value = value.strip()
    if kind == "TOOL":
        number = re.fullmatch(r"TOOL_DATA\[(\d+)\]", value, re.IGNORECASE)
        if number:
            reader.out.change_tool(int(number[1]), line)
        return
    base = (
        _components(value, line, reader)
        if value.startswith("{")
        else reader.frames.get(value.upper(), {value.upper(): 0.0})
    )
    if reader.base not in (None, base):
        message = "a program with several bases is not supported; `work` is one base."
        reader.refuse(line, value, message)
    reader.base = base


def _pose(text: str, line: int, reader: _Krl) -> dict[str, float] | None:
    """Return the components of a position that is written out or declared."""
    text = text.strip()
    if text.startswith("{"):
        return _components(text, line, reader)
    found = reader.frames.get(text.upper())
    if found is None and text.upper() in ("HOME", "XHOME"):
        return dict.fromkeys(_JOINTS, 0.0)
    if found is None:
        reader.refuse(line, text, "no position of this name is declared as numbers.")
    return found


def _motion(kind: str, rest: str, line: int, reader: _Krl) -> None:
    """Carry out a motion."""
    speed = _WITH.search(rest)
    rest = _APPROXIMATION.sub("", _WITH.sub("", rest)).strip()
    parts = re.findall(r"\{[^}]*\}|[^,{}]+", rest)
    parts = [part.strip() for part in parts if part.strip()]
    turn = next((part for part in parts if part.upper().startswith("CA")), None)
    wanted = 2 if kind in ("CIRC", "SCIRC") else 1
    if turn is not None:
        reader.refuse(line, turn, "an arc ends at its end point here; leave CA out.")
        return
    if len(parts) != wanted:
        reader.refuse(line, rest, f"{kind} needs {wanted} position(s).")
        return
    poses = [_pose(part, line, reader) for part in parts]
    if any(pose is None for pose in poses):
        return
    found = [pose for pose in poses if pose is not None]
    if _JOINTS & set(found[-1]):
        message = "goes to joint angles; the motion is taken up at the next position"
        reader.out.note(kind, message, line)
        reader.lose_place(line)
        return
    before = reader.feed
    if speed is not None:
        reader.feed = float(speed[1])
    middle = _apply(found[0], dict(reader.values))
    reader.values = _apply(found[-1], reader.values)
    point, axis = _place(reader.values)
    if reader.spline is not None:
        reader.spline.append(_Knot(point, axis, line, kind in ("SLIN", "LIN")))
    elif kind in ("CIRC", "SCIRC"):
        reader.arc_to(_place(middle)[0], point, axis, line)
    elif kind == "SPL":
        reader.refuse(line, kind, "SPL stands between SPLINE and ENDSPLINE.")
    else:
        if kind in ("PTP", "SPTP"):
            reader.out.note(kind, "is taken as a straight rapid move", line)
        reader.line_to(point, axis, line, is_rapid=kind in ("PTP", "SPTP"))
    reader.feed = before


def _apply(pose: dict[str, float], values: dict[str, float]) -> dict[str, float]:
    """Return the values with those that a position states."""
    return {key: pose.get(key, value) for key, value in values.items()}


def _place(values: dict[str, float]) -> tuple[Point, Point]:
    """Return the tip [m] and the tool axis."""
    point = (1e-3 * values["X"], 1e-3 * values["Y"], 1e-3 * values["Z"])
    return point, axis_of_abc(values["A"], values["B"], values["C"])


def _time_block(found: re.Match[str], line: int, reader: _Krl) -> None:
    """Apply TIME_BLOCK: shares of the segments, and the time of all."""
    if reader.spline is None:
        reader.refuse(line, found[0], "TIME_BLOCK stands in a SPLINE block.")
    elif found[2] is not None and reader.spline:
        reader.spline[-1].share = float(found[2])
    elif found[3] is not None and reader.spline:
        shares = [knot.share for knot in reader.spline]
        if math.isnan(shares[-1]) and len(shares) > 1:
            shares[-1] = 100.0 - sum(shares[:-1])
        elif len(shares) == 1:
            shares = [100.0]
        if not all(share > 0 for share in shares):
            message = "every segment before it needs TIME_BLOCK PART above 0."
            reader.refuse(line, found[0], message)
            return
        for knot, share in zip(reader.spline, shares, strict=True):
            knot.share = float(found[3]) * share / sum(shares)


def _spline(word: str, row: str, line: int, reader: _Krl) -> None:
    """Begin or end a SPLINE block."""
    if word == "SPLINE":
        speed = _WITH.search(f" {row}")
        reader.feed = float(speed[1]) if speed else reader.feed
        reader.spline = []
        return
    knots, reader.spline = reader.spline, None
    if not knots:
        reader.refuse(line, row, "the SPLINE block has no segment.")
        return
    if not reader.is_placed:
        reader.refuse(line, row, "a spline needs a motion to a stated place before it.")
        return
    if all(knot.is_straight for knot in knots):
        for knot in knots:
            duration = None if math.isnan(knot.share) else knot.share
            reader.line_to(knot.point, knot.axis, knot.line, duration=duration)
        return
    _spline_moves(knots, line, reader)


def _spline_moves(knots: list[_Knot], line: int, reader: _Krl) -> None:
    """Make the moves of a cubic spline through points."""
    from scipy.interpolate import CubicSpline

    points = np.array([reader.position, *(knot.point for knot in knots)])
    axes = np.array([reader.axis, *(knot.axis for knot in knots)])
    shares = np.array([knot.share for knot in knots])
    is_timed = not np.isnan(shares).any()
    steps = shares if is_timed else np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not np.all(steps > 0):
        reader.refuse(line, "ENDSPLINE", "two points of the spline are the same.")
        return
    time = np.concatenate([[0.0], np.cumsum(steps)])
    curve = CubicSpline(time, np.concatenate([points, axes], axis=1), bc_type="natural")
    bend = np.linalg.norm(curve(time, 2)[:, :3], axis=1)
    for index, knot in enumerate(knots):
        largest = max(bend[index], bend[index + 1])
        count = math.ceil(steps[index] * math.sqrt(largest / (8 * _SPLINE_TOLERANCE)))
        count = min(max(count, 1), _MOST_PIECES)
        at = time[index] + steps[index] * np.arange(1, count + 1) / count
        for row in curve(at):
            unit = row[3:] / np.linalg.norm(row[3:])
            x, y, z = row[:3].tolist()
            i, j, k = unit.tolist()
            duration = float(steps[index]) / count if is_timed else None
            reader.line_to((x, y, z), (i, j, k), knot.line, duration=duration)
