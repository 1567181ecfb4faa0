"""A program of one format written in another."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import Literal

from .._results_folder import ResultsFolder, write_whole
from ._session.errors import BadInput

# Spindle speeds that a note lists.
_LISTED_SPEEDS = 8


def convert_file(
    source: pathlib.Path,
    target: pathlib.Path,
    *,
    tolerance: float,
    force: bool,
    is_spline: bool = False,
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    keys: Sequence[str] = (),
) -> list[str]:
    """Write a program in the format of another suffix; return lines about it.

    Args:
        source: The program or the path.
        target: The file to write.
        tolerance: Largest distance of the written motion from the read one [m].
        force: True to replace a file that is there.
        is_spline: True to write a path as a spline.
        tool_axis: Axis of the robot's tool that points from the shank to the tip, in a
            program of KRL or RAPID that is read or written; "z" if None.
        keys: Lines of `[program]`, for what a program leaves to the control.

    Raises:
        BadInput: If a file is there already, or none can be.
        ValueError: If the program cannot be read, or the format cannot say it.
    """
    from ..config import program_setup
    from ..io import PROGRAM_FORMATS, read_program, write_program
    from ..toolpath import Path, Program, reduce_path

    if is_spline and target.suffix.lower() != ".src":
        raise BadInput(f"--spline: {target} knows no splines; .src does")
    if target.is_dir():
        raise BadInput(f"{target}: found a folder, but a file is required")
    if not target.parent.is_dir():
        raise BadInput(f"{target}: found no folder {target.parent} to write it to")
    if target.exists() and not force:
        raise BadInput(f"{target}: the file exists; --force replaces it")
    is_of_robot = [
        PROGRAM_FORMATS.get(file.suffix.lower()) in ("KRL", "RAPID")
        for file in (source, target)
    ]
    if tool_axis is not None and not any(is_of_robot):
        raise BadInput(f"--tool-axis: neither {source} nor {target} is KRL or RAPID")
    setup = program_setup(keys, tool_axis=tool_axis if is_of_robot[0] else None)
    program = read_program(source, setup=setup)
    lines = []
    if isinstance(program, Path):
        if target.suffix.lower() != ".csv":
            reduced = reduce_path(program, tolerance, is_spline=is_spline)
            lines.append(
                f"rows: {program.step_count}, blocks: {reduced.step_count - 1}"
            )
            program = Program.of_path(reduced, name=target.name)
    else:
        if is_spline:
            raise BadInput(f"--spline: {source} is no path; its moves stay as they are")
        lines += [f"note: {note}" for note in program.notes]
        if len(program.tools) > 1:
            program = program.of_tool()
            tool = program.sections[0].tool
            lines.append(f"note: only tool {tool} is written, others are left out")
        speeds = [f"{speed * 30 / math.pi:g}" for speed in program.spindle_speeds]
        if target.suffix.lower() != ".csv" and len(speeds) > 1:
            first, *others = speeds
            is_long = len(others) > _LISTED_SPEEDS
            listed = ", ".join(others[:_LISTED_SPEEDS]) + ", ..." * is_long
            lines.append(
                f"note: only the first spindle speed, {first} rpm, is written; not "
                f"{listed}"
            )
        program = dataclasses.replace(program, name=target.name)
    header = [f"converted from {source.name} by diffmill"]
    text = write_program(
        program,
        target.suffix,
        header=header,
        tolerance=tolerance,
        is_spline=is_spline,
        tool_axis=tool_axis or "z",
    )
    with ResultsFolder(target, str(target)).locked():
        write_whole(target, text.encode())
    return [f"wrote {target}", *lines]
