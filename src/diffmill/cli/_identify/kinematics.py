"""Link errors of a robot: report and figures."""

import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...identification import KinematicStudy
from ...viz import plot_correlation, plot_pose_errors, plot_prediction
from .reading import channel_lines, note_lines
from .report import EstimatedValue, Report, all_noted, noted
from .rounded import Rounded
from .toml_snippets import doubted

# Unknowns of which the poses leave more than this share of the prior variance are open.
_OPEN = 0.5
# An error of so many of its sizes beforehand is not what the prior says.
_FAR = 4.0
# A robot that is so far off as it is stated has a wrong unit or axis [m].
_WRONG = 0.05
_CASES = {
    "before": "as stated, tool and base placed",
    "after": "with link errors",
    "with_process": "and a process on what is left",
}
_WHAT = {
    "position": "positions of the tool",
    "frame": "frames of the tool",
    "distance": "distances of the tool from a fixed point",
}

_ASSUMED = (
    "Beforehand each error is normal about zero with the size that [prior] states; "
    "standard errors follow from that.",
    "The robot stands still and unloaded in each pose, and the instrument does not "
    "move.",
)


def report(study: KinematicStudy, result: KinematicStudy.Fit) -> Report:
    """Report of link errors.

    Args:
        study: The measured poses.
        result: Their fit.
    """
    fit, cross_validated = result.fit, result.cross_validated
    doubts = _doubts(result)
    parameters = fit.model.parameters
    cases = _cross_validated(result)
    facts = {
        "kind": study.kind,
        "parameters": [one.name for one in parameters],
        "values_SI": fit.x,
        "standard_errors_SI": fit.standard_errors,
        "intervals_SI": fit.interval,
        "covariance_SI": fit.covariance,
        "prior_SI": fit.model.sizes,
        "known_share": fit.known_share,
        "spread_SI": fit.spread,
        "left_out_m": {
            name: {"mean": lengths.mean(), "largest": lengths.max()}
            for name, lengths in (
                (name, cross_validated.lengths(one)) for name, one in cases.items()
            )
        },
        "outlier_rows": _rows(study, fit.outliers),
        "ambiguities": {
            name: [dict(zip(one.names, one.shares, strict=True)) for one in found]
            for name, found in (
                ("of_any_pose", result.ambiguities.structural),
                ("of_these_poses", result.ambiguities.of_poses),
            )
        },
        "further_poses": result.advice.q,
        "notes": [*study.notes, *doubts],
    }
    known = np.flatnonzero(
        (fit.known_share > _OPEN) & [not one.is_placement for one in parameters]
    )
    draw = functools.partial
    errors = fit.standard_errors[known]
    figures = {
        "left_out": draw(
            plot_pose_errors,
            {_CASES[name]: cross_validated.lengths(one) for name, one in cases.items()},
            title="errors of poses that were left out",
        ),
        "prediction": draw(
            plot_prediction,
            cross_validated.before[:, :3],
            (cross_validated.before - cross_validated.after)[:, :3],
            unit="\u00b5m",
            scale=1e6,
            what="d",
            title="error of the robot as stated, by link errors from other poses",
            marked=fit.outliers,
            labels=[f"row {row}" for row in _rows(study, fit.outliers)],
        ),
    }
    if known.size > 1:
        figures["correlation"] = draw(
            plot_correlation,
            [parameters[i].name for i in known],
            fit.covariance[np.ix_(known, known)] / np.outer(errors, errors),
        )
    lines = [
        *_error_lines(study, result),
        *_cross_validation_lines(study, result),
        *_open_lines(result),
        *_advice_lines(study, result),
        *all_noted(doubts, "warning"),
    ]
    toml = _toml(study, result)
    if doubts:
        toml = doubted(toml, f"{doubts[0]} See summary.txt.")
    every = zip(parameters, fit.x, fit.standard_errors, fit.known_share, strict=True)
    estimates = [
        EstimatedValue(
            one.name,
            1e3 * float(value) if share >= _OPEN else np.nan,
            1e3 * float(error),
            f"m{one.unit}",
        )
        for one, value, error, share in every
    ]
    return Report(lines, toml, facts, figures, estimates, _ASSUMED)


