"""What holds from one block of a program to the next."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from ....toolpath import Move, Point
from ..faults import Fault
from ..geometry import MM_PER_INCH, point_of
from ..move_list import MoveList
from ..setup import ProgramSetup
from .arcs import INCH_TOLERANCE, MM_TOLERANCE, ArcTolerance
from .blocks import Block
from .compensation import CutterCompensation

AXES = "XYZ"
# Codes that go to places of the machine.
MACHINE_CODES = ("G28", "G30", "G53")
NO_MACHINE_ZERO = (
    "where the machine's zero lies is not known; needed is its place in `work` (in a "
    "job: [program] machine_zero)."
)


class Turn(NamedTuple):
    """Rotation, scaling or mirror image of places in the XY plane.

    A place p goes to centre + factor (p - centre), in the units of the program; a
    mirror image takes the conjugate of p - centre.
    """

    centre: complex
    factor: complex = 1.0 + 0j
    is_mirror: bool = False

    def direction(self, way: complex) -> complex:
        """A way between two places, turned."""
        return self.factor * (way.conjugate() if self.is_mirror else way)

    def place(self, place: complex) -> complex:
        """A place, turned."""
        return self.centre + self.direction(place - self.centre)

    def before(self, place: complex) -> complex:
        """The place that is turned to a place."""
        way = (place - self.centre) / self.factor
        return self.centre + (way.conjugate() if self.is_mirror else way)


@dataclass
class Cycle:
    """Words of a canned cycle, which hold until another motion is chosen.

    They are kept as written, but for `level` [mm]: where the tool was before the first
    of several cycles in a row.
    """

    level: float = math.nan
    bottom: float = math.nan
    retract: float = math.nan
    rest: float = math.nan
    peck: float = math.nan


@dataclass(slots=True)
class State:
    """State between two blocks; NaN marks numbers that a fault made unknown.

    Attributes:
        setup: Settings that the program does not state.
        out: The moves so far.
        position: Tool tip in `work` [mm].
        motion: Motion code times ten; None before the first, 800 for none, -1 after a
            refused one.
        plain_motion: The last motion code that was no cycle, times ten.
        plane: Index of the axis across the working plane.
        scale: Millimetres per unit of the program.
        feed: Feed [mm/s], with G95 per revolution [mm]; None before the first F word.
        feed_mode: 930 inverse time, 940 per minute, 950 per revolution.
        system: Coordinate system, such as "G54".
        zeros: Zeros of the systems in `work` [mm].
        machine_places: Zeros of systems in machine coordinates that G10 L2 has stated
            without the zero of the machine [mm].
        references: Points of G28 and G30 that G28.1 and G30.1 have set, in `work` with
            a tool of no length [mm].
        own_offset: Offset of G92 [mm], and the one that G92.3 restores.
        unknown: Axes along which the place of the tool is not known, and what has lost
            it, such as "G53".
        unknown_exits: By tool, what is wrong if it cuts again: it has left a cut for a
            place that is not known.
        turns: What turns, scales or mirrors the places of words in the XY plane, by
            modal group.
        shift: From program coordinates to `work` [mm]; None if to be found anew.
        length: Compensated tool length [mm]; None if it is not known.
        radius_number: The last D; None before the first.
        compensation: Compensation of the cutter's radius at work.
        retract: Way up out of a cut, made before the next move of the tool.
        departure: Where the tool is behind G40, beside the programmed position [m].
    """

    setup: ProgramSetup
    out: MoveList = field(default_factory=MoveList)
    position: Point = (0.0, 0.0, 0.0)
    motion: int | None = None
    plain_motion: int | None = None
    plane: int = 2
    is_plane_known: bool = True
    scale: float = 1.0
    is_incremental: bool = False
    is_centre_absolute: bool = False
    is_retract_high: bool = False
    is_ended: bool = False
    feed: float | None = None
    feed_mode: int = 940
    spindle_rpm: float = 0.0
    is_surface_speed: bool = False
    selected_tool: int | None = None
    system: str = "G54"
    zeros: dict[str, Point] = field(default_factory=dict)
    machine_places: dict[str, Point] = field(default_factory=dict)
    references: list[Point | None] = field(default_factory=lambda: [None, None])
    own_offset: Point = (0.0, 0.0, 0.0)
    stored_offset: Point = (0.0, 0.0, 0.0)
    unknown: dict[str, str] = field(default_factory=dict)
    unknown_exits: dict[int | None, Fault] = field(default_factory=dict)
    is_polar: bool = False
    is_turned: bool = False
    turns: dict[str, Turn] = field(default_factory=dict)
    shift: Point | None = None
    length: float | None = 0.0
    length_word: str = ""
    cycle: Cycle = field(default_factory=Cycle)
    radius_number: float | None = None
    compensation: CutterCompensation | None = None
    departure: Point | None = None
    retract: Move | None = None
    # True once a move may be another one than programmed.
    is_beside: bool = False

    def add(self, move: Move, axes: str) -> None:
        """Add a programmed move."""
        retract, self.retract = self.retract, None
        if retract is not None and not self.out.is_approach:
            self.out.add(retract, "")
        if self.departure is not None:
            if move.centre is not None:
                message = "the first move behind G40 is straight."
                self.out.faults.append(Fault(move.line, "", message))
            move, self.departure = move._replace(start=self.departure), None
        (self.compensation or self.out).add(move, axes)

    @property
    def arc_tolerance(self) -> ArcTolerance:
        """Tolerances of arcs in the units of the program."""
        return INCH_TOLERANCE if self.scale == MM_PER_INCH else MM_TOLERANCE


def new_state(setup: ProgramSetup) -> State:
    """Return the state before the first block."""
    zeros = {
        name: (1e3 * x, 1e3 * y, 1e3 * z) for name, (x, y, z) in setup.offsets.items()
    }
    return State(setup, zeros=zeros, is_centre_absolute=setup.arc_centres == "absolute")


def find_shift(block: Block, state: State) -> Point:
    """Return the way from program coordinates to `work` [mm]."""
    if state.shift is not None:
        return state.shift
    zero = find_zero(state.system, block, state)
    state.shift = point_of(a + b for a, b in zip(zero, state.own_offset, strict=True))
    return state.shift


def find_zero(name: str, block: Block, state: State) -> Point:
    """Return the zero of a system in `work` [mm]; the first one used is `work`."""
    places = state.machine_places
    if name not in state.zeros:
        known = next((one for one in state.zeros if one in places), None)
        if known is not None and name in places:
            steps = zip(state.zeros[known], places[name], places[known], strict=True)
            state.zeros[name] = point_of(zero + at - old for zero, at, old in steps)
            return state.zeros[name]
        if state.zeros:
            message = (
                f"where {name} lies is not known; needed is its zero in `work` "
                f'(in a job: [program] offsets = {{ "{name}" = ["0 mm", ...] }}).'
            )
            block.refuse(block.texts.get("system", ""), message)
        state.zeros[name] = (0.0, 0.0, 0.0)
    return state.zeros[name]


def lose_place(axes: str, word: str, block: Block, state: State) -> None:
    """Forget where the tool is along some axes, until the program states it."""
    state.unknown |= dict.fromkeys(axes, word)
    state.out.lose(axes, block.line)


def require_place(axes: str, word: str, block: Block, state: State) -> None:
    """Report a code that needs to know where the tool is along some axes."""
    lost = [axis for axis in axes if axis in state.unknown]
    if not lost:
        return
    cause, names = state.unknown[lost[0]], " and ".join(lost)
    key = "machine_zero" if cause in MACHINE_CODES else "tool_lengths"
    message = (
        f"where the tool is in {names} is not known after {cause}; needed is {names} "
        f"in a G0 before (or, in a job, [program] {key})."
    )
    block.refuse(word, message)
    state.unknown.clear()


def machine_zero(block: Block, word: str, state: State) -> Point | None:
    """Return the zero of the machine in `work` [mm], or None with a fault."""
    if state.setup.machine_zero is None:
        block.refuse(word, NO_MACHINE_ZERO)
        return None
    return point_of(1e3 * value for value in state.setup.machine_zero)


def metres(point: Point) -> Point:
    """Return a point given in millimetres in metres."""
    return point[0] * 1e-3, point[1] * 1e-3, point[2] * 1e-3
