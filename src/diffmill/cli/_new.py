"""A commented job for a program: what the program says, and what is to be filled in."""

import dataclasses
import json
import math
import os
import pathlib
import re
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from .._jax_config import configure_jax
from .._results_folder import write_whole
from ._session.errors import BadInput, bad_input
from ._session.job_options import JobOptions
from ._session.progress import Progress

if TYPE_CHECKING:
    from ..toolpath import Move, Path, Point, Program

_OPEN = "FILL IN"
# Speeds, feeds and extents have so many digits.
_DIGITS = 6
# Material below the deepest cut [m], and the spacing of rays over the diameter.
_BELOW, _SPACING = 1e-3, 1 / 40
# Over how many diameters a path is long, and how far beside the block it begins [m].
_LONG, _CLEAR = 1.5, 0.5e-3
# "T1 D=10. CR=0." of a list of tools, "DIAMETER 10", "D10 MILL", in comments.
_DIAMETER = re.compile(
    r"(?:\bDIA(?:METER|M)?\.?\s*[=:]?\s*|\bD\s*=\s*|\bD(?=\d+(?:\.\d*)?\s*(?:MM|R|MILL)))"
    r"(\d+\.?\d*)",
    re.IGNORECASE,
)
_TOOL = re.compile(r"\bT\d|mill\b|tool|cutter|fr[aä]ser|\bbit\b", re.IGNORECASE)
_INCHES = re.compile(r"\bG20\b|^\s*UNITS\s*/\s*INCH", re.IGNORECASE | re.MULTILINE)
_COMMENT = re.compile(r"\(([^)]*)\)|[;!](.*)|^\s*PPRINT(.*)", re.MULTILINE)


class _Facts(NamedTuple):
    """Facts of a program that a job needs.

    Attributes:
        lower: Least coordinates of the tip at a feed [m].
        upper: Greatest ones [m].
        top: Greatest height at which the tip moves sideways at a feed [m].
        speeds: Spindle speeds [rad/s].
        feeds: Feeds [m/s].
        diameters: Diameters that comments name, with the program's unit.
        tools: Numbers of its tools.
        tool: That of the moves; None without a number.
        goes_sideways: True if the tip moves sideways at a feed.
        rapids: Both ends of the rapid moves sideways [m].
        has_base: True if it states the place of the work in the robot's base.
        needs_acceleration: False for a path with times of its own.
    """

    lower: Float[np.ndarray, " 3"]
    upper: Float[np.ndarray, " 3"]
    top: float
    speeds: tuple[float, ...]
    feeds: tuple[float, ...]
    diameters: tuple[str, ...]
    tools: tuple[int | None, ...]
    tool: int | None
    goes_sideways: bool
    rapids: Float[np.ndarray, "move 2 3"]
    has_base: bool
    needs_acceleration: bool


def run_new(
    file: pathlib.Path,
    options: JobOptions,
    out: pathlib.Path | None,
    *,
    force: bool,
    progress: Progress,
    ask: Callable[[str], str] | None = None,
) -> int:
    """Write a job for a program; return the exit code.

    Args:
        file: The program.
        options: What options say.
        out: The job, or None for the program's name with .toml.
        force: True to replace a file that is there.
        progress: Display of the progress.
        ask: Asks the user for a value; None where no terminal is.
    """
    from ..cutting import materials
    from ..robot import built_in_models

    job = file.with_suffix(".toml") if out is None else out
    if job.exists() and not force:
        raise BadInput(f"{job}: found a file there; --force replaces it")
    _check_name("--material", options.material, list(materials()))
    if options.robot is not None and not options.robot.endswith((".toml", ".urdf")):
        _check_name("--robot", options.robot, built_in_models())
    configure_jax()
    with bad_input():
        facts = _facts(file, options)
    if len(facts.tools) > 1 and options.tool is None:
        numbers = ", ".join(f"T{number}" for number in facts.tools)
        progress.write(
            f"note: the program has the tools {numbers}; the job is of T{facts.tool}, "
            "--tool chooses another"
        )
    if ask is not None:
        options = _asked(options, facts, ask, list(materials()), built_in_models())
    lines = _job_lines(file, job, options, facts)
    with bad_input():
        write_whole(job, ("\n".join(lines) + "\n").encode())
    print(f"wrote {job}")
    missing = [line for line in lines if _OPEN in line]
    if missing:
        print("fill in, each with a line in it that says how:")
        for line in missing:
            print(f"  line {lines.index(line) + 1}: {line.lstrip('# ')}")
        print(f"next: diffmill check {job}")
        return 0
    from ._check import describe_file

    with bad_input():
        print("\n".join(describe_file(job, allow_outside=True)))
    print(f"next: diffmill correct {job}")
    return 0


