"""Load tests as a table: joint positions, loads and displacements, one pose per row."""

import re
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ... import units as q
from ...identification import LoadTestStudy, Record
from ...io import Quantity, TableReader
from ...robot import Robot, forward_kinematics
from .context import Context
from .schema import LoadTestsTable

# Rotations of one pose each.
Turns = Float[np.ndarray, "pose 3 3"]
# No joint turns so far [rad], and no load bends a robot so far [m]; hardly one a fifth
# of that, where the user has not confirmed the unit.
_LARGEST_ANGLE, _LARGEST_MOVE, _USUAL_MOVE = 4 * np.pi, 0.1, 0.02


class _Tests(NamedTuple):
    """Rows of a table as written, in SI units; shape (row, component) each."""

    joint: np.ndarray
    load: np.ndarray
    moved: np.ndarray
    notes: list[str]
    channels: tuple[Record.Channel, ...]


def read_load_tests(
    name: str,
    table: LoadTestsTable,
    robot: Robot,
    notes: list[str],
    context: Context,
) -> LoadTestStudy | None:
    """Return load tests, the loads in base axes, or None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[load_tests]`.
        robot: The robot with its tool.
        notes: What is doubtful in the robot's file.
        context: Folder and problems.
    """
    found = context.read(table, "[load_tests]", _columns(table, robot))
    if found is None:
        return None
    good = _good_rows(found, table, context.problems)
    if good is None:
        return None
    if not good.any():
        context.problems.append(
            f"[load_tests] file: {table.file}: found no complete row."
        )
        return None
    angles, load, moved = found.joint[good], found.load[good], found.moved[good]
    tool = _tool_axes(robot, angles)
    load_frame, frame = (
        tool if name == "tool" else None
        for name in (table.load_frame, table.displacement_frame)
    )
    load = _exchanged(load, table.load_axes)
    if load_frame is not None:
        parts = load.reshape(len(load), -1, 3)
        load = np.einsum("pij,pkj->pki", load_frame, parts).reshape(load.shape)
    return LoadTestStudy(
        name=name,
        robot=robot,
        q=angles,
        wrench=np.pad(load, ((0, 0), (0, 6 - load.shape[1]))),
        # In base one missing component would make all of them unknown.
        displacement=_exchanged(moved, table.displacement_axes),
        load_frame=load_frame,
        displacement_frame=frame,
        rows=tuple((np.flatnonzero(good) + 1).tolist()),
        has_offset=table.has_offset,
        noise=table.noise,
        notes=(*notes, *found.notes),
        channels=found.channels,
    )


def _good_rows(
    found: _Tests, table: LoadTestsTable, problems: list[str]
) -> Bool[np.ndarray, " row"] | None:
    """Return which rows are complete and wanted; None with problems noted."""
    whole = np.hstack([found.joint, found.load])
    good = np.asarray(
        np.isfinite(whole).all(axis=1) & np.isfinite(found.moved).any(axis=1)
    )
    if not good.all():
        found.notes.append(_lost_rows(np.flatnonzero(~good) + 1))
    for row in table.skip_rows:
        if row > len(good):
            problems.append(
                f"[load_tests] skip_rows: found {row}, but there are {len(good)} rows"
            )
            return None
        good[row - 1] = False
    return good


def _lost_rows(lost: Int[np.ndarray, " row"]) -> str:
    shown = ", ".join(map(str, lost[:10].tolist()))
    more = ", ..." if lost.size > 10 else ""
    return f"Rows {shown}{more} have empty cells and were left out."


def _columns(table: LoadTestsTable, robot: Robot) -> Callable[[TableReader], _Tests]:
    """Return what reads joint positions, loads and displacements."""

    def build(reader: TableReader) -> _Tests:
        groups = _groups(robot)
        reader.allow(quantity for group in groups.values() for quantity in group)
        values, missing = {}, []
        for name, group in groups.items():
            given = _given(name, group, reader)
            lost = [quantity.key for quantity in group if quantity.key not in given]
            if lost and (given or name not in ("moment", "rotation")):
                missing.extend(lost)
            elif given:
                values[name] = np.column_stack([given[one.key] for one in group])
        if missing and not reader.faults:
            reader.faults.append(
                f"found no column for {', '.join(missing)} among {reader.listed()}; "
                "name it with `channels`."
            )
        reader.check()
        _check_sizes(robot, values, table, reader.faults)
        reader.check()
        load = [values[n] for n in ("force", "moment") if n in values]
        moved = [values[n] for n in ("displacement", "rotation") if n in values]
        return _Tests(
            values["joint"],
            np.hstack(load),
            np.hstack(moved),
            reader.notes,
            tuple(reader.read),
        )

    return build


