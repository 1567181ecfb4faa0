"""Check of the tables of a job alone, before JAX is imported."""

import os
import pathlib

from ..._toml import JobError, read_toml
from .._schema.job import read_tables


def check_tables(file: str | os.PathLike[str]) -> None:
    """Check keys, values and units of a job, but nothing that it names.

    Args:
        file: The job file.

    Raises:
        JobError: Its tables have faults; all of them are listed.

    Differentiability: not applicable, a host function.
    """
    path = pathlib.Path(file)
    problems: list[str] = []
    read_tables(read_toml(path).tables, problems)
    if problems:
        raise JobError(path, problems)
