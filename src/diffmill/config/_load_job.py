"""Reading a job: every fault of the file and what it refers to, in one error."""

import math
import os
import pathlib
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from .._job import Job, SimulationSettings
from .._toml import JobError, read_toml
from ..cutter import AbstractCutter, ToolHolder
from ..process import default_element_height, is_plunging
from ..robot import Robot
from ..toolpath import Path, Program
from ._build.program import read_program, spindle_speed, time_path
from ._build.robot import added_joints, pose_matrix, read_robot
from ._build.stock import StockPlan, read_stock
from ._check.modes import (
    LONGEST_SUBSTEP,
    check_modes,
    check_sag,
    counting_modes,
    default_looks,
    default_substeps,
)
from ._check.rapids import check_overhang, check_rapids, immersion, notes
from ._check.reach import check_reach
from ._schema.correction import check_correction, correction_settings
from ._schema.cutter import make_cutter, make_holder
from ._schema.job import ProgramTable, SimulationTable, read_tables

# Room below the deepest disc [m].
_ROOM = 0.6e-3
# Samples per revolution: of a flat cutter that stands upright, and of any other.
_FEWEST_ANGLES, _FEWEST_IN_SPACE = 180, 96
# Of a length that is written down with a few digits.
_ROUNDING = 1e-6


