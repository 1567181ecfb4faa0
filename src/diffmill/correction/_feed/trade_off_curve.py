"""A feed override along the path as an unknown: error against time.

A slower tool takes thinner chips, is pushed less and leaves a smaller error, but takes
longer. With the override o(s) as the unknown, positive and within bounds,

    minimise  E(o)^2 / (2 E_1^2) + weight * T(o) / T_1,

where E is the root mean square contour error over the length that is cut, T the time
of the whole path, and E_1 and T_1 are those of the program as it is. Weight after
weight gives the curve of the errors that can be had for a time. The logarithms of the
override at knots are the variables. E is a sum of squares, so that its columns of
derivatives, one for each knot, give the curvature too (Gauss-Newton); T is cheap, and
its second derivatives are exact.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...toolpath import cycle_time, rows_until
from .._quadratic import solve_bounded_quadratic
from .problem import FeedProblem, feed_figures, feed_slopes

# Called with a message and the share of the weights that are done.
OnShare = Callable[[str, float], None]
# Largest change of an override in one step, as a logarithm.
_STRIDE = 0.4
# Damping at first, over the mean curvature, and what it is multiplied by.
_DAMPING, _MORE, _LESS = 1e-3, 10.0, 0.2
# A step that promises less of the objective than this ends the search.
_SETTLED = 3e-5
_ATTEMPTS = 6


class FeedPoint(eqx.Module):
    """The best override for one weight of the time.

    Attributes:
        weight: Weight of the time; NaN for the program as it is.
        override: Override at the knots, shape (knot,).
        cycle_time: Time of the whole path [s].
        rms: Root mean square contour error over the length that is cut [m].
        steps: Steps that were taken.
        runs: Simulations, those with derivatives included.
        is_settled: Whether no further step promised anything.
    """

    weight: float
    override: Float[np.ndarray, " knot"]
    cycle_time: float
    rms: float
    steps: int
    runs: int
    is_settled: bool


def feed_curve(
    problem: FeedProblem,
    *,
    time_weights: tuple[float, ...],
    count: int = 8,
    max_steps: int = 8,
    on_progress: OnShare | None = None,
) -> tuple[FeedPoint, ...]:
    """Return the best override for each weight, after the path as it is.

    Args:
        problem: The path and the plant.
        time_weights: Weights of the time, positive; each starts where the last ended.
        count: Knots of the override.
        max_steps: Gauss-Newton steps for each weight at most.
        on_progress: Called with a message and the share done.

    Returns:
        The program as it is, its override clipped to the bounds, then one point per
        weight.

    Raises:
        ValueError: A weight is not positive, a count is too small, or the path as it
            is has no error to trade, or one that is not finite.

    **Differentiability**: runs on the host, not traceable.
    """
    if not time_weights or not all(0 < w < float("inf") for w in time_weights):
        raise ValueError(
            f"Argument `time_weights` must be positive numbers, but is {time_weights}."
        )
    if count < 2 or max_steps < 1:
        raise ValueError(
            "Arguments `count` and `max_steps` must be at least 2 and 1, but are "
            f"{count} and {max_steps}."
        )
    search = _Search(problem, count)
    tell = on_progress or (lambda message, share: None)
    points = [search.start()]
    tell(_told(points[0]), 0.0)
    for done, weight in enumerate(time_weights):
        name = f"weight {weight:g}"
        report = lambda text, done=done, name=name: tell(
            f"{name}: {text}", done / len(time_weights)
        )
        points.append(search.minimise(weight, points[-1].override, max_steps, report))
        tell(f"{name}: {_told(points[-1])}", (done + 1) / len(time_weights))
    return tuple(points)


def _told(point: FeedPoint) -> str:
    return f"{point.cycle_time:.2f} s, contour error {1e6 * point.rms:.2f} um rms"


class _Search:
    """Constants of a trade-off curve."""

    def __init__(self, problem: FeedProblem, count: int):
        self.problem, self.count = problem, count
        self.bounds = np.log(problem.lowest), np.log(problem.highest)
        self.dtype = jnp.result_type(problem.feed.path.positions)
        end = cycle_time(problem.feed, [problem.lowest] * count)
        self.rows = rows_until(end, problem.feed.period)
        x = np.clip(np.zeros(count), *self.bounds)
        self.first = self.figures(x)
        if not (np.isfinite(self.first[0]) and self.first[0] > 0):
            raise ValueError(
                "Argument `problem` must have a plant that leaves an error where the "
                "tool cuts, but its mean square is "
                f"{self.first[0]:g}."
            )
        self.x = x

    def figures(self, x: Float[np.ndarray, " knot"]) -> tuple[float, float]:
        """Return the mean square error and the time."""
        square, time = feed_figures(self.problem, jnp.asarray(x, self.dtype), self.rows)
        return float(square), float(time)

    def start(self) -> FeedPoint:
        """Return the program as it is."""
        square, time = self.first
        return FeedPoint(
            float("nan"), np.exp(self.x), time, float(np.sqrt(square)), 0, 1, True
        )

    def objective(self, figures: tuple[float, float], weight: float) -> float:
        """Return what becomes small; infinite where the motion is not finite."""
        value = figures[0] / (2 * self.first[0]) + weight * figures[1] / self.first[1]
        return value if np.isfinite(value) else np.inf

    def model(
        self, x: Float[np.ndarray, " knot"], weight: float
    ) -> tuple[Float[np.ndarray, " knot"], Float[np.ndarray, "knot knot"]]:
        """Return gradient and curvature of the objective."""
        found = feed_slopes(self.problem, jnp.asarray(x, self.dtype), self.rows)
        g, H, g_time, H_time = (np.asarray(value, np.float64) for value in found)
        square, time = self.first
        # Where the time is not convex its curvature is left out, not followed.
        values, vectors = np.linalg.eigh((H_time + H_time.T) / 2)
        H_time = (vectors * np.maximum(values, 0.0)) @ vectors.T
        scale = weight / time
        return g / square + scale * g_time, H / square + scale * H_time

    def minimise(
        self,
        weight: float,
        start: Float[np.ndarray, " knot"],
        max_steps: int,
        report: Callable[[str], None],
    ) -> FeedPoint:
        """Return the best override for one weight."""
        x = np.log(start)
        best = self.figures(x)
        damping, runs, steps, is_settled = _DAMPING, 1, 0, False
        while steps < max_steps and not is_settled:
            gradient, H = self.model(x, weight)
            runs += 1
            moved, damping, tried = self._step(x, best, weight, gradient, H, damping)
            runs += tried
            is_settled = moved is None
            if moved is not None:
                before = self.objective(best, weight)
                x, best = moved
                steps += 1
                gain = before - self.objective(best, weight)
                is_settled = gain < _SETTLED * before
                report(f"step {steps}, {best[1]:.2f} s, {1e6 * best[0] ** 0.5:.2f} um")
        return FeedPoint(
            weight, np.exp(x), best[1], float(np.sqrt(best[0])), steps, runs, is_settled
        )

    def _step(
        self,
        x: Float[np.ndarray, " knot"],
        best: tuple[float, float],
        weight: float,
        gradient: Float[np.ndarray, " knot"],
        H: Float[np.ndarray, "knot knot"],
        damping: float,
    ) -> tuple[tuple[np.ndarray, tuple[float, float]] | None, float, int]:
        """Return a better point and its figures or None, the damping, and the runs."""
        now = self.objective(best, weight)
        lower = np.maximum(self.bounds[0] - x, -_STRIDE)
        upper = np.minimum(self.bounds[1] - x, _STRIDE)
        size = max(float(np.trace(H)) / x.size, 1e-12)
        for tried in range(1, _ATTEMPTS + 1):
            damped = H + damping * size * np.eye(x.size)
            found = solve_bounded_quadratic(
                lambda p, damped=damped: damped @ p,
                gradient,
                np.minimum(lower, 0.0),
                np.maximum(upper, 0.0),
                rtol=1e-6,
                max_products=20 * x.size,
            )
            if found.decrease < _SETTLED * now:
                return None, damping, tried - 1
            there = x + found.p
            figures = self.figures(there)
            if self.objective(figures, weight) < now:
                return (there, figures), damping * _LESS, tried
            damping *= _MORE
        return None, damping, _ATTEMPTS