def _check_name(option: str, name: str | None, allowed: list[str]) -> None:
    """Refuse a name that is none of those allowed."""
    if name is not None and name not in allowed:
        raise BadInput(f"{option}: found {name!r}; allowed: {', '.join(allowed)}")


def _facts(file: pathlib.Path, options: JobOptions) -> _Facts:
    """Facts of a program or a recorded path.

    Raises:
        ValueError: It cannot be read, has no such tool, or moves nothing at a feed.
    """
    from ..config import program_setup
    from ..io import read_program
    from ..toolpath import Path

    read = read_program(file, setup=program_setup(options.program_lines))
    if isinstance(read, Path):
        return _path_facts(read)
    return _program_facts(read, options.tool)


def _path_facts(path: "Path") -> _Facts:
    positions = np.asarray(path.positions, np.float64)
    cuts = ~np.asarray(path.is_rapid, bool)
    at_feed = positions[cuts] if cuts.any() else positions
    return _Facts(
        lower=at_feed.min(axis=0),
        upper=at_feed.max(axis=0),
        top=float(at_feed[:, 2].max()),
        speeds=(),
        feeds=(),
        diameters=(),
        tools=(),
        tool=None,
        goes_sideways=True,
        rapids=np.zeros((0, 2, 3)),
        has_base=False,
        needs_acceleration=False,
    )


def _program_facts(program: "Program", tool: int | None) -> _Facts:
    own = program.of_tool(tool)
    moves = own.timed_moves
    at_feed = [move for move in moves if not move.is_rapid and move.length > 0]
    if not at_feed:
        raise ValueError(
            f"{program.name}: found no move at a feed, so nothing that could cut"
        )
    bounds = np.array([point for move in at_feed for point in move.bounds])
    return _Facts(
        lower=bounds.min(axis=0),
        upper=bounds.max(axis=0),
        top=_top(at_feed),
        speeds=own.spindle_speeds,
        feeds=tuple(sorted({move.feed for move in at_feed if move.feed})),
        diameters=_diameters(program.source, own.tools[0]),
        tools=program.tools,
        tool=own.tools[0],
        goes_sideways=any(move.start[:2] != move.end[:2] for move in at_feed),
        rapids=np.reshape(
            [
                (move.start, move.end)
                for move in moves
                if move.is_rapid and move.start[:2] != move.end[:2]
            ],
            (-1, 2, 3),
        ),
        has_base=program.work_position is not None,
        needs_acceleration=True,
    )


def _top(at_feed: "list[Move]") -> float:
    """Greatest height at which a move sideways begins or ends lower [m].

    A plunge or a ramp into the block begins above it.
    """
    heights = [
        min(move.start[2], move.end[2])
        for move in at_feed
        if move.start[:2] != move.end[:2]
    ]
    return max(heights, default=min(move.end[2] for move in at_feed))


def _diameters(source: str, tool: int | None) -> tuple[str, ...]:
    """Diameters of cutters that comments of a program name, with its unit.

    Only those of a tool, if comments name it with one.
    """
    comments = [" ".join(filter(None, found)) for found in _COMMENT.findall(source)]
    of_tools = [text for text in comments if _TOOL.search(text)]
    own = re.compile(rf"\bT0*{tool}\b")
    of_tool = [text for text in of_tools if own.search(text) and _DIAMETER.search(text)]
    chosen = of_tool or of_tools
    found = [float(x) for text in chosen for x in _DIAMETER.findall(text)]
    unit = "in" if _INCHES.search(_COMMENT.sub("", source)) else "mm"
    return tuple(dict.fromkeys(f"{x:g} {unit}" for x in found if x > 0))


