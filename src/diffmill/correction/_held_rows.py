"""Rows of a residual that are kept within bounds instead of being made small.

They come with the residual, from the same run of the plant, and do not count in the
square. As long as a row is out of its bounds the least squares first bring it back:
what their linear model has outside, of this row or any other, counts many times over.
Once all are within, each step is bounded by their linear model, drawn in a little for
what is not linear, and a trial that leaves the bounds all the same is refused.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ._products import AbstractProducts
from ._spline.command_limits import AbstractRows

# The linear model may go to this share of a bound.
_DRAWN_IN = 0.95
# Weight of what is out of bounds while it is brought back: far more than what is to
# become small, which is about 1 at its largest.
_WEIGHT = 30.0

Rows = Float[np.ndarray, " row"]


class HeldRows(eqx.Module):
    """Bounds of the last entries of a residual.

    Attributes:
        lower: Least values, below 0 or minus infinity, shape (row,).
        upper: Largest values, above 0 or infinity, shape (row,).
    """

    lower: Rows = eqx.field(default_factory=lambda: np.zeros(0))
    upper: Rows = eqx.field(default_factory=lambda: np.zeros(0))

    def __check_init__(self):
        if self.lower.shape != self.upper.shape:
            raise ValueError("Arguments `lower` and `upper` must have one shape.")
        if not np.all((self.lower < 0) & (self.upper > 0)):
            raise ValueError(
                "Arguments `lower` and `upper` must lie below and above 0, but do not."
            )

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.lower.shape[0]

    def rows(self, residual: Float[Array, " entry"]) -> Rows:
        """Return the values of the rows."""
        return np.asarray(residual[residual.shape[0] - self.count :], np.float64)

    def outside(self, rows: Rows, share: float = 1.0) -> Rows:
        """Return how far rows are out of a share of their bounds, with the sign."""
        return rows - np.clip(rows, share * self.lower, share * self.upper)

    def is_within(self, rows: Rows) -> bool:
        """Tell whether all rows are within their bounds."""
        return bool(np.all((rows >= self.lower) & (rows <= self.upper)))

    def weight(self, residual: Float[Array, "*entry"]) -> float:
        """Return the weight of what is out of bounds; 0 if all rows are within."""
        if not self.count or self.is_within(self.rows(residual)):
            return 0.0
        return _WEIGHT

    def cost(self, residual: Float[Array, "*entry"], weight: float) -> float:
        """Return half the square that is to become small.

        Infinite for rows out of their bounds that have been within.
        """
        if not self.count:
            return 0.5 * float(jnp.sum(residual**2))
        rows = self.rows(residual)
        counted = residual[: residual.shape[0] - self.count]
        square = float(jnp.sum(counted**2))
        if weight:
            square += weight**2 * float(np.sum(self.outside(rows, _DRAWN_IN) ** 2))
        elif not self.is_within(rows):
            square = np.inf
        return 0.5 * square

    def slope(
        self, residual: Float[Array, "*entry"], weight: float
    ) -> Float[Array, "*entry"]:
        """Return the derivative of the cost by the residual."""
        if not self.count:
            return residual
        push = np.zeros(self.count)
        if weight:
            push = weight**2 * self.outside(self.rows(residual), _DRAWN_IN)
        return self._with_rows(residual, push)

    def without(self, change: Float[Array, "*entry"]) -> Float[Array, "*entry"]:
        """Return a change of the residual without that of the rows."""
        if not self.count:
            return change
        return self._with_rows(change, np.zeros(self.count))

    def only(self, like: Float[Array, " entry"], rows: Rows) -> Float[Array, " entry"]:
        """Return a residual of which all but the rows is zero."""
        return self._with_rows(0 * like, rows)

    def _with_rows(
        self, residual: Float[Array, " entry"], rows: Rows
    ) -> Float[Array, " entry"]:
        counted = residual[: residual.shape[0] - self.count]
        return jnp.concatenate([counted, jnp.asarray(rows, residual.dtype)])


class LinearModel:
    """Products with a residual's Jacobian at one point, counted.

    It remembers the last product J p: rows and square ask for the same one.
    """

    def __init__(
        self,
        products: AbstractProducts,
        program: PyTree,
        vector: Callable[[np.ndarray], Array],
        scale: np.ndarray,
    ):
        self.spent = 0
        self._products = products
        self._program = program
        self._vector = vector
        self._scale = scale
        self._last: tuple[np.ndarray, Array] | None = None

    def forward(self, p: np.ndarray) -> Array:
        """Return J p, p in units of the scale."""
        if self._last is None or self._last[0] is not p:
            self.spent += 1
            w = self._products.forward(self._program, self._vector(p))
            self._last = p, w
        return self._last[1]

    def transpose(self, w: Array) -> np.ndarray:
        """Return J^T w in units of the scale."""
        return self._back(self._products.transpose, w)

    def gradient(self, w: Array) -> np.ndarray:
        """Return the same to the last digit, in units of the scale."""
        return self._back(self._products.gradient, w)

    def _back(self, product: Callable[..., Array], w: Array) -> np.ndarray:
        self.spent += 1
        like = self._vector(np.zeros_like(self._scale))
        return np.asarray(product(self._program, like, w), np.float64) * self._scale


class HeldStep(AbstractRows):
    """Bounds of a step by the linear model of held rows.

    Attributes:
        held: The rows.
        model: The linear model of the residual.
        lower: Least changes, shape (row,).
        upper: Largest changes, shape (row,).
        residual: The residual where the step begins, for its shape.
    """

    held: HeldRows
    model: LinearModel
    lower: Rows
    upper: Rows
    residual: Float[Array, " entry"]

    def apply(self, coefficients: np.ndarray) -> Rows:
        """Return the changes of the rows."""
        return self.held.rows(self.model.forward(coefficients))

    def transpose(self, rows: Rows) -> np.ndarray:
        """Return the transposed map of changes."""
        return self.model.transpose(self.held.only(self.residual, rows))


def held_step(
    held: HeldRows, model: LinearModel, residual: Float[Array, " entry"]
) -> HeldStep:
    """Return the bounds of a step.

    Args:
        held: The rows.
        model: The linear model where the step begins.
        residual: The residual there.

    Returns:
        Bounds of the changes to the drawn in bounds. If all rows are within the bounds
        themselves, "no step" keeps them: a row between both may not come closer.

    **Differentiability**: runs on the host, not traceable.
    """
    rows = held.rows(residual)
    lower, upper = _DRAWN_IN * held.lower - rows, _DRAWN_IN * held.upper - rows
    if held.is_within(rows):
        lower, upper = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
    return HeldStep(held=held, model=model, lower=lower, upper=upper, residual=residual)
