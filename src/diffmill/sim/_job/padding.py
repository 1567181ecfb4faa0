"""Paths of many lengths for one compiled program.

A compiled program serves arrays of one shape, so a path that is one row longer would
be compiled anew. A path is therefore padded to one of few lengths before it runs, and
the rows behind its last one are not simulated (`diffmill/_padding.py`).
"""

import dataclasses

import jax
import jax.core

from ..._job import Job


def padded_job(job: Job) -> Job:
    """Return a job of one of few lengths, without texts.

    Args:
        job: The job; where its path is traced, only the texts are left out.
    """
    job = job.without_texts()
    if isinstance(job.path.positions, jax.core.Tracer):
        return job
    return dataclasses.replace(job, path=job.path.padded())