def reading(study: KinematicStudy) -> list[str]:
    """Measured poses in words, line by line."""
    what = _WHAT[study.poses.observed]
    head = f"  {len(study.poses.q)} {what}, {study.robot.name}"
    return [head, *channel_lines(study.channels), *note_lines(study.notes)]


def _rows(study: KinematicStudy, places: Sequence[int]) -> list[int]:
    """Numbers of the rows of a table at some places."""
    return [study.rows[i] if study.rows else i + 1 for i in places]


def _cross_validated(
    result: KinematicStudy.Fit,
) -> dict[str, Float[np.ndarray, "pose component"]]:
    """Residuals of poses that were left out, by what predicts them."""
    own = result.cross_validated
    cases = {"before": own.before, "after": own.after}
    return cases | (
        {} if own.with_process is None else {"with_process": own.with_process}
    )


def _doubts(result: KinematicStudy.Fit) -> list[str]:
    """Sentences on why the errors should not be used."""
    fit, cross_validated = result.fit, result.cross_validated
    doubts = []
    before = float(np.median(cross_validated.lengths(cross_validated.before)))
    after = float(np.median(cross_validated.lengths(cross_validated.after)))
    if before > _WRONG:
        doubts.append(
            f"The robot as stated is {1e3 * before:.3g} mm off: look at units, at the "
            "sign and zero of each joint, and at the columns."
        )
    if not result.is_better:
        doubts.append(
            f"The errors do not predict poses that were left out: {1e6 * before:.3g} "
            f"um without them, {1e6 * after:.3g} um with them."
        )
    if not fit.has_converged:
        doubts.append("The fit has not converged.")
    return doubts


def _error_lines(study: KinematicStudy, result: KinematicStudy.Fit) -> list[str]:
    """Errors that the poses tell, with what is doubtful in them."""
    fit = result.fit
    lines = [f"{len(study.poses.q)} {_WHAT[study.poses.observed]}, {study.robot.name}"]
    lines += all_noted(study.notes)
    width = max(len(one.name) for one in fit.model.parameters) + 2
    lines += [
        "",
        f"{'error':{width}}{'value':>11}{'std. error':>12}   95 % interval  unit",
    ]
    far = []
    every = zip(
        fit.model.parameters, fit.x, fit.standard_errors, fit.known_share, strict=True
    )
    for one, value, error, share in every:
        if share < _OPEN:
            continue
        rounded = Rounded.of(1e3 * value, 1e3 * error)
        low, high = (
            Rounded.of(1e3 * (value + s * 1.96 * error), 1e3 * error).value
            for s in (-1, 1)
        )
        lines.append(
            f"{one.name:{width}}{rounded.value:>11}{rounded.error:>12}   "
            f"{low} to {high}  m{one.unit}"
        )
        if not one.is_placement and abs(value) > _FAR * one.size:
            far.append(f"{one.name} ({rounded.value} m{one.unit})")
    if far:
        lines += noted(
            f"{', '.join(far)}: more than {_FAR:g} times the size beforehand; if that "
            "is so, state a larger one in [prior].",
            "warning",
        )
    if fit.outliers:
        rows = ", ".join(map(str, _rows(study, fit.outliers)))
        lines += noted(
            f"Rows {rows} of the table contradict the others and count little.",
            "warning",
        )
    return lines


def _cross_validation_lines(
    study: KinematicStudy, result: KinematicStudy.Fit
) -> list[str]:
    """Errors of poses that were left out, and what is left of them."""
    fit, cross_validated = result.fit, result.cross_validated
    lines = ["", f"poses left out, each {_nth(study.folds)} predicted by the others:"]
    for name, one in _cross_validated(result).items():
        lengths = 1e3 * cross_validated.lengths(one)
        mean, largest = lengths.mean(), lengths.max()
        text = f"  {_CASES[name]:32}{mean:8.4f} mm mean, {largest:.4f} largest"
        if study.poses.rotation is not None:
            text += f", {1e3 * cross_validated.angles(one).mean():.4f} mrad mean"
        lines.append(text)
    lines += noted(
        f"One coordinate scatters by {1e6 * fit.spread[0]:.3g} um about the fit, "
        f"{fit.spread[0] / study.noise.length:.2g} times the noise that is stated: "
        "what no link error explains is left of the robot's repeatability, its gears "
        "and its load."
    )
    if cross_validated.with_process is not None:
        lines += noted("The process is printed, and not written: no job reads it.")
    return lines


