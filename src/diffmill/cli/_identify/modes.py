"""Modes and the joints' damping from modes, in words: shared by its two kinds."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...identification import FrequencyResponse, ModeStudy, RingDown
from ...viz import plot_correlation, plot_joint_values
from .reading import channel_lines, note_lines
from .report import EstimatedValue, Report, all_noted, noted, uncertainty_remark
from .toml_snippets import doubted, joints_toml, uncertainty_toml

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Modes that explain a smaller share of what was measured are doubted.
LEAST_EXPLAINED = 0.9
_ASSUMED = (
    "The structure is linear: the frequencies do not change with the size of the "
    "vibration, and the damping is viscous.",
    "The robot stands still and its servos are on as in the cut.",
)


@dataclasses.dataclass(frozen=True)
class MeasuredModes:
    """Report of a measurement and its modes.

    Attributes:
        lines: Summary for the terminal.
        facts: Numbers for `identified.json`.
        draw: Draws the measurement and its fit.
        machine: Tables of the modes of a machine; none if it was not measured at the
            tool tip.
    """

    lines: list[str]
    facts: dict[str, object]
    draw: "Callable[[], Figure]"
    machine: Sequence[str] = ()


def modes_report(
    study: ModeStudy, result: ModeStudy.Fit, parts: Sequence[MeasuredModes]
) -> Report:
    """Report of modes, and of the joints' dampers.

    Args:
        study: The measurements.
        result: Their fit.
        parts: Reports of the single measurements.
    """
    lines = [line for part in parts for line in part.lines]
    lines += _match_lines(study, result)
    facts: dict[str, object] = {
        "kind": study.kind,
        "measured": [
            {"name": one.name, **part.facts, **dataclasses.asdict(faults)}
            for one, part, faults in zip(
                study.measured, parts, result.faults, strict=True
            )
        ],
    }
    figures: dict[str, Callable[[], Figure]] = {}
    for i, (fit, part) in enumerate(zip(result.modes, parts, strict=True), 1):
        number = f"_{i}" if len(parts) > 1 else ""
        modes = range(1, len(fit.frequencies) + 1)
        names = [f"{what} {k}" for what in ("f", "zeta") for k in modes]
        figures[f"correlation{number}"] = functools.partial(
            plot_correlation, names, fit.correlation
        )
        figures[f"{study.kind}{number}"] = part.draw
    damping, robot = result.damping, study.robot
    if damping is not None and robot is not None:
        lines += _damper_lines(study, result)
        facts["joints"] = list(robot.joint_names)
        facts["damping_SI"] = damping.damping
        facts["damping_errors_SI"] = damping.standard_errors
        facts["identifiable"] = damping.identifiable
        figures["damping"] = functools.partial(
            plot_joint_values,
            robot.joint_names,
            damping.damping,
            damping.standard_errors,
            np.asarray(robot.joint_damping, np.float64),
            unit="damping [N m s/rad, N s/m]",
        )
        figures["damping_correlation"] = functools.partial(
            plot_correlation, robot.joint_names, damping.correlation
        )
    machine = [line for part in parts for line in part.machine]
    toml = machine or _damper_toml(study, result)
    return Report(lines, toml, facts, figures, _estimates(study, result), _ASSUMED)


def _estimates(study: ModeStudy, result: ModeStudy.Fit) -> list[EstimatedValue]:
    """Frequencies and damping of the modes, and the joints' dampers."""
    estimates = []
    for one, fit in zip(study.measured, result.modes, strict=True):
        for k, is_known in enumerate(fit.identifiable & fit.is_structural):
            for what, values, errors, scale, unit in (
                ("frequency", fit.frequencies, fit.frequency_errors, 1.0, "Hz"),
                ("damping", fit.damping_ratios, fit.damping_errors, 100.0, "%"),
            ):
                value = scale * float(values[k]) if is_known else np.nan
                error = scale * float(errors[k])
                name = f"{one.name}, {what} {k + 1}"
                estimates.append(EstimatedValue(name, value, error, unit))
    damping, robot = result.damping, study.robot
    if damping is not None and robot is not None:
        for i, name in enumerate(robot.joint_names):
            value = float(damping.damping[i]) if damping.identifiable[i] else np.nan
            unit = "N s/m" if robot.joint_kinds[i] == "prismatic" else "N m s/rad"
            error = float(damping.standard_errors[i])
            estimates.append(EstimatedValue(f"damper of {name}", value, error, unit))
    return estimates


