"""Correction of long paths: segment after segment, each with a look ahead.

A segment starts from the state in which the corrected part before it has left the
machine and the stock. Gauss-Newton corrects its rows by those coefficients of the
spline over the whole program that act on them; then the rows but for the overlap are
run with the command found, and the next segment starts there and optimises once more
what the overlap has seen. Coefficients that act on rows which have been run are held,
so that the command is as smooth over a seam as anywhere. A plant may follow rows ahead,
as a controller does on a clock that is late: then those behind what has been run are
held too. The cost is that of the whole path, restricted to the segment.

What lies behind the end of a segment stays as it was found before: in a first sweep, as
the start has it, which bends the end of the segment towards the start. A second sweep
over all segments begins where the first has ended, and takes most of that away. So a
sweep that another follows is the surroundings of the next, and takes half of the steps.

The contour error hardly sees how far the tool leads or lags, so that there are several
local minima at a sharp corner. A corner near the end of a segment is rounded for a tool
that must be back in time at once, which may be another of them than that of the whole
path, and the next segment would not leave it. In the first sweep the overlap therefore
begins anew, from the start, as it does for the whole path. Limits of velocity and
acceleration, and bounds of the surface, forbid that: what has been run and the start
need not fit together.

So the work is linear in the length of the path, and what must be in memory at once, the
linear system of one segment, does not depend on it.
"""

import dataclasses
import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, PyTree

from ..._result import RESULTS
from ..._types import FloatRows
from ...optimise import LeastSquaresStep, LevenbergMarquardt
from .._core.method import AbstractMethod, MethodResult, OnProgress, corrected
from .._core.problem import Problem
from .._method.checkpoint import Arrays, OnCheckpoint, pack, unpack
from .._method.gauss_newton import GaussNewton, check_bounds
from .._method.offset_fit import ContourResidual, fit_offsets, offset_fit
from .._spline.command_limits import LinearLimits, window_limits
from .._spline.projection import project
from .._spline.spline_offsets import CLAMPED, SplineOffsets, SplineWindow
from .._surface.segment_limits import (
    BoundedRows,
    cut_points,
    deepest_rows,
    keeps_bounds,
    window_bounds,
)
from .._surface.surface_limits import SurfaceBounds, refusal
from .plant_segment import AbstractPieces
from .receding_horizon_state import (
    HorizonRun,
    advance,
    command_at,
    part_of,
    rms_so_far,
)


