"""Parameters from a record of a robot's cut: what is said of them, and figures."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ...cutting import LinearEdgeLaw
from ...identification import CoupledStudy
from ...viz import plot_correlation, plot_force_fit
from .report import Report, all_noted, noted
from .text import kept_remark
from .toml_snippets import doubted, force_toml, joints_toml

_NAMES = LinearEdgeLaw.NAMES
# Letter and unit of a figure, and the factor from SI.
_SHOWN = {"force": ("F", "N", 1.0), "deviation": ("d", "\u00b5m", 1e6)}
# Rows that a figure shows closely.
_ROWS = 60


def report_coupled(study: CoupledStudy, fit: CoupledStudy.Fit) -> Report:
    """Return the report of parameters of arm and cut.

    Args:
        study: The record and its job.
        fit: Their fit.
    """
    facts = {
        "kind": "coupled",
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
    return Report(_lines(study, fit), _toml(study, fit), facts, _figures(study, fit))


def _lines(study: CoupledStudy, fit: CoupledStudy.Fit) -> list[str]:
    """Return parameters and how far to trust them."""
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
    """Return the tables for a job."""
    robot, lines = study.job.robot, []
    assert robot is not None
    relative, remarks = {}, {}
    for letter, key, word in (
        ("K", "joint_stiffness", "stiffness"),
        ("D", "joint_damping", "damping"),
    ):
        names = [f"{letter} {joint}" for joint in robot.joint_names]
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
        remarks[word] = kept_remark(robot.joint_names, is_known)
    fitted = [name for name in _NAMES if name in fit.parameters]
    if fitted:
        # A table holds all six: what was not fitted was taken as known.
        law = study.job.law
        given = {n: float(np.mean(getattr(law, n))) for n in _NAMES if n not in fitted}
        values = {n: given[n] if n in given else fit.parameters[n] for n in _NAMES}
        errors = {n: fit.standard_errors[n] for n in fitted}
        known = {n: n in given or fit.identifiable[n] for n in _NAMES}
        lines += ["", *force_toml(values, errors, known)]
        shares = [
            fit.standard_errors[n] / abs(fit.parameters[n])
            for n in fitted
            if fit.identifiable[n]
        ]
        relative |= {"force": max(shares)} if shares else {}
    if not fit.is_explained:
        return doubted(lines, "The record does not suit the job; see summary.txt.")
    if relative:
        lines += ["", "[correction.uncertainty]"]
        for word, value in relative.items():
            remark = remarks.get(word)
            lines += [] if remark is None else [f"# {remark}"]
            lines.append(f"{word} = {value:.3g}")
        lines += ["gaussian = true"]
    return lines or ["# Nothing is identifiable; see summary.txt."]


def _figures(
    study: CoupledStudy, fit: CoupledStudy.Fit
) -> dict[str, Callable[[], Any]]:
    """Return what draws the figures."""
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
            measured,
            measured - fit.residual[name],
            revolution=turn,
            title=f"{name}: {fit.explained[name]:.1%} of its square explained",
            turns=max(4.0, _ROWS * spacing / turn),
            what=letter,
            unit=unit,
            scale=scale,
        )
    return figures
