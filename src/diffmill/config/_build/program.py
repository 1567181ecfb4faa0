"""The program of a job: found, read, timed, with the spindle speed that it implies."""

import math
import pathlib
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from ... import io
from ..._toml import parse_toml
from ..._types import FloatRows3
from ...io import PROGRAM_FORMATS, ProgramError, ProgramSetup
from ...robot import Robot
from ...settings.correction import LineWeight
from ...settings.tables import validated
from ...toolpath import (
    Path,
    Point,
    Program,
    TimedProgram,
    TimingLimits,
)
from .._schema.cutter import CutterTable
from .._schema.job import ProgramTable
from .context import FileContext

ToolAxis: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]
# The program and the job state the same speed in different units.
_SAME_SPEED = 1e-6
# Instants of a written path are rounded [s].
_SAME_INSTANT = 1e-6
# Longest time over which the way is averaged [s]: the heaviest machine speeds up in
# less.
_LONGEST_SMOOTHING = 60.0
# Unit vectors that are nearer to each other are the same.
_SAME_ROTATION = 1e-6
# Speeds that a message lists.
_LISTED = 8
# What a recorded path takes of `[program]`, and what it does without: a job keeps its
# limits while its program is exchanged for a path.
_OF_PATHS = ("file", "commanded", "tool_axis")
_WITHOUT_EFFECT = (
    "acceleration",
    "rapid_feed",
    "corner_tolerance",
    "feed",
    "smoothing",
    "jerk",
    "joint_ramp",
)
# What a program does not say itself.
_OF_SETUP = (
    "feed",
    "tool_axis",
    "pass_over",
    "block_delete",
    "offsets",
    "tool_lengths",
    "tool_radii",
    "dialect",
    "arc_centres",
    "machine_zero",
    "reference_point",
    "second_reference_point",
)
# As much as the readers of programs and paths take [byte].
_LARGEST_FILE = 250_000_000


def read_program(
    table: ProgramTable, context: FileContext, cutter: CutterTable | None = None
) -> Program | Path | None:
    """Program or recorded path of a job; None after a fault.

    Args:
        table: `[program]`.
        context: Receives notes and what is wrong.
        cutter: `[cutter]`, whose radius G41 and G42 take where nothing else says it.
    """
    suffix = pathlib.PurePath(table.file).suffix.lower()
    if suffix not in PROGRAM_FORMATS:
        context.problems.append(
            f"[program] file: found {table.file!r}; allowed: "
            f"{', '.join(PROGRAM_FORMATS)}"
        )
        return None
    path = context.file(table.file, "[program] file", largest=_LARGEST_FILE)
    if path is None:
        return None
    try:
        program = io.read_program(path, setup=_setup(table, cutter))
        if isinstance(program, Path):
            _check_recorded(table, context)
            context.notes.extend(f"[program] {note}" for note in program.notes)
            return program
        chosen = program.of_tool(table.tool)
    except ProgramError as error:
        context.problems.extend(_problems(str(error)))
        return None
    except ValueError as error:
        context.problems.append(f"[program] tool: {error}")
        return None
    context.notes.extend(f"[program] {note}" for note in program.notes)
    if (feed := table.feed) is not None:
        feeds = [move.feed for move in chosen.moves if not move.is_rapid]
        if not any(own is None or math.isclose(own, feed) for own in feeds):
            context.notes.append(
                "[program] feed: without effect, since the program says a feed for "
                "every move"
            )
    if len(program.sections) > 1:
        context.notes.append(_tool_note(program, chosen))
    return chosen


def rotated_as_asked(
    rotation: Literal["program", "fixed", "free"] | None,
    program: Program | Path | None,
    problems: list[str],
    *,
    is_arm: bool,
) -> Program | Path | None:
    """Program with the rotation about the tool axis that a job asks for.

    Args:
        rotation: `[robot] tool_rotation`.
        program: The program; None if it could not be read.
        problems: Receives what is wrong.
        is_arm: Whether an arm follows it.
    """
    is_stated = isinstance(program, Program) and program.states_rotation
    if rotation == "program" and program is not None and not is_stated:
        problems.append(
            '[robot] tool_rotation: found "program", but the program does not state '
            'the rotation about the tool axis; allowed: "fixed", "free"'
        )
    if not isinstance(program, Program):
        return program
    if rotation == "fixed" or not is_stated:
        return program.without_rotation()
    if not is_arm or rotation == "free":
        return program
    before = program.moves[max(program.approach_count - 1, 0)]
    for move in program.timed_moves:
        is_timed = move.length > 0 or move.duration is not None
        assert move.tool_x is not None and before.tool_x is not None
        turn = math.dist(move.tool_x, before.tool_x)
        if not is_timed and turn > _SAME_ROTATION:
            problems.append(
                f"[program] file: {program.name}, line {move.line}: the tool turns "
                "about its axis on the spot, which has no time; [robot] tool_rotation "
                '= "fixed" leaves that rotation out'
            )
            break
        before = move
    return program


