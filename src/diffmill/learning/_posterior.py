"""Posterior of parameters and process, from the residuals of measured parts."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ._gaussian_process import Observations, PathProcess, best_process
from ._measurement import Seen
from ._parameters import AdaptableMachine

# Shares of the priors that a group of parameters may have.
_SHARES = (0.03, 0.3, 1.0)
# Groups that get bigger and smaller together.
_TOGETHER = (("stiffness", "damping"), ("force",), ("friction",), ("backlash",))
# Largest step of a parameter at once, in prior sizes.
_TRUST = 3.0
# Length of a process, in spacings of its observations, at which they show it [-].
_LEAST_SPACINGS = 0.8


class Stacked(NamedTuple):
    """Observations of all parts in the order of their times.

    Attributes:
        seen: Of one part after the other.
        order: Their order, shape (observation,).
        variance: Of each, older parts counting less [m^2], shape (observation,).
    """

    seen: tuple[Seen, ...]
    order: np.ndarray
    variance: Float[np.ndarray, " observation"]

    @classmethod
    def of(cls, seen: tuple[Seen, ...], weights: Float[np.ndarray, " part"]):
        """Stack parts whose variances are divided by weights."""
        time = np.concatenate([s.time for s in seen])
        variance = [s.variance / w for s, w in zip(seen, weights, strict=True)]
        return cls(seen, np.argsort(time, kind="stable"), np.concatenate(variance))

    def observations(self, chosen: Bool[np.ndarray, " observation"]) -> Observations:
        """Those chosen, as a filter takes them."""
        of = lambda name: np.concatenate([getattr(s, name) for s in self.seen])
        at = self.order[chosen[self.order]]
        return Observations(of("time")[at], of("direction")[at], self.variance[at])

    def rows(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Values of all observations, those chosen, in order."""
        return values[self.order[chosen[self.order]]]


class Processes(NamedTuple):
    """The process of each set of axes, and which observations see it.

    Attributes:
        process: One process per set.
        chosen: Observations of each, shape (set, observation).
        gain: How much more likely they make what was seen, logarithm.
    """

    process: tuple[PathProcess, ...]
    chosen: tuple[np.ndarray, ...]
    gain: float


def processes(stacked: Stacked, residual: np.ndarray) -> Processes:
    """Processes of the largest marginal likelihood for a residual.

    A tracker sees each axis, which then has a process of its own; points of walls see
    one direction each, and all axes share theirs. A constant is none of its matters:
    touching off leaves one, which has a parameter.
    """
    direction = np.concatenate([s.direction for s in stacked.seen])
    offset = np.linalg.lstsq(direction, residual, rcond=None)[0]
    residual = residual - direction @ offset
    time = np.concatenate([s.time for s in stacked.seen])
    if all(s.is_tracked for s in stacked.seen):
        sets = [(np.eye(3)[a], direction[:, a] == 1) for a in range(3)]
    else:
        sets = [(np.ones(3), np.ones(len(time), bool))]
    found, gain = [], 0.0
    for axes, chosen in sets:
        spacing = np.diff(np.unique(time[chosen]))
        least = _LEAST_SPACINGS * float(np.median(spacing)) if len(spacing) else 0.0
        seen = stacked.observations(chosen)
        best = best_process(seen, stacked.rows(residual, chosen), axes, least)
        length = jnp.full(3, best.length)
        found.append(PathProcess(length, best.size * jnp.asarray(axes)))
        gain += best.evidence - best.evidence_of_none
    return Processes(tuple(found), tuple(chosen for _, chosen in sets), gain)


def whitened(stacked: Stacked, found: Processes, columns: np.ndarray) -> np.ndarray:
    """Columns of observations, without correlation and of variance one."""
    white = []
    for process, chosen in zip(found.process, found.chosen, strict=True):
        rows = jnp.asarray(stacked.rows(columns, chosen))
        white.append(np.asarray(_whiten(process, stacked.observations(chosen), rows)))
    return np.concatenate(white)


@jax.jit
def _whiten(process: PathProcess, seen: Observations, rows: jax.Array) -> jax.Array:
    return process.whiten(seen, rows).rows


class Prior(NamedTuple):
    """Prior of the unknowns, with the group sizes of the largest likelihood.

    Attributes:
        scale: Standard deviation of each unknown, in units of its full prior.
        gain: How much more likely the unknowns make what was seen, logarithm.
    """

    scale: Float[np.ndarray, " unknown"]
    gain: float


class Linearised(NamedTuple):
    """Linear least squares for the unknowns about some values of them.

    Attributes:
        unknowns: The values: free parameters, then what set-ups leave open.
        slopes: Whitened slopes of the observations, shape (observation, unknown).
        residual: Whitened residual at the values, shape (observation,).
        prior: Prior that suits them.
        gain: How much more likely unknowns and process make what was seen, logarithm.
    """

    unknowns: Float[np.ndarray, " unknown"]
    slopes: Float[np.ndarray, "observation unknown"]
    residual: Float[np.ndarray, " observation"]
    prior: Prior
    gain: float

    def solved(self, lower: Float[np.ndarray, " unknown"]) -> np.ndarray:
        """Unknowns after a step, within their lower bounds and a trust region.

        Args:
            lower: The bounds, shape (unknown,).
        """
        from scipy.optimize import lsq_linear

        x, scale = self.unknowns, self.prior.scale
        rows = np.concatenate([np.diag(1 / scale), self.slopes])
        right = np.concatenate([-x / scale, self.residual])
        Q, R = np.linalg.qr(rows)
        low = np.maximum(lower - x, -_TRUST) - 1e-9
        high = np.full(len(x), _TRUST) + 1e-9
        return x + lsq_linear(R, Q.T @ right, bounds=(low, high)).x

    def covariance(self) -> Float[np.ndarray, "unknown unknown"]:
        """Covariance of the unknowns, in units of their full priors."""
        return np.linalg.inv(
            np.diag(1 / self.prior.scale**2) + self.slopes.T @ self.slopes
        )


def chosen_prior(
    machine: AdaptableMachine, free: np.ndarray, slopes: np.ndarray, seen: np.ndarray
) -> Prior:
    """Prior whose groups have the sizes of the largest marginal likelihood.

    Args:
        machine: The machine.
        free: Indices of the free parameters.
        slopes: Whitened columns, those of a measurement's set-up last.
        seen: Whitened observations with the unknowns at zero.
    """
    groups = {
        group.name: np.flatnonzero(np.isin(free, group.index))
        for group in machine.groups
    }
    sets = [np.concatenate([groups[n] for n in names]) for names in _TOGETHER]
    sets = [index for index in sets if len(index)]
    G, h = slopes.T @ slopes, slopes.T @ seen
    best = Prior(np.ones(len(G)), -np.inf)
    for shares in itertools.product(_SHARES, repeat=len(sets)):
        scale = np.ones(len(G))
        for index, share in zip(sets, shares, strict=True):
            scale[index] = share
        A = np.eye(len(G)) + scale[:, None] * G * scale
        C = np.linalg.cholesky(A)
        b = np.linalg.solve(C, scale * h)
        gain = 0.5 * b @ b - np.sum(np.log(np.diag(C)))
        if gain > best.gain:
            best = Prior(scale, float(gain))
    return best
