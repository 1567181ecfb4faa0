"""A feed override along a path: the same way, travelled faster or slower.

A sampled path says at which speed v every interval between two rows is passed. An
override o asks for o v. Two passes over the squares of the speeds, forward and
backward, then take away what a bounded tangential acceleration cannot reach,

    w_(k+1) <= w_k + 2 a ds,

after the lateral acceleration has bounded each of them. The time that an interval
takes follows, and with it the place on the path at each new tooth instant. All that
depends on the override is JAX code with arrays of fixed length, so that it
differentiates; a path that ends early rests for the rows that are left.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._types import FloatSteps, RealScalarLike
from ._path import MOST_STEPS, SAME_INSTANT, Path, check_steps

# Intervals shorter than this are dwells [m].
_DWELL_LENGTH = 1e-12
# A speed that changes by less than this share per row is constant but for rounding.
_CONSTANT_SPEED_SHARE = 1e-6


# What a user may give: one number, or one per knot along the path.
Override = (
    RealScalarLike
    | Float[Array, " knot"]
    | Float[np.ndarray, " knot"]
    | tuple[float, ...]
    | list[float]
)


class PathFeed(eqx.Module):
    """A path whose feed can be overridden, with what bounds its speed.

    Attributes:
        path: The path as programmed.
        period: Time between two rows T [s].
        acceleration: Largest acceleration along and across the path [m/s^2].
        travel: Length of the path up to each row [m], shape (step,).
        speed: Speed in the interval that ends at row k + 1 [m/s], shape (step - 1,).
        most: Largest override that the lateral acceleration allows, shape
            (step - 1,).
        cubic: Coefficients of the tip within each interval, highest power first, over
            the share of the interval that is passed [m], shape (4, step - 1, 3).
    """

    path: Path
    period: float = eqx.field(static=True)
    acceleration: Float[np.ndarray, ""] | Float[Array, ""]
    travel: FloatSteps
    speed: Float[np.ndarray, " interval"] | Float[Array, " interval"]
    most: Float[np.ndarray, " interval"] | Float[Array, " interval"]
    cubic: Float[np.ndarray, "4 interval 3"] | Float[Array, "4 interval 3"]

    def instants(self, override: Float[Array, " knot"]) -> Float[Array, " step"]:
        """Return when each row of the programmed path is reached.

        Args:
            override: Override at knots equally spaced over the length of the path,
                linear between them, shape (knot,). Rapid moves are not overridden.

        Returns:
            Instants since the start [s], shape (step,).

        **Differentiability**: kinks where a limit of the acceleration begins to act
        and where a knot passes the middle of an interval.
        """
        rates = self._rates(override)
        ends = jnp.cumsum(jnp.asarray(self.period, override.dtype) / rates)
        return jnp.concatenate([jnp.zeros(1, override.dtype), ends])

    def places(
        self, override: Float[Array, " knot"], step_count: int
    ) -> Float[Array, " row"]:
        """Places of the tool at the tooth instants, in rows of the path.

        Args:
            override: Override at knots, shape (knot,), see `instants`.
            step_count: Number of tooth instants.

        Returns:
            Places such as 2.5, midway between rows 2 and 3, shape (row,); the last row
            of the path for all instants after its end.

        **Differentiability**: kinks where those of `instants` are.
        """
        dtype = override.dtype
        at = self.instants(override)
        wanted = self.period * jnp.arange(step_count, dtype=dtype)
        return jnp.interp(wanted, at, jnp.arange(at.size, dtype=dtype))

    def positions(self, places: Float[Array, " row"]) -> Float[Array, "row 3"]:
        """Return the tool tips at some places [m], shape (row, 3).

        A monotone cubic through the rows of the path, see `Path.resampled`.

        **Differentiability**: smooth within an interval, once at rows.
        """
        index = self._interval(places)
        share = places - index.astype(places.dtype)
        c = jnp.asarray(self.cubic, places.dtype)[:, index]
        x = share[:, None]
        return ((c[0] * x + c[1]) * x + c[2]) * x + c[3]

    def axes(self, places: Float[Array, " row"]) -> Float[Array, "row 3"]:
        """Return the unit tool axes at some places, shape (row, 3).

        **Differentiability**: kinks at rows.
        """
        index = self._interval(places)
        share = places - index.astype(places.dtype)
        rows = jnp.asarray(self.path.axes, places.dtype)
        axes = rows[index] + share[:, None] * (rows[index + 1] - rows[index])
        return axes / jnp.linalg.norm(axes, axis=1, keepdims=True)

    def tool_x(self, places: Float[Array, " row"]) -> Float[Array, "row 3"] | None:
        """Return the unit x of the tool at some places, shape (row, 3).

        None where the path leaves the rotation about the axis open.

        **Differentiability**: kinks at rows.
        """
        if self.path.tool_x is None:
            return None
        index = self._interval(places)
        share = places - index.astype(places.dtype)
        rows = jnp.asarray(self.path.tool_x, places.dtype)
        x = rows[index] + share[:, None] * (rows[index + 1] - rows[index])
        axes = self.axes(places)
        x = x - jnp.sum(x * axes, axis=1, keepdims=True) * axes
        return x / jnp.linalg.norm(x, axis=1, keepdims=True)

    def _interval(self, places: Float[Array, " row"]) -> Int[Array, " row"]:
        """Return the interval of each place."""
        last = self.speed.shape[0] - 1
        return jnp.clip(jnp.floor(places).astype(jnp.int32), 0, last)

    def _rates(self, override: Float[Array, " knot"]) -> Float[Array, " interval"]:
        """Return the speed of each interval over the programmed one."""
        dtype = override.dtype
        cast = lambda values: jnp.asarray(values, dtype)
        travel = cast(self.travel)
        knots = travel[-1] * cast(np.linspace(0.0, 1.0, override.shape[0]))
        middle = (travel[1:] + travel[:-1]) / 2
        asked = jnp.interp(middle, knots, override)
        is_rapid = jnp.asarray(self.path.is_rapid)[1:]
        asked = jnp.where(is_rapid, jnp.ones_like(asked), asked)
        asked = jnp.minimum(asked, cast(self.most))
        speed = cast(self.speed)
        square = _reached(
            (asked * speed) ** 2, 2 * cast(self.acceleration) * jnp.diff(middle)
        )
        # A dwell keeps its time; a root at zero needs a harmless input.
        is_moving = speed * self.period > _DWELL_LENGTH
        safe = jnp.where(is_moving, square / jnp.where(is_moving, speed, 1.0) ** 2, 1.0)
        return jnp.sqrt(safe)

    def cycle_time(self, override: Override) -> float:
        """Return the time that the path takes with an override [s].

        **Differentiability**: none, it runs on the host; see `instants`.
        """
        return float(_end(self, jnp.asarray(checked_override(override))))

    def row_count(self, override: Override) -> int:
        """Number of tooth instants that the path takes with an override.

        Raises:
            ValueError: More than a path may have.
        """
        periods = self.cycle_time(override) / self.period
        check_steps(periods, float(MOST_STEPS))
        return max(1, math.ceil(periods - SAME_INSTANT)) + 1

    @classmethod
    def of_path(
        cls, path: Path, *, acceleration: RealScalarLike | None = None
    ) -> "PathFeed":
        """Return a path whose feed can be overridden.

        Args:
            path: The path as programmed, on the host.
            acceleration: Largest acceleration along and across the path [m/s^2]; the
                largest of the path itself if not given.

        Returns:
            The path with what bounds its speed. An override of 1 gives the path itself,
            unless `acceleration` is less than what it needs.

        Raises:
            ValueError: If the acceleration is not positive, or the path never
                accelerates and none is given, or does not move.
        """
        from scipy.interpolate import PchipInterpolator

        rows = np.asarray(path.positions, np.float64)
        time = np.asarray(path.time, np.float64)
        period = (time[-1] - time[0]) / (time.size - 1)
        steps = np.diff(rows, axis=0)
        length = np.linalg.norm(steps, axis=1)
        if not np.any(length > _DWELL_LENGTH):
            raise ValueError("Argument `path` must move the tool, but does not.")
        change = np.diff(steps, axis=0) / period**2
        along = np.diff(length) / period**2
        across = np.sqrt(np.maximum(np.sum(change**2, axis=1) - along**2, 0.0))
        if acceleration is None:
            acceleration = np.linalg.norm(change, axis=1).max(initial=0.0)
            if acceleration < _CONSTANT_SPEED_SHARE * length.max() / period**2:
                raise ValueError(
                    "Argument `acceleration` must be given for a path that never "
                    "accelerates, but is None."
                )
        limit = float(np.asarray(acceleration))
        if not (math.isfinite(limit) and limit > 0):
            raise ValueError(
                f"Argument `acceleration` must be positive and finite, but is {limit}."
            )
        # The lateral acceleration grows with the square of the speed.
        most = np.sqrt(limit / np.maximum(across, 1e-6 * limit))
        ends = np.concatenate([[np.inf], most, [np.inf]])
        return cls(
            path=path,
            period=float(period),
            acceleration=np.asarray(limit),
            travel=np.concatenate([[0.0], np.cumsum(length)]),
            speed=length / period,
            most=np.minimum(ends[1:], ends[:-1]),
            cubic=PchipInterpolator(np.arange(float(time.size)), rows, axis=0).c,
        )


@eqx.filter_jit
def _end(feed: PathFeed, override: Float[Array, " knot"]) -> Float[Array, ""]:
    return feed.instants(override)[-1]


def checked_override(override: Override) -> Float[np.ndarray, " knot"]:
    """Return an override as values at two knots or more.

    Raises:
        ValueError: If a value is not positive and finite.
    """
    values = np.atleast_1d(np.asarray(override, float))
    if values.ndim != 1 or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(
            "Argument `override` must be positive numbers, one or one per knot, but is "
            f"{override}."
        )
    return np.repeat(values, 2) if values.size == 1 else values


def _reached(
    limit: Float[Array, " interval"], gain: Float[Array, " gap"]
) -> Float[Array, " interval"]:
    """Return squares of speeds within their limits that change by `gain` at most."""

    def sweep(limit, gain, reverse):
        def step(before, x):
            least = jnp.minimum(x[0], before + x[1])
            return least, least

        first = limit[-1] if reverse else limit[0]
        others = limit[:-1] if reverse else limit[1:]
        _, swept = jax.lax.scan(step, first, (others, gain), reverse=reverse)
        parts = [swept, first[None]] if reverse else [first[None], swept]
        return jnp.concatenate(parts)

    return sweep(sweep(limit, gain, False), gain, True)