def commanded_tips(
    table: ProgramTable, path: Path, context: FileContext
) -> FloatRows3 | None:
    """Tips that the job commands instead of the path's [m], shape (step, 3), if any.

    Args:
        table: `[program]`.
        path: The path.
        context: Receives what is wrong.
    """
    key = "[program] commanded"
    if table.commanded is None:
        return None
    told = read_command(table.commanded, key, path, context)
    if told is not None:
        context.notes.append(
            f"{key}: the controller receives {table.commanded}; errors are those from "
            "the program"
        )
    return told


def read_command(
    name: str, key: str, path: Path, context: FileContext
) -> FloatRows3 | None:
    """Tips of a recorded path that tells the controller what to do [m], (step, 3).

    None with a problem noted if its rows are not those of the program.

    Args:
        name: Its file.
        key: Where it is named.
        path: Path of the program.
        context: Receives what is wrong.
    """
    file = context.file(name, key, largest=_LARGEST_FILE)
    if file is None:
        return None
    try:
        told = io.read_path_csv(file)
    except ProgramError as error:
        context.problems.extend(f"{key}: {line}" for line in _problems(str(error)))
        return None
    ours, theirs = (np.asarray(x.time) - float(x.time[0]) for x in (path, told))
    if len(ours) != len(theirs) or np.any(np.abs(ours - theirs) > _SAME_INSTANT):
        context.problems.append(
            f"{key}: found {len(theirs)} rows in {theirs[-1]:.6g} s, but those of the "
            f"program are required, {len(ours)} in {ours[-1]:.6g} s, each at the same "
            "instant"
        )
        return None
    return np.asarray(told.positions)


def check_sections(
    sections: Sequence[LineWeight],
    program: Program | Path | None,
    problems: list[str],
) -> None:
    """Faults of sections in which the program does not move.

    Args:
        sections: `[correction] weight`.
        program: The program; None if it could not be read.
        problems: Receives what is wrong.
    """
    if not sections or program is None:
        return
    if isinstance(program, Path):
        lines = np.asarray(program.line)
    else:
        lines = np.array([move.line for move in program.timed_moves])
    problems.extend(
        f"[correction] weight.lines: found [{first}, {last}], but the first and the "
        "last line of a section in which the program moves are required; its moves "
        f"are those of lines {lines.min()} to {lines.max()}"
        for first, last, _ in sections
        if not np.any((first <= lines) & (lines <= last))
    )


def _check_recorded(table: ProgramTable, context: FileContext) -> None:
    """Notes and faults of keys that a recorded path does not use."""
    defaults = ProgramTable(file=table.file)
    stated = [
        key
        for key in ProgramTable.model_fields
        if key in table.model_fields_set
        and key not in _OF_PATHS
        and getattr(table, key) != getattr(defaults, key)
    ]
    if idle := [key for key in stated if key in _WITHOUT_EFFECT]:
        context.notes.append(
            f"[program] {', '.join(idle)}: without effect, since a recorded path has "
            "its own times"
        )
    context.problems.extend(
        f"[program] {key}: found one, but a recorded path has its own times and "
        "places; allowed with a program only"
        for key in stated
        if key not in _WITHOUT_EFFECT
    )


def _problems(text: str) -> list[str]:
    """Faults of a message; the last one says what is allowed."""
    return text.replace("\nAllowed are", " Allowed are").splitlines()


def _tool_note(program: Program, chosen: Program) -> str:
    """Note of the tool that is simulated, and of the others."""
    tool = chosen.sections[0].tool
    rest = [f"T{one}" for one in program.tools if one != tool]
    others = f"; left out: {', '.join(rest)}" if rest else ""
    return f"[program] tool: {'T' + str(tool) if tool is not None else 'no T'}{others}"


def program_setup(
    lines: Sequence[str], *, tool_axis: ToolAxis | None = None
) -> ProgramSetup:
    """Settings of the control that lines of `[program]` state.

    Args:
        lines: Such as 'tool_lengths = { 1 = "80 mm" }'.
        tool_axis: As the key of this name, where no line has it.

    Raises:
        ValueError: If a line is no key of the settings, or its value is faulty.
    """
    try:
        raw = parse_toml("\n".join(lines).encode())
    except ValueError as error:
        message = "--program: needed are keys as in a job, such as "
        raise ValueError(f"{message}machine_zero = [...]; {error}") from error
    problems = [
        f"--program: found {key!r}; allowed: {', '.join(_OF_SETUP)}"
        for key in raw
        if key not in _OF_SETUP
    ]
    raw = {"tool_axis": tool_axis, **raw, "file": "program"}
    table = None
    if not problems:
        table = validated(ProgramTable, raw, "--program", problems)
    if table is None:
        raise ValueError("\n".join(problems))
    return _setup(table)


