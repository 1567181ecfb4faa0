"""G-code that is written: a path at its instants, or moves, with what a program says.

What a program says beside its motion is its frame, for a corrected one to say it again.
"""

import bisect
import collections
import math
import re
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...._types import RealScalarLike
from ....toolpath import Move, Path, Program
from ..faults import Fault
from ..geometry import MM_PER_INCH, program_moves, straight_pieces
from ..text import plain_number, split_lines
from .macros import MACRO
from .words import Word, split_comments, split_words

_DECIMALS = 6
# Lines of motion alone are most of a program.
_NO_MOTION = re.compile(r"[(;MmSsTtHh]|[Gg][\s0]*(?:2\s*[01]|4\s*[39])")
_PROGRAM_NUMBER = re.compile(r"\s*[oO:]")
_MOVES = frozenset("XYZ")
_COOLANT = (7, 8, 9)


class ProgramFrame(NamedTuple):
    """Blocks and comments before, between and after the motion of one tool.

    Attributes:
        comments: Those of the header.
        opening: Blocks before the motion: tool, its length, coolant.
        spindle: "M3", or "M4" where it turns the other way.
        between: Lines of the program, and blocks before their motion: a comment in
            parentheses, or coolant.
        closing: Blocks behind the motion.
    """

    comments: tuple[str, ...] = ()
    opening: tuple[str, ...] = ()
    spindle: str = "M3"
    between: tuple[tuple[int, str], ...] = ()
    closing: tuple[str, ...] = ("M5", "M2")


def program_frame(source: str, lines: Collection[int]) -> ProgramFrame:
    """Blocks and comments of a G-code program beside the motion of some of its lines.

    It has the comments of the header, and those between which and a line that still
    moves no change of the tool stands. Blocks with a block delete / are left out.

    Args:
        source: The text of the program; one of another format has an empty frame.
        lines: Numbers of the lines that still move, from 1.
    """
    moving = sorted({line for line in lines if line > 0})
    if not moving:
        return ProgramFrame()
    reader, faults = _FrameReader(moving), list[Fault]()
    for number, text in enumerate(split_lines(source, "program"), 1):
        if _NO_MOTION.search(text) or not reader.has_moved:
            reader.add(number, text, faults)
        # A program in G-code has been read without a fault: this is none.
        if faults:
            return ProgramFrame()
        if reader.end:
            break
    return reader.frame()


class _FrameReader:
    """Words and comments so far of a program whose lines `moving` still move."""

    def __init__(self, moving: list[int]):
        self.moving, self.has_moved = moving, False
        self.first, self.last = moving[0], moving[-1]
        self.header: list[str] = []
        self.between: list[tuple[int, str]] = []
        self.selected, self.scale = "", 1.0
        self.loaded: list[str] = []
        self.lengths: list[str] = []
        self.spindle, self.end = "M3", ""
        self.coolant: dict[str, None] = {}
        self.closing: dict[str, None] = {}

    def add(self, number: int, text: str, faults: list[Fault]) -> None:
        """Take in a line."""
        if text.lstrip().startswith(("/", "%")):
            return
        has_words = self.has_moved or not _PROGRAM_NUMBER.match(text)
        # What a parameter says is in the moves.
        has_words = has_words and not MACRO.search(text)
        words = split_words(text, number, faults) if has_words else []
        keys = {_key(word) for word in words}
        values = {word.letter: word.number for word in words}
        if keys & {"M6", "M61"}:
            self._drop_other_tools(number)
        _, comments = split_comments(text, number, [])
        for comment in filter(None, comments):
            if not self.has_moved:
                self.header.append(comment)
            elif number <= self.last:
                self.between.append((number, comment_block(comment)))
        for word in words:
            self._word(number, word)
        if number <= self.first:
            self._take_tool(keys, values)
            self._take_length(keys, values)
        self.has_moved |= "G43.1" not in keys and not _MOVES.isdisjoint(values)

    def _drop_other_tools(self, change: int) -> None:
        """Drop what no kept motion follows before a change of the tool."""
        while self.between:
            at = bisect.bisect_left(self.moving, self.between[-1][0])
            if at < len(self.moving) and self.moving[at] < change:
                break
            self.between.pop()

    def _word(self, number: int, word: Word) -> None:
        """Take in a word."""
        key, is_before = _key(word), number <= self.first
        if word.letter == "M" and word.number in (2, 30):
            self.end = key
        elif word.letter == "M" and word.number in _COOLANT:
            self._cool(number, key)
        elif is_before and word.letter == "T":
            self.selected = key
        elif is_before and key in ("M3", "M4"):
            self.spindle = key

    def _take_tool(self, keys: set[str], values: dict[str, float]) -> None:
        """Take in a tool that is changed, or said to be in the spindle."""
        if "M6" in keys:
            self.loaded = [f"{self.selected} M6".strip()]
        if "M61" in keys and "Q" in values:
            # Right behind a change it is the number of what has been loaded.
            before = [] if self.has_moved else self.loaded
            self.loaded = [*before, f"M61 Q{plain_number(values['Q'])}"]

    def _take_length(self, keys: set[str], values: dict[str, float]) -> None:
        """Take in the length of a tool, in millimetres."""
        if keys & {"G20", "G21"}:
            self.scale = MM_PER_INCH if "G20" in keys else 1.0
        number = f" H{plain_number(values['H'])}" if "H" in values else ""
        if "G43" in keys:
            self.lengths = [f"G43{number}"]
        elif "G43.1" in keys and "Z" in values:
            length = round(values["Z"] * self.scale, 6)
            self.lengths = [f"G43.1 Z{plain_number(length)}"]
        elif "G43.2" in keys:
            self.lengths.append(f"G43.2{number}")
        elif "G49" in keys:
            self.lengths = []

    def _cool(self, number: int, key: str) -> None:
        """Take in a word of coolant, where it stands."""
        if number > self.last:
            # What is switched on there is for another tool.
            self.closing |= {key: None} if key == "M9" else {}
        elif number > self.first:
            self.between.append((number, key))
        elif key == "M9":
            self.coolant.clear()
        else:
            self.coolant[key] = None

    def frame(self) -> ProgramFrame:
        """Return the blocks and comments."""
        # One that is selected later is the next one.
        opening = [*(self.loaded or [self.selected] * bool(self.selected))]
        opening += self.lengths
        return ProgramFrame(
            comments=tuple(self.header),
            opening=(*opening, *self.coolant),
            spindle=self.spindle,
            between=tuple(self.between),
            closing=("M5", *self.closing, self.end or "M2"),
        )


