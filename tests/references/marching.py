"""Cutting forces of a general end mill, by marching in time along a straight feed.

The tool advances along a straight line with a constant axis, and has done so for ever.
At each instant each tooth is a row of short elements on its edge. The chip before an
element is the way from it, along the inward normal, to the nearest of the surfaces that
the earlier teeth left, as far as that lies in the raw stock: faces that bound the stock
cut off the chip on either side. An element touches where it has such a chip.

A surface left by an earlier tooth is the tool's surface of revolution, with that
tooth's own radius, at the place where the tool was then:

- circles (default): the tool stands still while it turns, and an earlier pass lies
  exact multiples of the feed behind;
- trochoids: the tool moves while it turns, and the earlier place is that of the instant
  when the earlier edge passed the very point where the normal meets its surface.

Conventions: axes of the tool x, y and z, +z from tip to shank; clockwise rotation seen
from the shank; immersion angle phi from tool +y, the edge at e = (sin phi, cos phi)
moving along t = (cos phi, -sin phi); tooth j at
phi = theta + angle_j - 2 z tan(helix) / D. Forces act on the tool:
F = -F_t t - F_r n + F_a a, n the outward normal and a = t x n (+z on a cylinder).

Left out: motion of the tool across the cutting direction t (feed is slow against the
rotation); an element whose inward normal meets no earlier surface at all (the outermost
feed per tooth at the sharp corner of a flat tool) cuts nothing.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .halfspaces import Stock

# Parts of a chip, from the edge inward, at which a face of the stock is looked for.
_PARTS = 16
# Force per chip width [N/m], tangential, radial, axial, shape (3, ...), from h [m].
Law = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class LinearLaw:
    """Forces linear in the chip thickness, with edge terms.

    Attributes:
        K_tc, K_rc, K_ac: Tangential, radial, axial cutting coefficients [Pa].
        K_te, K_re, K_ae: Tangential, radial, axial edge coefficients [N/m].
    """

    K_tc: float
    K_rc: float
    K_ac: float
    K_te: float = 0.0
    K_re: float = 0.0
    K_ae: float = 0.0

    def __call__(self, chip_thickness: np.ndarray) -> np.ndarray:
        """Return the force per chip width [N/m], shape (3, ...)."""
        h = chip_thickness
        return np.stack(
            [
                self.K_tc * h + self.K_te,
                self.K_rc * h + self.K_re,
                self.K_ac * h + self.K_ae,
            ]
        )


@dataclasses.dataclass(frozen=True)
class Tool:
    """A general end mill with vertical sides.

    Attributes:
        radius: Radius R [m].
        tooth_angles: Angle of each tooth at the tip [rad], ascending within a turn.
        length: Height of the cutting edges above the tip [m].
        corner_radius: Radius of the corner [m]: 0 flat, R ball, else bull-nose.
        helix_angle: Helix angle at the radius R, of constant lead [rad].
        runout: How far the tool's axis lies beside that of rotation, e [m]: an edge at
            the angle phi of the tool is e cos(runout_angle - phi) farther out.
        runout_angle: Angle of the run-out [rad].
        bottom_inner_radius: Where the bottom edges begin [m].
    """

    radius: float
    tooth_angles: tuple[float, ...]
    length: float
    corner_radius: float = 0.0
    helix_angle: float = 0.0
    runout: float = 0.0
    runout_angle: float = 0.0
    bottom_inner_radius: float = 0.0

    def __post_init__(self) -> None:
        """Check the angles and the corner."""
        angles = np.asarray(self.tooth_angles)
        if np.any(np.diff(angles) <= 0) or angles[-1] - angles[0] >= 2 * math.pi:
            raise ValueError(
                "Argument `tooth_angles` must ascend within one turn, but is "
                f"{self.tooth_angles}"
            )
        if not 0 <= self.corner_radius <= self.radius:
            raise ValueError(
                "Argument `corner_radius` must lie between 0 and the radius "
                f"{self.radius}, but is {self.corner_radius}"
            )

    def offset(self, tooth: int, height: np.ndarray) -> np.ndarray:
        """Return how much farther out a tooth is at heights above the tip [m]."""
        angle = self.tooth_angles[tooth] - self.lag(height)
        return self.runout * np.cos(self.runout_angle - angle)

    def lag(self, height: np.ndarray) -> np.ndarray:
        """Return the angle by which the edge lags behind its tip [rad]."""
        return height * math.tan(self.helix_angle) / self.radius


def even_teeth(count: int) -> tuple[float, ...]:
    """Return the angles of evenly spaced teeth [rad]."""
    return tuple(2 * math.pi * j / count for j in range(count))


@dataclasses.dataclass(frozen=True)
class Elements:
    """Elements along the profile: ends, middles and normals, without run-out.

    Attributes:
        radius: Radii of the start, middle, end [m], shape (3, element).
        height: Heights of the start, middle, end [m], shape (3, element).
        lead: Angle kappa between axis and normal [rad], 0 at the bottom and pi/2 on
            the sides, shape (element,).
        width: Lengths along the profile [m], shape (element,).
    """

    radius: np.ndarray
    height: np.ndarray
    lead: np.ndarray
    width: np.ndarray


def bottom_elements(tool: Tool, count: int) -> Elements:
    """Return the elements of the flat bottom, from its inner radius outward."""
    outer = tool.radius - tool.corner_radius
    radius = _thirds(tool.bottom_inner_radius, outer, count)
    return Elements(
        radius, np.zeros_like(radius), np.zeros(count), radius[2] - radius[0]
    )


def side_elements(tool: Tool, count: int) -> Elements:
    """Return the elements of the corner and the cylinder, shared by their lengths."""
    r_c = tool.corner_radius
    kappa_end = math.acos(1 - min(tool.length / r_c, 1)) if r_c > 0 else 0.0
    arc, straight = r_c * kappa_end, max(tool.length - r_c, 0.0)
    arc_count = math.ceil(count * arc / (arc + straight))
    if straight > 0:
        arc_count = min(arc_count, count - 1)
    kappa = _thirds(0, kappa_end, arc_count)
    z = _thirds(r_c, tool.length, count - arc_count)
    return Elements(
        radius=np.hstack(
            [tool.radius - r_c * (1 - np.sin(kappa)), np.full_like(z, tool.radius)]
        ),
        height=np.hstack([r_c * (1 - np.cos(kappa)), z]),
        lead=np.hstack([kappa[1], np.full(z.shape[1], math.pi / 2)]),
        width=np.hstack([r_c * (kappa[2] - kappa[0]), z[2] - z[0]]),
    )


def _thirds(low: float, high: float, count: int) -> np.ndarray:
    """Return starts, middles and ends of `count` equal parts, shape (3, count)."""
    edges = np.linspace(low, high, count + 1)
    return np.stack([edges[:-1], (edges[:-1] + edges[1:]) / 2, edges[1:]])


@dataclasses.dataclass(frozen=True)
class Chips:
    """The chips of one tooth over a revolution, where there are any; tool axes.

    Attributes:
        step: Index of the instant, shape (chip,).
        element: Index of the element, shape (chip,).
        radius: Distance of the middle of the chip from the axis [m], shape (chip,).
        thickness: Chip thickness h in the stock [m], shape (chip,).
        width: Width of the chip in the stock, along the profile [m], shape (chip,).
        directions: Unit vectors t, n, a, shape (3, chip, 3).
    """

    step: np.ndarray
    element: np.ndarray
    radius: np.ndarray
    thickness: np.ndarray
    width: np.ndarray
    directions: np.ndarray


def tool_axes(axis: np.ndarray, tool_x: np.ndarray | None = None) -> np.ndarray:
    """Return the tool's axes as columns, shape (3, 3).

    Tool x is as near to `tool_x` (work x if not given) as the axis allows.
    """
    a = np.asarray(axis, float) / np.linalg.norm(axis)
    wanted = np.array([1.0, 0, 0]) if tool_x is None else np.asarray(tool_x, float)
    x = wanted - (wanted @ a) * a
    if np.linalg.norm(x) < 1e-9:
        raise ValueError(
            f"Argument `tool_x` must not be along the axis, but both are {axis}"
        )
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(a, x), a], axis=1)


def turning_angles(steps: int) -> np.ndarray:
    """Return the angles theta of the instants [rad]: middles of equal parts."""
    return 2 * math.pi * (np.arange(steps) + 0.5) / steps


def chips(
    tool: Tool,
    stock: Stock,
    feed: np.ndarray,
    elements: Elements,
    *,
    steps: int = 720,
    is_trochoidal: bool = False,
) -> Iterator[Chips]:
    """Yield the chips of each tooth over a revolution.

    Args:
        tool: The tool.
        stock: The raw stock in axes of the tool, the origin at the tip (at theta = 0
            where the tool moves).
        feed: Feed per mean tooth period in axes of the tool [m], shape (3,).
        elements: The elements of the edge.
        steps: Number of instants of the revolution.
        is_trochoidal: Whether the tool moves while it turns.
    """
    theta = turning_angles(steps)[:, None]
    travel = feed * len(tool.tooth_angles) / (2 * math.pi)  # per radian
    tip = theta[..., None] * (travel if is_trochoidal else 0 * travel)
    for tooth, angle in enumerate(tool.tooth_angles):
        radius = elements.radius + tool.offset(tooth, elements.height)
        start, middle, end = (
            tip
            + _cylindrical(
                radius[k],
                elements.height[k],
                theta + angle - tool.lag(elements.height[k]),
            )
            for k in range(3)
        )
        phi = theta + angle - tool.lag(elements.height[1])
        lead = np.broadcast_to(elements.lead, phi.shape)
        inward = -_directions(phi, lead)[1]
        most = np.linalg.norm(travel) * 2 * math.pi / len(tool.tooth_angles)
        looks = [
            stock.fraction(start + depth * inward, end + depth * inward)
            for depth in (0, most / 2, most)
        ]
        # Run-out toward the axis leaves elements at the tip of a ball without radius.
        step, element = np.nonzero(np.max(looks, axis=0) * (radius[1] > 0))
        directions = _directions(phi[step, element], elements.lead[element])
        h = _thickness(
            tool,
            tooth,
            (middle - tip)[step, element],
            directions[1],
            travel,
            is_trochoidal=is_trochoidal,
        )
        # Surfaces slid along themselves touch: rounding is no chip.
        cut = h > 1e-10 * tool.radius
        step, element, h, directions = (
            step[cut],
            element[cut],
            h[cut],
            directions[:, cut],
        )
        ends = start[step, element], end[step, element]
        share, filled, depth = _in_stock(stock, *ends, -directions[1], h)
        cut = share > 0
        yield Chips(
            step[cut],
            element[cut],
            (radius[1, element] - depth * np.sin(elements.lead[element]))[cut],
            (h * filled)[cut],
            (share * elements.width[element])[cut],
            directions[:, cut],
        )


def _in_stock(
    stock: Stock,
    start: np.ndarray,
    end: np.ndarray,
    inward: np.ndarray,
    thickness: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what of chips is in the stock, each of shape (chip,).

    The share of the width that has a chip, the share of the thickness there, and the
    mean depth of the chip below the edge [m].
    """

    def shares(part: float, chips: Any = slice(None)) -> np.ndarray:
        way = (part * thickness[:, None] * inward)[chips]
        return stock.fraction(start[chips] + way, end[chips] + way)

    outer, inner = shares(0.0), shares(1.0)
    width, filled, depth = outer.copy(), np.ones_like(outer), thickness / 2
    # Where both sides are in the stock so is the chip.
    part = np.nonzero((outer < 1) | (inner < 1))[0]
    places = (np.arange(_PARTS) + 0.5) / _PARTS
    found = np.stack([shares(place, part) for place in places])
    total = found.sum(axis=0)
    most = np.max([*found, outer[part], inner[part]], axis=0)
    safe = np.where(most > 0, most, 1)
    width[part] = most
    filled[part] = total / safe / _PARTS
    mean = np.sum(places[:, None] * found, axis=0) / np.where(total > 0, total, 1)
    depth[part] = mean * thickness[part]
    return width, filled, depth


