"""Records of joints with two encoders and a torque."""

import dataclasses
import functools
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, Field, StrictFloat, StrictInt

from ... import units as q
from ...identification import JointRecord, ReversalStudy
from ...io import Quantity, TableReader
from ...robot import Robot
from ...settings.fields import Angle, Frequency
from ...settings.tables import TomlTable
from .context import Context
from .fields import File
from .kind import IdentificationKind
from .robot import StudiedRobotTable, read_tool_robot
from .schema import MeasuredTable

# Joints that columns are looked for, where neither ratios nor a robot say how many.
_MOST_JOINTS = 12
# No gear bends so far [rad].
_LARGEST_DEFLECTION = 0.02
# A link that moves by less of the way of its motor is not measured.
_LEAST_SHARE = 0.5
# What may stand between a quantity and the number of a joint.
_JOINT = r"[\s_.\-]*(joint|axis|achse|a|j|q)?[\s_.\-]*"


def _is_ratio(value: float | int) -> float:
    """Ratio that is not 0."""
    if value == 0 or not np.isfinite(value):
        raise ValueError(f"found {value!r}, but a finite number beside 0 is required")
    return float(value)


GearRatio = Annotated[StrictFloat | StrictInt, AfterValidator(_is_ratio)]


def _is_positive(value: float) -> float:
    """Angle that is above 0."""
    if value <= 0:
        raise ValueError(f"found {value:g} rad, but an angle above 0 is required")
    return value


PositiveAngle = Annotated[Angle, AfterValidator(_is_positive)]


class ReversalTable(TomlTable):
    """`[reversal]`."""

    gear_ratios: list[GearRatio] | None = Field(
        default=None,
        description="turns of the motor per turn of every joint, such as [256.857, "
        "267.429]: the torque of the records is that of the motors; if left out it is "
        "that behind the gears",
    )
    lowpass: Frequency = Field(
        default=10.0,
        description="cut-off frequency of all signals; below the first resonance of "
        "the arm the spring is at rest",
    )
    longest_presliding: PositiveAngle = Field(
        default=2e-3,
        description="longest travel over which the friction of a joint may build up, "
        'such as "2 mrad"',
    )


class JointRecordTable(MeasuredTable):
    """An entry of `[[joint_record]]`."""

    file: File = Field(
        description="file of a motion in the air with columns motor_1, link_1 and "
        'torque_1 of every joint, such as "joints.csv"'
    )
    rate: Frequency | None = Field(
        default=None,
        description='samples per time, such as "250 Hz"; required if neither a time '
        "column nor the header has it",
    )


def _read(
    name: str,
    context: Context,
    *,
    reversal: ReversalTable | None = None,
    joint_record: list[JointRecordTable] | None = None,
    robot: StudiedRobotTable | None = None,
) -> ReversalStudy | None:
    """Study of joints with two encoders, or None with problems noted.

    Args:
        name: The file that asks for it.
        context: Folder and problems.
        reversal: `[reversal]`.
        joint_record: `[[joint_record]]`.
        robot: `[robot]`, whose springs stand in for those that records do not show.
    """
    notes: list[str] = []
    arm = None
    if robot is not None:
        arm = read_tool_robot(robot, context, notes, needs_mass=False)
    if reversal is None or joint_record is None or (arm is None and robot is not None):
        return None
    ratios = reversal.gear_ratios
    if arm is not None and not _suits(arm, ratios, context.problems):
        return None
    count = len(ratios) if ratios else arm.joint_count if arm else None
    records = [
        context.read(
            entry,
            f"[[joint_record]] {place}",
            functools.partial(_record, rate=entry.rate, ratios=ratios, count=count),
        )
        for place, entry in enumerate(joint_record, 1)
    ]
    good = [one for one in records if one is not None]
    if len(good) < len(records):
        return None
    count = max(one.motor.shape[1] for one in good)
    names = arm.joint_names if arm else [f"joint_{i}" for i in range(1, count + 1)]
    return ReversalStudy(
        name=name,
        joint_names=tuple(names),
        records=tuple(_widened(one, count) for one in good),
        robot=arm,
        lowpass=reversal.lowpass,
        longest_presliding=reversal.longest_presliding,
        notes=tuple(notes),
    )


def _suits(arm: Robot, ratios: list[float] | None, problems: list[str]) -> bool:
    """True for a robot that turns and has a ratio per joint; others are noted."""
    sliding = [
        name
        for name, kind in zip(arm.joint_names, arm.joint_kinds, strict=True)
        if kind == "prismatic"
    ]
    if sliding:
        problems.append(
            f"[robot]: found the sliding joints {', '.join(sliding)}, but only "
            "joints that turn are allowed"
        )
    if ratios and len(ratios) != arm.joint_count:
        problems.append(
            f"[reversal] gear_ratios: found {len(ratios)} values, but one per joint is "
            f"required: {', '.join(arm.joint_names)}"
        )
        return False
    return not sliding


