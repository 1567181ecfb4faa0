"""Load tests as a table: joint positions, loads and displacements, one pose per row."""

import pathlib
import re
from typing import TypeAlias

import jax
import numpy as np
from jaxtyping import Bool, Int

from ... import units as q
from ...io import RecordError, Table, check_keys, column_of, read_table
from ...robot import Robot, forward_kinematics
from .._build.program import file_in_folder
from .schema import LoadTestsTable
from .tasks import LoadTestTask, Turns

_PARTS = r"[\s_.\-]*"
# No joint turns so far [rad], and no load bends a robot so far [m]; hardly one a fifth
# of that, where the user has not confirmed the unit.
_LARGEST_ANGLE, _LARGEST_MOVE, _USUAL_MOVE = 4 * np.pi, 0.1, 0.02
# A column: its key, the dimensions that it may have, and what it may be called.
_Wanted: TypeAlias = tuple[str, tuple[q.QuantityKind, ...], str]


def read_load_tests(
    name: str,
    table: LoadTestsTable,
    robot: Robot,
    folder: pathlib.Path,
    problems: list[str],
    notes: list[str],
    *,
    allow_outside: bool,
) -> LoadTestTask | None:
    """Return load tests in base axes, or None with problems noted.

    Args:
        name: The file that asks for it.
        table: `[load_tests]`.
        robot: The robot with its tool.
        folder: Folder of the file.
        problems: Receives what is wrong.
        notes: What was assumed so far; is added to.
        allow_outside: Whether the table may lie outside that folder.
    """
    place = "[load_tests] file"
    path = file_in_folder(
        table.file, place, folder, problems, allow_outside=allow_outside
    )
    if path is None:
        return None
    faults: list[str] = []
    try:
        found = read_table(path)
        columns = _columns(found, table, robot, faults, notes)
        notes.extend(found.notes)
    except (RecordError, OSError) as error:
        columns = None
        faults.extend(error.faults if isinstance(error, RecordError) else [str(error)])
    if columns is None or faults:
        problems.extend(f"{place}: {path.name}: {line}" for line in faults)
        return None
    angles, load, moved = columns
    good = _good_rows(columns, table, problems, notes)
    if good is None:
        return None
    if not good.any():
        problems.append(f"{place}: {path.name}: found no complete row.")
        return None
    angles, load, moved = angles[good], load[good], moved[good]
    tool = _tool_axes(robot, angles)
    load_frame, frame = (
        tool if name == "tool" else None
        for name in (table.load_frame, table.displacement_frame)
    )
    load = _in_base(load, table.load_axes, load_frame)
    moved = _in_base(moved, table.displacement_axes, frame)
    return LoadTestTask(
        name=name,
        robot=robot,
        q=angles,
        wrench=np.pad(load, ((0, 0), (0, 6 - load.shape[1]))),
        displacement=moved,
        frames=(load_frame, frame),
        rows=tuple((np.flatnonzero(good) + 1).tolist()),
        has_offset=table.has_offset,
        noise=table.noise,
        notes=tuple(notes),
    )


def _good_rows(
    columns: tuple[np.ndarray, np.ndarray, np.ndarray],
    table: LoadTestsTable,
    problems: list[str],
    notes: list[str],
) -> Bool[np.ndarray, " row"] | None:
    """Return which rows are complete and wanted; None with problems noted."""
    angles, load, moved = columns
    whole = np.hstack([angles, load])
    good = np.asarray(np.isfinite(whole).all(axis=1) & np.isfinite(moved).any(axis=1))
    if not good.all():
        notes.append(_lost_rows(np.flatnonzero(~good) + 1))
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


def _columns(
    found: Table,
    table: LoadTestsTable,
    robot: Robot,
    faults: list[str],
    notes: list[str],
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return joint positions, loads and displacements as written, in SI units."""
    groups = _groups(robot)
    known = {key for group in groups.values() for key, _, _ in group}
    check_keys("channel", table.channels or {}, sorted(known), faults)
    check_keys("unit of", table.units, groups, faults)
    values, missing = {}, []
    for name, group in groups.items():
        given = _given(name, group, found, table, faults, notes)
        lost = [key for key, _, _ in group if key not in given]
        is_optional = name in ("moment", "rotation")
        if lost and (given or not is_optional):
            missing.extend(lost)
        elif given:
            values[name] = np.column_stack([given[key] for key, _, _ in group])
    if missing and not faults:
        names = ", ".join(f"`{column.name}`" for column in found.columns)
        faults.append(
            f"found no column for {', '.join(missing)} among {names}; name it with "
            "`channels`."
        )
    if faults:
        return None
    _check_sizes(robot, values, table, faults)
    load = [values[n] for n in ("force", "moment") if n in values]
    moved = [values[n] for n in ("displacement", "rotation") if n in values]
    return values["joint"], np.hstack(load), np.hstack(moved)


def _groups(robot: Robot) -> dict[str, list[_Wanted]]:
    """Return the columns of a table by what they measure."""
    joints = zip(robot.joint_names, robot.joint_kinds, strict=True)
    return {
        "joint": [
            (
                name,
                (q.LENGTH,) if kind == "prismatic" else (q.ANGLE,),
                rf"{re.escape(name)}|(q|j|a|theta|axis|joint|achse){_PARTS}{i}",
            )
            for i, (name, kind) in enumerate(joints, 1)
        ],
        "force": [(f"F{a}", (q.FORCE,), _letter("f|force|kraft", a)) for a in "xyz"],
        "moment": [
            (f"M{a}", (q.MOMENT,), _letter("m|t|moment|torque", a)) for a in "xyz"
        ],
        "displacement": [
            (f"d{a}", (q.LENGTH,), _letter("d|u|delta|defl|deflection|disp\\w*", a))
            for a in "xyz"
        ],
        "rotation": [
            (f"r{a}", (q.ANGLE,), _letter("r|dr|rot|rotation|phi", a)) for a in "xyz"
        ],
    }


def _given(
    name: str,
    group: list[_Wanted],
    found: Table,
    table: LoadTestsTable,
    faults: list[str],
    notes: list[str],
) -> dict[str, np.ndarray]:
    """Return the columns of a group that there are, those that are "none" filled."""
    wanted, unit = dict(table.channels or {}), table.units.get(name)
    parts = {
        key: column_of(found, key, kinds, pattern, wanted, faults, notes, unit)
        for key, kinds, pattern in group
    }
    given = {key: part for key, part in parts.items() if part is not None}
    # "none": no load along this axis, no measurement along that one.
    for key in [k for k in parts if given and k in wanted and wanted[k] is None]:
        fill = 0.0 if name in ("force", "moment") else np.nan
        given[key] = np.full(len(next(iter(given.values()))), fill)
    return given


def _letter(words: str, axis: str) -> str:
    return rf"({words}){_PARTS}{axis}|{axis}{_PARTS}({words})"


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


def _in_base(
    vectors: np.ndarray, axes: list[str] | None, frame: Turns | None
) -> np.ndarray:
    """Return vectors with the axes exchanged, turned from their frame into base.

    Moments and rotations, behind forces and displacements, change their sign once more
    where the axes are mirrored.
    """
    parts = vectors.reshape(len(vectors), -1, 3)
    if axes is not None:
        signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
        order = ["xyz".index(name[-1]) for name in axes]
        handed = np.array([1.0, np.prod(signs) * np.linalg.det(np.eye(3)[order])])
        parts = parts[:, :, order] * signs[None, None]
        parts = parts * handed[None, : parts.shape[1], None]
    if frame is not None:
        parts = np.einsum("pij,pkj->pki", frame, parts)
    return parts.reshape(vectors.shape)
