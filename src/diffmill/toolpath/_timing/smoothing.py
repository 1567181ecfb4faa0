"""Speeding up smoothly: a moving average of the way along a program.

The way s that the tool has gone between two stops is replaced by its mean over the last
tau seconds. The tool stays on the programmed curve; speeds and accelerations are means
of those of the plain motion and so stay within the same limits, and the tangential
acceleration no longer jumps: it changes by 2 a / tau at most.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

Times = Float[np.ndarray, " step"]


class WayInTime:
    """The way along a path whose speed is linear between knots, and its integral.

    Args:
        time: Knots [s], not decreasing, shape (knot,); the speed may jump where two of
            them are the same.
        speed: Speeds there [m/s], shape (knot,).
    """

    def __init__(
        self, time: Float[np.ndarray, " knot"], speed: Float[np.ndarray, " knot"]
    ):
        step = np.diff(time)
        more = (speed[:-1] + speed[1:]) / 2 * step
        self.time, self.speed = time, speed
        self.way = np.concatenate([[0.0], np.cumsum(more)])
        area = self.way[:-1] * step + (2 * speed[:-1] + speed[1:]) * step**2 / 6
        self.area = np.concatenate([[0.0], np.cumsum(area)])
        self.slope = np.diff(speed) / np.where(step > 0, step, 1.0)

    def __call__(self, time: Times) -> tuple[Times, Times]:
        """Return the way [m] and its integral [m s] at times, shape (step,) each."""
        knot = np.searchsorted(self.time, time, side="right") - 1
        knot = np.clip(knot, 0, self.slope.size - 1)
        t = time - self.time[knot]
        s, v, a = self.way[knot], self.speed[knot], self.slope[knot]
        way = s + t * (v + t * a / 2)
        return way, self.area[knot] + t * (s + t * (v / 2 + t * a / 6))


def mean_way(
    way: WayInTime,
    start: Times,
    stop: Times,
    local: Times,
    smoothing: Times,
) -> Times:
    """Return the mean over the last tau of the way between two stops [m].

    Args:
        way: Along the whole path.
        start: When, in the plain motion, the tool leaves the stop before [s].
        stop: When it reaches the next one [s].
        local: Time since the stop before [s], from 0 to stop - start + tau.
        smoothing: tau [s]; the way itself where it is zero.

    Returns:
        Way since the stop before, shape (step,).
    """
    (s_0, A_0), (s_1, _) = way(start), way(stop)
    whole = stop - start

    def area(t: Times) -> Times:
        inside = np.clip(t, 0.0, whole)
        _, A = way(start + inside)
        return A - A_0 - s_0 * inside + (s_1 - s_0) * np.maximum(t - whole, 0.0)

    tau = np.where(smoothing > 0, smoothing, 1.0)
    mean = (area(local) - area(local - tau)) / tau
    here = way(start + np.clip(local, 0.0, whole))[0] - s_0
    return np.clip(np.where(smoothing > 0, mean, here), 0.0, s_1 - s_0)


class SlowRange(NamedTuple):
    """Length of a part of a path [m], and the largest speed on it [m/s]."""

    length: float
    speed: float


def slow_ranges(
    length: Float[np.ndarray, " piece"],
    speed: Float[np.ndarray, " piece"],
    section: Int[np.ndarray, " piece"],
    smoothing: float,
) -> list[list[SlowRange]]:
    """Parts of the pieces of a path with speeds that keep the limits of slow ones.

    Of a piece with the speed v, the mean over tau holds that speed if the plain motion
    holds it v tau / 2 before and after, too.

    Args:
        length: Of the pieces [m], shape (piece,).
        speed: Largest speed on each [m/s], shape (piece,).
        section: Number of the stop before each, shape (piece,).
        smoothing: tau [s].

    Returns:
        For each piece its parts, in order.
    """
    count = length.size
    # Of every piece, how far a slower speed reaches into it from either end.
    heads: list[list[SlowRange]] = [[] for _ in range(count)]
    tails: list[list[SlowRange]] = [[] for _ in range(count)]
    lengths, speeds, sections = length.tolist(), speed.tolist(), section.tolist()
    for i, v in enumerate(speeds):
        for step, ends in ((1, heads), (-1, tails)):
            reach, j = v * smoothing / 2, i + step
            while reach > 0 and 0 <= j < count and sections[j] == sections[i]:
                # A slower one reaches on by itself.
                if speeds[j] <= v:
                    break
                ends[j].append(SlowRange(min(reach, lengths[j]), v))
                reach -= lengths[j]
                j += step
    return [
        _parts(lengths[i], speeds[i], heads[i], tails[i])
        if heads[i] or tails[i]
        else [SlowRange(lengths[i], speeds[i])]
        for i in range(count)
    ]


def _parts(
    length: float,
    speed: float,
    heads: list[SlowRange],
    tails: list[SlowRange],
) -> list[SlowRange]:
    """Return the parts of one piece."""
    ends = {length, *(reach for reach, _ in heads)}
    ends |= {length - reach for reach, _ in tails} - {0.0}
    out, start = [], 0.0
    for end in sorted(ends):
        middle = (start + end) / 2
        slowest = min(
            [speed]
            + [v for reach, v in heads if middle < reach]
            + [v for reach, v in tails if middle > length - reach]
        )
        out.append(SlowRange(end - start, slowest))
        start = end
    return out
