"""Tooth periods as linear maps of the arm's state and the tips before.

    x' = A x + G F,   F(t) = N(t) y(t) + sum over j of B_j(t) y(t - tau_j),   y = C x

Of teeth that are alike one period repeats itself, of others the whole turn; a delay
tau_j is a whole number of periods for even teeth only. A period is cut into equal
steps. In each the arm is exact, by the exponential of A, and so are its fastest modes;
the slopes N and B are their means over the step, and the tips run straight from its
start to its end, so that the force is implicit in where the step ends. What is cut off
is of second order: with n steps per turn of a vibration the force is too small by the
share (2 pi / n)^2 / 12.

Reference: the idea of semi-discretisation, Insperger, Stepan, Updated semi-
discretization method for periodic delay-differential equations, 2004, with tips that
run straight, now and in the periods before.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int

# Larger maps are left to Arnoldi's method, with so many vectors.
_DENSE, _KRYLOV = 100, 40
# Delays that are whole numbers of steps but for rounding.
_WHOLE = 1e-9


@dataclasses.dataclass(frozen=True)
class Regeneration:
    """Slopes of the force of one period, per step, in `work`.

    Attributes:
        now: N, in the tip [N/m], shape (step, 3, 3).
        before: B, in the tips before [N/m], shape (step, delay, 3, axis).
        delays: tau, how long before [tooth periods], shape (delay,).
    """

    now: Float[np.ndarray, "step 3 3"]
    before: Float[np.ndarray, "step delay 3 axis"]
    delays: Float[np.ndarray, " delay"]

    def gain(self) -> float:
        """Return by how much tips that swing by 1 m can swing the force [N/m]."""
        size = lambda slopes: np.linalg.norm(slopes, 2, axis=(-2, -1))
        return float(np.max(size(self.now) + size(self.before).sum(axis=1)))

    def in_steps(self, count: int) -> "Regeneration":
        """Return the mean slopes over another number of equal steps."""
        old = len(self.now)
        edges = [np.arange(n + 1) / n for n in (count, old)]
        low = np.maximum(edges[0][:-1, None], edges[1][None, :-1])
        high = np.minimum(edges[0][1:, None], edges[1][None, 1:])
        share = count * np.maximum(high - low, 0.0)
        mean = lambda slopes: np.tensordot(share, slopes, 1)
        return Regeneration(mean(self.now), mean(self.before), self.delays)


@dataclasses.dataclass(frozen=True)
class Step:
    """The arm over one step: x_1 = E x_0 + W_0 F_0 + W_1 F_1, exact for a linear F."""

    E: Float[np.ndarray, "state state"]
    W_0: Float[np.ndarray, "state 3"]
    W_1: Float[np.ndarray, "state 3"]

    @staticmethod
    def of(
        A: Float[np.ndarray, "state state"], G: Float[np.ndarray, "state 3"], h: float
    ) -> "Step":
        """Return the step of x' = A x + G F of length h [s]."""
        from scipy.linalg import expm

        n = len(A)
        # The state with F and its rise over the step, in the unit of the step.
        whole = np.zeros((n + 6, n + 6))
        whole[:n, :n], whole[:n, n : n + 3] = h * A, h * G
        whole[n : n + 3, n + 3 :] = np.eye(3)
        rows = expm(whole)[:n]
        rise = rows[:, n + 3 :]
        return Step(rows[:, :n], rows[:, n : n + 3] - rise, rise)


class PeriodMap(NamedTuple):
    """One tooth period as a map of the arm's state and the tips before, newest first.

    Tips that are known already only move on by a period: they need no rows here.

    Attributes:
        state: The arm's state at the end, shape (state, all).
        tips: The tips of the period, shape (step, 3, all).
        axes: The axes along which tips before are kept.
    """

    state: Float[np.ndarray, "state all"]
    tips: Float[np.ndarray, "step 3 all"]
    axes: Int[np.ndarray, " axis"]

    def apply(self, x: Inexact[np.ndarray, "all ..."]) -> np.ndarray:
        """Return state and tips before at the end, from those at the start."""
        added = np.tensordot(self.tips, x, 1)[::-1, self.axes]
        added = added.reshape(-1, *x.shape[1:])
        known = x[len(self.state) :]
        return np.concatenate([self.state @ x, added, known])[: len(x)]


def monodromy(
    step: Step, C: Float[np.ndarray, "3 state"], periods: Sequence[Regeneration]
) -> list[PeriodMap]:
    """Return the maps of periods that repeat themselves.

    Args:
        step: The arm over one step.
        C: Slope of the tip in its state.
        periods: The slopes of the force in each; delays and axes without any are left
            out.
    """
    used = np.any([np.any(p.before != 0, axis=(0, 2)) for p in periods], axis=0)
    kept, axes = (np.flatnonzero(used.any(axis=at)) for at in (1, 0))
    count = len(periods[0].now)
    # In steps; a tip that is still to come is taken from the last one that is known.
    delays = np.maximum(periods[0].delays[kept] * count, 1.0)
    maps = []
    for period in periods:
        before = period.before[:, kept][..., axes]
        slopes = Regeneration(period.now, before, delays)
        maps.append(_period_map(step, C, slopes, axes))
    return maps


