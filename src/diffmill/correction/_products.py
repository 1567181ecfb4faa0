"""Products with the Jacobian of a residual: J v and J^T w without the matrix."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
from jaxtyping import Array, Float, PyTree

# Takes the unknowns and everything else that the residual needs, as a pytree, so that
# no large array becomes a constant of the compiled program.
Residual = Callable[[Float[Array, "*unknown"], PyTree], Float[Array, "*residual"]]


class AbstractProducts(eqx.Module):
    """Products with a Jacobian: the trade of memory for time."""

    @abc.abstractmethod
    def linearise(
        self, residual: Residual, x: Float[Array, "*unknown"], args: PyTree
    ) -> tuple[Float[Array, "*residual"], PyTree]:
        """Return the residual at x and whatever the products need from there."""

    @abc.abstractmethod
    def forward(
        self, linear: PyTree, v: Float[Array, "*unknown"]
    ) -> Float[Array, "*residual"]:
        """Return J v."""

    @abc.abstractmethod
    def transpose(
        self, linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
    ) -> Float[Array, "*unknown"]:
        """Return J^T w; x only tells the shape of the unknowns."""

    def gradient(
        self, linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
    ) -> Float[Array, "*unknown"]:
        """Return J^T w to the last digit, where the products are not."""
        return self.transpose(linear, x, w)


class StoredProducts(AbstractProducts):
    """Linearise once and store the linear program: the fastest products.

    Each product then runs only linear operations and none of the simulation. The
    coefficients of every step are in memory at once: about what plain reverse mode
    needs.
    """

    def linearise(
        self, residual: Residual, x: Float[Array, "*unknown"], args: PyTree
    ) -> tuple[Float[Array, "*residual"], PyTree]:
        """Return the residual and the stored linear program."""
        return _linearise(residual, x, args)

    def forward(
        self, linear: PyTree, v: Float[Array, "*unknown"]
    ) -> Float[Array, "*residual"]:
        """Return J v from the stored program."""
        return _push(linear, v)

    def transpose(
        self, linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
    ) -> Float[Array, "*unknown"]:
        """Return J^T w from the stored program, transposed."""
        return _pull(linear, x, w)


@eqx.filter_jit
def evaluate(
    residual: Residual, x: Float[Array, "*unknown"], args: PyTree
) -> Float[Array, "*residual"]:
    """Return the residual, compiled once per residual and shapes."""
    return residual(x, args)


@eqx.filter_jit
def _linearise(
    residual: Residual, x: Float[Array, "*unknown"], args: PyTree
) -> tuple[Float[Array, "*residual"], PyTree]:
    # jax.linearize returns a pytree: its leaves are the coefficients, its structure
    # the linear program, the same object for every call of this compiled function.
    return jax.linearize(lambda y: residual(y, args), x)


@eqx.filter_jit
def _push(linear: PyTree, v: Float[Array, "*unknown"]) -> Float[Array, "*residual"]:
    return linear(v)


@eqx.filter_jit
def _pull(
    linear: PyTree, x: Float[Array, "*unknown"], w: Float[Array, "*residual"]
) -> Float[Array, "*unknown"]:
    return jax.linear_transpose(linear, x)(w)[0]


@eqx.filter_jit
def pull_once(
    residual: Residual,
    x: Float[Array, "*unknown"],
    args: PyTree,
    w: Float[Array, "*residual"],
) -> Float[Array, "*unknown"]:
    """Return J^T w by one run in reverse mode."""
    return jax.vjp(lambda y: residual(y, args), x)[1](w)[0]
