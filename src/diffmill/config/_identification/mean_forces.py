"""Mean forces over the feed: from a table, or of records of one feed each."""

import dataclasses
from typing import NamedTuple

import numpy as np
from pydantic import Field

from ...identification import (
    ForceRecord,
    ForceSettings,
    MeanForceStudy,
    Record,
    StraightCut,
)
from ...io import Quantity, RecordError, TableReader
from ...settings.fields import Force, PositiveLength
from ...units import FORCE, LENGTH
from .._schema.cutter import CutterTable
from .._schema.job import SpindleTable
from .context import Context
from .kind import IdentificationKind
from .records import (
    check_straight,
    force_settings,
    read_force_records,
    with_straight_cut,
)
from .schema import CutTable, FitTable, MeasuredTable, RecordTable

_FEED = Quantity(
    "feed_per_tooth",
    r"f_?z|feed|feed[ _]?per[ _]?tooth|vorschub|zahnvorschub",
    (LENGTH,),
    ("feed_per_tooth",),
)
_FORCES = tuple(
    q._replace(pattern=rf"(mean[ _]?)?({q.pattern})([ _]?mean)?")
    for q in Quantity.vector("F", "f|force|kraft", FORCE, "force")
)
_KEYS = tuple(q.key for q in (_FEED, *_FORCES))


class MeansTable(MeasuredTable):
    """`[means]`: mean forces over the feed, in the file or in another one."""

    feed_per_tooth: list[PositiveLength] | None = Field(
        default=None,
        description='feeds per tooth, such as ["0.05 mm", ...]; with Fx, Fy and Fz '
        "required without file",
    )
    Fx: list[Force] | None = Field(
        default=None,
        description='mean forces along x at the feeds, such as ["107 N", ...]',
    )
    Fy: list[Force] | None = Field(
        default=None,
        description='mean forces along y at the feeds, such as ["107 N", ...]',
    )
    Fz: list[Force] | None = Field(
        default=None,
        description='mean forces along z at the feeds, such as ["107 N", ...]',
    )


class _Means(NamedTuple):
    """Mean forces [N], shape (feed, 3), over the feed per tooth [m]."""

    feeds: np.ndarray
    force: np.ndarray
    records: tuple[ForceRecord, ...] = ()
    notes: tuple[str, ...] = ()
    channels: tuple[Record.Channel, ...] = ()


def _read(
    name: str,
    context: Context,
    *,
    cutter: CutterTable | None = None,
    cut: CutTable | None = None,
    means: MeansTable | None = None,
    record: list[RecordTable] | None = None,
    spindle: SpindleTable | None = None,
    fit: FitTable | None = None,
) -> MeanForceStudy | None:
    """Study of mean forces of a table, or of records; None with problems noted."""
    context = with_straight_cut(context, cutter, spindle, cut)
    records = read_force_records(record, fit, context, has_jobs=False)
    fit = FitTable() if fit is None else fit
    context.problems.extend(
        f"[fit] {key}: found beside mean forces, which it does not change; "
        'allowed with kind = "force_records"'
        for key in ("loss", "refine", "shift_range", "lowpass")
        if key in fit.model_fields_set
    )
    if means is not None and "refine_speed" in fit.model_fields_set:
        context.problems.append(
            "[fit] refine_speed: found beside [means], which has no record to take the "
            "speed from; allowed with [[record]]"
        )
    study = _study(
        name, means, None if record is None else records, force_settings(fit), context
    )
    if study is not None and record is None and fit.force_on == "workpiece":
        study = dataclasses.replace(study, mean_force=-study.mean_force)
    return study


def _study(
    name: str,
    table: MeansTable | None,
    records: tuple[ForceRecord, ...] | None,
    settings: ForceSettings,
    context: Context,
) -> MeanForceStudy | None:
    """Study of mean forces as they were recorded, or None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[means]`, or None.
        records: The records, each with a feed; None if the file has none.
        settings: Settings of the fit.
        context: Cutter, cut and problems.
    """
    problems = context.problems
    if (table is None) == (records is None):
        if table is None and problems:
            # A table with a fault of its own has been reported.
            return None
        found = "neither" if table is None else "both"
        problems.append(
            f"[means], [[record]]: found {found}, but exactly one of a table of means "
            "and of records with a feed each is required"
        )
        return None
    if context.cutter is None or context.cut is None:
        return None
    if table is not None:
        means = _of_table(table, context)
    else:
        means = _of_records(records or (), problems)
    if means is None or problems:
        return None
    feeds = means.feeds
    if np.unique(feeds).size < 2 or not np.all(feeds > 0):
        problems.append(
            f"[means] feed_per_tooth: found {np.unique(feeds).size} different feeds, "
            "but at least two above 0 are required for a line"
        )
        return None
    cut = StraightCut(
        cutter=context.cutter,
        spindle_speed=context.speed,
        feed_per_tooth=float(feeds.max()),
        axial_depth=context.cut.axial_depth,
        radial_depth=context.cut.radial_depth,
        side=context.cut.side,
    )
    if means.records and isinstance(means.records[0].process, StraightCut):
        cut = means.records[0].process
    if not check_straight(cut, "[cut]", problems):
        return None
    order = np.argsort(feeds, kind="stable")
    in_order = tuple(means.records[i] for i in order) if means.records else ()
    return MeanForceStudy(
        name=name,
        cut=cut,
        feed_per_tooth=feeds[order],
        mean_force=means.force[order],
        records=in_order,
        settings=settings,
        notes=means.notes,
        channels=means.channels,
    )


