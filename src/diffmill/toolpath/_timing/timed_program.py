"""A program under the limits of a controller: its speeds, its rows at instants."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._types import RealScalarLike
from .._moves import Program
from .._path import MOST_STEPS, SAME_INSTANT, Path, check_steps
from .._turned_axes import turned_axes, turned_tool_x
from .cycle_time import CycleTime, Loss
from .legs import (
    JERK,
    SHORTEST_LENGTH,
    Leg,
    TimingLimits,
    legs_of_program,
    rounded_corner_count,
    sections_of,
)
from .pieces import Arc, Segment, arc_positions
from .smoothing import WayInTime, mean_way
from .way_limits import JointCourse, WayLimit, lowest


class Profile(NamedTuple):
    """Trapezoidal speed over the pieces, one entry per piece."""

    length: Float[np.ndarray, " piece"]
    speed_in: Float[np.ndarray, " piece"]
    speed_peak: Float[np.ndarray, " piece"]
    speed_out: Float[np.ndarray, " piece"]
    time_rise: Float[np.ndarray, " piece"]
    time_fall: Float[np.ndarray, " piece"]
    duration: Float[np.ndarray, " piece"]


class ProgramTiming(NamedTuple):
    """Timing of a program, to time another one in the same way.

    Attributes:
        limits: Limits of the controller.
        along: Further limits along its path, from the joints.
        cycle_time: Time that it takes, and what makes it longer.
    """

    limits: TimingLimits
    along: tuple[WayLimit, ...]
    cycle_time: CycleTime

    def timed(self, program: Program) -> "TimedProgram":
        """Return another program under the same limits, its way nearly the same.

        Raises:
            ValueError: If a feed is missing, the tool turns on the spot or to the
                opposite axis, or nothing moves.
        """
        return TimedProgram.of(program, self.limits, self.along)


class TimedProgram(NamedTuple):
    """A program with the speed at every place of it.

    Attributes:
        program: The program; its approach has no time.
        limits: Limits of the controller.
        along: Further limits along its path.
        legs: Its pieces, corners rounded.
        profile: Speeds on them.
    """

    program: Program
    limits: TimingLimits
    along: tuple[WayLimit, ...]
    legs: list[Leg]
    profile: Profile

    @classmethod
    def of(
        cls, program: Program, limits: TimingLimits, along: tuple[WayLimit, ...] = ()
    ) -> "TimedProgram":
        """Return a program under limits.

        Args:
            program: The program.
            limits: Limits of the controller.
            along: Further limits along its path.

        Raises:
            ValueError: If a limit is not positive, a feed is missing, the tool turns on
                the spot or to the opposite axis, or nothing moves.
        """
        limits.check()
        legs = legs_of_program(program, limits, along)
        return cls(program, limits, along, legs, _speeds(legs))

    @property
    def timing(self) -> ProgramTiming:
        """Timing of the program."""
        return ProgramTiming(self.limits, self.along, self.cycle_time)

    @property
    def stops(self) -> Float[np.ndarray, " stop"]:
        """Ways from the start at which the tool is at rest [m], shape (stop,)."""
        is_stop = np.array([leg.is_stop for leg in self.legs])
        return np.append(0.0, np.cumsum(self.profile.length)[is_stop])

    @property
    def rounded_corners(self) -> int:
        """Number of corners that are rounded by up to the corner tolerance."""
        return rounded_corner_count(self.program, self.limits)

    @property
    def cycle_time(self) -> CycleTime:
        """Time that the program takes, and what makes it longer."""
        # A move that states its time loses none.
        stated = sum(leg.duration for leg in self.legs if leg.duration is not None)
        asked = sum(
            leg.piece.length / leg.asked for leg in self.legs if leg.duration is None
        )
        return CycleTime.of_losses(asked + stated, self._losses())

    def _losses(self) -> Iterator[Loss]:
        """Yield the times that limits add, piece by piece."""
        duration = self.profile.duration.tolist()
        longer = self._longer(sections_of(self.legs)).tolist()
        section = 0
        for leg, seconds in zip(self.legs, duration, strict=True):
            if leg.duration is None:
                at_limit = leg.piece.length / leg.speed
                yield Loss(leg.line, leg.cause, at_limit - leg.piece.length / leg.asked)
                yield Loss(leg.line, leg.ramp_cause, seconds - at_limit)
            if leg.is_stop:
                yield Loss(leg.line, JERK, longer[section])
                section += 1

    def within(
        self,
        path: Path,
        q: Float[np.ndarray, "row joint"],
        *,
        names: tuple[str, ...],
        speed: Float[np.ndarray, " joint"],
        acceleration: Float[np.ndarray, " joint"],
    ) -> "TimedProgram":
        """Return the program slowed down where joints would pass their limits.

        What joints do between two rows does not show, where a curve is short or begins
        behind a rapid move: the slower program has more rows there. So repeat this with
        its own path until it returns the same program.

        Args:
            path: This program at its tooth instants, at rest before and after or not.
            q: Joint positions at the rows of `path` [rad or m], shape (row, joint).
            names: Of the joints.
            speed: Fastest motion of each [rad/s or m/s], shape (joint,); may be
                infinite.
            acceleration: Largest acceleration of each [rad/s^2 or m/s^2], shape
                (joint,); may be infinite.

        Returns:
            The program; this one if the joints keep their limits.

        Raises:
            ValueError: If the path has not as many rows as this program.
        """
        way = self._way_at(path)
        if way[-1] == 0:
            return self
        course = JointCourse(q, names, speed, acceleration)
        # Rows of a slowed program are nearer to each other and show more.
        if self.along and course.keeps_bounds(path.duration / (path.step_count - 1)):
            return self
        along = course.way_limits(
            way,
            self.stops,
            fastest=max(leg.speed for leg in self.legs),
            largest_acceleration=self.limits.acceleration,
        )
        if not along:
            return self
        return TimedProgram.of(self.program, self.limits, lowest(self.along, along))

    def path(
        self, tooth_period: RealScalarLike, *, most_steps: RealScalarLike = MOST_STEPS
    ) -> Path:
        """Path of the program: the tool at every tooth instant, see `sample_program`.

        Args:
            tooth_period: Time between rows T [s].
            most_steps: Largest number of tooth periods.

        Raises:
            ValueError: If the period is not positive, or the motion takes more than
                `most_steps`.
        """
        if not (math.isfinite(tooth_period) and tooth_period > 0):
            raise ValueError(
                "Argument `tooth_period` must be positive and finite, but is "
                f"{tooth_period}."
            )
        period = float(tooth_period)
        duration = self.profile.duration.sum()
        duration += self._longer(sections_of(self.legs)).sum()
        check_steps(float(duration / period), float(most_steps))
        legs = self.legs
        index, distance = self._places(period)
        share = distance / np.array([leg.piece.length or 1.0 for leg in legs])[index]
        first = np.array([leg.first_axis for leg in legs])
        last = np.array([leg.last_axis for leg in legs])
        axes, tool_x = turned_axes(first[index], last[index], share), None
        # Of a program that states the rotation about the tool axis everywhere.
        first_x = [leg.first_x for leg in legs if leg.first_x is not None]
        last_x = [leg.last_x for leg in legs if leg.last_x is not None]
        if len(first_x) == len(last_x) == len(legs):
            first, last = np.hstack([first, first_x]), np.hstack([last, last_x])
            tool_x = turned_tool_x(first[index], last[index], share, axes)
        return Path(
            time=period * np.arange(index.size),
            positions=_positions(legs, index, distance),
            axes=axes,
            is_rapid=np.array([leg.is_rapid for leg in legs])[index],
            line=np.array([leg.line for leg in legs], dtype=np.int32)[index],
            tool_x=tool_x,
        )

    def _way_at(self, path: Path) -> Float[np.ndarray, " step"]:
        """Return the way [m] at the rows of the program's path."""
        # Chords between rows are shorter than curves: they would shift limits along
        # the way, by more than a rounded corner is long.
        index, distance = self._places(path.duration / (path.step_count - 1))
        begun = np.cumsum(self.profile.length) - self.profile.length
        way = np.maximum.accumulate(begun[index] + distance)
        at_rest, odd = divmod(path.step_count - way.size, 2)
        if at_rest < 0 or odd:
            raise ValueError(
                f"Argument `path` must have the {way.size} rows of this program, with "
                f"as many at rest before as after them, but has {path.step_count}."
            )
        return np.pad(way, at_rest, mode="edge")

    def _longer(self, section: Int[np.ndarray, " piece"]) -> Float[np.ndarray, " part"]:
        """Return by how much smoothing lengthens the way from stop to stop [s]."""
        # A move that states its time is not longer, and no rest.
        is_free = np.array([leg.duration is None for leg in self.legs])
        smoothing = self.limits.smoothing
        return smoothing * (np.bincount(section, self.profile.length * is_free) > 0)

    def _places(
        self, tooth_period: float
    ) -> tuple[Int[np.ndarray, " step"], Float[np.ndarray, " step"]]:
        """Pieces on which the tool is at the tooth instants, distances within [m]."""
        legs, profile = self.legs, self.profile
        margin = SAME_INSTANT * tooth_period

        def at(ends: Float[np.ndarray, " part"], time: np.ndarray) -> np.ndarray:
            return np.minimum(np.searchsorted(ends, time - margin), ends.size - 1)

        ends = np.cumsum(profile.duration)
        section = sections_of(legs)
        first = np.flatnonzero(np.diff(section, prepend=-1))
        stops = ends[np.append(first[1:], len(legs)) - 1]
        # Between two stops a smoothed motion takes so much longer.
        longer = self._longer(section)
        late = np.cumsum(longer)
        count = max(1, math.ceil((stops[-1] + late[-1]) / tooth_period - SAME_INSTANT))
        time = tooth_period * np.arange(count + 1)
        if self.limits.smoothing == 0:
            index = at(ends, time)
            begun = (ends - profile.duration)[index]
            return index, _travelled(profile, index, time - begun)
        part = at(stops + late, time)
        begun = np.append(0.0, stops[:-1])
        local = time - (begun + late - longer)[part]
        way = _way_in_time(profile)
        gone = mean_way(way, begun[part], stops[part], local, longer[part])
        lengths = np.cumsum(profile.length)
        before = (lengths - profile.length)[first]
        index = np.searchsorted(lengths, before[part] + gone - SHORTEST_LENGTH)
        index = np.clip(index, first[part], np.append(first[1:], len(legs))[part] - 1)
        distance = before[part] + gone - (lengths - profile.length)[index]
        return index, np.clip(distance, 0.0, profile.length[index])


