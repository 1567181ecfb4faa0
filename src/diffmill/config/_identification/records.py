"""Records of forces made ready: read, beside what was cut, without their offset."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence

from ..._job import Job
from ...identification import ForceRecord, ForceSettings, Record, StraightCut
from ...io import RecordError, load_record
from .._schema.cutter import CutterTable, make_cutter
from .._schema.job import SpindleTable
from .context import Context
from .cut_selection import engaged, find_cuts, span_of, tare_of, unbroken_spans
from .schema import CutTable, FitTable, RecordTable
from .spindle_angle import spindle_angle

# Names of the forces that are allowed beside those of `load_record`.
_ALIASES = {"force_x": "Fx", "force_y": "Fy", "force_z": "Fz"}
# Revolutions that a fit needs at least.
_LEAST_TURNS = 3.0
# Keys of a straight cut.
_SIZES = ("feed_per_tooth", "axial_depth", "radial_depth", "side", "speed")


def with_straight_cut(
    context: Context,
    cutter: CutterTable | None,
    spindle: SpindleTable | None,
    cut: CutTable | None,
) -> Context:
    """Context with the cutter, the speed and the depths of straight cuts.

    Args:
        context: Folder and problems.
        cutter: `[cutter]`.
        spindle: `[spindle]`.
        cut: `[cut]`.
    """
    return dataclasses.replace(
        context,
        cutter=None if cutter is None else make_cutter(cutter),
        speed=None if spindle is None else spindle.speed,
        cut=cut,
    )


def force_settings(table: FitTable) -> ForceSettings:
    """Settings of a force fit."""
    axes = table.axes
    return ForceSettings(
        axes=(axes[0], axes[1], axes[2]) if isinstance(axes, list) else None,
        takes_proposed=axes == "proposed",
        loss=table.loss,
        refine=tuple(table.refine),
        shift_range=table.shift_range,
        lowpass=table.lowpass,
        refines_speed=table.refine_speed,
        force_on=table.force_on,
        has_offset=table.has_offset,
        has_drift=table.has_drift,
    )


def read_force_records(
    entries: Sequence[RecordTable] | None,
    fit: FitTable | None,
    context: Context,
    *,
    has_jobs: bool,
) -> tuple[ForceRecord, ...]:
    """Records of forces on the tool, without those whose problems were noted.

    Args:
        entries: The tables `[[record]]`.
        fit: `[fit]`, which may say that the recorded forces are those on the workpiece.
        context: What the records share.
        has_jobs: Whether a record may be of a job.
    """
    records = []
    for number, entry in enumerate(entries or (), 1):
        place = f"[[record]] {number}"
        if entry.job is not None and not has_jobs:
            context.problems.append(
                f"{place} job: found beside mean forces, which are those of straight "
                'cuts; allowed with kind = "force_records"'
            )
        elif entry.job is None and (entry.speed or context.speed) is None:
            context.problems.append(
                f"{place} speed: found nothing, but it is required here or in "
                '[spindle] for a straight cut, such as "6000 rpm"'
            )
        record = read_force_record(entry, place, context)
        if record is not None:
            records.append(record)
    if fit is not None and fit.force_on == "workpiece":
        records = [record.reversed() for record in records]
    return tuple(records)


def read_force_record(
    table: RecordTable, place: str, context: Context
) -> ForceRecord | None:
    """Record ready to be fitted, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry, such as "[[record]] 1".
        context: What the records share.
    """
    process = _process(table, place, context)
    path = context.file(table.file, f"{place} file")
    if path is None:
        return None
    channels = {_ALIASES.get(k, k): v for k, v in (table.channels or {}).items()}
    units = {_ALIASES.get(k, k): v for k, v in table.units.items()}
    try:
        record = load_record(path, channels, table.rate, units)
    except RecordError as error:
        lines = [f"{place} file: {path.name}: {fault}" for fault in error.faults]
        context.problems.extend(lines)
        return None
    if process is None:
        return None
    return _ready(record, process, table, place, context.problems)


def _ready(
    record: Record,
    process: Job | StraightCut,
    table: RecordTable,
    place: str,
    problems: list[str],
) -> ForceRecord | None:
    """Record with its cut found and its tare removed.

    Args:
        record: The record as read.
        process: What was cut.
        table: Its checked entry.
        place: What a line calls the entry.
        problems: Receives what is wrong.
    """
    # Without a speed a tooth period has as many samples as it needs.
    tooth, flute_count = 4 / record.rate, 1
    if isinstance(process, Job):
        tooth = float(process.tooth_period)
    elif process.spindle_speed is not None:
        flute_count = process.cutter.flute_count
        tooth = 2 * math.pi / (process.spindle_speed * flute_count)
    if record.rate * tooth < 4:
        hint = "".join(
            f'. {note} Give its unit by `units`, such as {{ time = "ms" }}'
            for note in record.notes
            if "was taken in s" in note
        )
        problems.append(
            f"{place} file: found {record.rate:g} samples per second, but at least "
            f"{4 / tooth:g} are required: four per tooth{hint}"
        )
        return None
    visible_cuts = find_cuts(record, tooth)
    cuts = visible_cuts or unbroken_spans(record, tooth)
    notes = list(record.notes)
    count = len(problems)
    angle = spindle_angle(record, process, table, place, problems, notes)
    if isinstance(process, StraightCut) and table.time_shift is not None:
        problems.append(
            f"{place} time_shift: found beside a straight cut, which has no clock of "
            "its own; leave it out, or give a tacho and tooth_angle"
        )
    if table.tare_after is not None and not isinstance(table.tare, list):
        problems.append(
            f"{place} tare_after: found without a section in tare, but only both of "
            "them show the drift; give both, or none to have them looked for"
        )
    span = span_of(record, process, table, cuts, place, problems)
    if span is None:
        return None
    try:
        tare = tare_of(record, table, visible_cuts, span, tooth, notes)
        quiet = record if tare is None else record.without(tare)
        start, stop = engaged(process, table, span, record, notes)
        used = quiet.section(start, stop)
    except ValueError as error:
        problems.append(f"{place}: {error}")
        return None
    turn = tooth * flute_count
    if isinstance(process, StraightCut) and stop - start < _LEAST_TURNS * turn:
        problems.append(
            f"{place}: found {stop - start:.4g} s of steady cut, but at least "
            f"{_LEAST_TURNS:g} revolutions, {_LEAST_TURNS * turn:.4g} s, are required"
        )
    if len(problems) > count:
        return None
    number = f", cut {table.cut}" if isinstance(table.cut, int) else ""
    return ForceRecord(
        name=f"{pathlib.PurePath(table.file).name}{number}",
        record=quiet,
        process=process,
        start=start,
        stop=stop,
        time_shift=table.time_shift,
        is_saturated=bool(used.is_saturated.any()),
        angle=angle,
        knows_tooth=angle is not None and table.tooth_angle is not None,
        notes=tuple(notes),
        tare=tare,
    )


def _process(
    table: RecordTable, place: str, context: Context
) -> Job | StraightCut | None:
    """Process that was recorded: a job, or a straight cut; None with problems noted."""
    problems = context.problems
    sizes = [k for k in _SIZES if getattr(table, k) is not None]
    if table.job is not None:
        if sizes:
            problems.append(
                f"{place} job: found beside {', '.join(sizes)}, but a job says all of "
                "that: only one of both is allowed"
            )
            return None
        return context.job(table.job, f"{place} job")
    if context.cutter is None or (context.cut is None and table.axial_depth is None):
        problems.append(
            f"{place}: found no job, but it is required, or the tables [cutter], "
            "[spindle] and [cut] of a straight cut"
        )
        return None
    if table.feed_per_tooth is None:
        problems.append(
            f"{place} feed_per_tooth: found nothing, but it is required for a straight "
            'cut: a length, such as "0.1 mm"'
        )
        return None
    cut = context.cut
    side = table.side or (cut.side if cut is not None else "slot")
    width = table.radial_depth or (cut.radial_depth if cut is not None else None)
    depth = table.axial_depth or (cut.axial_depth if cut is not None else None)
    assert depth is not None
    straight = StraightCut(
        cutter=context.cutter,
        spindle_speed=table.speed or context.speed,
        feed_per_tooth=table.feed_per_tooth,
        axial_depth=depth,
        radial_depth=width,
        side=side,
    )
    return straight if check_straight(straight, place, problems) else None


def check_straight(cut: StraightCut, place: str, problems: list[str]) -> bool:
    """True if the sizes of a straight cut are possible; others are noted."""
    diameter = 2 * float(cut.cutter.nominal_radius)
    count = len(problems)
    if cut.axial_depth > float(cut.cutter.flute_length):
        problems.append(
            f"{place} axial_depth: found {cut.axial_depth * 1e3:g} mm; at most the "
            f"flute length, {float(cut.cutter.flute_length) * 1e3:g} mm, is allowed"
        )
    if cut.feed_per_tooth >= diameter / 4:
        problems.append(
            f"{place} feed_per_tooth: found {cut.feed_per_tooth * 1e3:g} mm; less than "
            f"a quarter of the diameter, {diameter * 250:g} mm, is required"
        )
    if (cut.radial_depth is None) != (cut.side == "slot"):
        found = "nothing" if cut.radial_depth is None else "a radial depth"
        problems.append(
            f'{place} radial_depth: found {found} beside side = "{cut.side}"; it is '
            'required for "up" and "down" and not allowed for "slot"'
        )
    else:
        try:
            StraightCut.immersion(diameter, cut.radial_depth, cut.side)
        except ValueError:
            width = (cut.radial_depth or 0) * 1e3
            problems.append(
                f"{place} radial_depth: found {width:g} mm; at most the diameter, "
                f"{diameter * 1e3:g} mm, is allowed"
            )
    return len(problems) == count
