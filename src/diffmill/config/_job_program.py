"""The program of a job before it is timed."""

import os
import pathlib
from typing import NamedTuple

from .._toml import JobError, read_toml
from ..toolpath import Program
from ._build.context import FileContext
from ._build.program import read_program
from ._schema.job import read_tables


class JobProgram(NamedTuple):
    """The program of one tool.

    Attributes:
        program: The program.
        suffix: Suffix of its file, such as ".nc".
    """

    program: Program
    suffix: str

    @classmethod
    def of_job(
        cls, file: str | os.PathLike[str], *, allow_outside: bool = False
    ) -> "JobProgram | None":
        """Program of a job; None if that is a recorded path.

        Args:
            file: The job file.
            allow_outside: Whether the job may name files outside its own folder.

        Raises:
            JobError: If the job or its program cannot be read.
        """
        path = pathlib.Path(file)
        raw = read_toml(path).tables
        context = FileContext(path.parent, allow_outside, [], [])
        tables = read_tables(raw, context.problems)
        table = tables.program
        program = None
        if table is not None:
            program = read_program(table, context, tables.cutter)
        if context.problems:
            raise JobError(path, context.problems)
        if table is None or not isinstance(program, Program):
            return None
        # As the arm takes it, see `rotated_as_asked`.
        if tables.robot is not None and tables.robot.tool_rotation == "fixed":
            program = program.without_rotation()
        return cls(program, pathlib.PurePath(table.file).suffix.lower())
