"""Force of a straight cut whose teeth go on trochoids: no circles, no stock of rays.

The tool moves along +x by c = f N / (2 pi) per radian of the spindle, f the feed per
tooth of N teeth. A tooth of radius r at the angle phi from +y, clockwise, looks along
e = (sin phi, cos phi) from the axis. The j-th tooth before it crossed this ray when it
stood at phi + delta, and the axis was behind by j f - c delta:

    r_j sin(delta) = (j f - c delta) cos(phi)                      across the ray
    inner_j = r_j cos(delta) - (j f - c delta) sin(phi)            along the ray
    h = min(r, outer face) - max(inner_1, ..., inner_N, inner face)

The faces are those of the raw stock, a half-plane beside the tool. Nothing is left out
but that the edge has no thickness. Per height dz of an edge the force on the tool is

    dF = (-F_t cos phi - F_r sin phi, F_t sin phi - F_r cos phi, F_a) dz,
    F_i = K_ic h + K_ie where h > 0.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class TrochoidCut:
    """A straight cut along +x in steady state.

    Attributes:
        coefficients: K_tc, K_rc, K_ac [Pa] and K_te, K_re, K_ae [N/m], shape (6,).
        feed: Feed per tooth f [m].
        depth: Axial depth [m].
        speed: Spindle speed omega [rad/s].
        radius: Radius of the tool [m].
        teeth: How many N, evenly spaced.
        helix: Helix angle [rad].
        side: "slot", "up" (the stock at +y) or "down" (at -y).
        radial_depth: Width of the cut [m]; not for a slot.
        runout: Offset of the tool's axis off that of the spindle [m].
        runout_angle: Where it lies, from tooth 0 against the turn [rad].
        slices: How many heights the edge is cut into.
    """

    coefficients: Values
    feed: float
    depth: float
    speed: float
    radius: float = 5e-3
    teeth: int = 2
    helix: float = 0.0
    side: str = "slot"
    radial_depth: float = math.nan
    runout: float = 0.0
    runout_angle: float = 0.0
    slices: int = 48

    def force(self, time: Values) -> Values:
        """Force on the tool [N], shape (row, 3); tooth 0 stands at 0 at the time 0.

        Args:
            time: Instants [s], shape (row,).
        """
        z = (np.arange(self.slices) + 0.5) * self.depth / self.slices
        lag = z * math.tan(self.helix) / self.radius
        pitch = 2 * math.pi / self.teeth
        total = np.zeros((len(time), 3))
        for tooth in range(self.teeth):
            phi = self.speed * time[:, None] + tooth * pitch - lag[None]
            own, *before = (
                self._tooth_radius(tooth + j, lag)[None] for j in range(self.teeth + 1)
            )
            h = self.chip(phi, own, before)
            K = self.coefficients
            F_t, F_r, F_a = (K[i] * h + K[3 + i] * (h > 0) for i in range(3))
            sin, cos = np.sin(phi), np.cos(phi)
            parts = [-F_t * cos - F_r * sin, F_t * sin - F_r * cos, F_a]
            total += np.stack([np.sum(part, axis=1) for part in parts], axis=1)
        return total * self.depth / self.slices

    def chip(self, phi: Values, own: Values, before: list[Values]) -> Values:
        """Chip thickness [m], as phi; 0 where there is none.

        Args:
            phi: Angles of the tooth [rad].
            own: Radius of its path about the axis [m], broadcast.
            before: Radii of the teeth before it, from the last one on [m], broadcast.
        """
        sin, cos = np.sin(phi), np.cos(phi)
        inner, outer = self._faces(cos)
        for j, r in enumerate(before, 1):
            delta = self.turn_between(cos, r, j)
            behind = j * self.feed - self._per_radian * delta
            inner = np.maximum(inner, r * np.cos(delta) - behind * sin)
        return np.maximum(np.minimum(outer, own) - inner, 0.0)

    def turn_between(self, cos: Values, radius: Values, j: int) -> Values:
        """Angle delta by which the j-th tooth before had turned further [rad].

        Newton's method; delta is of the size of feed over radius, so that it converges
        to rounding in three steps.
        """
        delta = j * self.feed * cos / radius
        for _ in range(4):
            off = (
                radius * np.sin(delta)
                - (j * self.feed - self._per_radian * delta) * cos
            )
            delta = delta - off / (radius * np.cos(delta) + self._per_radian * cos)
        return delta

    @property
    def _per_radian(self) -> float:
        """Travel of the axis per radian of the spindle [m]."""
        return self.feed * self.teeth / (2 * math.pi)

    def _tooth_radius(self, tooth: int, lag: Values) -> Values:
        """Radius of the path of a tooth at every height [m], shape (slice,).

        Teeth are counted in the order in which they pass, the next one 2 pi / N on; by
        the lag of a helix an edge stands elsewhere on the tool.
        """
        place = 2 * math.pi * tooth / self.teeth - lag
        return self.radius + self.runout * np.cos(place - self.runout_angle)

    def _faces(self, cos: Values) -> tuple[Values, Values]:
        """Radii between which a ray lies in the raw stock [m], as cos."""
        if self.side == "slot":
            return np.zeros_like(cos), np.full_like(cos, np.inf)
        toward = cos if self.side == "down" else -cos
        # The stock is where toward * r <= offset.
        offset = self.radial_depth - self.radius
        face = offset / np.where(toward == 0, 1e-30, toward)
        inner = np.where(toward < 0, np.maximum(face, 0.0), 0.0)
        return inner, np.where(toward > 0, np.maximum(face, 0.0), np.inf)
