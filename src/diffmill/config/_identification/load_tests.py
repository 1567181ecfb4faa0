"""Load tests as a table: joint positions, loads and displacements, one pose per row."""

import dataclasses
import functools
from typing import Annotated, Literal

import jax
import numpy as np
from pydantic import Field, StrictBool, StrictInt

from ... import units as q
from ...identification import LoadTestStudy
from ...io import Quantity, TableReader
from ...robot import Robot, forward_kinematics
from .context import Context
from .fields import Axes, File
from .kind import IdentificationKind
from .robot import (
    LARGEST_ANGLE,
    StudiedRobotTable,
    joint_quantities,
    read_tool_robot,
)
from .schema import MeasuredTable

# No load bends a robot so far [m]; hardly one a fifth of that, where the user has not
# confirmed the unit.
_LARGEST_MOVE, _USUAL_MOVE = 0.1, 0.02


class LoadTestsTable(MeasuredTable):
    """`[load_tests]`."""

    file: File = Field(description='table with one pose per row, such as "loads.csv"')
    load_axes: Axes | None = Field(
        default=None,
        description="for x, y, z of load_frame the recorded axis, such as "
        '["-y", "x", "z"]; as recorded if left out',
    )
    displacement_axes: Axes | None = Field(
        default=None,
        description="for x, y, z of displacement_frame the recorded axis, such as "
        '["-y", "x", "z"]; as recorded if left out',
    )
    load_frame: Literal["base", "tool"] = Field(
        default="base", description="frame in which the load was recorded"
    )
    displacement_frame: Literal["base", "tool"] = Field(
        default="base", description="frame in which the displacement was recorded"
    )
    has_offset: StrictBool = Field(
        default=False,
        description="true: a constant displacement is fitted too, as of a tracker",
    )
    noise: Literal["absolute", "relative"] | None = Field(
        default=None,
        description="scatter of the poses: alike, or in proportion to the "
        "displacement; the likelier if left out",
    )
    skip_rows: list[Annotated[StrictInt, Field(ge=1)]] = Field(
        default_factory=list,
        description="numbers of rows that are left out, such as [7]",
    )


def _read(
    name: str,
    context: Context,
    *,
    robot: StudiedRobotTable | None = None,
    load_tests: LoadTestsTable | None = None,
) -> LoadTestStudy | None:
    """Study of load tests, the loads in base axes, or None with problems noted.

    Args:
        name: The file that asks for it.
        context: Folder and problems.
        robot: `[robot]`.
        load_tests: `[load_tests]`.
    """
    notes: list[str] = []
    if robot is None:
        return None
    arm = read_tool_robot(robot, context, notes, needs_mass=False)
    if arm is None or load_tests is None:
        return None
    build = functools.partial(
        _study, name=name, table=load_tests, robot=arm, problems=context.problems
    )
    study = context.read(load_tests, "[load_tests]", build)
    if study is not None:
        study = dataclasses.replace(study, notes=(*notes, *study.notes))
    return study


def _study(
    reader: TableReader,
    name: str,
    table: LoadTestsTable,
    robot: Robot,
    problems: list[str],
) -> LoadTestStudy | None:
    """Study of the complete rows of a table, or None with problems noted.

    Raises:
        RecordError: A column is missing, or has another unit.
    """
    values = _columns(reader, robot)
    _check_sizes(robot, values, table, reader.faults)
    reader.check()
    load = np.hstack([values[n] for n in ("force", "moment") if n in values])
    moved = np.hstack([values[n] for n in ("displacement", "rotation") if n in values])
    whole = np.hstack([values["joint"], load])
    good = np.asarray(np.isfinite(whole).all(axis=1) & np.isfinite(moved).any(axis=1))
    if not good.all():
        lost = np.flatnonzero(~good) + 1
        shown = ", ".join(map(str, lost[:10].tolist()))
        more = ", ..." if lost.size > 10 else ""
        reader.notes.append(f"Rows {shown}{more} have empty cells and were left out.")
    for row in table.skip_rows:
        if row > len(good):
            problems.append(
                f"[load_tests] skip_rows: found {row}, but there are {len(good)} rows"
            )
            return None
        good[row - 1] = False
    if not good.any():
        problems.append(f"[load_tests] file: {table.file}: found no complete row.")
        return None
    angles = values["joint"][good]
    poses = jax.vmap(lambda row: forward_kinematics(robot, row))(
        np.asarray(angles, robot.dtype)
    )
    rotations = np.asarray(poses, np.float64)[:, :3, :3]
    load_frame, frame = (
        rotations if axes == "tool" else None
        for axes in (table.load_frame, table.displacement_frame)
    )
    load = _exchanged(load[good], table.load_axes)
    if load_frame is not None:
        parts = load.reshape(len(load), -1, 3)
        load = np.einsum("pij,pkj->pki", load_frame, parts).reshape(load.shape)
    return LoadTestStudy(
        name=name,
        robot=robot,
        q=angles,
        wrench=np.pad(load, ((0, 0), (0, 6 - load.shape[1]))),
        # In base one missing component would make all of them unknown.
        displacement=_exchanged(moved[good], table.displacement_axes),
        load_frame=load_frame,
        displacement_frame=frame,
        rows=tuple((np.flatnonzero(good) + 1).tolist()),
        has_offset=table.has_offset,
        noise=table.noise,
        notes=tuple(reader.notes),
        channels=tuple(reader.read),
    )


