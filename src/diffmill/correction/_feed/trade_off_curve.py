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

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...optimise import (
    AbstractProblem,
    LeastSquaresState,
    LevenbergMarquardt,
    QuadraticModel,
    least_squares,
)
from .problem import FeedFigures, FeedProblem, feed_figures, feed_slopes

# Called with a message and the share of the weights that are done.
OnShare = Callable[[str, float], None]
# Largest change of an override in one step, as a logarithm.
_MAX_STEP = 0.4
# Factor of the damping after a good step.
_DAMPING_DECREASE = 0.2
# A step that promises less of the objective than this ends the search.
_COST_RTOL = 3e-5
_TRIALS_PER_STEP = 6


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

    @staticmethod
    def curve(
        problem: FeedProblem,
        *,
        time_weights: tuple[float, ...],
        count: int = 8,
        max_steps: int = 8,
        on_progress: OnShare | None = None,
    ) -> "tuple[FeedPoint, ...]":
        """Best override for each weight, after the path as it is.

        Args:
            problem: The path and the plant.
            time_weights: Weights of the time, positive; each starts where the last
                ended.
            count: Knots of the override.
            max_steps: Gauss-Newton steps for each weight at most.
            on_progress: Called with a message and the share done.

        Returns:
            The program as it is, its override clipped to the bounds, then one point per
            weight.

        Raises:
            ValueError: A weight is not positive, a count is too small, or the path as
                it is has no error to trade, or one that is not finite.
        """
        if not time_weights or not all(0 < w < float("inf") for w in time_weights):
            raise ValueError(
                "Argument `time_weights` must be positive numbers, but is "
                f"{time_weights}."
            )
        if count < 2 or max_steps < 1:
            raise ValueError(
                "Arguments `count` and `max_steps` must be at least 2 and 1, but are "
                f"{count} and {max_steps}."
            )
        bounds = np.log(problem.lowest), np.log(problem.highest)
        rows = problem.feed.row_count([problem.lowest] * count)
        x = np.clip(np.zeros(count), *bounds)
        first = _figures(problem, x, rows)
        if not (np.isfinite(first.square) and first.square > 0):
            raise ValueError(
                "Argument `problem` must have a plant that leaves an error where the "
                f"tool cuts, but its mean square is {first.square:g}."
            )
        solver = LevenbergMarquardt(
            max_steps=max_steps,
            attempts=_TRIALS_PER_STEP,
            max_step=_MAX_STEP,
            damping_decrease=_DAMPING_DECREASE,
            cost_rtol=_COST_RTOL,
        )
        report_share = on_progress or (lambda message, share: None)
        state = LeastSquaresState(x, first, solver.damping)
        points = [_point(float("nan"), state)]
        report_share(_point_text(points[0]), 0.0)
        for done, weight in enumerate(time_weights):
            name = f"weight {weight:g}"
            report = lambda at, done=done, name=name: report_share(
                f"{name}: step {at.steps}, {at.value.time:.2f} s, "
                f"{1e6 * at.value.square**0.5:.2f} um",
                done / len(time_weights),
            )
            state = least_squares(
                _Objective(problem, weight, first, rows),
                state.x,
                solver,
                lower=bounds[0],
                upper=bounds[1],
                state=LeastSquaresState(state.x, state.value, solver.damping),
                callback=report,
            )
            points.append(_point(weight, state))
            report_share(
                f"{name}: {_point_text(points[-1])}", (done + 1) / len(time_weights)
            )
        return tuple(points)


def _point(weight: float, state: LeastSquaresState) -> FeedPoint:
    """Point of the curve for a weight; NaN for the path as it is."""
    return FeedPoint(
        weight,
        np.exp(state.x),
        state.value.time,
        state.value.square**0.5,
        state.steps,
        state.evaluations + state.models,
        state.has_converged or bool(np.isnan(weight)),
    )


def _point_text(point: FeedPoint) -> str:
    return f"{point.cycle_time:.2f} s, contour error {1e6 * point.rms:.2f} um rms"


class _Objective(AbstractProblem):
    """Error and weighed time of a path over the logarithms of its override.

    Attributes:
        problem: The path and the plant.
        weight: Weight of the time.
        first: Figures of the path as it is.
        rows: Rows to simulate.
    """

    problem: FeedProblem
    weight: float
    first: FeedFigures
    rows: int

    def evaluate(self, x: Float[np.ndarray, " knot"]) -> FeedFigures | None:
        """Figures; None where the motion is not finite."""
        figures = _figures(self.problem, x, self.rows)
        is_finite = math.isfinite(figures.square) and math.isfinite(figures.time)
        return figures if is_finite else None

    def model(
        self, x: Float[np.ndarray, " knot"], value: FeedFigures
    ) -> QuadraticModel:
        """Model of the objective."""
        dtype = jnp.result_type(self.problem.feed.path.positions)
        slopes = feed_slopes(self.problem, jnp.asarray(x, dtype), self.rows)
        g, H, g_time, H_time = (
            np.asarray(part, np.float64)
            for part in (
                slopes.gradient,
                slopes.curvature,
                slopes.time_gradient,
                slopes.time_curvature,
            )
        )
        # Where the time is not convex its curvature is left out, not followed.
        values, vectors = np.linalg.eigh((H_time + H_time.T) / 2)
        H_time = (vectors * np.maximum(values, 0.0)) @ vectors.T
        square, scale = self.first.square, self.weight / self.first.time
        cost = lambda x, at: at.square / (2 * square) + scale * at.time
        return QuadraticModel(
            cost, g / square + scale * g_time, H / square + scale * H_time
        )


def _figures(
    problem: FeedProblem, x: Float[np.ndarray, " knot"], rows: int
) -> FeedFigures:
    dtype = jnp.result_type(problem.feed.path.positions)
    figures = feed_figures(problem, jnp.asarray(x, dtype), rows)
    return FeedFigures(float(figures.square), float(figures.time))
