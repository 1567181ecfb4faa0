"""The worst member of an ensemble instead of the mean, by weights that follow it.

The smallest worst error is a weighted mean's for weights that none but the worst
members have. They are found by raising each member's weight by its own error, round
after round: Lawson's algorithm for best approximation in the maximum norm, see Rice and
Usow, The Lawson algorithm and extensions, Mathematics of Computation 22, 1968.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ._least_squares_records import LeastSquaresSolution, following

# Rounds after that with equal weights.
_ROUNDS = 5

Member = Float[np.ndarray, " member"]


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


def worst_case(
    solve: Callable[[Float[Array, "*unknown"], Any], LeastSquaresSolution],
    member_errors: Callable[[Float[Array, "*unknown"], Any], Member],
    start: Float[Array, "*unknown"],
    args: Any,
    *,
    rounds: int = _ROUNDS,
) -> LeastSquaresSolution:
    """Return the unknowns whose worst member has the smallest error.

    Args:
        solve: Minimises the weighted mean square from a start; its second argument has
            an `.ensemble` with weights.
        member_errors: Root mean square error of each member.
        start: First point.
        args: What `solve` takes.
        rounds: Rounds after the one with equal weights.

    Returns:
        The best of all rounds, so no worse than that of the mean; with the steps and
        the price of all.

    **Differentiability**: runs on the host, not traceable.
    """
    count = len(args.ensemble.draws)
    weights = np.full(count, 1 / count)
    weigh = lambda weights: eqx.tree_at(
        lambda a: a.ensemble.weights, args, weights, is_leaf=lambda x: x is None
    )
    last = best = solve(start, weigh(weights))
    lowest, history = np.inf, last.history
    for left in reversed(range(rounds + 1)):
        errors = member_errors(last.x, args)
        if not np.all(np.isfinite(errors)):
            break
        if errors.max() < lowest:
            best, lowest = last, float(errors.max())
        if left:
            weights = reweighted(weights, errors)
            last = solve(last.x, weigh(weights))
            history = following(history, last.history)
    return dataclasses.replace(best, history=history)
