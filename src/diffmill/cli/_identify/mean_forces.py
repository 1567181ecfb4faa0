"""Coefficients from mean forces over the feed: report and figures."""

import dataclasses
import functools

import numpy as np

from ...identification import MeanForceStudy
from ...viz import plot_correlation, plot_mean_forces
from .diagnoses import diagnosis_facts, diagnosis_lines, tare_facts
from .reading import (
    channel_lines,
    note_lines,
    range_text,
    reading_lines,
    tare_lines,
)
from .registration import used_axes_lines
from .report import (
    Report,
    all_noted,
    axes_text,
    coefficient_estimates,
    coefficient_lines,
    correlation_lines,
    force_on_text,
    noted,
)
from .toml_snippets import NOT_IN_ERRORS, fitted_force_toml

_ASSUMED = (
    "Mean forces grow along a straight line with the feed per tooth: the chip has the "
    "thickness f_z sin(phi), and coefficients do not change with the feed.",
    "All teeth cut alike; the tool neither bends nor wears between the cuts.",
)


def report(study: MeanForceStudy, result: MeanForceStudy.Fit) -> Report:
    """Report of coefficients from mean forces.

    Args:
        study: The means.
        result: Their fit.
    """
    used, fit = result.used, result.fit
    names = [record.name for record in study.records]
    lines = [
        *_input_lines(study),
        *diagnosis_lines(result.diagnoses, records=names),
        *_axes_lines(study, result),
        *_fit_lines(result),
    ]
    if result.amplitudes:
        lines.append(
            "amplitude at the tooth passing, not fitted [N]: predicted / measured"
        )
    for record, one in zip(study.records, result.amplitudes, strict=True):
        parts = [
            f"F{a} {p:.4g} / {m:.4g}"
            for a, p, m in zip("xyz", one.predicted, one.measured, strict=True)
        ]
        lines.append(f"  {record.name}: {', '.join(parts)}")
    facts = {
        "kind": study.kind,
        "records": names,
        "tare": tare_facts(study.records),
        "feed_per_tooth_m": study.feed_per_tooth,
        "mean_force_N": result.force,
        "axes": used.axes,
        "force_on": study.settings.force_on,
        "proposed_axes": result.axes[0].axes,
        "coefficients_SI": fit.coefficients,
        "standard_errors_SI": fit.standard_errors,
        "correlation": fit.correlation,
        "identifiable": fit.identifiable,
        "r_squared": fit.r_squared,
        "relative_uncertainty": result.relative_uncertainty,
        "left_out_N": result.predicted,
        "amplitudes_N": [dataclasses.asdict(one) for one in result.amplitudes],
        "notes": study.notes,
        "diagnoses": diagnosis_facts(result.diagnoses),
    }
    figures = {
        "mean_forces": functools.partial(
            plot_mean_forces,
            study.feed_per_tooth,
            result.force,
            fit.slope,
            fit.offset,
            predicted=result.predicted,
        ),
        "correlation": functools.partial(
            plot_correlation, list(fit.coefficients), fit.correlation
        ),
    }
    doubts = []
    if fit.coefficients["K_tc"] <= 0:
        doubts = ["K_tc is not positive: axes or cut are wrong"]
    elif not any(fit.identifiable.values()):
        doubts = ["No coefficient is identifiable"]
    if any(record.is_saturated for record in study.records):
        doubts.append("Samples of a record are saturated")
    errors, known = fit.standard_errors, fit.identifiable
    return Report(
        lines,
        fitted_force_toml(result, doubts),
        facts,
        figures,
        coefficient_estimates(fit.coefficients, errors, known),
        _ASSUMED,
    )


def reading(study: MeanForceStudy) -> list[str]:
    """Mean forces and their records in words, line by line."""
    lines = [line for one in study.records for line in reading_lines(one)]
    lines.append(
        f"  mean forces at {len(study.feed_per_tooth)} feeds, "
        f"{range_text(study.feed_per_tooth, 'm')} per tooth"
    )
    lines += channel_lines(study.channels)
    if not study.channels:
        lines += [
            f"    mean F{axis}: {range_text(force, 'N')}"
            for axis, force in zip("xyz", study.mean_force.T, strict=True)
        ]
    return lines + note_lines(study.notes)