def _columns(reader: TableReader, robot: Robot) -> dict[str, np.ndarray]:
    """Joint positions, loads and displacements in SI units, shape (row, component).

    Raises:
        RecordError: A column is missing.
    """
    groups = _groups(robot)
    reader.allow(quantity for group in groups.values() for quantity in group)
    values, missing = {}, []
    for name, group in groups.items():
        parts = {quantity.key: reader.values(quantity) for quantity in group}
        given = {key: part for key, part in parts.items() if part is not None}
        # "none": no load along this axis, no measurement along that one.
        for key in [k for k in parts if given and reader.is_excluded(k)]:
            fill = 0.0 if name in ("force", "moment") else np.nan
            given[key] = np.full(len(next(iter(given.values()))), fill)
        lost = [key for key in parts if key not in given]
        if lost and (given or name not in ("moment", "rotation")):
            missing.extend(lost)
        elif given:
            values[name] = np.column_stack([given[key] for key in parts])
    if missing and not reader.faults:
        reader.faults.append(
            f"found no column for {', '.join(missing)} among {reader.listed()}; "
            "name it with `channels`."
        )
    reader.check()
    return values


def _groups(robot: Robot) -> dict[str, tuple[Quantity, ...]]:
    """Columns of a table by what they measure."""
    return {
        "joint": joint_quantities(robot),
        "force": Quantity.vector("F", "f|force|kraft", q.FORCE, "force"),
        "moment": Quantity.vector("M", "m|t|moment|torque", q.MOMENT, "moment"),
        "displacement": Quantity.vector(
            "d", r"d|u|delta|defl|deflection|disp\w*", q.LENGTH, "displacement"
        ),
        "rotation": Quantity.vector("r", "r|dr|rot|rotation|phi", q.ANGLE, "rotation"),
    }


def _check_sizes(
    robot: Robot,
    values: dict[str, np.ndarray],
    table: LoadTestsTable,
    faults: list[str],
) -> None:
    """Note numbers that only another unit explains."""
    turning = np.array([kind != "prismatic" for kind in robot.joint_kinds])
    angle = float(np.nanmax(np.abs(values["joint"][:, turning]), initial=0.0))
    moved = values["displacement"]
    if table.has_offset:
        # The zero of a tracker lies anywhere.
        seen = [part[np.isfinite(part)] for part in moved.T]
        moved = moved - np.array([np.median(x) if x.size else 0.0 for x in seen])
    moved = moved[np.isfinite(moved).any(axis=1)]
    # The whole vector: along the load it moves much farther than across.
    lengths = np.sqrt(np.nansum(moved**2, axis=1))
    usual_move = float(np.median(lengths)) if lengths.size else 0.0
    most = _LARGEST_MOVE if "displacement" in table.units else _USUAL_MOVE
    for what, size, limit, unit, wrong in (
        ("joint", angle, LARGEST_ANGLE, "rad", "deg"),
        ("displacement", usual_move, most, "m", "mm"),
    ):
        if size > limit:
            faults.append(
                f"the columns of `{what}` reach {size:.4g} {unit}, which no load test "
                f"has; give the unit in the header, or by `units`, such as "
                f'{{ {what} = "{wrong}" }}.'
            )


def _exchanged(vectors: np.ndarray, axes: list[str] | None) -> np.ndarray:
    """Vectors with their axes exchanged.

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


KIND = IdentificationKind(
    "load_tests",
    required={"robot": StudiedRobotTable, "load_tests": LoadTestsTable},
    optional={},
    read=_read,
)
