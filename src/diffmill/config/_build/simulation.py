"""`[simulation]`: what of it follows from the rest of a job, or does not suit it."""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from ...cutter import AbstractCutter
from ...process import Immersion, default_element_height
from ...robot import drive_classes
from ...settings.machine_errors import MachineErrorSettings
from ...settings.simulation import ChipSettings, ScatterSettings, SimulationSettings
from ...toolpath import Path
from .._check.modes import (
    check_constant_force,
    check_modes,
    default_substeps,
    default_updates,
)
from .._check.notes import immersion
from .._schema.job import JobTables
from .context import FileContext
from .correction import check_correction
from .parts import JobParts
from .program import check_sections

# Room below the deepest disc [m].
_ROOM = 0.6e-3
# Samples per revolution: of a flat cutter that stands upright, and of any other.
_FEWEST_ANGLES, _FEWEST_IN_SPACE = 180, 96
# Discs of a cutter: each has samples of its own at every angle.
_MOST_DISCS = 10_000
# Of a length that is written down with a few digits.
_ROUNDING = 1e-6


def completed_simulation(
    tables: JobTables, parts: JobParts, context: FileContext
) -> SimulationSettings | None:
    """Numerical settings with those that follow from the job, and their faults."""
    table, robot = tables.simulation, tables.robot
    cutter, path, stock = parts.cutter, parts.path, parts.stock
    problems = context.problems
    if table is None or cutter is None or parts.speed is None:
        return None
    period = parts.tooth_period
    fastest = parts.fastest if table.mode.vibrates else 0.0
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
            "only of an upright tool, with even pitch and without run-out"
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
    problems.extend(_machine_faults(tables, parts))
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
    if table.resolution == "adaptive" and updates > 1:
        problems.append(
            f'[simulation] resolution: found "adaptive" with a tooth period of '
            f"{period * 1e3:g} ms with {updates} engagement updates; "
            'only "every tooth" is allowed'
        )
    return dataclasses.replace(
        table,
        scatter=_scatter(tables),
        angles=angles,
        substeps=substeps,
        element_height=height,
        axial_depth=depth,
        plunges=Immersion.is_plunging(path.positions, float(stock.upper[2])),
        has_bottom=has_bottom,
        axes=axes,
        updates_per_period=updates if table.chip.updates_within_period else 1,
    )


def _scatter(tables: JobTables) -> ScatterSettings | None:
    """Scatter of the machine: that of assumed drives, where the file states none."""
    simulation, robot = tables.simulation, tables.robot
    assert simulation is not None
    assumed = None if robot is None else drive_classes().get(robot.drives or "")
    if assumed is None or robot is None or not simulation.mode.vibrates:
        return simulation.scatter
    stated = simulation.scatter or ScatterSettings()
    # What the file states beside the class is not assumed.
    spreads = {
        "stiffness": assumed.spread if robot.joint_stiffness is None else 0.0,
        "damping": assumed.damping_spread if robot.joint_damping is None else 0.0,
    }
    missing = {k: v for k, v in spreads.items() if not getattr(stated, k)}
    return dataclasses.replace(stated, **missing)


def _machine_faults(tables: JobTables, parts: JobParts) -> Iterator[str]:
    """Faults of sizes of machine errors that the machine of the job cannot have."""
    simulation, correction = tables.simulation, tables.correction
    assert simulation is not None
    stated: dict[str, MachineErrorSettings | None] = {
        "[simulation] scatter": simulation.scatter,
        "[correction] uncertainty": correction and correction.uncertainty,
        "[truth]": tables.truth,
    }
    controller = parts.controller
    for table, sizes in stated.items():
        for name in () if sizes is None else sizes.robot_errors:
            if parts.modes is not None and table != "[truth]":
                why = "a robot, but the job has [machine]"
            elif name == "bandwidth" and (
                controller is None or controller.bandwidth is None
            ):
                why = "[controller] with a bandwidth"
            elif name == "runout" and simulation.chip.needs_plain_cutter:
                why = f'a chip model other than "{simulation.chip.name}"'
            elif table == "[simulation] scatter" and not simulation.mode.vibrates:
                why = f'a mode other than "{simulation.mode.name}"'
            else:
                continue
            yield f"{table} {name}: found a size above 0, which needs {why}"


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
    if table.stability == "full" and (is_rigid or not table.mode.vibrates):
        why = "rigid = true" if is_rigid else f'mode = "{table.mode.name}"'
        problems.append(
            f"[simulation] stability: found true, but with {why} nothing vibrates; "
            'only false or "quick" is allowed'
        )
    differs = not cutter.has_even_pitch or cutter.has_runout
    if table.resolution == "adaptive" and (differs or chip.needs_plain_cutter):
        why = f'chip = "{chip.name}"' if not differs else "teeth that are not alike"
        problems.append(
            f'[simulation] resolution: found "adaptive" with {why}, but an engagement '
            'is reused only with even pitch, no run-out and chip = "near_far"; '
            'only "every tooth" is allowed'
        )
    if table.has_sensitivity and is_rigid:
        problems.append(
            "[simulation] sensitivity: found true, but with rigid = true no parameter "
            "moves the tool; only false is allowed"
        )


def _axes(
    path: Path | None, table: SimulationSettings
) -> tuple[tuple[float, float, float], ...]:
    """Directions of the tool, rounded; none if it is upright."""
    if path is None:
        return ()
    if not table.tilts and path.is_upright:
        return ()
    # They size arrays: neighbours are one.
    rows = np.unique(np.round(np.asarray(path.axes), 2), axis=0)
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
