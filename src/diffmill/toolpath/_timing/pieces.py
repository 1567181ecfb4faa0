"""Smooth pieces of curve, each a function of the distance along it."""

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from .._moves import Move, Point


class Segment(NamedTuple):
    """A straight piece, possibly of length zero.

    Attributes:
        start: First point [m].
        end: Last point [m].
    """

    start: Point
    end: Point

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
        fraction = distance / (self.length or 1.0)
        along = np.subtract(self.end, self.start)
        return np.array([self.start]) + fraction[:, None] * along[None]

    def tangent(self, *, at_end: bool) -> Point:
        """Return the unit direction of travel."""
        (a, b, c), (x, y, z), length = self.start, self.end, self.length
        return (x - a) / length, (y - b) / length, (z - c) / length

    def trimmed(self, head: float, tail: float) -> "Segment":
        """Return the piece without a length at its start and at its end [m]."""
        direction = self.tangent(at_end=False)
        return Segment(
            moved(self.start, head, direction), moved(self.end, -tail, direction)
        )


class Arc(NamedTuple):
    """An arc, helix or slight spiral in any plane, from fraction `first` to `last`.

        p(u) = c + (r_0 + u (r_1 - r_0)) (cos(u sweep) e_1 + sin(u sweep) e_2) + u rise

    Attributes:
        centre: Centre c at the start [m].
        radial: Unit vector e_1 from the centre to the start.
        forward: Unit vector e_2 in the sense of travel.
        radii: Radius at the start and at the end of the whole arc [m].
        sweep: Angle of the whole arc, positive [rad].
        rise: Motion along the axis over the whole arc [m].
        first: Fraction of the whole arc at which the piece starts.
        last: Fraction of the whole arc at which the piece ends.
    """

    centre: Point
    radial: Point
    forward: Point
    radii: tuple[float, float]
    sweep: float
    rise: Point
    first: float = 0.0
    last: float = 1.0

    @property
    def whole(self) -> float:
        """Length of the whole arc [m]; its speed in u is constant but for a spiral."""
        first, last = self.radii
        return math.hypot(0.5 * (first + last) * self.sweep, *self.rise, last - first)

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.whole * (self.last - self.first)

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m]; a helix is straighter than its circle."""
        radius = min(self.radii)
        circular = 0.5 * (self.radii[0] + self.radii[1]) * self.sweep / self.whole
        return circular**2 / radius

    def positions(
        self, distance: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "point 3"]:
        """Return the points at distances from the start [m]."""
        return arc_positions([self], distance)

    def tangent(self, *, at_end: bool) -> Point:
        """Return the unit direction of travel at the start or at the end."""
        u = self.last if at_end else self.first
        change = self.radii[1] - self.radii[0]
        speed = (self.radii[0] + u * change) * self.sweep
        cos, sin = math.cos(u * self.sweep), math.sin(u * self.sweep)
        rate = moved(self.rise, change * cos - speed * sin, self.radial)
        rate = moved(rate, change * sin + speed * cos, self.forward)
        return scaled(rate, 1 / math.hypot(*rate))

    def trimmed(self, head: float, tail: float) -> "Arc":
        """Return the piece without a length at its start and at its end [m]."""
        whole = self.whole
        return self._replace(
            first=self.first + head / whole, last=self.last - tail / whole
        )


def moved(point: Point, length: float, direction: Point) -> Point:
    """Return a point moved along a vector."""
    (x, y, z), (u, v, w) = point, direction
    return x + length * u, y + length * v, z + length * w


def scaled(vector: Point, factor: float) -> Point:
    """Return a vector times a number."""
    x, y, z = vector
    return factor * x, factor * y, factor * z


def arc_positions(
    arcs: list[Arc], distance: Float[np.ndarray, " point"]
) -> Float[np.ndarray, "point 3"]:
    """Return the points at distances from the starts of arcs.

    Args:
        arcs: One arc for each point, or one for all.
        distance: Distances from the start [m], shape (point,).
    """
    centre, radial, forward, rise = (
        np.array([getattr(arc, name) for arc in arcs])
        for name in ("centre", "radial", "forward", "rise")
    )
    first, last, sweep, begin, whole = np.array(
        [(*arc.radii, arc.sweep, arc.first, arc.whole) for arc in arcs]
    ).T[..., None]
    u = begin + distance[:, None] / whole
    radius, angle = first + u * (last - first), u * sweep
    return (
        centre + radius * (np.cos(angle) * radial + np.sin(angle) * forward) + u * rise
    )


class Blend(NamedTuple):
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


Piece: TypeAlias = Segment | Arc | Blend


def piece_of_move(move: Move) -> Segment | Arc:
    """Return the curve of a move."""
    if move.centre is None:
        return Segment(move.start, move.end)
    radii = move.radii
    radial = scaled(move.spokes[0], 1 / radii[0])
    (a, b, c), (u, v, w) = radial, move.normal
    sign = math.copysign(1.0, move.turn)
    forward = scaled((v * c - w * b, w * a - u * c, u * b - v * a), sign)
    rise = scaled(move.normal, move.rise)
    return Arc(move.centre, radial, forward, radii, abs(move.sweep), rise)


def _bezier(
    control: Float[np.ndarray, "4 3"], parameter: Float[np.ndarray, " point"]
) -> Float[np.ndarray, "point 3"]:
    """Return points of a cubic Bezier curve."""
    u = parameter[:, None]
    v = 1 - u
    p0, p1, p2, p3 = control
    return v**3 * p0 + 3 * v**2 * u * p1 + 3 * v * u**2 * p2 + u**3 * p3