def vibration_reading(head: str, one: RingDown | FrequencyResponse) -> list[str]:
    """Measurement in words, line by line.

    Args:
        head: Its size and range.
        one: The measurement.
    """
    return [
        f"  {one.name}: {head}, modes sought: {one.mode_count}",
        *channel_lines(one.channels),
        *note_lines(one.notes, 4),
    ]


def _damper_toml(study: ModeStudy, result: ModeStudy.Fit) -> list[str]:
    """Tables of the joints' dampers for a job."""
    damping, robot = result.damping, study.robot
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
    for one, fit in zip(study.measured, result.modes, strict=True):
        if fit.explained < LEAST_EXPLAINED:
            return doubted(lines, too_little(one))
    return lines


def too_little(one: FrequencyResponse | RingDown) -> str:
    """Reason to doubt the modes of a measurement that they hardly explain."""
    return f"{one.name}: the modes explain too little of it; see summary.txt."


def mode_facts(fit: RingDown.Fit | FrequencyResponse.Fit) -> dict[str, object]:
    """Numbers of a measurement's modes for `identified.json`."""
    return {
        "frequencies_Hz": fit.frequencies,
        "frequency_errors_Hz": fit.frequency_errors,
        "damping_ratios": fit.damping_ratios,
        "damping_errors": fit.damping_errors,
        "identifiable": fit.identifiable,
        "is_structural": fit.is_structural,
        "explained": fit.explained,
    }


def mode_lines(
    one: RingDown | FrequencyResponse,
    fit: RingDown.Fit | FrequencyResponse.Fit,
    stiffness: Sequence[str] = (),
) -> list[str]:
    """Table of the modes of one measurement.

    Args:
        one: The measurement.
        fit: Its modes.
        stiffness: Stiffness of each mode, in words; none if it is not known.
    """
    lines = [f"{one.name}: the modes explain {fit.explained:.2%} of the signal"]
    lines += all_noted(one.notes)
    head = f"  {'frequency':>12}{'std. error':>12}{'damping':>10}{'std. error':>12}"
    lines.append(head + (f"{'modal stiffness':>18}" if stiffness else ""))
    for k in range(len(fit.frequencies)):
        row = (
            f"  {fit.frequencies[k]:9.4g} Hz{fit.frequency_errors[k]:9.2g} Hz"
            f"{100 * fit.damping_ratios[k]:8.3g} %{100 * fit.damping_errors[k]:10.2g} %"
        )
        row += stiffness[k] if stiffness else ""
        if not fit.is_structural[k]:
            row += "   no mode: no structure is damped so much"
        elif not fit.identifiable[k]:
            row += "   not identifiable"
        lines.append(row)
    if fit.explained < LEAST_EXPLAINED:
        lines += noted(
            "That is little: more modes, another band, or a later start may be needed.",
            "warning",
        )
    return lines


def _match_lines(study: ModeStudy, result: ModeStudy.Fit) -> list[str]:
    """Measured modes beside those of the model."""
    lines = []
    for one in result.matches:
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
    if result.damping is None and study.robot is not None and has_poses:
        lines.append("no measured mode belongs to the model")
    return lines


def _damper_lines(study: ModeStudy, result: ModeStudy.Fit) -> list[str]:
    """Dampers of the joints with their errors and doubts."""
    fit = result.damping
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
