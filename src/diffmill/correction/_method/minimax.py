"""The worst member of an ensemble instead of the mean, by weights that follow it.

The smallest worst error is a weighted mean's for weights that none but the worst
members have. They are found by raising each member's weight by its own error, round
after round: Lawson's algorithm for best approximation in the maximum norm, see Rice and
Usow, The Lawson algorithm and extensions, Mathematics of Computation 22, 1968.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
    following,
)

# Rounds after that with equal weights.
_ROUNDS = 5

Member = Float[np.ndarray, " member"]


class WorstCaseMemory(eqx.Module):
    """State of the rounds after a step of one of them.

    Attributes:
        round: Rounds that have ended.
        weights: Weights of the members in the present one.
        start: Where it started, of the shape of the unknowns.
        best: Best of the rounds that have ended, without its steps; None in the first.
        lowest: Its largest error, infinite in the first.
        history: Steps of the rounds that have ended.
        inner: What the present round needs.
    """

    round: int
    weights: Member
    start: Float[np.ndarray, "*unknown"]
    best: LeastSquaresSolution | None
    lowest: float
    history: tuple[LeastSquaresStep, ...]
    inner: LeastSquaresMemory


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
    solve: Callable[..., LeastSquaresSolution],
    member_errors: Callable[[Float[Array, "*unknown"], Any], Member],
    start: Float[Array, "*unknown"],
    args: Any,
    *,
    rounds: int = _ROUNDS,
    is_held: Callable[[LeastSquaresSolution], bool] = lambda found: True,
    on_memory: Callable[[WorstCaseMemory], object] | None = None,
    resume: WorstCaseMemory | None = None,
) -> LeastSquaresSolution:
    """Return the unknowns whose worst member has the smallest error.

    Args:
        solve: Minimises the weighted mean square from a start; its second argument has
            an `.ensemble` with weights, `on_memory` and `resume` are those of
            `least_squares`.
        member_errors: Root mean square error of each member.
        start: First point.
        args: What `solve` takes.
        rounds: Rounds after the one with equal weights.
        is_held: Whether a solution keeps what is to be held: any that does is better
            than one that does not.
        on_memory: Called after every step with all that is needed to go on.
        resume: What it was called with, to go on from there as if nothing had been.

    Returns:
        The best of all rounds, so no worse than that of the mean; with the steps and
        the price of all.

    **Differentiability**: runs on the host, not traceable.
    """
    count = len(args.ensemble.draws)
    weigh = lambda weights: eqx.tree_at(
        lambda a: a.ensemble.weights, args, weights, is_leaf=lambda x: x is None
    )
    done, weights, inner = 0, np.full(count, 1 / count), None
    best, lowest, history = None, np.inf, ()
    if resume is not None:
        done, weights, inner = resume.round, resume.weights, resume.inner
        best, lowest, history = resume.best, resume.lowest, resume.history
        start = jnp.asarray(resume.start)
    while True:
        so_far = functools.partial(
            WorstCaseMemory, done, weights, np.asarray(start), best, lowest, history
        )
        found = solve(
            start,
            weigh(weights),
            on_memory=_remembering(on_memory, so_far),
            resume=inner,
        )
        inner, history = None, following(history, found.history)
        errors = member_errors(found.x, args)
        is_finite = bool(np.all(np.isfinite(errors)))
        largest = float(errors.max()) if is_finite and is_held(found) else np.inf
        if best is None or largest < lowest:
            best, lowest = found, largest
        if not is_finite or done == rounds:
            return dataclasses.replace(best, history=history)
        done, start, weights = done + 1, found.x, reweighted(weights, errors)


def _remembering(
    on_memory: Callable[[WorstCaseMemory], object] | None,
    so_far: Callable[[LeastSquaresMemory], WorstCaseMemory],
) -> Callable[[LeastSquaresMemory], object] | None:
    """Return what tells a step of a round together with the rounds before it."""
    if on_memory is None:
        return None
    return lambda inner: on_memory(so_far(inner))
