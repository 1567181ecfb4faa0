"""Levenberg's method for a simulation with a handful of unknown parameters.

Steps are taken in logarithms, so that parameters stay positive, and by robust weights
from the scatter of every channel. Each logarithm has a wide normal prior around its
start: it is of no account beside a record that shows the parameter, and keeps one in
place that no record shows. The prior takes no part in the standard errors.
"""

from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .robust_regression import (
    LinearFit,
    Loss,
    Rows,
    normal_equations,
    robust_cost,
    weigh,
)

# Standard deviation of the prior: a factor of ten either way is two of them.
_PRIOR = 1.15
# Longest step of a logarithm, and the length of a step, in logarithms, that is none.
_LONGEST, _STILL = 1.0, 1e-7
# Squared length of a step in standard errors at which the iteration ends, if the step
# was good, and if it was not: the cost has kinks, and further steps would be refused.
_REST, _KINK = 1e-3, 0.1
# First damping over the largest curvature, and what a good or bad step makes of it.
_DAMPING, _LESS, _MORE = 1e-3, 0.1, 10.0

Evaluate = Callable[[np.ndarray], list[Rows] | None]


class SteppedFit(eqx.Module):
    """Solution of the iteration.

    Attributes:
        x: Unknowns, logarithms first, shape (unknown,).
        rows: Equations there, their `force` being what is left of the record.
        fit: Weights, spreads and residuals there.
        simulations: Simulations with derivatives that were run.
        has_converged: Whether the last step was small.
    """

    x: Float[np.ndarray, " unknown"]
    rows: list[Rows]
    fit: LinearFit
    simulations: int
    has_converged: bool


def fit_steps(
    evaluate: Evaluate,
    start: Float[np.ndarray, " unknown"],
    begun: list[Rows],
    log_count: int,
    loss: Loss,
    max_steps: int,
) -> SteppedFit:
    """Fit unknowns of a simulation to records.

    Args:
        evaluate: Gives the equations at some unknowns, their `force` being what is
            left of the record; None if the simulation failed there.
        start: First unknowns, shape (unknown,).
        begun: The equations there.
        log_count: How many of them, the first, are logarithms.
        loss: The loss.
        max_steps: Steps at most.

    Returns:
        The fit.

    **Differentiability**: runs on the host.
    """
    prior = np.where(np.arange(len(start)) < log_count, _PRIOR**-2, 0.0)
    x, rows, count = start, begun, 1
    damping, is_done = _DAMPING, False
    for _ in range(max_steps):
        state = weigh(rows, np.zeros(len(x)), loss)
        G, g = normal_equations(rows, state.weights)
        G, g = G + np.diag(prior), g - prior * (x - start)
        least = np.diag(np.maximum(np.diagonal(G), 1e-300))
        step = np.linalg.solve(G + damping * least, g)
        longest = float(np.abs(step[:log_count]).max(initial=1e-300))
        step = step * min(1.0, _LONGEST / longest)
        trial, count = evaluate(x + step), count + 1

        def cost(at: list[Rows], x: np.ndarray, state: LinearFit = state) -> float:
            off = [r.force / s[None] for r, s in zip(at, state.spread, strict=True)]
            return sum(robust_cost(r, loss) for r in off) + float(
                prior @ (x - start) ** 2
            )

        is_better = trial is not None and cost(trial, x + step) <= cost(rows, x)
        if trial is not None and is_better:
            x, rows = x + step, trial
        damping = damping * (_LESS if is_better else _MORE)
        length = float(step @ G @ step)
        is_done = length < (_REST if is_better else _KINK) or longest < _STILL
        if is_done:
            break
    fit = weigh(rows, np.zeros(len(x)), loss)
    return SteppedFit(x, rows, fit, count, is_done)
