"""Bounds of outputs of a function that is minimised.

As long as an output is out of its bounds the steps first bring it back: what the linear
model has outside, of this output or any other, counts many times over, as a soft
constraint. Once all are within, the linear model of each step is bounded, drawn in a
little for what is not linear, and a trial that leaves the bounds is refused.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ._least_squares import LinearRows

# The linear model may go to this share of a bound.
_DRAWN_IN_SHARE = 0.95
# Weight of what is out of bounds: far more than what is to become small, which is about
# 1 at its largest.
_OUTSIDE_WEIGHT = 30.0

Outputs = Float[np.ndarray, " output"]


class OutputConstraints(eqx.Module):
    """Bounds of outputs, in units in which what is minimised is about 1.

    Attributes:
        lower: Least values, below 0 or minus infinity, shape (output,).
        upper: Largest values, above 0 or infinity, shape (output,).
    """

    lower: Outputs = eqx.field(default_factory=lambda: np.zeros(0))
    upper: Outputs = eqx.field(default_factory=lambda: np.zeros(0))

    def __check_init__(self):
        if self.lower.shape != self.upper.shape:
            raise ValueError("Arguments `lower` and `upper` must have one shape.")
        if not np.all((self.lower < 0) & (self.upper > 0)):
            raise ValueError(
                "Arguments `lower` and `upper` must lie below and above 0, but do not."
            )

    def is_within(self, outputs: Outputs) -> bool:
        """True if all outputs are within their bounds."""
        return bool(np.all((outputs >= self.lower) & (outputs <= self.upper)))

    def cost(self, outputs: Outputs, *, is_hard: bool) -> float:
        """Cost of outputs out of bounds: infinite, or that of the soft constraint."""
        if is_hard:
            return 0.0 if self.is_within(outputs) else np.inf
        drawn = np.clip(
            outputs, _DRAWN_IN_SHARE * self.lower, _DRAWN_IN_SHARE * self.upper
        )
        return 0.5 * _OUTSIDE_WEIGHT**2 * float(np.sum((outputs - drawn) ** 2))

    def rows(
        self, outputs: Outputs, slopes: Float[np.ndarray, "output unknown"]
    ) -> LinearRows:
        """Constraints of a step: hard ones if all outputs are within.

        Args:
            outputs: Where the step begins, shape (output,).
            slopes: Their derivative, shape (output, unknown).
        """
        is_hard = self.is_within(outputs)
        lower = _DRAWN_IN_SHARE * self.lower - outputs
        upper = _DRAWN_IN_SHARE * self.upper - outputs
        if is_hard:
            # An output between both bounds may not come closer.
            lower, upper = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
        return LinearRows(slopes, lower, upper, np.inf if is_hard else _OUTSIDE_WEIGHT)
