"""What a program for a machine takes for granted and does not say itself."""

import dataclasses
from collections.abc import Mapping
from typing import Literal

from ...toolpath import Point
from .geometry import ToolAxis


@dataclasses.dataclass(frozen=True)
class ProgramSetup:
    """Settings that the operator of a machine makes before a program runs.

    Attributes:
        feed: Feed of moves for which the program gives none [m/s], or None.
        offsets: Zeros of coordinate systems in `work` [m], by word ("G54", "G59.1").
            A program that uses one system alone needs none: it is `work`.
        tool_lengths: Lengths that G43 H compensates [m], by number. Without them the
            tip is where the program says as soon as it states Z after G43 or G49.
        machine_zero: Zero of the machine in `work` [m]; a cut that depends on G53,
            G28 or G30 needs it.
        reference_points: Machine coordinates to which G28 and G30 go [m].
        skips_blocks: Whether lines that begin with a block delete / are left out.
        tool_radii: Radii of cutters [m] that G41 and G42 compensate, by D.
        radius: Radius of a D that `tool_radii` leaves out [m], or None.
        dialect: Whose parameters, loops and calls G-code has; None for Fanuc's where
            the program has words that LinuxCNC does not know, else LinuxCNC's.
        arc_centres: Whether I, J and K of arcs are measured from the start of the arc,
            or are the place of its centre, until G-code has G90.1 or G91.1.
        tool_axis: Axis of the tool that points from the shank to the tip, for programs
            of robots, "z" if None; for a path "z" if its i, j, k do, else "-z".
        pass_over: Routines of robots' programs and M codes that move nothing.
    """

    feed: float | None = None
    offsets: Mapping[str, Point] = dataclasses.field(default_factory=dict)
    tool_lengths: Mapping[int, float] = dataclasses.field(default_factory=dict)
    machine_zero: Point | None = None
    reference_points: tuple[Point, Point] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    skips_blocks: bool = False
    tool_radii: Mapping[int, float] = dataclasses.field(default_factory=dict)
    radius: float | None = None
    dialect: Literal["linuxcnc", "fanuc"] | None = None
    arc_centres: Literal["relative", "absolute"] = "relative"
    tool_axis: ToolAxis | None = None
    pass_over: tuple[str, ...] = ()
