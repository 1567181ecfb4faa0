"""Correction of long paths: segment after segment, each with a look ahead.

A segment starts from the state in which the corrected part before it has left the
machine and the stock. Gauss-Newton corrects its rows by those coefficients of the
spline over the whole program that act on them; then the rows but for the overlap are
run with the command found, and the next segment starts there and optimises once more
what the overlap has seen. Coefficients that act on rows which have been run are held,
so that the command is as smooth over a seam as anywhere. The cost is that of the whole
path, restricted to the segment.

What lies behind the end of a segment stays as it was found before: in a first sweep, as
the start has it, which bends the end of the segment towards the start. A second sweep
over all segments begins where the first has ended, and takes most of that away.

The contour error hardly sees how far the tool lags, so that there are several local
minima at a sharp corner, and a segment may find another of them than the whole path, at
any overlap. Started from the solution of the whole path, segments stay there.

So the work is linear in the length of the path, and what must be in memory at once, the
linear program of one segment, does not depend on it.
"""

import dataclasses
import time
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._bspline import CLAMPED, SplineOffsets
from ._gauss_newton import ContourResidual, GaussNewton, contour_residual
from ._least_squares import least_squares
from ._least_squares_records import LeastSquaresStep, following
from ._limits import LinearLimits, command_limits
from ._memory import (
    Arrays,
    OnCheckpoint,
    below,
    pack_history,
    pack_tree,
    under,
    unpack_history,
    unpack_tree,
)
from ._method import AbstractMethod, Corrected, OnProgress, corrected
from ._problem import FloatRows, Motion, Problem, contour_of
from ._projection import project
from ._response import banded_preconditioner
from ._segments import AbstractPiece, AbstractPieces
from ._spline_window import spline_window, window_limits


class _Run(eqx.Module):
    """What has been done up to the end of a segment.

    Attributes:
        sweep: How many sweeps have been finished before.
        row: First row that has not been run; the number of rows at the end.
        coefficients: Of the whole program, the clamped included.
        state: The plant's at that row.
        square: Sum of the weighted squares of the contour error so far [m^2].
        history: Steps of all segments so far.
    """

    sweep: int
    row: int
    coefficients: np.ndarray
    state: Any
    square: float
    history: tuple[LeastSquaresStep, ...]


