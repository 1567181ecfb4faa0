"""Centres of programmed arcs, with the tolerances of the LinuxCNC interpreter."""

import math
from typing import NamedTuple

from ..geometry import MM_PER_INCH

Point2 = tuple[float, float]

# LinuxCNC, interp_internal.hh: how far the radii at the ends of an arc may differ,
# and how much too small a programmed radius may be, in the program's units.
_SPIRAL_RELATIVE = 1e-3
_SPIRAL_LIMIT_FACTOR = 100.0
_SEMICIRCLE_RTOL = 1e-12


class ArcTolerance(NamedTuple):
    """Tolerances in the units of the program.

    Attributes:
        spiral: Difference of the radii at the ends that is always accepted.
        radius: Smallest radius, and how much one may be too small for its chord.
    """

    spiral: float
    radius: float


MM_TOLERANCE = ArcTolerance(spiral=2 * 0.01 * math.sqrt(2), radius=5e-5 * MM_PER_INCH)
INCH_TOLERANCE = ArcTolerance(spiral=2 * 0.001 * math.sqrt(2), radius=5e-5)


class ArcError(ValueError):
    """An arc whose numbers do not fit together."""


def centre_from_offset(
    start: Point2, end: Point2, offset: Point2, tolerance: ArcTolerance
) -> Point2:
    """Return the centre of an arc programmed by I and J, relative to its start."""
    centre = (start[0] + offset[0], start[1] + offset[1])
    first, last = math.dist(start, centre), math.dist(end, centre)
    if min(first, last) < tolerance.radius:
        raise ArcError(
            f"the arc has no radius: {first:.6g} at its start, {last:.6g} at its end."
        )
    difference = abs(first - last)
    is_far = difference > tolerance.spiral
    is_far &= difference > _SPIRAL_RELATIVE * max(first, last)
    if is_far or difference > _SPIRAL_LIMIT_FACTOR * tolerance.spiral:
        raise ArcError(
            f"the radius is {first:.6g} at the start of the arc, but {last:.6g} at its "
            f"end; allowed is a difference of {tolerance.spiral:.3g} or "
            f"{_SPIRAL_RELATIVE:.1%}."
        )
    return centre


def centre_from_radius(
    start: Point2, end: Point2, radius: float, turn: int, tolerance: ArcTolerance
) -> Point2:
    """Return the centre of an arc programmed by R; R < 0 takes the longer way."""
    chord = math.dist(start, end)
    if chord == 0:
        raise ArcError(
            "an arc with R must end elsewhere than it starts; write a full circle "
            "with I and J."
        )
    half = chord / 2
    if half - abs(radius) > tolerance.radius:
        raise ArcError(
            f"the radius {abs(radius):.6g} is too small to reach the end of the arc, "
            f"{chord:.6g} away; allowed is {half:.6g} or more."
        )
    square = radius * radius - half * half
    is_semicircle = half > (1 - _SEMICIRCLE_RTOL) * abs(radius)
    height = 0.0 if is_semicircle else math.sqrt(max(square, 0.0))
    # The centre lies to the left of the chord for the short way counter-clockwise.
    side = turn if radius > 0 else -turn
    across = (-(end[1] - start[1]) / chord, (end[0] - start[0]) / chord)
    return (
        (start[0] + end[0]) / 2 + side * height * across[0],
        (start[1] + end[1]) / 2 + side * height * across[1],
    )
