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
from jaxtyping import Array, Float

from ..._arrays import on_device
from ..._job import Job
from ...toolpath import Path

_Tree = TypeVar("_Tree")
# Paths are padded to the least of these lengths: this times a power of the ratio.
_LEAST, _RATIO = 256, 4


def padded_count(row_count: int) -> int:
    """Return the number of rows to which a path of so many is padded."""
    count = _LEAST
    while count < row_count:
        count *= _RATIO
    return count


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


def pad_rows(
    rows: Float[Array, "step ..."] | Float[np.ndarray, "step ..."], step_count: int
) -> Float[Array, "row ..."] | Float[np.ndarray, "row ..."]:
    """Return rows as long as those of a padded path; the last one comes again."""
    if rows.shape[0] == step_count:
        return rows
    at = np.minimum(np.arange(step_count), rows.shape[0] - 1)
    return np.asarray(rows)[at]


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
    kept = [on_device(np.asarray(rows)[:row_count]) for rows in at(tree)]
    return eqx.tree_at(at, tree, kept)