class RecedingHorizon(AbstractMethod):
    """Gauss-Newton on segments of a path, for paths of any length.

    Attributes:
        pieces: The problem's plant, as one that can be run piece by piece.
        method: Settings of the correction of a segment; its steps are those of the last
            sweep, half of them those of the others.
        horizon: Rows of a segment.
        overlap: Rows of its end that the next segment corrects once more.
        sweeps: How often the whole path is gone through, each time from the command
            that the time before has found; a path of one segment, once.
    """

    pieces: AbstractPieces
    method: GaussNewton
    horizon: int = eqx.field(static=True)
    overlap: int = eqx.field(static=True)
    sweeps: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        if not 0 < self.overlap < self.horizon:
            raise ValueError(
                "Argument `overlap` must be above 0 and below `horizon` "
                f"({self.horizon} rows), but is {self.overlap} rows."
            )
        if self.sweeps < 1:
            raise ValueError(
                f"Argument `sweeps` must be at least 1, but is {self.sweeps}."
            )

    def segment_count(self, row_count: int) -> int:
        """Number of segments of a path of some rows, in one sweep."""
        return 1 + max(0, -(-(row_count - self.horizon) // self._hop))

    @property
    def _hop(self) -> int:
        return self.horizon - self.overlap

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
        on_checkpoint: OnCheckpoint | None = None,
        resume: Arrays | None = None,
    ) -> MethodResult:
        """Outcome of the best command within knots and bounds, from `start`.

        `on_progress` is called after every segment, with the rms contour error of the
        rows run so far; where it ends the method, later rows stay as in `start`.
        `on_checkpoint` is called then with the state, `resume` is the one from which
        to go on.

        Raises:
            InfeasibleLimit: The nominal command breaks a limit, or no correction of a
                segment keeps the bounds of the surface.
        """
        rows = problem.nominal.shape[0]
        spline = SplineOffsets(rows, problem.time_step, self.method.knot_spacing)
        run = self._first(problem, spline, start)
        if resume is not None:
            run = unpack(resume, run)
        total, seconds = sum(self._remaining_segments(rows, 0, 0)), []
        steps = [self._solver(rows, k).max_steps for k in range(self._sweeps(rows))]
        while run.row < rows:
            began, before = time.perf_counter(), run.row
            run = self._segment(problem, spline, run)
            # The last segment is not run by itself.
            counted = run.row if run.row < rows else before
            # A step costs alike in all sweeps.
            seconds.append((time.perf_counter() - began) / max(1, steps[run.sweep]))
            error = rms_so_far(problem, run, counted)
            counts = self._remaining_segments(rows, run.sweep, run.row)
            left, steps_left = sum(counts), np.dot(counts, steps[run.sweep :])
            if left and run.row >= rows:
                state = self._begun(problem, spline, run.coefficients)
                run = HorizonRun(
                    run.sweep + 1, 0, run.coefficients, state, 0.0, run.history
                )
            if on_checkpoint is not None:
                on_checkpoint(pack(run))
            if on_progress is not None:
                # The first one compiles, which the others do not.
                time_left = steps_left * np.mean(seconds[1:] or seconds)
                message = f"segment {total - left} of {total}, {time_left:.0f} s left"
                if on_progress(message, error):
                    break
        return self._corrected(problem, spline, run)

    def _remaining_segments(self, rows: int, sweep: int, row: int) -> list[int]:
        """Numbers of segments from a row on, of this sweep and of those after it."""
        now = self.segment_count(rows - row) if row < rows else 0
        return [now] + [self.segment_count(rows)] * (self._sweeps(rows) - 1 - sweep)

    def _solver(self, rows: int, sweep: int) -> LevenbergMarquardt:
        """Settings of a sweep: half of the steps if another follows."""
        solver = self.method.solver
        if sweep + 1 == self._sweeps(rows):
            return solver
        steps = min(max(1, solver.max_steps // 2), solver.max_steps)
        return dataclasses.replace(solver, max_steps=steps)

    def _sweeps(self, rows: int) -> int:
        """Number of sweeps over a path of some rows."""
        return self.sweeps if self.segment_count(rows) > 1 else 1

    def _first(
        self, problem: Problem, spline: SplineOffsets, start: FloatRows | None
    ) -> HorizonRun:
        """State before the first segment."""
        nominal = np.asarray(problem.nominal)
        free = np.zeros((spline.coefficient_count, nominal.shape[1]))
        if start is not None:
            limits = self._limits(problem, spline)
            away = np.asarray(start) - nominal
            free = project(spline, away, problem.max_offset, limits=limits)
        coefficients = np.pad(free, ((CLAMPED, CLAMPED), (0, 0)))
        state = self._begun(problem, spline, coefficients)
        return HorizonRun(0, 0, coefficients, state, 0.0, ())

    def _begun(
        self, problem: Problem, spline: SplineOffsets, coefficients: np.ndarray
    ) -> PyTree:
        """State at row 0, given three rows and those ahead."""
        count = 3 + self.pieces.preview_rows
        return self.pieces.begin(command_at(problem, spline, coefficients, 0, count))

    def _window(self, spline: SplineOffsets, row: int) -> SplineWindow:
        """Part of the spline that acts on the segment from a row on."""
        ahead = self.pieces.preview_rows
        return spline.window(row, self.horizon, preview_rows=ahead)

    def _limits(
        self, problem: Problem, spline: SplineOffsets
    ) -> tuple[LinearLimits, ...]:
        """Limits of the whole command."""
        return self.method.all_limits(spline, np.asarray(problem.nominal))

    def _segment(
        self, problem: Problem, spline: SplineOffsets, run: HorizonRun
    ) -> HorizonRun:
        """Correct the rows of one segment, and run them but for the overlap."""
        rows, row = problem.nominal.shape[0], run.row
        part = part_of(problem, self.pieces, run.state, row, self.horizon)
        bounds = self.method.bounds
        is_solved = bool(np.any(part.is_cutting > 0))
        if bounds is not None:
            is_solved |= bool(cut_points(bounds, row, row + self.horizon).any())
        if is_solved:
            run = self._solve(problem, part, spline, run)
        state = run.state
        if row == 0:
            # The start moves with the command, which has just been changed.
            state = self._begun(problem, spline, run.coefficients)
        if row + self.horizon >= rows:
            # The whole run that follows tells the error of these rows.
            return dataclasses.replace(run, row=rows, state=state)
        final = part_of(problem, self.pieces, state, row, self._hop + 1)
        count, window = self._hop + 1 + self.pieces.preview_rows, problem.window
        command = command_at(problem, spline, run.coefficients, row, count, window)
        state, square = advance(final, jnp.asarray(command))
        square, row = run.square + float(square), row + self._hop
        return dataclasses.replace(run, row=row, state=state, square=square)

    def _solve(
        self, problem: Problem, part: Problem, spline: SplineOffsets, run: HorizonRun
    ) -> HorizonRun:
        """Run with the coefficients of a segment corrected."""
        method, bound = self.method, float(problem.max_offset)
        limits = self._limits(problem, spline)
        dtype = np.asarray(problem.nominal).dtype
        window = self._window(spline, run.row)
        place = window.place()
        first = np.zeros((place.size, problem.nominal.shape[1]))
        is_there = place < len(run.coefficients)
        first[is_there] = run.coefficients[place[is_there]]
        is_free = np.asarray(window.is_free)[:, None]
        # Weighted alone, the rows of a segment would count for more than they do in
        # the whole path; the roughness has to grow with them.
        share = np.sum(part.is_cutting) / np.sum(np.asarray(problem.is_cutting))
        # Where nothing counts but what is held, as in a path that counts alike.
        share = share if share > 0 else self.horizon / len(np.asarray(problem.nominal))
        share *= (len(run.coefficients) - 2) / (place.size - 2)
        smoothness = method.smoothness / np.sqrt(share)
        own = window_limits(limits, run.coefficients, window)
        bounds = self._bounds(problem, run.row)
        args = ContourResidual(
            part,
            window.padded(problem.window),
            jnp.asarray(smoothness, dtype),
            jnp.asarray(method.lag_weight, dtype),
            method.objective,
            bounds,
        )
        fit = offset_fit(args, (part.plant,), limits=own)
        last = fit_offsets(
            fit,
            first,
            self._solver(problem.nominal.shape[0], run.sweep),
            lower=np.where(is_free, -bound, first).reshape(-1),
            upper=np.where(is_free, bound, first).reshape(-1),
        )
        if last is None:
            return dataclasses.replace(run, unsettled=run.unsettled + 1)
        new = run.coefficients.copy()
        x = np.asarray(fit.coefficients(last.x), np.float64)
        changed = np.asarray(window.is_free)
        new[place[changed]] = x[changed]
        if bounds is not None:
            check_bounds(bounds, fit, last, bound)
        if run.sweep == 0 and not limits and bounds is None:
            again = self._overlapping(spline, run.row)
            new[again] = run.coefficients[again]
        is_settled = last.has_converged and fit.is_within(last.value)
        return dataclasses.replace(
            run,
            coefficients=new,
            history=_following(run.history, last.history),
            unsettled=run.unsettled + (not is_settled),
        )

    def _bounds(self, problem: Problem, row: int) -> SurfaceBounds | None:
        """Bounds of the surface for the segment from a row on; None without any.

        Its last rows cannot be brought within, since what lies behind them stays: half
        of the overlap is left free.
        """
        bounds, rows = self.method.bounds, problem.nominal.shape[0]
        if bounds is None:
            return None
        count = self._hop + self.overlap // 2
        ends = {k: self._end(rows, k, count) for k in range(0, rows, self._hop)}
        most = max(int(cut_points(bounds, k, end).sum()) for k, end in ends.items())
        return window_bounds(
            bounds,
            deepest_rows(bounds, problem.desired),
            BoundedRows(row, self._end(rows, row, self._hop), ends[row]),
            shift=problem.window - row,
            count=most,
        )

    def _end(self, rows: int, row: int, count: int) -> int:
        """Row behind some of a segment, behind all if it is the last."""
        return rows if row + self.horizon >= rows else row + count

    def _overlapping(
        self, spline: SplineOffsets, row: int
    ) -> Int[np.ndarray, " coefficient"]:
        """Places of the coefficients that the next segment may change, (coefficient,).

        Args:
            spline: The basis.
            row: First row of this segment.
        """
        if row + self.horizon >= spline.step_count:
            return np.zeros(0, np.int32)
        window = self._window(spline, row + self._hop)
        place = window.place()[np.asarray(window.is_free)]
        return place[place < spline.coefficient_count + 2 * CLAMPED].astype(np.int32)

    def _corrected(
        self, problem: Problem, spline: SplineOffsets, run: HorizonRun
    ) -> MethodResult:
        """Outcome with a run of the whole plant."""
        rows = problem.nominal.shape[0]
        share = self.horizon / rows
        last = run.history[-1] if run.history else None
        dtype = np.asarray(problem.nominal).dtype
        offsets = np.abs(np.asarray(run.coefficients, dtype))
        at_bound = offsets >= np.asarray(problem.max_offset, dtype)
        outcome = corrected(
            problem,
            command_at(problem, spline, run.coefficients, 0, rows),
            forward_runs=0 if last is None else int(np.ceil(share * last.evaluations)),
            linearisations=0 if last is None else int(np.ceil(share * last.models)),
            history=run.history,
            detail={
                "knot_spacing": spline.actual_spacing,
                "unknowns": float(spline.coefficient_count * problem.nominal.shape[1]),
                "bound_count": float(np.sum(at_bound)),
                "segment_count": float(self.segment_count(rows)),
                "sweeps": float(self._sweeps(rows)),
                "horizon": float(self.horizon),
                "overlap": float(self.overlap),
                "smoothness": self.method.smoothness,
                "lag_weight": self.method.lag_weight,
                "unsettled_segments": float(run.unsettled),
            },
            result=RESULTS.not_converged if run.unsettled else RESULTS.successful,
        )
        if (bounds := self.method.bounds) is not None:
            errors = np.asarray(bounds.errors(outcome.motion), np.float64)
            if np.all(np.isfinite(errors)) and not keeps_bounds(bounds, errors):
                free = run.coefficients[CLAMPED:-CLAMPED]
                limits = self._limits(problem, spline)
                raise refusal(bounds, errors, free, float(problem.max_offset), limits)
        return outcome


def _following(
    before: tuple[LeastSquaresStep, ...], steps: tuple[LeastSquaresStep, ...]
) -> tuple[LeastSquaresStep, ...]:
    """Steps of earlier segments and of this one, whose costs are counted on."""
    if not before:
        return steps
    last = before[-1]
    return before + tuple(
        dataclasses.replace(
            step,
            evaluations=last.evaluations + step.evaluations,
            models=last.models + step.models,
            seconds=last.seconds + step.seconds,
        )
        for step in steps
    )
