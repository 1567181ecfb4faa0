"""Mean forces over the feed: from a table, or of records of one feed each."""

import numpy as np

from ...io import RecordError, check_keys, column_of, read_table
from ...units import FORCE, LENGTH
from .._build.program import file_in_folder
from .force_records import Context, check_straight
from .mean_over_revolutions import mean_over_turns
from .schema import MeansTable
from .tasks import ForceRecord, ForceSettings, MeanForceTask, StraightCut

_FEED = r"f_?z|feed|feed[ _]?per[ _]?tooth|vorschub|zahnvorschub"


def mean_force_task(
    name: str,
    table: MeansTable | None,
    records: tuple[ForceRecord, ...],
    rest: tuple[Context, ForceSettings, bool],
    problems: list[str],
) -> MeanForceTask | None:
    """Return mean forces of a table, or of records; None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[means]`, or None.
        records: The records, each with a feed.
        rest: What the records share, the settings, and whether records were given.
        problems: Receives what is wrong.
    """
    context, settings, has_records = rest
    if (table is None) != has_records:
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
    notes: list[str] = []
    if table is None:
        of_records = _means_of_records(records, problems)
        if of_records is None:
            return None
        feeds, force, records = of_records
    else:
        both = _mean_table(table, context, problems, notes)
        if both is None:
            return None
        feeds, force = both
    if problems:
        return None
    if np.unique(feeds).size < 2 or not np.all(feeds > 0):
        problems.append(
            f"[means] feed_per_tooth: found {np.unique(feeds).size} different feeds, "
            "but at least two above 0 are required for a line"
        )
        return None
    sizes = (context.cut.axial_depth, context.cut.radial_depth, context.cut.side)
    cut = StraightCut(context.cutter, context.speed, *sizes, float(feeds.max()))
    if records and isinstance(records[0].process, StraightCut):
        cut = records[0].process
    if not check_straight(cut, "[cut]", problems):
        return None
    order = np.argsort(feeds, kind="stable")
    sorted_records = tuple(records[i] for i in order) if records else ()
    return MeanForceTask(
        name, cut, feeds[order], force[order], sorted_records, settings, tuple(notes)
    )


def _means_of_records(
    records: tuple[ForceRecord, ...], problems: list[str]
) -> tuple[np.ndarray, np.ndarray, tuple[ForceRecord, ...]] | None:
    """Return feeds, forces and records with what is to be said of their means."""
    for place, one in enumerate(records, 1):
        seen = zip("xyz", one.record.is_measured, strict=True)
        if lost := [f"F{axis}" for axis, is_measured in seen if not is_measured]:
            problems.append(
                f"[[record]] {place} channels: found no {', '.join(lost)}, but "
                'mean forces need all three; kind = "force_records" fits two, too'
            )
    cuts = [r.process for r in records if isinstance(r.process, StraightCut)]
    means = [mean_over_turns(record) for record in records]
    alike = {cut._replace(feed_per_tooth=0.0)[2:5] for cut in cuts}
    if len(alike) > 1:
        problems.append(
            "[[record]]: found different depths or sides, but mean forces over the "
            'feed need one cut; kind = "force_records" fits them jointly'
        )
        return None
    return (
        np.array([cut.feed_per_tooth for cut in cuts]),
        np.array([one for one, _ in means]).reshape(-1, 3),
        tuple(
            record._replace(notes=(*record.notes, *said))
            for record, (_, said) in zip(records, means, strict=True)
        ),
    )


def _mean_table(
    table: MeansTable, context: Context, problems: list[str], notes: list[str]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return feeds and forces of `[means]`, or None with problems noted."""
    keys = ("feed_per_tooth", "Fx", "Fy", "Fz")
    given = [key for key in keys if getattr(table, key) is not None]
    if table.file is None:
        lost = [key for key in keys if key not in given]
        counts = {key: len(getattr(table, key)) for key in given}
        if lost:
            problems.append(
                f"[means]: found no {', '.join(lost)}, but a file is required, or "
                f"{', '.join(keys)}"
            )
            return None
        if len(set(counts.values())) > 1:
            found = ", ".join(f"{key} {count}" for key, count in counts.items())
            problems.append(f"[means]: found lists of different lengths: {found}")
            return None
        values = {key: np.array(getattr(table, key)) for key in keys}
    else:
        if given:
            problems.append(
                f"[means] file: found beside {', '.join(given)}; only one is allowed"
            )
            return None
        found = _mean_file(table, context, problems, notes)
        if found is None:
            return None
        values = found
    force = np.column_stack([values[key] for key in keys[1:]])
    good = np.isfinite(force).all(axis=1) & np.isfinite(values["feed_per_tooth"])
    if not good.all():
        rows = ", ".join(map(str, (np.flatnonzero(~good) + 1).tolist()))
        notes.append(f"Rows {rows} have empty cells and were left out.")
    return values["feed_per_tooth"][good], force[good]


def _mean_file(
    table: MeansTable, context: Context, problems: list[str], notes: list[str]
) -> dict[str, np.ndarray] | None:
    """Return the columns of a table of mean forces."""
    assert table.file is not None
    place = "[means] file"
    path = file_in_folder(
        table.file, place, context.folder, problems, allow_outside=context.allow_outside
    )
    if path is None:
        return None
    faults: list[str] = []
    wanted = dict(table.channels or {})
    patterns = {
        "feed_per_tooth": (LENGTH, _FEED),
        **{
            f"F{a}": (FORCE, rf"(mean[ _]?)?(f|force|kraft)[\s_.\-]*{a}([ _]?mean)?")
            for a in "xyz"
        },
    }
    values = {}
    try:
        found = read_table(path)
        notes.extend(found.notes)
        check_keys("unit of", table.units, ("feed_per_tooth", "force"), faults)
        for key, (kind, pattern) in patterns.items():
            unit = table.units.get("force" if kind is FORCE else key)
            column = column_of(
                found, key, (kind,), pattern, wanted, faults, notes, unit
            )
            if column is not None:
                values[key] = column
        unitless = [n for n in notes if "taken in m" in n]
        if unitless and values["feed_per_tooth"].max() > 0.01:
            faults.append(
                "the feed has no unit and is larger than 10 mm in m: write its unit in "
                "the header, such as `fz_mm`."
            )
    except (RecordError, OSError) as error:
        faults = [str(error)]
    lost = [key for key in patterns if key not in values]
    if any(key in wanted and wanted[key] is None for key in lost):
        faults.append(
            f"found no {', '.join(lost)}, but mean forces need the feed and all three "
            'forces; records with kind = "force_records" need not have all.'
        )
    if lost and not faults:
        faults.append(f"found no column for {', '.join(lost)}; name it by `channels`.")
    problems.extend(f"{place}: {table.file}: {fault}" for fault in faults)
    return None if faults else values
