"""The tables of a job file: which keys there are and what each may hold.

Every table is checked on its own, so that a fault in one does not hide those of the
others.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Annotated, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, Field, StrictBool, StrictInt, StrictStr

from ...settings.base import Settings
from ...settings.correction import CorrectionSettings
from ...settings.fields import (
    Acceleration,
    Angles3,
    Damping,
    Delay,
    Jerk,
    Length,
    Lengths3,
    PositiveLength,
    PositiveSpeed,
    Slots,
    SpindleSpeed,
    Stiffness,
    Tolerance,
    fix_a_frame,
)
from ...settings.output import OutputSettings
from ...settings.simulation import SimulationSettings
from ...settings.tables import TomlTable, meant_by, read_settings, validated
from ...settings.truth import TruthSettings
from .calibration import CalibrationTable
from .compliance import BendingToolTable, FlangeSpringTable
from .controller import ControllerTable, read_controller
from .cutter import CutterTable
from .force import ForceTables, read_force
from .machine import MachineTable, is_machine

_Table = TypeVar("_Table")
_Toml = TypeVar("_Toml", bound=TomlTable)
_Settings = TypeVar("_Settings", bound=Settings)
CoordinateSystem: TypeAlias = Annotated[
    str, Field(pattern=r"^(G5[4-9]|G59\.[123]|G54\.1 P[1-9]\d{0,2})$")
]
# Keys of a TOML table are text.
ToolNumber: TypeAlias = Annotated[int, Field(ge=0)]


class SpindleTable(TomlTable):
    """`[spindle]`."""

    speed: SpindleSpeed | None = Field(
        default=None,
        description='speed of the spindle, such as "8000 rpm"; that of the program if '
        "left out",
    )


class StockTable(TomlTable):
    """`[stock]`."""

    lower: Lengths3 | None = Field(
        default=None,
        description="least x, y, z of a block in work, such as "
        '["0 mm", "0 mm", "-6 mm"]',
    )
    upper: Lengths3 | None = Field(
        default=None,
        description="greatest x, y, z of a block in work, such as "
        '["42 mm", "17 mm", "0 mm"]',
    )
    mesh: Annotated[StrictStr, Field(min_length=1)] | None = Field(
        default=None,
        description="file of a closed mesh (.stl, .obj, .ply) instead of a block, such "
        'as "stock.stl"',
    )
    mesh_unit: Literal["m", "cm", "mm", "um", "in"] | None = Field(
        default=None, description="unit of length of the mesh; mm if left out"
    )
    result: Annotated[StrictStr, Field(min_length=1)] | None = Field(
        default=None,
        description="folder of an earlier run, whose stock is taken instead of a block",
    )
    spacing: PositiveLength | None = Field(
        default=None,
        description='distance between the rays of the stock, such as "0.2 mm"; '
        "required, but result has its own",
    )
    intervals: Annotated[list[Slots], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="how many intervals a ray along x, y and z may have, such as "
        "[8, 8, 1]; as many as the program needs if left out",
    )


class ProgramTable(TomlTable):
    """`[program]`."""

    file: StrictStr = Field(
        min_length=1, description='a program or a path (.csv), such as "part.ngc"'
    )
    commanded: Annotated[StrictStr, Field(min_length=1)] | None = Field(
        default=None,
        description="for simulate: a path (.csv) with a row for each of the program's "
        "that the controller receives instead, such as the corrected.csv of a result; "
        "the error is still that from the program",
    )
    feed: PositiveSpeed | None = Field(
        default=None,
        description="feed of moves for which the program gives none, such as "
        '"50 mm/s"; required if there are such moves',
    )
    acceleration: Acceleration = Field(
        default=2.0, description="largest acceleration along and across the path"
    )
    rapid_feed: PositiveSpeed = Field(default=0.2, description="speed of rapid moves")
    corner_tolerance: Tolerance = Field(
        default=1e-4,
        description="largest distance from a corner that is rounded; at 0 the tool "
        "stops exactly at every corner",
    )
    smoothing: Delay = Field(
        default=0.0,
        description="time over which the motion along the path is averaged, against "
        'jumps of its acceleration, such as "100 ms"',
    )
    jerk: Jerk | None = Field(
        default=None,
        description='largest tangential jerk, such as "10 m/s^3", instead of '
        "smoothing; no limit if left out",
    )
    joint_ramp: Delay = Field(
        default=0.0,
        description='time in which a joint reaches its full speed, such as "0.2 s"; 0: '
        "accelerations of joints have no limit",
    )
    tool: Annotated[StrictInt, Field(ge=0)] | None = Field(
        default=None,
        description="number of the tool that is simulated, of several; if left out, "
        "the first that makes a move at a feed",
    )
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = Field(
        default=None,
        description="axis of the controller's tool that points from the shank to the "
        "tip, in programs that are read and written (KRL and RAPID); of a path z if "
        "its i, j, k point so; if left out z, and tip to shank in a path",
    )
    pass_over: list[StrictStr] = Field(
        default_factory=list,
        description="names of routines that a program of a robot calls, that no file "
        'has and that move neither arm nor work, such as ["SPINDLE_ON"], and M codes '
        'of G-code, such as ["M88"]; they are noted',
    )
    block_delete: StrictBool = Field(
        default=False, description="true: lines that begin with / are left out"
    )
    offsets: dict[CoordinateSystem, Lengths3] = Field(
        default_factory=dict,
        description="zeros of coordinate systems in work, such as { G55 = "
        '["100 mm", "0 mm", "0 mm"] }, for a program that uses several',
    )
    tool_lengths: dict[ToolNumber, Tolerance] = Field(
        default_factory=dict,
        description="tool lengths that G43 H compensates, by number, such as { 1 = "
        '"80 mm" }',
    )
    tool_radii: dict[ToolNumber, Length] = Field(
        default_factory=dict,
        description="radii of cutters that G41 and G42 compensate, by D, such as { 1 = "
        '"5 mm" }; of other D that of `[cutter]`',
    )
    dialect: Literal["linuxcnc", "fanuc"] | None = Field(
        default=None,
        description="whose parameters, loops and calls G-code has; if left out "
        "Fanuc's where the program has words that LinuxCNC does not know",
    )
    arc_centres: Literal["relative", "absolute"] = Field(
        default="relative",
        description="whether I, J and K of arcs are measured from the start of the arc "
        "or are the place of its centre, until the program has G90.1 or G91.1",
    )
    machine_zero: Lengths3 | None = Field(
        default=None,
        description="zero of the machine in work, such as "
        '["-200 mm", "-150 mm", "400 mm"]; required where a cut depends on G53, G28 '
        "or G30",
    )
    reference_point: Lengths3 = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="where G28 goes, in machine coordinates",
    )
    second_reference_point: Lengths3 = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="where G30 goes, in machine coordinates",
    )


class PoseTable(TomlTable):
    """A pose, as `[robot] work_in_base`: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position: Lengths3 = Field(
        description='place of the origin: three lengths, such as ["1500 mm", ...]'
    )
    rpy: Angles3 = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="angles roll, pitch and yaw",
    )


