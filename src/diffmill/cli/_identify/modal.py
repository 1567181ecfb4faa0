"""Modes and the joints' damping from modes: what is said of them, and figures."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ...identification import (
    FrequencyResponse,
    ModeStudy,
    RingDown,
)
from ...viz import (
    plot_correlation,
    plot_frequency_response,
    plot_joint_values,
    plot_ring_down,
)
from .digits import Rounded
from .report import Report, all_noted, noted
from .text import uncertainty_remark
from .toml_snippets import commented, doubted, joints_toml, uncertainty_toml

# Modes that explain a smaller share of what was measured are doubted.
_LITTLE = 0.9
_UNITS = {
    "receptance": "displacement over force [m/N]",
    "mobility": "velocity over force [m/(N s)]",
    "accelerance": "acceleration over force [1/kg]",
}


def report_modes(study: ModeStudy, found: ModeStudy.Fit) -> Report:
    """Return the report of modes, and of the joints' dampers.

    Args:
        study: The measurements.
        found: Their fit.
    """
    is_ring = isinstance(study.measured[0], RingDown)
    lines: list[str] = []
    for one, fit, faults in zip(study.measured, found.modes, found.faults, strict=True):
        lines += _mode_lines(one, fit, is_ring)
        lines += all_noted(_fault_texts(faults), "warning")
    lines += _match_lines(study, found)
    facts: dict[str, Any] = {
        "kind": "ring_down" if is_ring else "frequency_response",
        "measured": [
            {"name": one.name, **_mode_facts(fit), **faults._asdict()}
            for one, fit, faults in zip(
                study.measured, found.modes, found.faults, strict=True
            )
        ],
    }
    damping, robot = found.damping, study.robot
    if damping is not None and robot is not None:
        lines += _damper_lines(study, found)
        facts["joints"] = list(robot.joint_names)
        facts["damping_SI"] = damping.damping
        facts["damping_errors_SI"] = damping.standard_errors
        facts["identifiable"] = damping.identifiable
    return Report(lines, _toml(study, found), facts, _figures(study, found))


def _toml(study: ModeStudy, found: ModeStudy.Fit) -> list[str]:
    """Return the tables for a job."""
    damping, robot = found.damping, study.robot
    machine = _machine_toml(study, found)
    if machine:
        return machine
    if damping is None or robot is None:
        return [
            "# Modes only: give [robot] and joint_positions for the joints' dampers."
        ]
    known = damping.identifiable
    if not known.any():
        return ["# No joint's damper is identifiable; see summary.txt."]
    values, errors = damping.damping, damping.standard_errors
    share = float(np.max(errors[known] / values[known]))
    remark = uncertainty_remark(robot.joint_names, known)
    lines = [
        *joints_toml(robot, "joint_damping", values, errors, known),
        *uncertainty_toml("damping", share, remark),
    ]
    for one, fit in zip(study.measured, found.modes, strict=True):
        if fit.explained < _LITTLE:
            return doubted(lines, _too_little(one))
    return lines


def _machine_toml(study: ModeStudy, found: ModeStudy.Fit) -> list[str]:
    """Return the modes of a machine, of what was measured at its tool tip."""
    return [
        line
        for one, fit, faults in zip(
            study.measured, found.modes, found.faults, strict=True
        )
        if isinstance(one, FrequencyResponse) and one.direction is not None
        for line in _mode_tables(one, fit, faults)
    ]


def _mode_tables(one: FrequencyResponse, fit: Any, faults: Any) -> list[str]:
    """Return the modes of one direction as tables of a job."""
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
    if any(faults):
        return doubted(lines, f"{one.name}: a wrong sign; see summary.txt.")
    return doubted(lines, _too_little(one)) if fit.explained < _LITTLE else lines


def _fault_texts(faults: Any) -> list[str]:
    """Return what signs of a response no structure has, in words."""
    texts = []
    if faults.is_conjugate:
        texts.append(
            "The phase has the wrong sign, as of a file that holds the complex "
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


def _too_little(one: FrequencyResponse | RingDown) -> str:
    return f"{one.name}: the modes explain too little of it; see summary.txt."


def _mode_facts(fit: Any) -> dict[str, Any]:
    facts = {
        "frequencies_Hz": fit.frequencies,
        "frequency_errors_Hz": fit.frequency_errors,
        "damping_ratios": fit.damping_ratios,
        "damping_errors": fit.damping_errors,
        "identifiable": fit.identifiable,
        "is_structural": fit.is_structural,
        "explained": fit.explained,
    }
    if hasattr(fit, "stiffness"):
        facts["modal_stiffness_N_per_m"] = fit.stiffness
        facts["modal_stiffness_errors_N_per_m"] = fit.stiffness_errors
    return facts


def _mode_lines(one: Any, fit: Any, is_ring: bool) -> list[str]:
    """Return the modes of one measurement."""
    lines = [f"{one.name}: the modes explain {fit.explained:.2%} of the signal"]
    lines += all_noted(one.notes)
    head = f"  {'frequency':>12}{'std. error':>12}{'damping':>10}{'std. error':>12}"
    lines.append(head + ("" if is_ring else f"{'modal stiffness':>18}"))
    for k in range(len(fit.frequencies)):
        row = (
            f"  {fit.frequencies[k]:9.4g} Hz{fit.frequency_errors[k]:9.2g} Hz"
            f"{100 * fit.damping_ratios[k]:8.3g} %{100 * fit.damping_errors[k]:10.2g} %"
        )
        if not is_ring:
            row += (
                f"{fit.stiffness[k] * 1e-6:9.4g} +- "
                f"{fit.stiffness_errors[k] * 1e-6:.2g} N/um"
            )
        if not fit.is_structural[k]:
            row += "   no mode: no structure is damped so much"
        elif not fit.identifiable[k]:
            row += "   not identifiable"
        lines.append(row)
    if fit.explained < _LITTLE:
        lines += noted(
            "That is little: more modes, another band, or a later start may be needed.",
            "warning",
        )
    return lines


def _match_lines(study: ModeStudy, found: ModeStudy.Fit) -> list[str]:
    """Return which measured mode is taken for which of the model's."""
    lines = []
    for one in found.matches:
        lines.append(
            f"  {study.measured[one.measurement].name}: {one.frequency:.4g} Hz is "
            f"taken for mode {one.mode + 1} of the model, {one.own:.4g} Hz "
            f"({one.frequency / one.own - 1:+.0%})"
        )
        if one.is_far:
            lines += noted(
                "That is far: the mode is left out; correct the stiffness first.",
                "warning",
            )
        elif one.is_taken:
            lines += noted(
                f"Mode {one.mode + 1} is taken already: the second was left out.",
                "warning",
            )
    has_poses = any(one.q is not None for one in study.measured)
    if found.damping is None and study.robot is not None and has_poses:
        lines.append("no measured mode belongs to the model")
    return lines


