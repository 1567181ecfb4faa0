"""Moves as a program is read: sections of tools, approaches, notes."""

from dataclasses import dataclass, field

from ...toolpath import Move, Program, Section
from .faults import Fault, ProgramError

# Lines that a note lists.
_LISTED = 3


@dataclass
class _Note:
    """One kind of note: its sentence, and where it holds."""

    sentence: str
    lines: list[int] = field(default_factory=list)
    count: int = 0


@dataclass
class MoveList:
    """The moves so far, with what the program says about tools and speeds.

    Attributes:
        moves: The moves [m].
        sections: Finished sections.
        is_approach: Whether the place of the tool is still not known.
        known: Axes whose position the section has stated.
    """

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
    _notes: dict[str, _Note] = field(default_factory=dict)

    @property
    def tool(self) -> int | None:
        """The tool that works now."""
        return self._tool

    def add(self, move: Move, axes: str) -> None:
        """Add a move.

        Args:
            move: The move.
            axes: Which of X, Y and Z it brings to a place that the program states.
        """
        if self.is_approach:
            if move.is_rapid:
                self._approach_count += 1
                self.known.update(axes)
                self.is_approach = len(self.known) < 3
            else:
                self.is_approach = False
        self.moves.append(move)

    def rest(self, duration: float) -> None:
        """Let the tool stay where it is [s]; before any move there is no such place."""
        if self.moves:
            last = self.moves[-1]
            self.moves[-1] = last._replace(rest=last.rest + duration)

    def set_speed(self, speed: float) -> None:
        """Set the spindle speed [rad/s]; 0 stops it and sets none."""
        if speed > 0:
            self._speed = speed
            self._speeds[speed] = self._all_speeds[speed] = None

    def change_tool(self, tool: int, line: int) -> None:
        """Begin a section with another tool, if it is another one."""
        if tool == self._tool:
            return
        if len(self.moves) > self._first:
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

    def note(self, word: str, sentence: str, line: int) -> None:
        """Note a word that changes no motion, or an assumption."""
        note = self._notes.setdefault(word, _Note(sentence))
        note.count += 1
        if len(note.lines) < _LISTED and line not in note.lines:
            note.lines.append(line)

    def finish(self, text: str, name: str) -> Program:
        """Return the program.

        Raises:
            ProgramError: If nothing moves.
        """
        if not any(move.length > 0 for move in self.moves):
            message = "the program moves nothing; needed is a motion to another place."
            raise ProgramError(name, [Fault(0, "", message)])
        self._finish()
        return Program(
            tuple(self.moves),
            approach_count=self.sections[0].approach_count,
            spindle_speeds=tuple(self._all_speeds),
            source=text,
            name=name,
            sections=tuple(self.sections),
            notes=tuple(_sentence(word, note) for word, note in self._notes.items()),
        )

    def _finish(self) -> None:
        """Keep the section at work, if it has moves."""
        speeds = self._speeds
        if not speeds and self._speed is not None:
            speeds = {self._speed: None}
        if len(self.moves) > self._first:
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


def _sentence(word: str, note: _Note) -> str:
    """Return a note as text: where, which word, and what of it."""
    lines = ", ".join(str(line) for line in note.lines)
    more = f" and {note.count - len(note.lines)} more" if note.count > _LISTED else ""
    plural = "s" if note.count > 1 else ""
    return f"line{plural} {lines}{more}: {word}: {note.sentence}"
