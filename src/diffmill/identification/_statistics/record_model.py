"""Quadratic model of the residual of a record, by a simulation with few unknowns.

Parameters are logarithms, so that they keep their sign; robust weights come from the
scatter of every channel. Each logarithm has a wide normal prior around its start, 0: it
is of no account beside a record that shows the parameter, and keeps one in place that
no record shows. The prior takes no part in the standard errors.
"""

import numpy as np
from jaxtyping import Bool, Float

from ...optimise import LevenbergMarquardt, QuadraticModel
from .robust_regression import Loss, Rows, normal_equations, robust_cost, weigh

# Standard deviation of the prior: a factor of ten either way is two of them.
_PRIOR = 1.15
# Longest step of a logarithm, and the length of a step, in logarithms, that is none.
_LONGEST, _STILL = 1.0, 1e-7
# Squared length of a step in standard errors at which the iteration ends, if the step
# was good, and if it was not: the cost has kinks, and further steps would be refused.
_REST, _KINK = 1e-3, 0.1


def record_model(
    rows: list[Rows],
    x: Float[np.ndarray, " unknown"],
    start: Float[np.ndarray, " unknown"],
    is_log: Bool[np.ndarray, " unknown"],
    loss: Loss,
) -> QuadraticModel:
    """Quadratic model of the robust cost, weighed by the scatter at a point.

    Args:
        rows: The equations there, their `force` being the residual of the record.
        x: The point, shape (unknown,).
        start: Middle of the priors, shape (unknown,).
        is_log: Which unknowns are logarithms, shape (unknown,).
        loss: The loss.
    """
    prior = np.where(is_log, _PRIOR**-2, 0.0)
    state = weigh(rows, np.zeros(len(x)), loss)
    G, g = normal_equations(rows, state.weights)

    def cost(there: Float[np.ndarray, " unknown"], at: list[Rows]) -> float:
        off = [r.force / s[None] for r, s in zip(at, state.spread, strict=True)]
        left = sum(robust_cost(r, loss) for r in off)
        return 0.5 * (left + float(prior @ (there - start) ** 2))

    return QuadraticModel(cost, prior * (x - start) - g, G + np.diag(prior))


def record_solver(
    is_log: Bool[np.ndarray, " unknown"], max_steps: int
) -> LevenbergMarquardt:
    """Solver with settings that suit a record."""
    return LevenbergMarquardt(
        max_steps=max_steps,
        max_step=np.where(is_log, _LONGEST, np.inf),
        step_rtol=_REST,
        rejected_step_rtol=_KINK,
        step_atol=_STILL,
    )