class _Padded(eqx.Module):
    """A piece with still rows before and after it, which only the contour looks at."""

    piece: AbstractPiece
    reach: int = eqx.field(static=True)

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Return the motion, its first and last row repeated."""
        return self.run(command)[0]

    def run(self, command: Float[Array, "step axis"]) -> tuple[Motion, Any]:
        """Return the motion and the plant's state at the piece's last row."""
        motion, state = self.piece.run(command[self.reach : -self.reach])
        repeat = lambda x: jnp.pad(x, ((self.reach, self.reach), (0, 0)), mode="edge")
        return Motion(repeat(motion.actual), repeat(motion.force)), state


class RecedingHorizon(AbstractMethod):
    """Gauss-Newton on segments of a path, for paths of any length.

    Attributes:
        pieces: The problem's plant, as one that can be run piece by piece.
        method: Settings of the correction of a segment.
        horizon: Rows of a segment.
        overlap: Rows of its end that the next segment corrects once more.
        sweeps: How often the whole path is gone through, each time from the command
            that the time before has found; a path of one segment, once.
        on_checkpoint: Called after every segment with all that is needed to go on.
        resume: What it was called with, to go on from there.
    """

    pieces: AbstractPieces
    method: GaussNewton
    horizon: int = eqx.field(static=True)
    overlap: int = eqx.field(static=True)
    sweeps: int = eqx.field(static=True, default=2)
    on_checkpoint: OnCheckpoint | None = None
    resume: Arrays | None = None

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
        """Return the number of segments of a path of some rows, in one sweep."""
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
    ) -> Corrected:
        """Return the best command within knots and bounds, from `start`.

        `on_progress` is called after every segment, with the rms contour error of
        what has been run; where it ends the method, the rest stays as in `start`.
        """
        rows = problem.nominal.shape[0]
        spline = SplineOffsets(rows, problem.time_step, self.method.knot_spacing)
        run = self._first(problem, spline, start)
        total, seconds = self._left(rows, 0, 0), []
        while run.row < rows:
            began = time.perf_counter()
            run = self._segment(problem, spline, run)
            seconds.append(time.perf_counter() - began)
            error = _rms(problem, run)
            left = self._left(rows, run.sweep, run.row)
            if left and run.row >= rows:
                run = self._again(problem, spline, run)
            if self.on_checkpoint is not None:
                self.on_checkpoint(_packed(run))
            if on_progress is not None:
                # The first one compiles, which the others do not.
                each = float(np.mean(seconds[1:] or seconds))
                message = f"segment {total - left} of {total}, {left * each:.0f} s left"
                if on_progress(message, error):
                    break
        return self._corrected(problem, spline, run)

    def _left(self, rows: int, sweep: int, row: int) -> int:
        """Return the number of segments from a row on, of all sweeps."""
        each = self.segment_count(rows)
        sweeps = self.sweeps if each > 1 else 1
        now = self.segment_count(rows - row) if row < rows else 0
        return now + (sweeps - 1 - sweep) * each

    def _first(
        self, problem: Problem, spline: SplineOffsets, start: FloatRows | None
    ) -> _Run:
        """Return the state before the first segment, or that to resume."""
        nominal = np.asarray(problem.nominal)
        free = np.zeros((spline.coefficient_count, nominal.shape[1]))
        if start is not None:
            limits = self._limits(problem, spline)
            away = np.asarray(start) - nominal
            free = project(spline, away, problem.max_offset, limits=limits)
        coefficients = np.pad(free, ((CLAMPED, CLAMPED), (0, 0)))
        state = self.pieces.begin(_command(problem, spline, coefficients, 0, 2))
        run = _Run(0, 0, coefficients, state, 0.0, ())
        return _unpacked(self.resume, run) if self.resume else run

    def _again(self, problem: Problem, spline: SplineOffsets, run: _Run) -> _Run:
        """Return the state before the first segment of the next sweep."""
        command = _command(problem, spline, run.coefficients, 0, 2)
        state = self.pieces.begin(command)
        return _Run(run.sweep + 1, 0, run.coefficients, state, 0.0, run.history)

    def _limits(
        self, problem: Problem, spline: SplineOffsets
    ) -> tuple[LinearLimits, ...]:
        """Return the limits of the whole command."""
        return command_limits(
            spline,
            problem.nominal,
            max_velocity=self.method.max_velocity,
            max_acceleration=self.method.max_acceleration,
        )

    def _segment(self, problem: Problem, spline: SplineOffsets, run: _Run) -> _Run:
        """Correct the rows of one segment, and run them but for the overlap."""
        rows, row = problem.nominal.shape[0], run.row
        coefficients, history = run.coefficients, run.history
        part = _part(problem, self.pieces.piece, run.state, row, self.horizon)
        if np.any(part.is_cutting > 0):
            coefficients, history = self._solve(problem, part, spline, run)
        is_last = row + self.horizon >= rows
        count = rows - row if is_last else self._hop + 1
        state = run.state
        if row == 0:
            # The start moves with the command, which has just been changed.
            state = self.pieces.begin(_command(problem, spline, coefficients, 0, 2))
        if is_last:
            # The whole run that follows tells the error of these rows.
            return _Run(run.sweep, rows, coefficients, state, run.square, history)
        kept = _part(problem, self.pieces.piece, state, row, count)
        command = _command(problem, spline, coefficients, row, count, problem.window)
        state, square = _advance(kept, jnp.asarray(command))
        square, row = run.square + float(square), row + self._hop
        return _Run(run.sweep, row, coefficients, state, square, history)

    def _solve(
        self, problem: Problem, part: Problem, spline: SplineOffsets, run: _Run
    ) -> tuple[np.ndarray, tuple[LeastSquaresStep, ...]]:
        """Return the coefficients with those of a segment corrected, and the steps."""
        method, bound = self.method, float(problem.max_offset)
        dtype = np.asarray(problem.nominal).dtype
        window = spline_window(spline, run.row, self.horizon)
        place = window.place()
        first = np.zeros((place.size, problem.nominal.shape[1]))
        is_there = place < len(run.coefficients)
        first[is_there] = run.coefficients[place[is_there]]
        is_free = np.asarray(window.is_free)[:, None]
        # Weighted alone, the rows of a segment would count for more than they do in
        # the whole path; the roughness has to grow with them.
        share = np.sum(part.is_cutting) / np.sum(np.asarray(problem.is_cutting))
        share *= (len(run.coefficients) - 2) / (place.size - 2)
        smoothness = method.smoothness / np.sqrt(share)
        precondition = None
        if method.response is not None:
            precondition = banded_preconditioner(
                method.response, window, window.transposed, problem.time_step
            )
        solution = least_squares(
            contour_residual,
            jnp.asarray(first, dtype),
            ContourResidual(
                part,
                window.padded(problem.window),
                jnp.asarray(smoothness, dtype),
                jnp.asarray(method.lag_weight, dtype),
                method.objective,
            ),
            lower=np.where(is_free, -bound, first),
            upper=np.where(is_free, bound, first),
            scale=bound,
            solver=method.solver,
            precondition=precondition,
            limits=window_limits(
                self._limits(problem, spline), run.coefficients, window
            ),
        )
        new = run.coefficients.copy()
        found = np.asarray(solution.x, np.float64)
        changed = place[np.asarray(window.is_free)]
        new[changed] = found[np.asarray(window.is_free)]
        return new, following(run.history, solution.history)

    def _corrected(
        self, problem: Problem, spline: SplineOffsets, run: _Run
    ) -> Corrected:
        """Run the whole plant with the command found."""
        rows = problem.nominal.shape[0]
        share = self.horizon / rows
        last = run.history[-1] if run.history else None
        return corrected(
            problem,
            _command(problem, spline, run.coefficients, 0, rows),
            forward_runs=0 if last is None else int(np.ceil(share * last.forward_runs)),
            products=0 if last is None else int(np.ceil(share * last.products)),
            history=run.history,
            detail={
                "knot_spacing": spline.actual_spacing,
                "unknowns": float(spline.coefficient_count * problem.nominal.shape[1]),
                "segment_count": float(self.segment_count(rows)),
                "sweeps": float(self.sweeps),
                "horizon": float(self.horizon),
                "overlap": float(self.overlap),
                "smoothness": self.method.smoothness,
                "lag_weight": self.method.lag_weight,
            },
        )


@eqx.filter_jit
def _advance(
    part: Problem, command: Float[Array, "step axis"]
) -> tuple[Any, Float[Array, ""]]:
    """Return the state at a piece's last row, and its sum of squared errors.

    The last row belongs to the piece after.
    """
    padded: Any = part.plant
    motion, state = padded.run(command)
    weights = jnp.asarray(part.is_cutting, command.dtype)
    weights = weights.at[-1 - part.window].set(0)
    square = jnp.sum(contour_of(part, motion) ** 2, axis=1)
    return state, jnp.sum(jnp.where(weights > 0, weights * square, 0))


def _part(problem: Problem, piece: Any, state: Any, row: int, count: int) -> Problem:
    """Return the problem of some rows, with more around them that do not count."""
    rows, reach = problem.nominal.shape[0], problem.window
    inner = np.arange(row, row + count)
    around = np.clip(np.arange(row - reach, row + count + reach), 0, rows - 1)
    weights = np.asarray(problem.is_cutting)[np.minimum(inner, rows - 1)]
    weights = np.pad(np.where(inner < rows, weights, 0), reach)
    plant = _Padded(piece(state, np.minimum(inner, rows - 1)), reach)
    return dataclasses.replace(
        problem,
        plant=plant,
        nominal=np.asarray(problem.nominal)[around],
        desired=np.asarray(problem.desired)[around],
        is_cutting=weights,
    )


def _command(
    problem: Problem,
    spline: SplineOffsets,
    coefficients: np.ndarray,
    row: int,
    count: int,
    reach: int = 0,
) -> Float[Array, "step axis"]:
    """Return the command at some rows, and at some more around them."""
    nominal = np.asarray(problem.nominal)
    offsets = spline.offsets(jnp.asarray(coefficients[CLAMPED:-CLAMPED], nominal.dtype))
    command = nominal + np.asarray(offsets)
    at = np.clip(np.arange(row - reach, row + count + reach), 0, len(nominal) - 1)
    return jnp.asarray(command[at])


def _rms(problem: Problem, run: _Run) -> float:
    """Return the rms contour error of the rows that have been run [m]."""
    weight = float(np.sum(np.asarray(problem.is_cutting)[: run.row]))
    return float(np.sqrt(run.square / weight)) if weight > 0 else 0.0


def _packed(run: _Run) -> dict[str, np.ndarray]:
    return {
        "sweep": np.asarray(run.sweep),
        "row": np.asarray(run.row),
        "coefficients": run.coefficients,
        "square": np.asarray(run.square),
        "history": pack_history(run.history),
        **under("state", pack_tree(run.state)),
    }


def _unpacked(arrays: Arrays, like: _Run) -> _Run:
    return _Run(
        int(arrays["sweep"]),
        int(arrays["row"]),
        np.asarray(arrays["coefficients"]),
        unpack_tree(below("state", arrays), like.state),
        float(arrays["square"]),
        unpack_history(arrays["history"]),
    )
