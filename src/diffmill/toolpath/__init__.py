"""Tool paths: where the tool shall be, and when.

A program is a list of moves (lines, arcs, helices); a path is the tool tip at every
tooth instant. Between them stands the timing: the programmed feed, one limit of the
tangential and the centripetal acceleration, those of a robot's joints, corners rounded
within a tolerance or stopped at, a start and an end at rest. Assumed: the controller
travels with trapezoidal speed, smoothed over a time, a corner is rounded by an arc
between lines and by a cubic curve at arcs, rapid moves are straight and end at rest,
the tool axis turns evenly along a move. A path of few blocks, straight or a spline,
keeps a tolerance at every time (`reduce_path`). Left out: axes of a machine that turn,
and the controller's own path deviation. The contour error of a path against the desired
one is JAX code and differentiates; everything else runs once, on the host, in NumPy.
"""

from ._contour import (
    ContourStatistics as ContourStatistics,
    contour_error as contour_error,
    contour_vector as contour_vector,
)
from ._moves import (
    Move as Move,
    Point as Point,
    Program as Program,
    Section as Section,
)
from ._override import (
    retime as retime,
)
from ._path import Path as Path
from ._path_feed import PathFeed as PathFeed
from ._reduction.block_ends import BlockEnds as BlockEnds
from ._reduction.reduce_path import reduce_path as reduce_path
from ._timing.legs import TimingLimits as TimingLimits
from ._timing.sample_program import sample_program as sample_program
from ._timing.timed_program import (
    ProgramTiming as ProgramTiming,
    TimedProgram as TimedProgram,
)
