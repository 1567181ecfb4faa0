"""Measured poses as a table: joint positions and where the tool was, one per row."""

import dataclasses
import functools
import math
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, StrictBool, StrictInt

from ... import units as q
from ...identification import KinematicStudy
from ...io import Quantity, TableReader
from ...robot import Robot, rpy_matrix
from ...settings.fields import Lengths3, PositiveAngle, PositiveLength
from ...settings.tables import TomlTable
from .context import Context
from .fields import File
from .kind import IdentificationKind
from .robot import (
    LARGEST_ANGLE,
    StudiedRobotTable,
    joint_quantities,
    read_tool_robot,
)
from .schema import MeasuredTable

# No robot reaches so far [m], nor is its tool so far off [m].
_LARGEST_REACH, _LARGEST_DIFFERENCE = 50.0, 0.1


class PosesTable(MeasuredTable):
    """`[poses]`."""

    file: File = Field(description='table with one pose per row, such as "poses.csv"')
    measured: Literal["position", "frame", "distance"] = Field(
        default="position",
        description="what of the tool was measured: x, y, z of its origin; these with "
        "roll, pitch and yaw; or the distance of its origin from a fixed point, as by "
        "a ball bar or a wire",
    )
    difference: Literal["actual - desired", "desired - actual"] | None = Field(
        default=None,
        description="sign of columns dx, dy, dz, if the table states the desired x, y, "
        "z and these; required with such columns",
    )
    noise: PositiveLength = Field(
        description="standard deviation of one measured coordinate, of the instrument, "
        'such as "15 um"; what the robot does not repeat is found'
    )
    rotation_noise: PositiveAngle = Field(
        default=1e-4,
        description='standard deviation of a measured angle, such as "50 urad"',
    )
    fixed_point: Lengths3 | None = Field(
        default=None,
        description="rough place in the base from which distances count, such as "
        '["1200 mm", "0 mm", "300 mm"]; required for distances',
    )
    gravity_compensated: StrictBool = Field(
        default=True,
        description="false: the controller leaves the sag of the arm under its own "
        "weight, which follows from its springs and masses",
    )
    waves: StrictBool = Field(
        default=False,
        description="true: gears that turn unevenly are fitted too",
    )
    wave_period: PositiveAngle = Field(
        default=2 * math.pi,
        description="turn of a joint in which its waves repeat; waves of half of it "
        "are fitted too",
    )
    parameters: Literal["all", "independent"] = Field(
        default="all",
        description="six errors of every joint, as many as poses can distinguish being "
        "found and the others left open; or those alone, as many as modified "
        "parameters of Denavit and Hartenberg",
    )
    process: StrictBool = Field(
        default=False,
        description="true: prints how much of what link errors leave a Gaussian "
        "process on the joints would predict",
    )
    folds: Annotated[StrictInt, Field(ge=2, le=100)] = Field(
        default=5,
        description="parts of the poses, each of which is predicted by the others",
    )
    skip_rows: list[Annotated[StrictInt, Field(ge=1)]] = Field(
        default_factory=list,
        description="numbers of rows that are left out, such as [7]",
    )


class PriorTable(TomlTable):
    """`[prior]`: how large errors are before anything is measured.

    Standard deviations; what the poses tell does not depend on them, what they leave
    open stays within them.
    """

    displacement: PositiveLength = Field(
        default=2e-3, description="of a joint's frame along each axis"
    )
    rotation: PositiveAngle = Field(
        default=5e-3, description="of a joint's frame about each axis"
    )
    joint_offset: PositiveAngle = Field(
        default=20e-3, description="of the zero of a turning joint"
    )
    slide_offset: PositiveLength = Field(
        default=20e-3, description="of the zero of a slide"
    )
    tool: PositiveLength = Field(
        default=0.1,
        description="of the tool's place in the flange, and of a fixed point, along "
        "each axis",
    )
    wave: PositiveAngle = Field(
        default=0.5e-3, description="of each amplitude of a gear's waves"
    )


def _read(
    name: str,
    context: Context,
    *,
    robot: StudiedRobotTable | None = None,
    poses: PosesTable | None = None,
    prior: PriorTable | None = None,
) -> KinematicStudy | None:
    """Study of measured poses, or None with problems noted.

    Args:
        name: The file that asks for it.
        context: Folder and problems.
        robot: `[robot]`.
        poses: `[poses]`.
        prior: `[prior]`; its defaults without one.
    """
    notes: list[str] = []
    if poses is not None and (poses.measured == "distance") != bool(poses.fixed_point):
        found = "nothing" if poses.fixed_point is None else "a point"
        context.problems.append(
            f'[poses] fixed_point: found {found} beside measured = "{poses.measured}", '
            'but it is required for "distance" and for that alone'
        )
        poses = None
    if robot is None:
        return None
    arm = read_tool_robot(robot, context, notes, needs_mass=False)
    if arm is None or poses is None:
        return None
    build = functools.partial(_study, table=poses, robot=arm, problems=context.problems)
    measured = context.read(poses, "[poses]", build)
    if measured is None:
        return None
    sizes = (prior or PriorTable()).model_dump()
    return KinematicStudy(
        name=name,
        robot=arm,
        poses=measured.poses,
        noise=KinematicStudy.Noise(poses.noise, poses.rotation_noise),
        sizes=KinematicStudy.Sizes(**sizes),
        fixed_point=None if poses.fixed_point is None else np.array(poses.fixed_point),
        has_waves=poses.waves,
        waves_per_turn=2 * math.pi / poses.wave_period,
        has_all_parameters=poses.parameters == "all",
        is_gravity_compensated=poses.gravity_compensated,
        has_process=poses.process,
        folds=poses.folds,
        rows=measured.rows,
        notes=(*notes, *measured.reader.notes),
        channels=tuple(measured.reader.read),
    )