def _of_records(records: tuple[ForceRecord, ...], problems: list[str]) -> _Means | None:
    """Means of records, each with its notes; None with problems noted."""
    for place, one in enumerate(records, 1):
        seen = zip("xyz", one.record.is_measured, strict=True)
        if lost := [f"F{axis}" for axis, is_measured in seen if not is_measured]:
            problems.append(
                f"[[record]] {place} channels: found no {', '.join(lost)}, but "
                'mean forces need all three; kind = "force_records" fits two, too'
            )
    cuts = [r.process for r in records if isinstance(r.process, StraightCut)]
    if len({(cut.axial_depth, cut.radial_depth, cut.side) for cut in cuts}) > 1:
        problems.append(
            "[[record]]: found different depths or sides, but mean forces over the "
            'feed need one cut; kind = "force_records" fits them jointly'
        )
        return None
    means, noted = [], []
    for one, cut in zip(records, cuts, strict=True):
        mean = one.record.mean_over_turns(one.start, one.stop, cut.spindle_speed)
        means.append(mean.force)
        noted.append(dataclasses.replace(one, notes=(*one.notes, *mean.notes)))
    feeds = np.array([cut.feed_per_tooth for cut in cuts])
    return _Means(feeds, np.array(means).reshape(-1, 3), tuple(noted))


def _of_table(table: MeansTable, context: Context) -> _Means | None:
    """Feeds and forces of `[means]`, or None with problems noted."""
    problems = context.problems
    given = [key for key in _KEYS if getattr(table, key) is not None]
    if table.file is not None:
        if given:
            problems.append(
                f"[means] file: found beside {', '.join(given)}; only one is allowed"
            )
            return None
        return context.read(table, "[means]", _of_file)
    problems += [
        f"[means] {key}: found without a file, but lists have their own names and "
        "units; allowed with file"
        for key in ("channels", "units")
        if key in table.model_fields_set
    ]
    lost = [key for key in _KEYS if key not in given]
    counts = {key: len(getattr(table, key)) for key in given}
    if lost:
        problems.append(
            f"[means]: found no {', '.join(lost)}, but a file is required, or "
            f"{', '.join(_KEYS)}"
        )
        return None
    if len(set(counts.values())) > 1:
        found = ", ".join(f"{key} {count}" for key, count in counts.items())
        problems.append(f"[means]: found lists of different lengths: {found}")
        return None
    feeds, *forces = (np.array(getattr(table, key)) for key in _KEYS)
    return _complete(feeds, np.column_stack(forces), [])


def _of_file(reader: TableReader) -> _Means:
    """Columns of a table of mean forces.

    Raises:
        RecordError: One is missing.
    """
    reader.allow((_FEED, *_FORCES))
    values = {q.key: reader.values(q) for q in (_FEED, *_FORCES)}
    found = [one for one in values.values() if one is not None]
    lost = [key for key, column in values.items() if column is None]
    if any(reader.is_excluded(key) for key in lost):
        reader.faults.append(
            f"found no {', '.join(lost)}, but mean forces need the feed and all three "
            'forces; records with kind = "force_records" need not have all.'
        )
    if lost and not reader.faults:
        reader.faults.append(
            f"found no column for {', '.join(lost)}; name it by `channels`."
        )
    reader.check()
    if any("taken in m" in note for note in reader.notes) and found[0].max() > 0.01:
        fault = (
            "the feed has no unit and is larger than 10 mm in m: write its unit in "
            "the header, such as `fz_mm`."
        )
        raise RecordError(reader.name, [fault])
    means = _complete(found[0], np.column_stack(found[1:]), reader.notes)
    return means._replace(channels=tuple(reader.read))


def _complete(feeds: np.ndarray, force: np.ndarray, notes: list[str]) -> _Means:
    """Rows that have all values."""
    good = np.isfinite(force).all(axis=1) & np.isfinite(feeds)
    if not good.all():
        rows = ", ".join(map(str, (np.flatnonzero(~good) + 1).tolist()))
        notes = [*notes, f"Rows {rows} have empty cells and were left out."]
    return _Means(feeds[good], force[good], notes=tuple(notes))


KIND = IdentificationKind(
    "mean_forces",
    required={"cutter": CutterTable, "cut": CutTable},
    optional={
        "means": MeansTable,
        "record": [RecordTable],
        "spindle": SpindleTable,
        "fit": FitTable,
    },
    read=_read,
)
