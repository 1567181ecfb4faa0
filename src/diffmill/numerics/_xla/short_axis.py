"""Sums over a short axis, and copies along one: each is the other's transpose.

XLA's CPU compiler reduces a short axis by a loop of single numbers; in reverse mode a
broadcast is such a reduction, too. Written term by term, a sum becomes part of the
loops around it, over long axes; but JAX transposes a term into an array of zeros around
it. So both are primitives.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

_sum = Primitive("sum_of_few")
_copies = Primitive("few_copies")


class ShortAxis:
    """Sums over a short axis, and copies along one."""

    @staticmethod
    def sum(terms: Float[Array, " term *any"]) -> Float[Array, "*any"]:
        """Sum over a short leading axis.

        **Differentiability**: linear.
        """
        return _sum.bind(terms)

    @staticmethod
    def copies(values: Float[Array, "*any"], count: int) -> Float[Array, " copy *any"]:
        """Copies of values along a new leading axis.

        **Differentiability**: linear.
        """
        return _copies.bind(values, count=count)


def _add(terms: Array) -> Array:
    first, *others = jnp.unstack(terms)
    return sum(others, first)


def _copy(values: Array, count: int) -> Array:
    return jnp.broadcast_to(values[None], (count, *values.shape))


def _add_batch(args: Sequence[Array], axes: Sequence[int]) -> tuple[Array, int]:
    return ShortAxis.sum(jnp.moveaxis(args[0], axes[0], 1)), 0


def _copy_batch(
    args: Sequence[Array], axes: Sequence[int], *, count: int
) -> tuple[Array, int]:
    return ShortAxis.copies(args[0], count), axes[0] + 1


_sum.def_impl(_add)
_sum.def_abstract_eval(lambda terms: terms.update(shape=terms.shape[1:]))
mlir.register_lowering(_sum, mlir.lower_fun(_add, multiple_results=False))
batching.primitive_batchers[_sum] = _add_batch
ad.deflinear2(_sum, lambda ct, terms: [ShortAxis.copies(ct, terms.aval.shape[0])])

_copies.def_impl(_copy)
_copies.def_abstract_eval(
    lambda values, count: values.update(shape=(count, *values.shape))
)
mlir.register_lowering(_copies, mlir.lower_fun(_copy, multiple_results=False))
batching.primitive_batchers[_copies] = _copy_batch
ad.deflinear2(_copies, lambda ct, values, count: [ShortAxis.sum(ct)])
