"""The tables of a job file: which keys there are and what each may hold.

Every table is checked on its own, so that a fault in one does not hide those of the
others.
"""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import Field, StrictBool, StrictInt, StrictStr

from .compliance import BendingToolTable, FlangeSpringTable
from .controller import read_controller
from .correction import CorrectionTable
from .cutter import CutterTable
from .fields import (
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
from .force import read_force
from .machine import MachineTable, is_machine
from .table import TomlTable, meant_by, validated

if TYPE_CHECKING:
    from ..._job import OutputSettings

CoordinateSystem: TypeAlias = Literal[
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"
]
# Keys of a TOML table are text.
ToolNumber: TypeAlias = Annotated[int, Field(ge=0)]


class SpindleTable(TomlTable):
    """`[spindle]`."""

    speed: SpindleSpeed | None = None


class StockTable(TomlTable):
    """`[stock]`."""

    lower: Lengths3 | None = None
    upper: Lengths3 | None = None
    mesh: Annotated[StrictStr, Field(min_length=1)] | None = None
    mesh_unit: Literal["m", "cm", "mm", "um", "in"] | None = None
    result: Annotated[StrictStr, Field(min_length=1)] | None = None
    spacing: PositiveLength | None = None
    intervals: Annotated[list[Slots], Field(min_length=3, max_length=3)] | None = None


class ProgramTable(TomlTable):
    """`[program]`."""

    file: StrictStr = Field(
        min_length=1, description='a program or a path (.csv), such as "part.ngc"'
    )
    feed: PositiveSpeed | None = None
    acceleration: Acceleration = 2.0
    rapid_feed: PositiveSpeed = 0.2
    corner_tolerance: Tolerance = 1e-4
    smoothing: Delay = 0.0
    jerk: Jerk | None = None
    joint_ramp: Delay = 0.0
    tool: Annotated[StrictInt, Field(ge=0)] | None = None
    block_delete: StrictBool = False
    offsets: dict[CoordinateSystem, Lengths3] = Field(default_factory=dict)
    tool_lengths: dict[ToolNumber, Tolerance] = Field(default_factory=dict)
    machine_zero: Lengths3 | None = None
    reference_point: Lengths3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    second_reference_point: Lengths3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])


class PoseTable(TomlTable):
    """A pose: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position: Lengths3 = Field(description='three lengths, such as ["1500 mm", ...]')
    rpy: Angles3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])


class RobotTable(TomlTable):
    """`[robot]`."""

    model: StrictStr | None = None
    file: StrictStr | None = None
    rigid: StrictBool = False
    tool: StrictStr | None = None
    drives: Annotated[StrictStr, Field(min_length=1)] | None = None
    joint_stiffness: list[Stiffness] | None = None
    joint_damping: list[Damping] | None = None
    work_in_base: PoseTable | None = None
    tool_in_flange: PoseTable | None = None
    joint_start: list[StrictStr] | None = None
    tool_rotation: Literal["fixed", "free"] = "fixed"
    flange_spring: FlangeSpringTable | None = None
    bending_tool: BendingToolTable | None = None


class OutputTable(TomlTable):
    """`[output]`."""

    formats: list[Literal["gcode", "krl", "rapid", "apt"]] = Field(
        default_factory=lambda: ["gcode"]
    )
    tolerance: Tolerance = 1e-6
    stream_cycle: Delay = 0.0
    max_step: PositiveLength = math.inf
    blocks: Literal["lines", "spline"] = "lines"
    moved_ends: StrictBool = False

    def settings(self) -> "OutputSettings":
        """Return the settings of a job."""
        from ..._job import OutputSettings

        suffixes = {"gcode": ".ngc", "krl": ".src", "rapid": ".mod", "apt": ".apt"}
        return OutputSettings(
            formats=tuple(suffixes[name] for name in self.formats),
            tolerance=self.tolerance,
            cycle=self.stream_cycle,
            max_step=self.max_step,
            is_spline=self.blocks == "spline",
            moves_ends=self.moved_ends,
        )


class ScatterTable(TomlTable):
    """`[simulation] scatter`: relative standard deviations of the model."""

    stiffness: Uncertainty = 0.0
    damping: Uncertainty = 0.0
    force: Uncertainty = 0.0


class SimulationTable(TomlTable):
    """`[simulation]`."""

    angles: Annotated[StrictInt, Field(ge=1, le=100_000)] | None = None
    substeps: Annotated[StrictInt, Field(ge=1, le=1000)] | None = None
    element_height: PositiveLength | None = None
    axial_depth: PositiveLength | None = None
    precision: Literal["float64", "float32"] = "float64"
    gravity_compensated: StrictBool = True
    chip: Literal["near_far", "point_cloud"] = "near_far"
    tool_tilt: StrictBool = False
    bottom_edges: StrictBool = False
    integrator: Literal["midpoint", "rk4"] = "midpoint"
    dynamics: Literal["crba", "aba"] = "crba"
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    stability: StrictBool | Literal["quick"] = "quick"
    sensitivity: StrictBool = False
    scatter: ScatterTable | None = None


TABLES: dict[str, type[TomlTable]] = {
    "cutter": CutterTable,
    "spindle": SpindleTable,
    "stock": StockTable,
    "program": ProgramTable,
    "robot": RobotTable,
    "machine": MachineTable,
    "simulation": SimulationTable,
    "correction": CorrectionTable,
    "output": OutputTable,
}
OPTIONAL_TABLES = frozenset(
    {"spindle", "controller", "simulation", "correction", "output"}
)


def read_tables(raw: dict[str, Any], problems: list[str]) -> dict[str, Any]:
    """Check all tables of a job.

    Args:
        raw: The parsed TOML.
        problems: Receives a line for everything that is wrong.

    Returns:
        The tables without a fault, by name; optional ones that are absent hold
        their defaults.
    """
    tables = {}
    if "machine" in raw and "robot" in raw:
        problems.append(
            "[machine]: found beside [robot], but a job has either: modes of a spindle "
            "on an arm are those of [robot.flange_spring] and [robot.bending_tool]"
        )
    names = [*TABLES]
    names.insert(names.index("stock"), "force")
    names.insert(names.index("simulation"), "controller")
    allowed = ", ".join(f"[{name}]" for name in names)
    for name in raw:
        if name not in names:
            problems.append(
                f"{name}: found an unknown table or key; allowed: {allowed}"
                f"{meant_by(name, names)}"
            )
    for name in names:
        if name == "machine" and name not in raw:
            continue
        if name == "robot" and is_machine(raw):
            continue
        if name not in raw and name not in OPTIONAL_TABLES:
            hint = ""
            if name == "robot":
                hint = " (rigid = true stands for no robot), or [machine]"
            problems.append(f"[{name}]: found no such table, but it is required{hint}")
            continue
        found = raw.get(name, {})
        if name == "force":
            table = read_force(found, problems)
        elif name == "controller":
            table = read_controller(found, problems)
        else:
            table = validated(TABLES[name], found, f"[{name}]", problems)
        if table is not None:
            tables[name] = table
    return tables
