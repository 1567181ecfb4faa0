"""Reports of feed studies: the feeds of a table, and the fastest one."""

from typing import TYPE_CHECKING

import numpy as np

from ...viz import StudyReport, StudyTable, Verdict

if TYPE_CHECKING:
    from ..._job import Job
    from ...correction import FastestFeed, FeedTradeoff, TunedFeed

_ASSUMED = (
    "The machine is exactly as modelled; learning or an identification says how far "
    "it is from that.",
    "Coefficients of the force do not change with the feed.",
    "The control keeps the feed that it is told, within the accelerations of the job.",
)
_CAPTIONS = {
    "feed": "Contour error over the cycle time, each point with its override; below it "
    "the overrides along the path, where they were tuned.",
    "fastest": "Largest contour error over the override. Dashed: the tolerance; a "
    "cross breaks a limit, which the first one names.",
}


def tradeoff_report(
    job: "Job", tradeoff: "FeedTradeoff", tuned: "TunedFeed | None", text: str
) -> StudyReport:
    """Report of the errors and times of several feeds.

    Args:
        job: The job.
        tradeoff: The job at all feeds.
        tuned: The job with its feed tuned, or None.
        text: The summary of the terminal.
    """
    order = np.argsort(tradeoff.override)
    rows = [
        (
            f"{tradeoff.override[k]:g}",
            f"{tradeoff.cycle_time[k]:.2f}",
            f"{1e3 * tradeoff.feed_per_tooth[k]:.3g}",
            _micrometres(float(tradeoff.uncorrected[k])),
            _micrometres(float(tradeoff.corrected[k])),
            _micrometres(float(tradeoff.max_offset[k])),
        )
        for k in order
    ]
    header = (
        "override",
        "time [s]",
        "feed per tooth [mm]",
        "program, rms [um]",
        "corrected, rms [um]",
        "largest offset [um]",
    )
    note = "Contour error: rms over the length that is cut."
    tables = [StudyTable("Feeds of the whole program", header, tuple(rows), note)]
    if tuned is not None:
        along = [
            (
                f"{one.weight:g}",
                f"{one.cycle_time:.2f}",
                _micrometres(one.rms),
                f"{one.override.min():.2f} to {one.override.max():.2f}",
                "" if one.is_settled else "steps ran out",
            )
            for one in tuned.points[1:]
        ]
        header = ("weight of the time", "time [s]", "rms [um]", "override", "remark")
        tables.append(StudyTable("Overrides along the path", header, tuple(along)))
    least = int(np.argmin(tradeoff.uncorrected))
    found = (
        f"The program leaves {_micrometres(tradeoff.uncorrected[least])} um rms, the "
        f"least, at an override of {tradeoff.override[least]:g} in "
        f"{tradeoff.cycle_time[least]:.2f} s."
    )
    return StudyReport(
        kind="Feed",
        title=job.name,
        asked=("What a slower or faster feed costs in error.",),
        verdict=Verdict(None, "Error against time", found),
        tables=tuple(tables),
        assumptions=_ASSUMED,
        notes=tuple(job.notes),
        text=text,
        source=job.source,
        captions=_CAPTIONS,
    )


def fastest_report(
    job: "Job", found: "FastestFeed", limits: tuple[str, ...], text: str
) -> StudyReport:
    """Report of the fastest feed within limits.

    Args:
        job: The job.
        found: The feeds that were tried.
        limits: The limits, in words.
        text: The summary of the terminal.
    """
    tried = sorted(found.tried, key=lambda one: one.override)
    rows = tuple(
        (
            f"{one.override:.3f}",
            f"{one.cycle_time:.2f}",
            _micrometres(one.error),
            f"{one.force:.0f}" if np.isfinite(one.force) else "-",
            f"{one.power:.0f}" if np.isfinite(one.power) else "-",
            f"{100 * one.joint_speed:.0f}" if one.joint_speed > 0 else "-",
            one.broken or "-",
        )
        for one in tried
    )
    header = (
        "override",
        "time [s]",
        "largest error [um]",
        "largest force [N]",
        "largest power [W]",
        "joint speed [%]",
        "breaks",
    )
    best = None if found.best is None else tried.index(found.best)
    verdict = Verdict(False, "No feed keeps the limits", "The slowest one breaks them.")
    if found.best is not None:
        text_of_next = "the largest that was tried breaks nothing"
        if found.limited_by:
            text_of_next = f"the next larger one breaks: {found.limited_by}"
        verdict = Verdict(
            True,
            f"Override {found.best.override:.3f}"
            if found.along is None
            else f"Override {found.along.min():.2f} to {found.along.max():.2f}",
            f"The program takes {found.best.cycle_time:.2f} s; {text_of_next}.",
        )
    return StudyReport(
        kind="Fastest feed",
        title=job.name,
        asked=("The fastest feed of the whole program within:", *limits),
        verdict=verdict,
        tables=(StudyTable("Feeds that were tried", header, rows, best=best),),
        assumptions=(
            *_ASSUMED,
            "The error grows with the feed; the override is found to 2 %. One that "
            "varies along the path was run, and keeps the limits; it need not be the "
            "fastest of its kind.",
        ),
        notes=tuple(job.notes),
        text=text,
        source=job.source,
        captions=_CAPTIONS,
    )


def _micrometres(length: float) -> str:
    return f"{1e6 * length:.3g}" if np.isfinite(length) else "-"
