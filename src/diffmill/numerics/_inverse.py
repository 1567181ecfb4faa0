"""The inverse of a small matrix without LAPACK, alone or in batches.

Two of jaxlib's batched LAPACK calls that run beside each other wait for the same few
threads of XLA, and now and then for ever.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


@jax.custom_jvp
def small_inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a matrix of a few rows.

    Gauss and Jordan's elimination, each column with its largest pivot, as a loop:
    written out, it takes twice as long to compile.

    Args:
        matrix: Any square matrix, shape (n, n).

    Returns:
        The inverse, shape (n, n); not finite where the matrix is singular.

    **Differentiability**: smooth; a derivative is two products.
    """
    count = matrix.shape[0]
    rows = jnp.concatenate([matrix, jnp.eye(count, dtype=matrix.dtype)], axis=1)
    index = jnp.arange(count)

    def eliminate(
        k: Int[Array, ""], rows: Float[Array, "n both"]
    ) -> Float[Array, "n both"]:
        candidates = jnp.where(index >= k, jnp.abs(rows[:, k]), -1.0)
        is_pivot = index == jnp.argmax(candidates)
        pivot = jnp.sum(jnp.where(is_pivot[:, None], rows, 0.0), axis=0)
        rows = jnp.where(is_pivot[:, None], rows[k][None], rows)
        pivot = pivot / pivot[k]
        cleared = rows - rows[:, k][:, None] * pivot[None]
        return jnp.where((index == k)[:, None], pivot[None], cleared)

    rows = jax.lax.fori_loop(0, count, eliminate, rows)
    return rows[:, count:]


@small_inverse.defjvp
def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Array, Array]:
    inverse = small_inverse(*primals)
    return inverse, -inverse @ tangents[0] @ inverse
