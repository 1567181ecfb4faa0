"""Coefficients from whole records of forces, with their figures."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from .._session.errors import BadInput
from .._session.progress import Progress
from .diagnoses import diagnosis_facts, diagnosis_lines, diagnosis_title
from .outcome import Outcome
from .registration import (
    axes_are_doubted,
    axes_lines,
    placed,
    record_lines,
    tooth_lines,
)
from .text import coefficient_lines, correlation_lines, noted

if TYPE_CHECKING:
    from ...config import ForceRecordTask
    from ...identification import AxesProposal, CrossValidation, ForceCoefficientFit

# How far a tooth may stand off the angle that is given for it [deg]: a degree moves
# the radial coefficients by some percent, and a mark is hardly known so well.
_TOOTH_OFF = 10.0


def identify_records(task: "ForceRecordTask", progress: Progress) -> Outcome:
    """Fit the coefficients to records.

    Args:
        task: The records and settings.
        progress: Told what is being done.
    """
    from ...config import doubted
    from ...identification import (
        axes_of,
        combine_axes_proposals,
        cross_validate,
        fit_force_coefficients,
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
    reach = settings.shift_range
    if reach is None and all(record.knows_tooth for record in task.records):
        reach = _TOOTH_OFF / 360 * 2 * np.pi / max(one.spindle_speed for one in beside)
    try:
        fit = fit_force_coefficients(
            [one.cut for one in beside],
            [one.time for one in beside],
            [one.force for one in beside],
            axes=axes,
            time_shift=0.0 if fixed and reach is None else None,
            shift_range=reach,
            loss=settings.loss,  # pyright: ignore[reportArgumentType]
            refine=settings.refine,
            lowpass=settings.lowpass,
        )
    except ValueError as error:
        raise BadInput(f"{task.name}: {error}") from error
    left = cross_validate(fit)
    is_likely = not axes_are_doubted(proposal, axes)
    # In wrong axes an offset explains the means, though nothing is wrong with channels.
    found = fit.diagnoses if is_likely else ()
    lines = [
        *record_lines(task, beside),
        *axes_lines(proposal, axes, settings.takes_proposed),
        *_fit_lines(fit, left, task),
        *diagnosis_lines(found, axes, [one.name for one in task.records]),
        *tooth_lines(
            task.records, [(one.shift, one.revolution) for one in fit.records]
        ),
    ]
    diagnoses = [
        dataclasses.replace(one, record=i)
        for i, place in enumerate(beside)
        for one in place.diagnoses
    ]
    diagnoses += found
    toml = _toml(fit, is_likely)
    grave = [one for one in diagnoses if one.is_grave]
    if grave and is_likely and not fit.doubts:
        toml = doubted(toml, f"{diagnosis_title(grave[0])}; see summary.txt.")
    return Outcome(
        lines,
        toml,
        {**_facts(task, fit, proposal, left), "diagnoses": diagnosis_facts(diagnoses)},
        lambda folder: _draw(folder, task, fit, left),
    )


def _fit_lines(
    fit: "ForceCoefficientFit",
    left: "tuple[CrossValidation, ...]",
    task: "ForceRecordTask",
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
    for doubt in fit.doubts:
        lines += noted(doubt, "warning")
    for part in left:
        lines.append(
            f"left out: {task.records[part.record].name}, {part.what}: "
            f"{part.error:.2%} of the force rms off"
        )
    lines += correlation_lines(names, fit.correlation)
    for note in fit.notes[len(fit.doubts) :]:
        lines += noted(note)
    return lines


def _toml(fit: "ForceCoefficientFit", is_likely: bool) -> list[str]:
    """Return the tables for a job, as comments if they are doubtful."""
    from ...config import doubted, force_toml, uncertainty_toml
    from ...identification import relative_uncertainty

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
    if fit.doubts:
        return doubted(lines, f"{fit.doubts[0].partition(':')[0]}; see summary.txt.")
    if not is_likely:
        return doubted(lines, "Other axes make more sense; see summary.txt.")
    return lines


def _facts(
    task: "ForceRecordTask",
    fit: "ForceCoefficientFit",
    proposal: "AxesProposal",
    left: "tuple[CrossValidation, ...]",
) -> dict[str, Any]:
    """Return the numbers for `identified.json`."""
    from ...identification import axes_of

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
        "gross_errors": fit.gross_errors,
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
    left: "tuple[CrossValidation, ...]",
) -> None:
    """Write the figures."""
    from ...identification import residual_force, residual_spectrum
    from ...viz import (
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
