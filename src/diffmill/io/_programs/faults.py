"""What is wrong with a program, and the error that lists it."""

from typing import NamedTuple

SHOWN_FAULTS = 20


class Fault(NamedTuple):
    """One thing wrong with a program.

    Attributes:
        line: Line of the file, from 1; 0 for the file as a whole.
        word: The word found, as written; may be empty.
        message: What is wrong, and what is allowed.
        is_unsupported: Whether the list of all allowed words is of help.
        file: Name of the file, where it is not that of the program.
    """

    line: int
    word: str
    message: str
    is_unsupported: bool = False
    file: str = ""

    def __str__(self) -> str:
        """Return the fault as one line of text."""
        place = f"line {self.line}: " if self.line else ""
        quoted = f'found "{self.word}": ' if self.word else ""
        return place + quoted + self.message


class ProgramError(ValueError):
    """A program that cannot be read, with everything wrong in it.

    Attributes:
        name: Name of the program's file.
        faults: What is wrong, in the order of the lines; at most 20.
    """

    def __init__(self, name: str, faults: list[Fault], allowed: str = ""):
        self.name, self.allowed = name, allowed
        self.faults = tuple(faults[:SHOWN_FAULTS])
        lines = [f"{fault.file or name}, {fault}" for fault in self.faults]
        if len(faults) > SHOWN_FAULTS:
            lines.append(f"{name}: further faults are not listed.")
        if allowed and any(fault.is_unsupported for fault in self.faults):
            lines.append(f"Allowed are {allowed}.")
        super().__init__("\n".join(lines))

    def with_faults(self, faults: list[Fault]) -> "ProgramError":
        """The error with other faults."""
        return ProgramError(self.name, faults, self.allowed)
