"""Gaussian process along a path, by a Kalman filter: as long as the path is."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Observations(NamedTuple):
    """Scalar observations of a process of three axes, in the order of their times.

    Attributes:
        time: [s], shape (observation,).
        direction: Unit vectors d: what is seen is d . g, shape (observation, 3).
        variance: Of the noise [m^2], shape (observation,).
    """

    time: Float[Array, " observation"] | Float[np.ndarray, " observation"]
    direction: Float[Array, "observation 3"] | Float[np.ndarray, "observation 3"]
    variance: Float[Array, " observation"] | Float[np.ndarray, " observation"]


class Whitened(NamedTuple):
    """Rows without correlation, of variance one.

    Attributes:
        rows: W times the rows, with W^T W the inverse of their covariance, shape
            (observation, column).
        log_determinant: Of the covariance.
    """

    rows: Float[Array, "observation column"] | Float[np.ndarray, "observation column"]
    log_determinant: Float[Array, ""] | float


class PathProcess(eqx.Module):
    """Three independent processes with Matern's kernel of order 3/2 along a path.

        k(t, t') = s^2 (1 + r) exp(-r),   r = sqrt(3) |t - t'| / l

    Such a process is a state of two numbers per axis, its value and its rate, so that a
    Kalman filter whitens observations in a time that is proportional to their number.

    Attributes:
        length: l, per axis [s], shape (3,).
        size: s, per axis [m], shape (3,).
    """

    length: Float[Array, " 3"]
    size: Float[Array, " 3"]

    def whiten(
        self, seen: Observations, rows: Float[Array, "observation column"]
    ) -> Whitened:
        """Whiten what was seen, and columns that explain it.

        Args:
            seen: The observations.
            rows: What was seen, and columns, shape (observation, column).

        **Differentiability**: smooth.
        Reference: Hartikainen and Sarkka, MLSP 2010.
        """

        def step(carry, row):
            mean, P, last = carry
            time, direction, variance, values = row
            A, Q = self._transition(time - last)
            mean, P = A @ mean, A @ P @ A.T + Q
            h = jnp.stack([direction, jnp.zeros(3)], axis=1).reshape(-1)
            S = h @ P @ h + variance
            away = values - h @ mean
            gain = P @ h / S
            P = P - jnp.outer(gain, gain) * S
            carry = mean + jnp.outer(gain, away), P, time
            return carry, (away / jnp.sqrt(S), jnp.log(S))

        first = jnp.zeros((6, rows.shape[1])), self._stationary(), seen.time[0]
        _, (white, logs) = jax.lax.scan(step, first, (*seen, rows))
        return Whitened(white, jnp.sum(logs))

    def smoothed(
        self,
        seen: Observations,
        values: Float[np.ndarray, " observation"],
        times: Float[np.ndarray, " row"],
    ) -> tuple[Float[Array, "row 3"], Float[Array, "row 3"]]:
        """Mean and standard deviation of the process at some times [m].

        Args:
            seen: The observations.
            values: What was seen [m], shape (observation,).
            times: Increasing times [s], shape (row,).

        **Differentiability**: none is meant.
        """
        # Times without an observation see nothing: their noise is without end.
        count = len(values)
        order = np.argsort(np.concatenate([seen.time, times]), kind="stable")
        rows = [
            np.concatenate([x, y])[order]
            for x, y in (
                (np.asarray(seen.time), np.asarray(times)),
                (np.asarray(seen.direction), np.zeros((len(times), 3))),
                (np.asarray(seen.variance), np.ones(len(times))),
                (np.asarray(values), np.zeros(len(times))),
            )
        ]
        mean, deviation = _smooth(self, *map(jnp.asarray, rows))
        place = np.empty(len(order), int)
        place[order] = np.arange(len(order))
        at = place[count:]
        return mean[at], deviation[at]

    def _rate(self) -> Float[Array, " 3"]:
        return np.sqrt(3.0) / self.length

    def _stationary(self) -> Float[Array, "6 6"]:
        """Covariance of value and rate of each axis, before anything is seen."""
        both = jnp.stack([jnp.ones(3), self._rate() ** 2], axis=1)
        return jnp.diag((self.size[:, None] ** 2 * both).reshape(-1))

    def _transition(self, dt: Float[Array, ""]) -> tuple[Array, Array]:
        """Transition over some time, and the covariance that comes to it."""
        rate = self._rate()
        r = rate * dt
        blocks = jnp.exp(-r)[:, None, None] * jnp.stack(
            [
                jnp.stack([1 + r, jnp.full(3, dt)], axis=1),
                jnp.stack([-rate * r, 1 - r], axis=1),
            ],
            axis=1,
        )
        A = jax.scipy.linalg.block_diag(*blocks)
        P = self._stationary()
        return A, P - A @ P @ A.T


@jax.jit
def _smooth(
    process: PathProcess, time: Array, direction: Array, variance: Array, values: Array
) -> tuple[Array, Array]:
    """Rauch-Tung-Striebel smoother: mean and deviation at all times, (row, 3)."""

    def forward(carry, row):
        mean, P, last = carry
        time, direction, variance, value = row
        A, Q = process._transition(time - last)
        mean, P = A @ mean, A @ P @ A.T + Q
        ahead = mean, P
        h = jnp.stack([direction, jnp.zeros(3)], axis=1).reshape(-1)
        S = h @ P @ h + variance
        gain = P @ h / S
        mean, P = mean + gain * (value - h @ mean), P - jnp.outer(gain, gain) * S
        return (mean, P, time), (mean, P, *ahead, A)

    start = jnp.zeros(6), process._stationary(), time[0]
    rows = (time, direction, variance, values)
    _, (mean, P, mean_ahead, P_ahead, A) = jax.lax.scan(forward, start, rows)

    def backward(carry, row):
        later, P_later = carry
        mean, P, next_ahead, P_next, A = row
        # An axis without a process has no variance, and takes nothing from later.
        spread = jnp.diag(P_next)
        floor = jnp.where(spread > 0, _FLOOR * spread, 1.0)
        gain = jnp.linalg.solve(P_next + jnp.diag(floor), A @ P).T
        mean = mean + gain @ (later - next_ahead)
        P = P + gain @ (P_later - P_next) @ gain.T
        return (mean, P), (mean, P)

    last = mean[-1], P[-1]
    rows = (mean[:-1], P[:-1], mean_ahead[1:], P_ahead[1:], A[1:])
    _, (means, Ps) = jax.lax.scan(backward, last, rows, reverse=True)
    means = jnp.concatenate([means, mean[-1:]])
    Ps = jnp.concatenate([Ps, P[-1:]])
    variances = jnp.diagonal(Ps, axis1=1, axis2=2)[:, ::2]
    return means[:, ::2], jnp.sqrt(jnp.maximum(variances, 0.0))


# Share of a variance that keeps a covariance regular.
_FLOOR = 1e-12
# Lengths [s] and sizes [m] of a process that are tried.
LENGTHS = np.array([0.006, 0.012, 0.024, 0.048, 0.096, 0.2, 0.4])
SIZES = np.geomspace(0.2e-6, 60e-6, 30)
# Size that is expected of what no parameter explains [m]; larger ones count less.
EXPECTED_SIZE = 5e-6


@jax.jit
def _evidence(
    seen: Observations, values: Array, axes: Array, lengths: Array, scale: Array
) -> Array:
    """Log marginal likelihood on a grid of lengths and sizes, (length, size)."""
    sizes = scale * SIZES

    def at(length, size):
        process = PathProcess(jnp.full(3, length), size * axes)
        white = process.whiten(seen, values[:, None])
        return -0.5 * (jnp.sum(white.rows**2) + white.log_determinant)

    grid = jax.vmap(jax.vmap(at, (None, 0)), (0, None))(lengths, sizes)
    return grid + log_size_prior(SIZES)[None]


def log_size_prior(size: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
    """Logarithm of how likely a size of a process is, but for a constant."""
    return -np.log1p((size / EXPECTED_SIZE) ** 2)


class BestProcess(NamedTuple):
    """The process of the largest marginal likelihood.

    Attributes:
        length: l [s].
        size: s [m].
        evidence: Logarithm of its likelihood.
        evidence_of_none: That of a process of the least size, as good as none.
    """

    length: float
    size: float
    evidence: float
    evidence_of_none: float


def best_process(
    seen: Observations,
    values: Float[np.ndarray, " observation"],
    axes: Float[np.ndarray, " 3"],
    least_length: float,
    scale: float = 1.0,
) -> BestProcess:
    """Length and size of the largest marginal likelihood.

    Args:
        seen: The observations.
        values: What was seen [m], shape (observation,).
        axes: 1 for axes that have the process, else 0, shape (3,).
        least_length: Shortest length that the spacing of the observations can show [s].
        scale: By which the sizes that are tried are those of another quantity.
    """
    lengths = LENGTHS[LENGTHS >= min(least_length, LENGTHS[-1])]
    sizes = scale * SIZES
    arrays = map(jnp.asarray, (values, axes, lengths, scale))
    grid = _evidence(seen, *arrays)
    grid = np.asarray(grid)
    i, j = np.unravel_index(np.argmax(grid), grid.shape)
    return BestProcess(
        float(lengths[i]), float(sizes[j]), float(grid[i, j]), float(grid[:, 0].max())
    )
