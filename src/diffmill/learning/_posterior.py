"""Posterior of parameters and process, from the residuals of measured parts."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ._gaussian_process import (
    EXPECTED_SIZE,
    Observations,
    PathProcess,
    Whitened,
    best_process,
    log_size_prior,
)
from ._measurement import Seen
from ._parameters import AdaptableMachine

# Shares of the priors that a group of parameters may have.
_SHARES = (0.03, 0.3, 1.0)
# Groups that get bigger and smaller together.
_TOGETHER = (
    ("stiffness", "damping"),
    ("force",),
    ("friction",),
    ("backlash",),
    ("servo",),
)
# Size of a process of forces, over that of one of the tip [N/m].
_FORCE_SCALE = 1e6
# Largest step of a parameter at once, in prior sizes.
_TRUST = 3.0
# Length of a process, in spacings of its observations, at which they show it [-].
_LEAST_SPACINGS = 0.8
# Turns in which process and parameters are chosen for each other.
_TURNS = 3


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

    @property
    def direction(self) -> Float[np.ndarray, "observation 3"]:
        """Directions of all observations."""
        return np.concatenate([s.direction for s in self.seen])

    @property
    def is_force(self) -> Bool[np.ndarray, " observation"]:
        """True for observations of forces."""
        kinds = [np.full(len(s.time), s.observed == "force") for s in self.seen]
        return np.concatenate(kinds)

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
        none: Log likelihood of what was seen with processes as good as none.
        of_tip: How many of them are of the tip; those of forces come last.
    """

    process: tuple[PathProcess, ...]
    chosen: tuple[np.ndarray, ...]
    none: float
    of_tip: int

    def of_expected_size(self) -> "Processes":
        """The same, of the tip no larger than is expected of them."""
        small = [
            PathProcess(one.length, jnp.minimum(one.size, EXPECTED_SIZE))
            for one in self.process[: self.of_tip]
        ]
        return self._replace(process=(*small, *self.process[self.of_tip :]))


def processes(stacked: Stacked, residual: np.ndarray) -> Processes:
    """Processes of the largest marginal likelihood for a residual.

    A tracker sees each axis, which then has a process of its own; points of walls see
    one direction each, and all axes share theirs. Forces have their own. A constant is
    none of its matters: touching off leaves one, which has a parameter.
    """
    direction, is_force = stacked.direction, stacked.is_force
    time = np.concatenate([s.time for s in stacked.seen])
    found, all_chosen, none, of_tip = [], [], 0.0, 0
    for kind in (False, True):
        own = is_force == kind
        seen = [s for s in stacked.seen if (s.observed == "force") == kind]
        if not seen:
            continue
        offset = np.linalg.lstsq(direction[own], residual[own], rcond=None)[0]
        away = residual - direction @ offset
        sets = [(np.ones(3), own)]
        if all(s.is_tracked for s in seen):
            sets = [(np.eye(3)[a], own & (direction[:, a] == 1)) for a in range(3)]
        for axes, chosen in sets:
            spacing = np.diff(np.unique(time[chosen]))
            least = _LEAST_SPACINGS * float(np.median(spacing)) if len(spacing) else 0.0
            scale = _FORCE_SCALE if kind else 1.0
            rows = stacked.rows(away, chosen)
            best = best_process(stacked.observations(chosen), rows, axes, least, scale)
            length = jnp.full(3, best.length)
            found.append(PathProcess(length, best.size * jnp.asarray(axes)))
            all_chosen.append(chosen)
            none += best.evidence_of_none
        of_tip += 0 if kind else len(sets)
    return Processes(tuple(found), tuple(all_chosen), none, of_tip)


def whitened(stacked: Stacked, found: Processes, columns: np.ndarray) -> Whitened:
    """Columns of observations, without correlation and of variance one.

    The determinant also has the prior of the processes' sizes.
    """
    white, log_determinant = [], 0.0
    for k, (process, chosen) in enumerate(
        zip(found.process, found.chosen, strict=True)
    ):
        rows = jnp.asarray(stacked.rows(columns, chosen))
        own = _whiten(process, stacked.observations(chosen), rows)
        white.append(np.asarray(own.rows))
        scale = 1.0 if k < found.of_tip else _FORCE_SCALE
        prior = log_size_prior(np.asarray(process.size) / scale)
        # Axes without the process have a size of nothing.
        log_determinant += float(own.log_determinant) - 2 * float(prior.min())
    return Whitened(np.concatenate(white), log_determinant)


@jax.jit
def _whiten(process: PathProcess, seen: Observations, rows: jax.Array) -> Whitened:
    return process.whiten(seen, rows)


class Prior(NamedTuple):
    """Normal prior of the unknowns: W (x - m) has variance one, without correlation.

    Attributes:
        mean: m, shape (unknown,).
        root: W, shape (unknown, unknown).
        gain: How much more likely the unknowns make what was seen, logarithm.
    """

    mean: Float[np.ndarray, " unknown"]
    root: Float[np.ndarray, "unknown unknown"]
    gain: float


