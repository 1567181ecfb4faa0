"""Bandwidth and dead time of a controller: report and figure."""

import functools

import numpy as np

from ...identification import ControllerStudy
from ...viz import plot_prediction
from .reading import note_lines, range_text
from .report import EstimatedValue, Report, all_noted, noted
from .rounded import Rounded

_ASSUMED = (
    "One linear servo with one dead time moves all axes; nothing is cut, and friction "
    "and backlash do not show.",
)


def report(study: ControllerStudy, result: ControllerStudy.Fit) -> Report:
    """Report of a controller.

    Args:
        study: The paths in the air.
        result: Their fit.
    """
    errors, zeta = result.standard_errors, result.damping_ratio
    lines = [
        f"{int(study.is_recorded.sum())} rows of a path in the air, every "
        f"{study.time_step * 1e3:.3g} ms",
        *all_noted(study.notes),
        "",
        f"bandwidth      {result.bandwidth:9.4g} +- {errors['bandwidth']:.2g} Hz "
        f"(servo of {study.order} order)",
    ]
    if zeta is not None:
        lines.append(f"damping ratio  {zeta:9.4g} +- {errors['damping_ratio']:.2g}")
    lines += [
        f"dead time      {result.dead_time * 1e3:9.4g} +- "
        f"{errors['dead_time'] * 1e3:.2g} ms",
        f"left: {result.residual_rms * 1e6:.3g} um rms per axis",
    ]
    toml = ["[controller]"]
    if result.is_identifiable:
        number, error = Rounded.of(result.bandwidth, errors["bandwidth"])
        toml.append(f'bandwidth = "{number} Hz"      # +- {error}')
        if zeta is not None:
            number, error = Rounded.of(zeta, errors["damping_ratio"])
            toml.append(f"damping_ratio = {number}        # +- {error}")
        late = Rounded.of(1e3 * result.dead_time, 1e3 * errors["dead_time"])
        toml.append(f'dead_time = "{late.value} ms"      # +- {late.error}')
    elif not result.are_servos_alike:
        toml = ["# No bandwidth: the servos of the axes differ; see summary.txt."]
        each = ", ".join(
            f"{axis} {value:.3g} Hz"
            for axis, value in zip("xyz", result.bandwidth_by_axis, strict=True)
            if np.isfinite(value)
        )
        lines += noted(
            "One servo for all axes does not suit this record: each axis alone would "
            f"have {each}. A job takes one for each joint ([controller]), which tips "
            "alone do not determine: look at the gains of the servos, or let `diffmill "
            "learn` find what moves each joint.",
            "warning",
        )
    else:
        toml = ["# No bandwidth: this path does not show it; see summary.txt."]
        lines += noted(
            "The path does not part the bandwidth from the dead time: record one that "
            "speeds up and slows down more often, or harder, such as short moves with "
            "exact stops at the feed and acceleration of the cut.",
            "warning",
        )
    facts = {
        "kind": study.kind,
        "bandwidth_Hz": result.bandwidth,
        "damping_ratio": zeta,
        "dead_time_s": result.dead_time,
        "standard_errors": errors,
        "is_identifiable": result.is_identifiable,
        "bandwidth_by_axis_Hz": result.bandwidth_by_axis,
        "are_servos_alike": result.are_servos_alike,
        "residual_rms_m": result.residual_rms,
        "notes": list(study.notes),
    }
    draw = functools.partial(
        plot_prediction,
        result.measured,
        result.predicted,
        unit="\u00b5m",
        scale=1e6,
        what="d",
        title="actual less commanded, and by the controller found",
    )
    known = result.is_identifiable
    estimates = [
        EstimatedValue(name.replace("_", " "), value if known else np.nan, error, unit)
        for name, value, error, unit in (
            ("bandwidth", result.bandwidth, errors["bandwidth"], "Hz"),
            *(
                [("damping_ratio", zeta, errors["damping_ratio"], "1")]
                if zeta is not None
                else []
            ),
            ("dead_time", 1e3 * result.dead_time, 1e3 * errors["dead_time"], "ms"),
        )
    ]
    return Report(lines, toml, facts, {"controller": draw}, estimates, _ASSUMED)


def reading(study: ControllerStudy) -> list[str]:
    """Commanded and actual paths in words, line by line."""
    rows, step = study.is_recorded, study.time_step
    lines = [
        f"  {int(rows.sum())} rows every {step * 1e3:.3g} ms, "
        f"{step * max(len(rows) - 1, 0):.4g} s"
    ]
    for what, tips in (
        ("commanded", study.commanded),
        ("actual", study.actual[rows]),
        ("actual less commanded", (study.actual - study.commanded)[rows]),
    ):
        parts = [
            f"{axis} {range_text(values, 'm')}"
            for axis, values in zip("xyz", tips.T, strict=True)
        ]
        lines.append(f"    {what}: {', '.join(parts)}")
    return lines + note_lines(study.notes)