def _setup(table: ProgramTable, cutter: CutterTable | None = None) -> ProgramSetup:
    """Settings of the control that a program does not state."""
    zero = table.machine_zero
    return ProgramSetup(
        feed=table.feed,
        offsets={name: _point(zero) for name, zero in table.offsets.items()},
        tool_lengths=table.tool_lengths,
        tool_radii=table.tool_radii,
        radius=None if cutter is None else cutter.diameter / 2,
        dialect=table.dialect,
        arc_centres=table.arc_centres,
        machine_zero=None if zero is None else _point(zero),
        reference_points=(
            _point(table.reference_point),
            _point(table.second_reference_point),
        ),
        skips_blocks=table.block_delete,
        tool_axis=table.tool_axis,
        pass_over=tuple(table.pass_over),
    )


def _point(lengths: list[float]) -> Point:
    """Point of three lengths [m]."""
    x, y, z = lengths
    return x, y, z


def spindle_speed(
    given: float | None,
    program: Program | Path | None,
    problems: list[str],
    *,
    is_override: bool = False,
) -> float | None:
    """Spindle speed of a job [rad/s]; None after a fault.

    Args:
        given: What `[spindle] speed` says, or None.
        program: The program; None if it could not be read.
        problems: Receives what is wrong.
        is_override: Whether what is given counts, whatever the program says.
    """
    if is_override and given is not None:
        return given
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
            "[spindle] speed: found nothing, and the program sets no speed above 0; a "
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


def time_program(
    program: Program, table: ProgramTable, problems: list[str]
) -> TimedProgram | None:
    """Program with times under the limits of a job; None after a fault."""
    smoothing = table.smoothing
    if table.jerk is not None:
        if smoothing > 0:
            problems.append(
                "[program] jerk: found beside smoothing; one of them is allowed"
            )
            return None
        # From full acceleration to full braking in this time, which is the worst.
        smoothing = 2 * table.acceleration / table.jerk
    if not smoothing <= _LONGEST_SMOOTHING:
        least = 2 * table.acceleration / _LONGEST_SMOOTHING
        problems.append(
            f"[program] smoothing: found {smoothing:g} s, but at most "
            f"{_LONGEST_SMOOTHING:g} s is allowed"
            if table.jerk is None
            else f"[program] jerk: found {table.jerk:g} m/s^3, with which speeding up "
            f"takes {smoothing:g} s; at most {_LONGEST_SMOOTHING:g} s is allowed, a "
            f"jerk of at least {least:.3g} m/s^3 beside this acceleration"
        )
        return None
    limits = TimingLimits(
        acceleration=table.acceleration,
        rapid_feed=table.rapid_feed,
        corner_tolerance=table.corner_tolerance,
        feed=table.feed,
        smoothing=smoothing,
    )
    try:
        return TimedProgram.of(program, limits)
    except ValueError as error:
        problems.append(f"[program] file: {error}")
        return None


def recorded_path(path: Path, tooth_period: float, problems: list[str]) -> Path | None:
    """Recorded path at the tooth instants; None after a fault."""
    try:
        return path.resampled(tooth_period)
    except ValueError as error:
        problems.append(f"[program] file: {error}")
        return None


def note_rounding(timed: TimedProgram, context: FileContext) -> None:
    """Note of rounded corners: the error is counted from the rounded path."""
    count = timed.rounded_corners
    if count:
        context.notes.append(
            f"[program] corner_tolerance: the path rounds {count} "
            f"corner{'s' * (count > 1)} of the program by up to "
            f"{1e3 * timed.limits.corner_tolerance:g} mm, and errors are those from "
            'the rounded path; "0 mm" stops at every corner'
        )


def rows_of(
    timed: TimedProgram, tooth_period: float, problems: list[str]
) -> Path | None:
    """Path of a timed program at the tooth instants; None after a fault."""
    try:
        return timed.path(tooth_period)
    except ValueError as error:
        problems.append(f"[program] file: {error}")
        return None


def slowed_for_joints(
    timed: TimedProgram,
    path: Path,
    robot: Robot,
    q: Float[np.ndarray, "step joint"],
    ramp: float,
) -> TimedProgram:
    """Program whose joints keep their speeds and accelerations.

    Args:
        timed: The program.
        path: The same at the tooth instants.
        robot: The robot.
        q: Its joints at the rows of `path` [rad or m], shape (step, joint).
        ramp: Time in which a joint may reach its full speed [s]; 0 for any.

    Returns:
        The same program if they keep them anyway.
    """
    if robot.joint_speed is None:
        return timed
    speed = np.asarray(robot.joint_speed, np.float64)
    acceleration = speed / ramp if ramp > 0 else np.full_like(speed, np.inf)
    return timed.within(
        path, q, names=robot.joint_names, speed=speed, acceleration=acceleration
    )
