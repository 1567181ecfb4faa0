"""Paths of many lengths for one compiled program.

A compiled program serves arrays of one shape, so a path that is one row longer would
be compiled anew. A path is therefore padded to one of few lengths before it runs, and
the rows behind its last one are not simulated (`diffmill/_live_rows.py`).
"""

import dataclasses
from typing import TypeVar

import equinox as eqx
import jax
import jax.core
import numpy as np

from ..._arrays import first_rows
from ..._job import Job
from ..._live_rows import padded_count
from ...toolpath import Path

_Tree = TypeVar("_Tree")


def pad_path(path: Path, row_count: int | None = None) -> Path:
    """Return a path with rows behind its last one that no simulation runs.

    Args:
        path: The path; one that is padded is returned as it is.
        row_count: Rows of the padded path; one of few sizes if not given.

    Returns:
        The path; its `row_count` says how many of its rows count.

    Raises:
        ValueError: The path has more rows than asked for.
    """
    if path.row_count is not None:
        return path
    count = path.step_count
    total = padded_count(count) if row_count is None else row_count
    if total < count:
        raise ValueError(
            f"Argument `row_count` must be at least the path's number of rows "
            f"({count}), but is {total}."
        )
    at = np.minimum(np.arange(total), count - 1)
    rows = jax.tree.map(lambda x: np.asarray(x)[at], path)
    return dataclasses.replace(rows, row_count=np.asarray(count, np.int32))


def padded_job(job: Job) -> Job:
    """Return a job of one of few lengths, without texts.

    Args:
        job: The job; where its path is traced, only the texts are left out.
    """
    job = job.without_texts()
    if isinstance(job.path.positions, jax.core.Tracer):
        return job
    return dataclasses.replace(job, path=pad_path(job.path))


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
