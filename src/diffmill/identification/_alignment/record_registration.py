"""Registration of records on their cuts: speed, window and time, to begin a fit."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from ..._job import Job
from ...cutting import LinearEdgeLaw
from .._cut.cut_model import (
    Cut,
    EngagementColumns,
    at_times,
    cut_of,
)
from .._cut.straight_cut import SETTLED, StraightCut
from .._force.mean_force import NAMES
from .._record.clock_faults import check_clock, check_teeth
from .._record.diagnosis import Diagnosis
from .._record.spindle_harmonics import refine_spindle_speed
from .axis_assignment import propose_axes
from .axis_proposal import AxesProposal
from .time_alignment import TimeAlignment, align_in_time

# Coefficients of a metal in proportion [Pa, N/m], where none are known.
_USUAL = np.array([1000e6, 350e6, 100e6, 15e3, 15e3, 5e3])
# Revolutions of a straight cut that are fitted, and teeth to which their number is
# rounded up so that few sizes are compiled.
_TURNS, _ROUND = 40, 32
# Samples from which the axes are judged, how many of a tooth period are enough, the
# least number, and usual steps over which a line is drawn.
_JUDGED, _PER_TOOTH, _LEAST, _BRIDGED = 8000, 32, 24, 2.5
# A nominal speed that is off by more is doubted.
_SPEED_OFF = 0.03
# A force this many times the largest of all but a few percent is a gross error.
_SPIKE, _ALL_BUT = 3.0, 0.98
# Share of the largest force below which the tool counts as out of the cut.
_CUTTING_SHARE = 0.02


@dataclasses.dataclass(frozen=True)
class RecordRegistration:
    """A record registered on its cut, its axes as recorded.

    Attributes:
        cut: The cut, with a plan.
        engagement: Its force per coefficient.
        time: Instants on the clock of the cut, to a revolution or better [s],
            shape (row,).
        force: As recorded [N], shape (row, 3); NaN out of the cut.
        offset: Clock of the cut minus clock of the record [s].
        proposal: Assignments of the axes.
        alignment: How well the sizes of the forces agree over a job, or None.
        spindle_speed: As used [rad/s].
        notes: Assumptions and doubts, one sentence each.
        diagnoses: Faults of clock and teeth of a steady cut.
    """

    cut: Cut
    engagement: EngagementColumns
    time: Float[np.ndarray, " row"]
    force: Float[np.ndarray, "row 3"]
    offset: float
    proposal: AxesProposal
    alignment: TimeAlignment | None
    spindle_speed: float
    notes: tuple[str, ...]
    diagnoses: tuple[Diagnosis, ...] = ()

    @classmethod
    def on_straight_cut(
        cls,
        sizes: StraightCut,
        time: Float[np.ndarray, " row"],
        force: Float[np.ndarray, "row 3"],
        *,
        refines_speed: bool = True,
        largest_feed: float | None = None,
        angle: Float[np.ndarray, " row"] | None = None,
    ) -> "RecordRegistration":
        """Register the steady part of a record on a straight cut.

        Args:
            sizes: Sizes of the cut, with its nominal spindle speed.
            time: Instants of the steady part [s], shape (row,).
            force: As recorded, without offset [N], shape (row, 3); NaN where not known.
            refines_speed: Whether the speed is taken from the record.
            largest_feed: See `StraightCut.cut`.
            angle: Measured spindle angle at each row [rad], increasing, or None: the
                clock of the cut then follows the spindle, and tooth 0 is at this
                angle.

        Returns:
            Its first 40 revolutions with the cut.

        Raises:
            ValueError: Sizes that no straight cut has, or less than three revolutions.
        """
        speed, flutes, notes = sizes.spindle_speed, sizes.cutter.flute_count, ()
        if angle is not None:
            speed = float(angle[-1] - angle[0]) / float(time[-1] - time[0])
            time = _spindle_clock(time, angle, speed)
        elif speed is None:
            raise ValueError(
                "Argument `sizes` must have a spindle speed, but has none."
            )
        elif refines_speed:
            repeated = _repeating_speed(speed, flutes, time, force)
            notes = _speed_notes(speed, repeated)
            speed = speed if _is_off(speed, repeated) else repeated
        turn = 2 * math.pi / speed
        turns = min(_TURNS, math.floor((float(time[-1] - time[0])) / turn + 1e-6))
        if turns < 3:
            raise ValueError(
                f"The record must have 3 revolutions of {turn:.4g} s, but lasts "
                f"{float(time[-1] - time[0]):.4g} s."
            )
        keep = time <= time[0] + turns * turn
        teeth = SETTLED + (turns + 2) * flutes + 1
        teeth = _ROUND * math.ceil(teeth / _ROUND)
        sizes = dataclasses.replace(sizes, spindle_speed=speed)
        cut = cut_of(sizes.cut(teeth=teeth, largest_feed=largest_feed))
        engagement = EngagementColumns.of_cut(cut)
        # A revolution of room, within which the fit looks for the shift.
        offset = turn + SETTLED * cut.tooth_period - float(time[0])
        if angle is not None:
            offset = _in_phase(offset, time, angle, speed)
        when, seen = time[keep] + offset, force[keep]
        proposal = _axes_proposal(engagement, when, seen, turn / 2, cut)
        diagnoses = (
            () if angle is not None else _diagnosed(time[keep], seen, speed, flutes)
        )
        return cls(
            cut,
            engagement,
            when,
            seen,
            offset,
            proposal,
            None,
            speed,
            notes,
            diagnoses,
        )

    @classmethod
    def on_job(
        cls,
        job: Job,
        time: Float[np.ndarray, " row"],
        force: Float[np.ndarray, "row 3"],
        *,
        time_shift: float | None = None,
        angle: Float[np.ndarray, " row"] | None = None,
        keeps_shift: bool = False,
    ) -> "RecordRegistration":
        """Set a record with the cut of a job.

        Args:
            job: The job; its desired path by a rigid machine.
            time: Instants of the record [s], shape (row,).
            force: As recorded, without offset [N], shape (row, 3); NaN where not known.
            time_shift: Time of the job minus time of the record [s]; found by the sizes
                of the forces if not given.
            angle: Measured spindle angle at each row [rad], increasing, or None: the
                clock of the record then follows the spindle, and tooth 0 is at this
                angle.
            keeps_shift: Whether the time shift is exact, and the zero of the angle is
                not.

        Returns:
            The record with the cut, samples out of the cut marked as not known.

        Raises:
            ValueError: The record does not overlap the cut.
            SimulationFailed: The cut could not be simulated.
        """
        cut = cut_of(job)
        engagement = EngagementColumns.of_cut(cut)
        law = job.law
        K = _USUAL
        if isinstance(law, LinearEdgeLaw):
            K = np.array([np.mean(np.asarray(getattr(law, name))) for name in NAMES])
        alignment = None
        turn = cut.tooth_period * cut.cutter.flute_count
        speed = 2 * math.pi / turn
        if angle is not None:
            time = _spindle_clock(time, angle, speed)
        if time_shift is None:
            alignment = align_in_time(engagement, K, time, force)
            time_shift = alignment.shift
        if angle is not None and not keeps_shift:
            time_shift = _in_phase(time_shift, time, angle, speed)
        when = time + time_shift
        # Samples at which the tool cuts within a revolution.
        size = np.linalg.norm(engagement.columns @ K + engagement.constant, axis=1)
        width = 2 * math.ceil(turn / engagement.spacing) + 1
        cuts = (size > _CUTTING_SHARE * size.max(initial=0.0)).astype(np.float64)
        is_cut = np.convolve(cuts, np.ones(width), mode="same") > 0.5
        place = (when - engagement.start) / engagement.spacing
        place = np.round(place).astype(np.int64)
        inside = (place >= 0) & (place < len(is_cut))
        inside &= is_cut[np.clip(place, 0, len(is_cut) - 1)]
        if inside.sum() < 12:
            raise ValueError(
                f"The record, {float(time[0]):g} to {float(time[-1]):g} s, has "
                f"{int(inside.sum())} samples while the job cuts: look at the time "
                "shift."
            )
        first, last = np.flatnonzero(inside)[[0, -1]]
        when = when[first : last + 1]
        seen = np.where(inside[:, None], force, np.nan)[first : last + 1]
        proposal = _axes_proposal(engagement, when, seen, turn / 2, cut)
        return cls(
            cut, engagement, when, seen, time_shift, proposal, alignment, speed, ()
        )


def _diagnosed(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
    spindle_speed: float,
    flute_count: int,
) -> tuple[Diagnosis, ...]:
    """Faults of clock and teeth by the phase and the harmonics of a steady cut."""
    force = force[:, np.isfinite(force).any(axis=0)]
    known = np.isfinite(force).all(axis=1)
    if known.sum() <= 16:
        return ()
    time, force = time[known], force[known]
    # Without the right teeth there is no phase to look at.
    return check_teeth(time, force, spindle_speed, flute_count) or check_clock(
        time, force, spindle_speed, flute_count
    )


def _spindle_clock(
    time: Float[np.ndarray, " row"],
    angle: Float[np.ndarray, " row"],
    speed: float,
) -> Float[np.ndarray, " row"]:
    """Clock on which the spindle turns evenly [s], shape (row,)."""
    return time[0] + (angle - angle[0]) / speed


def _in_phase(
    offset: float, time: np.ndarray, angle: np.ndarray, speed: float
) -> float:
    """Nearest offset of the clock with which tooth 0 is at the angle [s].

    It stands at zero when the clock of the cut does.
    """
    off = float(angle[0]) - speed * (float(time[0]) + offset)
    return offset + math.remainder(off, 2 * math.pi) / speed


def _repeating_speed(
    given: float,
    flute_count: int,
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
) -> float:
    """Spindle speed at which forces repeat [rad/s]; that given for few samples."""
    force = force[:, np.isfinite(force).any(axis=0)]
    known = np.isfinite(force).all(axis=1)
    if known.sum() <= 16:
        return given
    return refine_spindle_speed(
        time[known], force[known], given, flute_count=flute_count
    )


def _is_off(given: float, repeated: float) -> bool:
    """True if the forces repeat at a speed that the spindle cannot have."""
    return abs(repeated / given - 1) > _SPEED_OFF


def _speed_notes(given: float, repeated: float) -> tuple[str, ...]:
    """Sentence if the forces repeat at another speed than the given one."""
    change = repeated / given - 1
    rpm = repeated * 30 / math.pi
    if _is_off(given, repeated):
        return (
            f"The forces repeat at {rpm:.6g} rpm, {change:+.1%} "
            "off the speed given, which was kept: look at speed and number of teeth.",
        )
    if abs(change) > 1e-4:
        return (f"The forces repeat at {rpm:.6g} rpm ({change:+.2%}), which was used.",)
    return ()


def _axes_proposal(
    engagement: EngagementColumns,
    time: np.ndarray,
    force: np.ndarray,
    max_shift: float,
    cut: Cut,
) -> AxesProposal:
    """Assignments of the axes, from the forces on an even grid.

    What lies in a gap too long to be bridged becomes zero, measured and simulated.
    """
    is_measured = np.asarray(np.isfinite(force).any(axis=0))
    known = np.asarray(np.isfinite(force[:, is_measured]).all(axis=1))
    size = np.abs(np.nan_to_num(force)).max(axis=1)
    usual = max(float(np.quantile(size[known], _ALL_BUT)), 1e-300)
    known = np.flatnonzero(known & (size <= _SPIKE * usual))
    grid, seen, is_near = _on_grid(time[known], force[known], cut.tooth_period)
    count = int(is_near.sum())
    if count < _LEAST:
        raise ValueError(
            f"The record must have {_LEAST} samples with the cut that lie near each "
            f"other, but its gaps leave {count} of {known.size}."
        )
    columns = at_times(engagement.columns, engagement.start, engagement.spacing, grid)
    seen[:, ~is_measured] = np.nan
    spacing = float(grid[1] - grid[0])
    return propose_axes(
        np.where(np.logical_or.outer(is_near, ~is_measured), seen, 0.0),
        np.where(is_near[:, None, None], columns, 0.0),
        1 / spacing,
        # Four times the shift, in whole samples, must be shorter than the record.
        max_shift=min(max_shift, ((grid.size - 1) // 4) * spacing * (1 - 1e-9)),
        tooth_frequency=1 / cut.tooth_period,
        helix_angle=float(cut.cutter.helix_angle),
    )


def _on_grid(
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
    tooth_period: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Record at even instants, where it is densest.

    Samples may be lost or come at uneven instants: straight lines lie between those
    that are no further apart than two and a half usual steps.

    Returns:
        Instants [s], shape (sample,); forces [N], shape (sample, 3); and true where
        samples of the record lie near enough, shape (sample,).
    """
    step = float(np.median(np.diff(time)))
    # Not more samples than the angles have, or the shifts take long.
    spacing = step * max(1, int(tooth_period / (_PER_TOOTH * step)))
    count = int((time[-1] - time[0]) / spacing + 1e-6) + 1
    grid = time[0] + spacing * np.arange(count)
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    apart = time[after] - time[after - 1]
    is_near = apart <= max(_BRIDGED * step, tooth_period / _PER_TOOTH)
    if count > _JUDGED:
        near_count = np.cumsum(np.concatenate([[0], is_near]))
        first = int(np.argmax(near_count[_JUDGED:] - near_count[:-_JUDGED]))
        part = slice(first, first + _JUDGED)
        grid, after, apart, is_near = (
            grid[part],
            after[part],
            apart[part],
            is_near[part],
        )
    share = np.clip((grid - time[after - 1]) / apart, 0.0, 1.0)[:, None]
    seen = (1 - share) * force[after - 1] + share * force[after]
    return grid, np.nan_to_num(seen), is_near
