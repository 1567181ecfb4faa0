"""Optimiser of a job, resumable from its checkpoints."""

import functools
from collections.abc import Callable
from typing import NamedTuple

from ..._job import Job
from .._core.method import MethodResult
from .._method.adam import Adam
from .._method.checkpoint import pack_fit, unpack_fit
from .._method.gauss_newton import GaussNewton
from .._segments.plant_segment import AbstractPieces
from .._segments.receding_horizon import RecedingHorizon
from .case_runner import CaseRecord
from .method import Optimiser
from .objective import UnsuitableSettings
from .plant_segments import preview_rows

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
    is_able &= not has_own_objective
    if settings.horizon == "auto":
        horizon = _HORIZON if rows > _WHOLE_ROWS and is_able else rows
    else:
        horizon = settings.horizon
    if horizon >= rows:
        return None
    if not is_able:
        raise UnsuitableSettings(
            'Argument `job` must have the horizon "auto" unless its objective is '
            '"path" and not one of your own, its mode "dynamic", its model certain '
            f'and its method "gauss_newton", but has a horizon of {horizon} rows.'
        )
    overlap, ahead = settings.overlap, preview_rows(job)
    if overlap == "auto":
        knots = round(_OVERLAP_KNOTS * settings.knot_spacing / float(job.tooth_period))
        overlap = max(1, min(knots + ahead, horizon // 2))
    if overlap >= horizon:
        raise UnsuitableSettings(
            f"Argument `job` must have an overlap below its horizon of {horizon} rows, "
            f"but has {overlap} rows."
        )
    if overlap <= ahead:
        raise UnsuitableSettings(
            f"Argument `job` must have an overlap above the {ahead} rows by which its "
            f"controller looks ahead, but has {overlap} rows."
        )
    return SegmentRows(horizon, overlap)


def with_segment_checkpoints(
    method: Optimiser,
    pieces: AbstractPieces,
    record: CaseRecord,
    segments: SegmentRows | None,
) -> Callable[..., MethodResult]:
    """Return a method that corrects as a job asks, and tells all that it has found.

    Args:
        method: The optimiser.
        pieces: The plant, piece by piece.
        record: Where it tells it, after every step or every segment, and what it goes
            on from.
        segments: Rows of the segments; None for the path as a whole.

    Returns:
        A function of a problem, as `AbstractMethod`.
    """
    if isinstance(method, Adam):
        return functools.partial(
            method,
            on_memory=lambda arrays: record.store("adam", arrays),
            resume=record.stored("adam") or None,
        )
    if segments is None:
        return with_step_checkpoints(method, "gauss_newton", record)
    return RecedingHorizon(
        pieces,
        method,
        horizon=segments.length,
        overlap=segments.overlap,
        on_checkpoint=lambda arrays: record.store("horizon", arrays),
        resume=record.stored("horizon") or None,
    )


def with_step_checkpoints(
    method: GaussNewton, name: str, record: CaseRecord
) -> Callable[..., MethodResult]:
    """Return a method on a whole path that tells every step under a name."""
    state = record.stored(name)
    return functools.partial(
        method,
        on_state=lambda state: record.store(name, pack_fit(state)),
        resume=unpack_fit(state) if state else None,
    )
