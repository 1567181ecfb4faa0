"""From measured parts to the next command."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._job import Job
from .._types import FloatRows3
from ..correction import Correction, correct
from ..process import FrozenStock
from ..sim import Solution, rigid_cut
from ._measurement import Part, wall_times
from ._parameters import AdaptableMachine, MachinePrior, Rows3
from ._posterior import (
    Linearised,
    Processes,
    Stacked,
    chosen_prior,
    processes,
    whitened,
)

# Logarithm of how much more likely parameters and process must make what was seen to
# be taken: below it a model that is right would be spoilt by noise.
_LEAST_GAIN = 3.0
_FIRST_STEPS, _LATER_STEPS = 2, 1
OnProgress = Callable[[str], None]


class LearnedMachine(eqx.Module):
    """Machine as parts that were cut show it.

    Attributes:
        job: The job with the machine as it was learnt, and what no parameter explains
            as the disturbance of its path: `simulate` predicts the next part with it,
            `correct` corrects its program.
        parameters: In units of their priors, shape (parameter,).
        covariance: Of these, shape (parameter, parameter).
        names: Of the parameters.
        sizes: Standard deviations of the priors, shape (parameter,).
        disturbance: Mean of what no parameter explains [m], shape (step, 3).
        uncertainty: Its standard deviation [m], shape (step, 3).
        gain: How much more likely parameters and process make what was measured,
            logarithm; what is less than 3 is not taken.
        correction: The next command, corrected from the best one so far; None if it
            was not asked for.
        machine: The machine as a function of its parameters.
    """

    job: Job
    parameters: Float[np.ndarray, " parameter"]
    covariance: Float[np.ndarray, "parameter parameter"]
    names: tuple[str, ...] = eqx.field(static=True)
    sizes: Float[np.ndarray, " parameter"]
    disturbance: Rows3
    uncertainty: Rows3
    gain: float
    machine: AdaptableMachine
    correction: Correction | None = None

    @property
    def commanded(self) -> Rows3:
        """The next command [m], shape (step, 3).

        Raises:
            ValueError: None was asked for.
        """
        if self.correction is None:
            raise ValueError("No command was asked for: `corrects` was False.")
        return np.asarray(self.correction.commanded)


def learn(
    job: Job,
    parts: Sequence[Part],
    *,
    prior: MachinePrior | None = None,
    corrects: bool = True,
    max_steps: int = 3,
    known: LearnedMachine | None = None,
    on_progress: OnProgress | None = None,
) -> LearnedMachine:
    """Learn from parts that were cut, and correct the program for the next one.

    Args:
        job: The job; its machine must have a robot.
        parts: Parts of this program, in the order in which they were cut.
        prior: Sizes of what may be wrong; the default's if not given.
        corrects: Whether the program is corrected, too.
        max_steps: Steps of its optimiser at most.
        known: What was learnt from the parts before, to begin there.
        on_progress: Called with a message.

    Returns:
        The machine, and the next command.

    Raises:
        ValueError: There is no part, no robot, or a measurement does not suit the path.
        SimulationFailed: A run fails.

    Differentiability: runs on the host, not traceable.
    """
    tell = on_progress or (lambda message: None)
    job = job.with_precision()
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but has none.")
    if not parts:
        raise ValueError("Argument `parts` must have a part, but is empty.")
    machine = AdaptableMachine.of_job(job, prior or MachinePrior())
    search = _Search(job, machine, tuple(parts))
    x = np.zeros(machine.count) if known is None else known.parameters
    for _ in range(_FIRST_STEPS if known is None else _LATER_STEPS):
        tell("what the machine does beyond its model")
        system = search.linearised(x)
        if system.gain < _LEAST_GAIN:
            tell("the parts show nothing that the model does not know")
            break
        x = search.step(x, system)
    found = search.outcome(x, system)
    if not corrects:
        return found
    tell("next command")
    best = min(search.commands, key=lambda u: search.expected_error(found, u))
    # The corrected command holds for the machine as it is known now.
    settings = dataclasses.replace(found.job.correction, max_steps=max_steps)
    asked = dataclasses.replace(found.job, correction=settings)
    correction = correct(asked, start=best, throw=False)
    return dataclasses.replace(found, correction=correction)


class _Search:
    """Gauss-Newton on the parameters of a machine, the process integrated out.

    Attributes:
        set_up: What the set-ups of the measurements leave open, of one part after the
            other, in units of its priors, shape (nuisance,).
    """

    def __init__(self, job: Job, machine: AdaptableMachine, parts: tuple[Part, ...]):
        self.job, self.machine = job, machine
        self.commands = [np.asarray(part.commanded) for part in parts]
        self.rigid = rigid_cut(machine.base, FrozenStock())
        program = jnp.asarray(job.path.positions)
        self.model = Solution.of_command(
            machine.base, self.rigid, program, FrozenStock()
        )
        self.seen = tuple(part.measured.seen(job, self.model) for part in parts)
        self.weights = np.ones(len(parts))
        self.free = np.flatnonzero(machine.is_free)
        self.set_up = np.zeros(sum(s.nuisance.shape[1] for s in self.seen))

    def predicted(self, x: np.ndarray, command: FloatRows3) -> Rows3:
        """Deviation of the tip at the wall instants with some parameters [m]."""
        adapted = self.machine.job_at(x)
        run = Solution.of_command(
            adapted, self.rigid, jnp.asarray(command), FrozenStock()
        )
        run.raise_unless_successful(adapted)
        desired = np.asarray(self.job.path.positions)
        return np.asarray(run.surface_deviation) + self.machine.field(x, desired)

    def residuals(self, x: np.ndarray) -> list[np.ndarray]:
        """Deviation of each part beyond the machine and the set-ups [m]."""
        found, first = [], 0
        for seen, command in zip(self.seen, self.commands, strict=True):
            last = first + seen.nuisance.shape[1]
            known = seen.of_rows(self.predicted(x, command))
            known = known + seen.nuisance @ self.set_up[first:last]
            found.append(seen.value - known)
            first = last
        return found

    def weigh(self, residuals: list[np.ndarray]) -> Stacked:
        """Observations in which older parts count less by what changed since."""
        last = residuals[-1]
        for k, own in enumerate(residuals[:-1]):
            if own.shape == last.shape:
                noise = float(np.mean(self.seen[k].variance))
                drift = max(0.0, float(np.mean((own - last) ** 2)) - 2 * noise)
                self.weights[k] = noise / (noise + drift)
        return Stacked.of(self.seen, self.weights)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Columns of all observations in the parameters; of the last command."""
        columns = self.machine.columns(x, self.rigid, self.commands[-1])
        return np.concatenate([seen.of_rows(columns) for seen in self.seen])

    def nuisance(self) -> np.ndarray:
        """Columns of what the set-ups leave open, of one part after the other."""
        from scipy.linalg import block_diag

        blocks = np.asarray(block_diag(*(seen.nuisance for seen in self.seen)))
        return blocks.reshape(sum(len(seen.value) for seen in self.seen), -1)

    def linearised(self, x: np.ndarray) -> Linearised:
        """Whitened columns and residuals about some parameters, and their prior."""
        residuals = self.residuals(x)
        stacked = self.weigh(residuals)
        residual = np.concatenate(residuals)
        found = processes(stacked, residual)
        columns = [residual[:, None], self.slopes(x)[:, self.free], self.nuisance()]
        white = whitened(stacked, found, np.concatenate(columns, axis=1))
        r, M = white[:, 0], white[:, 1:]
        at = np.r_[x[self.free], self.set_up]
        prior = chosen_prior(self.machine, self.free, M, r + M @ at)
        return Linearised(at, M, r, prior, prior.gain + found.gain)

    def step(self, x: np.ndarray, system: Linearised) -> np.ndarray:
        """Parameters after a Gauss-Newton step, which also takes the set-ups."""
        count = len(self.free)
        no_bound = np.full(len(self.set_up), -np.inf)
        found = system.solved(np.r_[self.machine.lower[self.free], no_bound])
        x = x.copy()
        x[self.free], self.set_up = found[:count], found[count:]
        return x

    def outcome(self, x: np.ndarray, system: Linearised) -> LearnedMachine:
        """Machine that was learnt, with some parameters.

        Args:
            x: The parameters.
            system: The last one, whose covariance holds.
        """
        residuals = self.residuals(x)
        stacked, residual = self.weigh(residuals), np.concatenate(residuals)
        mean, deviation = self._disturbance(
            stacked, processes(stacked, residual), residual
        )
        if system.gain < _LEAST_GAIN:
            mean = np.zeros_like(mean)
        count = len(self.free)
        covariance = np.zeros((self.machine.count, self.machine.count))
        covariance[np.ix_(self.free, self.free)] = system.covariance()[:count, :count]
        desired = np.asarray(self.job.path.positions)
        adapted = self.machine.job_at(x)
        path = dataclasses.replace(
            adapted.path, disturbance=mean + self.machine.field(x, desired)
        )
        return LearnedMachine(
            job=dataclasses.replace(adapted, path=path),
            parameters=x,
            covariance=covariance,
            names=self.machine.names,
            sizes=self.machine.sizes,
            disturbance=mean,
            uncertainty=deviation,
            gain=system.gain,
            machine=self.machine,
        )

    def _disturbance(
        self, stacked: Stacked, found: Processes, residual: np.ndarray
    ) -> tuple[Rows3, Rows3]:
        """Posterior mean and deviation of the process at the wall instants [m]."""
        times = wall_times(self.model)
        mean, variance = np.zeros((len(times), 3)), np.zeros((len(times), 3))
        for process, chosen in zip(found.process, found.chosen, strict=True):
            seen = stacked.observations(chosen)
            m, s = process.smoothed(seen, stacked.rows(residual, chosen), times)
            mean, variance = mean + np.asarray(m), variance + np.asarray(s) ** 2
        return mean, np.sqrt(variance)

    def expected_error(self, found: LearnedMachine, command: FloatRows3) -> float:
        """Contour error that a command is expected to leave, where it cuts [m rms]."""
        run = Solution.of_command(
            found.job, self.rigid, jnp.asarray(command), FrozenStock()
        )
        return run.contour.rms
