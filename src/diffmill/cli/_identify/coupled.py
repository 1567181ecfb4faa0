"""Parameters from a record of a robot's cut: report and figures."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ...cutting import AbstractForceLaw, KienzleLaw
from ...identification import CoupledStudy
from ...viz import plot_correlation, plot_force_fit
from .reading import channel_lines, note_lines
from .report import EstimatedValue, Report, all_noted, noted, uncertainty_remark
from .toml_snippets import doubted, force_toml, joints_toml

# Joints that `[robot.bending_tool]` and `[robot.flange_spring]` add to those of a job.
_ADDED = (
    "tool_x",
    "tool_y",
    *(f"flange_{r}{axis}" for r in ("", "r") for axis in "xyz"),
)
# Letter and unit of a figure, and the factor from SI.
_SHOWN = {"force": ("F", "N", 1.0), "deviation": ("d", "\u00b5m", 1e6)}
# Rows that a figure shows closely.
_ROWS = 60

_ASSUMED = (
    "The arm is that of the job but for the parameters that are fitted; what the job's "
    "model leaves out goes into them.",
    "The clock of the record runs as the job's, but for one shift.",
)


def report(study: CoupledStudy, fit: CoupledStudy.Fit) -> Report:
    """Report of parameters of arm and cut.

    Args:
        study: The record and its job.
        fit: Their fit.
    """
    facts = {
        "kind": study.kind,
        "parameters_SI": fit.parameters,
        "standard_errors_SI": fit.standard_errors,
        "identifiable": fit.identifiable,
        "names": fit.names,
        "correlation": fit.correlation,
        "explained": fit.explained,
        "residual_rms_SI": fit.residual_rms,
        "offset_m": fit.offset,
        "time_shift_s": fit.time_shift,
        "has_converged": fit.has_converged,
        "notes": [*study.notes, *fit.notes],
    }
    estimates = [
        EstimatedValue(
            name,
            fit.parameters[name] if fit.identifiable[name] else np.nan,
            fit.standard_errors[name],
            "SI",
            f"{factor:.3f} times the job's",
        )
        for name, factor in zip(fit.names, np.exp(fit.log_scale), strict=True)
    ]
    lines, figures = _lines(study, fit), _figures(study, fit)
    return Report(lines, _toml(study, fit), facts, figures, estimates, _ASSUMED)


def reading(study: CoupledStudy) -> list[str]:
    """Record in words, line by line."""
    first, last = float(study.time[0]), float(study.time[-1])
    return [
        f"  {len(study.time)} rows from {first:.4g} to {last:.4g} s on the clock "
        "of the job",
        *channel_lines(study.channels),
        *note_lines(study.notes),
    ]


def _lines(study: CoupledStudy, fit: CoupledStudy.Fit) -> list[str]:
    """Parameters with their errors and doubts."""
    lines = all_noted(study.notes)
    width = 2 + max(len(name) for name in fit.names)
    lines.append(f"{'parameter':{width}}{'value':>12}{'std. error':>12}{'given x':>10}")
    for name, factor in zip(fit.names, np.exp(fit.log_scale), strict=True):
        row = f"{'-':>12}{'-':>12}{factor:10.3f}   not identifiable"
        if fit.identifiable[name]:
            value, error = fit.parameters[name], fit.standard_errors[name]
            row = f"{value:12.5g}{error:12.2g}{factor:10.3f}"
        lines.append(f"{name:{width}}{row}")
    for what, share in fit.explained.items():
        lines.append(f"the fit explains {share:.2%} of the squared {what}")
    if not fit.has_converged:
        lines += noted("The iteration did not converge.", "warning")
    return lines + all_noted(fit.notes)


def _toml(study: CoupledStudy, fit: CoupledStudy.Fit) -> list[str]:
    """Tables for a job."""
    robot, lines = study.job.robot, []
    assert robot is not None
    relative, remarks, behind = {}, {}, []
    # The lists of `[robot]` do not have the joints that its springs add.
    pairs = zip(robot.joint_names, robot.is_virtual, strict=True)
    added_count = sum(is_free and name in _ADDED for name, is_free in pairs)
    joints = robot.joint_names[: robot.joint_count - added_count]
    for letter, key, word in (
        ("K", "joint_stiffness", "stiffness"),
        ("D", "joint_damping", "damping"),
    ):
        names = [f"{letter} {joint}" for joint in joints]
        added = [f"{letter} {joint}" for joint in robot.joint_names[len(joints) :]]
        behind += [name for name in added if fit.identifiable.get(name)]
        is_known = np.array([fit.identifiable.get(name, False) for name in names])
        if not is_known.any():
            continue
        joint_values = np.array([fit.parameters.get(name, np.nan) for name in names])
        joint_errors = np.array(
            [fit.standard_errors.get(name, np.nan) for name in names]
        )
        rows = joints_toml(robot, key, joint_values, joint_errors, is_known)
        # Both lists stand in one table.
        lines += rows[1:] if lines else rows
        relative[word] = float(
            np.max(joint_errors[is_known] / np.abs(joint_values[is_known]))
        )
        remarks[word] = uncertainty_remark(joints, is_known)
    if behind:
        lines.append(
            f"# {', '.join(behind)}: see summary.txt; they follow from the keys of "
            "[robot.bending_tool] and [robot.flange_spring]"
        )
    # A job states the coefficients of its law under these names.
    fields = [field.name for field in dataclasses.fields(study.job.law)]
    names = [name for name in fields if name.startswith(("K_", "m_"))]
    if fitted := [name for name in names if name in fit.parameters]:
        lines += ["", *_law_toml(study.job.law, fit, names)]
        shares = [
            fit.standard_errors[n] / abs(fit.parameters[n])
            for n in fitted
            # An exponent is no factor of the force.
            if fit.identifiable[n] and n.startswith("K_")
        ]
        relative |= {"force": max(shares)} if shares else {}
    if not fit.is_explained:
        return doubted(lines, "The record does not suit the job; see summary.txt.")
    if relative:
        lines += ["", "[correction.uncertainty]"]
        for word, value in relative.items():
            remark = remarks.get(word)
            lines += [] if remark is None else [f"# {remark}"]
            lines.append(f"{word} = {value:.2g}")
        lines += ["gaussian = true"]
    return lines or ["# Nothing is identifiable; see summary.txt."]


def _law_toml(
    law: AbstractForceLaw, fit: CoupledStudy.Fit, names: list[str]
) -> list[str]:
    """Lines of `[force]`; coefficients that were not fitted are those of the job."""
    fitted = [name for name in names if name in fit.parameters]
    given = {n: float(np.mean(getattr(law, n))) for n in names if n not in fitted}
    values = {n: given[n] if n in given else fit.parameters[n] for n in names}
    errors = {n: fit.standard_errors[n] for n in fitted}
    known = {n: n in given or fit.identifiable[n] for n in names}
    head, *rows = force_toml(values, errors, known)
    if not isinstance(law, KienzleLaw):
        return [head, *rows]
    thicknesses = [
        f'{name} = "{1e3 * float(getattr(law, name)):.6g} mm"'
        for name in ("reference_thickness", "least_thickness")
    ]
    return [head, 'law = "kienzle"', *rows, *thicknesses]


def _figures(
    study: CoupledStudy, fit: CoupledStudy.Fit
) -> dict[str, Callable[[], Any]]:
    """Functions that draw the figures."""
    turn = float(study.job.tooth_period) * study.job.cutter.flute_count
    spacing = float(np.median(np.diff(study.time)))
    figures: dict[str, Callable[[], Any]] = {
        "correlation": functools.partial(
            plot_correlation, fit.names, np.asarray(fit.correlation)
        )
    }
    for name, measured in study.compared.items():
        letter, unit, scale = _SHOWN[name]
        figures[name] = functools.partial(
            plot_force_fit,
            study.time + fit.time_shift,
            scale * measured,
            scale * (measured - fit.residual[name]),
            revolution=turn,
            title=f"{name}: {fit.explained[name]:.1%} of its square explained",
            turns=max(4.0, _ROWS * spacing / turn),
            what=letter,
            unit=unit,
        )
    return figures