def load_job(file: str | os.PathLike[str], *, allow_outside: bool = False) -> Job:
    """Return a job from a TOML file and the program and robot that it names.

    Args:
        file: The job file.
        allow_outside: Whether the job may name files outside its own folder.

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
    problems: list[str] = []
    tables = read_tables(raw, problems)
    if "program" not in tables:
        _check_program(raw.get("program"), path.parent, problems, allow_outside)
    job = _build(path, text, tables, problems, allow_outside=allow_outside)
    if problems or job is None:
        raise JobError(path, problems)
    return job


def job_precision(file: str | os.PathLike[str]) -> str:
    """Return the precision that a job asks for, before JAX is configured for it.

    Args:
        file: The job file.

    Returns:
        "float32" if the job says so, else "float64", also for a faulty job.
    """
    try:
        _, raw = read_toml(pathlib.Path(file))
    except JobError:
        return "float64"
    simulation = raw.get("simulation", {})
    found = simulation.get("precision") if isinstance(simulation, dict) else None
    return "float32" if found == "float32" else "float64"


def _check_program(
    raw: object, folder: pathlib.Path, problems: list[str], allow_outside: bool
) -> None:
    """Note the faults of a program although its table has faults of its own."""
    name = raw.get("file") if isinstance(raw, dict) else None
    if isinstance(name, str) and name:
        # Any feed will do: a faulty one has been reported.
        table = ProgramTable(file=name).model_copy(update={"feed": 1.0})
        read_program(table, folder, problems, allow_outside=allow_outside)


def _build(
    path: pathlib.Path,
    text: str,
    tables: dict[str, Any],
    problems: list[str],
    *,
    allow_outside: bool,
) -> Job | None:
    """Return the job of checked tables; None, or a job of no use, after problems."""
    folder = path.parent
    program, robot, start = None, None, None
    robot_notes: list[str] = []
    outside = {"allow_outside": allow_outside}
    if "program" in tables:
        program = read_program(tables["program"], folder, problems, **outside)
    speed = None
    if "spindle" in tables:
        speed = spindle_speed(tables["spindle"].speed, program, problems)
    cutter = make_cutter(tables["cutter"]) if "cutter" in tables else None
    holder = make_holder(tables["cutter"]) if "cutter" in tables else None
    check_overhang(tables, problems)
    if "robot" in tables:
        robot, start = read_robot(
            tables["robot"], cutter, folder, problems, robot_notes, **outside
        )
    if cutter is not None and "force" in tables:
        tables["force"].check_teeth(cutter.flute_count, problems)
    stock = _stock(tables, folder, problems, allow_outside)
    desired = None
    if cutter is not None and speed is not None:
        desired = _timed(tables, program, speed, cutter.flute_count, problems)
    work = getattr(tables.get("robot"), "work_in_base", None)
    T_base_work = pose_matrix(work)
    fastest = 0.0
    if desired is not None and robot is not None and work is not None:
        rotation = tables["robot"].tool_rotation
        q = check_reach(
            robot,
            desired,
            T_base_work,
            start,
            rotation,
            problems,
            robot_notes,
            start_count=robot.joint_count - added_joints(tables["robot"]),
        )
        fastest = _check_springs(robot, q, problems, robot_notes)
    if desired is not None and cutter is not None and stock is not None:
        check_rapids(desired, cutter, holder, stock, problems, robot_notes)
    simulation = _simulation(tables, cutter, speed, (desired, stock), fastest, problems)
    if simulation is not None and fastest > 0.0 and simulation.mode == "dynamic":
        assert cutter is not None and speed is not None
        period = 2 * math.pi / (speed * cutter.flute_count)
        check_modes(fastest, period / simulation.substeps, robot_notes)
    if "correction" in tables and cutter is not None and simulation is not None:
        check_correction(tables["correction"], cutter, not simulation.axes, problems)
    if problems or simulation is None or desired is None or cutter is None:
        return None
    assert stock is not None
    return _assemble(
        path.stem,
        text,
        tables,
        (cutter, holder),
        speed,
        (desired, stock),
        simulation,
        program,
        (robot, T_base_work, start),
        robot_notes,
    )


def _stock(
    tables: dict[str, Any],
    folder: pathlib.Path,
    problems: list[str],
    allow_outside: bool,
) -> StockPlan | None:
    """Return the stock in the precision of the simulation, if there is its table."""
    if "stock" not in tables:
        return None
    precision = getattr(tables.get("simulation"), "precision", "float64")
    return read_stock(
        tables["stock"], precision, folder, problems, allow_outside=allow_outside
    )


def _timed(
    tables: dict[str, Any],
    program: Program | Path | None,
    speed: float,
    flute_count: int,
    problems: list[str],
) -> Path | None:
    """Return the program as a path with a row per tooth period, if it has one."""
    period = 2 * math.pi / (speed * flute_count)
    if period > 1000 * LONGEST_SUBSTEP:
        least = 60 / (flute_count * 1000 * LONGEST_SUBSTEP)
        problems.append(
            f"[spindle] speed: found {speed * 30 / math.pi:g} rpm; at least "
            f"{least:g} rpm is required"
        )
        return None
    if program is None:
        return None
    return time_path(program, tables["program"], period, problems)


def _assemble(
    name: str,
    text: str,
    tables: dict[str, Any],
    tool: tuple[AbstractCutter, ToolHolder | None],
    speed: float | None,
    place: tuple[Path, StockPlan],
    simulation: SimulationSettings,
    program: Program | Path | None,
    robot_parts: tuple[
        Robot | None, Float[np.ndarray, "4 4"], Float[np.ndarray, " joint"] | None
    ],
    robot_notes: list[str],
) -> Job:
    """Return the job of faultless parts."""
    assert speed is not None
    desired, stock = place
    cutter, holder = tool
    robot, T_base_work, start = robot_parts
    law, bottom_law = tables["force"].laws()
    return Job(
        name=name,
        cutter=cutter,
        law=law,
        spindle_speed=speed,
        stock=stock.make(),
        path=desired,
        robot=robot,
        T_base_work=T_base_work,
        joint_start=start,
        tool_rotation=tables["robot"].tool_rotation,
        simulation=simulation,
        correction=correction_settings(
            tables["correction"], is_recorded=isinstance(program, Path)
        ),
        source=text,
        program=program.source if isinstance(program, Program) else "",
        notes=(
            *tables["force"].notes(cutter),
            *robot_notes,
            *notes(stock, desired, cutter),
        ),
        bottom_law=bottom_law,
        holder=holder,
        keeps_intervals=tables["stock"].intervals is not None,
    )


def _simulation(
    tables: dict[str, Any],
    cutter: AbstractCutter | None,
    speed: float | None,
    place: tuple[Path | None, StockPlan | None],
    fastest: float,
    problems: list[str],
) -> SimulationSettings | None:
    """Return the numerical settings with their defaults."""
    table: SimulationTable | None = tables.get("simulation")
    path, stock = place
    if table is None or cutter is None or speed is None:
        return None
    period = 2 * math.pi / (speed * cutter.flute_count)
    substeps = table.substeps or default_substeps(
        period, fastest if table.mode == "dynamic" else 0.0
    )
    block = cutter.flute_count * substeps
    axes = _axes(path, table)
    fewest = _FEWEST_ANGLES if cutter.is_plain and not axes else _FEWEST_IN_SPACE
    angles = table.angles or block * math.ceil(fewest / block)
    if angles < fewest or angles % block:
        near = max(angles // block, math.ceil(fewest / block)) * block
        problems.append(
            f"[simulation] angles: found {angles}, but at least {fewest} and a "
            f"multiple of teeth x substeps ({cutter.flute_count} x {substeps} = "
            f"{block}) is required, such as {near}"
        )
    deepest = None
    if path is not None and stock is not None:
        deepest = immersion(path, cutter, stock) + _ROOM
    _check_simulation(tables, cutter, deepest, problems)
    if table.bottom_edges and cutter.has_dish and (axes or not cutter.is_plain):
        problems.append(
            "[simulation] bottom_edges: found true, but with dish_angle they are known "
            "only of a tool that stands upright, with even pitch and without run-out"
        )
    if stock is None or path is None or deepest is None:
        return None
    return SimulationSettings(
        angles=angles,
        substeps=substeps,
        element_height=table.element_height
        or default_element_height(table.chip, stock.spacing, cutter),
        axial_depth=table.axial_depth or deepest,
        precision=table.precision,
        is_gravity_compensated=table.gravity_compensated,
        plunges=is_plunging(path.positions, float(stock.upper[2])),
        has_bottom=table.bottom_edges,
        axes=axes,
        chip=table.chip,
        integrator=table.integrator,
        dynamics=table.dynamics,
        mode=table.mode,
        looks=default_looks(period, substeps) if table.chip == "near_far" else 1,
        has_sensitivity=table.sensitivity,
        stability=_stability(table.stability),
    )


def _stability(key: bool | Literal["quick"]) -> Literal["quick", "full", "none"]:
    """Return how chatter is looked for."""
    if key == "quick":
        return "quick"
    return "full" if key else "none"


def _check_springs(
    robot: Robot,
    q: Float[np.ndarray, "step joint"],
    problems: list[str],
    notes: list[str],
) -> float:
    """Return the highest frequency along a path that counts [Hz], 0 for none."""
    if not np.isfinite(np.asarray(robot.joint_stiffness)).all():
        return 0.0
    poses = q[[0, len(q) // 2, -1]]
    try:
        check_sag(robot, poses, problems, notes)
        return max(np.max(counting_modes(robot, row), initial=0.0) for row in poses)
    except ValueError as error:
        problems.append(f"[robot]: {error}")
        return 0.0


def _check_simulation(
    tables: dict[str, Any],
    cutter: AbstractCutter,
    deepest: float | None,
    problems: list[str],
) -> None:
    """Note settings that the cutter or the machine do not allow.

    Args:
        tables: The checked tables of the job.
        cutter: The cutter.
        deepest: The depth that is taken if the job gives none [m], if it is known.
        problems: Receives what is wrong.
    """
    table: SimulationTable = tables["simulation"]
    most = max(cutter.flute_length, deepest or 0.0)
    if table.axial_depth is not None and table.axial_depth > most * (1 + _ROUNDING):
        problems.append(
            f"[simulation] axial_depth: found {table.axial_depth * 1e3:g} mm; at most "
            f"{most * 1e3:g} mm is allowed: the flute length, or the depth of the path"
        )
    if table.chip == "point_cloud" and not cutter.is_plain:
        problems.append(
            '[simulation] chip: found "point_cloud", which a flat cutter with even '
            'pitch and without run-out is required for; others take "near_far"'
        )
    if table.stability is True:
        _check_vibrates(tables, problems)
    if table.sensitivity and "robot" in tables and tables["robot"].rigid:
        problems.append(
            "[simulation] sensitivity: found true, but with rigid = true no parameter "
            "moves the tool; only false is allowed"
        )


def _check_vibrates(tables: dict[str, Any], problems: list[str]) -> None:
    """Note where the stability is asked for of a machine that cannot vibrate."""
    is_rigid = "robot" in tables and tables["robot"].rigid
    if is_rigid or tables["simulation"].mode == "quasistatic":
        why = "rigid = true" if is_rigid else 'mode = "quasistatic"'
        problems.append(
            f"[simulation] stability: found true, but with {why} nothing vibrates; "
            'only false or "quick" is allowed'
        )


def _axes(
    path: Path | None, table: SimulationTable
) -> tuple[tuple[float, float, float], ...]:
    """Return the directions of the tool, or none if it stands upright."""
    if path is None:
        return ()
    rows = np.unique(np.round(np.asarray(path.axes), 2), axis=0)
    if not table.tool_tilt and np.array_equal(rows, [[0.0, 0.0, 1.0]]):
        return ()
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
