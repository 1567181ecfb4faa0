"""Correction of a program: a command whose actual path is the desired one.

What it models: a plant (machine with process, any traceable function from a command
to a motion) and methods that look for a better command behind one interface: the
mirror, once and iterated; an input shaper; the inverse drive; bounded Gauss-Newton on
spline offsets with exact derivatives, for the tip or the machined surface, for one
model or draws of it. All report the same figures, over the rows that cut and by part of
the path.
Assumptions: the command is one row per tooth period; the controller follows what
the knot spacing and the limits of velocity and acceleration allow.
Limits of the command and of the joints, the gouge limit and staying in the cut are
held by Gauss-Newton, not penalised; what cannot be held is refused.
The feed is a second unknown, which trades error for time; the place of the workpiece
in the cell, and the turn of the flange about the tool axis, a third, chosen beforehand
by what the springs alone leave.
For optimisers of other packages `residual` gives the same problem as pure functions.
Left out: feed and offset at once; corrections of the tool axis; in segments of long
paths, the surface as the objective and uncertain models.
"""

from ._core.method import GivenCommand as GivenCommand
from ._core.path_objective import (
    AbstractObjective as AbstractObjective,
    PathObjective as PathObjective,
)
from ._core.path_segments import PathParts as PathParts
from ._core.problem import (
    Motion as Motion,
    Problem as Problem,
)
from ._core.row_weights import (
    row_weights as row_weights,
)
from ._feed.fastest_feed import (
    FastestFeed as FastestFeed,
    TriedFeed as TriedFeed,
    fastest_feed as fastest_feed,
)
from ._feed.problem import (
    FeedProblem as FeedProblem,
)
from ._feed.result import FeedTradeoff as FeedTradeoff, TunedFeed as TunedFeed
from ._feed.trade_off_curve import FeedPoint as FeedPoint
from ._feed.tune_feed import feed_tradeoff as feed_tradeoff, tune_feed as tune_feed
from ._job.correct import (
    Correction as Correction,
    correct as correct,
)
from ._job.correction_problem import NothingToCorrect as NothingToCorrect
from ._job.joint_limits import (
    JointLimits as JointLimits,
)
from ._job.objective import UnsuitableSettings as UnsuitableSettings
from ._job.plants import ScaledPlant as ScaledPlant, TipPlant as TipPlant
from ._job.residual import residual as residual
from ._job.segment_rows import SegmentRows as SegmentRows
from ._method.adam import Adam as Adam
from ._method.ensemble import (
    DelayedPlant as DelayedPlant,
    Ensemble as Ensemble,
    delayed as delayed,
)
from ._method.gauss_newton import GaussNewton as GaussNewton
from ._method.input_shaper import shaped as shaped
from ._method.inverse_drive import inverse_drive as inverse_drive
from ._method.mirror import (
    IteratedMirror as IteratedMirror,
    Mirror as Mirror,
)
from ._placement.place_workpiece import place_workpiece as place_workpiece
from ._segments.plant_segment import (
    AbstractPiece as AbstractPiece,
    AbstractPieces as AbstractPieces,
)
from ._segments.receding_horizon import RecedingHorizon as RecedingHorizon
from ._spline.command_limits import (
    InfeasibleLimit as InfeasibleLimit,
    LinearLimits as LinearLimits,
)
from ._spline.projection import project as project
from ._spline.spline_offsets import SplineOffsets as SplineOffsets
from ._surface.finished_surface import FinishedSurface as FinishedSurface
from ._surface.surface_limits import SurfaceBounds as SurfaceBounds
from ._surface.surface_objective import SurfaceObjective as SurfaceObjective
