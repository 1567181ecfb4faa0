"""Batches that a CPU computes one element after the other."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero

_P = ParamSpec("_P")
_T = TypeVar("_T")


def batched_in_turn(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Function that `vmap` maps one element after the other on a CPU.

    A batch of branches takes all of them, and a batch of slices becomes a gather, so
    that a loop over a table costs several times what its elements cost in turn. On
    other devices the batch is that of `vmap`.

    Args:
        function: Of trees of arrays and of anything else, which must not hold traced
            values of its own.

    Returns:
        The function.

    **Differentiability**: that of the function, whose derivatives `vmap` batches as it
    does without this.
    """
    # Which arguments these are is checked where they come in.
    call: Callable[..., _T] = function

    @functools.wraps(function)
    def in_turn(*args: _P.args, **keywords: _P.kwargs) -> _T:
        arrays, rest = eqx.partition((args, keywords), eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        others: list[Any] = []

        def plain(*leaves: Any) -> Any:
            args, keywords = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            found, other = eqx.partition(call(*args, **keywords), eqx.is_array)
            others[:] = [other]
            return found

        # Outside of `jit` JAX gives constants back as arrays of NumPy.
        found = jax.tree.map(jnp.asarray, _in_turn(plain)(*leaves))
        return eqx.combine(found, others[0])

    return in_turn


def _in_turn(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Function of arrays alone, see `batched_in_turn`."""

    @custom_vmap
    def single(*leaves: Any) -> Any:
        return plain(*leaves)

    @single.def_vmap
    def batch(_: int, is_batched: list[bool], *leaves: Any) -> tuple[Any, Any]:
        if jax.default_backend() == "cpu":
            found = _mapped(single, is_batched, leaves)
        else:
            axes = [0 if batched else None for batched in is_batched]
            found = jax.vmap(plain, axes)(*leaves)
        return found, jax.tree.map(lambda _: True, found)

    # Only what is not differentiated goes by the rule: JAX has none for reverse mode.
    value = jax.custom_jvp(single)

    @functools.partial(value.defjvp, symbolic_zeros=True)
    def derivative(primals: Any, tangents: Any) -> tuple[Any, Any]:
        moves = [not isinstance(x, SymbolicZero) for x in tangents]

        def of_moved(*moved: Any) -> Any:
            given = iter(moved)
            pairs = zip(primals, moves, strict=True)
            return plain(*(next(given) if moves else x for x, moves in pairs))

        of = lambda rows: tuple(x for x, on in zip(rows, moves, strict=True) if on)
        return jax.jvp(of_moved, of(primals), of(tangents))

    return value


def _mapped(
    single: Callable[..., Any], is_batched: list[bool], leaves: tuple[Any, ...]
) -> Any:
    """Results of a batch, one element after the other."""

    def of_row(row: list[Any]) -> Any:
        rows = iter(row)
        pairs = zip(leaves, is_batched, strict=True)
        return single(*(next(rows) if batched else x for x, batched in pairs))

    rows = [x for x, batched in zip(leaves, is_batched, strict=True) if batched]
    return jax.lax.map(of_row, rows)
