"""Slots enough for the intervals of the rays, found by running a job.

How many intervals a ray needs at once is known only when the program has been cut: a
pocket cleared in many passes leaves strips that a ray crosses one by one. Every slot
costs time and memory in each step, so a job begins with a few and is run again with
more where they do not do.
"""

import jax
import jax.core

from ..._job import Job
from ..._result import RESULTS

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
    if max(counts) > _MOST or job.stock.memory_with(counts).is_too_much:
        return None
    return job.with_intervals(counts)
