"""Timing of a program under feed and acceleration limits.

The moves become smooth pieces (corners rounded, or exact stops), each with the largest
speed that the feed and the centripetal acceleration allow. A backward and a forward
pass over the pieces give the speeds at their ends that a bounded tangential
acceleration can reach, and each piece is then travelled by speeding up, cruising and
slowing down, smoothed over a time if asked for. The path is read off at the tooth
instants.
"""

from ..._types import RealScalarLike
from .._moves import Program
from .._path import MOST_STEPS, Path
from .legs import TimingLimits
from .timed_program import TimedProgram


def sample_program(
    program: Program,
    tooth_period: RealScalarLike,
    *,
    acceleration: RealScalarLike,
    rapid_feed: RealScalarLike,
    corner_tolerance: RealScalarLike,
    feed: RealScalarLike | None = None,
    smoothing: RealScalarLike = 0.0,
    most_steps: RealScalarLike = MOST_STEPS,
) -> Path:
    """Path of a program: the tool at every tooth instant.

    The tangential and the centripetal acceleration each stay within the limit. The
    tool starts and ends at rest and stops where a rapid move begins or ends, where it
    turns back, and, without a corner tolerance, at every corner. Moves that give a
    duration (inverse time) take exactly that, at a constant speed, unrounded and not
    smoothed; one of them without a displacement holds the tool for its duration.

    Args:
        program: The program; its approach is left out.
        tooth_period: Time between rows T [s].
        acceleration: Largest acceleration along and across the path [m/s^2].
        rapid_feed: Speed of rapid moves [m/s].
        corner_tolerance: Largest distance from a corner [m]; 0 stops exactly there.
        feed: Speed of feed moves that state none [m/s].
        smoothing: Time over which the motion along the path is averaged [s]: the tool
            stays on the path and within the limits, the tangential acceleration changes
            by 2 acceleration / smoothing at most, and the way from one stop to the next
            takes so much longer. Where the curvature jumps, the centripetal
            acceleration still does.
        most_steps: Largest number of tooth periods.

    Returns:
        The path. Its last row is the end point, at or just after the end of the
        motion. A row carries the line and the kind of the move that ends there or
        passes there.

    Raises:
        ValueError: If a limit is not positive, a feed is missing, the tool turns on
            the spot or to the opposite axis, nothing moves, or the motion takes more
            than `most_steps`.
    """
    limits = TimingLimits(
        acceleration=float(acceleration),
        rapid_feed=float(rapid_feed),
        corner_tolerance=float(corner_tolerance),
        feed=None if feed is None else float(feed),
        smoothing=float(smoothing),
    )
    timed = TimedProgram.of(program, limits)
    return timed.path(tooth_period, most_steps=most_steps)