def _nth(folds: int) -> str:
    """Share of the poses that one fold is."""
    return {2: "half", 3: "third", 4: "quarter", 5: "fifth", 10: "tenth"}.get(
        folds, f"{folds}th part"
    )


def _open_lines(result: KinematicStudy.Fit) -> list[str]:
    """Combinations of errors that the poses do not tell."""
    fit, lines = result.fit, []
    units = {one.name: one.unit for one in fit.model.parameters}
    for head, found in (
        (
            "no pose of this robot, tool and instrument determines",
            result.ambiguities.structural,
        ),
        ("these poses do not determine, others would", result.ambiguities.of_poses),
    ):
        if not found:
            continue
        lines += ["", f"{head}:"]
        for one in found:
            if len(one.names) == 1:
                lines.append(f"  {one.names[0]}")
                continue
            parts = [
                f"{name} by {share:.3g} m{units[name]}"
                for name, share in zip(one.names, one.shares, strict=True)
            ]
            lines.append(f"  {', '.join(parts[:-1])} and {parts[-1]}: no change")
    return lines


def _advice_lines(study: KinematicStudy, result: KinematicStudy.Fit) -> list[str]:
    """Poses that would help most."""
    advice = result.advice
    lines = ["", "poses that would help most:"]
    for q in advice.q:
        pose = ", ".join(
            f"{1e3 * v:.0f} mm" if kind == "prismatic" else f"{np.rad2deg(v):.0f} deg"
            for v, kind in zip(q, study.robot.joint_kinds, strict=True)
        )
        lines.append(f"  joints ({pose})")
    lines.append(
        f"with them a coordinate is known to {1e6 * advice.tip_error_with:.3g} um all "
        f"over the joints' range, without to {1e6 * advice.tip_error:.3g} um"
    )
    return lines + noted(
        "Whether a pose collides, and whether the instrument sees it, is not looked at."
    )


def _toml(study: KinematicStudy, result: KinematicStudy.Fit) -> list[str]:
    """Table `[robot.calibration]`."""
    errors, sigma = result.fit.errors, result.fit.standard_link_errors
    lines = [
        "# Each error is known to the number behind it (1 sigma), all together far",
        "# better: none may be left out.",
        "[robot.calibration]",
    ]
    joints = study.robot.joint_units
    for field in ("displacement", "rotation", "waves", "joint_offsets"):
        values = getattr(errors, field)
        if values is None:
            continue
        units = {"displacement": ["m"] * len(values), "joint_offsets": joints}
        every = zip(
            study.robot.joint_names,
            np.asarray(values),
            np.asarray(getattr(sigma, field)),
            units.get(field, ["rad"] * len(values)),
            strict=True,
        )
        rows = [
            f"    {_toml_value(row, unit)},  # {name}: {_plus_minus(error, unit)}"
            for name, row, error, unit in every
        ]
        lines += [f"{field} = [", *rows, "]"]
    if errors.waves is not None:
        lines.append(f'wave_period = "{360 / study.waves_per_turn:.6g} deg"')
    tool = _toml_value(np.asarray(errors.tool_position), "m")
    return [
        *lines,
        "# Of the target that was measured; a cutter in its place has the same.",
        f"# tool = {tool}  # {_plus_minus(np.asarray(sigma.tool_position), 'm')}",
    ]


def _toml_value(values: Float[np.ndarray, " part"] | float, unit: str) -> str:
    """Quantity or list of quantities, to a tenth of a micrometre or microradian."""
    if isinstance(values, np.ndarray):
        return f"[{', '.join(_toml_value(value, unit) for value in values)}]"
    return f'"{round(1e3 * float(values), 4) + 0.0:.4f} m{unit}"'


def _plus_minus(errors: Float[np.ndarray, " part"] | float, unit: str) -> str:
    """Standard errors of a row; a dash for what was not fitted."""
    parts = [f"{1e3 * e:.2g}" if e > 0 else "-" for e in np.atleast_1d(errors)]
    return f"+- {', '.join(parts)} m{unit}"