def _asked(
    options: JobOptions,
    facts: _Facts,
    ask: Callable[[str], str],
    materials: list[str],
    models: list[str],
) -> JobOptions:
    """Options with what the user answers; an empty answer leaves a line to fill in."""
    questions = {
        "robot": f"robot ({', '.join(models)}, or a .toml or .urdf file)",
        "diameter": 'diameter of the cutter, such as "10 mm"',
        "teeth": "its number of teeth",
        "material": f"material ({', '.join(materials)})",
    }
    if len(facts.speeds) != 1:
        questions["speed"] = 'spindle speed, such as "8000 rpm"'
    for key, question in questions.items():
        if getattr(options, key) is not None:
            continue
        answer = ask(f"{question}: ").strip().strip('"')
        if not answer:
            continue
        if key == "teeth" and not answer.isdigit():
            raise BadInput(f"teeth: found {answer!r}, but a whole number is required")
        value = int(answer) if key == "teeth" else answer
        options = dataclasses.replace(options, **{key: value})
    _check_name("material", options.material, materials)
    return options


def _job_lines(
    file: pathlib.Path, job: pathlib.Path, options: JobOptions, facts: _Facts
) -> list[str]:
    """Lines of the job."""
    from ..cutting import materials

    return [
        f"# A job for {file.name}, begun by `diffmill new`. docs/job.md has all keys.",
        "",
        *_cutter_lines(options, facts),
        "",
        *_spindle_lines(options, facts),
        "",
        "[force]",
        _line(
            "material",
            options.material and json.dumps(options.material),
            '"aluminium_7075_t6"',
            "of the work, one of those below",
        ),
        *([] if options.material else _comment(", ".join(materials()))),
        "",
        *_stock_lines(options, facts),
        "",
        *_program_lines(file, job, options, facts),
        "",
        *_robot_lines(job, options, facts),
        "",
        "[correction]",
        "# The largest contour error that the part allows: the verdict depends on it.",
        'tolerance_band = "0.1 mm"',
    ]


def _comment(text: str) -> list[str]:
    """Lines of a comment."""
    return textwrap.wrap(text, 78, initial_indent="#   ", subsequent_indent="#   ")


def _line(key: str, value: str | None, example: str, comment: str) -> str:
    """Line of a key; one to fill in where no value is known."""
    if value is None:
        return f"# {key} = {example}  # {_OPEN}: {comment}"
    return f"{key} = {value}"


def _cutter_lines(options: JobOptions, facts: _Facts) -> list[str]:
    named = ", ".join(facts.diameters)
    hint = f"; comments of the program name {named}" if named else ""
    comment = f"of the cutter{hint}"
    diameter = options.diameter and json.dumps(options.diameter)
    teeth = None if options.teeth is None else str(options.teeth)
    return [
        "[cutter]",
        'kind = "flat"                   # or "ball", or "bull" with corner_radius',
        _line("diameter", diameter, f'"{_diameter(options, facts)}"', comment),
        _line("teeth", teeth, "2", "number of its teeth"),
        '# helix_angle = "30 deg"        # 0 deg if left out',
    ]


def _diameter(options: JobOptions, facts: _Facts) -> str:
    """Diameter that is stated, or else an example: the first that comments name."""
    return options.diameter or next(iter(facts.diameters), "10 mm")


def _spindle_lines(options: JobOptions, facts: _Facts) -> list[str]:
    lines = ["[spindle]"]
    if options.speed is not None:
        return [*lines, f"speed = {json.dumps(options.speed)}"]
    rpm = [f"{_number(30 / math.pi * speed)} rpm" for speed in facts.speeds]
    if len(rpm) == 1:
        return [*lines, f'speed = "{rpm[0]}"  # as the program says']
    found = f"; the program has {', '.join(rpm)}" if rpm else "; the program has no S"
    return [*lines, _line("speed", None, '"8000 rpm"', f"of the spindle{found}")]


