"""Limits of speed and acceleration along a way, from coordinates that move with it.

Along the way s the joints of a robot stand at q(s). Their speeds are q' s_dot and their
accelerations q'' s_dot^2 + q' s_ddot: each of the two terms gets half of what a joint
may, so that their sum stays within it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Limits are this much below what is allowed, for what is between two rows.
_LIMIT_MARGIN = 0.99
# Neighbours with limits within this factor of each other have one limit.
_SAME_LIMIT_FACTOR = 1.1
# Rows nearer to each other than this [m] are left out: their differences are rounding.
_LEAST_ROW_DISTANCE = 1e-6
# Rounding of speeds and accelerations at rows.
_ROUNDING_SHARE = 1e-9


class WayLimit(NamedTuple):
    """A limit on a part of a way.

    Attributes:
        end: Way at which the part ends [m]; it begins where the one before ends.
        speed: Largest speed [m/s].
        acceleration: Largest acceleration along the way [m/s^2].
        cause: What limits, such as "joint a4".
    """

    end: float
    speed: float
    acceleration: float
    cause: str


class JointCourse(NamedTuple):
    """Joint positions of a robot along a path, and the limits of the joints.

    Attributes:
        q: Joint positions at the rows of a path [rad or m], shape (row, joint).
        names: Of the joints.
        speed: Fastest motion of each [rad/s or m/s], shape (joint,); may be infinite.
        acceleration: Largest acceleration of each [rad/s^2 or m/s^2], shape (joint,);
            may be infinite.
    """

    q: Float[np.ndarray, "row joint"]
    names: tuple[str, ...]
    speed: Float[np.ndarray, " joint"]
    acceleration: Float[np.ndarray, " joint"]

    def keeps_bounds(self, time_step: float) -> bool:
        """True if rows that are `time_step` [s] apart keep the limits."""
        rate = np.abs(np.diff(self.q, axis=0)) / time_step
        change = np.abs(np.diff(self.q, 2, axis=0)) / time_step**2
        more = 1 + _ROUNDING_SHARE
        is_slow = (rate <= more * self.speed).all()
        return bool(is_slow and (change <= more * self.acceleration).all())

    def way_limits(
        self,
        way: Float[np.ndarray, " row"],
        stops: Float[np.ndarray, " stop"],
        *,
        fastest: float,
        largest_acceleration: float,
    ) -> tuple[WayLimit, ...]:
        """Limits that the joints set along a way.

        Args:
            way: Way at each row of `q` [m], not decreasing, shape (row,).
            stops: Ways at which the tool is at rest [m], and may turn, shape (stop,).
            fastest: Speed along the way that the motion never passes [m/s].
            largest_acceleration: Acceleration that it never passes [m/s^2].

        Returns:
            The limits; none if the joints allow all of it.
        """
        rows = _apart(way)
        if len(rows) < 3:
            return ()
        at = way[rows]
        step = np.diff(at)
        slope = np.abs(np.diff(self.q[rows], axis=0)) / step[:, None]
        bend = np.zeros_like(slope)
        turn = np.abs(np.diff(np.diff(self.q[rows], axis=0) / step[:, None], axis=0))
        turn /= ((step[1:] + step[:-1]) / 2)[:, None]
        # Where it stops, the way may turn at once: that takes no speed.
        first = np.searchsorted(stops, at[:-2], side="right")
        last = np.searchsorted(stops, at[2:])
        turn[last > first] = 0.0
        bend[1:] = turn
        bend[:-1] = np.maximum(bend[:-1], turn)
        with np.errstate(divide="ignore"):
            by_speed = _LIMIT_MARGIN * self.speed / slope
            by_bend = np.sqrt(_LIMIT_MARGIN * self.acceleration / 2 / bend)
            by_slope = _LIMIT_MARGIN * self.acceleration / 2 / slope
        by_joint = np.minimum(by_speed, by_bend)
        speed = _with_neighbours(np.minimum(by_joint.min(axis=1), fastest))
        acceleration = _with_neighbours(
            np.minimum(by_slope.min(axis=1), largest_acceleration)
        )
        if (speed >= fastest).all() and (acceleration >= largest_acceleration).all():
            return ()
        # The joint that takes most of what is asked for is the one that is named.
        share = np.maximum(fastest / by_joint, largest_acceleration / by_slope)
        return _merged(at, speed, acceleration, share, self.names)


def lowest(
    some: tuple[WayLimit, ...], others: tuple[WayLimit, ...]
) -> tuple[WayLimit, ...]:
    """Limits that keep both of two lists of limits along the same way."""
    if not (some and others):
        return some or others
    ends = sorted({limit.end for limit in some + others})
    # The last limit of either holds to the end, whose way is rounded.
    first, second = (
        np.minimum(np.searchsorted([x.end for x in one], ends), len(one) - 1).tolist()
        for one in (some, others)
    )
    out = []
    for end, i, j in zip(ends, first, second, strict=True):
        pair = some[i], others[j]
        slower = min(pair, key=lambda limit: limit.speed)
        least = min(limit.acceleration for limit in pair)
        out.append(slower._replace(end=end, acceleration=least))
    return tuple(out)


def _apart(way: Float[np.ndarray, " row"]) -> list[int]:
    """Return rows that are not too near to each other, from the first on."""
    rows, before = [0], float(way[0])
    for row, here in enumerate(way.tolist()):
        if here - before >= _LEAST_ROW_DISTANCE:
            rows.append(row)
            before = here
    return rows


def _with_neighbours(limit: Float[np.ndarray, " part"]) -> Float[np.ndarray, " part"]:
    """Return the least of each limit and those beside it."""
    out = limit.copy()
    out[1:] = np.minimum(out[1:], limit[:-1])
    out[:-1] = np.minimum(out[:-1], limit[1:])
    return out


def _merged(
    at: Float[np.ndarray, " row"],
    speed: Float[np.ndarray, " part"],
    acceleration: Float[np.ndarray, " part"],
    share: Float[np.ndarray, "part joint"],
    names: tuple[str, ...],
) -> tuple[WayLimit, ...]:
    """Return few limits for many that are nearly the same."""
    out: list[WayLimit] = []
    first = 0
    for part in range(1, len(speed) + 1):
        here = slice(first, part + 1)
        if part < len(speed) and all(
            x[here].max() <= _SAME_LIMIT_FACTOR * x[here].min()
            for x in (speed, acceleration)
        ):
            continue
        here = slice(first, part)
        joint = names[int(np.argmax(share[here].max(axis=0)))]
        least = float(speed[here].min()), float(acceleration[here].min())
        out.append(WayLimit(float(at[part]), *least, f"joint {joint}"))
        first = part
    return tuple(out)
