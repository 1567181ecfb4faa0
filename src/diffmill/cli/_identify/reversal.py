"""Springs, reversals and delays of joints: report and figures."""

import dataclasses
import functools
import math

import numpy as np

from ...identification import ReversalStudy
from ...viz import plot_reversal
from .reading import channel_lines, note_lines
from .report import EstimatedValue, Report, all_noted
from .rounded import Rounded
from .toml_snippets import commented

_HEAD = (
    f"{'joint':12}{'stiffness':>22}{'reversal':>16}{'backlash':>16}{'presliding':>14}"
    f"{'delay':>16}"
)
_UNITS = f"{'':12}{'[MN m/rad], 95 %':>22}" + "".join(
    f"{unit:>{width}}"
    for unit, width in (("[urad]", 16), ("[urad]", 16), ("[urad]", 14), ("[ms]", 16))
)

_ASSUMED = (
    "Two encoders read motor and link without an error of their own; the spring "
    "between them is linear beside backlash and friction.",
    "The robot's file is right about masses: they give the load of each joint.",
)


def report(study: ReversalStudy, result: ReversalStudy.Fit) -> Report:
    """Report of the drives.

    Args:
        study: The records.
        result: Their fit.
    """
    names = [study.joint_names[one.joint] for one in result.drives]
    lines = [
        f"{len(study.records)} records of {len(names)} joints with two encoders, below "
        f"{study.lowpass:g} Hz",
        *all_noted(_all_notes(study)),
        "",
        _HEAD,
        _UNITS,
    ]
    toml_stiffness, toml_drives, facts, figures, doubts = [], [], {}, {}, []
    for name, fitted in zip(names, result.drives, strict=True):
        drive = fitted.drive
        low, high = drive.stiffness_interval
        spring = f"{1e-6 * low:.3g} to {1e-6 * high:.3g}"
        if not math.isfinite(high):
            spring = f"at least {1e-6 * low:.3g}"
        reversal, backlash, delay = (
            _text(one.value, one.error, scale)
            for one, scale in (
                (drive.reversal, 1e6),
                (drive.backlash, 1e6),
                (drive.delay, 1e3),
            )
        )
        lines.append(
            f"{name:12}{spring:>22}{reversal:>16}{backlash:>16}"
            f"{1e6 * drive.presliding:>14.3g}{delay:>16}"
        )
        doubts += _doubts(name, fitted)
        stiffness, table = _toml(study, name, fitted)
        toml_stiffness.append(stiffness)
        toml_drives += table
        facts[name] = _facts(fitted)
        figures[f"reversal_{name}"] = functools.partial(
            plot_reversal, name, fitted.cross_validated
        )
    lines += [
        "",
        "left out: link less motor of a record as the others predict it [urad rms]",
        f"{'joint':12}{'measured':>10}{'drive':>10}{'repeats':>10}  record",
    ]
    for name, fitted in zip(names, result.drives, strict=True):
        for one in fitted.cross_validated:
            parts = "".join(f"{1e6 * rms:10.3g}" for rms in one.rms)
            lines.append(f"{name:12}{parts}  {one.name}")
        lines.append(
            f"{name:12}{max(fitted.repeating_share, 0.0):.0%} of the square of what "
            f"the drive leaves repeats{_of(fitted)}"
        )
    lines += all_noted(
        [
            "Viscous friction of a link and the delay of its encoder are one: the "
            "delay has both. Joints of one controller share the delay.",
            *doubts,
            *result.notes,
        ]
    )
    toml = ["[stiffness]", *toml_stiffness, *toml_drives]
    return Report(
        lines,
        toml,
        {"kind": study.kind, "joints": facts, "notes": [*_all_notes(study), *doubts]},
        figures,
        [
            one
            for name, fitted in zip(names, result.drives, strict=True)
            for one in _estimates(name, fitted)
        ],
        _ASSUMED,
    )


def reading(study: ReversalStudy) -> list[str]:
    """Records of joints in words, line by line."""
    lines = []
    for one in study.records:
        lines += [
            f"  {one.name}: {len(one.motor)} rows every {1e3 * one.time_step:.4g} ms",
            *channel_lines(one.channels),
            *note_lines(one.notes, 4),
        ]
    return lines + note_lines(study.notes)


def _estimates(name: str, fitted: ReversalStudy.Drive) -> list[EstimatedValue]:
    """Spring, reversal, backlash and delay of a joint."""
    drive = fitted.drive
    low, high = drive.stiffness_interval
    bound = f"at least {1e-6 * low:.3g}" if not math.isfinite(high) else ""
    return [
        EstimatedValue(
            f"{name}, {what}",
            scale * one.value if math.isfinite(one.error) else math.nan,
            scale * one.error,
            unit,
            remark,
        )
        for what, one, scale, unit, remark in (
            ("stiffness", drive.stiffness, 1e-6, "MN m/rad", bound),
            ("reversal", drive.reversal, 1e6, "urad", ""),
            ("backlash", drive.backlash, 1e6, "urad", ""),
            ("delay", drive.delay, 1e3, "ms", ""),
        )
    ]