def _key(word: Word) -> str:
    """Return a word as text, a whole number as such."""
    return f"{word.letter}{plain_number(word.number)}"


def comment_block(text: str) -> str:
    """Return text as a comment on one line, without what a terminal would obey."""
    plain = " ".join(text.split()).replace("(", "[").replace(")", "]")
    plain = "".join(letter if letter.isprintable() else "?" for letter in plain)
    return f"({plain.encode('ascii', errors='replace').decode('ascii')})"


def write_gcode(
    path: Path,
    *,
    header: Sequence[str] = (),
    spindle_speed: RealScalarLike | None = None,
    frame: ProgramFrame | None = None,
) -> str:
    """Return a program with one straight move per row in inverse time (G93).

    The program goes to the first row at rapid feed, and from there every row takes
    exactly the time since the row before it, whatever the controller's acceleration.
    A row that repeats the one before it (a dwell) would be a move of no length, which
    has no speed and which controllers skip; it is written one last decimal (1 nm)
    beside, in z, so that its time is kept. Whether a row was rapid is not kept.

    Args:
        path: The path; its tool axis must be +z.
        header: Lines of comment for the top of the program.
        spindle_speed: Speed that the program sets [rad/s]; None sets none.
        frame: What stands before, between and behind the motion; a comment or coolant
            stands before the first row of its line or of a later one.

    Returns:
        The program's text, in millimetres.

    Raises:
        ValueError: If the tool axis is tilted, a number is not finite, or the time
            does not increase.
    """
    time, positions = np.asarray(path.time), np.asarray(path.positions)
    if not path.is_upright:
        raise ValueError(
            "Argument `path` must keep the tool axis along +z, but tilts it; a program "
            "with X, Y and Z only cannot."
        )
    if not (np.all(np.isfinite(positions)) and np.all(np.isfinite(time))):
        raise ValueError("Argument `path` must be finite, but is not.")
    steps = np.diff(time)
    if not np.all(steps > 0):
        raise ValueError("Argument `path` must have increasing time, but has not.")
    points = _distinct(np.round(positions * 1e3, _DECIMALS))
    frame = ProgramFrame() if frame is None else frame
    lines = [comment_block(text) for text in (*header, *frame.comments)]
    lines += ["G17 G21 G90 G93", *frame.opening]
    if spindle_speed is not None:
        lines.append(_spindle_block(float(spindle_speed), frame))
    lines.append(f"G0 {_coordinates(points[0])}")
    between = collections.deque(frame.between)
    numbers = np.asarray(path.line)[1:].tolist()
    for point, step, number in zip(points[1:], steps, numbers, strict=True):
        while between and between[0][0] <= number:
            lines.append(between.popleft()[1])
        lines.append(f"G1 {_coordinates(point)} F{60 / step:.9f}")
    return "\n".join([*lines, *frame.closing]) + "\n"


