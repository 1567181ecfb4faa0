"""Reading a job: every fault of the file and what it refers to, in one error."""

import dataclasses
import math
import os
import pathlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._job import Job
from .._toml import JobError, read_toml
from .._types import FloatRows3
from ..cutter import AbstractCutter, ToolHolder
from ..process import Immersion, default_element_height
from ..robot import Controller, Robot, TipModes
from ..settings.correction import CorrectionSettings
from ..settings.output import OutputSettings
from ..settings.simulation import ChipSettings, SimulationSettings
from ..settings.tables import idle_keys
from ..toolpath import Path, Program, TimedProgram
from ._build.context import FileContext
from ._build.correction import check_correction, completed_correction
from ._build.machine import fastest_mode, read_machine
from ._build.program import (
    check_sections,
    commanded_tips,
    note_rounding,
    read_program,
    recorded_path,
    rotated_as_asked,
    rows_of,
    slowed_for_joints,
    spindle_speed,
    time_program,
)
from ._build.robot import pose_matrix, read_robot
from ._build.stock import StockPlan, read_stock
from ._changes import changed, changes_text
from ._check.end_force import end_notes
from ._check.frames import base_note, program_base, tool_note
from ._check.modes import (
    LONGEST_SUBSTEP,
    check_constant_force,
    check_modes,
    check_sag,
    counting_modes,
    default_substeps,
    default_updates,
)
from ._check.notes import immersion, notes, rate_notes
from ._check.ranges import range_notes
from ._check.rapids import check_overhang, check_rapids
from ._check.reach import ReachCheck
from ._schema.cutter import make_cutter, make_holder
from ._schema.job import (
    JobTables,
    ProgramTable,
    RobotTable,
    read_tables,
)

# Room below the deepest disc [m].
_ROOM = 0.6e-3
# Samples per revolution: of a flat cutter that stands upright, and of any other.
_FEWEST_ANGLES, _FEWEST_IN_SPACE = 180, 96
# Delays of its controller for which a program is at rest before and after it.
_REST = 3.0
# How often a program is slowed down for joints: what they do between two rows shows
# when slower rows are nearer to each other. Two are enough as a rule.
_PASSES = 3
# As `TimedProgram.path` takes, before there is a rest.
_MOST_STEPS = 1_000_000
# Discs of a cutter: each has samples of its own at every angle.
_MOST_DISCS = 10_000
# Of a length that is written down with a few digits.
_ROUNDING = 1e-6


def load_job(
    file: str | os.PathLike[str],
    *,
    allow_outside: bool = False,
    changes: Mapping[str, object] | None = None,
) -> Job:
    """Job of a TOML file and the program and robot that it names.

    Args:
        file: The job file.
        allow_outside: Whether the job may name files outside its own folder.
        changes: Other values for some of its keys, as they would stand in it, such as
            {"spindle.speed": "9000 rpm"}, which counts before an S word of the program;
            an entry of a list has a number from 1 on: "robot.joint_stiffness.2".

    Returns:
        The job in SI units, its path sampled at the tooth instants.

    Raises:
        JobError: If anything is wrong: syntax, keys, units, sizes, the program, rapid
            moves through the stock, the robot's reach, memory. All is listed at once.

    Differentiability: not applicable, a host function; the job's leaves are ordinary
    inputs of `simulate`.
    """
    path = pathlib.Path(file)
    text, raw = read_toml(path)
    context = FileContext(path.parent, allow_outside, [], [])
    if changes:
        raw = changed(raw, changes, context.problems)
        text = f"{text}\n{changes_text(changes)}"
    tables = read_tables(raw, context.problems)
    context.notes.extend(range_notes(raw))
    if tables.correction is not None:
        context.notes.extend(
            f"[correction] {key}: without effect, since it works with {other} only"
            for key, other in idle_keys(
                CorrectionSettings, raw.get("correction")
            ).items()
        )
    if tables.program is None:
        _check_program(raw.get("program"), context)
    # A speed that is asked for beside the file counts before the program's.
    is_asked = "spindle.speed" in (changes or {})
    parts = _read_parts(tables, context, overrides_speed=is_asked)
    simulation = _simulation(tables, parts, context)
    if context.problems or simulation is None:
        raise JobError(path, context.problems)
    return _assemble(path.stem, text, tables, parts, simulation, context.notes)


