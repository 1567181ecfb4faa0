"""The program of a job: found, read, timed, with the spindle speed that it implies."""

import math
import pathlib

from ...toolpath import Path, Program, resample, sample_program
from ...io import read_gcode
from ...io import GCodeError
from .._schema.job import ProgramTable
from .context import FileContext
from ...io import PathFileError, read_path_csv

_GCODE_SUFFIXES = (".ngc", ".nc", ".gcode")
# The program and the job state the same speed in different units.
_SAME_SPEED = 1e-6
# Speeds that a message lists.
_LISTED = 8


def read_program(table: ProgramTable, context: FileContext) -> Program | Path | None:
    """Return the program or the recorded path of a job, or None with problems noted."""
    suffix = pathlib.PurePath(table.file).suffix.lower()
    if suffix not in (*_GCODE_SUFFIXES, ".csv"):
        context.problems.append(
            f"[program] file: found {table.file!r}; allowed: "
            f"{', '.join(_GCODE_SUFFIXES)} (G-code) and .csv (recorded path)"
        )
        return None
    path = context.file(table.file, "[program] file")
    if path is None:
        return None
    try:
        if suffix == ".csv":
            return read_path_csv(path)
        return read_gcode(path, feed=table.feed)
    except (GCodeError, PathFileError) as error:
        context.problems.extend(str(error).splitlines())
        return None


def spindle_speed(
    given: float | None, program: Program | Path | None, problems: list[str]
) -> float | None:
    """Return the spindle speed [rad/s] of a job, or None with problems noted.

    Args:
        given: What `[spindle] speed` says, or None.
        program: The program; None if it could not be read.
        problems: Receives what is wrong.
    """
    stated = program.spindle_speeds if isinstance(program, Program) else ()
    rpm = 60 / (2 * math.pi)
    if len(stated) > 1:
        found = ", ".join(f"S{speed * rpm:g}" for speed in stated[:_LISTED])
        found += ", ..." if len(stated) > _LISTED else ""
        problems.append(
            f"[program] file: found the spindle speeds {found}; one speed is allowed"
        )
        return given
    if given is None and not stated and program is not None:
        problems.append(
            "[spindle] speed: found nothing, and the program has no S word; a "
            'rotational speed with its unit is required, such as "8000 rpm"'
        )
        return None
    if given is not None and stated:
        if abs(stated[0] - given) > _SAME_SPEED * given:
            problems.append(
                f"[spindle] speed: found {given * rpm:g} rpm, but the program says "
                f"S{stated[0] * rpm:g}; leave one out or make them equal"
            )
        return given
    return stated[0] if stated else given


def time_path(
    program: Program | Path,
    table: ProgramTable,
    tooth_period: float,
    problems: list[str],
) -> Path | None:
    """Return the path at the tooth instants, or None with problems noted."""
    if isinstance(program, Path) and table.smoothing > 0:
        problems.append(
            f"[program] smoothing: found {table.smoothing * 1e3:g} ms, but a recorded "
            "path has its own times; allowed with G-code only"
        )
        return None
    try:
        if isinstance(program, Path):
            path = resample(
                program.time,
                program.positions,
                program.axes,
                program.is_rapid,
                program.line,
                tooth_period,
            )
        else:
            path = sample_program(
                program,
                tooth_period,
                acceleration=table.acceleration,
                rapid_feed=table.rapid_feed,
                corner_tolerance=table.corner_tolerance,
                feed=table.feed,
                smoothing=table.smoothing,
            )
    except ValueError as error:
        problems.append(f"[program] file: {error}")
        return None
    return path
