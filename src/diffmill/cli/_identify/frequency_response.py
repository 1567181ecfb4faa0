"""Modes from frequency responses: report and figures."""

import functools
from typing import Any

from ...identification import FrequencyResponse, ModeStudy
from ...viz import plot_frequency_response
from .modes import (
    LEAST_EXPLAINED,
    MeasuredModes,
    mode_facts,
    mode_lines,
    modes_report,
    too_little,
    vibration_reading,
)
from .report import Report, all_noted
from .rounded import Rounded
from .toml_snippets import commented, doubted

_UNITS = {
    "receptance": "displacement over force [m/N]",
    "mobility": "velocity over force [m/(N s)]",
    "accelerance": "acceleration over force [1/kg]",
}


def report(study: ModeStudy, result: ModeStudy.Fit) -> Report:
    """Report of the modes of frequency responses.

    Args:
        study: The responses.
        result: Their fit.
    """
    parts = []
    # All of them are of this kind.
    triples: Any = zip(study.measured, result.modes, result.faults, strict=True)
    for one, fit, faults in triples:
        texts = _fault_texts(faults)
        stiffness = [
            f"{value * 1e-6:9.4g} +- {error * 1e-6:.2g} N/um"
            for value, error in zip(fit.stiffness, fit.stiffness_errors, strict=True)
        ]
        facts = {
            **mode_facts(fit),
            "modal_stiffness_N_per_m": fit.stiffness,
            "modal_stiffness_errors_N_per_m": fit.stiffness_errors,
        }
        draw = functools.partial(
            plot_frequency_response,
            one.frequency,
            one.response,
            one.frequency[one.is_fitted],
            fit.fitted,
            unit=_UNITS[one.quantity],
            modes=fit.frequencies,
            title=one.name,
        )
        lines = [*mode_lines(one, fit, stiffness), *all_noted(texts, "warning")]
        machine = []
        if one.direction is not None:
            machine = _mode_tables(one, fit, has_faults=bool(texts))
        parts.append(MeasuredModes(lines, facts, draw, machine))
    return modes_report(study, result, parts)


def reading(study: ModeStudy) -> list[str]:
    """Frequency responses in words, line by line."""
    lines: list[str] = []
    responses: Any = study.measured
    for one in responses:
        low, high = one.frequency[[0, -1]].tolist()
        head = (
            f"{one.quantity}, {len(one.frequency)} lines from {low:.4g} to {high:.4g} "
            f"Hz, {int(one.is_fitted.sum())} of them fitted"
        )
        lines += vibration_reading(head, one)
    return lines


def _mode_tables(
    one: FrequencyResponse, fit: FrequencyResponse.Fit, *, has_faults: bool
) -> list[str]:
    """Modes of one direction as tables of a job."""
    lines = []
    # At the point that is struck every mode moves with the force.
    known = fit.identifiable & fit.is_structural & (fit.stiffness > 0)
    for k, is_known in enumerate(known):
        if not is_known:
            lines.append(f"# {one.name}: {fit.frequencies[k]:.4g} Hz is not known")
            continue
        frequency = Rounded.of(fit.frequencies[k], fit.frequency_errors[k])
        damping = Rounded.of(fit.damping_ratios[k], fit.damping_errors[k])
        stiffness = Rounded.of(fit.stiffness[k], fit.stiffness_errors[k])
        lines += [
            "[[machine.modes]]",
            commented(f'frequency = "{frequency.value} Hz"', f"+- {frequency.error}"),
            commented(f"damping_ratio = {damping.value}", f"+- {damping.error}"),
            f"direction = {one.direction}",
            commented(f'stiffness = "{stiffness.value} N/m"', f"+- {stiffness.error}"),
        ]
    if has_faults:
        return doubted(lines, f"{one.name}: a wrong sign; see summary.txt.")
    return doubted(lines, too_little(one)) if fit.explained < LEAST_EXPLAINED else lines


def _fault_texts(faults: FrequencyResponse.Faults) -> list[str]:
    """Signs of a response that no structure has, in words."""
    texts = []
    if faults.is_conjugate:
        texts.append(
            "The phase has the wrong sign, as of a file that has the complex "
            "conjugate or a phase lag: with the sign of the imaginary part (or of the "
            "phase) reversed the modes explain it. Nothing was changed."
        )
    if faults.is_reversed:
        texts.append(
            "The response has the wrong sign: the point moves against the force on it. "
            "Hammer and sensor point in opposite directions, or a channel is reversed. "
            "Nothing was changed."
        )
    return texts
