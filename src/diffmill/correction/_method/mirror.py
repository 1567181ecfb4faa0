"""Correction by mirroring the predicted deviation, once or again and again."""

import dataclasses
import operator
from collections.abc import Iterator
from itertools import product

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._types import FloatRows
from ...numerics import lowpass
from .._core.error_metrics import contour_statistics
from .._core.method import AbstractMethod, MethodResult, OnProgress, corrected
from .._core.problem import Motion, Problem
from .._spline.projection import clip_offset

# An iterate that changes the error by less than this fraction has settled.
_SETTLED_CHANGE = 1e-3
# Of two iterates that leave the same error the slower and earlier one is better.
_RANK = operator.attrgetter("error", "cutoff", "relaxation", "iterate")


class Mirror(AbstractMethod):
    """Subtract the predicted deviation from the command, once and unfiltered.

    The offset is clipped at `max_offset` of the problem, row by row and axis by axis.

    Attributes:
        before: Motion of the nominal command; found by a run if None.
    """

    before: Motion | None = None

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
    ) -> MethodResult:
        """Outcome of start - (actual - desired), clipped; tip commands only."""
        command = _start(problem, start)
        motion = self.before if start is None else None
        if motion is None:
            motion = problem.run(command)
        command = command - _deviation(problem, motion)
        command = clip_offset(problem.nominal, command, problem.max_offset)
        return corrected(problem, command, forward_runs=1)


class IteratedMirror(AbstractMethod):
    """Iterate the mirror with a low-pass and a relaxation; keep the best of a grid.

        c_(i+1) = clip(c_i - relaxation lowpass(actual_i - desired))

    The low-pass is a Butterworth filter run forward and backward, so that it has no
    phase and half the gain at the cut-off. Every pair of cut-off and relaxation is a
    branch, and the best iterate of all branches, the start included, by rms contour
    error over the rows that cut, is the result.

    A branch stops before its last iterate when its error is not finite, has grown
    twice in succession, has changed by less than 0.1 % twice in succession, or is on
    the way to end above the best of the branches before: its last relative change,
    repeated up to the last iterate, would not get there.

    With a sample the grid runs on that part of the path; only its best branch, or the
    slowest one where none helps, runs on the whole path.

    Attributes:
        cutoffs: Cut-off frequencies [Hz]; those above half the rate of the rows are
            left out.
        relaxations: Relaxations.
        iterations: Iterates of a branch at most.
        order: Order of one pass of the filter.
        before: Motion of the nominal command; found by a run if None.
        sample: Problem of a part of the path, from its beginning; None for the whole.
    """

    cutoffs: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
    relaxations: tuple[float, ...] = (0.3, 0.5, 1.0)
    iterations: int = 10
    order: int = 4
    before: Motion | None = None
    sample: Problem | None = None

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
    ) -> MethodResult:
        """Outcome of the best iterate of the grid; tip commands only."""
        if self.sample is not None:
            return self._with_branch_of(self.sample, problem, start, on_progress)
        command = _start(problem, start)
        motion = self.before if start is None else None
        if motion is None:
            motion = problem.run(command)
        error = contour_statistics(problem, problem.contour(motion)).rms
        start_error = error if np.isfinite(error) else np.inf
        best, runs = _Iterate(command, start_error, 0, 0.0, 0.0), 1
        deviation = _deviation(problem, motion)
        # A filter needs two rows per period.
        cutoffs_below_limit = [c for c in self.cutoffs if c < 0.5 / problem.time_step]
        # The highest cut-offs first: where they diverge they end soon, and if they do
        # not, they leave an error that the lower ones will not get below.
        grid = list(
            product(sorted(cutoffs_below_limit, reverse=True), self.relaxations)
        )
        # One branch after the other: two runs of one compiled program at the same time
        # can block each other in XLA's pool of threads.
        for done, (cutoff, relaxation) in enumerate(grid, start=1):
            first = _Iterate(command, start_error, 0, cutoff, relaxation)
            branch = list(_branch(self, problem, first, deviation, best.error))
            runs += len(branch)
            best = min(best, *branch, key=_RANK)
            if on_progress is not None:
                message = f"mirror: {done} of {len(grid)} branches, {runs} runs"
                if on_progress(message, best.error):
                    break
        detail = {
            "cutoff": best.cutoff,
            "relaxation": best.relaxation,
            "iterate": float(best.iterate),
            "runs_of_full_grid": float(1 + len(grid) * self.iterations),
        }
        return corrected(problem, best.command, forward_runs=runs, detail=detail)

    def _with_branch_of(
        self,
        sample: Problem,
        problem: Problem,
        start: FloatRows | None,
        on_progress: OnProgress | None,
    ) -> MethodResult:
        """Outcome of the branch that is best on a sample."""
        rows = sample.nominal.shape[0]
        part = None if start is None else start[:rows]
        grid = dataclasses.replace(self, sample=None, before=None)
        sampled = grid(sample, start=part, on_progress=on_progress)
        cutoff, relaxation = sampled.detail["cutoff"], sampled.detail["relaxation"]
        if cutoff == 0:
            cutoff, relaxation = min(self.cutoffs), min(self.relaxations)
        branch = dataclasses.replace(
            self, sample=None, cutoffs=(cutoff,), relaxations=(relaxation,)
        )
        result = branch(problem, start=start, on_progress=on_progress)
        runs = int(np.ceil(rows / problem.nominal.shape[0] * sampled.forward_runs))
        return dataclasses.replace(result, forward_runs=result.forward_runs + runs)