@dataclasses.dataclass(frozen=True)
class _Measured:
    """Complete rows of a table.

    Attributes:
        poses: What was measured.
        rows: Numbers of the rows, from 1.
        reader: Notes, and the columns that were read.
    """

    poses: KinematicStudy.Poses
    rows: tuple[int, ...]
    reader: TableReader


def _study(
    reader: TableReader, table: PosesTable, robot: Robot, problems: list[str]
) -> _Measured | None:
    """Complete rows of a table, or None with problems noted.

    Raises:
        RecordError: A column is missing, or has another unit.
    """
    columns = _columns(reader, robot, table)
    _check_sizes(robot, columns, reader.faults)
    reader.check()
    whole = np.hstack(list(columns.values()))
    good = np.asarray(np.isfinite(whole).all(axis=1))
    if not good.all():
        lost = (np.flatnonzero(~good) + 1).tolist()
        shown = ", ".join(map(str, lost[:10])) + (", ..." if len(lost) > 10 else "")
        reader.notes.append(f"Rows {shown} have empty cells and were left out.")
    for row in table.skip_rows:
        if row > len(good):
            problems.append(
                f"[poses] skip_rows: found {row}, but there are {len(good)} rows"
            )
            return None
        good[row - 1] = False
    if not good.any():
        problems.append(f"[poses] file: {table.file}: found no complete row.")
        return None
    kept = {name: values[good] for name, values in columns.items()}
    position, rotation = kept.get("position"), None
    if position is not None and "difference" in kept:
        sign = 1.0 if table.difference == "actual - desired" else -1.0
        position = position + sign * kept["difference"]
    if "angles" in kept:
        rotation = np.stack([rpy_matrix(*row) for row in kept["angles"]])
    distance = kept["distance"][:, 0] if "distance" in kept else None
    return _Measured(
        KinematicStudy.Poses(kept["joint"], position, rotation, distance),
        tuple((np.flatnonzero(good) + 1).tolist()),
        reader,
    )


def _columns(
    reader: TableReader, robot: Robot, table: PosesTable
) -> dict[str, Float[np.ndarray, "row component"]]:
    """Joint positions and what was measured, in SI units, shape (row, component).

    Raises:
        RecordError: A column is missing.
    """
    groups = {"joint": joint_quantities(robot)}
    if table.measured == "distance":
        groups["distance"] = (_DISTANCE,)
    else:
        groups |= {"position": _POSITION, "difference": _DIFFERENCE}
    if table.measured == "frame":
        groups["angles"] = _ANGLES
    reader.allow(quantity for group in groups.values() for quantity in group)
    found = {name: [reader.values(x) for x in group] for name, group in groups.items()}
    missing = []
    for name, group in groups.items():
        lost = [x.key for x, v in zip(group, found[name], strict=True) if v is None]
        # A table has differences or not.
        if name == "difference" and len(lost) == 3 and table.difference is None:
            del found[name]
            continue
        missing += lost
    if missing and not reader.faults:
        reader.faults.append(
            f"found no column for {', '.join(missing)} among {reader.listed()}; "
            "name it with `channels`."
        )
    if "difference" in found and table.difference is None and not reader.faults:
        reader.faults.append(
            "found columns of a difference (dx, dy, dz), but not its sign; say "
            'difference = "actual - desired" or "desired - actual", or that x, y, z '
            'are what was measured, by channels = { dx = "none", dy = "none", dz = '
            '"none" }.'
        )
    reader.check()
    return {
        name: np.column_stack([part for part in parts if part is not None])
        for name, parts in found.items()
    }


_POSITION = Quantity.vector(
    "", "|p|pos|position|tip|tcp|desired|measured", q.LENGTH, "position"
)
_DIFFERENCE = Quantity.vector(
    "d", r"d|dev|deviation|diff\w*|err\w*", q.LENGTH, "difference"
)
_ANGLES = (
    Quantity("roll", "roll|gamma", (q.ANGLE,), ("angle",)),
    Quantity("pitch", "pitch|beta", (q.ANGLE,), ("angle",)),
    Quantity("yaw", "yaw|alpha", (q.ANGLE,), ("angle",)),
)
_DISTANCE = Quantity("distance", r"dist\w*|length|range|l", (q.LENGTH,), ("distance",))


def _check_sizes(
    robot: Robot, columns: dict[str, Float[np.ndarray, "..."]], faults: list[str]
) -> None:
    """Note numbers that only another unit explains."""
    turning = np.array([kind != "prismatic" for kind in robot.joint_kinds])
    for what, values, limit, unit, wrong in (
        ("joint", columns["joint"][:, turning], LARGEST_ANGLE, "rad", "deg"),
        ("position", columns.get("position"), _LARGEST_REACH, "m", "mm"),
        ("difference", columns.get("difference"), _LARGEST_DIFFERENCE, "m", "mm"),
        ("distance", columns.get("distance"), _LARGEST_REACH, "m", "mm"),
        ("angle", columns.get("angles"), LARGEST_ANGLE, "rad", "deg"),
    ):
        size = 0.0 if values is None else float(np.nanmax(np.abs(values), initial=0.0))
        if size > limit:
            faults.append(
                f"the columns of `{what}` reach {size:.4g} {unit}, which no robot has; "
                "give the unit in the header, or by `units`, such as "
                f'{{ {what} = "{wrong}" }}.'
            )


KIND = IdentificationKind(
    "kinematics",
    required={"robot": StudiedRobotTable, "poses": PosesTable},
    optional={"prior": PriorTable},
    read=_read,
)
