"""Bounded quadratic programs by projected conjugate gradients, products only.

    minimise  q(p) = p.A p / 2 + g.p   subject to  lower <= p <= upper

with A symmetric, positive semidefinite and known only by its products. In the interior
of a face conjugate gradients; a step that would leave the box is projected onto it
(which enlarges the face) and kept if q falls, else cut at the boundary; where the
variables at a bound want to leave it more than the free ones want to move, one step
releases them. The balance of the two is the proportioning rule of Dostal, Optimal
Quadratic Programming Algorithms, Springer 2009, chapter 5; the projected step replaces
his step of fixed length, which needs the norm of A.

Everything runs on the host in NumPy: the vectors are short beside the cost of a
product, the loop can be interrupted between any two products, and only the product is
compiled, once.
"""

from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

Vector = Float[np.ndarray, "*shape"]

# Gradients below this are zero: dividing by them would overflow.
_TINY = 1e-300


class QuadraticSolution(eqx.Module):
    """Minimiser of a bounded quadratic program.

    Attributes:
        p: The minimiser, of the gradient's shape.
        decrease: -q(p), at least 0.
        products: Products with A that were needed.
        is_bound: Which variables stand at a bound.
        relative_gradient: Norm of the projected gradient over its first value; NaN
            where only that by the preconditioner is known.
    """

    p: Vector
    decrease: float
    products: int
    is_bound: Bool[np.ndarray, "*shape"]
    relative_gradient: float


class _State(eqx.Module):
    p: np.ndarray
    gradient: np.ndarray
    direction: np.ndarray
    products: int
    is_restarted: bool


def solve_bounded_quadratic(
    product: Callable[[np.ndarray], np.ndarray],
    gradient: Vector,
    lower: Vector,
    upper: Vector,
    *,
    rtol: float = 1e-2,
    max_products: int = 40,
    precondition: Callable[[np.ndarray], np.ndarray] | None = None,
    is_enough: Callable[[np.ndarray, int], bool] | None = None,
) -> QuadraticSolution:
    """Minimise p.A p / 2 + g.p in a box that contains p = 0.

    Args:
        product: Returns A p for a p of the gradient's shape.
        gradient: g, any shape.
        lower: Lower bounds of p, at most 0.
        upper: Upper bounds of p, at least 0.
        rtol: Stop when the projected gradient has fallen by this factor.
        max_products: Products with A at most.
        precondition: Roughly A^-1, symmetric and positive semidefinite; within a
            face its rows and columns of bound variables are left out.
        is_enough: Whether to stop at a point after some products.

    Returns:
        The solution; exactly within the bounds, also when the products run out.

    **Differentiability**: runs on the host, not traceable.
    """
    scaled = precondition or (lambda vector: vector)
    p = np.zeros_like(gradient)
    free, chopped = _split(p, gradient, lower, upper)
    first = float(np.sqrt(np.sum(free**2) + np.sum(chopped**2)))
    state = _State(p, gradient, free, 0, True)
    norm = first
    while norm > max(rtol * first, _TINY) and state.products < max_products:
        if is_enough is not None and is_enough(state.p, state.products):
            break
        free, chopped = _split(state.p, state.gradient, lower, upper)
        if np.sum(chopped**2) <= np.sum(free**2):
            state = _move(
                product, scaled, state, free, gradient, (lower, upper), max_products
            )
        else:
            state = _release(product, state, chopped, (lower, upper))
        if state.p is p:
            break
        p = state.p
        free, chopped = _split(p, state.gradient, lower, upper)
        norm = float(np.sqrt(np.sum(free**2) + np.sum(chopped**2)))
    return QuadraticSolution(
        p=p,
        decrease=float(-0.5 * np.sum(p * (state.gradient + gradient))),
        products=state.products,
        is_bound=(p <= lower) | (p >= upper),
        relative_gradient=norm / first if first > 0 else 0.0,
    )


def projected_gradient(
    x: Vector, gradient: Vector, lower: Vector, upper: Vector
) -> Vector:
    """Return the gradient without the parts that push against an active bound.

    Args:
        x: The point, within the bounds.
        gradient: The gradient there.
        lower: Lower bounds.
        upper: Upper bounds.

    Returns:
        The projected gradient; zero where the conditions of optimality hold.

    **Differentiability**: kink at the bounds.
    """
    free, chopped = _split(x, gradient, lower, upper)
    return free + chopped


def _split(
    p: np.ndarray, gradient: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient of the free variables, and of those that want to be."""
    at_lower, at_upper = p <= lower, p >= upper
    free = np.where(at_lower | at_upper, 0.0, gradient)
    chopped = np.where(at_lower & ~at_upper, np.minimum(gradient, 0.0), 0.0)
    chopped += np.where(at_upper & ~at_lower, np.maximum(gradient, 0.0), 0.0)
    return free, chopped


def _boundary(
    p: np.ndarray, direction: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the largest a with p - a direction in the box, and that point."""
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(direction > 0, (p - lower) / direction, np.inf)
        limit = np.where(direction < 0, (p - upper) / direction, limit)
    room = float(limit.min())
    if not np.isfinite(room):
        return np.inf, p
    # Exactly onto the bound: a variable left one rounding short would stop the next
    # step there again.
    target = np.where(direction > 0, lower, upper)
    moved = np.clip(p - room * direction, lower, upper)
    return room, np.where(limit <= room * (1 + 1e-9), target, moved)


def _move(
    product: Callable[[np.ndarray], np.ndarray],
    scaled: Callable[[np.ndarray], np.ndarray],
    state: _State,
    free: np.ndarray,
    gradient: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    max_products: int,
) -> _State:
    """Take a conjugate gradient step within the face, or enlarge the face."""
    d = np.where(free != 0, scaled(free), 0) if state.is_restarted else state.direction
    A_d = product(d)
    curvature = float(np.sum(d * A_d))
    slope = float(np.sum(d * state.gradient))
    room, cut = _boundary(state.p, d, *bounds)
    if curvature <= 0 and not np.isfinite(room):
        return state
    length = slope / curvature if curvature > 0 else 2 * room
    if length <= room:
        p = np.clip(state.p - length * d, *bounds)
        new = state.gradient - length * A_d
        free = _split(p, new, *bounds)[0]
        steep = np.where(free != 0, scaled(free), 0)
        d = steep - (np.sum(steep * A_d) / curvature) * d
        return _State(p, new, d, state.products + 1, False)
    cut_gradient = state.gradient - room * A_d
    products = state.products + 1
    if products < max_products:
        far = np.clip(state.p - length * d, *bounds)
        far_gradient = product(far) + gradient
        products += 1
        if np.sum(far * (far_gradient + gradient)) <= np.sum(
            cut * (cut_gradient + gradient)
        ):
            return _State(far, far_gradient, d, products, True)
    return _State(cut, cut_gradient, d, products, True)


def _release(
    product: Callable[[np.ndarray], np.ndarray],
    state: _State,
    chopped: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
) -> _State:
    """Let the variables go that want to leave their bound."""
    A_d = product(chopped)
    curvature = float(np.sum(chopped * A_d))
    room, cut = _boundary(state.p, chopped, *bounds)
    if curvature <= 0 and not np.isfinite(room):
        return state
    length = np.sum(chopped * state.gradient) / curvature if curvature > 0 else room
    length = float(length)
    p = np.clip(state.p - length * chopped, *bounds) if length < room else cut
    new = state.gradient - min(length, room) * A_d
    return _State(p, new, chopped, state.products + 1, True)
