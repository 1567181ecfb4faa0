"""The corrected command as files: a path, programs, a stream of offsets."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...toolpath import ContourStatistics
from .moved_ends import moved_path, read_written

if TYPE_CHECKING:
    from ..._job import Job
    from ...config import JobProgram
    from ...sim import Solution
    from ...toolpath import Path

# A written program with so many times the error of its command needs more blocks.
_NOTED_ERROR_RATIO = 1.2
# Of lines of KRL: that they keep their times is not known.
_UNTIMED = (
    "a controller of KUKA stops where straight pieces of a SPLINE block meet at an "
    'angle, and then does not keep their times; [output] blocks = "spline" has no such '
    "corners"
)
# Angles are written to 1e-6 degrees: largest change of an axis [-].
_AXIS_ROUNDING = 1e-7


def untimed_programs(job: "Job") -> dict[str, str]:
    """Corrected programs whose times a controller may not keep, and why, by suffix."""
    is_untimed = ".src" in job.output.suffixes and job.output.blocks == "lines"
    return {".src": _UNTIMED} if is_untimed else {}


def written_errors(
    job: "Job",
    final: "Solution",
    folder: pathlib.Path,
    program: "JobProgram | None" = None,
) -> tuple[dict[str, ContourStatistics], list[str]]:
    """Read the corrected programs of a folder and run them.

    Args:
        job: The job.
        final: Solution of the command that they were written from.
        folder: The folder.
        program: The job's own program, whose block ends were moved; None if not.

    Returns:
        Contour error of each program where the tool cuts, by name of file, and lines
        for the user.
    """
    from ...io import OffsetStream

    job = job.with_precision()
    with_tips = lambda tips: eqx.tree_at(lambda p: p.positions, job.path, tips)
    paths, readings = {}, {}
    for suffix in job.output.suffixes:
        name, axis = f"corrected{suffix}", job.output.tool_axis
        period = float(job.tooth_period)
        passed = job.output.pass_over
        paths[name] = written_path(
            folder / name, period, tool_axis=axis, pass_over=passed
        )
        readings[name] = "read back and run"
    if job.output.stream_cycle > 0:
        stream = OffsetStream.read(folder / "stream.csv")
        time = np.asarray(job.path.time) - float(job.path.time[0])
        tips = np.asarray(job.path.positions) + stream.at(time)
        paths["stream.csv"] = with_tips(tips)
        readings["stream.csv"] = "read back, added to the program and run"
    if program is not None:
        name, tips = f"moved{program.suffix}", moved_path(job, program, folder)
        paths[name] = None if tips is None else with_tips(tips)
        readings[name] = "read back, timed and run"
    own, contours, lines = final.contour.rms, {}, []
    for name, path in paths.items():
        is_loaded = name.startswith("corrected")
        if path is None:
            reason = "it states feeds instead of times"
            reason = reason if is_loaded else "its arcs are written in pieces"
            lines.append(f"{name}: not run, since {reason}")
            continue
        contours[name] = contour = _run_written(job, final, path)
        line = f"{name}: {readings[name]}, it leaves {contour.rms * 1e6:.2f} um rms "
        line += "where the tool cuts"
        if is_loaded:
            line += f"; its command leaves {own * 1e6:.2f} um"
        lines.append(line)
        if is_loaded and not contour.rms <= _NOTED_ERROR_RATIO * own:
            lines.append(
                f"note: {name} leaves {contour.rms / own:.2g} times the error of its "
                f"command: [output] tolerance is {job.output.tolerance * 1e6:g} um, a "
                "smaller one takes more blocks"
            )
    return contours, lines


def written_path(
    file: pathlib.Path,
    tooth_period: float,
    *,
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] = "z",
    pass_over: tuple[str, ...] = (),
) -> "Path | None":
    """Path of a written program; None if its moves do not state their times.

    Args:
        file: The program.
        tooth_period: Time between the rows of the path [s].
        tool_axis: Axis of a controller's tool that points from the shank to the tip.
        pass_over: Routines that the program calls and that move nothing.
    """
    from ...toolpath import Move, Path, sample_program

    program = read_written(file, tool_axis, pass_over)
    assert not isinstance(program, Path)
    if count := program.approach_count:
        # A rest at the first point is a part of the command, but not of a program.
        last = program.moves[count - 1]
        rest = Move(last.end, last.end, duration=last.rest, axis=last.axis)
        rest = rest._replace(tool_x=last.tool_x)
        moves = (*program.moves[:count], rest, *program.moves[count:])
        program = dataclasses.replace(
            program, moves=moves if last.rest else program.moves
        )
    if any(move.duration is None for move in program.timed_moves if move.length > 0):
        return None
    # No limit holds for moves that state their times.
    return sample_program(
        program, tooth_period, acceleration=1.0, rapid_feed=1.0, corner_tolerance=0.0
    )


def _run_written(job: "Job", final: "Solution", path: "Path") -> ContourStatistics:
    """Contour error of a path that stands for the command, where that one cuts."""
    import jax.numpy as jnp

    from ..._result import RESULTS
    from ...process import ThroughPoses
    from ...sim import Solution, simulate_with_slot_growth

    # Rounded times may end a row sooner or later; the tool then rests at the end.
    rows = np.minimum(np.arange(job.path.step_count), path.step_count - 1)
    dtype = final.commanded.dtype
    axes = np.asarray(path.axes)[rows]
    # An arm that cannot turn the tool cannot follow what rounding turns it by either.
    is_other = np.abs(axes - np.asarray(job.path.axes)).max() > _AXIS_ROUNDING
    if job.simulation.axes and is_other:
        job = eqx.tree_at(lambda j: j.path.axes, job, jnp.asarray(axes, dtype))
    if job.path.tool_x is not None and path.tool_x is not None:
        side = jnp.asarray(np.asarray(path.tool_x)[rows], dtype)
        job = eqx.tree_at(lambda j: j.path.tool_x, job, side)
    tips = jnp.asarray(np.asarray(path.positions)[rows], dtype)
    # By the program that the correction has compiled.
    solution = Solution.of_command(job, final.rigid, tips, ThroughPoses())
    if solution.result == RESULTS.interval_overflow:
        quiet = lambda message, share: None
        solution = simulate_with_slot_growth(job, tips, ThroughPoses(), quiet).solution
    solution.raise_unless_successful(job)
    return ContourStatistics.of(solution.contour_error, final.is_cutting)


def corrected_files(
    job: "Job", commanded: Float[np.ndarray, "step 3"], name: str = "corrected"
) -> tuple[dict[str, str], list[str]]:
    """Files of a corrected command.

    Args:
        job: The job.
        commanded: Tip positions of the corrected command [m], shape (step, 3).
        name: Name of its programs, without their suffix.

    Returns:
        Text by name of file, and lines for the user.
    """
    from ...io import (
        OffsetStream,
        program_frame,
        write_gcode,
        write_path_csv,
        write_program,
    )
    from ...toolpath import Program, reduce_path

    output, lines = job.output, []
    path = eqx.tree_at(lambda p: p.positions, job.path, commanded)
    if path.is_upright:
        # Blocks may lean a little more than the rows that they pass, and G-code not at
        # all.
        up = np.broadcast_to([0.0, 0.0, 1.0], path.axes.shape).astype(path.axes.dtype)
        path = eqx.tree_at(lambda p: p.axes, path, up)
    files = {f"{name}.csv": write_path_csv(path)}
    reduced = reduce_path(path, output.tolerance)
    method = job.correction.method.name
    header = [f"{job.name}, corrected by diffmill", f"method: {method}"]
    for suffix in output.suffixes:
        file, blocks = f"{name}{suffix}", reduced
        if suffix == ".ngc":
            speed = float(job.spindle_speed)
            frame = program_frame(job.program, np.asarray(path.line).tolist())
            files[file] = write_gcode(
                blocks, header=header, spindle_speed=speed, frame=frame
            )
        else:
            is_spline = output.blocks == "spline" and suffix == ".src"
            if is_spline:
                blocks = reduce_path(path, output.tolerance, is_spline=True)
            # A module of KRL bears the name of its file.
            program = dataclasses.replace(
                Program.of_path(blocks, name=name),
                first_angles=output.first_angles,
                first_status=output.first_status,
                source=job.program,
                tool_axis=output.source_axis,
            )
            files[file] = write_program(
                program,
                suffix,
                header=header,
                is_spline=is_spline,
                tool_axis=output.tool_axis,
            )
            if reason := untimed_programs(job).get(suffix):
                lines.append(f"note: {file}: {reason}")
        lines.append(
            f"{file}: {blocks.step_count - 1} blocks instead of "
            f"{path.step_count - 1}, within {output.tolerance * 1e6:g} um at any time"
        )
    if output.stream_cycle > 0:
        stream = OffsetStream.of_paths(job.path, path, output.stream_cycle)
        files["stream.csv"] = stream.text
        line = f"stream.csv: steps of {stream.largest_step * 1e6:.3g} um at most"
        if stream.largest_step > output.max_step:
            line += f", but [output] max_step is {output.max_step * 1e6:g} um"
        lines.append(line)
    return files, lines
