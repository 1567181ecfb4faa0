"""One tooth period as a linear map of the arm's state and the tips before.

    x' = A x + G F,   F(t) = N(t) y(t) + sum over j of B_j(t) y(t - j T),   y = C x

The period is cut into equal steps. In each the arm is exact, by the exponential of A,
and so are its fastest modes; the slopes N and B are their means over the step, and the
tips run straight from its start to its end, so that the force is implicit in where the
step ends. What is cut off is of second order: with n steps per turn of a vibration the
force is too small by the share (2 pi / n)^2 / 12.

Reference: the idea of semi-discretisation, Insperger, Stepan, Updated semi-
discretization method for periodic delay-differential equations, 2004, with tips that
run straight, now and in the periods before.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

# Larger maps are left to Arnoldi's method, with so many vectors.
_DENSE, _KRYLOV = 100, 40


@dataclasses.dataclass(frozen=True)
class Regeneration:
    """Slopes of the force of one period, per step, in `work`.

    Attributes:
        now: N, in the tip [N/m], shape (step, 3, 3).
        before: B, in the tips of the periods before, newest first [N/m], shape (step,
            tooth, 3, 3).
    """

    now: Float[np.ndarray, "step 3 3"]
    before: Float[np.ndarray, "step tooth 3 3"]

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
        return Regeneration(mean(self.now), mean(self.before))


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

    Attributes:
        matrix: The map, the tips being those at the steps of the periods before, shape
            (all, all).
        tips: The tips of the period as maps of the same, shape (step, 3, all).
    """

    matrix: Float[np.ndarray, "all all"]
    tips: Float[np.ndarray, "step 3 all"]


def monodromy(
    step: Step, C: Float[np.ndarray, "3 state"], slopes: Regeneration
) -> PeriodMap:
    """Return the map of a period.

    Args:
        step: The arm over one step.
        C: Slope of the tip in its state.
        slopes: The slopes of the force; teeth and axes without any are left out.
    """
    state, count = len(step.E), len(slopes.now)
    used = np.any(slopes.before != 0, axis=(0, 2))
    axes = np.flatnonzero(used.any(axis=0))
    teeth = int(np.max(np.flatnonzero(used.any(axis=1)), initial=-1)) + 1
    before = slopes.before[:, :teeth][..., axes]
    start = np.eye(state + teeth * count * len(axes))
    X, now = start[:state], C @ start[:state]
    # Tips at the steps of each period, and at its end, where the next one begins.
    table = start[state:].reshape(teeth, count, len(axes), len(start))
    ends = np.concatenate([now[axes][None], table[:, 0]])[:teeth]
    table = np.concatenate([table, ends[:, None]], axis=1)

    tips = np.empty((count, 3, len(start)))
    for k in range(count):
        tips[k] = now
        old = [np.einsum("jab,jbn->an", before[k], table[:, at]) for at in (k, k + 1)]
        X = step.E @ X + step.W_0 @ (old[0] + slopes.now[k] @ now) + step.W_1 @ old[1]
        # The force at the end follows the tip there.
        stiff = np.eye(3) - C @ step.W_1 @ slopes.now[k]
        now = np.linalg.solve(stiff, C @ X)
        X = X + step.W_1 @ (slopes.now[k] @ now)
    kept = np.concatenate([tips[None, :, axes], table[:, :-1]])[:teeth]
    return PeriodMap(np.concatenate([X, kept.reshape(-1, len(start))]), tips)


class Vibration(NamedTuple):
    """The strongest vibration of a period.

    Attributes:
        radius: Magnitude of its multiplier over a period [-].
        frequency: [Hz].
        apparent_frequency: As one sample per period shows it [Hz].
    """

    radius: float
    frequency: float
    apparent_frequency: float


def strongest(period: PeriodMap, tooth_period: float) -> Vibration:
    """Return the strongest vibration."""
    value, vector = _largest(period.matrix)
    tips = period.tips
    count = len(tips)
    turn = np.angle(value)
    # Within a period the vibration is exp(s t) times a periodic motion, whose strongest
    # harmonic tells how many whole turns the eigenvalue hides.
    rate = np.log(max(abs(value), 1e-30)) + 1j * turn
    periodic = (tips @ vector) * np.exp(-rate * np.arange(count) / count)[:, None]
    power = np.sum(np.abs(np.fft.fft(periodic, axis=0)) ** 2, axis=1)
    harmonic = np.fft.fftfreq(count, 1 / count)[np.argmax(power)]
    hertz = 1 / (2 * np.pi * tooth_period)
    frequency = abs(turn + 2 * np.pi * harmonic) * hertz
    return Vibration(float(abs(value)), float(frequency), float(abs(turn) * hertz))


def _largest(
    matrix: Float[np.ndarray, "all all"],
) -> tuple[complex, Complex[np.ndarray, " all"]]:
    """Return the eigenvalue of largest magnitude and its vector."""
    from scipy.sparse.linalg import ArpackNoConvergence, eigs

    if len(matrix) > _DENSE:
        start = np.ones(len(matrix))
        try:
            found: Any = eigs(matrix, k=1, which="LM", v0=start, ncv=_KRYLOV)
            return complex(found[0][0]), found[1][:, 0]
        except ArpackNoConvergence:
            # Many of like magnitude: all of them are looked at.
            pass
    values, vectors = np.linalg.eig(matrix.astype(complex))
    at = int(np.argmax(np.abs(values)))
    return complex(values[at]), vectors[:, at]
