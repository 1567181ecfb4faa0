"""Arrays of numbers known on the host, for devices and in one precision."""

from typing import TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

_Tree = TypeVar("_Tree")


def on_device(rows: Array | np.ndarray) -> Array:
    """Return an array of JAX; `jnp.asarray` would compile a copy for every shape."""
    return rows if isinstance(rows, jax.Array) else jax.device_put(rows)


def first_rows(tree: _Tree, count: int) -> _Tree:
    """Return the first of the rows of all arrays, cut on the host.

    A device would compile a slice for each length.
    """
    cut = lambda x: x if x.shape[0] == count else on_device(np.asarray(x)[:count])
    return jax.tree.map(cut, tree)


def cast_floats(tree: _Tree, dtype: jnp.dtype) -> _Tree:
    """Return a tree with every floating leaf as an array of one type."""

    def cast(leaf: object) -> object:
        is_float = isinstance(leaf, float) or (
            hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)  # pyright: ignore[reportAttributeAccessIssue]
        )
        if not is_float:
            return leaf
        if isinstance(leaf, jax.Array):
            return jnp.asarray(leaf, dtype)
        return on_device(np.asarray(leaf, np.dtype(dtype)))  # pyright: ignore[reportArgumentType]

    return jax.tree.map(cast, tree)


def is_traced(arguments: object) -> bool:
    """Return whether JAX traces any of the arguments, as for a derivative."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(arguments))
