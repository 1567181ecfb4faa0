"""Coefficients from whole records of forces: report and figures."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ...identification import (
    ForceRecordStudy,
)
from ...viz import (
    plot_correlation,
    plot_force_fit,
    plot_prediction,
    plot_residual_spectrum,
)
from .diagnoses import diagnosis_facts, diagnosis_lines, tare_facts
from .reading import reading_lines
from .registration import axes_lines, record_lines, tooth_lines
from .report import (
    EstimatedValue,
    Report,
    all_noted,
    coefficient_estimates,
    coefficient_lines,
    correlation_lines,
    noted,
)
from .toml_snippets import NOT_IN_ERRORS, cutter_toml, fitted_force_toml

_ASSUMED = (
    "The tool goes as programmed: neither machine nor tool bends, and the spindle "
    "turns at one speed.",
    "The force law is linear in the chip with an edge force; teeth differ by their "
    "run-out alone.",
    "The dynamometer follows all frequencies alike.",
)


def report(study: ForceRecordStudy, result: ForceRecordStudy.Fit) -> Report:
    """Report of coefficients from records.

    Args:
        study: The records.
        result: Their fit.
    """
    fit, records = result.fit, study.records
    of_fit = fit.diagnoses if result.has_likely_axes else ()
    lines = [
        *record_lines(records, result.registrations),
        *axes_lines(study, result),
        *_fit_lines(study, result),
        *diagnosis_lines(of_fit, fit.axes, [one.name for one in records]),
        *tooth_lines(
            records,
            [one.shift for one in fit.records],
            fit.time_shift_errors,
            [one.revolution for one in fit.records],
        ),
    ]
    doubts = [one.partition(":")[0] for one in fit.doubts]
    toml = fitted_force_toml(result, doubts, cutter_toml(result))
    raw = dict(zip(fit.coefficients, fit.raw.tolist(), strict=True))
    estimates = coefficient_estimates(raw, fit.standard_errors, fit.identifiable)
    estimates += [
        EstimatedValue(name, 1e6 * value, 1e6 * fit.refined_errors[name], "um")
        for name, value in fit.refined.items()
    ]
    facts, figures = _facts(study, result), _figures(study, result)
    return Report(lines, toml, facts, figures, estimates, _ASSUMED)


def reading(study: ForceRecordStudy) -> list[str]:
    """Records in words, line by line."""
    return [line for one in study.records for line in reading_lines(one)]


def _fit_lines(study: ForceRecordStudy, result: ForceRecordStudy.Fit) -> list[str]:
    """Coefficients with their errors and doubts."""
    fit = result.fit
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
    lines += noted(
        "The standard errors include noise, coloured or not, what repeats with the "
        "teeth and is not in the model, and the simulation's rays and angles; not "
        f"{NOT_IN_ERRORS}."
    )
    for name, value in fit.refined.items():
        text = f"{1e6 * value:.3g}" if np.isfinite(value) else "not identifiable"
        lines.append(f"{name:14}{text:>12}{1e6 * fit.refined_errors[name]:12.2g}  um")
    share = f"{fit.explained:.2%}" if fit.explained > 0 else "nothing"
    lines.append(
        f"the fit explains {share} of the squared force; it leaves "
        f"{fit.residual_rms:.4g} N of {fit.force_rms:.4g} N rms"
    )
    lines += all_noted(fit.doubts, "warning")
    for part in result.predicted:
        lines.append(
            f"left out: {study.records[part.record].name}, predicted {part.what}: "
            f"{part.explained:.2%} of the squared force explained, {part.error:.2%} of "
            "the force rms off"
        )
    lines += correlation_lines(names, fit.correlation)
    return lines + all_noted(fit.notes[len(fit.doubts) :])


def _facts(study: ForceRecordStudy, result: ForceRecordStudy.Fit) -> dict[str, Any]:
    """Numbers for `identified.json`."""
    fit = result.fit
    return {
        "kind": study.kind,
        "records": [record.name for record in study.records],
        "tare": tare_facts(study.records),
        "coefficients_SI": fit.coefficients,
        "standard_errors_SI": fit.standard_errors,
        "raw_SI": fit.raw,
        "names": list(fit.coefficients),
        "correlation": fit.correlation,
        "identifiable": fit.identifiable,
        "refined_m": fit.refined,
        "refined_errors_m": fit.refined_errors,
        "has_converged": fit.has_converged,
        "explained": fit.explained,
        "gross_errors": fit.gross_errors,
        "residual_rms_N": fit.residual_rms,
        "force_rms_N": fit.force_rms,
        "axes": fit.axes,
        "force_on": study.settings.force_on,
        "proposed_axes": [
            {
                "axes": one.axes,
                "score": one.score,
                "residual": one.residual,
                "violations": one.violations,
                "coefficients_SI": one.coefficients,
            }
            for one in result.proposal.proposals
        ],
        "axes_are_clear": result.proposal.is_clear,
        "axes_evidence": result.proposal.evidence,
        "time_shift_s": fit.time_shift,
        "left_out": [
            {
                "record": part.record,
                "what": part.what,
                "error": part.error,
                "explained": part.explained,
            }
            for part in result.predicted
        ],
        "notes": [*fit.notes, *(n for r in study.records for n in r.notes)],
        "diagnoses": diagnosis_facts(result.diagnoses),
    }


def _figures(
    study: ForceRecordStudy, result: ForceRecordStudy.Fit
) -> dict[str, Callable[[], Any]]:
    """Functions that draw the figures."""
    fit, draw = result.fit, functools.partial
    names = list(fit.coefficients)
    figures: dict[str, Callable[[], Any]] = {}
    for i, (record, one) in enumerate(zip(study.records, fit.records, strict=True)):
        number = f"_{i + 1}" if len(study.records) > 1 else ""
        off, part = fit.residual_force(i), result.predicted[i]
        spectrum = fit.residual_spectrum(i)
        figures[f"record{number}"] = draw(
            plot_force_fit,
            one.time + one.shift,
            one.force,
            one.force - off,
            revolution=one.revolution,
            title=record.name,
        )
        figures[f"spectrum{number}"] = draw(
            plot_residual_spectrum,
            spectrum.frequency,
            spectrum.amplitude,
            2 * np.abs(np.fft.rfft(np.nan_to_num(one.force), axis=0)) / len(off),
            tooth_frequency=1 / one.cut.tooth_period,
            flute_count=one.cut.cutter.flute_count,
            title=record.name,
        )
        figures[f"left_out{number}"] = draw(
            plot_prediction,
            part.measured,
            part.predicted,
            unit="N",
            title=f"{record.name}: {part.what}, {part.error:.1%} off",
        )
    return {**figures, "correlation": draw(plot_correlation, names, fit.correlation)}
