"""Correction of a program: a command whose actual path is the desired one.

What it models: a plant (machine with process, any traceable function from a command
to a motion) and methods that look for a better command behind one interface: the
mirror, once and iterated; the inverse drive; bounded Gauss-Newton on spline offsets
with exact derivatives, for the tip or the machined surface, for one model or draws of
it. All report the same figures, over the rows that cut and by part of the path.
Assumptions: the command is one row per tooth period; the controller follows what
the knot spacing and the limits of velocity and acceleration allow.
Left out: corrections of feed and of the tool axis; limits of the joints, of the depth
of a gouge and of leaving the cut; the worst case instead of the mean over draws.
"""

from ._bspline import SplineOffsets as SplineOffsets
from ._correct import (
    CASES as CASES,
    Correction as Correction,
    NothingToCorrect as NothingToCorrect,
    correct as correct,
)
from ._ensemble import (
    Ensemble as Ensemble,
    ScaledPlant as ScaledPlant,
    draw_scales as draw_scales,
)
from ._first_order import Adam as Adam
from ._gauss_newton import (
    ContourResidual as ContourResidual,
    GaussNewton as GaussNewton,
    contour_residual as contour_residual,
)
from ._horizon import RecedingHorizon as RecedingHorizon
from ._inverse_drive import (
    InverseDriveCommand as InverseDriveCommand,
    at_instants as at_instants,
    differentiate as differentiate,
    inverse_drive as inverse_drive,
    spring_deflection as spring_deflection,
)
from ._least_squares import least_squares as least_squares
from ._least_squares_records import (
    LeastSquaresSolution as LeastSquaresSolution,
    LeastSquaresStep as LeastSquaresStep,
    LevenbergMarquardt as LevenbergMarquardt,
)
from ._limited_quadratic import (
    solve_limited_quadratic as solve_limited_quadratic,
)
from ._limits import (
    InfeasibleLimit as InfeasibleLimit,
    LinearLimits as LinearLimits,
    command_limits as command_limits,
)
from ._measures import Measures as Measures, measure as measure
from ._method import (
    AbstractMethod as AbstractMethod,
    Corrected as Corrected,
    GivenCommand as GivenCommand,
)
from ._mirror import IteratedMirror as IteratedMirror, Mirror as Mirror
from ._objective import (
    AbstractObjective as AbstractObjective,
    PathObjective as PathObjective,
)
from ._parts import PARTS as PARTS, by_part as by_part, path_parts as path_parts
from ._problem import (
    Motion as Motion,
    Plant as Plant,
    Problem as Problem,
    contour_of as contour_of,
    run as run,
)
from ._products import (
    AbstractProducts as AbstractProducts,
    RecomputedProducts as RecomputedProducts,
    StoredProducts as StoredProducts,
)
from ._projection import clip_offset as clip_offset, project as project
from ._quadratic import (
    QuadraticSolution as QuadraticSolution,
    solve_bounded_quadratic as solve_bounded_quadratic,
)
from ._response import (
    TipResponse as TipResponse,
    spline_preconditioner as spline_preconditioner,
    tip_response as tip_response,
)
from ._segments import AbstractPiece as AbstractPiece, AbstractPieces as AbstractPieces
from ._spline_window import (
    SplineWindow as SplineWindow,
    spline_window as spline_window,
)
from ._surface_objective import (
    FinishedSurface as FinishedSurface,
    SurfaceMeasures as SurfaceMeasures,
    SurfaceObjective as SurfaceObjective,
    finished_surface as finished_surface,
    measure_surface as measure_surface,
)
from ._weights import row_weights as row_weights, surface_poses as surface_poses
