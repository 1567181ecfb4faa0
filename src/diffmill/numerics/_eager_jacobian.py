"""Functions whose slopes are computed with their value, once for many products.

`jax.linearize` keeps all that a function computes on its way or, under
`jax.checkpoint`, computes it again in every product. Where few numbers come out, the
Jacobian itself is less to keep, and a product with it is a sum.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree


def eager_jacobian(
    function: Callable[..., Float[Array, " out"]],
) -> Callable[..., Float[Array, " out"]]:
    """Return a function of few outputs that is linearised into its Jacobian.

    That costs a reverse sweep per output, so it is worth it where many products
    follow.

    Args:
        function: Takes pytrees, returns one vector. It must not close over what it is
            differentiated in.

    Returns:
        The same function.

    **Differentiability**: that of `function`, in forward and reverse mode.
    """

    def slopes(out: Array, pull: Callable[[Array], Any]) -> PyTree:
        return jax.vmap(pull)(jnp.eye(out.size, dtype=out.dtype))

    # A sum, no matrix product: those are rounded to less on some devices.
    def product(slope: Array, move: Array) -> Array:
        return jnp.sum((slope * move[None]).reshape(slope.shape[0], -1), axis=1)

    return _with_slopes(function, slopes, product)


def eager_row_jacobian(
    function: Callable[..., Float[Array, "row out"]],
) -> Callable[..., Float[Array, "row out"]]:
    """Return a function of rows that is linearised into gradients of each row.

    That costs a reverse sweep per output of a row.

    Args:
        function: Takes pytrees, returns few numbers per row, which depend on the same
            row of its arguments only: whatever it is differentiated in has the axis
            of the rows first. It must not close over it.

    Returns:
        The same function.

    Raises:
        ValueError: It is differentiated in something without that axis.

    **Differentiability**: that of `function`, in forward and reverse mode.
    """

    def product(slope: Array, move: Array) -> Array:
        return jnp.sum((slope * move[None]).reshape(*slope.shape[:2], -1), axis=2).T

    def slopes(out: Array, pull: Callable[[Array], Any]) -> PyTree:
        unit = jnp.eye(out.shape[1], dtype=out.dtype)[:, None]
        rows = jax.vmap(pull)(jnp.broadcast_to(unit, (out.shape[1], *out.shape)))
        for found in jax.tree.leaves(rows):
            if found.shape[1:2] != out.shape[:1]:
                raise ValueError(
                    "What rows are differentiated in must have one entry per row, "
                    f"{out.shape[0]}, but has the shape {found.shape[1:]}."
                )
        return rows

    return _with_slopes(function, slopes, product)


def _with_slopes(
    function: Callable[..., Array],
    slopes_of: Callable[[Array, Callable[[Array], Any]], PyTree],
    product: Callable[[Array, Array], Array],
) -> Callable[..., Array]:
    """Return a function whose tangent is a sum of products of slopes and moves."""

    @eqx.filter_custom_jvp
    def run(args: PyTree) -> Array:
        return function(*args)

    @run.def_jvp
    def rule(primals: Any, tangents: Any) -> tuple[Array, Array]:
        (args,), (moves,) = primals, tangents
        # Without a tangent there is None in its place.
        is_moving = jax.tree.map(lambda move: move is not None, moves, is_leaf=_is_none)
        free, fixed = eqx.partition(args, is_moving)
        out, pull = jax.vjp(lambda x: function(*eqx.combine(x, fixed)), free)
        slopes = slopes_of(out, lambda row: pull(row)[0])
        parts = jax.tree.map(product, slopes, eqx.filter(moves, is_moving))
        return out, sum(jax.tree.leaves(parts), jnp.zeros_like(out))

    return lambda *args: run(args)


def _is_none(x: Any) -> bool:
    return x is None
