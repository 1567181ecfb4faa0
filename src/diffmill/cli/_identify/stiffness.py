"""Joint stiffness from load tests, with its figures."""

import pathlib
from typing import TYPE_CHECKING

import numpy as np

from .._session.progress import Progress
from .outcome import Outcome
from .text import kept_remark, noted

if TYPE_CHECKING:
    from ...config import LoadTestTask
    from ...identification import JointStiffnessFit, LoadCheck

# All springs this many times stiffer or softer than the model's: a unit is wrong.
_OTHER_UNIT = 30.0


def identify_stiffness(task: "LoadTestTask", progress: Progress) -> Outcome:
    """Fit joint stiffness to load tests.

    Args:
        task: The tests.
        progress: Told what is being done.
    """
    from ...config import doubted, joints_toml, uncertainty_toml
    from ...identification import check_load_tests, fit_joint_stiffness

    progress.update("joint stiffness")
    table = (task.robot, task.q, task.wrench, task.displacement)
    fit = fit_joint_stiffness(
        *table, has_offset=task.has_offset, noise=task.noise, frames=task.frames
    )
    check = check_load_tests(task.robot, fit, *table[1:])
    advice = _advice(task, fit)
    doubt = _unit_doubt(task, fit)
    lines = [*_stiffness_lines(task, fit, check), *advice]
    if doubt is not None:
        lines += noted(doubt, "warning")
    why = "the table does not suit the robot"
    if fit.is_consistent:
        why = "these loads do not show any joint well enough"
    toml = [f"# No stiffness: {why}; see summary.txt."]
    if fit.identifiable.any():
        parts = (fit.stiffness, fit.standard_errors, fit.identifiable)
        toml = joints_toml(task.robot, "joint_stiffness", *parts)
        known = fit.identifiable
        # An equal error of all joints that makes the displacement as uncertain.
        part = fit.share[known]
        off = fit.standard_errors[known] / fit.stiffness[known]
        share = float(np.linalg.norm(part * off) / np.linalg.norm(part))
        remark = kept_remark(fit.joint_names, known)
        toml += uncertainty_toml("stiffness", share, remark)
    if doubt is not None:
        toml = doubted(toml, "A unit of the table may be wrong; see summary.txt.")
    facts = {
        "kind": "load_tests",
        "joints": list(fit.joint_names),
        "stiffness_SI": fit.stiffness,
        "standard_errors_SI": fit.standard_errors,
        "stiffness_at_least_SI": fit.stiffness_bound,
        "stiffness_interval_SI": fit.stiffness_interval,
        "identifiable": fit.identifiable,
        "is_consistent": fit.is_consistent,
        "explained": fit.explained,
        "share": fit.share,
        "outlier_rows": [task.rows[i] for i in fit.outliers],
        "left_out_error": check.error,
        "noise": fit.noise,
        "spread_m": fit.spread,
        "notes": [*task.notes, *fit.notes, *([doubt] if doubt else [])],
    }
    return Outcome(
        lines, toml, facts, lambda folder: _draw_stiffness(folder, task, fit, check)
    )


def _unit_doubt(task: "LoadTestTask", fit: "JointStiffnessFit") -> str | None:
    """Return why the units of the table are doubted, None if they are not."""
    model = np.asarray(task.robot.joint_stiffness, np.float64)
    known = fit.identifiable & np.isfinite(model) & (model > 0)
    if not known.any():
        return None
    times = fit.stiffness[known] / model[known]
    if times.min() <= _OTHER_UNIT and times.max() >= 1 / _OTHER_UNIT:
        return None
    usual = np.exp(np.mean(np.log(times)))
    return (
        f"All joints that are known have about {usual:.2g} times the model's stiffness:"
        " look at the units of load and displacement, and at the model."
    )


