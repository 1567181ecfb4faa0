"""Coefficients from whole records of forces, with their figures."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ._errors import BadInput
from ._identify import Outcome
from ._identify_text import (
    NONSENSE,
    axes_text,
    coefficient_lines,
    correlation_lines,
    noted,
)
from ._progress import Progress

if TYPE_CHECKING:
    from ..identification import AxesProposal, ForceCoefficientFit, LeftOut, Placed
    from ..io import ForceRecord, ForceRecordTask

# A fit that explains less of the force, or forces that agree less in size over a job,
# are doubted.
_EXPLAINED, _ALIKE, _COVERED = 0.8, 0.8, 0.9
# Axes are doubted if others score this much better.
_BETTER = 0.05


def placed(
    record: "ForceRecord", refines_speed: bool, others: "Sequence[ForceRecord]"
) -> "Placed":
    """Return a record beside its cut.

    Args:
        record: The record, ready.
        refines_speed: Whether the speed of straight cuts is taken from the record.
        others: All records, among them this one: their cuts get stock of one size.

    Raises:
        BadInput: The record and its cut do not meet.
    """
    from ..identification import place_on_job, place_on_steady_cut
    from ..io import StraightCut

    time, force = samples(record)
    process = record.process
    try:
        if not isinstance(process, StraightCut):
            return place_on_job(process, time, force, time_shift=record.time_shift)
        assert process.spindle_speed is not None
        return place_on_steady_cut(
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
        )
    except ValueError as error:
        raise BadInput(f"{record.name}: {error}") from error


def samples(record: "ForceRecord") -> tuple[Any, Any]:
    """Return time and force of the part to be fitted, saturated samples unknown."""
    one = record.record
    keep = (one.time >= record.start) & (one.time <= record.stop)
    force = np.where(one.is_saturated[:, None], np.nan, one.force)
    return one.time[keep], force[keep]


def identify_records(task: "ForceRecordTask", progress: Progress) -> Outcome:
    """Fit the coefficients to records.

    Args:
        task: The records and settings.
        progress: Told what is being done.
    """
    from ..identification import (
        axes_of,
        combine_axes_proposals,
        fit_force_coefficients,
        predict_left_out,
    )

    settings, beside = task.fit, []
    for record in task.records:
        progress.update(f"cut of {record.name}")
        beside.append(placed(record, settings.refines_speed, task.records))
    proposal = combine_axes_proposals([one.proposal for one in beside])
    likely = axes_of(proposal.proposals[0].matrix)
    axes = settings.axes or ("x", "y", "z")
    if settings.takes_proposed:
        axes = likely
    progress.update("coefficients")
    fixed = all(record.time_shift is not None for record in task.records)
    try:
        fit = fit_force_coefficients(
            [one.cut for one in beside],
            [one.time for one in beside],
            [one.force for one in beside],
            axes=axes,
            time_shift=0.0 if fixed and settings.shift_range is None else None,
            shift_range=settings.shift_range,
            loss=settings.loss,  # pyright: ignore[reportArgumentType]
            refine=settings.refine,
        )
    except ValueError as error:
        raise BadInput(f"{task.name}: {error}") from error
    left = predict_left_out(fit)
    lines = [
        *_record_lines(task, beside),
        *axes_lines(proposal, axes, settings.takes_proposed),
        *_fit_lines(fit, left, task),
    ]
    return Outcome(
        lines,
        _toml(fit),
        _facts(task, fit, proposal, left),
        lambda folder: _draw(folder, task, fit, left),
    )


def _record_lines(task: "ForceRecordTask", beside: "list[Placed]") -> list[str]:
    """Return what was read and how it meets its cut."""
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


def axes_lines(
    proposal: "AxesProposal", axes: tuple[str, str, str], takes_proposed: bool
) -> list[str]:
    """Return what the record says of its axes; nothing is changed by it.

    Args:
        proposal: The assignments, the likeliest first.
        axes: Those that are used.
        takes_proposed: Whether the file asks for the likeliest.
    """
    from ..identification import axes_of

    best = proposal.proposals[0]
    likely = axes_of(best.matrix)
    used = next(c for c in proposal.candidates if axes_of(c.matrix) == axes)
    why = "the likeliest, as asked for" if takes_proposed else "as given or recorded"
    lines = [f"axes: {axes_text(axes)} ({why})"]
    if used.score - best.score > _BETTER:
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


def _fit_lines(
    fit: "ForceCoefficientFit", left: "tuple[LeftOut, ...]", task: "ForceRecordTask"
) -> list[str]:
    """Return coefficients and how far to trust them."""
    names = list(fit.coefficients)
    lines = [
        "",
        *coefficient_lines(
            fit.coefficients,
            dict(zip(names, fit.raw.tolist(), strict=True)),
            fit.standard_errors,
            fit.identifiable,
        ),
    ]
    for name, value in fit.refined.items():
        text = f"{1e6 * value:.3g}" if np.isfinite(value) else "not identifiable"
        lines.append(f"{name:14}{text:>12}{1e6 * fit.refined_errors[name]:12.2g}  um")
    lines.append(
        f"the fit explains {fit.explained:.2%} of the squared force; it leaves "
        f"{fit.residual_rms:.4g} N of {fit.force_rms:.4g} N rms"
    )
    if fit.explained < _EXPLAINED:
        lines += noted(
            "That is little: axes, cut, speed or time shift may be wrong, and the "
            "standard errors do not tell how far the coefficients are off.",
            "warning",
        )
    for part in left:
        lines.append(
            f"left out: {task.records[part.record].name}, {part.what}: "
            f"{part.error:.2%} of the force rms off"
        )
    lines += correlation_lines(names, fit.correlation)
    for note in fit.notes:
        lines += noted(note)
    return lines


def _toml(fit: "ForceCoefficientFit") -> list[str]:
    """Return the tables for a job."""
    from ..identification import relative_uncertainty
    from ..io import doubted, force_toml, uncertainty_toml

    rows = np.concatenate(
        [one.engagement.columns.reshape(-1, 6) for one in fit.records]
    )
    share = relative_uncertainty(
        fit.coefficients, fit.standard_errors, fit.correlation, rows
    )
    lines = [
        *force_toml(fit.coefficients, fit.standard_errors, fit.identifiable),
        *uncertainty_toml("force", share),
    ]
    return doubted(lines, NONSENSE) if fit.raw[0] <= 0 else lines


def _facts(
    task: "ForceRecordTask",
    fit: "ForceCoefficientFit",
    proposal: "AxesProposal",
    left: "tuple[LeftOut, ...]",
) -> dict[str, Any]:
    """Return the numbers for `identified.json`."""
    from ..identification import axes_of

    return {
        "kind": "force_records",
        "records": [record.name for record in task.records],
        "coefficients_SI": fit.coefficients,
        "standard_errors_SI": fit.standard_errors,
        "raw_SI": fit.raw,
        "names": list(fit.coefficients),
        "correlation": fit.correlation,
        "identifiable": fit.identifiable,
        "refined_m": fit.refined,
        "refined_errors_m": fit.refined_errors,
        "explained": fit.explained,
        "residual_rms_N": fit.residual_rms,
        "force_rms_N": fit.force_rms,
        "axes": fit.axes,
        "proposed_axes": [
            {
                "axes": axes_of(one.matrix),
                "score": one.score,
                "residual": one.residual,
                "violations": one.violations,
                "coefficients_SI": one.coefficients,
            }
            for one in proposal.proposals
        ],
        "axes_are_clear": proposal.is_clear,
        "axes_evidence": proposal.evidence,
        "time_shift_s": fit.time_shift,
        "left_out": [
            {"record": part.record, "what": part.what, "error": part.error}
            for part in left
        ],
        "notes": [*fit.notes, *(n for r in task.records for n in r.notes)],
    }


def _draw(
    folder: pathlib.Path,
    task: "ForceRecordTask",
    fit: "ForceCoefficientFit",
    left: "tuple[LeftOut, ...]",
) -> None:
    """Write the figures."""
    from ..identification import residual_force, residual_spectrum
    from ..viz import (
        plot_correlation,
        plot_force_fit,
        plot_prediction,
        plot_residual_spectrum,
        save_figure,
    )

    for i, (record, one) in enumerate(zip(task.records, fit.records, strict=True)):
        number = f"_{i + 1}" if len(task.records) > 1 else ""
        off = residual_force(fit, i)
        figure = plot_force_fit(
            one.time + one.shift,
            one.force,
            one.force - off,
            revolution=one.revolution,
            title=record.name,
        )
        save_figure(figure, folder / f"record{number}.png")
        frequency, amplitude = residual_spectrum(fit, i)
        whole = 2 * np.abs(np.fft.rfft(np.nan_to_num(one.force), axis=0)) / len(off)
        figure = plot_residual_spectrum(
            frequency,
            amplitude,
            whole,
            tooth_frequency=1 / one.cut.tooth_period,
            flute_count=one.cut.cutter.flute_count,
            title=record.name,
        )
        save_figure(figure, folder / f"spectrum{number}.png")
        part = left[i]
        figure = plot_prediction(
            part.measured,
            part.predicted,
            unit="N",
            title=f"{record.name}: {part.what}, {part.error:.1%} off",
        )
        save_figure(figure, folder / f"left_out{number}.png")
    figure = plot_correlation(list(fit.coefficients), fit.correlation)
    save_figure(figure, folder / "correlation.png")
