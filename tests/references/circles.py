"""Straight cuts of a flat tool that stands upright: the chip between two paths.

The tool feeds along +x by f per tooth; the tooth at angle phi from +y, clockwise, looks
outward along e = (sin phi, cos phi). Along e the chip reaches from the path of the
tooth before to the circle of radius R, as far as that lies in the raw stock, a
half-plane normal . x <= offset about the axis of the tool. All of it is in closed form
but the sums over phi, and the angle delta that the tooth before had turned further when
it crossed e (`references.trochoid`).
"""

import dataclasses
import math

import numpy as np

from .trochoid import TrochoidCut


@dataclasses.dataclass(frozen=True)
class Cut:
    """A straight cut along +x.

    Attributes:
        feed: Feed per tooth f [m].
        radial_depth: Width of the cut a_e [m]; the diameter or more for a slot.
        is_up_milling: Whether the teeth enter with thin chips, the stock at +y.
        radius: Radius of the tool R [m].
        teeth: Number of even teeth.
        is_trochoidal: Whether teeth go on trochoids, as they do; else on circles about
            a tool that stands still from tooth to tooth.
    """

    feed: float
    radial_depth: float
    is_up_milling: bool = True
    radius: float = 5e-3
    teeth: int = 2
    is_trochoidal: bool = True

    @property
    def travel_per_radian(self) -> float:
        """Travel of the tool while it turns by 1 rad [m]."""
        return self.is_trochoidal * self.feed * self.teeth / (2 * math.pi)

    def chip(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return between which radii the chip lies [m], as phi; equal for none."""
        R, f = self.radius, self.feed
        if self.is_trochoidal:
            exact = TrochoidCut(np.zeros(6), f, 1.0, 1.0, R, self.teeth)
            delta = exact.turn_between(np.cos(phi), np.asarray(R), 1)
            f = f - self.travel_per_radian * delta
        inner = np.sqrt(R**2 - (f * np.cos(phi)) ** 2) - f * np.sin(phi)
        inner, outer = np.minimum(inner, R), np.full_like(inner, R)
        if self.radial_depth < 2 * R:
            # The stock is where toward * r <= offset.
            toward = -np.cos(phi) if self.is_up_milling else np.cos(phi)
            face = (self.radial_depth - R) / np.where(toward == 0, 1e-30, toward)
            outer = np.where(toward > 0, np.minimum(outer, face), outer)
            inner = np.where(toward < 0, np.maximum(inner, face), inner)
        return inner, np.maximum(inner, outer)


def angles(count: int = 400_000) -> np.ndarray:
    """Return angles over the leading side and a little more [rad], evenly spaced."""
    return np.linspace(-0.5, math.pi + 0.5, count + 1)


def chip_area(cut: Cut) -> float:
    """Return the area of the chip of one tooth about the axis [m^2].

    int (outer^2 - inner^2) / 2 dphi
    """
    phi = angles()
    inner, outer = cut.chip(phi)
    return float(np.sum(outer**2 - inner**2) / 2 * (phi[1] - phi[0]))


def swept_area(cut: Cut) -> float:
    """Return the area that one tooth takes [m^2], as it turns and travels.

    The point at the radius r of the edge moves across the edge by r + c cos(phi) per
    radian, c the travel of the axis.
    """
    phi = angles()
    inner, outer = cut.chip(phi)
    travel = np.sum((outer - inner) * np.cos(phi)) * (phi[1] - phi[0])
    return chip_area(cut) + cut.travel_per_radian * float(travel)


def mean_force(law: object, cut: Cut, axial_depth: float) -> np.ndarray:
    """Return the mean force on the tool [N], shape (3,), in axes x, y, z.

    Args:
        law: Has K_tc, K_rc, K_ac [Pa] and K_te, K_re, K_ae [N/m].
        cut: The cut.
        axial_depth: Depth of cut along the axis a_p [m].
    """
    phi = angles()
    inner, outer = cut.chip(phi)
    return _mean(law, phi, outer - inner, axial_depth, cut.teeth)


def thin_chip_mean_force(
    law: object,
    feed: float,
    entry: float,
    exit: float,
    axial_depth: float,
    teeth: int = 2,
) -> np.ndarray:
    """Return the mean force where h = f sin(phi) between two angles [N], shape (3,)."""
    phi = angles()
    is_in = (phi >= entry) & (phi <= exit)
    h = np.where(is_in, np.maximum(feed * np.sin(phi), 0), 0)
    return _mean(law, phi, h, axial_depth, teeth)


def _mean(
    law: object, phi: np.ndarray, h: np.ndarray, axial_depth: float, teeth: int
) -> np.ndarray:
    # symbols: F_t tangential, F_r radial, F_a axial force per height
    K = [float(getattr(law, name)) for name in ("K_tc", "K_rc", "K_ac")]
    E = [float(getattr(law, name)) for name in ("K_te", "K_re", "K_ae")]
    F_t, F_r, F_a = (c * h + e * (h > 0) for c, e in zip(K, E, strict=True))
    share = teeth * axial_depth * (phi[1] - phi[0]) / (2 * math.pi)
    return share * np.array(
        [
            np.sum(-F_t * np.cos(phi) - F_r * np.sin(phi)),
            np.sum(F_t * np.sin(phi) - F_r * np.cos(phi)),
            np.sum(F_a),
        ]
    )
