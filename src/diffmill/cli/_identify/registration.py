"""Registration of force records in words: time, axes and doubts."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from ...identification import (
    ForceRecord,
    ForceRecordStudy,
    ForceSettings,
    RecordRegistration,
)
from .diagnoses import diagnosis_lines
from .reading import tare_lines
from .report import all_noted, axes_text, force_on_text, noted
from .rounded import Rounded

# Forces that agree less in size over a job, or overlap less of its cut, are doubted.
_ALIKE, _COVERED = 0.8, 0.9


def tooth_lines(
    records: Sequence[ForceRecord],
    shifts: Sequence[float],
    errors: Sequence[float],
    revolutions: Sequence[float],
) -> list[str]:
    """Angle of tooth 0 at the zero of a measured spindle angle, in words.

    Args:
        records: The records.
        shifts: Of each the time shift that the fit has added [s].
        errors: Standard errors of these [s].
        revolutions: Of each the time of a revolution [s].
    """
    lines = []
    every = zip(records, shifts, errors, revolutions, strict=True)
    for record, shift, error, turn in every:
        # The clock was set so that tooth 0 stands at the measured angle.
        angle = math.remainder(360 * shift / turn, 360)
        shown = Rounded.of(angle, 360 * error / turn).value
        if record.knows_tooth:
            lines.append(
                f"{record.name}: the tooth is {angle:+.2g} deg off the tooth_angle"
            )
        elif record.angle is not None and record.time_shift is None:
            lines += noted(
                f"{record.name}: tooth 0, or one that looks alike, is at "
                f"{shown} deg at the zero of the spindle's angle: "
                f'tooth_angle = "{shown} deg".'
            )
    return lines


def record_lines(
    records: Sequence[ForceRecord], registrations: Sequence[RecordRegistration]
) -> list[str]:
    """Records and their registration in words.

    Args:
        records: The records.
        registrations: Of each of them.
    """
    # What is true of all of them is said once.
    notes = [list(record.notes) for record in records]
    shared = [x for x in notes[0] if all(x in n for n in notes)] if notes[1:] else []
    lines = all_noted([f"of each record: {x}" for x in shared])
    for record, one in zip(records, registrations, strict=True):
        rpm = one.spindle_speed * 30 / np.pi
        known = int(np.isfinite(one.force).any(axis=1).sum())
        lines.append(
            f"{record.name}: {known} samples used, at {record.record.rate:g} Hz from "
            f"{record.start:.4g} to {record.stop:.4g} s, {rpm:.6g} rpm"
        )
        lines += tare_lines(record)
        lines += all_noted([x for x in (*record.notes, *one.notes) if x not in shared])
        lines += diagnosis_lines(one.diagnoses)
        if record.is_saturated:
            lines += noted(
                "Saturated samples were left out of the fit; mean and largest forces "
                "are larger than they show.",
                "warning",
            )
        if one.alignment is None:
            continue
        lines.append(
            f"  the job's time is the record's {one.alignment.shift:+.4g} s; the sizes "
            f"of the forces correlate by {one.alignment.quality:.3f}, and "
            f"{one.alignment.overlap:.0%} of the cut are in the record"
        )
        if one.alignment.quality < _ALIKE or one.alignment.overlap < _COVERED:
            lines += noted(
                "Record and job hardly agree in where the tool cuts: look at feed, "
                "speed, zero and stock of the job, or give the time shift.",
                "warning",
            )
    return lines


def used_axes_lines(axes: Sequence[str], settings: ForceSettings) -> list[str]:
    """Axes of a fit and the body on which the recorded forces act, line by line."""
    why = "as given or recorded"
    if settings.takes_proposed:
        why = "the likeliest, as requested"
    return [
        f"axes: {axes_text(axes)} ({why})",
        f"  {force_on_text(axes, settings.force_on)}",
    ]


def axes_lines(study: ForceRecordStudy, result: ForceRecordStudy.Fit) -> list[str]:
    """Axes of the fit, and others that suit the records; nothing is changed.

    Args:
        study: The records, and what the file says of their axes.
        result: The fit.
    """
    force_on = study.settings.force_on
    proposal, axes = result.proposal, result.fit.axes
    best = proposal.proposals[0]
    used = proposal.candidate(axes)
    lines = used_axes_lines(axes, study.settings)
    if not result.has_likely_axes:
        lines += noted(
            f"The axes {axes_text(best.axes)} make more sense: score "
            f"{best.score:.3f} against {used.score:.3f}; by a quick fit of each, "
            f"{best.residual:.1%} of the rms force is left against "
            f"{used.residual:.1%}. {force_on_text(best.axes, force_on).capitalize()}. "
            "Nothing was changed; give `axes` or `force_on` in [fit], or axes = "
            '"proposed".',
            "warning",
        )
    elif not proposal.is_clear:
        lines += noted(
            "Others suit nearly as well: the record does not determine the axes."
        )
    own = [place.proposal.proposals[0].axes for place in result.registrations]
    # No record tells the sign of z.
    ((usual, count),) = Counter(one[:2] for one in own).most_common(1)
    for record, one in zip(study.records, own, strict=True):
        if count > 1 and one[:2] != usual:
            lines += noted(
                f"{record.name} does not agree with the others: alone it suits the "
                f"axes {axes_text(one)}.",
                "warning",
            )
    lines += [f"  against the axes used: {text}" for text in used.violations]
    return lines + [f"  {sentence}" for sentence in proposal.evidence]