def _stiffness_lines(
    task: "LoadTestTask", fit: "JointStiffnessFit", check: "LoadCheck"
) -> list[str]:
    """Return springs and how far to trust them."""
    robot = task.robot
    lines = [f"{len(task.rows)} load tests of {robot.name}"]
    for note in task.notes:
        lines += noted(note)
    width = 2 + max(len(name) for name in fit.joint_names)
    lines += [
        "",
        f"{'joint':{width}}{'stiffness':>12}{'std. error':>12}{'of the model':>14}"
        f"{'share':>8}  unit",
    ]
    model = np.asarray(robot.joint_stiffness, np.float64)
    for i, name in enumerate(fit.joint_names):
        unit = "N/m" if robot.joint_kinds[i] == "prismatic" else "N m/rad"
        known = f"{model[i]:14.4g}" if np.isfinite(model[i]) else f"{'-':>14}"
        part = f"{known}{fit.share[i]:8.1%}  {unit}"
        if fit.identifiable[i]:
            number = f"{fit.stiffness[i]:12.4g}{fit.standard_errors[i]:12.2g}"
            least, most = fit.stiffness_interval[i]
            rough = f"   95 %: {least:.3g} to {most:.3g}" if fit.is_rough[i] else ""
            lines.append(f"{name:{width}}{number}{part}{rough}")
            continue
        least = fit.stiffness_bound[i]
        more = f", at least {least:.3g}" if least > 0 else ""
        lines.append(f"{name:{width}}{'-':>12}{'-':>12}{part}   not identifiable{more}")
    lines.append(
        f"the springs explain {max(fit.explained, 0):.2%} of the squared displacement; "
        f"one displacement scatters by {fit.spread * 1e6:.3g} um ({fit.noise})"
    )
    if fit.offset is not None:
        size = ", ".join(f"{1e6 * value:.3g}" for value in fit.offset[:3])
        lines.append(f"constant displacement: ({size}) um")
    if fit.outliers:
        rows = ", ".join(str(task.rows[i]) for i in fit.outliers)
        lines += noted(
            f"Rows {rows} of the table contradict the others"
            + (" and were left out." if fit.is_consistent else "."),
            "warning",
        )
    lines.append(
        f"left out: {_part(task)} predicted by the others, {check.error:.1%} of the "
        "displacement rms off"
    )
    for note in fit.notes:
        if "contradict the others and were left out" in note:
            # Said above with the numbers of the rows in the file.
            continue
        lines += noted(note, "note" if fit.is_consistent else "warning")
    return lines


def _part(task: "LoadTestTask") -> str:
    return "each row" if len(task.rows) <= 5 else "each fifth of the rows"


def _advice(task: "LoadTestTask", fit: "JointStiffnessFit") -> list[str]:
    """Return load tests that would show what the table does not."""
    from ...identification import suggest_load_tests

    if not fit.is_rough.any() or not fit.is_consistent:
        return []
    robot = task.robot
    model = np.asarray(robot.joint_stiffness)
    if np.isinf(model[~fit.identifiable]).any():
        return noted(
            "Further tests can be proposed once the model has a rough stiffness for "
            "every joint (joint_stiffness in [robot])."
        )
    tests = suggest_load_tests(robot, fit, task.q, task.wrench)
    lines = ["load tests that would help most:"]
    for q, wrench in zip(tests.q, tests.wrench, strict=True):
        pose = ", ".join(
            f"{1e3 * v:.0f} mm" if kind == "prismatic" else f"{np.rad2deg(v):.0f} deg"
            for v, kind in zip(q, robot.joint_kinds, strict=True)
        )
        force = ", ".join(f"{v:.0f}" for v in wrench[:3])
        lines.append(f"  joints ({pose}), force ({force}) N in base")
    if tests.unobservable:
        lines += noted(
            f"No force at this tool turns {', '.join(tests.unobservable)}: use a "
            "longer or sidewards tool, or load by a moment."
        )
    return lines


def _draw_stiffness(
    folder: pathlib.Path,
    task: "LoadTestTask",
    fit: "JointStiffnessFit",
    check: "LoadCheck",
) -> None:
    """Write the figures."""
    from ...viz import (
        plot_correlation,
        plot_joint_values,
        plot_load_residual,
        plot_prediction,
        save_figure,
    )

    rows = task.rows
    figure = plot_joint_values(
        fit.joint_names,
        fit.stiffness,
        fit.standard_errors,
        np.asarray(task.robot.joint_stiffness, np.float64),
        unit="stiffness [N m/rad, N/m]",
        bound=fit.stiffness_bound,
    )
    save_figure(figure, folder / "stiffness.png")
    figure = plot_load_residual(rows, task.displacement, fit.residual, fit.outliers)
    save_figure(figure, folder / "residual.png")
    figure = plot_prediction(
        check.measured[:, :3],
        check.predicted[:, :3],
        unit="\u00b5m",
        scale=1e6,
        what="d",
        title=f"{_part(task)} predicted by the others, {check.error:.1%} off",
        marked=fit.outliers,
        labels=[f"row {rows[i]}" for i in fit.outliers],
    )
    save_figure(figure, folder / "left_out.png")
    figure = plot_correlation(fit.joint_names, fit.correlation)
    save_figure(figure, folder / "correlation.png")
