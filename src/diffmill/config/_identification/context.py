"""A file for `diffmill identify` that is being read."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import TypeVar

from ..._job import Job
from ..._toml import JobError
from ...cutter import AbstractCutter
from ...io import RecordError, TableReader
from .._build.context import FileContext
from .._load_job import load_job
from .schema import CutTable, MeasuredTable

# Records are longer than programs [byte].
_LARGEST_RECORD = 2_000_000_000

Built = TypeVar("Built")


@dataclasses.dataclass(frozen=True)
class Context:
    """A file that is being read, with what is wrong in it.

    Attributes:
        folder: Folder of the file.
        allow_outside: Whether it may name files outside of its folder.
        problems: Receives a line for everything that is wrong.
        jobs: Jobs that have been loaded, by path; None after a fault.
        cutter: Of `[cutter]`, or None.
        speed: Of `[spindle]` [rad/s], or None.
        cut: `[cut]`, or None.
    """

    folder: pathlib.Path
    allow_outside: bool
    problems: list[str]
    jobs: dict[pathlib.Path, Job | None]
    cutter: AbstractCutter | None = None
    speed: float | None = None
    cut: CutTable | None = None

    def file(self, name: str, key: str) -> pathlib.Path | None:
        """Path of a file that is named, or None with a problem noted."""
        return self.with_notes([]).file(name, key, largest=_LARGEST_RECORD)

    def with_notes(self, notes: list[str]) -> FileContext:
        """Context of a table that a job has, too."""
        return FileContext(self.folder, self.allow_outside, self.problems, notes)

    def job(self, name: str, key: str) -> Job | None:
        """Job that is named; its faults are noted once."""
        path = self.file(name, key)
        if path is None:
            return None
        if path not in self.jobs:
            self.jobs[path] = None
            try:
                self.jobs[path] = load_job(path, allow_outside=self.allow_outside)
            except JobError as error:
                self.problems.extend(f"{key}: {name}: {x}" for x in error.problems)
        return self.jobs[path]

    def read(
        self,
        table: MeasuredTable,
        place: str,
        build: Callable[[TableReader], Built | None],
    ) -> Built | None:
        """Object built from the columns that a table names, or None with faults noted.

        Args:
            table: Its checked entry.
            place: What a line calls the entry.
            build: Builds it; its `RecordError` and the faults of the file are noted.
        """
        assert table.file is not None
        path = self.file(table.file, f"{place} file")
        if path is None:
            return None
        try:
            name, channels, units = table.file, table.channels, table.units
            return build(TableReader.of_file(path, name, channels, units))
        except RecordError as error:
            faults = error.faults
        except OSError as error:
            faults = (str(error),)
        self.problems.extend(f"{place} file: {table.file}: {one}" for one in faults)
        return None
