"""The largest of several costs, by the quadratic models of all of them.

The step that minimises the largest cost also minimises a weighted mean of the costs, in
which only those that are then the largest have a weight. The weights are found by
multiplying each by its member's error, round after round: Lawson's algorithm for best
approximation in the maximum norm, see Rice and Usow, The Lawson algorithm and
extensions, Mathematics of Computation 22, 1968. A round solves a quadratic program; the
models are made once a step.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...optimise import LinearRows, QuadraticModel

# Rounds at most, and the gap at which they end, as a share of the cost: no step has a
# largest cost below the least weighted mean, whatever the weights.
_MAX_ROUNDS = 200
_COST_GAP = 1e-3

Unknowns: TypeAlias = Float[np.ndarray, " unknown"]
Member: TypeAlias = Float[np.ndarray, " member"]


class CostModel(eqx.Module):
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
        """Model of half the square of a residual, by Gauss and Newton."""
        value = 0.5 * float(residual @ residual)
        return cls(value, slopes.T @ residual, slopes.T @ slopes)

    def plus(self, weight: float, other: "CostModel") -> "CostModel":
        """Model of this cost plus a weight times another."""
        return CostModel(
            self.value + weight * other.value,
            self.gradient + weight * other.gradient,
            self.curvature + weight * other.curvature,
        )

    def after(self, p: Unknowns) -> float:
        """Cost after a step; of a sum of squares it is never negative."""
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
        """Model of the largest cost around a point.

        Args:
            cost: Returns the cost of the value at a point.
            members: Models of the members' costs.
            shared: Model of the cost that is added to the largest.
            rows: Constraints of the step.
        """
        mean = _weighted(_equal(members), members, shared)
        return cls(
            cost,
            mean.gradient,
            mean.curvature,
            tuple(rows),
            members=members,
            shared=shared,
        )

    def decrease(self, p: Unknowns) -> float:
        """Decrease of the largest cost by a step, as the model foresees it."""
        return self._total(np.zeros_like(p)) - self._total(p)

    def damped_step(self, damping: float, box: LinearRows) -> Unknowns | None:
        """Step whose largest cost is least, in the damped metric of weighted means.

        Args:
            damping: Share of the curvature's diagonal that is added to it.
            box: Bounds of the step.
        """
        weights, least, step = _equal(self.members), np.inf, None
        for _ in range(_MAX_ROUNDS):
            mean = _weighted(weights, self.members, self.shared)
            model = QuadraticModel(self.cost, mean.gradient, mean.curvature, self.rows)
            p = model.damped_step(damping, box)
            if p is None:
                break
            if (total := self._total(p)) < least:
                least, step = total, p
            costs = np.array([member.after(p) for member in self.members])
            if costs.max() - weights @ costs <= _COST_GAP * total:
                break
            # Members of larger error get larger weights.
            raised = weights * np.sqrt(costs)
            if raised.sum() > 0:
                weights = raised / float(raised.sum())
        return step

    def _total(self, p: Unknowns) -> float:
        """Cost after a step, with the springs of soft rows."""
        largest = max(member.after(p) for member in self.members)
        rows = sum(rows.energy(p) for rows in self.rows)
        return largest + self.shared.after(p) + rows


def _weighted(
    weights: Member, members: Sequence[CostModel], shared: CostModel
) -> CostModel:
    """Model of a weighted mean of costs, plus the cost that they share."""
    value, gradient, curvature = shared.value, shared.gradient, shared.curvature
    for weight, member in zip(weights.tolist(), members, strict=True):
        value = value + weight * member.value
        gradient = gradient + weight * member.gradient
        curvature = curvature + weight * member.curvature
    return CostModel(value, gradient, curvature)


def _equal(members: Sequence[CostModel]) -> Member:
    return np.full(len(members), 1 / len(members))
