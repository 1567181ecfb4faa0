"""Functions of many scalars, each compiled to one stretch of machine code.

Such a function takes every number as an array of its own, whose only axis is that of a
batch, so that zeros and symmetry cost nothing and a batch runs along SIMD registers.

XLA's CPU compiler fuses such code until every result computes its own inputs again.
Two attributes of its calls stop that, for these operations alone: the results of a call
that is not inlined are stored (`materialise`), and a call that is declared small is
compiled to one function without a dispatch per operation.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata
from jaxtyping import Array, PyTree

from .materialise import materialise

# Elements of a batch that are computed together: some hundred arrays of this length fit
# the second cache. XLA must not split an operation inside a small call into threads (it
# then emits a call with wrong arguments); it does so from 256 KiB on.
_BLOCK = 256


def as_scalar_code(function: Callable[..., Array]) -> Callable[..., Array]:
    """Function of a model and arrays as one stretch of machine code; `vmap` batches it.

    Args:
        function: Of a model, a tree of arrays, and of arrays with any number of
            trailing axes of a batch; returns an array with the same trailing axes.

    Returns:
        The function of arrays without a batch. A batch of models is computed one model
        after the other.

    **Differentiability**: none; a caller gives derivatives of its own.
    """
    # XLA 0.10 stops at an argument that a small call in a loop does not use: a
    # materialised argument is used.
    compiled = jax.jit(lambda *args: function(*materialise(args)))

    def compute(*args: Any) -> Array:
        if jax.default_backend() != "cpu":
            return compiled(*args)
        with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
            return compiled(*args)

    @custom_vmap
    def single(model: PyTree, *args: Array) -> Array:
        return compute(model, *args)

    @single.def_vmap
    def batch(
        count: int, is_batched: list[Any], model: PyTree, *args: Array
    ) -> tuple[Array, bool]:
        of_model, *of_args = is_batched
        if any(jax.tree.leaves(of_model)):
            return _one_after_another(single, is_batched, (model, *args)), True
        full = [
            x if b else jnp.broadcast_to(x[None], (count, *x.shape))
            for x, b in zip(args, of_args, strict=True)
        ]
        return _in_blocks(compute, model, full, count), True

    return single


def _one_after_another(
    single: Callable[..., Array], is_batched: list[Any], args: tuple[Any, ...]
) -> Array:
    """Results of a batch in which the model, too, differs from row to row."""
    leaves, tree = jax.tree.flatten(args)
    flags = jax.tree.leaves(is_batched)

    def of_row(row: list[Array]) -> Array:
        batched = iter(row)
        own = [next(batched) if b else x for x, b in zip(leaves, flags, strict=True)]
        return single(*tree.unflatten(own))

    rows = [x for x, b in zip(leaves, flags, strict=True) if b]
    return jax.lax.map(of_row, rows)


def _in_blocks(
    compute: Callable[..., Array], model: PyTree, args: list[Array], count: int
) -> Array:
    """Results of a batch, whose axis is the last one inside and the first outside."""

    def block(rows: list[Array]) -> Array:
        columns = compute(model, *(jnp.moveaxis(x, 0, -1) for x in rows))
        return jnp.moveaxis(columns, -1, 0)

    if count <= _BLOCK:
        return block(args)
    blocks = -(-count // _BLOCK)

    def split(x: Array) -> Array:
        # The last block is filled up with copies of the last element.
        spare = [(0, blocks * _BLOCK - count)] + [(0, 0)] * (x.ndim - 1)
        return jnp.pad(x, spare, mode="edge").reshape(blocks, _BLOCK, *x.shape[1:])

    results = jax.lax.map(block, [split(x) for x in args])
    return results.reshape(blocks * _BLOCK, *results.shape[2:])[:count]
