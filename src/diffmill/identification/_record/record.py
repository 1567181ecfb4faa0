"""A measured record of forces, with what is doubtful in it marked."""

import dataclasses
import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from .spindle_angle import Pulses

# Standard deviations beyond which a sample of a tare section is off its median, and
# the mean of a revolution off the others. Without noise all revolutions are alike, but
# for a sample more or less, so that a wrong one is also off by this share of the force
# and this many of its samples.
_GROSS, _LEAST, _SAMPLES = 6.0, 0.02, 3.0


@dataclasses.dataclass(frozen=True)
class MeasuredChannel:
    """A column of a file, and the quantity that it was read as.

    Attributes:
        quantity: Name of the quantity, such as "Fx" or "time".
        column: Name of the column in the file.
        unit: Unit or sensitivity that the user or the file states; "" for none.
        si_unit: SI unit of the quantity; "" for a number without a dimension.
        lowest: Smallest number in `si_unit`.
        highest: Largest number in `si_unit`.
    """

    quantity: str
    column: str
    unit: str
    si_unit: str
    lowest: float
    highest: float


@dataclasses.dataclass(frozen=True)
class Tare:
    """Offset and drift of a record by its sections without a cut, in recorded axes.

        offset + drift * (time - instant)

    Attributes:
        instant: Instant of the offset [s].
        offset: Mean force at the instant [N], shape (3,).
        drift: Slope of the force [N/s], shape (3,); zero where one section is known.
        noise: Standard deviation of the force in the sections, about a line over time
            [N], shape (3,).
    """

    instant: float
    offset: Float[np.ndarray, " 3"]
    drift: Float[np.ndarray, " 3"]
    noise: Float[np.ndarray, " 3"]

    def force(
        self, time: Float[np.ndarray, " sample"]
    ) -> Float[np.ndarray, "sample 3"]:
        """Offset and drift at instants [s] as a force [N], shape (sample, 3)."""
        return self.offset[None] + self.drift[None] * (time - self.instant)[:, None]


@dataclasses.dataclass(frozen=True)
class TurnsMean:
    """Mean force over revolutions.

    Attributes:
        force: [N], shape (3,).
        notes: Revolutions that were left out, in words.
    """

    force: Float[np.ndarray, " 3"]
    notes: tuple[str, ...] = ()


