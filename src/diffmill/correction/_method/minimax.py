"""The largest of several costs, by the quadratic models of all of them.

The step that makes the largest small is that of a weighted mean whose weights none but
the largest have. They are found by raising each weight by its own error, round after
round: Lawson's algorithm for best approximation in the maximum norm, see Rice and Usow,
The Lawson algorithm and extensions, Mathematics of Computation 22, 1968. The rounds
are those of a quadratic program: the costs themselves are computed once a step.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...optimise import LinearRows, QuadraticModel

# Rounds at most, and the share of the cost that may be left to gain at which they end:
# no step makes the largest cost smaller than the weighted mean of any weights.
_ROUNDS = 200
_GAP = 1e-3

Unknowns = Float[np.ndarray, " unknown"]
Member = Float[np.ndarray, " member"]


class CostModel(NamedTuple):
    """Quadratic model of one cost around a point.

    Attributes:
        value: The cost there.
        gradient: Of it, shape (unknown,).
        curvature: Of it, shape (unknown, unknown).
    """

    value: float
    gradient: Unknowns
    curvature: Float[np.ndarray, "unknown unknown"]

    @classmethod
    def of(
        cls,
        residual: Float[np.ndarray, " residual"],
        slopes: Float[np.ndarray, "residual unknown"],
    ) -> "CostModel":
        """Return the model of half the square of a residual, by Gauss and Newton."""
        value = 0.5 * float(residual @ residual)
        return cls(value, slopes.T @ residual, slopes.T @ slopes)

    def plus(self, weight: float, other: "CostModel") -> "CostModel":
        """Return the sum with a weighted other cost."""
        return CostModel(
            self.value + weight * other.value,
            self.gradient + weight * other.gradient,
            self.curvature + weight * other.curvature,
        )

    def after(self, p: Unknowns) -> float:
        """Return the cost after a step; of a sum of squares it is never negative."""
        change = self.gradient @ p + 0.5 * p @ self.curvature @ p
        return max(float(self.value + change), 0.0)


class MinimaxModel(QuadraticModel):
    """Model of the largest of several costs, beside one that they share.

    Gradient and curvature are those of their mean, which says how long a step is.

    Attributes:
        members: The costs.
        shared: What is added to the largest.
    """

    members: Sequence[CostModel] = eqx.field(kw_only=True)
    shared: CostModel = eqx.field(kw_only=True)

    @classmethod
    def of(
        cls,
        cost: Callable[..., float],
        members: Sequence[CostModel],
        shared: CostModel,
        rows: Sequence[LinearRows],
    ) -> "MinimaxModel":
        """Return the model; arguments as of `QuadraticModel` and of this class."""
        mean = _weighted(_equal(members), members, shared)
        return cls(
            cost,
            mean.gradient,
            mean.curvature,
            tuple(rows),
            members=members,
            shared=shared,
        )

    def best_share(self, p: Unknowns, rise: float) -> float:
        """Return the share of a step that lowers the largest cost most, as of now."""
        worst = max(self.members, key=lambda member: member.value)
        gradient = worst.gradient + self.shared.gradient
        model = QuadraticModel(self.cost, gradient, self.curvature, self.rows)
        return model.best_share(p, rise)

    def decrease(self, p: Unknowns) -> float:
        """Return by how much a step lowers the largest cost in the model."""
        return self._total(np.zeros_like(p)) - self._total(p)

    def damped_step(self, damping: float, box: LinearRows) -> Unknowns | None:
        """Return the step of the least largest cost; arguments as of the parent."""
        weights, best, found = _equal(self.members), np.inf, None
        for _ in range(_ROUNDS):
            mean = _weighted(weights, self.members, self.shared)
            model = QuadraticModel(self.cost, mean.gradient, mean.curvature, self.rows)
            p = model.damped_step(damping, box)
            if p is None:
                break
            if (total := self._total(p)) < best:
                best, found = total, p
            costs = np.array([member.after(p) for member in self.members])
            if costs.max() - weights @ costs <= _GAP * total:
                break
            weights = reweighted(weights, np.sqrt(costs))
        return found

    def _total(self, p: Unknowns) -> float:
        """Return the cost after a step, what acts outside of soft rows counted in."""
        largest = max(member.after(p) for member in self.members)
        rows = sum(rows.energy(p) for rows in self.rows)
        return largest + self.shared.after(p) + rows


def _weighted(
    weights: Member, members: Sequence[CostModel], shared: CostModel
) -> CostModel:
    """Return the model of a weighted mean of costs, and of what they share."""
    total = shared
    for weight, member in zip(weights, members, strict=True):
        total = total.plus(float(weight), member)
    return total


def _equal(members: Sequence[CostModel]) -> Member:
    return np.full(len(members), 1 / len(members))


def reweighted(weights: Member, errors: Member) -> Member:
    """Return the weights of the next round.

    Args:
        weights: Weights of the members, which sum to 1.
        errors: Root mean square error of each member.

    Returns:
        Weights that sum to 1, larger for members of larger error.

    **Differentiability**: none, a host function.
    """
    raised = weights * errors
    total = float(raised.sum())
    return raised / total if total > 0 else weights