def _all_notes(study: ReversalStudy) -> list[str]:
    return [
        *study.notes,
        *(f"{one.name}: {note}" for one in study.records for note in one.notes),
    ]


def _text(value: float, error: float, scale: float) -> str:
    """Number and standard error."""
    if not math.isfinite(error):
        return "-"
    rounded = Rounded.of(scale * value, scale * error)
    return f"{rounded.value} +- {rounded.error}"


def _of(fitted: ReversalStudy.Drive) -> str:
    """Of what the error that repeats is a function."""
    prior = fitted.repeating
    if prior is None:
        return ""
    direction = " and direction" if prior.by_direction else ""
    return (
        f", a function of position{direction} of length "
        f"{np.rad2deg(prior.length):.3g} deg"
    )


def _doubts(name: str, fitted: ReversalStudy.Drive) -> list[str]:
    """Sentences on what the records do not show of a joint."""
    drive, doubts = fitted.drive, []
    if not math.isfinite(drive.stiffness.error):
        doubts.append(
            f"{name}: its load does not change enough to bound the stiffness from "
            "both sides; record poses and payloads that load it otherwise."
        )
    if drive.reversal.interval[0] <= 0:
        most = max(drive.reversal.interval[1], 0.0)
        doubts.append(
            f"{name}: no reversal shows beside what else changes with the motion; it "
            f"is at most {1e6 * most:.2g} urad."
        )
    if not math.isfinite(drive.backlash.error):
        if not drive.sees_both_flanks:
            doubts.append(
                f"{name}: the load pulls to one side throughout, so that a gap stays "
                "closed and no backlash shows."
            )
        else:
            doubts.append(
                f"{name}: the load changes its side with the motion alone; backlash "
                "and friction cannot be separated, and the reversal includes half of "
                "the backlash."
            )
    low, high = drive.presliding_interval
    if low == 0.0 or not math.isfinite(high):
        side, end = ("at most", high) if low == 0.0 else ("at least", low)
        doubts.append(
            f"{name}: the travel over which friction builds up shows from one side "
            f"only; it is {side} {1e6 * end:.2g} urad."
        )
    return doubts


def _toml(
    study: ReversalStudy, name: str, fitted: ReversalStudy.Drive
) -> tuple[str, list[str]]:
    """Line of `[stiffness]`, and lines of `[drive]`, of a joint."""
    drive, lines = fitted.drive, ["", f"[drive.{name}]"]
    K = drive.stiffness
    if math.isfinite(K.error):
        value, error = Rounded.of(1e-6 * K.value, 1e-6 * K.error)
        spring = commented(f'{name} = "{value} MN*m/rad"', f"+- {error}")
    else:
        least = 1e-6 * drive.stiffness_interval[0]
        spring = f"# {name}: not identifiable, at least {least:.3g} MN*m/rad"
        if study.robot is not None:
            model = float(np.asarray(study.robot.joint_stiffness)[fitted.joint])
            K = dataclasses.replace(K, value=model, error=0.0)
    gap = drive.backlash
    if math.isfinite(gap.error) and gap.interval[0] > 0:
        value, error = Rounded.of(1e6 * gap.value, 1e6 * gap.error)
        lines.append(commented(f'backlash = "{value} urad"', f"+- {error}"))
    else:
        lines.append("# backlash: not identifiable; see summary.txt")
    if drive.reversal.interval[0] > 0 and math.isfinite(K.error) and K.value < math.inf:
        value, error = Rounded.of(*dataclasses.astuple(K * drive.reversal))
        remark = f"+- {error}: stiffness times reversal"
        if K.error == 0.0:
            remark += ", with the stiffness of the model"
        low, high = (f"{1e6 * end:.3g}" for end in drive.presliding_interval)
        lines += [
            commented(f'coulomb_friction = "{value} N*m"', remark),
            commented(
                f'presliding = "{1e6 * drive.presliding:.3g} urad"',
                f"95 %: {low} to {high}",
            ),
        ]
    else:
        lost = "# coulomb_friction, presliding: not identifiable; see summary.txt"
        lines.append(lost)
    value, error = Rounded.of(drive.viscous.value, drive.viscous.error)
    lines.append(
        f"# viscous_friction: at most {value} +- {error} N*m*s/rad, that of motor and "
        "link together"
    )
    return spring, lines


def _facts(fitted: ReversalStudy.Drive) -> dict[str, object]:
    """Numbers of a joint in SI units."""
    drive = fitted.drive
    estimates = {
        "stiffness": drive.stiffness,
        "reversal": drive.reversal,
        "backlash": drive.backlash,
        "delay": drive.delay,
        "coulomb_friction_of_motor_and_link": drive.coulomb,
        "viscous_friction_of_motor_and_link": drive.viscous,
    }
    return {
        **{key: one.value for key, one in estimates.items()},
        "standard_errors": {key: one.error for key, one in estimates.items()},
        "stiffness_interval": drive.stiffness_interval,
        "presliding": drive.presliding,
        "presliding_interval": drive.presliding_interval,
        "independent_samples": drive.independent,
        "left_out_rms": {one.name: one.rms for one in fitted.cross_validated},
        "repeating_share": fitted.repeating_share,
    }