class Record(eqx.Module):
    """Three measured forces over time, in SI units, on the host.

    The axes are those of the dynamometer and the sign is the one that it recorded:
    nothing is turned or mirrored by reading. Forces are finite; rows that had none
    are left out and leave a gap, and a force that was not measured at all is zero.

    Attributes:
        time: Instants [s], increasing, shape (sample,).
        force: Forces in the recorded axes [N], shape (sample, 3).
        rate: Nominal sampling rate [Hz].
        is_saturated: Whether a channel is at the end of its range, shape (sample,).
        is_after_gap: Whether samples are missing just before, shape (sample,).
        tacho: Pulses of the spindle in any unit, shape (sample,), or None; NaN where
            it was not measured.
        angle: Measured spindle angle [rad], likewise.
        names: What the file calls the three forces.
        is_measured: Whether there is a channel of each force.
        notes: What was assumed or repaired when reading, one sentence each.
        source: The file, or where else the record comes from.
        channels: The columns that the record was read from; none if it was not read.
        Channel: A column of a file, and what it was read as.
        Tare: Offset, drift and noise by sections without a cut.

    Raises:
        ValueError: If shapes disagree, fewer than 2 samples are given, a force is not
            finite, no force is measured or one that is not differs from zero, the
            time does not increase or the rate is not positive.
    """

    time: Float[np.ndarray, " sample"]
    force: Float[np.ndarray, "sample 3"]
    rate: float
    is_saturated: Bool[np.ndarray, " sample"]
    is_after_gap: Bool[np.ndarray, " sample"]
    tacho: Float[np.ndarray, " sample"] | None = None
    angle: Float[np.ndarray, " sample"] | None = None
    names: tuple[str, str, str] = eqx.field(static=True, default=("Fx", "Fy", "Fz"))
    is_measured: tuple[bool, bool, bool] = eqx.field(static=True, default=(True,) * 3)
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    source: str = eqx.field(static=True, default="")
    channels: tuple[MeasuredChannel, ...] = eqx.field(static=True, default=())
    Channel = MeasuredChannel
    Tare = Tare

    def __check_init__(self) -> None:
        """Refuse arrays that make no record."""
        count = np.size(self.time)
        if count < 2:
            raise ValueError(f"A record needs at least 2 samples, but has {count}.")
        for name in ("force", "is_saturated", "is_after_gap", "tacho", "angle"):
            value = getattr(self, name)
            wanted = (count, 3) if name == "force" else (count,)
            if value is not None and np.shape(value) != wanted:
                raise ValueError(
                    f"Argument `{name}` must have the shape {wanted}, but has "
                    f"{np.shape(value)}."
                )
        if not np.all(np.isfinite(self.force)):
            raise ValueError("Argument `force` must be finite, but is not.")
        if not any(self.is_measured):
            raise ValueError("Argument `is_measured` must name a force, but has none.")
        if np.any(self.force[:, ~np.array(self.is_measured)]):
            raise ValueError(
                "Argument `force` must be zero where not measured, but is not."
            )
        # Written so that NaN is refused, too.
        if not np.all(np.diff(self.time) > 0):
            raise ValueError("Argument `time` must increase, but does not.")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise ValueError(
                f"Argument `rate` must be positive and finite, but is {self.rate}."
            )

    def section(self, start: float, stop: float) -> "Record":
        """Samples from `start` to `stop` [s], both included.

        Raises:
            ValueError: Fewer than two samples are left.
        """
        keep = (self.time >= start) & (self.time <= stop)
        if np.count_nonzero(keep) < 2:
            raise ValueError(
                f"The section {start:g} s to {stop:g} s must have 2 samples of the "
                f"record ({self.time[0]:g} s to {self.time[-1]:g} s), but has "
                f"{np.count_nonzero(keep)}."
            )
        names = ("time", "force", "is_saturated", "is_after_gap", "tacho", "angle")
        values = {name: getattr(self, name) for name in names}
        part = {name: None if v is None else v[keep] for name, v in values.items()}
        return dataclasses.replace(self, **part)

    def parts_between_gaps(self, *, longest: float = 0.0) -> list[slice]:
        """Samples between the gaps, one slice for each part.

        Args:
            longest: A gap that lasts no longer parts nothing [s].
        """
        is_apart = self.is_after_gap[1:] & (np.diff(self.time) > longest)
        starts = [0, *np.flatnonzero(is_apart) + 1, self.time.size]
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(starts)]

    def tare(self, before: slice, after: slice | None = None) -> Tare:
        """Offset, drift and noise by sections without a cut.

        Gross errors, six standard deviations off the section's median, do not count.

        Args:
            before: From where to where the tare section is [s], as slice(start, stop).
            after: A second one, which shows the drift [s], or None. The line goes
                through the mean time and mean force of both sections: charge amplifiers
                drift by a constant current.

        Raises:
            ValueError: If fewer than 2 samples lie in a section or both are the same.
        """
        first = self._level(before)
        if after is None:
            return first
        second = self._level(after)
        if first.instant == second.instant:
            raise ValueError("Arguments `before` and `after` must be two sections.")
        slope = (second.offset - first.offset) / (second.instant - first.instant)
        noise = np.sqrt(0.5 * (first.noise**2 + second.noise**2))
        return Tare(first.instant, first.offset, slope, noise)

    def without(self, tare: Tare) -> "Record":
        """Record less its offset and drift."""
        return dataclasses.replace(self, force=self.force - tare.force(self.time))

    def mean_over_turns(
        self, start: float, stop: float, spindle_speed: float | None
    ) -> "TurnsMean":
        """Mean force of a straight cut [N].

        Offset and drift are removed before. Single samples cannot be judged, since a
        cut is all peaks; the means of its revolutions are alike.

        Args:
            start: Where the cut begins [s].
            stop: Where it ends [s].
            spindle_speed: [rad/s]; None takes the mean of all samples.

        Returns:
            The mean, with a sentence if revolutions were left out.
        """
        inside = (self.time >= start) & (self.time < stop)
        time, force = self.time[inside], self.force[inside]
        if spindle_speed is None:
            return TurnsMean(force.mean(axis=0))
        turn = 2 * np.pi / spindle_speed
        place = np.floor((time - start) / turn).astype(int)
        count = max(1, int((stop - start) / turn + 1e-6))
        force, place = force[place < count], place[place < count]
        sizes = np.bincount(place, minlength=count)
        sums = np.stack(
            [np.bincount(place, f, minlength=count) for f in force.T], axis=1
        )
        sums, sizes = sums[sizes > 0], sizes[sizes > 0]
        off = sums / sizes[:, None]
        off = np.abs(off - np.median(off, axis=0)[None])
        # The median deviation is 0.67 standard deviations.
        limit = _GROSS / 0.67 * np.median(off, axis=0)
        least = max(_LEAST, _SAMPLES / np.median(sizes)) * np.sqrt(np.mean(force**2))
        good = np.all(off <= np.maximum(limit, least)[None], axis=1)
        if good.all():
            return TurnsMean(force.mean(axis=0))
        if good.mean() < 0.5:
            note = (
                "The mean forces of the revolutions do not agree with one another: "
                "look at the speed, and at where the cut begins and ends."
            )
            return TurnsMean(force.mean(axis=0), (note,))
        note = (
            f"{int((~good).sum())} of {good.size} revolutions have gross errors and "
            "were left out of the mean force."
        )
        return TurnsMean(sums[good].sum(axis=0) / sizes[good].sum(), (note,))

    def angle_from_tacho(
        self, *, pulses_per_turn: int = 1, first_angle: float = 0.0, smoothing: int = 1
    ) -> Float[np.ndarray, " sample"]:
        """Angle of the spindle from the pulses of a tacho [rad], shape (sample,).

        A pulse is where the signal rises through the middle of its range, to a part of
        a sample; it counts again only after falling below 40 % of the range. The angle
        is linear between pulses and goes on at the last speed outside of them. Samples
        without a number are bridged. Pulses nearer than half the median distance are
        bounces and left out; a distance of about several medians counts as that many
        pulses.

        Args:
            pulses_per_turn: Number of pulses in a turn.
            first_angle: Angle at the first pulse [rad].
            smoothing: Pulses through whose instants a parabola is laid, around each of
                them: a steep edge is known to a sample only, while a spindle turns
                evenly.

        Returns:
            The angle at each sample [rad], increasing, shape (sample,).

        Raises:
            ValueError: If the record has no tacho or fewer than two pulses.
        """
        if self.tacho is None or not np.isfinite(self.tacho).any():
            raise ValueError("The record must have a tacho channel, but has none.")
        seen = np.isfinite(self.tacho)
        pulses = Pulses.of_signal(self.time[seen], self.tacho[seen])
        pulses = pulses.smoothed(smoothing)
        return first_angle + pulses.passed(self.time) * 2 * np.pi / pulses_per_turn

    def _level(self, section: slice) -> Tare:
        """Mean force and noise of a section, gross errors left out; without a drift."""
        part = self.section(section.start, section.stop)
        off = np.abs(part.force - np.median(part.force, axis=0)[None])
        # The median deviation is 0.67 standard deviations; none tells of few digits.
        limit = _GROSS / 0.67 * np.median(off, axis=0)
        is_good = (off <= limit[None]) | (limit[None] == 0)
        level = np.mean(part.force, axis=0, where=is_good)
        # About a line: a drift within the section is no noise.
        late = (part.time - part.time.mean())[:, None] * is_good
        late = late - late.mean(axis=0, where=is_good)[None] * is_good
        slope = np.sum(late * part.force, axis=0) / np.sum(late**2, axis=0)
        off = part.force - level[None] - slope[None] * late
        noise = np.sqrt(np.mean(off**2, axis=0, where=is_good))
        return Tare(float(part.time.mean()), level, np.zeros_like(level), noise)
