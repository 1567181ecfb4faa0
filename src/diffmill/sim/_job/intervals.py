"""Slots enough for the intervals of the rays, found by running a job.

How many intervals a ray needs at once is known only when the program has been cut: a
pocket cleared in many passes leaves strips that a ray crosses one by one. Every slot
costs time and memory in each step, so a job begins with a few and is run again with
more where they do not do.
"""

import dataclasses

import equinox as eqx
import jax
import jax.core

from ..._job import Job
from ..._result import RESULTS
from ...workpiece import Stock, physical_memory, stock_bytes

# More intervals than this on a ray are no pocket but a fault of the program.
_MOST = 128


def with_more_intervals(job: Job, result: RESULTS) -> Job | None:
    """Return the job with twice the slots if a run of it needs more than it has.

    Args:
        job: The job that was run.
        result: Outcome of its run.

    Returns:
        The job with a note; None if the run did not end so, if the job states its
        number of intervals, under a transformation, or if there is no room for more.

    **Differentiability**: runs on the host.
    """
    is_traced = isinstance(jax.tree.leaves(result)[0], jax.core.Tracer)
    if is_traced or job.keeps_intervals:
        return None
    if not bool(result == RESULTS.interval_overflow):
        return None
    x, y, z = job.stock.interval_counts
    # A tool that stands upright never splits a ray along z.
    counts = (2 * x, 2 * y, 2 * z if job.simulation.axes else z)
    size = job.stock.origin.dtype.itemsize
    needed = stock_bytes(job.stock.grid_shape, counts, size)
    if max(counts) > _MOST or needed > physical_memory() / 2:
        return None
    return _resized(job, counts)


def with_intervals_of(job: Job, stock: Stock) -> Job:
    """Return a job with the slots of a stock that a run of it ended with.

    Args:
        job: The job as it was given to the run.
        stock: The stock after the run.

    Returns:
        The same job if the run took its slots, else one with those that it took, and
        a note.

    **Differentiability**: runs on the host.
    """
    counts = stock.interval_counts
    return job if counts == job.stock.interval_counts else _resized(job, counts)


def _resized(job: Job, counts: tuple[int, int, int]) -> Job:
    note = (
        "[stock] intervals: the rays were given {} intervals along x, y and z, since "
        "the program needs more than it began with"
    )
    mark = note.split("{}")[0]
    notes = tuple(n for n in job.notes if not n.startswith(mark))
    job = eqx.tree_at(lambda j: j.stock, job, job.stock.with_interval_counts(counts))
    listed = ", ".join(str(count) for count in counts)
    return dataclasses.replace(job, notes=(*notes, note.format(listed)))
