"""The part of a record in which the tool cuts, and those in which it does not."""

import math

from ..._job import Job
from ...identification import (
    CutSpan,
    Record,
    StraightCut,
)
from .schema import RecordTable

# Shortest section that a tare is taken from, in tooth periods and samples; a gap or a
# pause so many tooth periods long parts two cuts.
_TARE_PERIODS, _TARE_SAMPLES = 4.0, 20
# Cuts that are listed in a message at most.
_LISTED = 8


def find_cuts(record: Record, tooth_period: float) -> list[CutSpan]:
    """Cuts that stand out in a record; none if it shows no quiet part beside them."""
    window = _TARE_PERIODS * tooth_period
    cuts = CutSpan.find(record, tooth_frequency=1 / tooth_period, window=window)
    cuts = cuts or CutSpan.find(record, window=window)
    return [] if cuts == unbroken_spans(record, tooth_period) else cuts


def unbroken_spans(record: Record, tooth_period: float) -> list[CutSpan]:
    """Parts of a record between long gaps: each of them is a cut of its own."""
    return [
        CutSpan(float(record.time[p.start]), float(record.time[p.stop - 1]))
        for p in record.parts_between_gaps(longest=_TARE_PERIODS * tooth_period)
    ]


def span_of(
    record: Record,
    process: Job | StraightCut,
    table: RecordTable,
    cuts: list[CutSpan],
    place: str,
    problems: list[str],
) -> CutSpan | None:
    """Part of the record that belongs to the cut; None with a problem noted."""
    first, last = float(record.time[0]), float(record.time[-1])
    if table.start is not None or table.stop is not None:
        start = first if table.start is None else max(table.start, first)
        stop = last if table.stop is None else min(table.stop, last)
        if start >= stop:
            problems.append(
                f"{place} start, stop: found {start:g} s and {stop:g} s, but a part "
                f"within {first:g} s to {last:g} s is required"
            )
            return None
        return CutSpan(start, stop)
    if isinstance(table.cut, int):
        if table.cut > len(cuts):
            problems.append(
                f"{place} cut: found {table.cut}, but the record has {_cuts_text(cuts)}"
            )
            return None
        return cuts[table.cut - 1]
    if isinstance(process, Job):
        # A job may be idle between cuts, and what is before the first is quiet.
        return CutSpan(first, last)
    if len(cuts) > 1 and table.cut != "all":
        problems.append(
            f"{place} cut: found nothing, but the record has {_cuts_text(cuts)}; name "
            "one by its number, an entry for each, or give start and stop"
        )
        return None
    return CutSpan(cuts[0].start, cuts[-1].stop)


def _cuts_text(cuts: list[CutSpan]) -> str:
    shown = ", ".join(
        f"{i} from {cut.start:.4g} to {cut.stop:.4g} s"
        for i, cut in enumerate(cuts[:_LISTED], 1)
    )
    more = ", ..." if len(cuts) > _LISTED else ""
    return f"{len(cuts)} cut{'s' * (len(cuts) > 1)} ({shown}{more})"


def tare_of(
    record: Record,
    table: RecordTable,
    cuts: list[CutSpan],
    span: CutSpan,
    tooth: float,
    notes: list[str],
) -> Record.Tare | None:
    """Offset and drift of the record, None if none are removed; the reason is noted.

    Raises:
        ValueError: A section that the table names holds fewer than two samples.
    """
    if table.tare == "none":
        return None
    if table.tare is not None:
        after = slice(*table.tare_after) if isinstance(table.tare_after, list) else None
        return record.tare(slice(table.tare[0], table.tare[1]), after)
    before, after = _quiet(record, cuts, span, tooth)
    if before is not None and after is not None:
        notes.append(
            f"Offset and drift were taken from {before.start:.4g} to "
            f"{before.stop:.4g} s and {after.start:.4g} to {after.stop:.4g} s, where "
            "nothing is cut."
        )
        return record.tare(before, after)
    one = before or after
    if one is None:
        notes.append(
            "No section without a cut was found: no offset was removed. Of a whole "
            "record it is fitted, and hides K_ae where an edge is always in the cut; "
            "of mean forces it goes into the edge coefficients. Name a section by "
            "`tare`."
        )
        return None
    notes.append(
        f"The offset was taken from {one.start:.4g} to {one.stop:.4g} s, where nothing "
        "is cut."
    )
    return record.tare(one)


def _quiet(
    record: Record, cuts: list[CutSpan], span: CutSpan, tooth: float
) -> tuple[slice | None, slice | None]:
    """Sections without a cut before and after a part of the record."""
    if not cuts:
        return None, None
    guard = 2 * _TARE_PERIODS * tooth
    least = max(_TARE_PERIODS * tooth, _TARE_SAMPLES / record.rate)
    first, last = float(record.time[0]), float(record.time[-1])
    inside = [c for c in cuts if c.stop > span.start and c.start < span.stop] or cuts
    begin, end = inside[0].start, inside[-1].stop
    earlier = max([c.stop for c in cuts if c.stop < begin], default=None)
    later = min([c.start for c in cuts if c.start > end], default=None)
    before = (first if earlier is None else earlier + guard, begin - guard)
    after = (end + guard, last if later is None else later - guard)
    sections = []
    for a, b in (before, after):
        count = int(((record.time >= a) & (record.time <= b)).sum())
        is_long = b - a >= least and count >= _TARE_SAMPLES
        sections.append(slice(a, b) if is_long else None)
    return sections[0], sections[1]


def engaged(
    process: Job | StraightCut,
    table: RecordTable,
    span: CutSpan,
    record: Record,
    notes: list[str],
) -> tuple[float, float]:
    """Start and end [s] of the part of a straight cut with full engagement."""
    start, stop = span.start, span.stop
    speed = getattr(process, "spindle_speed", None)
    is_chosen = table.start is not None or table.stop is not None
    if isinstance(process, Job) or speed is None or is_chosen:
        return start, stop
    # The tool is in full engagement once its axis has passed the edge of the stock.
    feed = process.feed_per_tooth * process.cutter.flute_count * speed / (2 * math.pi)
    travel = 1.1 * float(process.cutter.nominal_radius) / feed
    step = 2 / record.rate
    ends = []
    if start > record.time[0] + step:
        start, ends = start + travel, ["entry"]
    if stop < record.time[-1] - step:
        stop, ends = stop - travel, [*ends, "exit"]
    if ends:
        notes.append(
            f"{travel:.4g} s were left out at {' and '.join(ends)}, while the tool is "
            "not fully engaged."
        )
    if start >= stop:
        raise ValueError(
            f"found a cut of {span.stop - span.start:.4g} s, but a tool of this radius "
            f"is not fully engaged for {travel:.4g} s at its {' and '.join(ends)}; "
            "look at feed, speed and diameter, or give start and stop"
        )
    return float(start), float(stop)