def _quantities(joint: int) -> tuple[Quantity, Quantity, Quantity]:
    """Columns of a joint, which is counted from 1."""
    return (
        Quantity(
            f"motor_{joint}",
            rf"(motor|drive|antrieb|theta){_JOINT}{joint}",
            (q.ANGLE,),
            ("motor",),
        ),
        Quantity(
            f"link_{joint}",
            rf"(link|secondary|se|output|abtrieb){_JOINT}{joint}",
            (q.ANGLE,),
            ("link",),
        ),
        Quantity(
            f"torque_{joint}",
            rf"(torque|tau|moment|m){_JOINT}{joint}",
            (q.MOMENT,),
            ("torque",),
        ),
    )


def _record(
    reader: TableReader,
    rate: float | None,
    ratios: list[float] | None,
    count: int | None,
) -> JointRecord | None:
    """Record of all joints at even instants, torques behind the gears.

    Raises:
        RecordError: A column is missing, or numbers make no sense.
    """
    joints = range(1, (count or _MOST_JOINTS) + 1)
    named = {joint: _quantities(joint) for joint in joints}
    reader.allow((reader.TIME, *(one for group in named.values() for one in group)))
    time = reader.values(reader.TIME)
    columns = {
        joint: [reader.values(quantity) for quantity in group]
        for joint, group in named.items()
    }
    reader.check()
    last = max((j for j, c in columns.items() if c[0] is not None), default=0)
    whole = [j for j, c in columns.items() if all(part is not None for part in c)]
    if not whole:
        reader.faults.append(
            f"found no joint with all of motor, link and torque among "
            f"{reader.listed()}; name the columns with `channels`, such as "
            '{ motor_1 = "A1 motor", link_1 = "A1 link", torque_1 = "A1 torque" }.'
        )
    reader.check()
    rows = len(columns[whole[0]][0])  # pyright: ignore[reportArgumentType]
    table = np.full((3, rows, count or last), np.nan)
    for joint in range(1, table.shape[2] + 1):
        for kind, part in enumerate(columns[joint]):
            if part is not None:
                table[kind, :, joint - 1] = part
    needed = table[:, :, [joint - 1 for joint in whole]]
    is_complete = np.asarray(np.isfinite(needed).all(axis=(0, 2)))
    line = reader.timeline(time, is_complete, rate or reader.table.rate)
    reader.check()
    assert line is not None
    if line.is_after_gap.any():
        reader.faults.append(
            f"found {np.count_nonzero(line.is_after_gap)} gaps in the time, but a "
            "record in one piece is required: the state of friction is lost in a gap."
        )
    motor, link, torque = (
        _even(np.asarray(line.time, np.float64), part[line.rows], 1.0 / line.rate)
        for part in table
    )
    still = np.ptp(link, axis=0) < _LEAST_SHARE * np.ptp(motor, axis=0)
    if still[[joint - 1 for joint in whole]].all():
        reader.faults.append(
            "no link follows its motor; the angle of a motor must be that behind its "
            "gear, and the unit of both be right."
        )
    elif still.any():
        names = ", ".join(str(i) for i in np.flatnonzero(still) + 1)
        reader.notes.append(
            f"The link encoders of the joints {names} do not follow their motors and "
            "were taken as not measured."
        )
        link[:, still] = np.nan
    off = link - motor
    size = np.array(
        [np.ptp(x[np.isfinite(x)]) if np.isfinite(x).any() else 0 for x in off.T]
    )
    for joint in np.flatnonzero(size > _LARGEST_DEFLECTION) + 1:
        reader.faults.append(
            f"link_{joint} less motor_{joint} changes by {size[joint - 1]:.3g} rad, "
            "which no gear bends: the angle of the motor must be that behind its gear; "
            "look at the units, too."
        )
    reader.check()
    if ratios is not None:
        torque = torque * np.array(ratios)[None]
    return JointRecord(
        name=reader.name,
        time_step=1.0 / line.rate,
        motor=motor,
        link=link,
        torque=torque,
        notes=tuple(reader.notes),
        channels=tuple(reader.read),
    )


def _even(
    time: Float[np.ndarray, " row"], values: Float[np.ndarray, "row joint"], step: float
) -> Float[np.ndarray, "even joint"]:
    """Values at even instants."""
    instants = np.arange(time[0], time[-1] + 1e-6 * step, step)
    return np.stack([np.interp(instants, time, x) for x in values.T], axis=1)


def _widened(record: JointRecord, count: int) -> JointRecord:
    """Record with columns for a number of joints."""
    more = count - record.motor.shape[1]
    pad = lambda x: np.pad(x, ((0, 0), (0, more)), constant_values=np.nan)
    return dataclasses.replace(
        record,
        motor=pad(record.motor),
        link=pad(record.link),
        torque=pad(record.torque),
    )


KIND = IdentificationKind(
    "reversal",
    required={"reversal": ReversalTable, "joint_record": [JointRecordTable]},
    optional={"robot": StudiedRobotTable},
    read=_read,
)