class Linearised(NamedTuple):
    """Linear least squares for the unknowns about some values of them.

    Attributes:
        unknowns: The values: free parameters, then what set-ups leave open.
        slopes: Whitened slopes of the observations, shape (observation, unknown).
        residual: Whitened residual at the values, shape (observation,).
        prior: Prior that suits them.
        gain: How much more likely unknowns and process make what was seen than the
            model with set-ups of its own and without a process, logarithm.
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

        x, W = self.unknowns, self.prior.root
        rows = np.concatenate([W, self.slopes])
        right = np.concatenate([W @ (self.prior.mean - x), self.residual])
        Q, R = np.linalg.qr(rows)
        low = np.maximum(lower - x, -_TRUST) - 1e-9
        high = np.full(len(x), _TRUST) + 1e-9
        return x + lsq_linear(R, Q.T @ right, bounds=(low, high)).x

    def covariance(self) -> Float[np.ndarray, "unknown unknown"]:
        """Covariance of the unknowns, in units of their full priors."""
        W = self.prior.root
        return np.linalg.inv(W.T @ W + self.slopes.T @ self.slopes)


class SetUp(NamedTuple):
    """Set-ups of measurements that suit a model without another machine.

    Attributes:
        found: In units of their priors, shape (nuisance,).
        evidence: Log likelihood of what was seen with them, and without a process.
    """

    found: Float[np.ndarray, " nuisance"]
    evidence: float

    @classmethod
    def fitted(
        cls, stacked: Stacked, of_model: np.ndarray, nuisance: np.ndarray
    ) -> "SetUp":
        """Set-ups that suit the model best, a constant of each observable aside.

        Args:
            stacked: The observations.
            of_model: Residuals of the model [m or N], shape (observation,).
            nuisance: Slopes in the set-ups, shape (observation, nuisance).
        """
        kinds = stacked.is_force, ~stacked.is_force
        constants = [stacked.direction * own[:, None] for own in kinds]
        count = nuisance.shape[1]
        columns = np.concatenate([nuisance, *constants], axis=1)
        weight = 1 / np.sqrt(stacked.variance)
        prior = np.eye(count, columns.shape[1])
        A = np.concatenate([columns * weight[:, None], prior])
        b = np.concatenate([of_model * weight, np.zeros(count)])
        found = np.linalg.lstsq(A, b, rcond=None)[0][:count]
        M = nuisance * weight[:, None]
        volume = np.linalg.slogdet(np.eye(count) + M.T @ M)[1]
        none = processes(stacked, of_model - nuisance @ found).none
        return cls(found, none - 0.5 * (found @ found + volume))


class Unknowns(NamedTuple):
    """Parameters and set-ups on which observations depend, linearly about values.

    Attributes:
        at: The values: free parameters, then what set-ups leave open.
        lower: Lower bounds of these.
        columns: Slopes of the observations, shape (observation, unknown).
        prior: Prior of them that suits whitened slopes and observations.
    """

    at: Float[np.ndarray, " unknown"]
    lower: Float[np.ndarray, " unknown"]
    columns: Float[np.ndarray, "observation unknown"]
    prior: Callable[[np.ndarray, np.ndarray], Prior]

    def linearised(
        self, stacked: Stacked, residual: np.ndarray, model: SetUp
    ) -> Linearised:
        """Least squares with process and prior of the largest marginal likelihood.

        A process as large as the residual explains it all and leaves nothing to the
        parameters; a small one lets them take what they can. From both, each is chosen
        by turns for what the other leaves.

        Args:
            stacked: The observations.
            residual: Of them at the values [m or N].
            model: What set-ups explain where the model is right.
        """
        large = processes(stacked, residual)
        rows = np.concatenate([residual[:, None], self.columns], axis=1)
        tried = []
        for found in (large, large.of_expected_size()):
            for _ in range(_TURNS):
                white = whitened(stacked, found, rows)
                r, M = np.asarray(white.rows[:, 0]), np.asarray(white.rows[:, 1:])
                prior = self.prior(M, r + M @ self.at)
                away = r + M @ (self.at - prior.mean)
                evidence = prior.gain - 0.5 * (away @ away + white.log_determinant)
                gain = float(evidence - model.evidence)
                tried.append(Linearised(self.at, M, r, prior, gain))
                change = tried[-1].solved(self.lower) - self.at
                found = processes(stacked, residual - self.columns @ change)
        return max(tried, key=lambda system: system.gain)


def known_prior(
    mean: np.ndarray, covariance: np.ndarray, slopes: np.ndarray, seen: np.ndarray
) -> Prior:
    """Prior that other parts have left, with how much more likely it makes these.

    Args:
        mean: Of the unknowns, shape (unknown,).
        covariance: Of them, shape (unknown, unknown).
        slopes: Whitened columns.
        seen: Whitened observations with the unknowns at zero.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return Prior(mean, root, _gain(slopes, seen - slopes @ mean, root))


def _gain(slopes: np.ndarray, away: np.ndarray, root: np.ndarray) -> float:
    """Logarithm of how much more likely unknowns make what is away from their mean."""
    S = np.linalg.solve(root.T, slopes.T)
    C = np.linalg.cholesky(np.eye(len(root)) + S @ S.T)
    b = np.linalg.solve(C, S @ away)
    return float(0.5 * b @ b - np.sum(np.log(np.diag(C))))


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
    count = slopes.shape[1]
    # As long as the unknowns are many: what is left out is the same for all priors.
    R = np.asarray(np.linalg.qr(np.column_stack([slopes, seen]), mode="r"))
    rows, right = R[:, :count], R[:, count]
    best = Prior(np.zeros(count), np.eye(count), -np.inf)
    for shares in itertools.product(_SHARES, repeat=len(sets)):
        scale = np.ones(count)
        for index, share in zip(sets, shares, strict=True):
            scale[index] = share
        root = np.diag(1 / scale)
        gain = _gain(rows, right, root)
        if gain > best.gain:
            best = Prior(np.zeros(count), root, gain)
    return best
