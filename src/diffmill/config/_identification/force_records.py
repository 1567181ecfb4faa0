"""Records of forces made ready: read, beside what was cut, without their offset."""

import math
import pathlib

from ..._job import Job
from ...identification import ForceRecord, Record, StraightCut
from ...io import RecordError, load_record
from .context import Context
from .cut_selection import cuts_in, engaged, span_of, tare_of
from .schema import RecordTable
from .spindle_angle import spindle_angle

# Names of the forces that are allowed beside those of `load_record`.
_ALIASES = {"force_x": "Fx", "force_y": "Fy", "force_z": "Fz"}
# Revolutions that a fit needs at least.
_LEAST_TURNS = 3.0


def read_force_record(
    table: RecordTable, place: str, context: Context
) -> ForceRecord | None:
    """Return a record ready to be fitted, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry, such as "[[record]] 1".
        context: What the records share.
    """
    process = _process(table, place, context)
    path = context.file(table.file, f"{place} file")
    if path is None:
        return None
    record = _record(path, table, place, context.problems)
    if record is None or process is None:
        return None
    return _ready(record, process, table, place, context.problems)


def _record(
    path: pathlib.Path, table: RecordTable, place: str, problems: list[str]
) -> Record | None:
    """Return the record of a file, or None with problems noted."""
    channels = {_ALIASES.get(k, k): v for k, v in (table.channels or {}).items()}
    units = {_ALIASES.get(k, k): v for k, v in table.units.items()}
    try:
        return load_record(path, channels, table.rate, units)
    except RecordError as error:
        problems.extend(f"{place} file: {path.name}: {f}" for f in error.faults)
        return None


def _ready(
    record: Record,
    process: Job | StraightCut,
    table: RecordTable,
    place: str,
    problems: list[str],
) -> ForceRecord | None:
    """Return a record with its cut found and its tare removed.

    Args:
        record: The record as read.
        process: What was cut.
        table: Its checked entry.
        place: What a line calls the entry.
        problems: Receives what is wrong.
    """
    tooth = _tooth_period(process, record)
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
    found = cuts_in(record, tooth)
    cuts = found.cuts
    parts = cuts if found.has_quiet else []
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
        tare = tare_of(record, table, parts, span, tooth, notes)
        quiet = record if tare is None else record.without(tare)
        start, stop = engaged(process, table, span, record, notes)
        used = quiet.section(start, stop)
    except ValueError as error:
        problems.append(f"{place}: {error}")
        return None
    turn = tooth * _flute_count(process)
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


def _tooth_period(process: Job | StraightCut, record: Record) -> float:
    """Return the tooth period [s]; without a speed, of as many samples as it needs."""
    if isinstance(process, Job):
        return float(process.tooth_period)
    if process.spindle_speed is None:
        return 4 / record.rate
    return 2 * math.pi / (process.spindle_speed * process.cutter.flute_count)


def _flute_count(process: Job | StraightCut) -> int:
    """Return the number of teeth in a revolution; 1 without a speed."""
    has_speed = isinstance(process, Job) or process.spindle_speed is not None
    return process.cutter.flute_count if has_speed else 1


def _process(
    table: RecordTable, place: str, context: Context
) -> Job | StraightCut | None:
    """Return what was cut."""
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


_SIZES = ("feed_per_tooth", "axial_depth", "radial_depth", "side", "speed")


def check_straight(cut: StraightCut, place: str, problems: list[str]) -> bool:
    """Note sizes that no straight cut has; return whether there are none."""
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
