"""Paths padded to few lengths: rows that count, and those that no period computes.

A compiled program serves one length, so that paths are padded before they run. A path
beyond the longest length is taken piece by piece, so that neither a program nor what
it holds at once grows with the path.

In the rows behind the last one the machine does nothing: a period there leaves the arm
as it is, and removes at most what is left to remove anyway.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, PyTree, Shaped

from ._arrays import is_traced, on_device
from ._types import IntScalar

_Tree = TypeVar("_Tree")
_Row = TypeVar("_Row")
# Paths are padded to the least of these lengths: this times a power of the ratio.
_LEAST, _RATIO = 256, 4
# The longest of them: a longer path is taken in pieces of so many rows.
LONGEST = 16_384
# Rows that are left out together where none of them counts.
_TOGETHER = 64


def padded_count(row_count: int) -> int:
    """Return the number of rows to which a path of so many is padded.

    Beyond the longest length these are whole pieces.
    """
    if row_count > LONGEST:
        return -(-row_count // LONGEST) * LONGEST
    count = _LEAST
    while count < row_count:
        count *= _RATIO
    return count


def pad_rows(
    rows: Shaped[Array, "step ..."] | Shaped[np.ndarray, "step ..."], step_count: int
) -> Shaped[Array, "row ..."] | Shaped[np.ndarray, "row ..."]:
    """Return rows as long as those of a padded path; the last one comes again.

    Rows of any kind are: places, axes, and the flags of a path's steps.
    """
    if rows.shape[0] == step_count:
        return rows
    at = np.minimum(np.arange(step_count), rows.shape[0] - 1)
    # A device would compile the lookup for each length.
    return rows[at] if is_traced(rows) else np.asarray(rows)[at]


def in_pieces(compute: Callable[[PyTree], _Tree], rows: PyTree) -> _Tree:
    """Values of rows that do not depend on each other, on the host, piece by piece.

    Args:
        compute: From padded rows to their values, row by row.
        rows: Arrays of a path's rows, a tree with an axis row.

    Returns:
        The values of all rows, as arrays of NumPy.
    """
    rows = jax.tree.map(np.asarray, rows)
    count = jax.tree.leaves(rows)[0].shape[0]
    total = min(padded_count(count), LONGEST)
    starts = range(0, count, total)
    found = [jax.device_get(compute(_piece(rows, k, total))) for k in starts]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)


def _piece(rows: PyTree, first: int, total: int) -> PyTree:
    """Some rows on the device, from one on; the last of all comes again."""
    cut = lambda x: x[np.minimum(np.arange(first, first + total), len(x) - 1)]
    return jax.tree.map(lambda x: on_device(cut(x)), rows)


def last_row(step_count: int, row_count: IntScalar | None) -> Int[Array, ""]:
    """Return the index of the last row that counts."""
    end = step_count if row_count is None else row_count
    return jnp.asarray(end - 1, jnp.int32)


def live_rows(
    indices: Int[Array, " period"], row_count: IntScalar | None
) -> Bool[Array, " period"] | None:
    """Flags of the periods that end at a row that counts; None for all."""
    return None if row_count is None else indices < row_count


def if_valid(
    is_live: Bool[Array, ""] | None,
    compute: Callable[[], _Tree],
    otherwise: _Tree | None = None,
) -> _Tree:
    """Values that a period computes, if it is one that counts.

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


class _Part(NamedTuple):
    """Rows that are left out together, or run.

    Attributes:
        rows: The rows, a tree with an axis row.
        is_live: Which of them count, shape (row,).
        is_run: Whether they are run, shape ().
    """

    rows: PyTree
    is_live: Bool[Array, "*part row"]
    is_run: Bool[Array, "*part"]


