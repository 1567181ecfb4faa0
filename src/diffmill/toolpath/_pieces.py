"""Smooth pieces of curve, each a function of the distance along it."""

import math
from abc import abstractmethod

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ._moves import Move


class AbstractPiece(eqx.Module):
    """A smooth piece of a path, travelled by its arc length."""

    @property
    @abstractmethod
    def length(self) -> float:
        """Length [m]."""

    @property
    @abstractmethod
    def curvature(self) -> float:
        """Largest curvature [1/m]."""

    @abstractmethod
    def positions(
        self, distance: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "point 3"]:
        """Return the points at distances from the start [m]."""

    @abstractmethod
    def tangent(self, *, at_end: bool) -> Float[np.ndarray, " 3"]:
        """Return the unit direction of travel at the start or at the end."""


class Segment(AbstractPiece):
    """A straight piece, possibly of length zero.

    Attributes:
        start: First point [m], shape (3,).
        end: Last point [m], shape (3,).
    """

    start: Float[np.ndarray, " 3"]
    end: Float[np.ndarray, " 3"]

    @property
    def length(self) -> float:
        """Length [m]."""
        return math.dist(self.start, self.end)

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m]."""
        return 0.0

    def positions(
        self, distance: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "point 3"]:
        """Return the points at distances from the start [m]."""
        fraction = (
            distance / self.length if self.length > 0 else np.zeros_like(distance)
        )
        return self.start + fraction[:, None] * (self.end - self.start)

    def tangent(self, *, at_end: bool) -> Float[np.ndarray, " 3"]:
        """Return the unit direction of travel."""
        return (self.end - self.start) / self.length

    def trimmed(self, head: float, tail: float) -> "Segment":
        """Return the piece without a length at its start and at its end [m]."""
        direction = self.tangent(at_end=False)
        return Segment(self.start + head * direction, self.end - tail * direction)


class Arc(AbstractPiece):
    """An arc, helix or slight spiral in any plane, from fraction `first` to `last`.

        p(u) = c + (r_0 + u (r_1 - r_0)) (cos(u sweep) e_1 + sin(u sweep) e_2) + u rise

    Attributes:
        centre: Centre c at the start [m], shape (3,).
        radial: Unit vector e_1 from the centre to the start, shape (3,).
        forward: Unit vector e_2 in the sense of travel, shape (3,).
        radii: Radius at the start and at the end of the whole arc [m].
        sweep: Angle of the whole arc, positive [rad].
        rise: Motion along the axis over the whole arc [m], shape (3,).
        first: Fraction of the whole arc at which the piece starts.
        last: Fraction of the whole arc at which the piece ends.
    """

    centre: Float[np.ndarray, " 3"]
    radial: Float[np.ndarray, " 3"]
    forward: Float[np.ndarray, " 3"]
    radii: tuple[float, float]
    sweep: float
    rise: Float[np.ndarray, " 3"]
    first: float = 0.0
    last: float = 1.0

    @property
    def _whole(self) -> float:
        """Length of the whole arc [m]; its speed in u is constant but for a spiral."""
        along = 0.5 * (self.radii[0] + self.radii[1]) * self.sweep
        across = self.radii[1] - self.radii[0]
        return math.hypot(along, float(np.linalg.norm(self.rise)), across)

    @property
    def length(self) -> float:
        """Length [m]."""
        return self._whole * (self.last - self.first)

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m]; a helix is straighter than its circle."""
        radius = min(self.radii)
        circular = 0.5 * (self.radii[0] + self.radii[1]) * self.sweep / self._whole
        return circular**2 / radius

    def positions(
        self, distance: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "point 3"]:
        """Return the points at distances from the start [m]."""
        u = (self.first + distance / self._whole)[:, None]
        radius = self.radii[0] + u * (self.radii[1] - self.radii[0])
        angle = u * self.sweep
        spoke = np.cos(angle) * self.radial + np.sin(angle) * self.forward
        return self.centre + radius * spoke + u * self.rise

    def tangent(self, *, at_end: bool) -> Float[np.ndarray, " 3"]:
        """Return the unit direction of travel at the start or at the end."""
        u = self.last if at_end else self.first
        change = self.radii[1] - self.radii[0]
        radius = self.radii[0] + u * change
        cos, sin = math.cos(u * self.sweep), math.sin(u * self.sweep)
        rate = (
            change * (cos * self.radial + sin * self.forward)
            + radius * self.sweep * (cos * self.forward - sin * self.radial)
            + self.rise
        )
        return rate / np.linalg.norm(rate)

    def trimmed(self, head: float, tail: float) -> "Arc":
        """Return the piece without a length at its start and at its end [m]."""
        first = self.first + head / self._whole
        last = self.last - tail / self._whole
        return eqx.tree_at(lambda arc: (arc.first, arc.last), self, (first, last))


class Blend(AbstractPiece):
    """A cubic Bezier curve, walked by a table of its arc length.

    Attributes:
        control: Control points [m], shape (4, 3).
        table: Arc length at equally spaced parameters [m], shape (sample,).
    """

    control: Float[np.ndarray, "4 3"]
    table: Float[np.ndarray, " sample"]

    @classmethod
    def from_control(cls, control: Float[np.ndarray, "4 3"]) -> "Blend":
        """Return the curve with its arc length tabulated."""
        points = _bezier(control, np.linspace(0.0, 1.0, 257))
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return cls(control, np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.table[-1])

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m], from samples."""
        parameter = np.linspace(0.0, 1.0, 65)
        edges = 3 * np.diff(self.control, axis=0)
        u = parameter[:, None]
        rate = edges[0] * (1 - u) ** 2 + 2 * edges[1] * u * (1 - u) + edges[2] * u**2
        bends = 2 * np.diff(edges, axis=0)
        bend = bends[0] * (1 - u) + bends[1] * u
        speed = np.linalg.norm(rate, axis=1)
        return float(np.max(np.linalg.norm(np.cross(rate, bend), axis=1) / speed**3))

    def positions(
        self, distance: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "point 3"]:
        """Return the points at distances from the start [m]."""
        parameters = np.linspace(0.0, 1.0, self.table.size)
        return _bezier(self.control, np.interp(distance, self.table, parameters))

    def tangent(self, *, at_end: bool) -> Float[np.ndarray, " 3"]:
        """Return the unit direction of travel at the start or at the end."""
        before, after = self.control[2:] if at_end else self.control[:2]
        return (after - before) / np.linalg.norm(after - before)


def piece_of_move(move: Move) -> Segment | Arc:
    """Return the curve of a move."""
    start, end = np.array(move.start), np.array(move.end)
    if move.centre is None:
        return Segment(start, end)
    centre = np.array(move.centre)
    spoke = start - centre
    radial = spoke / np.linalg.norm(spoke)
    forward = move.turn * np.array([-radial[1], radial[0], 0.0])
    rise = np.array([0.0, 0.0, move.end[2] - move.start[2]])
    return Arc(centre, radial, forward, move.radii, abs(move.sweep), rise)


def _bezier(
    control: Float[np.ndarray, "4 3"], parameter: Float[np.ndarray, " point"]
) -> Float[np.ndarray, "point 3"]:
    """Return points of a cubic Bezier curve."""
    u = parameter[:, None]
    v = 1 - u
    p0, p1, p2, p3 = control
    return v**3 * p0 + 3 * v**2 * u * p1 + 3 * v * u**2 * p2 + u**3 * p3
