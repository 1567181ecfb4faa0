"""Identified parameters as tables of a job file, ready to paste."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from ...identification import ForceRecordStudy, MeanForceStudy
from ...robot import Robot
from .diagnoses import diagnosis_title
from .rounded import Rounded

# Largest uncertainty that the table takes.
_LARGEST = 0.999
# The simulated chip is off by so much of itself, see docs/verified.md: the noise of a
# long record is less.
_LEAST_FORCE_ERROR = 0.01
# What intervals of coefficients do not hold.
NOT_IN_ERRORS = (
    "what acts like a coefficient: the gain of a channel, a wrong depth, diameter or "
    "speed"
)
_FORCE_REMARK = (
    "noise of the records, at least 1 % for the simulation: a worn tool, another batch "
    "of material and what the force law leaves out differ by more"
)


def force_toml(
    coefficients: Mapping[str, float],
    errors: Mapping[str, float],
    identifiable: Mapping[str, bool],
) -> list[str]:
    """Lines of `[force]`.

    Args:
        coefficients: By name [Pa, N/m, -].
        errors: Standard errors, likewise; without a name that is as in the job.
        identifiable: Whether the coefficient is known.
    """
    lines = ["[force]"]
    for name, value in coefficients.items():
        default, unit, scale = "a job needs it", "N/mm^2", 1e-6
        if name.startswith("m_"):
            unit, scale = "", 1.0
        elif name.endswith("e"):
            default, unit, scale = "left out it is 0", "N/mm", 1e-3
        if name in ("m_r", "m_a"):
            default = "left out it is m_t"
        text, error = f"{value * scale:.6g}", "as in the job"
        if name in errors and np.isfinite(value):
            rounded = Rounded.of(value * scale, errors[name] * scale)
            text, error = rounded.value, f"+- {rounded.error}"
        number = f'{name} = "{text} {unit}"' if unit else f"{name} = {text}"
        if identifiable[name] and np.isfinite(value):
            lines.append(commented(number, error))
            continue
        lost = f"# {name}: not identifiable"
        if np.isfinite(value):
            lost += f", {text} {error} {unit}"
        lines.append(f"{lost.rstrip()}; {default}")
    return lines


def commented(line: str, remark: str) -> str:
    """Line with a comment behind it; comments of a table stand below each other."""
    return f"{line:32}# {remark}"


def doubted(lines: Sequence[str], why: str) -> list[str]:
    """Lines as comments below the reason why they are not to be used."""
    return [f"# {why}", *(f"# {line}".rstrip() for line in lines)]


def uncertainty_toml(key: str, relative: float, remark: str | None = None) -> list[str]:
    """Lines of `[correction.uncertainty]` for a correction that is robust.

    Args:
        key: "force", "stiffness" or "damping".
        relative: Standard error over the value.
        remark: Exceptions, a comment above it.
    """
    if not np.isfinite(relative):
        return []
    value = min(float(relative), _LARGEST)
    return [
        "",
        "[correction.uncertainty]",
        *([] if remark is None else [f"# {remark}"]),
        f"{key} = {value:.2g}",
        "gaussian = true",
    ]


def force_uncertainty_toml(relative: float) -> list[str]:
    """Lines of `[correction.uncertainty]` after a fit of forces.

    Args:
        relative: Standard error of the force over the force, of noise alone.
    """
    known = max(relative, _LEAST_FORCE_ERROR) if np.isfinite(relative) else relative
    return uncertainty_toml("force", known, _FORCE_REMARK)


def cutter_toml(result: ForceRecordStudy.Fit) -> list[str]:
    """Lines of `[cutter]` with the run-out and diameter that were fitted.

    Args:
        result: Result of the study; no lines if it fitted the coefficients alone.
    """
    fit, lines = result.fit, []
    if "runout_x" in fit.refined:
        lines += _runout_toml(fit.refined, fit.refined_errors)
    growth = fit.refined.get("radius", np.nan)
    if np.isfinite(growth):
        nominal = float(fit.records[0].cut.cutter.nominal_radius)
        error = 2e3 * fit.refined_errors["radius"]
        value, shown = Rounded.of(2e3 * (nominal + growth), error)
        lines.append(commented(f'diameter = "{value} mm"', f"+- {shown}"))
    return ["[cutter]", *lines, ""] if lines else []


def _runout_toml(
    lengths: Mapping[str, float], errors: Mapping[str, float]
) -> list[str]:
    """Run-out and its angle; comments where the records do not show them."""
    x, y = lengths["runout_x"], lengths["runout_y"]
    x_error, y_error = errors["runout_x"], errors["runout_y"]
    if not np.isfinite(x) and not np.isfinite(y):
        return ["# runout, runout_angle: not identifiable; see summary.txt"]
    hidden = [name for name, v in (("x", x), ("y", y)) if not np.isfinite(v)]
    if hidden:
        # What does not show is left out, as if it were zero.
        x, x_error = (x, x_error) if np.isfinite(x) else (0.0, 0.0)
        y, y_error = (y, y_error) if np.isfinite(y) else (0.0, 0.0)
    size = float(np.hypot(x, y))
    size_error = float(np.hypot(x * x_error, y * y_error)) / size
    angle = float(np.degrees(np.arctan2(y, x)))
    angle_error = float(np.degrees(np.hypot(y * x_error, x * y_error))) / size**2
    value, shown = Rounded.of(1e6 * size, 1e6 * size_error)
    lines = [commented(f'runout = "{value} um"', f"+- {shown}")]
    if hidden:
        text = f'runout_angle = "{angle:.0f} deg"'
        why = f"runout_{hidden[0]} is not identifiable and taken as 0"
        return [*lines, commented(text, f"from tooth 0; {why}")]
    value, shown = Rounded.of(angle, angle_error)
    text = f'runout_angle = "{value} deg"'
    return [*lines, commented(text, f"from tooth 0, +- {shown}")]


def fitted_force_toml(
    result: ForceRecordStudy.Fit | MeanForceStudy.Fit,
    doubts: Sequence[str],
    cutter: Sequence[str] = (),
) -> list[str]:
    """Tables after a fit of forces, as comments if they are doubtful.

    Args:
        result: Result of the study.
        doubts: Why it is doubtful, beside axes and diagnoses; the first is told.
        cutter: Lines of `[cutter]` that stand before.
    """
    fit = result.fit
    lines = [
        *cutter,
        *force_toml(fit.coefficients, fit.standard_errors, fit.identifiable),
        *force_uncertainty_toml(result.relative_uncertainty),
    ]
    reasons = [
        *doubts,
        *([] if result.has_likely_axes else ["Other axes make more sense"]),
        *(diagnosis_title(one) for one in result.diagnoses if one.is_grave),
    ]
    return doubted(lines, f"{reasons[0]}; see summary.txt.") if reasons else lines


def joints_toml(
    robot: Robot,
    key: str,
    values: Float[np.ndarray, " joint"],
    errors: Float[np.ndarray, " joint"],
    identifiable: Bool[np.ndarray, " joint"],
) -> list[str]:
    """Lines of `joint_stiffness` or `joint_damping` of `[robot]`.

    Joints that are not identifiable keep the value of the model; without one the list
    cannot be written, and the lines are comments.

    Args:
        robot: The robot as it was.
        key: "joint_stiffness" or "joint_damping".
        values: As fitted, shape (joint,), of the joints that a job lists: those that
            the springs behind its arm add are the last ones of the robot.
        errors: Standard errors, shape (joint,).
        identifiable: Whether a value is known, shape (joint,).
    """
    model = np.asarray(getattr(robot, key), np.float64)
    unit = {"joint_stiffness": ("N*m/rad", "N/m")}.get(key, ("N*m*s/rad", "N*s/m"))
    rows, is_whole = [], True
    for i, name in enumerate(robot.joint_names[: len(values)]):
        one = unit[int(robot.joint_kinds[i] == "prismatic")]
        if identifiable[i]:
            value, error = Rounded.of(float(values[i]), float(errors[i]))
            rows.append(commented(f'    "{value} {one}",', f"{name}: +- {error}"))
        elif np.isfinite(model[i]):
            text = f'    "{model[i]:.6g} {one}",'
            rows.append(commented(text, f"{name}: not identifiable; as in the model"))
        else:
            is_whole = False
            rows.append(f"    # {name}: not identifiable, and the model has no value")
    lines = [f"{key} = [", *rows, "]"]
    if not is_whole:
        lines = ["# Fill in the joints without a value.", *(f"# {x}" for x in lines)]
    return ["[robot]", *lines]


def snippet(head: Sequence[str], lines: Sequence[str]) -> str:
    """Text of TOML with comments at its head."""
    return "\n".join([*(f"# {line}" for line in head), "", *lines]) + "\n"
