"""Reading a file for `diffmill identify`: all of its faults and its data at once."""

import os
import pathlib

from .._toml import JobError, read_toml
from ..identification import Study
from ._identification.context import Context
from ._identification.force_records import study_of_job
from ._identification.kinds import KINDS
from ._load_job import load_job


def load_identification(
    file: str | os.PathLike[str],
    forces: str | os.PathLike[str] | None = None,
    *,
    allow_outside: bool = False,
) -> Study:
    """Study that a TOML file asks for, its measurements read.

    Args:
        file: The file, with `kind = "mean_forces"`, "force_records", "load_tests",
            "ring_down", "frequency_response", "coupled", "controller" or
            "kinematics"; or a job, if `forces` is given.
        forces: A record of forces of the job, wherever it lies.
        allow_outside: Whether the file may name files outside its own folder.

    Returns:
        The study in SI units; see its `run`.

    Raises:
        JobError: If anything is wrong with the file or with a measurement. All is
            listed at once.
    """
    path = pathlib.Path(file)
    raw = read_toml(path).tables
    if forces is not None:
        record = pathlib.Path(forces)
        if "kind" in raw:
            raise JobError(
                path,
                [
                    f"kind: found beside the argument {record.name}; with a file of "
                    "forces a job is required"
                ],
            )
        if not record.is_file():
            raise JobError(
                path, [f"found no file {record}, but measured forces are needed"]
            )
        job = load_job(path, allow_outside=allow_outside)
        return study_of_job(path, job, record)
    if "kind" not in raw and "program" in raw:
        raise JobError(
            path,
            [
                "kind: found a job; give the file of its measured forces after it, or "
                'a file with kind = "force_records" that names both'
            ],
        )
    kind, problems = raw.get("kind"), []
    if not isinstance(kind, str) or kind not in KINDS:
        found = "nothing" if kind is None else repr(kind)
        allowed = ", ".join(f'"{name}"' for name in KINDS)
        text = f"kind: found {found}, but one of {allowed} is required"
        raise JobError(path, [f"{text}: what was measured"])
    tables = KINDS[kind].tables(raw, problems)
    context = Context(path.parent, allow_outside, problems, {})
    study = KINDS[kind].read(path.stem, context, **tables)
    if problems or study is None:
        raise JobError(path, problems)
    return study