def job_precision(
    file: str | os.PathLike[str], changes: Mapping[str, object] | None = None
) -> str:
    """Precision that a job asks for, before JAX is configured for it.

    Args:
        file: The job file.
        changes: Other values for some of its keys, as `load_job` takes them.

    Returns:
        "float32" if the job says so, else "float64", also for a faulty job.
    """
    try:
        raw = read_toml(pathlib.Path(file)).tables
    except JobError:
        return "float64"
    raw = changed(raw, changes or {}, [])
    simulation = raw.get("simulation", {})
    found = simulation.get("precision") if isinstance(simulation, dict) else None
    return "float32" if found == "float32" else "float64"


def _check_program(raw: object, context: FileContext) -> None:
    """Faults of a program whose table has faults of its own."""
    name = raw.get("file") if isinstance(raw, dict) else None
    if isinstance(name, str) and name:
        # Any feed will do: a faulty one has been reported.
        table = ProgramTable(file=name).model_copy(update={"feed": 1.0})
        read_program(table, context)


class _Parts(NamedTuple):
    """Parts of a job; None where a fault keeps one from being there.

    Attributes:
        program: The program, before it is timed.
        speed: Spindle speed [rad/s].
        cutter: The cutter.
        holder: Its holder, if the job has one.
        stock: The stock.
        robot: The robot; None for a rigid machine and one of modes.
        T_base_work: Maps work coordinates to the robot's base, shape (4, 4).
        joint_start: Where inverse kinematics starts [rad or m]; None for home.
        path: The path with a row per tooth period.
        controller: What is between program and motors; None for nothing.
        fastest: Highest frequency of the machine that counts [Hz]; 0 for none.
        modes: The modes of a machine that is given by them, else None.
        timed: The program with the speed at every place of it; None for a recorded
            path.
        commanded: Tips that the controller is told instead of the path's, if any.
        joints: Joints of the robot along the path [rad or m], if they are known.
    """

    program: Program | Path | None
    speed: float | None
    cutter: AbstractCutter | None
    holder: ToolHolder | None
    stock: StockPlan | None
    robot: Robot | None
    T_base_work: Float[np.ndarray, "4 4"]
    joint_start: Float[np.ndarray, " joint"] | None
    path: Path | None
    controller: Controller | None = None
    fastest: float = 0.0
    modes: TipModes | None = None
    timed: TimedProgram | None = None
    commanded: FloatRows3 | None = None
    joints: Float[np.ndarray, "step joint"] | None = None

    @property
    def tooth_period(self) -> float:
        """Tooth period [s] of a job with a cutter and a speed."""
        assert self.speed is not None and self.cutter is not None
        return 2 * math.pi / (self.speed * self.cutter.flute_count)


def _read_parts(
    tables: JobTables, context: FileContext, *, overrides_speed: bool
) -> _Parts:
    """Parts that checked tables state, with the path and the robot along it."""
    problems = context.problems
    program, speed, cutter, holder, stock, robot, start = (None,) * 7
    if tables.program is not None:
        program = read_program(tables.program, context)
    if tables.spindle is not None:
        given = tables.spindle.speed
        speed = spindle_speed(given, program, problems, is_override=overrides_speed)
        if given is None and speed is not None:
            rpm = speed * 30 / math.pi
            context.notes.extend(range_notes({"spindle": {"speed": f"{rpm:g} rpm"}}))
    if tables.cutter is not None:
        cutter = make_cutter(tables.cutter)
        holder = make_holder(tables.cutter)
    check_overhang(tables.cutter, tables.robot, problems)
    work = None if tables.robot is None else tables.robot.work_in_base
    T_base_work, stated = pose_matrix(work), program_base(program)
    is_placed = work is not None or stated is not None
    if tables.robot is not None:
        table = tables.robot
        fitted = read_robot(table, cutter, context, is_placed=is_placed)
        robot, start = fitted.robot, fitted.joint_start
        if robot is not None:
            T_base_work = stated if work is None and stated is not None else T_base_work
            found = base_note(T_base_work, program, is_stated=work is not None)
            context.notes.extend(found + tool_note(fitted.T_flange_tool, program))
        rotation, is_arm = table.tool_rotation, robot is not None
        program = rotated_as_asked(rotation, program, problems, is_arm=is_arm)
    if cutter is not None and tables.force is not None:
        tables.force.check_teeth(cutter.flute_count, problems)
    if tables.stock is not None:
        settings = tables.simulation
        precision = "float64" if settings is None else settings.precision
        stock = read_stock(tables.stock, precision, context)
    parts = _Parts(
        program, speed, cutter, holder, stock, robot, T_base_work, start, None
    )
    controller = _controller(tables, robot, problems)
    if cutter is not None and speed is not None:
        parts = _timed(tables, parts._replace(controller=controller), problems)
        if parts.timed is not None:
            note_rounding(parts.timed, context)
    if tables.machine is not None:
        modes = read_machine(tables.machine, context)
        _check_machine(tables, problems)
        if modes is not None:
            parts = parts._replace(modes=modes, fastest=fastest_mode(modes))
    if is_placed:
        parts = _follow(tables, parts, context)
    if tables.program is not None and parts.path is not None:
        tips = commanded_tips(tables.program, parts.path, context)
        parts = parts._replace(commanded=tips)
    if parts.path is not None and cutter is not None and stock is not None:
        check_rapids(parts.path, cutter, holder, stock, context)
    return parts


