"""The worst member of an ensemble instead of the mean, by weights that follow it.

The smallest worst error is a weighted mean's for weights that none but the worst
members have. They are found by raising each member's weight by its own error, round
after round: Lawson's algorithm for best approximation in the maximum norm, see Rice and
Usow, The Lawson algorithm and extensions, Mathematics of Computation 22, 1968.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...optimise import LeastSquaresState, LevenbergMarquardt
from .offset_fit import FitValue, OffsetFit, fit_offsets

# Rounds after that with equal weights.
ROUNDS = 5

Member = Float[np.ndarray, " member"]


class WorstCaseState(eqx.Module):
    """State of the rounds after a step of one of them.

    Attributes:
        round: Rounds that have ended.
        weights: Weights of the members in the present one.
        best: Best of the rounds that have ended; None in the first.
        inner: The present round.
    """

    round: int
    weights: Member
    best: LeastSquaresState | None
    inner: LeastSquaresState


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
    fit: OffsetFit,
    start: Float[np.ndarray, "coefficient axis"],
    solver: LevenbergMarquardt,
    *,
    bound: float,
    rounds: int = ROUNDS,
    callback: Callable[[WorstCaseState], bool] = lambda state: False,
    state: WorstCaseState | None = None,
) -> LeastSquaresState | None:
    """Return the offsets whose worst member has the smallest error.

    Args:
        fit: The problem, with the weights of the first round.
        start: Coefficients, shape (coefficient, axis).
        solver: Settings of every round.
        bound: Largest magnitude of an unknown.
        rounds: Rounds after the one with equal weights; without any the mean becomes
            small.
        callback: Called after every step with all that is needed to go on; True ends
            the search.
        state: What it was called with, to go on from there.

    Returns:
        The best state of all rounds, so no worse than that of the mean, with the
        price of all; None where the start has no finite residual.

    **Differentiability**: none, a host function.
    """
    done, best, inner = 0, None, None
    if state is not None:
        done, best, inner = state.round, state.best, state.inner
        fit = dataclasses.replace(fit, weights=state.weights)
    is_stopped = False
    while True:

        def tell(inner: LeastSquaresState, done=done, fit=fit, best=best) -> bool:
            nonlocal is_stopped
            is_stopped = callback(WorstCaseState(done, fit.weights, best, inner))
            return is_stopped

        found = fit_offsets(
            fit, start, solver, lower=-bound, upper=bound, state=inner, callback=tell
        )
        if found is None:
            return None
        if best is None or _largest(fit, found.value) < _largest(fit, best.value):
            best = found
        # The price is that of all rounds; no linear system is needed any more.
        best = dataclasses.replace(
            best,
            value=fit.without_model(best.value),
            history=found.history,
            evaluations=found.evaluations,
            models=found.models,
        )
        if is_stopped or done == rounds:
            return best
        done += 1
        weights = reweighted(fit.weights, _member_errors(found.value))
        fit = dataclasses.replace(fit, weights=weights)
        inner = dataclasses.replace(
            found, steps=0, has_converged=False, damping=solver.damping
        )


def _largest(fit: OffsetFit, value: FitValue) -> float:
    """Return the error of the worst member; infinite out of the bounds of outputs."""
    return float(_member_errors(value).max()) if fit.is_within(value) else np.inf


def _member_errors(value: FitValue) -> Member:
    """Return the root mean square error of each member, in units of 0.1 mm."""
    return np.sqrt(np.sum(value.errors**2, axis=1))
