"""Joint stiffness from load tests: report and figures."""

import functools

import numpy as np

from ...identification import LoadTestStudy
from ...viz import (
    plot_correlation,
    plot_joint_values,
    plot_load_residual,
    plot_prediction,
)
from .reading import channel_lines, note_lines
from .report import EstimatedValue, Report, all_noted, noted, uncertainty_remark
from .toml_snippets import doubted, joints_toml, uncertainty_toml

_ASSUMED = (
    "Joints are linear springs, links are rigid, and the load acts at the tool of the "
    "robot's file.",
    "The brakes or servos keep the motors where they are while the load comes on.",
)


def report(study: LoadTestStudy, result: LoadTestStudy.Fit) -> Report:
    """Report of joint stiffness.

    Args:
        study: The load tests.
        result: Their fit.
    """
    fit, check = result.fit, result.check
    doubts = []
    if result.unit_ratio != 1.0:
        doubts.append(
            f"All joints that are known have about {result.unit_ratio:.2g} times the "
            "model's stiffness: look at the units of load and displacement, and at the "
            "model."
        )
    facts = {
        "kind": study.kind,
        "joints": list(fit.joint_names),
        "stiffness_SI": fit.stiffness,
        "standard_errors_SI": fit.standard_errors,
        "stiffness_at_least_SI": fit.stiffness_bound,
        "stiffness_interval_SI": fit.stiffness_interval,
        "identifiable": fit.identifiable,
        "is_consistent": fit.is_consistent,
        "explained": fit.explained,
        "share": fit.share,
        "outlier_rows": [study.rows[i] for i in fit.outliers],
        "left_out_error": check.error,
        "noise": fit.noise,
        "spread_m": fit.spread,
        "notes": [*study.notes, *fit.notes, *doubts],
    }
    draw, rows = functools.partial, study.rows
    figures = {
        "stiffness": draw(
            plot_joint_values,
            fit.joint_names,
            fit.stiffness,
            fit.standard_errors,
            np.asarray(study.robot.joint_stiffness, np.float64),
            unit="stiffness [N m/rad, N/m]",
            bound=fit.stiffness_bound,
        ),
        "residual": draw(
            plot_load_residual, rows, study.displacement, fit.residual, fit.outliers
        ),
        "correlation": draw(plot_correlation, fit.joint_names, fit.correlation),
    }
    if np.isfinite(check.error):
        figures["left_out"] = draw(
            plot_prediction,
            check.measured[:, :3],
            check.predicted[:, :3],
            unit="\u00b5m",
            scale=1e6,
            what="d",
            title=f"{_part(study)} predicted by the others, {check.error:.1%} off",
            marked=fit.outliers,
            labels=[f"row {rows[i]}" for i in fit.outliers],
        )
    lines = [
        *_stiffness_lines(study, result),
        *_advice(study, result),
        *all_noted(doubts, "warning"),
    ]
    toml = _toml(study, result)
    if doubts:
        toml = doubted(toml, "A unit of the table may be wrong; see summary.txt.")
    estimates = [
        EstimatedValue(
            name,
            float(fit.stiffness[i]) if fit.identifiable[i] else np.nan,
            float(fit.standard_errors[i]),
            "N/m" if study.robot.joint_kinds[i] == "prismatic" else "N m/rad",
            f"at least {fit.stiffness_bound[i]:.3g}"
            if fit.stiffness_bound[i] > 0 and not fit.identifiable[i]
            else "",
        )
        for i, name in enumerate(fit.joint_names)
    ]
    return Report(lines, toml, facts, figures, estimates, _ASSUMED)


def reading(study: LoadTestStudy) -> list[str]:
    """Load tests in words, line by line."""
    head = f"  {len(study.rows)} load tests of {study.robot.name}"
    return [head, *channel_lines(study.channels), *note_lines(study.notes)]


def _toml(study: LoadTestStudy, result: LoadTestStudy.Fit) -> list[str]:
    """Tables for a job."""
    fit = result.fit
    if not fit.identifiable.any():
        why = "the table does not suit the robot"
        if fit.is_consistent:
            why = "these loads do not show any joint well enough"
        return [f"# No stiffness: {why}; see summary.txt."]
    values, errors, known = fit.stiffness, fit.standard_errors, fit.identifiable
    remark = uncertainty_remark(fit.joint_names, known)
    return [
        *joints_toml(study.robot, "joint_stiffness", values, errors, known),
        *uncertainty_toml("stiffness", result.relative_uncertainty, remark),
    ]


def _stiffness_lines(study: LoadTestStudy, result: LoadTestStudy.Fit) -> list[str]:
    """Springs with their errors and doubts."""
    robot, fit = study.robot, result.fit
    lines = [f"{len(study.rows)} load tests of {robot.name}"]
    lines += all_noted(study.notes)
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
    scatter = f"one displacement scatters by {fit.spread * 1e6:.3g} um ({fit.noise})"
    if not np.isfinite(fit.spread):
        scatter = "its scatter is not known: there are no more numbers than unknowns"
    lines.append(
        f"the springs explain {max(fit.explained, 0):.2%} of the squared displacement; "
        f"{scatter}"
    )
    if fit.offset is not None:
        size = ", ".join(f"{1e6 * value:.3g}" for value in fit.offset[:3])
        lines.append(f"constant displacement: ({size}) um")
    if fit.outliers:
        rows = ", ".join(str(study.rows[i]) for i in fit.outliers)
        lines += noted(
            f"Rows {rows} of the table contradict the others"
            + (" and were left out." if fit.is_consistent else "."),
            "warning",
        )
    if np.isfinite(result.check.error):
        lines.append(
            f"left out: {_part(study)} predicted by the others, "
            f"{result.check.error:.1%} of the displacement rms off"
        )
    else:
        lines.append("left out: nothing, there are no other rows to predict one by")
    # Outliers are told above with the numbers of the rows in the file.
    notes = [x for x in fit.notes if "contradict the others and were left" not in x]
    return lines + all_noted(notes, "note" if fit.is_consistent else "warning")


def _part(study: LoadTestStudy) -> str:
    return "each row" if len(study.rows) <= 5 else "each fifth of the rows"


def _advice(study: LoadTestStudy, result: LoadTestStudy.Fit) -> list[str]:
    """Load tests that would show the joints that the table does not."""
    if result.lacks_model:
        return noted(
            "Further tests can be proposed once the model has a rough stiffness for "
            "every joint (joint_stiffness in [robot])."
        )
    tests = result.advice
    if tests is None:
        return []
    lines = ["load tests that would help most:"]
    for q, wrench in zip(tests.q, tests.wrench, strict=True):
        pose = ", ".join(
            f"{1e3 * v:.0f} mm" if kind == "prismatic" else f"{np.rad2deg(v):.0f} deg"
            for v, kind in zip(q, study.robot.joint_kinds, strict=True)
        )
        force = ", ".join(f"{v:.0f}" for v in wrench[:3])
        lines.append(f"  joints ({pose}), force ({force}) N in base")
    if tests.unobservable:
        lines += noted(
            f"No force at this tool turns {', '.join(tests.unobservable)}: use a "
            "longer or sidewards tool, or load by a moment."
        )
    return lines