class _Iterate(eqx.Module):
    """A command of a branch of the grid.

    Attributes:
        command: The command, shape (step, 3).
        error: Root mean square contour error that it leaves [m].
        iterate: Its number, 0 for the start.
        cutoff: Cut-off frequency of the branch [Hz].
        relaxation: Relaxation of the branch [-].
    """

    command: np.ndarray
    error: float
    iterate: int
    cutoff: float
    relaxation: float


def _branch(
    method: IteratedMirror,
    problem: Problem,
    first: _Iterate,
    deviation: Float[np.ndarray, "step 3"],
    least_error: float,
) -> Iterator[_Iterate]:
    """Iterates of one branch after the first; one that is not finite ends it.

    Args:
        method: The grid.
        problem: The problem.
        first: Where the branch begins, with its cut-off and relaxation.
        deviation: Deviation that the first command leaves [m], shape (step, 3).
        least_error: Least error of the branches before [m].
    """
    cutoff, relaxation = first.cutoff, first.relaxation
    command, last = first.command, first.error
    grown = settled = 0
    for i in range(1, method.iterations + 1):
        step = lowpass(deviation, 1 / problem.time_step, cutoff, order=method.order)
        command = command - relaxation * step
        command = clip_offset(problem.nominal, command, problem.max_offset)
        motion = problem.run(command)
        deviation = _deviation(problem, motion)
        error = contour_statistics(problem, problem.contour(motion)).rms
        if not np.isfinite(error) or not np.all(np.isfinite(deviation)):
            yield _Iterate(command, np.inf, i, cutoff, relaxation)
            break
        yield _Iterate(command, error, i, cutoff, relaxation)
        grown = grown + 1 if error > last else 0
        settled = settled + 1 if abs(error - last) < _SETTLED_CHANGE * last else 0
        # At its present pace, is the branch still below the best at its last iterate?
        pace, last = error / last, error
        is_behind = i > 1 and error * pace ** (method.iterations - i) > least_error
        if grown == 2 or settled == 2 or is_behind:
            break


def _start(problem: Problem, start: FloatRows | None) -> np.ndarray:
    if problem.nominal.shape[1] != 3:
        raise ValueError(
            "Argument `problem` must command tip positions (3 axes) for a mirror, but "
            f"has {problem.nominal.shape[1]} axes."
        )
    command = problem.nominal if start is None else start
    return np.asarray(command, np.float64)


def _deviation(problem: Problem, motion: Motion) -> Float[np.ndarray, "step 3"]:
    actual = np.asarray(motion.actual, np.float64)
    return actual - np.asarray(problem.desired, np.float64)
