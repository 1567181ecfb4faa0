"""Growth of vibrations in milling, by semi-discretisation of the delayed equation.

A tool on one or two equal modes, along the feed x and across it, with straight teeth:

    m u'' + c u' + k u = -a W(t) (u(t) - u(t - T)),
    W(t) = sum of (K_t t + K_r e) e^T over the teeth in the cut,

e = (sin phi, cos phi) outward from the tool at the tooth, t = (cos phi, -sin phi) along
its motion. In each of equal steps W is its mean, the delayed tip the mean of its values
at both ends, and the rest of the equation is solved by the exponential of its matrix.

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

    @property
    def tooth_period(self) -> float:
        """Time between two teeth [s]."""
        return 1 / (self.speed * self.teeth)

    def slopes(self, time: np.ndarray) -> np.ndarray:
        """Return W at some times [Pa], shape (time, axis, axis)."""
        turn = self.speed * time[:, None] + np.arange(self.teeth) / self.teeth
        phi = 2 * math.pi * (turn % 1)
        e = np.stack([np.sin(phi), np.cos(phi)], -1)
        t = np.stack([np.cos(phi), -np.sin(phi)], -1)
        push = self.K_t * t + self.K_r * e
        is_in = (self.entry <= phi) & (phi <= self.exit)
        W = np.einsum("tj,tja,tjb->tab", is_in, push, e)
        return W[:, self.axes][:, :, self.axes]


def growth(cut: Cut, depth: float, steps: int = 200) -> float:
    """Return the factor by which a vibration grows per tooth period.

    Args:
        cut: The cut.
        depth: Its depth a [m].
        steps: Steps per tooth period.
    """
    n, h = len(cut.axes), cut.tooth_period / steps
    omega = 2 * math.pi * cut.frequency
    within = (np.arange(20) + 0.5) / 20
    state = np.eye(2 * n + n * steps)
    x, old = state[: 2 * n], state[2 * n :].reshape(steps, n, -1)
    ends = np.concatenate([old, x[None, :n]])
    new = []
    for k in range(steps):
        W = depth / cut.mass * cut.slopes((k + within) * h).mean(axis=0)
        rate = np.zeros((3 * n, 3 * n))
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n, :n] = -(omega**2) * np.eye(n) - W
        rate[n : 2 * n, n : 2 * n] = -2 * cut.ratio * omega * np.eye(n)
        rate[n : 2 * n, 2 * n :] = W
        E = expm(h * rate)[: 2 * n]
        new.append(x[:n])
        x = E[:, : 2 * n] @ x + E[:, 2 * n :] @ (ends[k] + ends[k + 1]) / 2
    matrix = np.concatenate([x, *new])
    value = eigs(matrix, k=1, v0=np.ones(len(matrix)), return_eigenvectors=False)
    return float(np.abs(value)[0])
