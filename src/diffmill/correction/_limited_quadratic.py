"""Quadratic programs in a box with linear inequalities, products only.

    minimise  p.A p / 2 + g.p  +  sum over springs of w^2 dist(S p, [least, most])^2 / 2
    subject to  lower <= p <= upper,  least <= L p <= most

The problem is solved exactly within the span of all vectors that have been multiplied
by A so far: first those of the conjugate gradients that only know of the box, then, one
by one, the preconditioned gradient of the Lagrangian at the last solution, which knows
the push of every bound. Nothing that has been multiplied is lost, and each small
problem is left to a solver for dense ones. Without bounds this is the method of
conjugate gradients, kept conjugate.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..optimise import solve_quadratic_program
from ._quadratic import QuadraticSolution, projected_gradient, solve_bounded_quadratic
from ._spline.command_limits import AbstractRows

# How many times the products of the problem without limits there may be.
_LIMITED = 2
# Products of the conjugate gradients that only know of the box, at least. Their
# recurrence does not keep them conjugate for long: where they are slow, the best point
# of the span, and what grows it from there, gain more with fewer products.
_BY_RECURRENCE = 14
# Vectors of the span at most: the small problem is dense in them.
_LARGEST_SPAN = 150
# Bounds are kept to this share of the largest of their kind: what the dense solver
# cannot tell. Where a bound leaves more room than that, it is kept exactly.
_TOLERANCE = 1e-7


class QuadraticNotSolved(ArithmeticError):
    """Raise when no small problem could be solved to working precision."""


class Spring(NamedTuple):
    """Rows that may leave their bounds: w^2 / 2 times the squares of how far."""

    rows: AbstractRows
    weight: float


class LimitedQuadratic:
    """Minimise p.(A + damping) p / 2 + g.p within a box and limits that p = 0 keeps."""

    def __init__(
        self,
        product: Callable[[np.ndarray], np.ndarray],
        gradient: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        limits: Sequence[AbstractRows],
        *,
        springs: Sequence[Spring] = (),
        rtol: float = 1e-2,
        max_products: int = 40,
        precondition: Callable[[np.ndarray], np.ndarray] | None = None,
        rounding: float = 2.2e-16,
    ):
        """State the problem but for its damping.

        Args:
            product: Returns A p.
            gradient: g, shape (coefficient, axis).
            lower: Lower bounds of p, at most 0.
            upper: Upper bounds of p, at least 0.
            limits: Limits of p; bounds on either side of 0.
            springs: Rows whose bounds p = 0 need not keep.
            rtol: Stop when the gradient of the Lagrangian, by the preconditioner, has
                fallen so far; the conjugate gradients, when the projected one has.
            max_products: Products with A at most without limits; twice as many with
                them.
            precondition: As `solve_bounded_quadratic`.
            rounding: Relative rounding of the products: what a vector hands on of it,
                its own and that of the others, stays below its root.
        """
        rows = [*limits, *(spring.rows for spring in springs)]
        self._span = _Span(product, rows, rounding)
        self._gradient = gradient
        self._box = lower, upper
        self._limits = limits
        self._springs = springs
        self._rtol = rtol
        self._max_products = max_products
        self._precondition = precondition

    def solve(self, damping: float = 0.0) -> QuadraticSolution:
        """Return the solution, within the box and, but for rounding, the limits.

        Its decrease counts the springs.

        Raises:
            QuadraticNotSolved: Rounding leaves no solution.

        **Differentiability**: runs on the host, not traceable.
        """
        most, (lower, upper) = self._max_products, self._box
        is_limited = len(self._limits) + len(self._springs) > 0
        is_pinned = lower == upper

        def is_enough(p: np.ndarray, products: int) -> bool:
            # Where the box bounds a point they keep to its face, as the span does not.
            is_bound = ((p <= lower) | (p >= upper)) & ~is_pinned
            return products >= _BY_RECURRENCE and (is_limited or not np.any(is_bound))

        first = solve_bounded_quadratic(
            lambda p: self._span.multiplied(p) + damping * p,
            self._gradient,
            lower,
            upper,
            rtol=self._rtol,
            max_products=most,
            precondition=self._precondition,
            is_enough=is_enough,
        )
        is_free = not self._springs and feasible_share(first.p, self._limits) >= 1
        if is_free and first.relative_gradient <= self._rtol:
            return first
        if is_limited:
            most *= _LIMITED
        outer = self._precondition or (lambda vector: vector)
        # What cannot move counts nowhere: neither as a slope nor as a way.
        moving = lambda vector: np.where(is_pinned, 0.0, vector)
        scaled = lambda slope: moving(outer(slope))
        start = projected_gradient(np.zeros_like(lower), self._gradient, lower, upper)
        first_size = _size(start, np.where(start != 0, scaled(start), 0.0))
        best: _Point | None = None
        while (point := self._within(damping)) is not None:
            if best is None or point.decrease > best.decrease:
                best = point
            slope = moving(self._span.slope(point, self._gradient, damping))
            steep = scaled(slope)
            is_settled = _size(slope, steep) <= self._rtol * first_size
            is_spent = self._span.products >= most
            if is_settled or is_spent or not self._span.is_grown(steep):
                break
        if is_free and (best is None or best.decrease <= first.decrease):
            return dataclasses.replace(first, products=self._span.products)
        if best is None:
            raise QuadraticNotSolved(
                "The quadratic program within the limits has no solution to working "
                "precision."
            )
        return self._solution(best)

    def solve_again(self, damping: float) -> QuadraticSolution | None:
        """Return the best point of what has been multiplied so far; None without one.

        It costs no product: where a step was refused, what is known of the model is
        enough for a shorter one.

        **Differentiability**: runs on the host, not traceable.
        """
        point = self._within(damping)
        return None if point is None else self._solution(point)

    def _within(self, damping: float) -> "_Point | None":
        return self._span.solved(
            self._gradient, self._box, self._limits, self._springs, damping
        )

    def _solution(self, point: "_Point") -> QuadraticSolution:
        p, (lower, upper) = point.p, self._box
        if not (self._limits or self._springs):
            # The dense solver stops just short of a bound.
            width = upper - lower
            near = np.where(np.isfinite(width), _TOLERANCE * width, 0.0)
            p = np.where(np.isfinite(lower) & (p - lower <= near), lower, p)
            p = np.where(np.isfinite(upper) & (upper - p <= near), upper, p)
        return QuadraticSolution(
            p=p,
            decrease=point.decrease,
            products=self._span.products,
            is_bound=(p <= lower) | (p >= upper),
            relative_gradient=np.nan,
        )


class _Point(NamedTuple):
    """A point within the bounds, what it gains, and what the bounds push there."""

    p: np.ndarray
    decrease: float
    # Its coordinates in the span, the push of the box and that of each kind of rows.
    y: np.ndarray
    pushes: list[np.ndarray]


class _Span:
    """Orthonormal vectors with what A and the rows make of them."""

    def __init__(
        self,
        product: Callable[[np.ndarray], np.ndarray],
        rows: Sequence[AbstractRows],
        rounding: float,
    ):
        self.products = 0
        self._rounding = rounding
        self._independent = float(np.sqrt(rounding))
        self._product = product
        self._rows = rows
        # Each with its product and its rows behind it, and how rounded these are.
        self._long: list[np.ndarray] = []
        self._noise: list[float] = []
        self._length = 0

    def multiplied(self, v: np.ndarray) -> np.ndarray:
        """Return A v and remember it."""
        A_v = self._product(v)
        self.products += 1
        self._remember(v, A_v)
        return A_v

    def is_grown(self, v: np.ndarray) -> bool:
        """Multiply a vector; tell whether the span has become larger."""
        if len(self._long) >= _LARGEST_SPAN:
            return False
        before = len(self._long)
        # Only what is new: otherwise rounding is all that is left of a vector that
        # is almost within the span.
        size = np.linalg.norm(v)
        for _ in range(2):
            for u in self._long:
                v = v - (u[: v.size] @ v.reshape(-1)) * u[: v.size].reshape(v.shape)
        if not np.linalg.norm(v) > self._independent * size:
            return False
        self.multiplied(v / np.linalg.norm(v))
        return len(self._long) > before

    def _remember(self, v: np.ndarray, A_v: np.ndarray) -> None:
        if not np.any(v):
            return
        parts = [v, A_v, *(rows.apply(v) for rows in self._rows)]
        long = np.concatenate([part.reshape(-1) for part in parts]) / np.linalg.norm(v)
        self._length, noise = v.size, self._rounding
        for _ in range(2):
            for u, of_u in zip(self._long, self._noise, strict=True):
                share = float(u[: v.size] @ long[: v.size])
                long, noise = long - share * u, noise + abs(share) * of_u
        left = float(np.linalg.norm(long[: v.size]))
        # A vector almost within the span hands the rounding of its product, and that
        # of the others, on to the next: where conjugate gradients have become slow,
        # some fiftyfold each time.
        if noise < self._independent * left:
            self._long.append(long / left)
            self._noise.append(noise / left)

    def solved(
        self,
        gradient: np.ndarray,
        box: tuple[np.ndarray, np.ndarray],
        limits: Sequence[AbstractRows],
        springs: Sequence[Spring],
        damping: float,
    ) -> _Point | None:
        """Return the best point of the span; None without one."""
        if not self._long:
            return None
        n, long = self._length, np.stack(self._long, axis=1)
        V, A_V, L_V = long[:n], long[n : 2 * n], long[2 * n :]
        g = gradient.reshape(-1)
        kinds = [Bounds.hard(limit.lower, limit.upper) for limit in limits]
        kinds += [Bounds.of_spring(spring) for spring in springs]
        each = [Bounds.of_box(*box), *kinds]
        P = V.T @ A_V
        P = 0.5 * (P + P.T) + damping * np.eye(P.shape[0])
        found = solve_quadratic_program(
            P,
            V.T @ g,
            np.concatenate([V, L_V]),
            np.concatenate([kind.lower for kind in each]),
            np.concatenate([kind.upper for kind in each]),
            np.concatenate([np.full(kind.lower.size, kind.weight) for kind in each]),
        )
        if found is None:
            return None
        y, push = found
        values = _by_kind(L_V @ y, kinds)
        room = [kind.share(rows) for kind, rows in zip(kinds, values, strict=True)]
        share = min([1.0, *room])
        p = np.clip((share * (V @ y)).reshape(gradient.shape), *box)
        gain = -share * (g @ V @ y) - 0.5 * share**2 * (y @ P @ y)
        for kind, rows in zip(kinds, values, strict=True):
            gain += kind.energy(0 * rows) - kind.energy(share * rows)
        return _Point(p, float(gain), y, _by_kind(push, each))

    def slope(self, point: _Point, gradient: np.ndarray, damping: float) -> np.ndarray:
        """Return the Lagrangian's gradient at a point; held rows cost a product."""
        n, long = self._length, np.stack(self._long, axis=1)
        of_box, *of_rows = point.pushes
        back = (long[n : 2 * n] + damping * long[:n]) @ point.y + of_box
        slope = gradient + back.reshape(gradient.shape)
        for rows, force in zip(self._rows, of_rows, strict=True):
            if np.any(force):
                slope = slope + rows.transpose(force.reshape(rows.lower.shape))
        return slope


