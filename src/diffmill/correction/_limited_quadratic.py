"""Quadratic programs in a box with linear inequalities, products only.

    minimise  p.A p / 2 + g.p   subject to  lower <= p <= upper,  least <= L p <= most

The rows L p are split off as variables of their own, kept within their limits and tied
to p by springs and multipliers (the alternating direction method: Boyd and others,
Distributed Optimization and Statistical Learning via the Alternating Direction Method
of Multipliers, 2011, section 5.2); each round is one bounded problem. What is left of
a violation is then taken away exactly: p = 0 is feasible and the set is convex, so that
p is shortened to its border, and the best of the shortened rounds is the result.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np

from ._limits import AbstractLimits
from ._quadratic import QuadraticSolution, solve_bounded_quadratic

# Rounds at most, products and accuracy of each, and the over-relaxation.
_ROUNDS = 200
_ROUND_PRODUCTS = 6
_ROUND_RTOL = 0.05
_RELAXATION = 1.6
# How many times the products of the problem without limits all rounds may take.
_LIMITED = 4
# Rounds that change the cost by less than this have settled.
_SETTLED = 1e-7


def solve_limited_quadratic(
    product: Callable[[np.ndarray], np.ndarray],
    gradient: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    limits: Sequence[AbstractLimits],
    *,
    rtol: float = 1e-2,
    max_products: int = 40,
    precondition: Callable[[np.ndarray], np.ndarray] | None = None,
) -> QuadraticSolution:
    """Minimise p.A p / 2 + g.p within a box and linear limits that p = 0 keeps.

    Args:
        product: Returns A p.
        gradient: g, shape (coefficient, axis).
        lower: Lower bounds of p, at most 0.
        upper: Upper bounds of p, at least 0.
        limits: Limits of p; bounds on either side of 0.
        rtol: Stop a bounded problem when its projected gradient has fallen so far.
        max_products: Products with A at most without limits in the way; four times as
            many with them.
        precondition: As `solve_bounded_quadratic`.

    Returns:
        The solution, exactly within box and limits.

    **Differentiability**: runs on the host, not traceable.
    """
    first = solve_bounded_quadratic(
        product,
        gradient,
        lower,
        upper,
        rtol=rtol,
        max_products=max_products,
        precondition=precondition,
    )
    p, used = first.p, first.products
    room = feasible_share(p, limits)
    if room >= 1:
        return first
    A_p = product(p)
    state = _start(p, A_p, limits, used + 1)
    max_products = _LIMITED * max_products
    best = _shortened(state, gradient, limits)
    for _ in range(_ROUNDS):
        if state.products + 4 > max_products:
            break
        state = _round(
            product, precondition, gradient, (lower, upper), limits, state, max_products
        )
        found = _shortened(state, gradient, limits)
        change = abs(found.decrease - best.decrease)
        best = found if found.decrease > best.decrease else best
        if change <= _SETTLED * best.decrease and found.share > 1 - _SETTLED:
            break
    p = best.p
    return QuadraticSolution(
        p=p,
        decrease=best.decrease,
        products=state.products,
        is_bound=(p <= lower) | (p >= upper),
        relative_gradient=first.relative_gradient,
    )


class _State(eqx.Module):
    """The iteration: p, A p, the rows split off and their scaled multipliers."""

    p: np.ndarray
    A_p: np.ndarray
    split: list[np.ndarray]
    pushed: list[np.ndarray]
    stiffness: list[float]
    products: int


class _Shortened(eqx.Module):
    """A feasible point on the way to p, how far, and what it gains."""

    p: np.ndarray
    share: float
    decrease: float


def _start(
    p: np.ndarray, A_p: np.ndarray, limits: Sequence[AbstractLimits], products: int
) -> _State:
    rows = [limit.apply(p) for limit in limits]
    energy = float(np.sum(p * A_p))
    return _State(
        p=p,
        A_p=A_p,
        split=[
            np.clip(r, limit.lower, limit.upper)
            for r, limit in zip(rows, limits, strict=True)
        ],
        pushed=[np.zeros_like(r) for r in rows],
        # Springs as stiff as the problem itself along p.
        stiffness=[energy / max(float(np.sum(r * r)), 1e-300) for r in rows],
        products=products,
    )


def _shortened(
    state: _State, gradient: np.ndarray, limits: Sequence[AbstractLimits]
) -> _Shortened:
    """Return the longest feasible part of p."""
    share = min(1.0, feasible_share(state.p, limits))
    slope = -float(np.sum(state.p * gradient))
    energy = float(np.sum(state.p * state.A_p))
    # The best length may be shorter still.
    share = float(np.clip(slope / energy, 0.0, share)) if energy > 0 else share
    return _Shortened(
        share * state.p, share, share * slope - 0.5 * share * share * energy
    )


def _round(
    product: Callable[[np.ndarray], np.ndarray],
    precondition: Callable[[np.ndarray], np.ndarray] | None,
    gradient: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    limits: Sequence[AbstractLimits],
    state: _State,
    max_products: int,
) -> _State:
    """Move p towards the rows as they were split off, then split them off anew."""

    def pull(rows: list[np.ndarray]) -> np.ndarray:
        parts = zip(limits, state.stiffness, rows, strict=True)
        return sum(
            (rho * limit.transpose(r) for limit, rho, r in parts),
            np.zeros_like(state.p),
        )

    def stiffened(d: np.ndarray) -> np.ndarray:
        return product(d) + pull([limit.apply(d) for limit in limits])

    apart = [
        limit.apply(state.p) - s + u
        for limit, s, u in zip(limits, state.split, state.pushed, strict=True)
    ]
    inner = solve_bounded_quadratic(
        stiffened,
        gradient + state.A_p + pull(apart),
        bounds[0] - state.p,
        bounds[1] - state.p,
        rtol=_ROUND_RTOL,
        max_products=min(_ROUND_PRODUCTS, max_products - state.products - 1),
        precondition=precondition,
    )
    p = np.clip(state.p + inner.p, *bounds)
    split, pushed = [], []
    for limit, s, u in zip(limits, state.split, state.pushed, strict=True):
        rows = _RELAXATION * limit.apply(p) + (1 - _RELAXATION) * s
        split.append(np.clip(rows + u, limit.lower, limit.upper))
        pushed.append(u + rows - split[-1])
    products = state.products + inner.products + 1
    return _State(p, product(p), split, pushed, state.stiffness, products)


def feasible_share(p: np.ndarray, limits: Sequence[AbstractLimits]) -> float:
    """Return the largest a with a p within the limits; above 1 where there is room.

    **Differentiability**: none, a host function.
    """
    share = np.inf
    for limit in limits:
        rows = limit.apply(p)
        bound = np.where(rows > 0, limit.upper, limit.lower)
        moves = np.abs(rows) > 0
        if np.any(moves):
            # A bound that is met by rounding only leaves a share of 0, not below.
            share = min(share, float(np.min(np.maximum(bound[moves] / rows[moves], 0))))
    # One rounding less, so that the product itself stays within.
    return share * (1 - 1e-12)
