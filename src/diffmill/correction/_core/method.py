"""The interface of all methods of correction, and what they report."""

import abc
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._result import RESULTS
from ..._types import FloatRows
from ...optimise import LeastSquaresStep
from ...toolpath import ContourStatistics
from .error_metrics import CommandStatistics, contour_statistics
from .problem import Motion, Problem

# Called now and then with a message and a measure of the error; True ends the run.
OnProgress = Callable[[str, float], bool | None]


class MethodResult(eqx.Module):
    """The outcome of one method.

    Attributes:
        command: The corrected command, whole, shape (step, axis).
        motion: Motion of the plant that follows it.
        contour: Contour vectors [m], shape (step, 3).
        measures: Contour error, by the weights of the rows; NaN where it is not finite.
        command_statistics: Acceleration and offset of the command.
        forward_runs: Runs of the plant that the method needed, this last included.
        linearisations: Runs with their linear system, or with a gradient.
        history: Steps of the optimiser; empty for methods without one.
        detail: Settings that the method itself chose, for the report.
        result: Outcome.
    """

    command: FloatRows
    motion: Motion
    contour: Float[np.ndarray, "step 3"]
    measures: ContourStatistics
    command_statistics: CommandStatistics
    forward_runs: int
    linearisations: int
    history: tuple[LeastSquaresStep, ...]
    detail: dict[str, float]
    result: RESULTS


class AbstractMethod(eqx.Module):
    """A way to find a better command; holds settings only."""

    @abc.abstractmethod
    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
    ) -> MethodResult:
        """Outcome of the method, always with a run of the plant on the final command.

        Args:
            problem: The problem.
            start: Command from which to start, for methods that improve one; None
                for the nominal one.
            on_progress: Called with a message and the rms contour error so far [m];
                True ends the method with the best so far.
        """


class GivenCommand(AbstractMethod):
    """Evaluate a command that was found elsewhere, or the nominal one.

    Attributes:
        command: The command, shape (step, axis); None for the nominal one.
        motion: Motion of the plant that follows it; found by a run if None.
    """

    command: FloatRows | None = None
    motion: Motion | None = None

    def __call__(
        self,
        problem: Problem,
        *,
        start: FloatRows | None = None,
        on_progress: OnProgress | None = None,
    ) -> MethodResult:
        """Outcome of the command; `start` is not used."""
        command = problem.nominal if self.command is None else self.command
        runs = 0 if self.motion is None else 1
        return corrected(problem, command, motion=self.motion, forward_runs=runs)


def corrected(
    problem: Problem,
    command: FloatRows,
    *,
    motion: Motion | None = None,
    forward_runs: int = 0,
    linearisations: int = 0,
    history: tuple[LeastSquaresStep, ...] = (),
    detail: dict[str, float] | None = None,
    result: RESULTS = RESULTS.successful,
) -> MethodResult:
    """Outcome of a method, with a run of the plant unless its motion is given.

    Args:
        problem: The problem.
        command: The final command, shape (step, axis).
        motion: Its motion, if known.
        forward_runs: Runs of the plant so far.
        linearisations: Runs with their linear system so far.
        history: Steps of the optimiser.
        detail: Settings that the method chose.
        result: Outcome so far; a motion that is not finite overrides it.

    **Differentiability**: runs on the host, not traceable.
    """
    if motion is None:
        motion = problem.run(command)
        forward_runs += 1
    contour = np.asarray(problem.contour(motion), np.float64)
    if not np.any(np.asarray(problem.is_cutting) > 0):
        raise ValueError("Argument `is_cutting` must mark a row, but marks none.")
    measures = contour_statistics(problem, contour)
    return MethodResult(
        command=command,
        motion=motion,
        contour=contour,
        measures=measures,
        command_statistics=CommandStatistics.of(problem, command),
        forward_runs=forward_runs,
        linearisations=linearisations,
        history=history,
        detail={} if detail is None else detail,
        result=result if np.isfinite(measures.rms) else RESULTS.non_finite,
    )
