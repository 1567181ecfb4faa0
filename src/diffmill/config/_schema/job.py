"""The tables of a job file: which keys there are and what each may hold.

Every table is checked on its own, so that a fault in one does not hide those of the
others.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, TypeVar

from pydantic import Field, StrictBool, StrictInt, StrictStr

from ...settings.base import Settings
from ...settings.correction import CorrectionSettings
from ...settings.fields import (
    Acceleration,
    Angles3,
    Damping,
    Delay,
    Jerk,
    Lengths3,
    PositiveLength,
    PositiveSpeed,
    Slots,
    SpindleSpeed,
    Stiffness,
    Tolerance,
    Uncertainty,
)
from ...settings.tables import TomlTable, meant_by, read_settings, validated
from .compliance import BendingToolTable, FlangeSpringTable
from .controller import ControllerTable, read_controller
from .cutter import CutterTable
from .force import ForceTables, read_force
from .machine import MachineTable, is_machine

if TYPE_CHECKING:
    from ..._job import OutputSettings
    from ...toolpath import Point

_Table = TypeVar("_Table")
_Toml = TypeVar("_Toml", bound=TomlTable)
_Settings = TypeVar("_Settings", bound=Settings)
CoordinateSystem: TypeAlias = Literal[
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"
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
        "required, but beside result its own holds",
    )
    intervals: Annotated[list[Slots], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="how many intervals a ray along x, y and z may hold, such as "
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
        "that the controller is told instead, such as the corrected.csv of a result; "
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
        description="time over which the way along the path is averaged, against "
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
    machine_zero: Lengths3 | None = Field(
        default=None,
        description="zero of the machine in work, such as "
        '["-200 mm", "-150 mm", "400 mm"]; required for G53, G28, G30 and G10 L2',
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
        'as "drives.toml"; nothing is added if left out',
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


class OutputTable(TomlTable):
    """`[output]`."""

    formats: list[Literal["gcode", "krl", "rapid", "apt"]] | None = Field(
        default=None,
        description='formats of the corrected program; ["gcode"] if left out, or '
        '["krl"] if the tool tilts, which G-code of X, Y and Z cannot',
    )
    tolerance: Tolerance = Field(
        default=1e-6,
        description="largest distance of the written program from the command at any "
        "time; 0 writes every tooth period",
    )
    stream_cycle: Delay = Field(
        default=0.0,
        description='time between the rows of stream.csv, such as "4 ms"; 0 writes no '
        "stream",
    )
    max_step: PositiveLength = Field(
        default=math.inf,
        description="change of an offset in a cycle above which a note is given, such "
        'as "50 um"',
    )
    blocks: Literal["lines", "spline"] = Field(
        default="lines", description="lines, or a spline in KRL"
    )
    moved_ends: StrictBool = Field(
        default=False,
        description="true: also writes the program itself with the ends of its blocks "
        "moved",
    )
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = Field(
        default=None,
        description="axis of the controller's tool that points from the shank to the "
        "tip, in KRL and RAPID; if left out that of a KRL or RAPID program, else z",
    )

    def settings(
        self,
        *,
        is_upright: bool,
        tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
        first_angles: "Point | None" = None,
    ) -> "OutputSettings":
        """Return the settings of a job."""
        from ..._job import OutputSettings

        suffixes = {"gcode": ".ngc", "krl": ".src", "rapid": ".mod", "apt": ".apt"}
        return OutputSettings(
            formats=tuple(suffixes[n] for n in self._names(is_upright=is_upright)),
            tolerance=self.tolerance,
            cycle=self.stream_cycle,
            max_step=self.max_step,
            is_spline=self.blocks == "spline",
            moves_ends=self.moved_ends,
            tool_axis=self.tool_axis or tool_axis or "z",
            first_angles=first_angles,
        )

    def _names(self, *, is_upright: bool) -> Sequence[str]:
        """Return the formats, those left out too."""
        if self.formats is None:
            return ["gcode"] if is_upright else ["krl"]
        return self.formats

    def notes(self, *, is_upright: bool) -> tuple[str, ...]:
        """Return which keys have no effect beside the others."""
        notes = []
        if self.blocks == "spline" and "krl" not in self._names(is_upright=is_upright):
            notes.append('[output] blocks: without effect, since formats has no "krl"')
        if self.max_step < math.inf and self.stream_cycle == 0:
            notes.append("[output] max_step: without effect, since stream_cycle is 0")
        return tuple(notes)


class ScatterTable(TomlTable):
    """`[simulation] scatter`: relative standard deviations of the model."""

    stiffness: Uncertainty = Field(
        default=0.0,
        description="relative standard deviation of the stiffness, such as 0.1",
    )
    damping: Uncertainty = Field(
        default=0.0,
        description="relative standard deviation of the damping, such as 0.2",
    )
    force: Uncertainty = Field(
        default=0.0,
        description="relative standard deviation of the force coefficients, such as "
        "0.1",
    )


class SimulationTable(TomlTable):
    """`[simulation]`."""

    angles: Annotated[StrictInt, Field(ge=1, le=100_000)] | None = Field(
        default=None,
        description="samples per revolution, a multiple of teeth times substeps; if "
        "left out at least 180 for an upright flat cutter of even pitch without "
        "run-out, else 96",
    )
    substeps: Annotated[StrictInt, Field(ge=1, le=1000)] | None = Field(
        default=None,
        description="steps of the machine in a tooth period; if left out 0.5 ms long "
        "at most, and as short as the modes of the machine ask",
    )
    element_height: PositiveLength | None = Field(
        default=None,
        description='height of the discs of the cutter, such as "0.2 mm"; if left out, '
        "it follows from the spacing of the stock and the helix angle",
    )
    axial_depth: PositiveLength | None = Field(
        default=None,
        description='deepest immersion that is computed, such as "3 mm"; that of the '
        "path if left out",
    )
    precision: Literal["float64", "float32"] = Field(
        default="float64", description="precision of all numbers"
    )
    gravity_compensated: StrictBool = Field(
        default=True, description="false: the controller leaves the sag of the arm"
    )
    chip: Literal["near_far", "point_cloud"] = Field(
        default="near_far",
        description="chip model; point_cloud is the hard one of the paper, for flat "
        "cutters of even pitch without run-out",
    )
    tool_tilt: StrictBool = Field(
        default=False, description="true: the bending arm also tilts the tool (slower)"
    )
    bottom_edges: StrictBool | None = Field(
        default=None,
        description="whether bottom edges cut where the tool descends, so that plunges "
        "push along the axis; if left out they do of a rigid machine and of an end "
        "with a dish_angle",
    )
    integrator: Literal["midpoint", "rk4"] = Field(
        default="midpoint",
        description="rule of the substeps; rk4 is explicit and slow, to verify the "
        "other by",
    )
    dynamics: Literal["crba", "aba"] = Field(
        default="crba",
        description="algorithm of the dynamics of the arm; aba, by articulated bodies, "
        "gives the same answer",
    )
    mode: Literal["dynamic", "quasistatic"] = Field(
        default="dynamic", description="quasistatic: the arm bends but does not swing"
    )
    stability: StrictBool | Literal["quick"] = Field(
        default="quick",
        description="true: chatter is looked for along the whole path; quick: only "
        "where most is cut; false: nowhere",
    )
    sensitivity: StrictBool = Field(
        default=False,
        description="true: also says what 10 % more stiffness, damping, force, ... "
        "does",
    )
    scatter: ScatterTable | None = Field(
        default=None,
        description="how far machines may be from the model, to add the contour error "
        "to be expected; not computed if left out",
    )


OPTIONAL_TABLES = frozenset(
    {"spindle", "controller", "simulation", "correction", "output"}
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
        simulation: `[simulation]`.
        correction: `[correction]`.
        output: `[output]`.
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
    simulation: SimulationTable | None
    correction: CorrectionSettings | None
    output: OutputTable | None
    stated: frozenset[str]


def read_tables(raw: Mapping[str, object], problems: list[str]) -> JobTables:
    """Check all tables of a job.

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
        is_there = _has_table(raw, name, problems)
        return check(raw.get(name, {}), problems) if is_there else None

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
        simulation=table("simulation", SimulationTable),
        correction=settings(CorrectionSettings),
        output=table("output", OutputTable),
        stated=frozenset(
            f"{name}.{key}"
            for name, keys in raw.items()
            if isinstance(keys, Mapping)
            for key in keys
        ),
    )


def _has_table(raw: Mapping[str, object], name: str, problems: list[str]) -> bool:
    """Return whether a table is to be checked; note one that is missing."""
    if name in raw or name in OPTIONAL_TABLES:
        return True
    if name == "machine" or (name == "robot" and is_machine(raw)):
        return False
    hint = ""
    if name == "robot":
        hint = " (rigid = true stands for no robot), or [machine]"
    problems.append(f"[{name}]: found no such table, but it is required{hint}")
    return False
