"""Description of a program, a recorded path, a job or an identification, in words."""

import collections
import math
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from .._jax_config import configure_jax
from .._toml import parse_toml
from ._expected import expected_campaign_line, expected_time_line
from ._session.progress import Progress

if TYPE_CHECKING:
    from ..toolpath import Move, Path, Point, Program, ProgramTiming


# The first bytes of a netCDF file; programs may have its suffix.
_HDF5 = b"\x89HDF"
# Lean from +z above which a cutter lies flat [deg].
_FLAT_LEAN = 80.0


def describe_file(
    file: pathlib.Path,
    *,
    allow_outside: bool,
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    keys: Sequence[str] = (),
) -> list[str]:
    """Lines that describe a file.

    Args:
        file: A job, a campaign, a file for `diffmill identify`, a program or a recorded
            path, told by its suffix, and a TOML file by its keys.
        allow_outside: True if a job may name files outside its folder.
        tool_axis: Axis of the tool of a program that points from the shank to the tip,
            as `[program] tool_axis` of a job.
        keys: Lines of `[program]`, for what a program leaves to the control.

    Raises:
        ValueError: If the file is faulty, or its suffix is not known.
    """
    suffix = file.suffix.lower()
    if suffix == ".toml" and (tool_axis is not None or keys):
        message = "--tool-axis and --program are for programs; a job has keys for it"
        raise ValueError(f"{file}: {message}")
    if suffix == ".toml":
        tables = tables_of(file)
        if "kind" in tables:
            configure_jax()
            from ..config import load_identification
            from ._identify.identify import in_words

            study = load_identification(file, allow_outside=allow_outside)
            first = f"{file}: a file for `diffmill identify` without faults"
            return [first, *in_words(study).reading(study)]
        if "part" in tables:
            return _describe_learning(file, allow_outside=allow_outside)
        if isinstance(tables.get("job"), str):
            return _describe_campaign(file, allow_outside=allow_outside)
        return _describe_job(file, allow_outside=allow_outside)
    from ..config import program_setup
    from ..io import PROGRAM_FORMATS, ProgramError, read_program
    from ..toolpath import Path

    if suffix not in PROGRAM_FORMATS:
        try:
            read_program(file)
        except ProgramError as error:
            # Another language is named by its lines.
            if error.faults[0].line:
                raise
        raise ValueError(
            f"{file}: found the suffix {suffix!r}; allowed: .toml (job or "
            f"identification), {', '.join(PROGRAM_FORMATS)}"
        )
    with file.open("rb") as start:
        if start.read(len(_HDF5)) == _HDF5:
            raise ValueError(
                f"{file}: found a result, in netCDF; needed is a job, a program or a "
                "path (xarray opens results)"
            )
    program = read_program(file, setup=program_setup(keys, tool_axis=tool_axis))
    if not isinstance(program, Path):
        return _describe_program(file, program)
    time = np.asarray(program.time)
    return [
        f"{file}: a recorded path without faults",
        f"  rows: {program.step_count} in {time[-1] - time[0]:.3f} s, of which "
        f"{int(np.sum(program.is_rapid))} rapid",
        _path_axis_line(program),
        *_extents(np.asarray(program.positions)),
        *(f"  note: {note}" for note in program.notes),
    ]


def tables_of(file: pathlib.Path) -> dict[str, object]:
    """Tables of a TOML file; none if it is faulty, which its reader reports."""
    try:
        return parse_toml(file.read_bytes())
    except (OSError, ValueError):
        return {}


def _describe_learning(file: pathlib.Path, *, allow_outside: bool) -> list[str]:
    from ..config import job_precision, load_learning

    configure_jax(job_precision(file.parent / str(tables_of(file).get("job", ""))))
    with Progress() as progress:
        progress.begin("reading job and measurements")
        measured = load_learning(file, allow_outside=allow_outside)
    lines = [f"{file}: a file for `diffmill learn` without faults, {measured.job.name}"]
    for name, part in zip(measured.part_names, measured.parts, strict=True):
        what = ", ".join(type(one).__name__ for one in part.measurements)
        lines.append(f"  {name}: {what}")
    return [*lines, *(f"  note: {note}" for note in measured.notes)]


