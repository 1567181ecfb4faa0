"""Registration of records of forces with their cuts: time, axes and doubts."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._session.errors import BadInput
from .diagnoses import diagnosis_lines
from .text import axes_text, noted

if TYPE_CHECKING:
    from ...config import ForceRecord, ForceRecordTask
    from ...identification import AxesProposal, RecordRegistration

# Forces that agree less in size over a job, or meet less of its cut, are doubted.
_ALIKE, _COVERED = 0.8, 0.9
# Axes are doubted if others score this much better.
_BETTER = 0.05


def placed(
    record: "ForceRecord", refines_speed: bool, others: "Sequence[ForceRecord]"
) -> "RecordRegistration":
    """Return a record beside its cut.

    Args:
        record: The record, ready.
        refines_speed: Whether the speed of straight cuts is taken from the record.
        others: All records, among them this one: their cuts get stock of one size.

    Raises:
        BadInput: The record and its cut do not meet.
    """
    from ...config import StraightCut
    from ...identification import register_on_job, register_on_straight_cut

    time, force = samples(record)
    angle = None
    if record.angle is not None:
        angle = record.angle[_is_used(record)]
    process = record.process
    try:
        if not isinstance(process, StraightCut):
            is_exact = record.time_shift is not None and not record.knows_tooth
            return register_on_job(
                process,
                time,
                force,
                time_shift=record.time_shift,
                angle=angle,
                keeps_shift=is_exact,
            )
        assert process.spindle_speed is not None
        return register_on_straight_cut(
            process.cutter,
            process.spindle_speed,
            process.feed_per_tooth,
            process.axial_depth,
            time,
            force,
            radial_depth=process.radial_depth,
            side=process.side,  # pyright: ignore[reportArgumentType]
            refines_speed=refines_speed,
            largest_feed=max(
                one.process.feed_per_tooth
                for one in others
                if isinstance(one.process, StraightCut)
            ),
            angle=angle,
        )
    except ValueError as error:
        raise BadInput(f"{record.name}: {error}") from error


def samples(record: "ForceRecord") -> tuple[Any, Any]:
    """Return time and force of the part to be fitted; NaN where not known.

    Those are forces without a channel, and saturated samples with their neighbours: of
    samples near the end of the range those would remain that noise has made smaller.
    """
    one = record.record
    keep = _is_used(record)
    is_lost = np.convolve(one.is_saturated, np.ones(3), mode="same") > 0.5
    is_known = ~is_lost[:, None] & np.array(one.is_measured)[None]
    force = np.where(is_known, one.force, np.nan)
    return one.time[keep], force[keep]


def _is_used(record: "ForceRecord") -> Any:
    """Return which samples are of the part to be fitted."""
    time = record.record.time
    return (time >= record.start) & (time <= record.stop)


def tooth_lines(
    records: "Sequence[ForceRecord]", turns: Sequence[tuple[float, float]]
) -> list[str]:
    """Return where tooth 0 stands at the zero of a measured spindle angle.

    Args:
        records: The records.
        turns: Of each the time shift that the fit has added and a revolution [s].
    """
    lines = []
    for record, (shift, turn) in zip(records, turns, strict=True):
        # The clock was set so that tooth 0 stands at the measured angle.
        angle = math.remainder(360 * shift / turn, 360)
        if record.knows_tooth:
            lines.append(
                f"{record.name}: the tooth stands {angle:+.2g} deg off the tooth_angle"
            )
        elif record.angle is not None and record.time_shift is None:
            lines += noted(
                f"{record.name}: tooth 0, or one that looks alike, stands at "
                f"{angle:.4g} deg at the zero of the spindle's angle: "
                f'tooth_angle = "{angle:.4g} deg".'
            )
    return lines


def record_lines(
    task: "ForceRecordTask", beside: "list[RecordRegistration]"
) -> list[str]:
    """Return what was read, and its registration.

    Args:
        task: The records.
        beside: Each of them beside its cut.
    """
    lines = []
    for record, one in zip(task.records, beside, strict=True):
        rpm = one.spindle_speed * 30 / np.pi
        known = int(np.isfinite(one.force).any(axis=1).sum())
        lines.append(
            f"{record.name}: {known} samples at {record.record.rate:g} Hz from "
            f"{record.start:.4g} to {record.stop:.4g} s, {rpm:.6g} rpm"
        )
        for note in (*record.notes, *one.notes):
            lines += noted(note)
        lines += diagnosis_lines(one.diagnoses)
        if record.is_saturated:
            lines += noted(
                "Saturated samples were left out of the fit; mean and largest forces "
                "are larger than they show.",
                "warning",
            )
        if one.meeting is None:
            continue
        lines.append(
            f"  the job's time is the record's {one.meeting.shift:+.4g} s; the sizes "
            f"of the forces correlate by {one.meeting.quality:.3f}, and "
            f"{one.meeting.overlap:.0%} of the cut are in the record"
        )
        if one.meeting.quality < _ALIKE or one.meeting.overlap < _COVERED:
            lines += noted(
                "Record and job hardly agree in where the tool cuts: look at feed, "
                "speed, zero and stock of the job, or give the time shift.",
                "warning",
            )
    return lines


def axes_are_doubted(proposal: "AxesProposal", axes: tuple[str, str, str]) -> bool:
    """Return whether other axes make more sense than those that are used."""
    from ...identification import axes_of

    used = next(c for c in proposal.candidates if axes_of(c.matrix) == axes)
    return used.score - proposal.proposals[0].score > _BETTER


def axes_lines(
    proposal: "AxesProposal", axes: tuple[str, str, str], takes_proposed: bool
) -> list[str]:
    """Return what the record says of its axes; nothing is changed by it.

    Args:
        proposal: The assignments, the likeliest first.
        axes: Those that are used.
        takes_proposed: Whether the file asks for the likeliest.
    """
    from ...identification import axes_of

    best = proposal.proposals[0]
    likely = axes_of(best.matrix)
    used = next(c for c in proposal.candidates if axes_of(c.matrix) == axes)
    why = "the likeliest, as asked for" if takes_proposed else "as given or recorded"
    lines = [f"axes: {axes_text(axes)} ({why})"]
    if axes_are_doubted(proposal, axes):
        lines += noted(
            f"The axes {axes_text(likely)} make more sense: score {best.score:.3f} "
            f"against {used.score:.3f}, {best.residual:.1%} of the force left against "
            f"{used.residual:.1%}. Nothing was changed; give `axes` in [fit], or "
            '"proposed".',
            "warning",
        )
        for violation in used.violations:
            lines.append(f"  against the axes used: {violation}")
    elif not proposal.is_clear:
        lines += noted("Others suit nearly as well: the record does not tell the axes.")
    for sentence in proposal.evidence:
        lines.append(f"  {sentence}")
    return lines