def _speeds(legs: list[Leg]) -> Profile:
    """Return the speed profile of all pieces by a backward and a forward pass."""
    length = np.array([leg.piece.length for leg in legs])
    limit = np.array([leg.speed for leg in legs])
    acceleration = np.array([leg.acceleration for leg in legs])
    is_stop = np.array([leg.is_stop for leg in legs[:-1]], dtype=bool)
    inner = np.where(is_stop, 0.0, np.minimum(limit[:-1], limit[1:]))
    gain = 2 * acceleration * length
    # Squares of the speeds where pieces meet: first what can slow down, then what can
    # speed up.
    square = [0.0, *(inner**2).tolist(), 0.0]
    gains = gain.tolist()
    for index in range(len(gains) - 1, -1, -1):
        square[index] = min(square[index], square[index + 1] + gains[index])
    for index, more in enumerate(gains):
        square[index + 1] = min(square[index + 1], square[index] + more)
    joint = np.sqrt(square)
    speed_in, speed_out = joint[:-1].copy(), joint[1:].copy()
    peak = np.sqrt(np.minimum(limit**2, (speed_in**2 + speed_out**2 + gain) / 2))
    rise, fall = (peak - speed_in) / acceleration, (peak - speed_out) / acceleration
    ramps = (speed_in + peak) / 2 * rise + (speed_out + peak) / 2 * fall
    cruise = np.maximum(length - ramps, 0.0) / np.where(peak > 0, peak, 1.0)
    duration = rise + cruise + fall
    for index, leg in enumerate(legs):
        if leg.duration is not None:
            speed = length[index] / leg.duration
            speed_in[index] = peak[index] = speed_out[index] = speed
            rise[index] = fall[index] = 0.0
            duration[index] = leg.duration
    return Profile(length, speed_in, peak, speed_out, rise, fall, duration)