def scan_rows(
    step: Callable[[_Tree, _Row, Bool[Array, ""] | None], PyTree],
    carry: _Tree,
    rows: _Row,
    is_live: Bool[Array, " row"] | None,
    *,
    behind: int = 0,
    together: int = _TOGETHER,
) -> PyTree:
    """Scan over rows as `jax.lax.scan`, without many rows that do not count.

    Where none of some rows counts, they are left out together: a branch that hands a
    stock on copies it, which is then little beside the rows of the other branch. Rows
    are filled up to whole parts with the last one, which then does not count.

    Args:
        step: From carry, row and whether it counts to carry and output.
        carry: What is carried from row to row.
        rows: The rows, a tree with an axis row.
        is_live: Which of them count, the first ones, shape (row,); None for all.
        behind: How many rows behind the last one that counts are run at least.
        together: How many rows are left out together.

    Returns:
        The last carry, and the outputs of all rows; of those left out zeros.
    """
    if is_live is None:
        return jax.lax.scan(lambda carry, row: step(carry, row, None), carry, rows)
    count = is_live.shape[0]
    parts = -(-count // together)
    index = jnp.arange(parts * together).reshape(parts, together)
    at = jnp.minimum(index, count - 1)
    # It is traced for its shapes, too.
    run = jax.jit(
        lambda carry, rows: jax.lax.scan(lambda c, x: step(c, *x), carry, rows)
    )

    def part(carry: _Tree, part: _Part) -> PyTree:
        scan = lambda: run(carry, (part.rows, part.is_live))
        shapes = jax.eval_shape(scan)[1]
        none = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        return jax.lax.cond(part.is_run, scan, lambda: (carry, none))

    split = jax.tree.map(lambda x: x[at], rows)
    live = is_live[at] & (index < count)
    is_run = _are_run(is_live, at[:, 0], behind)
    carry, found = jax.lax.scan(part, carry, _Part(split, live, is_run))
    return carry, jax.tree.map(lambda x: jax.lax.collapse(x, 0, 2)[:count], found)


def whole_parts(row_count: int) -> int:
    """Return the number of rows in as many whole parts of `scan_rows` as it takes."""
    return -(-row_count // _TOGETHER) * _TOGETHER


def _are_run(
    is_live: Bool[Array, " row"], firsts: Int[Array, " part"], behind: int
) -> Bool[Array, " part"]:
    """Flags of the parts that are run, from the rows at which they begin."""
    return is_live[jnp.maximum(firsts - behind, 0)]


def count_run(
    is_live: Bool[Array, " row"] | None, row_count: int, behind: int
) -> Int[Array, ""]:
    """Number of rows that `scan_rows` runs, those behind the last included.

    Args:
        is_live: As of `scan_rows`.
        row_count: How many rows there are.
        behind: As of `scan_rows`.
    """
    if is_live is None:
        return jnp.asarray(row_count, jnp.int32)
    firsts = jnp.arange(0, row_count, _TOGETHER)
    parts = jnp.sum(_are_run(is_live, firsts, behind), dtype=jnp.int32)
    return jnp.minimum(parts * _TOGETHER, row_count)


def map_rows(
    compute: Callable[..., _Tree], is_live: Bool[Array, " row"] | None, *rows: PyTree
) -> _Tree:
    """Map over rows as `jax.vmap`, without many rows that do not count.

    Args:
        compute: What is computed of a row, from its part of each of the trees.
        is_live: Which rows count, the first ones, shape (row,); None for all.
        rows: Trees with an axis row.

    Returns:
        The outputs of all rows; zeros where none of some rows counts.
    """
    if is_live is None:
        return jax.vmap(compute)(*rows)
    count = is_live.shape[0]
    parts = -(-count // _TOGETHER)
    index = jnp.arange(parts * _TOGETHER).reshape(parts, _TOGETHER)
    split = jax.tree.map(lambda x: x[jnp.minimum(index, count - 1)], rows)
    live = is_live[jnp.minimum(index, count - 1)]

    def of_part(part: _Part) -> _Tree:
        return if_valid(part.is_run, lambda: jax.vmap(compute)(*part.rows))

    found = jax.lax.map(of_part, _Part(split, live, live[:, 0]))
    return jax.tree.map(lambda x: jax.lax.collapse(x, 0, 2)[:count], found)
