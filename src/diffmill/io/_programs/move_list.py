"""Moves as a program is read: sections of tools, approaches, faults and notes."""

import math
from dataclasses import dataclass, field

from ...toolpath import Move, Program, Section
from .faults import Fault, ProgramError
from .limits import (
    LONGEST_DURATION,
    MOST_CYCLE_MOVES,
    MOST_MOVES,
    UNUSUAL_REST,
    UNUSUAL_SPEED,
    fault_of,
    is_plain,
)

# Lines that a note lists.
_LISTED_LINE_COUNT = 3


@dataclass
class _Note:
    """One kind of note: its word and sentence, its first lines and their number."""

    word: str
    sentence: str
    lines: list[int] = field(default_factory=list)
    count: int = 0

    def __str__(self) -> str:
        """Return the note as text: lines, word and sentence."""
        lines = ", ".join(str(line) for line in self.lines)
        more = self.count - len(self.lines) if self.count > _LISTED_LINE_COUNT else 0
        lines += f" and {more} more" if more else ""
        plural = "s" if self.count > 1 else ""
        return f"line{plural} {lines}: {self.word}: {self.sentence}"


@dataclass
class MoveList:
    """The moves so far, with what the program says about tools and speeds.

    Every move and rest of every language passes here, and its numbers are judged.

    Attributes:
        name: Name of the program's file, for messages.
        faults: What is wrong so far.
        moves: The moves [m].
        sections: Finished sections.
        is_approach: Whether the place of the tool is still not known.
        known: Axes whose position the section has stated.
    """

    name: str = "program"
    faults: list[Fault] = field(default_factory=list)
    moves: list[Move] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    is_approach: bool = True
    known: set[str] = field(default_factory=set)
    _tool: int | None = None
    _line: int = 1
    _first: int = 0
    _approach_count: int = 0
    _speed: float | None = None
    _speeds: dict[float, None] = field(default_factory=dict)
    _all_speeds: dict[float, None] = field(default_factory=dict)
    _notes: dict[tuple[str, str], _Note] = field(default_factory=dict)
    _lost: set[str] = field(default_factory=set)
    _cycle_moves: float = 0
    # Moves that have been looked through for the largest z, and that [m].
    _seen: int = 0
    _top: float = -math.inf
    # Line of the first motion whose numbers are not known.
    _unknown: int | None = None

    @property
    def tool(self) -> int | None:
        """The tool that works now."""
        return self._tool

    @property
    def has_section(self) -> bool:
        """True if the section at work has moves."""
        return len(self.moves) > self._first

    def add(self, move: Move, axes: str) -> None:
        """Add a move.

        Args:
            move: The move.
            axes: Which of X, Y and Z it brings to a place that the program states.

        Raises:
            ProgramError: If the program makes too many moves.
        """
        if not is_plain(move):
            if message := fault_of(move):
                self.faults.append(Fault(move.line, "", message))
            numbers = (*move.start, *move.end, *(move.centre or ()))
            numbers += (move.feed or 0.0, move.duration or 0.0)
            if self._unknown is None and any(map(math.isnan, numbers)):
                self._unknown = move.line
        if len(self.moves) >= MOST_MOVES:
            message = f"the program makes more than {MOST_MOVES} moves."
            raise ProgramError(self.name, [*self.faults, Fault(move.line, "", message)])
        if self._lost:
            self._lost.difference_update(axes)
        if self.is_approach:
            if move.is_rapid:
                self._approach_count += 1
                self.known.update(axes)
                self.is_approach = len(self.known) < 3
            else:
                self.is_approach = False
        self.moves.append(move)

    def reserve(
        self, count: int | float, line: int, what: str = "canned cycles"
    ) -> None:
        """Refuse more moves than few lines may ask for, before they are made.

        Raises:
            ProgramError: If `count` more are too many.
        """
        self._cycle_moves += count
        if not self._cycle_moves <= MOST_CYCLE_MOVES:
            message = f"{what} make more than {MOST_CYCLE_MOVES} moves."
            raise ProgramError(self.name, [*self.faults, Fault(line, "", message)])

    def dwell(self, duration: float, line: int, word: str = "") -> None:
        """Let the tool stay where it is [s]; before any move there is no such place."""
        last = self.moves[-1] if self.moves else Move((0, 0, 0), (0, 0, 0))
        self.moves[-1:] = [self.rested(last, duration, line, word)] * bool(self.moves)

    def rested(self, move: Move, duration: float, line: int, word: str) -> Move:
        """A move behind which the tool rests longer [s]."""
        if not 0 <= duration <= LONGEST_DURATION and not math.isnan(duration):
            message = f"found a rest of {duration:g} s; allowed are 0 to "
            message += f"{LONGEST_DURATION:g} s."
            self.faults.append(Fault(line, word, message))
        elif self._unknown is None and math.isnan(duration):
            self._unknown = line
        if duration > UNUSUAL_REST:
            sentence = "is longer than a minute; it counts in seconds here, and in "
            sentence += "milliseconds on some controllers"
            self.note(f"rest of {duration:g} s", sentence, line)
        return move._replace(rest=move.rest + duration)

    def highest(self) -> float:
        """Largest z of the moves so far [m]."""
        new = self.moves[self._seen :]
        self._top = max([self._top, *(move.end[2] for move in new)])
        self._seen = len(self.moves)
        return self._top

    def set_speed(self, speed: float) -> None:
        """Set the spindle speed [rad/s]; 0 stops it and sets none."""
        if speed > 0:
            self._speed = speed
            self._speeds[speed] = self._all_speeds[speed] = None

    def change_tool(self, tool: int, line: int) -> None:
        """Begin a section with another tool, if it is another one."""
        if tool == self._tool:
            return
        if self.has_section:
            self.begin_section(line)
        self._tool = tool

    def name_tool(self, tool: int) -> None:
        """Give the tool that has worked so far its number, which is told late."""
        self._tool = tool
        self.sections = [part._replace(tool=tool) for part in self.sections]

    def begin_section(self, line: int) -> None:
        """Begin a section: where the tip is has to be stated anew."""
        self._finish()
        self._line, self._first, self._approach_count = line, len(self.moves), 0
        self._speeds = {}
        self.is_approach = True
        self.known = set()

    def lose(self, axes: str, line: int) -> None:
        """Begin a section in which some axes have to be stated anew, others not."""
        known = self.known if self.is_approach else set("XYZ")
        if self.has_section and not self.is_approach:
            self.begin_section(line)
        self.is_approach, self.known = True, known - set(axes)
        self._lost |= set(axes)

    def note(self, word: str, sentence: str, line: int) -> None:
        """Note a word that changes no motion, or an assumption."""
        note = self._notes.setdefault((word, sentence), _Note(word, sentence))
        note.count += 1
        if len(note.lines) < _LISTED_LINE_COUNT and line not in note.lines:
            note.lines.append(line)

    def finish(self, text: str) -> Program:
        """Return the program.

        Raises:
            ProgramError: If a fault has been found, or nothing moves.
        """
        if self.faults:
            raise ProgramError(self.name, self.faults)
        if self._unknown is not None:
            message = "a number of this motion is not known, or too large."
            raise ProgramError(self.name, [Fault(self._unknown, "", message)])
        if not any(move.length > 0 for move in self.moves):
            message = "the program moves nothing; needed is a motion to another place."
            raise ProgramError(self.name, [Fault(0, "", message)])
        self._finish()
        self._note_speeds()
        return Program(
            tuple(self.moves),
            approach_count=self.sections[0].approach_count,
            spindle_speeds=tuple(self._all_speeds),
            source=text,
            name=self.name,
            sections=tuple(self.sections),
            notes=tuple(map(str, self._notes.values())),
        )

    def _note_speeds(self) -> None:
        """Note motion that is faster than a cell moves a cutter."""
        speeds = [
            move.length / move.duration if move.duration else move.feed or 0.0
            for move in self.moves
        ]
        fastest = max(speeds)
        if fastest <= UNUSUAL_SPEED:
            return
        sentence = f"up to {fastest:.3g} m/s ({fastest * 6e4:.3g} mm/min), faster than "
        sentence += "a cell moves a cutter; is its unit another one?"
        for move, speed in zip(self.moves, speeds, strict=True):
            if speed > UNUSUAL_SPEED:
                self.note("feed", sentence, move.line)

    def _finish(self) -> None:
        """Keep the section at work, if it has moves to a known place."""
        if self.sections and self._lost and self.has_section:
            sentence = "leads to a place that is not stated, and is left out"
            self.note("a rapid move", sentence, self.moves[self._first].line)
            del self.moves[self._first :]
        speeds = self._speeds
        if not speeds and self._speed is not None:
            speeds = {self._speed: None}
        if self.has_section:
            self.sections.append(
                Section(
                    self._tool,
                    self._first,
                    len(self.moves),
                    self._approach_count,
                    tuple(speeds),
                    self._line,
                )
            )
