"""Arrays of numbers known on the host, for devices and in one precision."""

import math
from collections.abc import Callable, Mapping
from typing import TypeAlias, TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree, Shaped

# Plain arrays by name, as a checkpoint holds them.
Arrays: TypeAlias = Mapping[str, Shaped[np.ndarray, "..."]]
_Tree = TypeVar("_Tree")


def on_device(rows: Array | np.ndarray) -> Array:
    """Return an array of JAX; `jnp.asarray` would compile a copy for every shape."""
    return rows if isinstance(rows, jax.Array) else jax.device_put(rows)


def first_rows(tree: _Tree, count: int) -> _Tree:
    """Return the first of the rows of all arrays, cut on the host unless traced.

    A device would compile a slice for each length.
    """

    def cut(x: Array | np.ndarray) -> Array | np.ndarray:
        if x.shape[0] == count:
            return x
        return x[:count] if is_traced(x) else on_device(np.asarray(x)[:count])

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


def named_leaves(
    tree: PyTree, is_leaf: Callable[[PyTree], bool] | None = None
) -> dict[str, PyTree]:
    """Leaves of a tree, named by their place in it.

    Args:
        tree: The tree.
        is_leaf: As of `jax.tree.flatten`.
    """
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree, is_leaf)
    name = lambda path: jax.tree_util.keystr(path, simple=True, separator="/")
    return {name(path): leaf for path, leaf in leaves}


def below(prefix: str, arrays: Arrays | None) -> dict[str, np.ndarray]:
    """Arrays whose names begin with a prefix, without it."""
    start, known = f"{prefix}/", {} if arrays is None else arrays
    return {k[len(start) :]: known[k] for k in known if k.startswith(start)}


def above(prefix: str, tree: PyTree) -> dict[str, np.ndarray]:
    """Leaves of a tree on the host, named by their place behind a prefix."""
    leaves = named_leaves(jax.device_get(tree))
    return {f"{prefix}/{name}": np.asarray(leaf) for name, leaf in leaves.items()}


def has_values(*leaves: object) -> bool:
    """True if all leaves are numbers or arrays: a part of a tree may have None."""
    return all(isinstance(leaf, jax.Array | np.ndarray | float) for leaf in leaves)


def is_traced(arguments: object) -> bool:
    """True if JAX traces any of the arguments, as for a derivative."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(arguments))


def check_known(
    name: str,
    value: object,
    *,
    least: float = -math.inf,
    is_open: bool = False,
    below: float = math.inf,
    shapes: tuple[tuple[int | None, ...], ...] = ((),),
) -> None:
    """Raise if an argument from outside is no number, or none that is allowed.

    A traced value has a shape and no number to look at.

    Args:
        name: The argument's.
        value: A number, or an array or sequence of them.
        least: The least that is allowed.
        is_open: Whether that is the first that is not.
        below: What all must be below.
        shapes: Shapes that are allowed; None stands for any length.

    Raises:
        ValueError: It says what was found and what is allowed.
    """
    if is_traced(value):
        found, shape = None, jnp.shape(jnp.asarray(value))  # pyright: ignore[reportArgumentType]
    else:
        try:
            found = np.asarray(value)  # pyright: ignore[reportArgumentType, reportCallIssue]
        except ValueError:
            found = np.asarray(None)
        if found.dtype.kind not in "iuf":
            raise ValueError(
                f"Argument `{name}` must be a number or an array of them, but is "
                f"{value!r}."
            )
        shape = found.shape
    alike = lambda x: (
        len(x) == len(shape)
        and all(allowed in (None, size) for allowed, size in zip(x, shape, strict=True))
    )
    if not any(alike(x) for x in shapes):
        allowed = " or ".join(str(x).replace("None", "any") for x in shapes)
        raise ValueError(
            f"Argument `{name}` must have shape {allowed}, but has {shape}."
        )
    if found is None:
        return
    is_low = found > least if is_open else found >= least
    if not np.all(np.isfinite(found) & is_low & (found < below)):
        bounds = ["finite"]
        if least > -math.inf:
            bounds.append(f"{'above' if is_open else 'at least'} {least:g}")
        if below < math.inf:
            bounds.append(f"below {below:g}")
        raise ValueError(
            f"Argument `{name}` must be {' and '.join(bounds)}, but is {value}."
        )
