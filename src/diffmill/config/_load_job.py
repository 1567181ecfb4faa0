"""Reading a job: every fault of the file and what it refers to, in one error."""

import dataclasses
import math
import os
import pathlib
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from .._job import Job
from .._toml import JobError, read_toml
from ..io import PROGRAM_FORMATS
from ..robot import Controller, Robot
from ..settings.correction import CorrectionSettings
from ..settings.output import OutputSettings
from ..settings.simulation import SimulationSettings
from ..settings.tables import idle_keys
from ..sim import mismatched
from ..toolpath import Path, Program, TimedProgram
from ._build.context import FileContext
from ._build.correction import completed_correction
from ._build.learnt import read_learnt, with_learnt
from ._build.machine import fastest_mode, read_machine
from ._build.parts import JobParts
from ._build.program import (
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
from ._build.simulation import completed_simulation
from ._build.stock import read_stock
from ._changes import changed, changes_text
from ._check.calibration import calibration_note
from ._check.end_force import end_notes
from ._check.frames import base_note, program_base, tool_note
from ._check.modes import (
    LONGEST_SUBSTEP,
    check_sag,
    counting_modes,
)
from ._check.notes import notes, rate_notes
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

# Delays of its controller for which a program is at rest before and after it.
_REST = 3.0
# How often a program is slowed down for joints: what they do between two rows shows
# when slower rows are nearer to each other. Two are enough as a rule.
_PASSES = 3
# As `TimedProgram.path` takes, before there is a rest.
_MOST_STEPS = 1_000_000


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
    simulation = completed_simulation(tables, parts, context)
    if context.problems or simulation is None:
        raise JobError(path, context.problems)
    job = _assemble(path.stem, text, tables, parts, simulation, context.notes)
    if parts.learnt is not None:
        job = with_learnt(job, parts.learnt, context)
    if context.problems:
        raise JobError(path, context.problems)
    return job


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


def _read_parts(
    tables: JobTables, context: FileContext, *, overrides_speed: bool
) -> JobParts:
    """Parts that checked tables state, with the path and the robot along it."""
    problems = context.problems
    program, speed, cutter, holder, stock, robot, start, known = (None,) * 8
    if tables.program is not None:
        program = read_program(tables.program, context, tables.cutter)
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
        robot, start, known = fitted.robot, fitted.joint_start, fitted.nominal
        if robot is not None:
            T_base_work = stated if work is None and stated is not None else T_base_work
            found = base_note(T_base_work, program, is_stated=work is not None)
            context.notes.extend(found + tool_note(fitted.T_flange_tool, program))
        rotation, is_arm = table.tool_rotation, robot is not None
        if rotation == "fixed" and getattr(program, "states_rotation", False):
            context.notes.append(
                '[robot] tool_rotation: "fixed" leaves out the rotation about the tool '
                "axis that the program states; what is written has x of the tool as "
                "near to x of work as can be, which turns the last axis"
            )
        program = rotated_as_asked(rotation, program, problems, is_arm=is_arm)
    if cutter is not None and tables.force is not None:
        tables.force.check_teeth(cutter.flute_count, problems)
    if tables.stock is not None:
        settings = tables.simulation
        precision = "float64" if settings is None else settings.precision
        stock = read_stock(tables.stock, precision, context)
    parts = JobParts(
        program, speed, cutter, holder, stock, robot, T_base_work, start, None
    )
    parts = parts._replace(nominal=known)
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
    if tables.learnt is not None and tables.learnt.file is not None:
        learnt = read_learnt(tables.learnt.file, "[learnt] file", context)
        parts = parts._replace(learnt=learnt)
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


def _follow(tables: JobTables, parts: JobParts, context: FileContext) -> JobParts:
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
    parts: JobParts,
    checks: ReachCheck,
    q: Float[np.ndarray, "step joint"],
    ramp: float,
    context: FileContext,
) -> tuple[JobParts, Float[np.ndarray, "slower joint"]]:
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
    if simulation is not None and not simulation.mode.vibrates:
        problems.append(
            f'[simulation] mode: found "{simulation.mode.name}" beside [machine], but '
            "a mode has a mass"
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


def _timed(tables: JobTables, parts: JobParts, problems: list[str]) -> JobParts:
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


def _with_rows(parts: JobParts, timed: TimedProgram, problems: list[str]) -> JobParts:
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
    parts: JobParts,
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
    assert tables.truth is not None
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
        truth=tables.truth,
        probes=_probes(tables),
    )
    more = end_notes(job, parts.joints)
    if parts.nominal is not None:
        model = dataclasses.replace(job, robot=parts.nominal)
        job = mismatched(model, job)
        more = [*more, calibration_note(job)]
    return dataclasses.replace(job, notes=(*job.notes, *more))


def _probes(tables: JobTables) -> Float[np.ndarray, "probe 3"] | None:
    """Points of the work that are touched off, if the job states them [m]."""
    table = tables.registration
    return None if table is None or table.points is None else np.array(table.points)


def _completed_output(
    output: OutputSettings,
    table: ProgramTable | None,
    program: Program | Path | None,
    path: Path,
) -> OutputSettings:
    """Settings with the keys that a job leaves out, and the angles of its program."""
    axis, formats = output.tool_axis, output.formats
    if formats is None:
        formats = (_own_format(table) or ("gcode" if path.is_upright else "krl"),)
    if axis is None and isinstance(program, Program) and table is not None:
        axis = table.tool_axis
    return dataclasses.replace(
        output,
        formats=formats,
        tool_axis=axis or OutputSettings.tool_axis,
        first_angles=getattr(program, "first_angles", None),
        first_status=getattr(program, "first_status", ()),
        source_axis=getattr(program, "tool_axis", None),
        pass_over=() if table is None else tuple(table.pass_over),
    )


def _own_format(table: ProgramTable | None) -> str | None:
    """Format of a robot's program that `correct` can run; None for another program."""
    suffix = "" if table is None else pathlib.Path(table.file).suffix.lower()
    language = PROGRAM_FORMATS.get(suffix, "")
    return language.lower() if language in ("KRL", "RAPID") else None


def _is_free(table: RobotTable | None) -> bool:
    """True if the inverse kinematics chooses the rotation about the tool axis."""
    return table is not None and table.tool_rotation == "free"
