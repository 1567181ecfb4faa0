"""The next command of a machine as parts have shown it."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._arrays import Arrays
from .._job import Job
from .._types import FloatRows3
from ..correction import Correction, correct
from ..numerics import lowpass
from ..process import FrozenStock
from ..sim import Run, Solution
from ._parameters import Rows3
from ._state import LearningState

# Of the mirror on the machine as it was learnt: cut-off frequencies [Hz], one after the
# other, share of the deviation that a turn takes off, turns at most.
_CUTOFFS, _RELAXATION, _MIRRORS = (6.0, 3.0), 0.7, 12
# Share of the step that has failed, to which the next one from the same command is cut.
_SHORTER = 0.5
# By how much a part must be worse than an earlier one to have failed [-].
_WORSE = 1.02


class CommandSearch(eqx.Module):
    """Search for a command on the machine as it was learnt.

    Attributes:
        job: The job on that machine.
        rigid: Rigid cut of the program.
        commands: Commands that cut the parts, in their order [m], each (step, 3).
        errors: Contour errors that they leave on it, where it cuts [m rms].
    """

    job: Job
    rigid: Run
    commands: tuple[Rows3, ...]
    errors: tuple[float, ...]

    @property
    def best(self) -> Rows3:
        """The best of the commands that were cut."""
        return self.commands[int(np.argmin(self.errors))]

    @property
    def radius(self) -> float:
        """Largest distance of the next command from the best one [m rms].

        Half of that of the last one where it was worse than the best; else infinite.
        """
        if self.errors[-1] <= _WORSE * min(self.errors):
            return np.inf
        return _SHORTER * _distance(self.commands[-1], self.best)

    def search(
        self,
        max_steps: int,
        state: LearningState,
        on_state: Callable[[LearningState], None],
        on_progress: Callable[[str, float], None],
    ) -> Correction:
        """The next command, by turns of a mirror and of Gauss-Newton.

        Gauss-Newton stands still before joints that stick or float in a gap: the mirror
        brings them through, and diverges where Gauss-Newton is good.

        Args:
            max_steps: Steps of Gauss-Newton at most.
            state: From which the search goes on.
            on_state: Called with the state before each step.
            on_progress: Called with a message of the stage, and the share of it that
                is done.
        """
        first = (max_steps + 1) // 2
        # Steps of Gauss-Newton in each stage; None for the mirror.
        stages = [
            stage for n in (first, max_steps - first) if n > 0 for stage in (None, n)
        ]
        command = state.command if len(state.command) else self.best
        correction, resumed = None, state.correction
        for number in range(state.stage, len(stages)):
            at = dataclasses.replace(
                state, stage=number, command=np.asarray(command), correction={}
            )
            if number > state.stage:
                on_state(at)
            steps = stages[number]
            if steps is None:
                command = self._mirrored(command, on_progress)
            else:
                correction = self._corrected(
                    command, steps, at, on_state, on_progress, resumed
                )
                command, resumed = np.asarray(correction.commanded), {}
        assert correction is not None
        far = _distance(command, self.best)
        if far <= self.radius:
            return correction
        on_progress(
            "next command: shorter, since the last one was worse than one before", 0.0
        )
        share = self.radius / far
        shorter = (1 - share) * self.best + share * np.asarray(command)
        return self._corrected(shorter, 0, state, lambda state: None, on_progress, {})

    def _corrected(
        self,
        start: Rows3,
        steps: int,
        state: LearningState,
        on_state: Callable[[LearningState], None],
        on_progress: Callable[[str, float], None],
        resumed: Arrays,
    ) -> Correction:
        """Correction from a command, by some steps of Gauss-Newton."""
        tell = lambda message, share: on_progress(f"next command: {message}", share)

        def tell_error(message: str, rms: float) -> None:
            tell(f"{message} done, weighted error {1e6 * rms:.2f} um rms", 0.0)

        # The corrected command holds for the machine as it is known now.
        settings = dataclasses.replace(self.job.correction, max_steps=steps)
        return correct(
            dataclasses.replace(self.job, correction=settings),
            start=start,
            throw=False,
            on_progress=tell_error,
            on_run_progress=tell,
            on_step_progress=tell,
            on_checkpoint=lambda arrays: on_state(
                dataclasses.replace(state, correction=arrays)
            ),
            resume=resumed or None,
        )

    def _mirrored(
        self, command: FloatRows3, on_progress: Callable[[str, float], None]
    ) -> Rows3:
        """Command of the least error that a filtered mirror finds, itself included."""
        job, program = self.job, np.asarray(self.job.path.positions)
        reach, rate = float(job.correction.max_offset), 1 / float(job.tooth_period)
        best, least = np.asarray(command), np.inf
        for number, cutoff in enumerate(_CUTOFFS):
            command, worse = best, 0
            for turn in range(_MIRRORS):
                done = number * _MIRRORS + turn
                on_progress("next command: mirror", done / (len(_CUTOFFS) * _MIRRORS))
                run = Solution.of_command(
                    job, self.rigid, jnp.asarray(command), FrozenStock()
                )
                error, deviation = run.contour.rms, np.asarray(run.surface_deviation)
                worse = 0 if error < least else worse + 1
                if error < least:
                    best, least = command, error
                if worse == 2 or not np.all(np.isfinite(deviation)):
                    break
                step = _RELAXATION * lowpass(deviation, rate, cutoff)
                command = np.clip(command - step, program - reach, program + reach)
        return best


def _distance(one: FloatRows3, other: FloatRows3) -> float:
    """Distance of two commands [m rms]."""
    away = np.asarray(one, np.float64) - np.asarray(other, np.float64)
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
