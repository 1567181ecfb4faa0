"""Rows of a padded path that count, and those that no period computes.

In the rows behind the last one the machine does nothing: a period there leaves the arm
as it is, and removes at most what is left to remove anyway.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ._types import IntScalar

_Tree = TypeVar("_Tree")


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
