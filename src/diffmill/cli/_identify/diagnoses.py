"""Diagnoses of a record in words."""

from collections.abc import Sequence

import numpy as np

from ...identification import Diagnosis, ForceRecord
from .report import noted


def diagnosis_lines(
    diagnoses: Sequence[Diagnosis],
    axes: Sequence[str] = ("x", "y", "z"),
    records: Sequence[str] = (),
) -> list[str]:
    """Lines of diagnoses; nothing was changed for any of them.

    Args:
        diagnoses: The diagnoses.
        axes: For x, y, z of the work the recorded axis.
        records: Names of the records, which begin the lines if there are several.
    """
    lines = []
    for one in diagnoses:
        text = _TEXTS[one.code](dict(one.values), axes)
        if len(records) > 1 and not one.code.startswith("implausible"):
            text = f"{records[one.record]}: {text}"
        lines += noted(text, "warning" if one.is_grave else "note")
    return lines


def diagnosis_facts(diagnoses: Sequence[Diagnosis]) -> list[dict[str, object]]:
    """Diagnoses for `identified.json`."""
    return [
        {"code": d.code, "record": d.record, "values_SI": dict(d.values)}
        for d in diagnoses
    ]


def tare_facts(records: Sequence[ForceRecord]) -> list[dict[str, object] | None]:
    """Offset, drift and noise of records for `identified.json`."""
    return [
        None
        if one.tare is None
        else {
            "time_s": one.tare.instant,
            "offset_N": one.tare.offset,
            "drift_N_per_s": one.tare.drift,
            "noise_N": one.tare.noise,
        }
        for one in records
    ]


def diagnosis_title(one: Diagnosis) -> str:
    """Diagnosis in few words."""
    return _TITLES[one.code]


def _lost(v: dict[str, float], axes: Sequence[str]) -> str:
    side = "late" if v["shift"] < 0 else "early"
    return (
        f"Samples seem to be lost at {v['time']:.4g} s: from there on the teeth come "
        f"{abs(v['shift']) * 1e3:.3g} ms too {side}, but for whole periods. Fit the "
        "part before or after it by start and stop, or give a column of the time."
    )


def _wanders(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"Clock and spindle part by {v['spread'] * 1e3:.2g} ms rms: single samples may "
        "be lost, or the spindle turns unevenly. A column of the time, or a tacho, "
        "would show which."
    )


def _rate(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"By the record's clock the teeth pass {v['ratio']:.4f} times as often as by "
        "the spindle's speed: look at the speed and at the sampling rate; a record "
        "without a column of the time may have lost rows here and there."
    )


def _teeth(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"The forces repeat {v['found']:.0f} times a turn: look at the number of "
        f"teeth, which is given as {v['given']:.0f}, and at the speed."
    )


def _gain(v: dict[str, float], axes: Sequence[str]) -> str:
    axis = int(v["axis"])
    return (
        f"The channel F{axes[axis][-1]} is {v['ratio']:.3g} times what suits the "
        f"others, or they are too large or small by as much: with that {_explains(v)}. "
        "Look at unit and range of each channel's amplifier."
    )


def _offset(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"A constant force of ({_recorded(v, axes)}) N in the recorded axes lies in "
        f"the record: without it {_explains(v)}. Name a section without a cut by tare."
    )


def _drift(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"The record drifts by ({_recorded(v, axes)}) N/s in the recorded axes: "
        f"without that {_explains(v)}. Name sections without a cut by tare and "
        "tare_after."
    )


def _spindle(v: dict[str, float], axes: Sequence[str]) -> str:
    # A force that was not measured has no amplitude.
    sizes = ", ".join(f"F{axis} {v[axis]:.3g}" for axis in "xyz" if v[axis] > 0)
    text = (
        f"The fit leaves a line at the spindle's frequency, {v['frequency']:.4g} Hz, "
        f"of amplitude {sizes} N in the axes of the work. Teeth that are all alike "
        "have none: "
    )
    if v["is_fitted"]:
        return (
            f"{text}beside the run-out that was fitted, teeth of different length "
            "would explain it, or an unbalanced spindle."
        )
    return (
        f"{text}run-out or uneven teeth would explain it, or an unbalanced spindle, "
        'which shows without a cut, too. Fit the run-out by refine = ["runout"] in '
        "[fit]."
    )


def _recorded(v: dict[str, float], axes: Sequence[str]) -> str:
    """Forces of the work as they were recorded, with three digits."""
    order = [axes.index(next(a for a in axes if a[-1] == name)) for name in "xyz"]
    signed = [v["xyz"[i]] * (-1 if axes[i].startswith("-") else 1) for i in order]
    return ", ".join(f"{value:.3g}" for value in signed)


def _explains(v: dict[str, float]) -> str:
    return (
        f"{1 - v['left']:.2%} of its squared force would be explained, against "
        f"{1 - v['before']:.2%}"
    )


def _pressure(v: dict[str, float], axes: Sequence[str]) -> str:
    text = (
        f"K_tc is {v['value'] * 1e-6:.3g} N/mm^2, but no material that is known lies "
        f"outside {v['least'] * 1e-6:.2g} to {v['most'] * 1e-6:.3g} N/mm^2"
    )
    if np.isfinite(v["factor"]):
        text += f"; over {v['factor']:.4g} it would be one of them"
    return f"{text}: look at the unit of the forces, and at depth and feed."


def _ratio(v: dict[str, float], axes: Sequence[str]) -> str:
    return (
        f"K_rc is {v['radial']:.2g} and K_ac {v['axial']:.2g} times K_tc, which no "
        "cutter has: look at axes, units and ranges of the channels."
    )


_TEXTS = {
    "samples_lost": _lost,
    "clock_wanders": _wanders,
    "clock_rate": _rate,
    "tooth_count": _teeth,
    "channel_gain": _gain,
    "offset": _offset,
    "drift": _drift,
    "spindle_line": _spindle,
    "implausible_pressure": _pressure,
    "implausible_ratio": _ratio,
}
_TITLES = {
    "samples_lost": "Samples seem to be lost",
    "clock_wanders": "Clock and spindle part",
    "clock_rate": "Clock and spindle run at different rates",
    "tooth_count": "The number of teeth may be wrong",
    "channel_gain": "A channel may have a wrong gain",
    "offset": "The record has an offset",
    "drift": "The record drifts",
    "spindle_line": "The fit leaves a line at the spindle's frequency",
    "implausible_pressure": "No known material has this K_tc",
    "implausible_ratio": "No cutter has these ratios of coefficients",
}
