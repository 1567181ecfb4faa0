"""Paths padded to few lengths: rows that count, and those that no period computes.

A compiled program serves one length, so that paths are padded before they run.

In the rows behind the last one the machine does nothing: a period there leaves the arm
as it is, and removes at most what is left to remove anyway.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._types import IntScalar

_Tree = TypeVar("_Tree")
# Paths are padded to the least of these lengths: this times a power of the ratio.
_LEAST, _RATIO = 256, 4


def padded_count(row_count: int) -> int:
    """Return the number of rows to which a path of so many is padded."""
    count = _LEAST
    while count < row_count:
        count *= _RATIO
    return count


def pad_rows(
    rows: Float[Array, "step ..."] | Float[np.ndarray, "step ..."], step_count: int
) -> Float[Array, "row ..."] | Float[np.ndarray, "row ..."]:
    """Return rows as long as those of a padded path; the last one comes again."""
    if rows.shape[0] == step_count:
        return rows
    at = np.minimum(np.arange(step_count), rows.shape[0] - 1)
    return np.asarray(rows)[at]


def last_row(step_count: int, row_count: IntScalar | None) -> Int[Array, ""]:
    """Return the index of the last row that counts."""
    end = step_count if row_count is None else row_count
    return jnp.asarray(end - 1, jnp.int32)


def live_rows(
    indices: Int[Array, " period"], row_count: IntScalar | None
) -> Bool[Array, " period"] | None:
    """Return which periods end at a row that counts; None for all."""
    return None if row_count is None else indices < row_count


def when_live(
    is_live: Bool[Array, ""] | None,
    compute: Callable[[], _Tree],
    otherwise: _Tree | None = None,
) -> _Tree:
    """Return what a period computes, if it is one that counts.

    Only what leaves the stock as it is may be skipped: a branch that hands a stock on
    copies it, which takes as long as a period.

    Args:
        is_live: Whether the period counts, shape (); None for a path that is not
            padded.
        compute: Returns what the period computes.
        otherwise: What is returned instead; zeros if not given.
    """
    if is_live is None:
        return compute()
    if otherwise is None:
        shapes = jax.eval_shape(compute)
        otherwise = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.cond(is_live, compute, lambda: otherwise)
