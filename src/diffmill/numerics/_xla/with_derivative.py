"""A value from one place and its derivative from another."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import PyTree

_T = TypeVar("_T", bound=PyTree)


def with_derivative_of(
    values: _T, function: Callable[..., _T], *arguments: PyTree
) -> _T:
    """Values of one source, with the derivative of a function of others.

    Args:
        values: A tree of arrays.
        function: Returns a tree like `values`. It is traced where a derivative is
            asked for, and not otherwise.
        arguments: Its arguments, trees of arrays, with all that is differentiated: a
            value that the function closes over counts as a constant.

    Returns:
        `values`.

    Differentiability: that of the function, in forward and reverse mode.
    """
    return _valued(function, values, arguments)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _valued(function: Callable[..., _T], values: _T, arguments: PyTree) -> _T:
    del function, arguments
    return values


def _jvp(function: Callable[..., _T], primals: Any, tangents: Any) -> tuple[_T, _T]:
    # Not the bare values: a result of them may be differentiated once more.
    values = _valued(function, *primals)
    leaves, tree = jax.tree.flatten(primals[1])
    slopes = tree.flatten_up_to(tangents[1])
    moving = [i for i, x in enumerate(slopes) if not isinstance(x, SymbolicZero)]

    def moved(*moving_leaves: Any) -> _T:
        whole = list(leaves)
        for i, leaf in zip(moving, moving_leaves, strict=True):
            whole[i] = leaf
        return function(*jax.tree.unflatten(tree, whole))

    if not moving:
        return values, jax.tree.map(jnp.zeros_like, values)
    pick = lambda all_leaves: tuple(all_leaves[i] for i in moving)
    _, slope = jax.jvp(moved, pick(leaves), pick(slopes))
    return values, slope


_valued.defjvp(_jvp, symbolic_zeros=True)
