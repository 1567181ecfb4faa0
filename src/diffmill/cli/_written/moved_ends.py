"""The program of a job with the ends of its blocks moved to where they correct most."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from ..._job import Job
    from ...config import JobProgram
    from ...toolpath import Path, Program


def read_written(
    file: pathlib.Path,
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"],
    pass_over: tuple[str, ...] = (),
) -> "Program | Path":
    """Program that was written with an axis of a controller's tool."""
    from ...io import ProgramSetup, read_program

    is_of_robot = file.suffix in (".src", ".mod", ".modx", ".prg")
    axis = tool_axis if is_of_robot else None
    setup = ProgramSetup(tool_axis=axis, pass_over=pass_over)
    return read_program(file, setup=setup)


def moved_files(
    job: "Job", given: "JobProgram | None", commanded: Float[np.ndarray, "step 3"]
) -> tuple[dict[str, str], list[str]]:
    """File of the moved program.

    Args:
        job: The job.
        given: The program before it was timed; None if there is none.
        commanded: Tip positions of the corrected command [m], shape (step, 3).

    Returns:
        Text by name of file, and lines for the user.
    """
    from ...io import program_frame, write_program
    from ...toolpath import BlockEnds

    if given is None:
        no_blocks = "note: [output] moved_ends: a recorded path has no blocks to move"
        return {}, [no_blocks]
    ends = BlockEnds.of(given.program, job.path)
    moved = ends.with_offsets(commanded - np.asarray(job.path.positions))
    name = f"moved{given.suffix}"
    text = write_program(
        dataclasses.replace(moved, name=name),
        given.suffix,
        header=[f"{job.name}, its block ends moved by diffmill"],
        tolerance=job.output.tolerance,
        frame=program_frame(job.program, np.asarray(job.path.line).tolist()),
        tool_axis=job.output.tool_axis,
    )
    line = f"{name}: the {ends.block_count} blocks of the program, their ends moved"
    return {name: text}, [line]


def moved_path(
    job: "Job", given: "JobProgram", folder: pathlib.Path
) -> Float[np.ndarray, "step 3"] | None:
    """Tip positions of the moved program at the job's rows, read and timed.

    The rows are at the same places of the blocks as those of the job: the change of
    the time of a block by its motion, micrometres on its length, is left out.

    Args:
        job: The job.
        given: The job's own program.
        folder: Folder of the moved one.

    Returns:
        Tip positions [m], shape (step, 3); None if the format writes other blocks.
    """
    from ...toolpath import BlockEnds, Program

    file = folder / f"moved{given.suffix}"
    program = read_written(file, job.output.tool_axis, job.output.pass_over)
    assert isinstance(program, Program)
    assert job.timing is not None
    path = job.timing.timed(program).path(float(job.tooth_period))
    places = BlockEnds.of(given.program, job.path)
    moved = BlockEnds.of(program, path)
    if moved.block_count != places.block_count:
        return None
    return places.positions(moved, path)
