"""Settings of the files with a corrected program: `[output]` of a job file."""

import math
from typing import Annotated, Literal, TypeAlias

from pydantic import StrictBool

from .base import ReadAs, Settings, key
from .fields import Delay, PositiveLength, Tolerance

Format: TypeAlias = Literal["gcode", "krl", "rapid", "apt"]
Formats: TypeAlias = Annotated[tuple[Format, ...], ReadAs(list[Format], tuple)]
# Suffixes of the files.
_SUFFIXES = {"gcode": ".ngc", "krl": ".src", "rapid": ".mod", "apt": ".apt"}


class OutputSettings(Settings, table="output"):
    """Format of the files with a corrected program.

    Attributes:
        formats: Formats of the program.
        tolerance: Largest distance of the written motion from the command at the
            time of every row [m]; 0 writes every row.
        stream_cycle: Time between the rows of a stream of offsets [s]; 0 writes none.
        max_step: How far an offset may change in a cycle [m].
        blocks: "lines", or "spline" for formats that know splines (KRL).
        moved_ends: Whether the program is also written with its own blocks, their ends
            moved.
        tool_axis: Axis of a controller's tool that points from the shank to the tip.
        first_angles: A, B and C with which the program's first position is written
            [deg], if it has them.
        first_status: Which way the joints of a robot reach it, see `Program`.
        source_axis: `tool_axis` of the program that is corrected.
        pass_over: Routines that it calls and that move nothing.
    """

    formats: Formats = key(
        "formats of the corrected program; if left out that of a KRL or RAPID "
        'program, else ["gcode"], or ["krl"] if the tool tilts, which G-code of X, Y '
        "and Z cannot",
        default=("gcode",),
        follows=True,
    )
    tolerance: Tolerance = key(
        "largest distance of the written program from the command at any time; 0 "
        "writes every tooth period",
        default=1e-6,
    )
    stream_cycle: Delay = key(
        'time between the rows of stream.csv, such as "4 ms"; 0 writes no stream',
        default=0.0,
    )
    max_step: PositiveLength = key(
        'change of an offset in a cycle above which a note is given, such as "50 um"',
        default=math.inf,
    )
    blocks: Literal["lines", "spline"] = key(
        "lines, or a spline in KRL", default="lines"
    )
    moved_ends: StrictBool = key(
        "true: also writes the program itself with the ends of its blocks moved",
        default=False,
    )
    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] = key(
        "axis of the controller's tool that points from the shank to the tip, in KRL "
        "and RAPID; if left out that of a KRL or RAPID program, else z",
        default="z",
        follows=True,
    )
    first_angles: tuple[float, float, float] | None = None
    first_status: tuple[float, ...] = ()
    source_axis: str | None = None
    pass_over: tuple[str, ...] = ()

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Suffixes of the program's files, such as ".ngc"."""
        return tuple(_SUFFIXES[name] for name in self.formats)

    def idle(self) -> tuple[str, ...]:
        """Keys that have no effect beside the others, each with the reason."""
        found = []
        if self.blocks == "spline" and "krl" not in self.formats:
            found.append('blocks: without effect, since formats has no "krl"')
        if self.max_step < math.inf and self.stream_cycle == 0:
            found.append("max_step: without effect, since stream_cycle is 0")
        return tuple(found)
