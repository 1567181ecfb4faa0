"""Whole records of forces, each with its cut."""

import os
import pathlib

from ..._job import Job
from ..._toml import JobError
from ...identification import ForceRecordStudy
from .._schema.cutter import CutterTable
from .._schema.job import SpindleTable
from .context import Context
from .kind import IdentificationKind
from .records import (
    force_settings,
    read_force_record,
    read_force_records,
    with_straight_cut,
)
from .schema import CutTable, FitTable, RecordTable


def study_of_job(
    path: pathlib.Path, job: Job, forces: pathlib.Path
) -> ForceRecordStudy:
    """Study of one record of a job.

    Args:
        path: The file of the job.
        job: The job.
        forces: The record, wherever it lies.

    Raises:
        JobError: If anything is wrong with the record.
    """
    context = Context(forces.parent, True, [], {path.resolve(): job})
    table = RecordTable(file=forces.name, job=os.fspath(path.resolve()))
    record = read_force_record(table, "record", context)
    if record is None or context.problems:
        raise JobError(forces, context.problems)
    return ForceRecordStudy(path.stem, (record,), force_settings(FitTable()))


def _read(
    name: str,
    context: Context,
    *,
    record: list[RecordTable] | None = None,
    cutter: CutterTable | None = None,
    spindle: SpindleTable | None = None,
    cut: CutTable | None = None,
    fit: FitTable | None = None,
) -> ForceRecordStudy:
    """Study of whole records; those whose problems were noted are not in it."""
    context = with_straight_cut(context, cutter, spindle, cut)
    records = read_force_records(record, fit, context, has_jobs=True)
    return ForceRecordStudy(name, records, force_settings(fit or FitTable()))


KIND = IdentificationKind(
    "force_records",
    required={"record": [RecordTable]},
    optional={
        "cutter": CutterTable,
        "spindle": SpindleTable,
        "cut": CutTable,
        "fit": FitTable,
    },
    read=_read,
)
