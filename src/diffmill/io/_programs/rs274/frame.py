"""What a program says beside its motion, for a corrected one to say it again."""

import bisect
import re
from collections.abc import Collection
from typing import NamedTuple

from ..faults import Fault
from ..geometry import MM_PER_INCH
from ..text import plain_number, split_lines
from .words import Word, split_comments, split_words

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
