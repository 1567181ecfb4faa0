"""Stiffness, damping and force coefficients from one record of a robot's cut."""

import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from .._session.errors import BadInput
from .._session.progress import Progress
from .outcome import Outcome
from .text import kept_remark, noted

if TYPE_CHECKING:
    from ...config import CoupledTask
    from ...identification import CoupledFit

# Letter and unit of a figure, and the factor from SI.
_SHOWN = {"force": ("F", "N", 1.0), "deviation": ("d", "\u00b5m", 1e6)}
# Rows that a figure shows closely.
_ROWS = 60


def identify_coupled(task: "CoupledTask", progress: Progress) -> Outcome:
    """Fit parameters of arm and cut to a record of a cut.

    Args:
        task: The record and its job.
        progress: Told what is being done.
    """
    from ...identification import fit_coupled, mean_over_period

    force, period = task.force, float(task.job.tooth_period)
    if force is not None and float(np.median(np.diff(task.time))) < 0.9 * period:
        # The simulated force is a mean over the tooth period.
        force = mean_over_period(task.time, force, period)
    progress.update("arm and cut")
    try:
        fit = fit_coupled(
            task.job,
            force=force,
            deviation=task.deviation,
            time=task.time,
            fit=task.fit,
            has_offset=task.has_offset,
            has_time_shift=task.has_time_shift,
            loss=task.loss,  # pyright: ignore[reportArgumentType]
        )
    except ValueError as error:
        raise BadInput(f"{task.name}: {error}") from error
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
        "notes": [*task.notes, *fit.notes],
    }
    return Outcome(
        _lines(task, fit),
        _toml(task, fit),
        facts,
        lambda folder: _draw(
            folder, task, fit, {"force": force, "deviation": task.deviation}
        ),
    )


def _lines(task: "CoupledTask", fit: "CoupledFit") -> list[str]:
    """Return parameters and how far to trust them."""
    lines = []
    for note in task.notes:
        lines += noted(note)
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
    for note in fit.notes:
        lines += noted(note)
    return lines


def _toml(task: "CoupledTask", fit: "CoupledFit") -> list[str]:
    """Return the tables for a job."""
    from ...config import doubted, force_toml, joints_toml
    from ...identification import NAMES

    robot, lines = task.job.robot, []
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
    fitted = [name for name in NAMES if name in fit.parameters]
    if fitted:
        # A table holds all six: what was not fitted was taken as known.
        law = task.job.law
        given = {n: float(np.mean(getattr(law, n))) for n in NAMES if n not in fitted}
        values = {n: given[n] if n in given else fit.parameters[n] for n in NAMES}
        errors = {n: fit.standard_errors[n] for n in fitted}
        known = {n: n in given or fit.identifiable[n] for n in NAMES}
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


def _draw(
    folder: pathlib.Path,
    task: "CoupledTask",
    fit: "CoupledFit",
    measured: dict[str, Any],
) -> None:
    """Write the figures."""
    from ...viz import plot_correlation, plot_force_fit, save_figure

    turn = float(task.job.tooth_period) * task.job.cutter.flute_count
    spacing = float(np.median(np.diff(task.time)))
    for name, left in fit.residual.items():
        letter, unit, scale = _SHOWN[name]
        figure = plot_force_fit(
            task.time + fit.time_shift,
            measured[name],
            measured[name] - left,
            revolution=turn,
            title=f"{name}: {fit.explained[name]:.1%} of its square explained",
            turns=max(4.0, _ROWS * spacing / turn),
            what=letter,
            unit=unit,
            scale=scale,
        )
        save_figure(figure, folder / f"{name}.png")
    values: Any = np.asarray(fit.correlation)
    save_figure(plot_correlation(fit.names, values), folder / "correlation.png")