def _way_in_time(profile: Profile) -> WayInTime:
    """Return the way along all pieces as a function of the time."""
    parts = np.stack(
        [
            np.zeros_like(profile.duration),
            profile.time_rise,
            profile.duration - profile.time_fall,
            profile.duration,
        ],
        axis=1,
    )
    begun = np.cumsum(profile.duration) - profile.duration
    speed = np.stack(
        [profile.speed_in, profile.speed_peak, profile.speed_peak, profile.speed_out],
        axis=1,
    )
    return WayInTime((begun[:, None] + parts).reshape(-1), speed.reshape(-1))


def _travelled(
    profile: Profile, index: Int[np.ndarray, " step"], time: Float[np.ndarray, " step"]
) -> Float[np.ndarray, " step"]:
    """Return the distance within each row's piece at a time since its start."""
    length, speed_in, peak, speed_out, rise, fall, duration = (
        column[index] for column in profile
    )
    time = np.clip(time, 0.0, duration)
    remaining = duration - time
    # Mean speed over a ramp, taken from the end that it touches; the middle cruises.
    up = speed_in + (peak - speed_in) * time / np.where(rise > 0, 2 * rise, 1.0)
    down = speed_out + (peak - speed_out) * remaining / np.where(
        fall > 0, 2 * fall, 1.0
    )
    cruise = (speed_in + peak) / 2 * rise + peak * (time - rise)
    distance = np.where(
        time < rise,
        up * time,
        np.where(remaining < fall, length - down * remaining, cruise),
    )
    return np.clip(distance, 0.0, length)


