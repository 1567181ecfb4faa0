"""Modes from ring-downs: report and figures."""

import functools
from typing import Any

from ...identification import ModeStudy
from ...viz import plot_ring_down
from .modes import (
    MeasuredModes,
    mode_facts,
    mode_lines,
    modes_report,
    vibration_reading,
)
from .report import Report


def report(study: ModeStudy, result: ModeStudy.Fit) -> Report:
    """Report of the modes of ring-downs.

    Args:
        study: The ring-downs.
        result: Their fit.
    """
    # All of them are of this kind.
    pairs: Any = zip(study.measured, result.modes, strict=True)
    parts = [
        MeasuredModes(
            mode_lines(one, fit),
            mode_facts(fit),
            functools.partial(
                plot_ring_down, one.time, one.signal, fit.fitted, title=one.name
            ),
        )
        for one, fit in pairs
    ]
    return modes_report(study, result, parts)


def reading(study: ModeStudy) -> list[str]:
    """Ring-downs in words, line by line."""
    lines: list[str] = []
    rings: Any = study.measured
    for one in rings:
        first, last = one.time[[0, -1]].tolist()
        head = f"{len(one.time)} samples from {first:.4g} to {last:.4g} s"
        lines += vibration_reading(head, one)
    return lines
