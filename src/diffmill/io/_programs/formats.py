"""Programs of every format, told by the suffix of the file."""

import math
import os
import pathlib
from collections.abc import Sequence

from ...toolpath import Path, Program, sample_program
from .._path_csv import read_path_csv, write_path_csv
from .dialects import recognised
from .faults import Fault, ProgramError
from .geometry import ToolAxis
from .robots.apt import parse_apt
from .robots.krl import parse_krl
from .robots.rapid import parse_rapid
from .robots.writers import write_apt, write_krl, write_rapid
from .rs274.interpreter import parse_gcode
from .rs274.writer import ProgramFrame, write_moves
from .setup import ProgramSetup
from .sources import Folder
from .text import read_text

GCODE = (".ngc", ".nc", ".gcode", ".tap", ".cnc")
APT = (".apt", ".cls", ".cl", ".cldata", ".ncl", ".aptsource")
RAPID = (".mod", ".prg", ".modx")
KRL = (".src",)
PROGRAM_FORMATS = {
    **dict.fromkeys(GCODE, "G-code"),
    **dict.fromkeys(KRL, "KRL"),
    **dict.fromkeys(RAPID, "RAPID"),
    **dict.fromkeys(APT, "APT"),
    ".csv": "path as CSV",
}
# With which a program without its own times becomes a path: those of a job.
_PERIOD = 4e-3
# Modules of a task that are looked through.
_MOST_MODULES = 30
_ACCELERATION = 2.0
_RAPID_FEED = 0.2


def read_program(
    file: str | os.PathLike[str], *, setup: ProgramSetup | None = None
) -> Program | Path:
    """Return a program of any format; a path as CSV is returned as recorded.

    Args:
        file: Path of the file; its suffix tells the format.
        setup: What the program does not say, with G-code.

    Raises:
        ValueError: If the file cannot be read, with file, line and word.
    """
    path = pathlib.Path(file)
    suffix, setup = path.suffix.lower(), ProgramSetup() if setup is None else setup
    if problem := _tool_axis_problem(suffix, setup.tool_axis):
        raise ProgramError(path.name, [Fault(0, "", problem)])
    if suffix == ".csv":
        return read_path_csv(path, is_axis_to_tip=setup.tool_axis == "z")
    if suffix not in PROGRAM_FORMATS:
        fault = Fault(
            0, "", f"the suffix {suffix!r} is not known; allowed: {allowed()}."
        )
        named = None
        if path.is_file():
            named = recognised(read_text(path), suffix, is_gcode=True)
        raise ProgramError(str(path), [named or fault])
    text = read_text(path)
    try:
        return _parsed(text, path, setup)
    except ProgramError as error:
        # One fault says more than the many of a program of another kind.
        fault = recognised(text, suffix, is_gcode=suffix in GCODE)
        if fault is None:
            raise
        raise ProgramError(path.name, [fault]) from error


def _parsed(text: str, path: pathlib.Path, setup: ProgramSetup) -> Program:
    """Return the program of a text in the language of its suffix."""
    suffix, name, folder = path.suffix.lower(), path.name, Folder(path.parent)
    if suffix in KRL:
        return parse_krl(text, name=name, setup=setup, folder=folder)
    if suffix in RAPID:
        return _rapid(text, path, setup)
    if suffix in APT:
        return parse_apt(text, name=name)
    return parse_gcode(text, name=name, setup=setup, folder=folder)


def _rapid(text: str, path: pathlib.Path, setup: ProgramSetup) -> Program:
    """Return the program of a module, with those beside it if it needs them."""
    try:
        return parse_rapid(text, name=path.name, setup=setup)
    except ProgramError:
        beside = [
            one
            for one in Folder(path.parent).files.values()
            if one.suffix.lower() in (*RAPID, ".sys") and one.name != path.name
        ]
        if not beside or len(beside) > _MOST_MODULES:
            raise
        try:
            texts = {one.name: read_text(one) for one in beside}
            return parse_rapid(text, name=path.name, setup=setup, modules=texts)
        except ProgramError:
            # What is wrong with this module says more than what is with them all.
            pass
        raise


def _tool_axis_problem(suffix: str, axis: ToolAxis | None) -> str:
    """Fault of a tool axis for the format of a suffix, "" if it is allowed."""
    known: tuple[str | None, ...] = (None, "x", "y", "z", "-x", "-y", "-z")
    if suffix not in KRL + RAPID:
        known = (None, "z", "-z") if suffix == ".csv" else (None,)
    if axis in known:
        return ""
    names = ", ".join(one for one in known if one) or "none"
    return (
        f'found the tool axis "{axis}"; allowed for {PROGRAM_FORMATS[suffix]}: {names}.'
    )


def allowed() -> str:
    """Return the suffixes and what they stand for."""
    groups: dict[str, list[str]] = {}
    for suffix, name in PROGRAM_FORMATS.items():
        groups.setdefault(name, []).append(suffix)
    return ", ".join(f"{' '.join(group)} ({name})" for name, group in groups.items())


def write_program(
    program: Program | Path,
    suffix: str,
    *,
    header: Sequence[str] = (),
    tolerance: float = 1e-6,
    is_spline: bool = False,
    frame: ProgramFrame | None = None,
    tool_axis: ToolAxis = "z",
) -> str:
    """Return the text of a program in the format of a suffix.

    A path is written with one straight move per row, in the time between the rows:
    `diffmill.toolpath.reduce_path` leaves few of them.

    Args:
        program: The program or the path.
        suffix: Such as ".src".
        header: Lines of comment.
        tolerance: How far straight pieces may lie beside an arc that the format does
            not know, and corners be rounded where times are needed [m].
        is_spline: Whether the rows of a path are points of a spline; KRL only.
        frame: What G-code says beside the motion; other formats leave it out. KRL and
            RAPID take theirs from the source of the program.
        tool_axis: Axis of a controller's tool that points from the shank to the tip;
            KRL and RAPID only.

    Raises:
        ValueError: If the suffix is not known, or the format cannot say the motion.
    """
    suffix = suffix.lower()
    if suffix not in PROGRAM_FORMATS:
        raise ValueError(f"found the suffix {suffix!r}; allowed: {allowed()}")
    if is_spline and suffix not in KRL:
        raise ValueError(
            f"Argument `is_spline` must be false for {suffix}; KRL has SPL."
        )
    if suffix == ".csv":
        if isinstance(program, Program):
            program = sample_program(
                program.of_tool(),
                _PERIOD,
                acceleration=_ACCELERATION,
                rapid_feed=_RAPID_FEED,
                corner_tolerance=tolerance if math.isfinite(tolerance) else 0.0,
            )
        return write_path_csv(program)
    moves = Program.of_path(program) if isinstance(program, Path) else program
    if suffix in KRL:
        return write_krl(
            moves,
            header=header,
            tolerance=tolerance,
            is_spline=is_spline,
            tool_axis=tool_axis,
        )
    if suffix in RAPID:
        return write_rapid(
            moves, header=header, tolerance=tolerance, tool_axis=tool_axis
        )
    if suffix in APT:
        return write_apt(moves, header=header, tolerance=tolerance)
    return write_moves(moves, header=header, tolerance=tolerance, frame=frame)