def _spread(points: list[list[float]]) -> list[list[float]]:
    """Points that fix a frame."""
    if not fix_a_frame(points):
        raise ValueError("found points on a line, but others are required")
    return points


ProbePoints: TypeAlias = Annotated[
    list[Lengths3], Field(min_length=3), AfterValidator(_spread)
]


class RegistrationTable(TomlTable):
    """`[registration]`."""

    points: ProbePoints | None = Field(
        default=None,
        description="points of the work that are touched off on a machine that its "
        "controller does not know, three or more that are not on a line, such as "
        '[["0 mm", "0 mm", "0 mm"], ...]; 40 rows of the path if left out',
    )


class LearntTable(TomlTable):
    """`[learnt]`."""

    file: StrictStr | None = Field(
        default=None,
        description="learnt.nc that `diffmill learn` has written of a part on this "
        "machine; the machine is as modelled if left out",
    )


class RobotTable(TomlTable):
    """`[robot]`."""

    model: StrictStr | None = Field(
        default=None,
        description='name of a built-in robot, such as "reis_rv130_like"; required '
        "without file and rigid",
    )
    file: StrictStr | None = Field(
        default=None,
        description='file of a robot of your own, such as "arm.toml" or "arm.urdf", '
        "instead of model",
    )
    rigid: StrictBool = Field(
        default=False,
        description="true: a machine that does not bend, instead of a robot; allows no "
        "other key",
    )
    tool: StrictStr | None = Field(
        default=None,
        description='link of a URDF that is the flange, such as "tool0"; required if '
        "several could be",
    )
    drives: Annotated[StrictStr, Field(min_length=1)] | None = Field(
        default=None,
        description="file with what the robot lacks (springs, drives, spindle), such "
        'as "drives.toml", or a payload class whose springs and damping are assumed: '
        '"class 10 kg", "class 200 kg", "class 500 kg"; nothing is added if left out',
    )
    joint_stiffness: list[Stiffness] | None = Field(
        default=None,
        description='stiffness of every joint, such as ["3.5 MN*m/rad", ...]; that of '
        "the robot and drives if left out",
    )
    joint_damping: list[Damping] | None = Field(
        default=None,
        description='damping of every joint, such as ["1825 N*m*s/rad", ...]; that of '
        "the robot and drives if left out",
    )
    reversal: StrictStr | None = Field(
        default=None,
        description="backlash and friction of a robot that was measured, "
        '"kuka_kr300"; those of the robot and drives if left out',
    )
    work_in_base: PoseTable | None = Field(
        default=None,
        description="pose of the workpiece in the base of the robot; required unless "
        "rigid = true, or the program states it ($BASE, a work object)",
    )
    tool_in_flange: PoseTable | None = Field(
        default=None,
        description="pose of the tool in the flange, its z up the shank; that of the "
        "robot if left out",
    )
    joint_start: list[StrictStr] | None = Field(
        default=None,
        description="joint positions near which the arm begins, such as "
        '["0 deg", "-60 deg", ...]; its home if left out',
    )
    tool_rotation: Literal["program", "fixed", "free"] | None = Field(
        default=None,
        description="rotation about the tool axis: program, as the program states it, "
        "fixed, x of the tool as near to x of work as it can be, or free, as suits the "
        "joints; program if left out where it states one, else fixed",
    )
    flange_spring: FlangeSpringTable | None = Field(
        default=None,
        description="what is soft between flange and spindle; nothing if left out",
    )
    bending_tool: BendingToolTable | None = Field(
        default=None, description="the cutter as a cantilever; rigid if left out"
    )
    calibration: CalibrationTable | None = Field(
        default=None,
        description="geometric errors of this robot; none if left out",
    )