def _groups(robot: Robot) -> dict[str, tuple[Quantity, ...]]:
    """Return the columns of a table by what they measure."""
    joints = zip(robot.joint_names, robot.joint_kinds, strict=True)
    return {
        "joint": tuple(
            Quantity(
                name,
                rf"{re.escape(name)}|(q|j|a|theta|axis|joint|achse)[\s_.\-]*{i}",
                (q.LENGTH,) if kind == "prismatic" else (q.ANGLE,),
                ("joint",),
            )
            for i, (name, kind) in enumerate(joints, 1)
        ),
        "force": Quantity.vector("F", "f|force|kraft", q.FORCE, "force"),
        "moment": Quantity.vector("M", "m|t|moment|torque", q.MOMENT, "moment"),
        "displacement": Quantity.vector(
            "d", r"d|u|delta|defl|deflection|disp\w*", q.LENGTH, "displacement"
        ),
        "rotation": Quantity.vector("r", "r|dr|rot|rotation|phi", q.ANGLE, "rotation"),
    }


def _given(
    name: str, group: tuple[Quantity, ...], reader: TableReader
) -> dict[str, np.ndarray]:
    """Return the columns of a group that there are, those that are "none" filled."""
    parts = {quantity.key: reader.values(quantity) for quantity in group}
    given = {key: part for key, part in parts.items() if part is not None}
    # "none": no load along this axis, no measurement along that one.
    for key in [k for k in parts if given and reader.is_excluded(k)]:
        fill = 0.0 if name in ("force", "moment") else np.nan
        given[key] = np.full(len(next(iter(given.values()))), fill)
    return given


def _check_sizes(
    robot: Robot,
    values: dict[str, np.ndarray],
    table: LoadTestsTable,
    faults: list[str],
) -> None:
    """Note numbers that only another unit explains."""
    turning = np.array([kind != "prismatic" for kind in robot.joint_kinds])
    angle = float(np.nanmax(np.abs(values["joint"][:, turning]), initial=0.0))
    moved = _usual_move(values, table)
    most = _LARGEST_MOVE if "displacement" in table.units else _USUAL_MOVE
    for what, size, limit, unit, wrong in (
        ("joint", angle, _LARGEST_ANGLE, "rad", "deg"),
        ("displacement", moved, most, "m", "mm"),
    ):
        if size > limit:
            faults.append(
                f"the columns of `{what}` hold {size:.4g} {unit}, which no load test "
                f"has; give the unit in the header, or by `units`, such as "
                f'{{ {what} = "{wrong}" }}.'
            )


def _usual_move(values: dict[str, np.ndarray], table: LoadTestsTable) -> float:
    """Return how far the tool moves in the median pose [m]."""
    moved = values["displacement"]
    if table.has_offset:
        # The zero of a tracker lies anywhere.
        seen = [part[np.isfinite(part)] for part in moved.T]
        moved = moved - np.array([np.median(x) if x.size else 0.0 for x in seen])
    moved = moved[np.isfinite(moved).any(axis=1)]
    # The whole vector: along the load it moves much farther than across.
    lengths = np.sqrt(np.nansum(moved**2, axis=1))
    return float(np.median(lengths)) if lengths.size else 0.0


def _tool_axes(robot: Robot, angles: np.ndarray) -> Turns:
    """Return the rotations of the tool into base."""
    poses = jax.vmap(lambda row: forward_kinematics(robot, row))(
        np.asarray(angles, robot.dtype)
    )
    return np.asarray(poses, np.float64)[:, :3, :3]


def _exchanged(vectors: np.ndarray, axes: list[str] | None) -> np.ndarray:
    """Return vectors with the axes exchanged.

    Moments and rotations, behind forces and displacements, change their sign once more
    where the axes are mirrored.
    """
    if axes is None:
        return vectors
    parts = vectors.reshape(len(vectors), -1, 3)
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
    order = ["xyz".index(name[-1]) for name in axes]
    handed = np.array([1.0, np.prod(signs) * np.linalg.det(np.eye(3)[order])])
    parts = parts[:, :, order] * signs[None, None]
    parts = parts * handed[None, : parts.shape[1], None]
    return parts.reshape(vectors.shape)
