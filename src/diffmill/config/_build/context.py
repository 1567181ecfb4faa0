"""A file that is being read: what it may name, and what is wrong with it."""

import os
import pathlib
from typing import NamedTuple

_LARGEST_FILE = 64_000_000


class FileContext(NamedTuple):
    """Context of the tables of a file.

    Attributes:
        folder: Folder of the file.
        allow_outside: Whether it may name files outside of its folder.
        problems: Receives a line for everything that is wrong.
        notes: Receives a line for everything that is doubtful.
    """

    folder: pathlib.Path
    allow_outside: bool
    problems: list[str]
    notes: list[str]

    def file(
        self, name: str, key: str, *, largest: int = _LARGEST_FILE
    ) -> pathlib.Path | None:
        """Path of a file that the job names; None after a fault.

        Args:
            name: The name as in the file that is being read.
            key: Where it stands, for the message.
            largest: Largest size that is allowed [byte].
        """
        try:
            # Unlike `resolve`, it lets a loop of links be: that is no file.
            path = pathlib.Path(os.path.realpath(self.folder / name))
            is_inside = path.is_relative_to(os.path.realpath(self.folder))
            is_file = path.is_file()
            size = path.stat().st_size if is_file else 0
        except (OSError, ValueError) as error:
            self.problems.append(
                f"{key}: found {name!r}, which cannot be opened: {error}"
            )
            return None
        if not is_inside and not self.allow_outside:
            self.problems.append(
                f"{key}: found {name!r}, which leads outside the job's folder; allowed "
                "are files in it or below (--allow-outside permits others)"
            )
            return None
        if not is_file:
            self.problems.append(
                f"{key}: found {name!r}, but there is no such file in the job's folder"
            )
            return None
        if size > largest:
            self.problems.append(
                f"{key}: found {name!r} of {size / 1e6:.0f} MB; at most "
                f"{largest / 1e6:.0f} MB are allowed"
            )
            return None
        return path
