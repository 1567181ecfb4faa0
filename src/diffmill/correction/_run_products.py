"""Products with the Jacobian of a contour residual, written down from the linear run.

The plant's linear system carries all unknowns through the run at once. It holds the
stock, so that the matrix is a little off; the gradient, by reverse mode, is exact, and
steps end where it says.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ._core.problem import AbstractLinearPlant, LinearMotion, Motion
from ._products import AbstractProducts, Residual, StoredProducts, pull_once

# Unknowns that are carried through the run at once: what bounds its memory.
_BLOCK = 96


class RunProducts(AbstractProducts):
    """The matrix, where the plant knows its linear system, else stored products."""

    def linearise(
        self, residual: Residual, x: Float[Array, "*unknown"], args: Any
    ) -> tuple[Float[Array, "*residual"], PyTree]:
        """Return the residual and the matrix, or the stored linear program."""
        plant = args.problem.plant
        linear = None
        if args.ensemble is None and isinstance(plant, AbstractLinearPlant):
            linear = plant.linearised(_command(x, args))
        if linear is None:
            return StoredProducts().linearise(residual, x, args)
        blocks = _blocks(x.size)
        found = [_columns(linear, x, args, jnp.asarray(block)) for block in blocks]
        J = np.concatenate([np.asarray(J, np.float64) for _, J in found])
        return found[0][0], _Matrix(J[: x.size].T, residual, x, args)

    def forward(
        self, linear: PyTree, v: Float[Array, "*unknown"]
    ) -> Float[Array, "*residual"]:
        """Return J v."""
        if not isinstance(linear, _Matrix):
            return StoredProducts().forward(linear, v)
        return jnp.asarray(linear.J @ np.asarray(v, np.float64).reshape(-1), v.dtype)

    def transpose(
        self, linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
    ) -> Float[Array, "*unknown"]:
        """Return J^T w."""
        if not isinstance(linear, _Matrix):
            return StoredProducts().transpose(linear, x, w)
        back = linear.J.T @ np.asarray(w, np.float64)
        return jnp.asarray(back.reshape(x.shape), x.dtype)

    def gradient(
        self, linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
    ) -> Float[Array, "*unknown"]:
        """Return J^T w by reverse mode of the residual itself."""
        if not isinstance(linear, _Matrix):
            return StoredProducts().transpose(linear, x, w)
        return pull_once(linear.residual, linear.x, linear.args, w)


class _Matrix(eqx.Module):
    """A Jacobian and where it was taken."""

    J: np.ndarray
    residual: Residual
    x: Float[Array, "*unknown"]
    args: PyTree


def _blocks(count: int) -> list[list[int]]:
    """Return the unknowns in blocks of one length, the last one filled up."""
    size = min(_BLOCK, count)
    return [
        [min(i, count - 1) for i in range(first, first + size)]
        for first in range(0, count, size)
    ]


@eqx.filter_jit
def _command(x: Float[Array, "coefficient axis"], args: Any) -> Array:
    return jnp.asarray(args.problem.nominal, x.dtype) + args.spline.offsets(x)


@eqx.filter_jit
def _columns(
    linear: LinearMotion, x: Float[Array, "coefficient axis"], args: Any, block: Array
) -> tuple[Float[Array, " residual"], Float[Array, "direction residual"]]:
    """Return the residual, and some rows of its transposed Jacobian."""
    from ._method.gauss_newton import terms

    axes = x.shape[1]
    # The basis is the same for every axis: its columns are offsets of unit vectors.
    basis = args.spline.offsets(jnp.eye(x.shape[0], dtype=x.dtype))
    column, axis = block // axes, block % axes
    along = jax.nn.one_hot(axis, axes, dtype=x.dtype)
    changes = basis[:, column][:, None] * along.T[None]
    moves = linear.move(changes)
    units = (
        along[:, None] * jax.nn.one_hot(column, x.shape[0], dtype=x.dtype)[..., None]
    )

    def residual(motion: Motion, x: Array) -> Array:
        return terms(x, args, motion)

    r, push = jax.linearize(residual, linear.motion, x)
    return r, jax.vmap(push)(moves, units)