def _damper_lines(study: ModeStudy, found: ModeStudy.Fit) -> list[str]:
    """Return the joints' dampers, and how far to trust them."""
    fit = found.damping
    assert fit is not None and study.robot is not None
    lines = ["", "joint dampers [N m s/rad, N s/m]:"]
    for i, name in enumerate(study.robot.joint_names):
        text = "not identifiable"
        if fit.identifiable[i]:
            text = f"{fit.damping[i]:.4g} +- {fit.standard_errors[i]:.2g}"
        lines.append(f"  {name}: {text}")
    posed = [one for one in study.measured if one.q is not None]
    for pose, mode in fit.outliers:
        lines += noted(
            f"Mode {mode + 1} of {posed[pose].name} contradicts the others and was "
            "left out.",
            "warning",
        )
    if not fit.identifiable.all():
        lines += noted(
            "Ring-downs in further poses, and of higher modes, show further joints."
        )
    return lines


def _figures(study: ModeStudy, found: ModeStudy.Fit) -> dict[str, Callable[[], Any]]:
    """Return what draws the figures."""
    draw = functools.partial
    figures: dict[str, Callable[[], Any]] = {}
    for i, (one, fit) in enumerate(zip(study.measured, found.modes, strict=True), 1):
        number = f"_{i}" if len(found.modes) > 1 else ""
        modes = range(1, len(fit.frequencies) + 1)
        names = [f"{what} {k}" for what in ("f", "zeta") for k in modes]
        figures[f"correlation{number}"] = draw(plot_correlation, names, fit.correlation)
        if isinstance(one, RingDown):
            figures[f"ring_down{number}"] = draw(
                plot_ring_down, one.time, one.signal, fit.fitted, title=one.name
            )
            continue
        figures[f"frequency_response{number}"] = draw(
            plot_frequency_response,
            one.frequency,
            one.response,
            one.frequency[one.is_fitted],
            fit.fitted,
            unit=_UNITS[one.quantity],
            modes=fit.frequencies,
            title=one.name,
        )
    damping, robot = found.damping, study.robot
    if damping is not None and robot is not None:
        figures["damping"] = draw(
            plot_joint_values,
            robot.joint_names,
            damping.damping,
            damping.standard_errors,
            np.asarray(robot.joint_damping, np.float64),
            unit="damping [N m s/rad, N s/m]",
        )
        figures["damping_correlation"] = draw(
            plot_correlation, robot.joint_names, damping.correlation
        )
    return figures
