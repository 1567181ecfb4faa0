"""Paths of many lengths for one compiled program.

A compiled program serves arrays of one shape, so a path that is one row longer would
be compiled anew. A path is therefore padded to one of few lengths before it runs, and
the rows behind its last one are not simulated (`diffmill/_padding.py`).
"""

import dataclasses
from typing import TypeVar

import equinox as eqx
import jax
import jax.core

from ..._arrays import first_rows
from ..._job import Job

_Tree = TypeVar("_Tree")


def padded_job(job: Job) -> Job:
    """Return a job of one of few lengths, without texts.

    Args:
        job: The job; where its path is traced, only the texts are left out.
    """
    job = job.without_texts()
    if isinstance(job.path.positions, jax.core.Tracer):
        return job
    return dataclasses.replace(job, path=job.path.padded())


def cut_rows(tree: _Tree, names: tuple[str, ...], row_count: int) -> _Tree:
    """Return results without the rows behind the last one that counts.

    Args:
        tree: The results.
        names: Their fields with a row per step; one that is None stays so.
        row_count: Rows to keep.

    Returns:
        The results; cut on the host, since a device compiles a slice for each length.
    """
    given = tuple(name for name in names if getattr(tree, name) is not None)
    at = lambda tree: [getattr(tree, name) for name in given]
    return eqx.tree_at(at, tree, first_rows(at(tree), row_count))
