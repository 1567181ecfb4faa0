"""Optimiser of a job, resumable from its checkpoints."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from ..._job import Job
from ...process import AbstractAdjoint
from .._method.adam import Adam
from .._method.checkpoint import pack_rounds, unpack_rounds
from .._method.gauss_newton import GaussNewton
from .._segments.receding_horizon import RecedingHorizon
from .case_runner import CaseRecord
from .method import Optimiser
from .objective import UnsuitableSettings
from .plant_segments import JobPieces, Steps

# Paths of at most so many rows are corrected as a whole, unless the job says otherwise.
_WHOLE_ROWS = 6000
# Rows of a segment.
_HORIZON = 2000
# Knots of the overlap: at 30 ms as long as an arm with a mode of 10 Hz and 2 % damping
# needs to lose two thirds of a swing.
_OVERLAP_KNOTS = 32


class SegmentRows(NamedTuple):
    """Rows of the segments in which a long path is corrected.

    Attributes:
        length: Of a segment.
        overlap: Of two that follow each other.
    """

    length: int
    overlap: int


def segment_rows(job: Job, *, has_own_objective: bool) -> SegmentRows | None:
    """Return the rows of the segments of a job; None for the path as a whole.

    An objective of one's own may look at the whole path, so that it gets the whole.

    Raises:
        UnsuitableSettings: The job asks for segments where there can be none.
    """
    settings, rows = job.correction, job.path.step_count
    is_able = settings.objective == "path" and job.simulation.mode == "dynamic"
    is_able &= settings.uncertainty is None and settings.method != "adam"
    is_able &= job.controller is None and not has_own_objective
    if settings.horizon == "auto":
        horizon = _HORIZON if rows > _WHOLE_ROWS and is_able else rows
    else:
        horizon = settings.horizon
    if horizon >= rows:
        return None
    if not is_able:
        raise UnsuitableSettings(
            'Argument `job` must have the horizon "auto" unless its objective is '
            '"path" and not one of your own, its mode "dynamic", its model certain, '
            'its controller ideal and its method "gauss_newton", but has a horizon of '
            f"{horizon} rows."
        )
    overlap = settings.overlap
    if overlap == "auto":
        knots = round(_OVERLAP_KNOTS * settings.knot_spacing / float(job.tooth_period))
        overlap = max(1, min(knots, horizon // 2))
    if overlap >= horizon:
        raise UnsuitableSettings(
            f"Argument `job` must have an overlap below its horizon of {horizon} rows, "
            f"but has {overlap} rows."
        )
    return SegmentRows(horizon, overlap)


def keeping(
    job: Job,
    method: Optimiser,
    adjoint: AbstractAdjoint,
    record: CaseRecord,
    wall_share: Steps,
    segments: SegmentRows | None,
) -> Callable[..., Any]:
    """Return a method that corrects as the job asks, and tells all that it has found.

    Args:
        job: The job, in its precision.
        method: The optimiser.
        adjoint: How to differentiate through the removal.
        record: Where it tells it, after every step or every segment, and what it goes
            on from.
        wall_share: When in each period its wall is made, shape (step,).
        segments: Rows of the segments; None for the path as a whole.

    Returns:
        A function of a problem, as `AbstractMethod`.
    """
    if isinstance(method, Adam):
        return functools.partial(
            method,
            on_memory=lambda arrays: record.keep("adam", arrays),
            resume=record.kept("adam") or None,
        )
    if segments is None:
        return remembering(method, "gauss_newton", record)
    return RecedingHorizon(
        JobPieces(job, adjoint, wall_share, job.correction.command == "joint"),
        method,
        horizon=segments.length,
        overlap=segments.overlap,
        on_checkpoint=lambda arrays: record.keep("horizon", arrays),
        resume=record.kept("horizon") or None,
    )


def remembering(
    method: GaussNewton, name: str, record: CaseRecord
) -> Callable[..., Any]:
    """Return a method on a whole path that tells every step under a name."""
    state = record.kept(name)
    return functools.partial(
        method,
        on_state=lambda state: record.keep(name, pack_rounds(state)),
        resume=unpack_rounds(state) if state else None,
    )
