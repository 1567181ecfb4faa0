"""Rounding of the corner between two pieces of path within a tolerance."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .pieces import Arc, Blend, Segment, moved, scaled

# Below this angle two moves count as tangent: at 50 mm/s the velocity then jumps by
# 0.05 mm/s at most, which is what end points rounded to a micrometre cause anyway.
TANGENT_ANGLE = 1e-3
# Beyond this angle the tool turns back; cutting the end short would be no rounding.
REVERSAL_ANGLE = math.radians(170.0)


class Corner(NamedTuple):
    """A rounded corner.

    Attributes:
        trim: Length taken from either side [m].
        piece: The curve in between.
    """

    trim: float
    piece: Arc | Blend


def corner_angle(before: Segment | Arc, after: Segment | Arc) -> float:
    """Return the angle by which the direction of travel jumps [rad]."""
    a, b, c = before.tangent(at_end=True)
    x, y, z = after.tangent(at_end=False)
    across = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    return math.atan2(across, a * x + b * y + c * z)


def round_corner(
    before: Segment | Arc, after: Segment | Arc, angle: float, tolerance: float
) -> Corner:
    """Return a curve that leaves and joins two pieces along their tangents.

    Between straight lines it is the arc whose middle is the tolerance away from the
    corner; elsewhere it is a cubic curve, shortened until it keeps the tolerance. At
    most half of either piece is used, so that neighbouring corners never meet.

    Args:
        before: Piece that ends at the corner.
        after: Piece that starts there.
        angle: `corner_angle` of them [rad], neither tangent nor a reversal.
        tolerance: Largest distance between the curve and the corner path [m].

    Returns:
        The corner.
    """
    half = 0.5 * min(before.length, after.length)
    trim = min(half, tolerance * math.sin(angle / 2) / (1 - math.cos(angle / 2)))
    if isinstance(before, Segment) and isinstance(after, Segment):
        return Corner(trim, _corner_arc(before, after, trim, angle))
    for piece in (before, after):
        if isinstance(piece, Arc):
            trim = min(trim, 0.5 / piece.curvature)
    blend = _corner_blend(before, after, trim)
    while (deviation := _deviation(before, after, trim, blend)) > tolerance:
        trim *= max(0.5, min(0.95, 0.95 * tolerance / deviation))
        blend = _corner_blend(before, after, trim)
    return Corner(trim, blend)


def _corner_arc(before: Segment, after: Segment, trim: float, angle: float) -> Arc:
    """Return the arc tangent to two lines at a distance from where they meet."""
    u, v = before.tangent(at_end=True), after.tangent(at_end=False)
    radius = trim / math.tan(angle / 2)
    inward = moved(v, -sum(a * b for a, b in zip(u, v, strict=True)), u)
    inward = scaled(inward, 1 / math.hypot(*inward))
    centre = moved(moved(before.end, -trim, u), radius, inward)
    rise = (0.0, 0.0, 0.0)
    return Arc(centre, scaled(inward, -1.0), u, (radius, radius), angle, rise)


def _corner_blend(before: Segment | Arc, after: Segment | Arc, trim: float) -> Blend:
    """Return the cubic curve between two trimmed pieces."""
    left, right = before.trimmed(0.0, trim), after.trimmed(trim, 0.0)
    start = left.positions(np.array([left.length]))[0]
    end = right.positions(np.zeros(1))[0]
    angle = corner_angle(left, right)
    # The handle of the cubic that approximates a circle between lines.
    ratio = 4 / 3 * math.tan(angle / 4) / math.tan(angle / 2) if angle > 1e-6 else 2 / 3
    return Blend.from_control(
        np.stack(
            [
                start,
                start + ratio * trim * np.array(left.tangent(at_end=True)),
                end - ratio * trim * np.array(right.tangent(at_end=False)),
                end,
            ]
        )
    )


def _deviation(
    before: Segment | Arc, after: Segment | Arc, trim: float, blend: Blend
) -> float:
    """Return the largest distance between a blend and what it replaces [m]."""
    steps = np.linspace(0.0, trim, 33)
    original = np.concatenate(
        [before.positions(before.length - steps[::-1]), after.positions(steps[1:])]
    )
    curve = blend.positions(np.linspace(0.0, blend.length, 65))
    return max(
        float(np.max(_distances(curve, original))),
        float(np.max(_distances(original, curve))),
    )


def _distances(
    points: Float[np.ndarray, "point 3"], polyline: Float[np.ndarray, "vertex 3"]
) -> Float[np.ndarray, " point"]:
    """Return the distance of each point to a polyline."""
    start, along = polyline[:-1], np.diff(polyline, axis=0)
    offset = points[:, None] - start
    square = np.maximum(np.sum(along**2, axis=1), 1e-300)
    fraction = np.clip(np.sum(offset * along, axis=2) / square, 0.0, 1.0)
    nearest = offset - fraction[:, :, None] * along
    return np.sqrt(np.min(np.sum(nearest**2, axis=2), axis=1))