def _describe_campaign(file: pathlib.Path, *, allow_outside: bool) -> list[str]:
    from ..config import load_campaign, load_job

    campaign = load_campaign(file, allow_outside=allow_outside)
    configure_jax()
    try:
        first = load_job(
            campaign.job, allow_outside=allow_outside, changes=next(campaign.changes())
        )
    except ValueError as error:
        expected = f"  note: its first job will be refused: {error}"
    else:
        count = math.prod(campaign.shape)
        expected = expected_campaign_line(first, campaign.command, count)
    lines = [
        f"{file}: a campaign of {math.prod(campaign.shape)} jobs, each to "
        f"{campaign.command}, from {campaign.job}"
    ]
    for variation, count in zip(campaign.variations, campaign.shape, strict=True):
        lines.append(f"  {variation.name}: {count}")
    return [*lines, expected]


def _describe_job(file: pathlib.Path, *, allow_outside: bool) -> list[str]:
    from ..config import check_tables

    # Faults of the tables come before imports that take seconds.
    check_tables(file)
    from ..config import job_precision, load_job

    configure_jax(job_precision(file))
    with Progress() as progress:
        progress.begin("reading the job")
        job = load_job(file, allow_outside=allow_outside)
    settings = job.simulation
    robot = "none (rigid machine)"
    if job.robot is not None:
        robot = job.robot.name
    elif job.modes is not None:
        robot = f"none ({len(job.modes.frequencies)} modes at the tool tip)"
    more = f" (notes: {len(job.notes)}, see below)" if job.notes else ""
    return [
        f"{file}: a job without faults{more}",
        f"  path: {job.path.step_count} tooth periods of "
        f"{float(job.tooth_period) * 1e3:g} ms, {float(job.path.time[-1]):.3f} s",
        *(_time_lines(job.timing) if job.timing is not None else ()),
        f"  robot: {robot}",
        _path_axis_line(job.path),
        f"  angles: {settings.angles} per revolution, sub-steps: {settings.substeps}, "
        f"height of a disc: {settings.element_height * 1e3:g} mm, discs up to "
        f"{settings.axial_depth * 1e3:g} mm above the tip, {settings.precision}",
        expected_time_line(job),
        *(f"  note: {note}" for note in job.notes),
    ]


def _time_lines(timing: "ProgramTiming") -> list[str]:
    """Lines on the causes of the time of a program."""
    time = timing.cycle_time
    lost = "; ".join(f"{cause} {seconds:.3f} s" for cause, seconds in time.lost)
    lines = [
        f"  time: {time.total:.3f} s, {time.programmed:.3f} s at the program's own "
        f"speeds; what limits add: {lost or 'nothing'}"
    ]
    if time.worst:
        worst = ", ".join(
            f"line {line} ({cause}) {seconds:.3f} s"
            for line, cause, seconds in time.worst
        )
        lines.append(f"  most of it in: {worst}")
    return lines


def _describe_program(file: pathlib.Path, program: "Program") -> list[str]:
    from ..io import PROGRAM_FORMATS

    kind = PROGRAM_FORMATS[file.suffix.lower()]
    lines = [f"{file}: {kind}, everything in it is supported"]
    if program.work_position is not None and program.work_rpy is not None:
        pose = program.work_position, program.work_rpy
        lines.append(_pose_line("base (work in the robot's base)", *pose))
    if len(program.tools) == 1:
        lines += _describe_moves(program.of_tool())
    else:
        for tool in program.tools:
            lines.append(f"  tool {'not named' if tool is None else f'T{tool}'}:")
            lines += [f"  {line}" for line in _describe_moves(program.of_tool(tool))]
    return lines + [f"  note: {note}" for note in program.notes]