def _cylindrical(radius: np.ndarray, height: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return points from radius, height and immersion angle, shape (..., 3)."""
    x, y = radius * np.sin(phi), radius * np.cos(phi)
    return np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1)


def _directions(phi: np.ndarray, kappa: np.ndarray) -> np.ndarray:
    """Return t, n and a = t x n at an immersion and a lead angle, shape (3, n, 3)."""
    t = _cylindrical(np.ones_like(phi), np.zeros(1), phi + math.pi / 2)
    n = _cylindrical(np.sin(kappa), -np.cos(kappa), phi)
    return np.stack([t, n, np.cross(t, n)])


def _thickness(
    tool: Tool,
    tooth: int,
    points: np.ndarray,
    normals: np.ndarray,
    travel: np.ndarray,
    *,
    is_trochoidal: bool,
) -> np.ndarray:
    """Return the chip thickness at points given from the present tip, shape (n,).

    The passes of one turn decide, the tooth's own last one among them: what lies in a
    convex body now and two feeds behind also lies in it one feed behind, so that no
    still earlier pass of the same radius has swept more of the chip.
    """
    N = len(tool.tooth_angles)
    nearest = np.full(len(points), np.inf)
    for m in range(1, N + 1):
        earlier = (tooth + m) % N
        delay = tool.tooth_angles[earlier] - tool.tooth_angles[tooth]
        delay += 2 * math.pi if delay <= 0 else 0
        radius = tool.radius + tool.offset(earlier, points[:, 2])
        since = np.full(len(points), delay)
        h = np.zeros(len(points))
        for _ in range(8 if is_trochoidal else 1):
            seen = points + since[:, None] * travel
            h = _way_to_body(seen, -normals, radius, tool.corner_radius)
            met = seen - np.where(np.isfinite(h), h, 0)[:, None] * normals
            since = delay - _advance(tool, points, met)
        nearest = np.minimum(nearest, h)
    return np.where(np.isfinite(nearest), nearest, 0)


def _advance(tool: Tool, points: np.ndarray, met: np.ndarray) -> np.ndarray:
    """Return how much farther an edge turns to reach `met` than `points` [rad].

    Of the earlier edge, seen from its own tip; less than a quarter turn, so that the
    search stays near where the centre of a ball leaves the angle undefined.
    """
    turn = np.arctan2(met[:, 0], met[:, 1]) - np.arctan2(points[:, 0], points[:, 1])
    turn = (turn + math.pi) % (2 * math.pi) - math.pi
    turn += tool.lag(met[:, 2] - points[:, 2])
    return np.clip(turn, -math.pi / 2, math.pi / 2)


def _way_to_body(
    points: np.ndarray, directions: np.ndarray, radius: np.ndarray, corner: float
) -> np.ndarray:
    """Return how far points are from a tool's body along directions, shape (n,).

    0 inside, infinite where the line misses. The distance from a convex body is convex
    along a line, so Newton's method from outside comes nearer without passing by.
    """
    way = np.zeros(len(points))
    active = np.arange(len(points))
    for _ in range(60):
        at = points[active] + way[active, None] * directions[active]
        distance, gradient = _body_distance(at, radius[active], corner)
        slope = np.sum(gradient * directions[active], axis=-1)
        is_outside = distance > 1e-13 * radius[active]
        is_lost = is_outside & (slope >= 0)
        way[active[is_lost]] = np.inf
        goes_on = is_outside & ~is_lost
        active = active[goes_on]
        if active.size == 0:
            return way
        way[active] -= distance[goes_on] / slope[goes_on]
    # A tangent line: its double root is met by halves, here to the last digits.
    return way


def _body_distance(
    points: np.ndarray, radius: np.ndarray, corner: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance from the tool's body and, outside, its gradient.

    The body is a rounded cylinder with its tip at the origin and no upper end.
    """
    r = np.hypot(points[:, 0], points[:, 1])
    out, down = r - (radius - corner), corner - points[:, 2]
    out_plus, down_plus = np.maximum(out, 0), np.maximum(down, 0)
    length = np.hypot(out_plus, down_plus)
    safe = np.where(length > 0, length, 1)
    radial = out_plus / safe / np.where(r > 0, r, 1)
    gradient = np.stack(
        [radial * points[:, 0], radial * points[:, 1], -down_plus / safe], axis=-1
    )
    inside = np.minimum(np.maximum(out, down), 0)
    return length + inside - corner, gradient


def force_over_revolution(
    tool: Tool,
    law: Law,
    stock: Stock,
    feed_vector: np.ndarray,
    axis: np.ndarray,
    *,
    tip: np.ndarray | None = None,
    tool_x: np.ndarray | None = None,
    bottom_law: Law | None = None,
    steps: int = 720,
    elements: int = 200,
    is_trochoidal: bool = False,
) -> np.ndarray:
    """Return the force on the tool over a revolution.

    Args:
        tool: The tool.
        law: Force per chip width of corner and sides.
        stock: The raw stock in axes of the work.
        feed_vector: Feed per mean tooth period in axes of the work [m], shape (3,).
        axis: Axis of the tool from tip to shank, any length, shape (3,).
        tip: Position of the tip [m], shape (3,); the origin if not given. A tool
            that moves is there at theta = 0.
        tool_x: Direction that tool x comes nearest to, shape (3,); work x if not given.
        bottom_law: Force per chip width of the bottom edges, which cut only where
            there is one.
        steps: Number of instants, at `turning_angles(steps)`.
        elements: Number of elements of a tooth; the bottom has as many.
        is_trochoidal: Whether the tool moves while it turns.

    Returns:
        Force on the tool in axes of the work [N], shape (step, 3).

    Raises:
        ValueError: If `tool_x` is along the axis.
    """
    axes = tool_axes(axis, tool_x)
    origin = np.zeros(3) if tip is None else np.asarray(tip, float)
    seen = stock.shifted(-origin).rotated(axes.T)
    feed = np.asarray(feed_vector, float) @ axes
    edges = [(law, side_elements(tool, elements))]
    if bottom_law is not None and tool.radius > tool.corner_radius:
        edges.append((bottom_law, bottom_elements(tool, elements)))
    force = np.zeros((steps, 3))
    for edge_law, edge in edges:
        for chip in chips(
            tool, seen, feed, edge, steps=steps, is_trochoidal=is_trochoidal
        ):
            F_t, F_r, F_a = (edge_law(chip.thickness) * chip.width)[..., None]
            t, n, a = chip.directions
            np.add.at(force, chip.step, -F_t * t - F_r * n + F_a * a)
    return force @ axes.T


def mean_force(
    tool: Tool,
    law: Law,
    stock: Stock,
    feed_vector: np.ndarray,
    axis: np.ndarray,
    **options: Any,
) -> np.ndarray:
    """Return the mean force over a revolution [N], shape (3,).

    Arguments as of `force_over_revolution`.
    """
    force = force_over_revolution(tool, law, stock, feed_vector, axis, **options)
    return force.mean(axis=0)
