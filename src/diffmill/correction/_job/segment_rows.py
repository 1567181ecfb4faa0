"""Segments in which the path of a job is corrected, if it is long."""

import equinox as eqx

from ..._job import Job
from .objective import UnsuitableSettings
from .plant_segments import preview_rows

# Paths of at most so many rows are corrected as a whole, unless the job says otherwise.
_WHOLE_ROWS = 6000
# Rows of a segment.
_HORIZON_ROWS = 2000
# Knots of the overlap: at 30 ms as long as an arm with a mode of 10 Hz and 2 % damping
# needs to lose two thirds of a swing.
_OVERLAP_KNOTS = 32


class SegmentRows(eqx.Module):
    """Rows of the segments in which a long path is corrected.

    Attributes:
        length: Of a segment.
        overlap: Of two that follow each other.
    """

    length: int
    overlap: int

    @classmethod
    def of_job(cls, job: Job, *, has_own_objective: bool) -> "SegmentRows | None":
        """Rows of the segments of a job; None for the path as a whole.

        An objective of one's own may look at the whole path, so that it gets the whole.

        Raises:
            UnsuitableSettings: The job asks for segments where there can be none.
        """
        settings, rows = job.correction, job.path.step_count
        strategies = settings.objective, settings.optimiser, job.simulation.mode
        is_able = not any(one.needs_whole_path for one in strategies)
        is_able &= settings.uncertainty is None and not has_own_objective
        if settings.horizon == "auto":
            horizon = _HORIZON_ROWS if rows > _WHOLE_ROWS and is_able else rows
        else:
            horizon = settings.horizon
        if horizon >= rows:
            return None
        if not is_able:
            raise UnsuitableSettings(
                'Argument `job` must have the horizon "auto" unless its objective, '
                "method and mode take a path in segments, its model is certain and the "
                f"objective not one of your own, but has a horizon of {horizon} rows."
            )
        overlap, ahead = settings.overlap, preview_rows(job)
        if overlap == "auto":
            knots = round(
                _OVERLAP_KNOTS * settings.knot_spacing / float(job.tooth_period)
            )
            overlap = max(1, min(knots + ahead, horizon // 2))
        if overlap >= horizon:
            raise UnsuitableSettings(
                "Argument `job` must have an overlap below its horizon of "
                f"{horizon} rows, but has {overlap} rows."
            )
        if overlap <= ahead:
            raise UnsuitableSettings(
                f"Argument `job` must have an overlap above the {ahead} rows by which "
                f"its controller looks ahead, but has {overlap} rows."
            )
        return cls(horizon, overlap)
