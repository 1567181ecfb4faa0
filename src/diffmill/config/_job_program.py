"""The program of a job before it is timed, and its timing."""

import os
import pathlib
from typing import NamedTuple

from .._toml import JobError, read_toml
from ..toolpath import Path, Program
from ._build.context import FileContext
from ._build.program import read_program, time_path
from ._schema.job import ProgramTable, read_tables


class JobProgram(NamedTuple):
    """The program of one tool, and how a job times it.

    Attributes:
        file: The job file.
        program: The program.
        table: `[program]` of the job.
    """

    file: pathlib.Path
    program: Program
    table: ProgramTable

    @classmethod
    def of_job(
        cls, file: str | os.PathLike[str], *, allow_outside: bool = False
    ) -> "JobProgram | None":
        """Return the program of a job, None if that is a recorded path.

        Args:
            file: The job file.
            allow_outside: Whether the job may name files outside its own folder.

        Raises:
            JobError: If the job or its program cannot be read.
        """
        path = pathlib.Path(file)
        _, raw = read_toml(path)
        context = FileContext(path.parent, allow_outside, [], [])
        table = read_tables(raw, context.problems).get("program")
        program = None if table is None else read_program(table, context)
        if context.problems:
            raise JobError(path, context.problems)
        if table is None or not isinstance(program, Program):
            return None
        return cls(path, program, table)

    @property
    def suffix(self) -> str:
        """Suffix of the program's file, such as ".nc"."""
        return pathlib.PurePath(self.table.file).suffix.lower()

    def timed(self, program: Program, tooth_period: float) -> Path:
        """Return another program as the job times its own.

        Args:
            program: The program.
            tooth_period: Time between the rows [s].

        Raises:
            JobError: If it cannot be timed.
        """
        problems: list[str] = []
        path = time_path(program, self.table, tooth_period, problems)
        if path is None:
            raise JobError(self.file, problems)
        return path
