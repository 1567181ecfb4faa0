"""Reports of what measured parts show, and of what to measure next."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...viz import CAUSES, StudyReport, StudyTable, Verdict
from .._identify.report import EstimatedValue, estimate_table

if TYPE_CHECKING:
    from ...config import MeasuredJob
    from ...learning import Advice, LearnedMachine

_ASSUMED = (
    "Parameters have normal priors of the stated sizes, and errors are linear in them "
    "about the parts that were cut.",
    "What no parameter explains repeats along the path of this program, and is smooth "
    "over a length that the parts themselves tell.",
    "The machine is the same for all parts: nothing wears or warms in between.",
)
_CAPTIONS = {
    "causes": "Error of the last command by cause, where the tool cuts, each alone; "
    "some cancel.",
    "learnt": "Parameters as the parts show them, in units of their priors. One whose "
    "interval is as wide as before is not told by them.",
}
# Factor from SI and unit of a parameter, by its unit.
SHOWN = {"1": (100.0, "%"), "rad": (1e6, "urad"), "m": (1e6, "um")}
# What was observed in words, with factor from SI and unit.
OBSERVED = {
    "tip": ("tip", 1e6, "um"),
    "wall": ("points of walls", 1e6, "um"),
    "arm": ("tip as encoders place it", 1e6, "um"),
    "force": ("force", 1.0, "N"),
}
# Share of its prior variance above which a parameter counts as open.
OPEN = 0.5


def learnt_report(
    measured: "MeasuredJob", found: "LearnedMachine", lines: Sequence[str]
) -> StudyReport:
    """Report of what parts show.

    Args:
        measured: The parts.
        found: What was learnt.
        lines: The summary of the terminal.
    """
    estimates = []
    for one in found.values():
        scale, unit = SHOWN.get(one.unit, (1.0, one.unit))
        is_known = one.open_share < OPEN
        value = scale * one.value if is_known else np.nan
        before = f"before: 0 +- {scale * one.size:.3g}"
        estimates.append(
            EstimatedValue(one.name, value, scale * one.error, unit, before)
        )
    known = [one for one in estimates if one.is_known]
    left = ", ".join(one.name for one in estimates if not one.is_known)
    table = estimate_table(known)
    if left:
        note = f"Not told by these parts, so as before: {left}."
        table = dataclasses.replace(table, note=note)
    causes = sorted(found.causes().items(), key=lambda one: -one[1])
    verdict = Verdict(
        None,
        "Nothing beyond the model",
        "The parts show nothing that the model does not know.",
    )
    if found.is_known_better:
        verdict = Verdict(
            True,
            "Learnt",
            f"What the parts show is exp({found.gain:.3g}) times as likely with the "
            f"machine that was learnt; {len(known)} of {len(estimates)} parameters are "
            "known better than half of what was not known.",
        )
    return StudyReport(
        kind="Learning",
        title=measured.job.name,
        asked=(
            "What the machine does beyond its model, as these parts show it:",
            *measured.part_names,
        ),
        verdict=verdict,
        tables=(
            _explained_table(measured, found),
            StudyTable(
                "Causes",
                ("cause", "across the path [um rms]"),
                tuple((CAUSES[name], f"{1e6 * size:.3g}") for name, size in causes),
                "Where the tool cuts, each alone.",
            ),
            table,
        ),
        assumptions=_ASSUMED,
        notes=(*measured.job.notes, *measured.notes),
        text="\n".join(lines),
        source=measured.source,
        captions=_CAPTIONS,
    )


def advice_report(
    measured: "MeasuredJob", ranked: "Sequence[Advice]", lines: Sequence[str]
) -> StudyReport:
    """Report of what measurements would leave unknown.

    Args:
        measured: The parts, if there are any, and the trials.
        ranked: The trials, the best first; the last is none.
        lines: The summary of the terminal.
    """
    best, none = ranked[0], ranked[-1]
    rows = tuple(
        (one.name or "without another measurement", f"{1e6 * one.spread:.3g}")
        for one in ranked
    )
    verdict = Verdict(
        None,
        f"Measure next: {best.name}" if best.name else "Nothing to measure",
        f"It would leave {1e6 * best.spread:.3g} um rms across the path of the part "
        f"unknown; without it {1e6 * none.spread:.3g} um are.",
    )
    header = ("measurement", "left unknown [um rms]")
    return StudyReport(
        kind="Advice",
        title=measured.job.name,
        asked=("What each measurement would leave unknown of the part.",),
        verdict=verdict,
        tables=(StudyTable("Measurements", header, rows, best=0),),
        assumptions=(
            _ASSUMED[0],
            "What no parameter explains stays unknown after each of them.",
        ),
        notes=(*measured.job.notes, *measured.notes),
        text="\n".join(lines),
        source=measured.source,
    )


def _explained_table(measured: "MeasuredJob", found: "LearnedMachine") -> StudyTable:
    """Sizes of what was measured, and of what is left of it."""
    rows = []
    for one in found.explained:
        what, scale, unit = OBSERVED[one.observed]
        sizes = (one.beyond_model, one.beyond_machine, one.beyond_process, one.noise)
        part = measured.part_names[one.part - 1]
        rows.append((part, what, *(f"{scale * x:.3g}" for x in sizes), unit))
    header = (
        *("part", "what", "beyond the model", "beyond the machine"),
        *("beyond the process", "noise", "unit"),
    )
    note = "Root mean squares of what was measured, and of what is left of it."
    return StudyTable("What the parts show", header, tuple(rows), note)
