"""A path whose feed is an unknown, and what the error and the time change with it.

The rows of the path are found anew for every override, the plant is run over them, and
the error is averaged over the length that is cut. The number of rows is that of the
slowest override, so that the shapes stay and the whole differentiates.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from ...toolpath import PathFeed, contour_vector
from .._core.problem import Motion, Weights


class WeightedContour(eqx.Module):
    """Contour vectors with the length of path that each of them stands for.

    Attributes:
        vectors: From the desired path to the tip [m], shape (row, 3).
        lengths: Length of the path up to a row, times its weight [m], shape (row,):
            nothing for a tool that rests.
    """

    vectors: Float[Array, "row 3"]
    lengths: Float[Array, " row"]

    def mean_square(self) -> Float[Array, ""]:
        """Mean square over the length of the path [m^2]."""
        square = jnp.sum(self.vectors**2, axis=1)
        return jnp.sum(self.lengths * square) / jnp.sum(self.lengths)


class FeedProblem(eqx.Module):
    """A path whose feed is to be chosen.

    Attributes:
        plant: Maps desired tips [m], tool axes and, of a path that states them, the x
            of the tool, each of shape (row, 3), to the `Motion` that follows;
            traceable.
        feed: The path with what bounds its speed.
        weights: How much the error counts per length at each row of the programmed
            path, shape (step,); best a smooth rise and fall, see
            `FeedProblem.smoothed`.
        lowest: Smallest override that is allowed.
        highest: Largest override that is allowed.
    """

    plant: Callable[..., Motion]
    feed: PathFeed
    weights: Weights
    lowest: float = eqx.field(static=True, default=0.5)
    highest: float = eqx.field(static=True, default=1.5)

    def __check_init__(self):
        """Refuse bounds that hold no override."""
        if not 0 < self.lowest < self.highest < float("inf"):
            raise ValueError(
                "Arguments `lowest` and `highest` must be positive and ascend, but are "
                f"{self.lowest} and {self.highest}."
            )

    def prediction(
        self, override: Float[Array, " knot"], step_count: int
    ) -> WeightedContour:
        """Contour vectors, with the length of path that each represents.

        Args:
            override: Override at the knots, shape (knot,).
            step_count: Rows to simulate; enough for the slowest override that occurs.

        **Differentiability**: that of the plant, kinks as `PathFeed.instants`; the
        choice of the nearest segment of the path is held.
        """
        feed = self.feed
        places = feed.places(override, step_count)
        desired = feed.positions(places)
        turned = [feed.axes(places)]
        if (tool_x := feed.tool_x(places)) is not None:
            turned.append(tool_x)
        motion = self.plant(desired, *turned)
        rows = jnp.arange(self.weights.shape[0], dtype=places.dtype)
        weights = jnp.interp(places, rows, jnp.asarray(self.weights, places.dtype))
        contour = contour_vector(motion.actual, desired)
        steps = jnp.diff(desired, axis=0, prepend=desired[:1])
        square = jnp.sum(steps**2, axis=1)
        moves = square > 0
        lengths = jnp.where(moves, jnp.sqrt(jnp.where(moves, square, 1.0)), 0.0)
        return WeightedContour(contour, weights * lengths)

    @staticmethod
    def smoothed(weights: Weights, rows: int = 8) -> Float[np.ndarray, " step"]:
        """Weights that rise and fall smoothly, over some rows to either side.

        Where a weight jumps, the rows come and go one by one as the feed changes; the
        sum over them then has small waves, as steep as the slopes that are sought.
        """
        box = np.full(rows, 1 / rows)
        window = np.convolve(box, box)
        wide = np.pad(np.asarray(weights, np.float64), rows - 1, mode="edge")
        return np.convolve(wide, window, mode="valid")


class FeedFigures(eqx.Module):
    """Mean square error and time of a path.

    Attributes:
        square: Mean square error [m^2], shape ().
        time: Time of the whole path [s], shape ().
    """

    square: RealScalarLike
    time: RealScalarLike


@eqx.filter_jit
def feed_figures(
    problem: FeedProblem, x: Float[Array, " knot"], step_count: int
) -> FeedFigures:
    """Figures of a path at the logarithms of its override."""
    override = jnp.exp(x)
    contour = problem.prediction(override, step_count)
    return FeedFigures(contour.mean_square(), problem.feed.instants(override)[-1])


class FeedSlopes(eqx.Module):
    """Derivatives of half the mean square error [m^2] and of the time [s].

    Attributes:
        gradient: Of the error, shape (knot,).
        curvature: Of the error, as Gauss-Newton has it, shape (knot, knot).
        time_gradient: Of the time, shape (knot,).
        time_curvature: Of the time, shape (knot, knot).
    """

    gradient: Float[Array, " knot"]
    curvature: Float[Array, "knot knot"]
    time_gradient: Float[Array, " knot"]
    time_curvature: Float[Array, "knot knot"]


@eqx.filter_jit
def feed_slopes(
    problem: FeedProblem, x: Float[Array, " knot"], step_count: int
) -> FeedSlopes:
    """Derivatives of the figures by the logarithms of the override."""
    predict = lambda x: (problem.prediction(jnp.exp(x), step_count),) * 2
    slopes, contour = jax.jacfwd(predict, has_aux=True)(x)
    # Lengths and weights of the rows change too, but give no curvature: a sum over
    # other rows of the same path.
    by = jax.grad(lambda contour: contour.mean_square() / 2)(contour)
    gradient = jnp.einsum("ra,rak->k", by.vectors, slopes.vectors)
    gradient = gradient + by.lengths @ slopes.lengths
    share = contour.lengths / jnp.sum(contour.lengths)
    J = slopes.vectors * jnp.sqrt(share)[:, None, None]
    J = J.reshape(-1, x.size)
    time = lambda x: problem.feed.instants(jnp.exp(x))[-1]
    return FeedSlopes(
        gradient, J.T @ J, jax.jacfwd(time)(x), jax.jacfwd(jax.jacfwd(time))(x)
    )