def _controller(
    tables: JobTables, robot: Robot | None, problems: list[str]
) -> Controller | None:
    """Controller of a job; None if it is ideal, or after a fault."""
    table, own = tables.controller, tables.robot
    is_machine = tables.machine is not None
    if table is None or (own is None and not is_machine):
        return None
    # A machine of modes has a drive for each axis of the work.
    count = 3 if robot is None else len(robot.motor_joints)
    added = 0 if robot is None else robot.joint_count - count
    try:
        found = table.controller(count, added)
    except ValueError as error:
        if robot is not None or is_machine:
            problems.append(str(error))
        return None
    if found is not None and own is not None and own.rigid:
        problems.append(
            "[controller]: found a controller, but with rigid = true there are no "
            'motors to follow it; only preset = "ideal" is allowed'
        )
    return found


def _standstill_rows(controller: Controller, tooth_period: float) -> float:
    """Number of rows at standstill before a program, and after it.

    It is no whole number, and infinite where a servo hardly follows.

    The motors begin before the clock on which the mean delay is left out, and end after
    it: by a delay, and servos by some of them.
    """
    lag = float(controller.delay)
    if controller.dead_time is not None:
        lag -= float(controller.dead_time)
    return _REST * lag / tooth_period


def _follow(tables: JobTables, parts: _Parts, context: FileContext) -> _Parts:
    """Parts with the path that the robot follows, slowed down where a joint is slow.

    Args:
        tables: Checked tables, that of the robot with them.
        parts: With the robot and the path.
        context: Receives what is wrong.

    Returns:
        The parts, with the path that it follows and its highest frequency.
    """
    table, robot, path = tables.robot, parts.robot, parts.path
    if table is None or robot is None or path is None:
        return parts
    checks = ReachCheck(
        robot,
        parts.T_base_work,
        parts.joint_start,
        "free" if _is_free(table) else "fixed",
        len(robot.motor_joints),
    )
    found = len(context.problems)
    q = checks.joints(path, context, is_slowed=parts.timed is not None)
    if parts.timed is not None and len(context.problems) == found:
        ramp = 0.0 if tables.program is None else tables.program.joint_ramp
        # The same poses, and nothing more to note.
        parts, q = _slowed(parts, checks, q, ramp, context._replace(notes=[]))
        if parts.path is None:
            return parts
    parts = parts._replace(joints=q)
    if not np.isfinite(np.asarray(robot.joint_stiffness)).all():
        return parts
    poses = np.asarray(q)[[0, len(q) // 2, -1]]
    try:
        check_sag(robot, poses, context)
        fastest = max(np.max(counting_modes(robot, row), initial=0.0) for row in poses)
    except ValueError as error:
        context.problems.append(f"[robot]: {error}")
        return parts
    return parts._replace(fastest=fastest)


def _slowed(
    parts: _Parts,
    checks: ReachCheck,
    q: Float[np.ndarray, "step joint"],
    ramp: float,
    context: FileContext,
) -> tuple[_Parts, Float[np.ndarray, "slower joint"]]:
    """Parts with a program whose joints keep their limits, and the joints.

    Args:
        parts: With the robot, the program and its path.
        checks: Follow the path.
        q: Joints along it [rad or m], shape (step, joint).
        ramp: Time in which a joint may reach its full speed [s]; 0 for any.
        context: Receives what is wrong, such as a joint that stays too fast since a
            move states its time.
    """
    found = len(context.problems)
    for left in range(_PASSES - 1, -1, -1):
        assert parts.timed is not None and parts.path is not None
        timed = slowed_for_joints(parts.timed, parts.path, checks.robot, q, ramp)
        if timed is parts.timed:
            break
        parts = _with_rows(parts, timed, context.problems)
        if parts.path is None:
            break
        q = checks.joints(parts.path, context, is_slowed=left > 0)
        if len(context.problems) > found:
            break
    return parts, q


def _check_machine(tables: JobTables, problems: list[str]) -> None:
    """Faults of settings that a machine of modes does not know."""
    simulation, correction = tables.simulation, tables.correction
    if simulation is not None and simulation.mode == "quasistatic":
        problems.append(
            '[simulation] mode: found "quasistatic" beside [machine], but a mode has a '
            "mass"
        )
    if correction is None:
        return
    if correction.command == "joint":
        problems.append(
            '[correction] command: found "joint" beside [machine], but a machine of '
            "modes has no joints"
        )
    if correction.method.needs_robot:
        problems.append(
            f'[correction] method: found "{correction.method.name}" beside [machine], '
            "but it is known of a robot alone"
        )


def _timed(tables: JobTables, parts: _Parts, problems: list[str]) -> _Parts:
    """Parts with the program as a path with a row per tooth period."""
    assert parts.cutter is not None and parts.speed is not None
    period, flutes = parts.tooth_period, parts.cutter.flute_count
    if period > 1000 * LONGEST_SUBSTEP:
        least = 60 / (flutes * 1000 * LONGEST_SUBSTEP)
        problems.append(
            f"[spindle] speed: found {parts.speed * 30 / math.pi:g} rpm; at least "
            f"{least:g} rpm is required"
        )
        return parts
    program, table = parts.program, tables.program
    if program is None or table is None:
        return parts
    if isinstance(program, Path):
        return parts._replace(path=recorded_path(program, period, problems))
    speed = None if parts.robot is None else parts.robot.joint_speed
    if table.joint_ramp > 0 and (speed is None or not np.isfinite(speed).any()):
        problems.append(
            "[program] joint_ramp: found one, but no joint has a speed; give the robot "
            "speeds, or leave it out"
        )
    timed = time_program(program, table, problems)
    return parts if timed is None else _with_rows(parts, timed, problems)


def _with_rows(parts: _Parts, timed: TimedProgram, problems: list[str]) -> _Parts:
    """Parts with a timed program and its rows."""
    path = rows_of(timed, parts.tooth_period, problems)
    if path is not None and parts.controller is not None:
        rest = _standstill_rows(parts.controller, parts.tooth_period)
        if not path.step_count + 2 * rest <= _MOST_STEPS:
            problems.append(
                f"[controller]: found a delay for which the program rests {rest:.3g} "
                f"tooth periods before and after it; at most {_MOST_STEPS} are allowed "
                "with its own"
            )
            return parts._replace(timed=timed, path=None)
        path = path.with_standstill(math.ceil(rest))
    return parts._replace(timed=timed, path=path)


def _assemble(
    name: str,
    text: str,
    tables: JobTables,
    parts: _Parts,
    simulation: SimulationSettings,
    found: list[str],
) -> Job:
    """Job of faultless parts."""
    program, cutter, path, stock = parts.program, parts.cutter, parts.path, parts.stock
    assert cutter is not None and path is not None and stock is not None
    assert parts.speed is not None
    force, block, robot = tables.force, tables.stock, tables.robot
    correction, output = tables.correction, tables.output
    assert force is not None and block is not None
    assert correction is not None and output is not None
    law, bottom_law = force.laws(cutter)
    output = _completed_output(output, tables.program, program, path)
    job = Job(
        name=name,
        cutter=cutter,
        law=law,
        spindle_speed=parts.speed,
        stock=stock.make(),
        path=path,
        robot=parts.robot,
        modes=parts.modes,
        T_base_work=parts.T_base_work,
        joint_start=parts.joint_start,
        tool_rotation="free" if _is_free(robot) else "fixed",
        simulation=simulation,
        correction=completed_correction(
            correction, is_recorded=isinstance(program, Path)
        ),
        source=text,
        program=program.source if isinstance(program, Program) else "",
        notes=(
            *force.notes(cutter),
            *(f"[output] {note}" for note in output.idle()),
            *found,
            *notes(stock, path, cutter),
            *rate_notes(stock, path, cutter, parts.tooth_period),
        ),
        bottom_law=bottom_law,
        holder=parts.holder,
        keeps_intervals=block.intervals is not None,
        output=output,
        controller=parts.controller,
        timing=None if parts.timed is None else parts.timed.timing,
        commanded=parts.commanded,
    )
    more = end_notes(job, parts.joints)
    return dataclasses.replace(job, notes=(*job.notes, *more))


def _completed_output(
    output: OutputSettings,
    table: ProgramTable | None,
    program: Program | Path | None,
    path: Path,
) -> OutputSettings:
    """Settings with the keys that a job leaves out, and the angles of its program."""
    axis, formats = output.tool_axis, output.formats
    if formats is None:
        formats = ("gcode",) if path.is_upright else ("krl",)
    if axis is None and isinstance(program, Program) and table is not None:
        axis = table.tool_axis
    return dataclasses.replace(
        output,
        formats=formats,
        tool_axis=axis or OutputSettings.tool_axis,
        first_angles=getattr(program, "first_angles", None),
    )


def _is_free(table: RobotTable | None) -> bool:
    """True if the inverse kinematics chooses the rotation about the tool axis."""
    return table is not None and table.tool_rotation == "free"


def _simulation(
    tables: JobTables, parts: _Parts, context: FileContext
) -> SimulationSettings | None:
    """Numerical settings with those that follow from the job, and their faults."""
    table, robot = tables.simulation, tables.robot
    cutter, path, stock = parts.cutter, parts.path, parts.stock
    problems = context.problems
    if table is None or cutter is None or parts.speed is None:
        return None
    period = parts.tooth_period
    fastest = parts.fastest if table.mode == "dynamic" else 0.0
    substeps = table.substeps or default_substeps(period, fastest)
    axes = _axes(path, table)
    angles = _angles(table, cutter, substeps, not axes, problems)
    deepest = None
    if path is not None and stock is not None:
        deepest = immersion(path, cutter, stock) + _ROOM
    _check_simulation(tables, cutter, deepest, problems)
    is_unknown = cutter.has_dish and (bool(axes) or not cutter.is_plain)
    if table.has_bottom and is_unknown:
        problems.append(
            "[simulation] bottom_edges: found true, but with dish_angle they are known "
            "only of a tool that stands upright, with even pitch and without run-out"
        )
    has_bottom = table.has_bottom
    if has_bottom is None:
        # A flat end on a machine that swings would be pressed onto every floor.
        is_rigid = robot is not None and robot.rigid
        has_bottom = (is_rigid or cutter.has_dish) and not is_unknown
    if parts.modes is not None and parts.controller is not None and axes:
        problems.append(
            "[controller]: found beside [machine] and a tool that tilts, but it is "
            "known of the axes x, y and z alone"
        )
    if table.scatter is not None and robot is not None and robot.rigid:
        problems.append(
            "[simulation] scatter: found a table, but the error to be expected is "
            "known only of a machine that is not rigid"
        )
    if stock is None or path is None or deepest is None:
        return None
    height = table.element_height or default_element_height(
        table.chip, stock.spacing, cutter
    )
    depth = table.axial_depth or deepest
    if depth < (deepest - _ROOM) * (1 - _ROUNDING):
        context.notes.append(
            f"[simulation] axial_depth: found {depth * 1e3:g} mm, but the path goes "
            f"{(deepest - _ROOM) * 1e3:g} mm below the top of the stock; what the tool "
            "cuts farther above its tip is not computed"
        )
    if depth > _MOST_DISCS * height:
        problems.append(
            f"[simulation] element_height: found {height * 1e3:g} mm, for which a "
            f"depth of {depth * 1e3:g} mm takes {depth / height:.3g} discs; at most "
            f"{_MOST_DISCS} are allowed"
        )
    # A default below it has no effect on a job that is not corrected.
    knots = tables.correction
    if knots is not None and "correction.knot_spacing" in tables.stated:
        if knots.knot_spacing < period:
            problems.append(
                f"[correction] knot_spacing: found {knots.knot_spacing * 1e3:g} ms, "
                f"but at least the tooth period, {period * 1e3:g} ms, is required"
            )
    if parts.modes is not None:
        check_constant_force(fastest, period / substeps, context.notes)
    elif fastest > 0.0:
        check_modes(fastest, period / substeps, context.notes)
    if tables.correction is not None:
        check_correction(tables.correction, cutter, not axes, problems, mode=table.mode)
        check_sections(tables.correction.sections, parts.program, problems)
    updates = default_updates(period, substeps)
    return dataclasses.replace(
        table,
        angles=angles,
        substeps=substeps,
        element_height=height,
        axial_depth=depth,
        plunges=Immersion.is_plunging(path.positions, float(stock.upper[2])),
        has_bottom=has_bottom,
        axes=axes,
        updates_per_period=updates if table.chip.updates_within_period else 1,
    )


def _angles(
    table: SimulationSettings,
    cutter: AbstractCutter,
    substeps: int,
    is_upright: bool,
    problems: list[str],
) -> int:
    """Samples per revolution, a multiple of teeth x sub-steps."""
    block = cutter.flute_count * substeps
    fewest = _FEWEST_ANGLES if cutter.is_plain and is_upright else _FEWEST_IN_SPACE
    angles = table.angles or block * math.ceil(fewest / block)
    if angles < fewest or angles % block:
        near = max(angles // block, math.ceil(fewest / block)) * block
        problems.append(
            f"[simulation] angles: found {angles}, but at least {fewest} and a "
            f"multiple of teeth x substeps ({cutter.flute_count} x {substeps} = "
            f"{block}) is required, such as {near}"
        )
    return angles


def _check_simulation(
    tables: JobTables,
    cutter: AbstractCutter,
    deepest: float | None,
    problems: list[str],
) -> None:
    """Faults of settings beside the cutter or the machine.

    Args:
        tables: The checked tables of the job.
        cutter: The cutter.
        deepest: The depth that is taken if the job gives none [m], if it is known.
        problems: Receives what is wrong.
    """
    table, robot = tables.simulation, tables.robot
    assert table is not None
    is_rigid = robot is not None and robot.rigid
    most = max(cutter.flute_length, deepest or 0.0)
    if table.axial_depth is not None and table.axial_depth > most * (1 + _ROUNDING):
        problems.append(
            f"[simulation] axial_depth: found {table.axial_depth * 1e3:g} mm; at most "
            f"{most * 1e3:g} mm is allowed: the flute length, or the depth of the path"
        )
    chip, others = table.chip, ChipSettings.each()
    if chip.needs_plain_cutter and not cutter.is_plain:
        free = [f'"{k}"' for k, one in others.items() if not one.needs_plain_cutter]
        problems.append(
            f'[simulation] chip: found "{chip.name}", which a flat cutter with even '
            f"pitch and without run-out is required for; others take {', '.join(free)}"
        )
    if table.stability == "full" and (is_rigid or table.mode == "quasistatic"):
        why = "rigid = true" if is_rigid else 'mode = "quasistatic"'
        problems.append(
            f"[simulation] stability: found true, but with {why} nothing vibrates; "
            'only false or "quick" is allowed'
        )
    if table.has_sensitivity and is_rigid:
        problems.append(
            "[simulation] sensitivity: found true, but with rigid = true no parameter "
            "moves the tool; only false is allowed"
        )


def _axes(
    path: Path | None, table: SimulationSettings
) -> tuple[tuple[float, float, float], ...]:
    """Directions of the tool, rounded; none if it stands upright."""
    if path is None:
        return ()
    if not table.tilts and path.is_upright:
        return ()
    # They size arrays: neighbours are one.
    rows = np.unique(np.round(np.asarray(path.axes), 2), axis=0)
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