def _describe_moves(program: "Program") -> list[str]:
    """Lines that describe the moves of one tool."""
    moves, part = program.timed_moves, program.sections[0]
    kinds = collections.Counter(_kind(move) for move in moves)
    names = ("rapid", "line", "arc", "rest")
    counts = ", ".join(f"{kinds[k]} {k}s" for k in names if kinds[k])
    feeds = sorted({m.feed for m in moves if m.feed is not None})
    speeds = [f"{60 * s / (2 * math.pi):g} rpm" for s in program.spindle_speeds]
    at_feed = [m for m in moves if not m.is_rapid]
    length = math.fsum(m.length for m in at_feed)
    seconds = math.fsum(_duration(m) for m in at_feed)
    lines = [
        f"  moves: {counts or 'none'}; {program.path_length * 1e3:.1f} mm after the "
        f"approach, {length * 1e3:.1f} mm of it at a feed in {seconds:.3f} s without "
        "acceleration",
        f"  spindle: {', '.join(speeds) or 'no S word'}",
        f"  feed: {', '.join(f'{f * 6e4:g} mm/min' for f in feeds) or 'none'}",
    ]
    inverse = [m.duration for m in moves if m.duration is not None and m.length > 0]
    if inverse:
        lines.append(
            f"  inverse time: {len(inverse)} moves in {math.fsum(inverse):.3f} s"
        )
    if part.tool_position is not None and part.tool_rpy is not None:
        pose = part.tool_position, part.tool_rpy
        lines.append(_pose_line("tool in the flange, its z up the shank", *pose))
    if moves:
        lines.append(_axis_line(np.array([m.axis for m in at_feed or moves])))
    bounds = [point for move in moves for point in move.bounds]
    return [*lines, *_extents(np.array(bounds))] if moves else lines


def _kind(move: "Move") -> str:
    """Kind of motion: "rapid", "arc", "line" or "rest"."""
    if move.is_rapid:
        return "rapid"
    if move.centre is not None:
        return "arc"
    return "line" if move.length > 0 or move.duration is None else "rest"


def _duration(move: "Move") -> float:
    """Least time of a move at a feed [s]; 0 where it has no feed."""
    if move.duration is not None:
        return move.duration
    return move.length / move.feed if move.feed else 0.0


def _path_axis_line(path: "Path") -> str:
    """Line of the tool axis, of the rows at a feed if there are any."""
    axes, is_cut = np.asarray(path.axes, np.float64), ~np.asarray(path.is_rapid, bool)
    return _axis_line(axes[is_cut] if is_cut.any() else axes)


def _axis_line(axes: Float[np.ndarray, "row 3"]) -> str:
    """Line on tool axes: the first, and the largest lean from +z."""
    lean = np.degrees(np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2]))
    x, y, z = np.round(axes[0], 4) + 0.0
    least, most = float(lean.min()), float(lean.max())
    posture = ", upright" if most < 1e-2 else ""
    if most > _FLAT_LEAN:
        posture = ": it lies flat" if most < 180 - _FLAT_LEAN else ": its tip is on top"
    leans = f"{most:.2f}" if most - least < 1e-2 else f"{least:.2f} to {most:.2f}"
    return (
        f"  tool axis, tip to shank: ({x:.4g}, {y:.4g}, {z:.4g}) at the start; leans "
        f"from +z by {leans} deg{posture}"
    )


def _pose_line(name: str, position: "Point", rpy: "Point") -> str:
    """Line with a pose that a program states."""
    x, y, z = (1e3 * value for value in position)
    roll, pitch, yaw = (math.degrees(angle) + 0.0 for angle in rpy)
    angles = f"{roll:g}, {pitch:g}, {yaw:g} deg"
    return f"  {name}: position {x:g}, {y:g}, {z:g} mm, rpy {angles}"


def _extents(points: Float[np.ndarray, "point 3"]) -> Sequence[str]:
    """Least and greatest coordinate of points, a line per axis."""
    low, high = points.min(axis=0) * 1e3, points.max(axis=0) * 1e3
    return [f"  {a}: {low[i]:.3f} to {high[i]:.3f} mm" for i, a in enumerate("xyz")]