def _positions(
    legs: list[Leg],
    index: Int[np.ndarray, " step"],
    distance: Float[np.ndarray, " step"],
) -> Float[np.ndarray, "step 3"]:
    """Return the tool tips, all straight pieces at once."""
    out = np.zeros((index.size, 3))
    straight = np.array([isinstance(leg.piece, Segment) for leg in legs])[index]
    _fill_straight(out, legs, index, distance, straight)
    arc = np.array([isinstance(leg.piece, Arc) for leg in legs])[index]
    if arc.any():
        arcs = [piece for i in index[arc] if isinstance(piece := legs[i].piece, Arc)]
        out[arc] = arc_positions(arcs, distance[arc])
    other = np.flatnonzero(~(straight | arc))
    if other.size:
        for rows in np.split(other, np.flatnonzero(np.diff(index[other])) + 1):
            out[rows] = legs[index[rows[0]]].piece.positions(distance[rows])
    return out


def _fill_straight(
    out: Float[np.ndarray, "step 3"],
    legs: list[Leg],
    index: Int[np.ndarray, " step"],
    distance: Float[np.ndarray, " step"],
    is_straight: Bool[np.ndarray, " step"],
) -> None:
    """Write the rows on straight pieces; the end of a piece is met exactly."""
    ends = np.zeros((len(legs), 2, 3))
    length = np.ones(len(legs))
    for row, leg in enumerate(legs):
        if isinstance(leg.piece, Segment):
            ends[row] = leg.piece.start, leg.piece.end
            length[row] = leg.piece.length or 1.0
    fraction = (distance / length[index])[:, None]
    points = (1 - fraction) * ends[index, 0] + fraction * ends[index, 1]
    out[is_straight] = points[is_straight]