def _distinct(
    points: Float[np.ndarray, "step 3"],
) -> Float[np.ndarray, "step 3"]:
    """Return points of which none repeats the one before, some moved by 1 nm."""
    points = points + 0.0
    nudge = 10.0**-_DECIMALS
    for row in range(1, len(points)):
        if np.all(np.abs(points[row] - points[row - 1]) < nudge / 2):
            points[row, 2] = round(points[row, 2] + nudge, _DECIMALS)
    return points


def _spindle_block(speed: float, frame: ProgramFrame) -> str:
    """Block that sets the spindle speed [rad/s] and starts the spindle."""
    return f"S{plain_number(round(speed * 30 / math.pi, 6))} {frame.spindle}"


def _coordinates(point: Float[np.ndarray, " 3"]) -> str:
    """Return a point in millimetres as words."""
    x, y, z = (f"{value + 0.0:.{_DECIMALS}f}" for value in point)
    return f"X{x} Y{y} Z{z}"


def write_moves(
    program: Program,
    *,
    header: Sequence[str] = (),
    tolerance: RealScalarLike = 1e-6,
    frame: ProgramFrame | None = None,
) -> str:
    """Return a program as G-code: its lines, arcs, feeds, durations and rests.

    Args:
        program: The program; its tool axis must be +z.
        header: Lines of comment for the top of the program.
        tolerance: How far straight pieces may lie beside an arc whose axis is none of
            x, y and z [m].
        frame: What stands before, between and behind the motion, as `write_gcode` takes
            it; None for the spindle and the end alone.

    Raises:
        ValueError: If the tool axis is tilted.
    """
    moves = program_moves(program)
    if not program.is_upright:
        raise ValueError(
            "the program tilts the tool axis; G-code with X, Y and Z only cannot."
        )
    closing = (*["M5"] * bool(program.spindle_speeds), "M2")
    frame = ProgramFrame(closing=closing) if frame is None else frame
    lines = [comment_block(text) for text in (*header, *frame.comments)]
    lines += ["G17 G21 G40 G49 G90 G94", *frame.opening]
    if program.spindle_speed is not None:
        lines.append(_spindle_block(program.spindle_speed, frame))
    plane, feed, mode = 2, None, 940
    between = collections.deque(frame.between)
    for move in moves:
        while between and between[0][0] <= move.line:
            lines.append(between.popleft()[1])
        normal = [round(value, 9) + 0.0 for value in move.normal]
        is_plane = sorted(map(abs, normal)) == [0.0, 0.0, 1.0]
        whole = [move] if is_plane else straight_pieces(move, float(tolerance))
        for one in whole:
            words = []
            if (
                one.centre is not None
                and abs(normal.index(max(normal, key=abs))) != plane
            ):
                plane = normal.index(max(normal, key=abs))
                words.append(f"G{(19, 18, 17)[plane]}")
            if not one.is_rapid and one.length > 0:
                wanted = 940 if one.duration is None else 930
                if wanted != mode:
                    mode, feed = wanted, None
                    words.append(f"G{mode // 10}")
            words.append(_motion_words(one, plane, normal))
            if one.duration is not None and one.length > 0:
                words.append(f"F{60 / one.duration:.9f}")
            elif one.feed is not None and one.feed != feed:
                feed = one.feed
                words.append(f"F{plain_number(feed * 6e4, 9)}")
            if one.length > 0 or one.duration is None:
                lines.append(" ".join(words))
            seconds = one.rest or (0.0 if one.length > 0 else one.duration or 0.0)
            if seconds:
                lines.append(f"G4 P{plain_number(seconds, 9)}")
    return "\n".join([*lines, *frame.closing]) + "\n"


def _motion_words(move: Move, plane: int, normal: list[float]) -> str:
    """Return the words of one motion, without its feed."""
    end = _coordinates(np.array(move.end) * 1e3)
    if move.centre is None:
        return f"G{0 if move.is_rapid else 1} {end}"
    is_left = move.turn * normal[plane] > 0
    offset = [1e3 * (c - s) for c, s in zip(move.centre, move.start, strict=True)]
    centre = " ".join(
        f"{letter}{offset[axis]:.{_DECIMALS}f}"
        for axis, letter in enumerate("IJK")
        if axis != plane
    )
    turns = f" P{abs(move.turn)}" if abs(move.turn) > 1 else ""
    return f"G{3 if is_left else 2} {end} {centre}{turns}"