class Bounds(NamedTuple):
    """Bounds of one kind of rows, drawn in by what the dense solver cannot tell."""

    lower: np.ndarray
    upper: np.ndarray
    weight: float
    slack: float

    @staticmethod
    def hard(lower: np.ndarray, upper: np.ndarray) -> "Bounds":
        """Return bounds that p = 0 keeps."""
        ends = np.concatenate([lower.reshape(-1), upper.reshape(-1)])
        slack = _TOLERANCE * np.max(np.abs(ends[np.isfinite(ends)]), initial=0.0)
        return Bounds(
            np.minimum(lower.reshape(-1) + slack, 0.0),
            np.maximum(upper.reshape(-1) - slack, 0.0),
            np.inf,
            float(slack),
        )

    @staticmethod
    def of_box(lower: np.ndarray, upper: np.ndarray) -> "Bounds":
        """Return those of a box, into which a point can be clipped."""
        flat = lower.reshape(-1), upper.reshape(-1)
        return Bounds(*flat, np.inf, 0.0)

    @staticmethod
    def of_spring(spring: Spring) -> "Bounds":
        """Return those of a spring."""
        lower, upper = spring.rows.lower, spring.rows.upper
        flat = lower.reshape(-1), upper.reshape(-1)
        return Bounds(*flat, spring.weight, 0.0)

    def share(self, rows: np.ndarray) -> float:
        """Return the largest a with a rows within the bounds, but for the slack."""
        if np.isfinite(self.weight):
            return np.inf
        return _share(rows, self.lower - self.slack, self.upper + self.slack)

    def energy(self, rows: np.ndarray) -> float:
        """Return what the spring holds."""
        if not np.isfinite(self.weight):
            return 0.0
        outside = rows - np.clip(rows, self.lower, self.upper)
        return 0.5 * self.weight**2 * float(np.sum(outside**2))


def _by_kind(rows: np.ndarray, kinds: Sequence[Bounds]) -> list[np.ndarray]:
    """Return the rows of each kind."""
    ends = np.cumsum([kind.lower.size for kind in kinds], dtype=int)
    return np.split(rows, ends)[: len(kinds)]


def _size(slope: np.ndarray, steep: np.ndarray) -> float:
    """Return the norm of a gradient by the preconditioner."""
    return float(np.sqrt(max(np.sum(steep * slope), 0.0)))


def feasible_share(p: np.ndarray, limits: Sequence[AbstractRows]) -> float:
    """Return the largest a with a p within the limits; above 1 where there is room.

    **Differentiability**: none, a host function.
    """
    shares = [_share(limit.apply(p), limit.lower, limit.upper) for limit in limits]
    return min(shares, default=np.inf)


def _share(rows: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    bound = np.where(rows > 0, upper, lower)
    moves = np.abs(rows) > 0
    if not np.any(moves):
        return np.inf
    # A bound that is met by rounding only leaves a share of 0, not below. One rounding
    # less, so that the product itself stays within.
    least = float(np.min(np.maximum(bound[moves] / rows[moves], 0)))
    return least * (1 - 1e-12)
