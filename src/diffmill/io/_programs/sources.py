"""Files of a program: those beside it, and lines that are counted on through them."""

import dataclasses
import functools
import pathlib
from collections.abc import Iterable

from .faults import Fault, ProgramError
from .limits import MOST_LINES
from .move_list import MoveList
from .text import split_lines


@dataclasses.dataclass(frozen=True)
class Folder:
    """Folder of a program, whose files may be parts of it.

    Attributes:
        path: The folder; None for a text that has none.
    """

    path: pathlib.Path | None = None

    @functools.cached_property
    def files(self) -> dict[str, pathlib.Path]:
        """Files by name in lower case; those to which a link leads out are none."""
        path = self.path
        if path is None:
            return {}
        files = [one for one in sorted(path.iterdir()) if one.is_file()]
        files = [one for one in files if one.resolve().parent == path.resolve()]
        return {one.name.lower(): one for one in files}

    def find(
        self, stems: Iterable[str], suffixes: Iterable[str]
    ) -> pathlib.Path | None:
        """First file of one of some stems and suffixes, whatever its capitals."""
        if self.path is None:
            return None
        suffixes = tuple(suffixes)
        names = [f"{stem}{suffix}" for stem in stems for suffix in suffixes]
        return next((file for one in names if (file := self._file(one))), None)

    def _file(self, name: str) -> pathlib.Path | None:
        exact = self.files.get(name.lower())
        if self.path is not None and exact is not None:
            same = self.path / name
            return same if same in self.files.values() else exact
        return exact


class Sources:
    """Files of a program in the order in which they are read.

    Attributes:
        count: Number of their lines so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._names: dict[int, str] = {}

    def lines(self, text: str, name: str, out: MoveList) -> list[str]:
        """Lines of one more file, counted on from those before.

        Raises:
            ProgramError: If a program has too many lines.
        """
        rows = split_lines(text, name)
        if self._names:
            sentence = f"is used too; its lines are counted from {self.count + 1} on"
            out.note(name, sentence, self.count + 1)
        self._names[self.count] = name
        self.count += len(rows)
        if self.count > MOST_LINES:
            message = f"with this file, the program has more than {MOST_LINES} lines."
            raise ProgramError(name, [Fault(0, "", message)])
        return rows

    def located(self, error: ProgramError) -> ProgramError:
        """Error whose faults tell the lines of their own files."""
        return error.with_faults([self._located(fault) for fault in error.faults])

    def _located(self, fault: Fault) -> Fault:
        begins = [one for one in self._names if one < fault.line]
        if fault.file or not begins or begins[-1] == 0:
            return fault
        line = fault.line - begins[-1]
        return fault._replace(line=line, file=self._names[begins[-1]])
