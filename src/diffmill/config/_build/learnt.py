"""What parts have shown of a machine: `[learnt]` of a job."""

import dataclasses
from typing import TYPE_CHECKING

from ..._job import Job
from .context import FileContext

# Learning takes imports that a job without it does not need.
if TYPE_CHECKING:
    from ...learning import MachinePosterior


def read_learnt(name: str, key: str, context: FileContext) -> "MachinePosterior | None":
    """Posterior that `learn` has written, or None with a problem noted.

    Args:
        name: The file as it is named.
        key: Where it is named.
        context: Folder and problems.
    """
    from ...learning import MachinePosterior

    file = context.file(name, key)
    if file is None:
        return None
    try:
        return MachinePosterior.read(file)
    except (ValueError, OSError, KeyError) as error:
        context.problems.append(
            f"{key}: {name}: found no machine that `diffmill learn` has written "
            f"({error})"
        )
        return None


def with_learnt(job: Job, learnt: "MachinePosterior", context: FileContext) -> Job:
    """Job on the machine that was learnt; as it was with a problem noted.

    Args:
        job: The job.
        learnt: What parts have shown.
        context: Receives what is wrong.
    """
    if job.robot is None:
        context.problems.append(
            "[learnt] file: found one beside a machine without joints, but a robot is "
            "required"
        )
        return job
    try:
        adapted = learnt.job_for(job)
    except ValueError as error:
        context.problems.append(f"[learnt] file: {error}")
        return job
    what = "and what no parameter explains"
    if not learnt.is_of(job):
        what = "without what none of them explains, which is of another program"
    note = f"[learnt]: the machine has the parameters that parts have shown, {what}"
    return dataclasses.replace(adapted, notes=(*adapted.notes, note))