def _period_map(
    step: Step,
    C: Float[np.ndarray, "3 state"],
    slopes: Regeneration,
    axes: Int[np.ndarray, " axis"],
) -> PeriodMap:
    """Return the map of a period.

    Args:
        step: The arm over one step.
        C: Slope of the tip in its state.
        slopes: The slopes of the force, delays in steps, from 1.
        axes: The axes along which those in the tips before are.
    """
    state, count = len(step.E), len(slopes.now)
    low = np.floor(slopes.delays + _WHOLE).astype(int)
    share = np.maximum(slopes.delays - low, 0.0)[:, None, None]
    longest = int(np.max(low + 1, initial=0))
    start = np.eye(state + longest * len(axes))
    X, now = start[:state], C @ start[:state]
    # Tips at the steps, the newest last.
    table = np.empty((longest + count + 1, len(axes), len(start)))
    table[:longest] = start[state:].reshape(longest, len(axes), len(start))[::-1]

    def delayed(at: int) -> Float[np.ndarray, "delay axis all"]:
        newer, older = table[at - low], table[at - low - 1]
        return newer + share * (older - newer)

    tips = np.empty((count, 3, len(start)))
    for k in range(count):
        at = longest + k
        tips[k], table[at] = now, now[axes]
        old = [
            np.einsum("jab,jbn->an", slopes.before[k], delayed(i)) for i in (at, at + 1)
        ]
        X = step.E @ X + step.W_0 @ (old[0] + slopes.now[k] @ now) + step.W_1 @ old[1]
        # The force at the end follows the tip there.
        stiff = np.eye(3) - C @ step.W_1 @ slopes.now[k]
        now = np.linalg.solve(stiff, C @ X)
        X = X + step.W_1 @ (slopes.now[k] @ now)
    return PeriodMap(X, tips, axes)


class Vibration(NamedTuple):
    """The strongest vibration of periods that repeat themselves.

    Attributes:
        radius: Magnitude of its multiplier over a period, their mean [-].
        frequency: [Hz].
        apparent_frequency: As one sample per period shows it [Hz].
    """

    radius: float
    frequency: float
    apparent_frequency: float


def strongest(periods: Sequence[PeriodMap], tooth_period: float) -> Vibration:
    """Return the strongest vibration of periods that repeat themselves."""
    value, vector = _largest(periods)
    tips = []
    for period in periods:
        tips.append(period.tips @ vector)
        vector = period.apply(vector)
    tips, turn = np.concatenate(tips), np.angle(value)
    count = len(tips)
    # Within the periods the vibration is exp(s t) times a periodic motion, whose
    # strongest harmonic tells how many whole turns the eigenvalue hides.
    rate = np.log(max(abs(value), 1e-30)) + 1j * turn
    periodic = tips * np.exp(-rate * np.arange(count) / count)[:, None]
    power = np.sum(np.abs(np.fft.fft(periodic, axis=0)) ** 2, axis=1)
    harmonic = np.fft.fftfreq(count, 1 / count)[np.argmax(power)]
    turns = abs(turn / (2 * np.pi) + harmonic) / len(periods)
    return Vibration(
        radius=float(abs(value) ** (1 / len(periods))),
        frequency=float(turns / tooth_period),
        apparent_frequency=float(abs(turns - np.round(turns)) / tooth_period),
    )


def _largest(
    periods: Sequence[PeriodMap],
) -> tuple[complex, Complex[np.ndarray, " all"]]:
    """Return the eigenvalue of largest magnitude of all periods, and its vector."""
    from scipy.sparse import linalg

    # Whose types know nothing of a function as an operator.
    sparse: Any = linalg

    def product(x: np.ndarray) -> np.ndarray:
        for period in periods:
            x = period.apply(x)
        return x

    size = periods[0].state.shape[1]
    if size > _DENSE:
        whole = sparse.LinearOperator((size, size), matvec=product, dtype=float)
        start = np.ones(size)
        try:
            values, vectors = sparse.eigs(whole, k=1, which="LM", v0=start, ncv=_KRYLOV)
            return complex(values[0]), vectors[:, 0]
        except sparse.ArpackNoConvergence:
            # Many of like magnitude: all of them are looked at.
            pass
    values, vectors = np.linalg.eig(product(np.eye(size)).astype(complex))
    at = int(np.argmax(np.abs(values)))
    return complex(values[at]), vectors[:, at]
