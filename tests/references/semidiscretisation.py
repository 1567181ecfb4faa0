"""Growth of vibrations in milling, by semi-discretisation of the delayed equation.

A tool on one or two equal modes, along the feed x and across it, with straight teeth:

    m u'' + c u' + k u = -a sum over teeth j in the cut of W_j(t) (u(t) - u(t - T_j)),
    W_j = (K_t t + K_r e) e^T,

T_j the time since the tooth before passed, e = (sin phi, cos phi) outward from the tool
at the tooth, t = (cos phi, -sin phi) along its motion. In each of equal steps W is its
mean, the delayed tip the mean of its values at both ends, and the rest of the equation
is solved by the exponential of its matrix. Uneven teeth repeat themselves after a turn;
a tip between two steps is interpolated.

Reference: Insperger, Stepan, Updated semi-discretization method for periodic
delay-differential equations with discrete delay, Int. J. Numer. Meth. Engng 61, 2004.
"""

import dataclasses
import math

import numpy as np
from scipy.linalg import expm
from scipy.sparse.linalg import eigs


@dataclasses.dataclass(frozen=True)
class Cut:
    """A cut and the modes of the tool.

    Attributes:
        speed: Of the spindle [1/s].
        teeth: Number of teeth.
        K_t: Tangential coefficient [Pa].
        K_r: Radial coefficient [Pa].
        mass: Of each mode [kg].
        frequency: Of each mode [Hz].
        ratio: Damping ratio of each mode.
        axes: Axes with a mode, 0 along the feed and 1 across it.
        entry: Immersion angle where a tooth enters [rad].
        exit: Where it leaves [rad].
        pitch: Angle from each tooth to the next [rad]; None for even teeth.
    """

    speed: float
    teeth: int
    K_t: float
    K_r: float
    mass: float
    frequency: float
    ratio: float
    axes: tuple[int, ...] = (0,)
    entry: float = 0.0
    exit: float = math.pi
    pitch: tuple[float, ...] | None = None

    @property
    def tooth_period(self) -> float:
        """Time between two teeth [s]."""
        return 1 / (self.speed * self.teeth)

    @property
    def places(self) -> np.ndarray:
        """Return the angles at which the teeth stand, shape (tooth,)."""
        if self.pitch is None:
            return 2 * math.pi * np.arange(self.teeth) / self.teeth
        return np.cumsum(self.pitch) - self.pitch

    def slopes(self, time: np.ndarray) -> np.ndarray:
        """Return W of the teeth at some times [Pa], shape (time, tooth, axis, axis)."""
        turn = 2 * math.pi * self.speed * time[:, None]
        phi = (turn + self.places) % (2 * math.pi)
        e = np.stack([np.sin(phi), np.cos(phi)], -1)
        t = np.stack([np.cos(phi), -np.sin(phi)], -1)
        push = self.K_t * t + self.K_r * e
        is_in = (self.entry <= phi) & (phi <= self.exit)
        W = np.einsum("tj,tja,tjb->tjab", is_in, push, e)
        return W[..., self.axes, :][..., self.axes]


def growth(cut: Cut, depth: float, steps: int = 200) -> float:
    """Return the factor by which a vibration grows per tooth period.

    Args:
        cut: The cut.
        depth: Its depth a [m].
        steps: Steps per tooth period.
    """
    n, h = len(cut.axes), cut.tooth_period / steps
    periods = 1 if cut.pitch is None else cut.teeth
    omega = 2 * math.pi * cut.frequency
    within = (np.arange(20) + 0.5) / 20
    # How many steps ago the tooth before passed.
    ahead = (np.roll(cut.places, -1) - cut.places) / (2 * math.pi) % 1
    delay = np.where(ahead == 0, 1, ahead) * cut.teeth * steps
    low = np.floor(delay + 1e-9).astype(int)
    share = np.maximum(delay - low, 0)[:, None, None]
    size = 2 * n + n * (low.max() + 1)
    x, old = np.split(np.eye(size), [2 * n])
    # The newest first.
    tips = np.concatenate([x[None, :n], old.reshape(-1, n, size)])
    for k in range(periods * steps):
        W = depth / cut.mass * cut.slopes((k + within) * h).mean(axis=0)
        rate = np.zeros((3 * n, 3 * n))
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n, :n] = -(omega**2) * np.eye(n) - W.sum(axis=0)
        rate[n : 2 * n, n : 2 * n] = -2 * cut.ratio * omega * np.eye(n)
        rate[n : 2 * n, 2 * n :] = np.eye(n)
        E = expm(h * rate)[: 2 * n]
        ends = (1 - share) * (tips[low] + tips[low - 1])
        ends = ends + share * (tips[low + 1] + tips[low])
        push = np.einsum("jab,jbn->an", W, ends / 2)
        x = E[:, : 2 * n] @ x + E[:, 2 * n :] @ push
        tips = np.concatenate([x[None, :n], tips[:-1]])
    matrix = np.concatenate([x, tips[1:].reshape(-1, size)])
    value = eigs(matrix, k=1, v0=np.ones(size), return_eigenvectors=False)
    return float(np.abs(value)[0] ** (1 / periods))
