"""Records of forces with their cuts, as studies take them."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..._job import Job
from .._alignment.record_registration import (
    RecordRegistration,
)
from .._cut.straight_cut import StraightCut
from .._record.diagnosis import Diagnosis
from .._record.record import Record, Tare
from .study import StudyError


@dataclasses.dataclass(frozen=True)
class ForceRecord:
    """A record of forces, ready to be registered on its cut.

    Attributes:
        name: The file, with the number of the cut if it has several.
        record: The record, offset and drift removed.
        process: What was cut.
        start: Where the part to be fitted begins, on the record's clock [s].
        stop: Where it ends [s].
        time_shift: Time of the cut minus time of the record [s], None if not given.
        is_saturated: Whether a sample between start and stop is saturated.
        angle: Spindle angle by a tacho or an encoder [rad], increasing, shape
            (sample,), or None.
        knows_tooth: Whether that is the immersion angle of tooth 0.
        notes: What was assumed or done, one sentence each.
        tare: Offset, drift and noise of the force as it was recorded; None if nothing
            was removed.
    """

    name: str
    record: Record
    process: Job | StraightCut
    start: float
    stop: float
    time_shift: float | None
    is_saturated: bool
    angle: Float[np.ndarray, " sample"] | None
    knows_tooth: bool
    notes: tuple[str, ...]
    tare: Tare | None = None

    def is_used(self) -> Bool[np.ndarray, " sample"]:
        """True for samples of the part to be fitted, shape (sample,)."""
        time = self.record.time
        return (time >= self.start) & (time <= self.stop)

    @property
    def knows_offset(self) -> bool:
        """True if a tare has shown the offset."""
        return self.tare is not None

    @property
    def knows_drift(self) -> bool:
        """True if a tare before and behind the cut has shown the drift."""
        return self.tare is not None and bool(np.any(self.tare.drift != 0))

    def samples(
        self,
    ) -> tuple[Float[np.ndarray, " row"], Float[np.ndarray, "row 3"]]:
        """Times [s] and forces [N] of the part to be fitted; NaN where not known.

        Those are forces without a channel, and saturated samples with their
        neighbours: of samples near the end of the range those would remain that noise
        has made smaller.
        """
        one, keep = self.record, self.is_used()
        is_lost = np.convolve(one.is_saturated, np.ones(3), mode="same") > 0.5
        is_known = ~is_lost[:, None] & np.array(one.is_measured)[None]
        force = np.where(is_known, one.force, np.nan)
        return one.time[keep], force[keep]

    def reversed(self) -> "ForceRecord":
        """Record of the force on the tool, made of that on the workpiece."""
        force = -self.record.force
        return dataclasses.replace(
            self, record=dataclasses.replace(self.record, force=force)
        )

    def register(
        self, others: "Sequence[ForceRecord]", *, refines_speed: bool
    ) -> RecordRegistration:
        """Registration of the record on its cut.

        Args:
            others: All records, among them this one: their cuts get stock of one size.
            refines_speed: Whether the speed of straight cuts is taken from the record.

        Raises:
            StudyError: The record and its cut do not overlap.
        """
        time, force = self.samples()
        angle = None if self.angle is None else self.angle[self.is_used()]
        process = self.process
        try:
            if not isinstance(process, StraightCut):
                return RecordRegistration.on_job(
                    process,
                    time,
                    force,
                    time_shift=self.time_shift,
                    angle=angle,
                    keeps_shift=self.time_shift is not None and not self.knows_tooth,
                )
            cuts = [one.process for one in others]
            return RecordRegistration.on_straight_cut(
                process,
                time,
                force,
                refines_speed=refines_speed,
                largest_feed=max(
                    cut.feed_per_tooth for cut in cuts if isinstance(cut, StraightCut)
                ),
                angle=angle,
            )
        except ValueError as error:
            raise StudyError(f"{self.name}: {error}") from error


def diagnoses_of(registrations: Sequence[RecordRegistration]) -> list[Diagnosis]:
    """Diagnoses of clocks and teeth, each with the index of its record."""
    return [
        dataclasses.replace(one, record=i)
        for i, place in enumerate(registrations)
        for one in place.diagnoses
    ]


@dataclasses.dataclass(frozen=True)
class ForceSettings:
    """Settings of a force fit; see `identification.fit_force_coefficients`.

    Attributes:
        axes: For x, y, z of the work the recorded axis; None if the file does not say.
        takes_proposed: Whether the file takes the likeliest axes.
        loss: "squares", "huber" or "tukey".
        refine: Of "runout" and "radius".
        shift_range: [s], or None.
        lowpass: Cut-off of a low-pass for both sides [Hz], or None.
        refines_speed: Whether the spindle speed of straight cuts is taken from the
            record.
        force_on: "workpiece" if the recorded forces were those on it, and have been
            reversed; "tool"; None if the file does not say.
        has_offset: Whether channels may have an offset of their own; None for those of
            records without a tare.
        has_drift: Whether they may drift; None for those of records whose tare does
            not tell it.
    """

    axes: tuple[str, str, str] | None
    takes_proposed: bool
    loss: str
    refine: tuple[str, ...]
    shift_range: float | None
    lowpass: float | None
    refines_speed: bool
    force_on: str | None = None
    has_offset: bool | None = None
    has_drift: bool | None = None