def _input_lines(study: MeanForceStudy) -> list[str]:
    """Feeds, cut and records of the means."""
    cut = study.cut
    width = "slot"
    low, high = 1e3 * study.feed_per_tooth.min(), 1e3 * study.feed_per_tooth.max()
    if cut.radial_depth is not None:
        width = f"{cut.side} milling, {cut.radial_depth * 1e3:g} mm wide"
    lines = [
        f"mean forces at {len(study.feed_per_tooth)} feeds, {low:g} to {high:g} mm "
        f"per tooth; {cut.cutter.flute_count} teeth, {cut.axial_depth * 1e3:g} mm "
        f"deep, {width}"
    ]
    lines += all_noted(study.notes)
    for record in study.records:
        lines += [f"{record.name}:", *tare_lines(record)]
        for note in record.notes:
            lines += noted(f"{record.name}: {note}")
        if record.is_saturated:
            lines += noted(
                f"{record.name}: samples are saturated, so that its mean force is too "
                "small; leave the record out or fit whole records.",
                "warning",
            )
    return lines


def _axes_lines(study: MeanForceStudy, result: MeanForceStudy.Fit) -> list[str]:
    """Axes of the fit, and others that suit the means; nothing is changed."""
    used = result.used
    settings = study.settings
    lines = used_axes_lines(used.axes, settings)
    lines += [f"  against them: {violation}" for violation in used.violations]
    best = result.axes[0]
    if not result.has_likely_axes:
        against = "; ".join(best.violations) or "nothing"
        lines += noted(
            f"The axes {axes_text(best.axes)} make more sense (against them: {against};"
            f" K_tc {best.fit.coefficients['K_tc'] * 1e-6:.4g}, K_rc "
            f"{best.fit.coefficients['K_rc'] * 1e-6:.4g}, K_ac "
            f"{best.fit.coefficients['K_ac'] * 1e-6:.4g} N/mm^2): "
            f"{force_on_text(best.axes, settings.force_on)}. Nothing was changed; give "
            '`axes` or `force_on` in [fit], or axes = "proposed".',
            "warning",
        )
    alike = [one for one in result.axes if one.score <= best.score and one is not best]
    if alike:
        names = ", ".join(axes_text(one.axes) for one in alike[:4])
        lines += noted(
            f"From mean forces alone {names} would make as much sense; whole records "
            "decide between them."
        )
    return lines


def _fit_lines(result: MeanForceStudy.Fit) -> list[str]:
    """Coefficients with their errors and doubts."""
    fit, force, left = result.fit, result.force, result.predicted
    lines = [
        "",
        *coefficient_lines(
            fit.coefficients, fit.coefficients, fit.standard_errors, fit.identifiable
        ),
        *noted(
            "The standard errors are those of the scatter about the lines: they "
            "include neither an offset, which goes into the coefficients of the edges, "
            f"nor {NOT_IN_ERRORS}."
        ),
        "the lines explain "
        + ", ".join(
            f"{share:.2%} of F{axis}"
            for axis, share in zip("xyz", fit.r_squared, strict=True)
        )
        + " over the feed",
    ]
    if len(force) == 2:
        lines += noted(
            "Two feeds make a line but no standard error: add a third, better five."
        )
    if len(force) > 2:
        from scipy.special import stdtrit

        # Student's t, both sides.
        most = float(stdtrit(len(force) - 2, 0.975))
        lines.append(
            f"95 % of true coefficients lie within {most:.1f} standard errors: "
            f"{len(force)} feeds leave {len(force) - 2} degrees of freedom"
        )
    if len(force) in (3, 4):
        lines += noted(
            f"Of {len(force)} feeds the standard errors are of the right size at best: "
            "points that lie on a line by chance make them tiny. Better are five."
        )
    lost = [name for name, known in fit.identifiable.items() if not known]
    if lost and len(force) > 2:
        lines += noted(
            f"{', '.join(lost)}: the standard error is large beside the mean forces; a "
            "wider range of feeds separates cutting and edge coefficients better, "
            "deeper cuts lift both over the noise."
        )
    good = np.isfinite(left).all(axis=1)
    if good.any():
        off = np.sqrt(np.mean((left - force)[good] ** 2, axis=0))
        size = np.sqrt(np.mean(force[good] ** 2, axis=0))
        parts = [
            f"F{a} {o / s:.1%}" if s > 0 else f"F{a} -"
            for a, o, s in zip("xyz", off, size, strict=True)
        ]
        lines.append(
            "left out: each feed predicted by the others, off by " + ", ".join(parts)
        )
    return lines + correlation_lines(list(fit.coefficients), fit.correlation)
