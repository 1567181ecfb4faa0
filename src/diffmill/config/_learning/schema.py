"""The tables of a file for `diffmill learn`: parts, what was measured, what may be."""

from typing import Annotated, Literal

from pydantic import Field, StrictInt, StrictStr

from ...settings.fields import (
    Delay,
    Force,
    PositiveAngle,
    PositiveLength,
    Tolerance,
    TurnTolerance,
    Uncertainty,
)
from ...settings.tables import TomlTable
from .._identification.fields import File
from .._identification.schema import MeasuredTable


class TrackerTable(MeasuredTable):
    """`[part.tracker]`: the tip on its way, as a tracker saw it."""

    file: File = Field(
        description="table of tips in work over time, with columns time, x, y, z, such "
        'as "track.csv"'
    )
    noise: PositiveLength = Field(
        description='standard deviation of one coordinate, such as "15 um"'
    )
    offset: Tolerance = Field(
        default=0.0,
        description="standard deviation of where the tracker takes the work to be, "
        "along each axis",
    )
    turn: TurnTolerance = Field(
        default=0.0,
        description="standard deviation of how it takes the work to be turned, about "
        "each axis",
    )
    delay: Delay = Field(
        default=0.0,
        description="standard deviation of its clock against the program's",
    )


class PointsTable(MeasuredTable):
    """`[part.points]`: points of the finished part."""

    file: File = Field(
        description="table of points in work with the normals out of the material, "
        'columns x, y, z, nx, ny, nz, such as "probe.csv"'
    )
    noise: PositiveLength = Field(
        description='standard deviation of a distance along the normal, such as "3 um"'
    )
    offset: Tolerance = Field(
        default=0.0,
        description="standard deviation of where the instrument takes the work to be, "
        "along each axis",
    )


class EncodersTable(MeasuredTable):
    """`[part.encoders]`: joints on their way, by encoders behind the gears."""

    file: File = Field(
        description="table of joint positions over time, with a column for each joint "
        "of the robot by its name or its number (q1, axis 2)"
    )
    noise: PositiveAngle = Field(
        description='standard deviation of a position, such as "10 urad"'
    )
    offset: TurnTolerance = Field(
        default=0.0, description="standard deviation of the zero of an encoder"
    )
    delay: Delay = Field(
        default=0.0,
        description="standard deviation of their clock against the program's",
    )


class ForcesTable(MeasuredTable):
    """`[part.forces]`: forces on their way, by a dynamometer or a sensor."""

    file: File = Field(
        description="table of forces along the axes of work over time, with columns "
        "time, Fx, Fy, Fz"
    )
    noise: Annotated[Force, Field(gt=0)] = Field(
        description='standard deviation of a sample, such as "5 N"'
    )
    offset: Annotated[Force, Field(ge=0)] = Field(
        default=0.0, description="standard deviation of the zero of each axis"
    )
    on: Literal["tool", "workpiece"] = Field(
        default="tool", description="on what the forces act"
    )


class PartTable(TomlTable):
    """An entry of `[[part]]`: a part that was cut and measured."""

    name: StrictStr | None = Field(
        default=None, description='what it is called, such as "first"; its number'
    )
    commanded: File | None = Field(
        default=None,
        description="path (.csv) that cut it, with a row for each of the program's, "
        "such as the corrected.csv of a result; the program itself if left out",
    )
    tracker: TrackerTable | None = Field(
        default=None, description="the tip on its way; not measured if left out"
    )
    points: PointsTable | None = Field(
        default=None, description="points of the part; not measured if left out"
    )
    encoders: EncodersTable | None = Field(
        default=None, description="joints on their way; not measured if left out"
    )
    forces: ForcesTable | None = Field(
        default=None, description="forces on their way; not measured if left out"
    )


class MachinePriorTable(TomlTable):
    """`[prior]`: how far the machine may be off, before a part is measured.

    Standard deviations; of friction and gaps those of a half-normal distribution.
    """

    learnt: File | None = Field(
        default=None,
        description="learnt.nc of another program on the same machine, whose "
        "parameters replace all else of this table",
    )
    stiffness: Uncertainty = Field(
        default=0.1, description="share by which each joint's stiffness is off"
    )
    damping: Uncertainty = Field(
        default=0.2, description="share by which each joint's damping is off"
    )
    force: Uncertainty = Field(
        default=0.2, description="share by which all force coefficients are off"
    )
    coefficient: Uncertainty = Field(
        default=0.07, description="share by which each coefficient is off besides"
    )
    friction: TurnTolerance = Field(
        default=2e-5,
        description="Coulomb friction of each joint, as the angle by which it bends "
        "the joint's spring",
    )
    backlash: TurnTolerance = Field(default=3e-5, description="gap of each joint")
    servo: Uncertainty = Field(
        default=0.1, description="share by which the bandwidth of each servo is off"
    )
    radius: Tolerance = Field(
        default=5e-6,
        description="what the cutter cuts beyond its radius, by run-out, wear and "
        "size; points of walls alone show it",
    )
    offset: Tolerance = Field(
        default=3e-5, description="error of the tip all over the work, along each axis"
    )
    gradient: TurnTolerance = Field(
        default=2e-4,
        description="by how much it grows over the work, each component, as an angle",
    )


class TrialTable(TomlTable):
    """An entry of `[[trial]]`: a measurement that could be made, for `--advise`."""

    job: File = Field(
        description="a job on the same machine that would be run under a tracker, such "
        'as "air.toml"'
    )
    name: StrictStr | None = Field(
        default=None, description='what it is called, such as "air path"; its job'
    )


class AdviceTable(TomlTable):
    """`[advice]`: instruments of measurements that could be made."""

    tracker: PositiveLength = Field(
        default=15e-6, description="standard deviation of a coordinate of a tracker"
    )
    gauge: PositiveLength = Field(
        default=5e-6, description="standard deviation of a gauge at the tip"
    )


class LearningTable(TomlTable):
    """Keys of a file for `diffmill learn` that stand before all tables."""

    job: File = Field(description='the job that was cut, such as "part.toml"')
    steps: Annotated[StrictInt, Field(ge=0, le=100)] = Field(
        default=8, description="steps of the next correction at most; 0: none is made"
    )
    prior: MachinePriorTable = Field(
        default_factory=MachinePriorTable, description="how far the machine may be off"
    )
    part: list[PartTable] = Field(
        default_factory=list,
        description="parts that were cut, in this order; none are required for "
        "--advise alone",
    )
    trial: list[TrialTable] = Field(
        default_factory=list,
        description="measurements that could be made, beside the usual ones",
    )
    advice: AdviceTable = Field(
        default_factory=AdviceTable, description="their instruments"
    )