OPTIONAL_TABLES = frozenset(
    {
        *("spindle", "controller", "registration", "learnt", "simulation"),
        "correction",
        *("output", "truth"),
    }
)


@dataclasses.dataclass(frozen=True)
class JobTables:
    """The checked tables of a job.

    None stands for a table with a fault, and for a required one that is missing; one
    that may be left out holds its defaults.

    Attributes:
        cutter: `[cutter]`.
        spindle: `[spindle]`.
        force: `[force]` and `[force.bottom]`.
        stock: `[stock]`.
        program: `[program]`.
        robot: `[robot]`; None beside a machine of modes.
        machine: `[machine]`; None beside a robot.
        controller: `[controller]`.
        registration: `[registration]`.
        simulation: `[simulation]`.
        correction: `[correction]`.
        output: `[output]`.
        truth: `[truth]`.
        stated: Keys that the file states, such as "cutter.teeth".
    """

    cutter: CutterTable | None
    spindle: SpindleTable | None
    force: ForceTables | None
    stock: StockTable | None
    program: ProgramTable | None
    robot: RobotTable | None
    machine: MachineTable | None
    controller: ControllerTable | None
    registration: RegistrationTable | None
    learnt: LearntTable | None
    simulation: SimulationSettings | None
    correction: CorrectionSettings | None
    output: OutputSettings | None
    truth: TruthSettings | None
    stated: frozenset[str]


def read_tables(raw: Mapping[str, object], problems: list[str]) -> JobTables:
    """Checked tables of a job.

    Args:
        raw: The parsed TOML.
        problems: Receives a line for everything that is wrong.

    """
    if "machine" in raw and "robot" in raw:
        problems.append(
            "[machine]: found beside [robot], but a job has either: modes of a spindle "
            "on an arm are those of [robot.flange_spring] and [robot.bending_tool]"
        )
    names = [f.name for f in dataclasses.fields(JobTables) if f.name != "stated"]
    allowed = ", ".join(f"[{name}]" for name in names)
    for name in raw:
        if name not in names:
            problems.append(
                f"{name}: found an unknown table or key; allowed: {allowed}"
                f"{meant_by(name, names)}"
            )

    def read(
        name: str, check: Callable[[object, list[str]], _Table | None]
    ) -> _Table | None:
        if name in raw or name in OPTIONAL_TABLES:
            return check(raw.get(name, {}), problems)
        if name == "machine" or (name == "robot" and is_machine(raw)):
            return None
        hint = ""
        if name == "robot":
            hint = " (rigid = true means no robot), or [machine]"
        problems.append(f"[{name}]: found no such table, but it is required{hint}")
        return None

    def table(name: str, kind: type[_Toml]) -> _Toml | None:
        return read(
            name, lambda found, faults: validated(kind, found, f"[{name}]", faults)
        )

    def settings(kind: type[_Settings]) -> _Settings | None:
        return read(
            kind.table, lambda found, faults: read_settings(kind, found, faults)
        )

    # In the order in which faults are listed.
    return JobTables(
        cutter=table("cutter", CutterTable),
        spindle=table("spindle", SpindleTable),
        force=read("force", read_force),
        stock=table("stock", StockTable),
        program=table("program", ProgramTable),
        robot=table("robot", RobotTable),
        machine=table("machine", MachineTable),
        controller=read("controller", read_controller),
        registration=table("registration", RegistrationTable),
        learnt=table("learnt", LearntTable),
        simulation=settings(SimulationSettings),
        correction=settings(CorrectionSettings),
        output=settings(OutputSettings),
        truth=settings(TruthSettings),
        stated=frozenset(
            f"{name}.{key}"
            for name, keys in raw.items()
            if isinstance(keys, Mapping)
            for key in keys
        ),
    )