def _stock_lines(options: JobOptions, facts: _Facts) -> list[str]:
    """The box of the cutting moves: what else is there the program does not say."""
    lower = [*facts.lower[:2], facts.lower[2] - _BELOW]
    # Most programs have their zero on top of the block.
    highest = 0.0 if facts.lower[2] < 0 else facts.lower[2] + _BELOW
    upper = [*facts.upper[:2], max(highest, facts.top)]
    diameter = _length(_diameter(options, facts))
    spacing = json.dumps(f"{_number(1e3 * _SPACING * diameter)} mm")
    is_long = [
        facts.goes_sideways and upper[a] - lower[a] > _LONG * diameter for a in range(2)
    ]
    for a in range(2):
        # A slot begins and ends beside the block and lies in it across; what is long
        # both ways is the outline of the block.
        beside = -(diameter / 2 + _CLEAR) if is_long[a] else diameter / 2
        beside = 0.0 if all(is_long) else beside
        # A rapid move at the depth of the cut is beside the block.
        deep = facts.rapids[facts.rapids[:, :, 2].max(axis=1) < upper[2], :, a]
        for bounds, sign in ((lower, -1), (upper, 1)):
            is_open = is_long[a] and bool(np.all(deep == bounds[a], axis=1).any())
            away = -(diameter / 2 + _CLEAR) if is_open else beside
            bounds[a] += sign * away
    return [
        "[stock]",
        "# ASSUMED: the tip goes to the edges of the block, in a slot and by rapid",
        "# moves at depth beyond them, and the block ends 1 mm below the deepest cut.",
        "# Write the block that you clamp, in the coordinates of the program.",
        f"lower = {_millimetres(lower)}",
        f"upper = {_millimetres(upper)}",
        f"spacing = {spacing}             # a 40th of the cutter's diameter or less",
    ]


def _program_lines(
    file: pathlib.Path, job: pathlib.Path, options: JobOptions, facts: _Facts
) -> list[str]:
    lines = ["[program]", f"file = {json.dumps(_relative(file, job))}"]
    if len(facts.tools) > 1 and facts.tool is not None:
        lines.append(f"tool = {facts.tool}")
    lines.extend(options.program_lines)
    if not facts.needs_acceleration:
        return lines
    if facts.feeds:
        feeds = ", ".join(_number(6e4 * feed) for feed in facts.feeds[:6])
        lines.append(f"# its feeds: {feeds} mm/min")
    return [
        *lines,
        "# ASSUMED: what the controller does with it, see docs/job.md.",
        'acceleration = "0.5 m/s^2"',
        'smoothing = "100 ms"',
    ]


def _robot_lines(job: pathlib.Path, options: JobOptions, facts: _Facts) -> list[str]:
    from ..robot import built_in_models, drive_classes, forward_kinematics, load

    name = options.robot
    lines = ["[robot]"]
    is_model = name in built_in_models()
    if name is None or is_model:
        example = '"kuka_kr210_like"'
        comment = f"{', '.join(built_in_models())}; or file = "
        comment += '"arm.toml" or "arm.urdf" in its place'
        lines.append(_line("model", name and json.dumps(name), example, comment))
    else:
        lines.append(f"file = {json.dumps(_relative(pathlib.Path(name), job))}")
        if name.endswith(".urdf"):
            allowed = ", ".join(f'"{one}"' for one in drive_classes())
            comment = f"payload of the arm: {allowed}; or a file of its own springs"
            lines.append(_line("drives", None, '"class 200 kg"', comment))
    example = '{ position = ["1800 mm", "0 mm", "900 mm"] }'
    comment = "where the program's zero is, seen from the robot's base"
    if facts.has_base:
        return [*lines, f"# work_in_base = {example}  # the program states its base"]
    if not is_model:
        return [*lines, _line("work_in_base", None, example, comment)]
    robot = load(str(name))
    tip = np.asarray(forward_kinematics(robot, np.asarray(robot.home)))[:3, 3]
    place = np.round(tip - (facts.lower + facts.upper) / 2, 2)
    position = _millimetres(place.tolist())
    return [
        *lines,
        "# ASSUMED: the middle of the part is where the tip is at home. Write",
        f"# {comment}.",
        f"work_in_base = {{ position = {position} }}",
    ]


def _relative(file: pathlib.Path, job: pathlib.Path) -> str:
    """A file as a job names it, from its own folder."""
    return pathlib.Path(os.path.relpath(file, job.parent)).as_posix()


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _millimetres(point: "list[float] | Point") -> str:
    """A point as a job has it."""
    return json.dumps([f"{_number(1e3 * float(x) + 0.0)} mm" for x in point])


def _length(text: str) -> float:
    """Length of a text with a unit [m].

    Raises:
        BadInput: It is none.
    """
    from ..units import LENGTH, quantity

    with bad_input():
        return quantity(text, LENGTH)
