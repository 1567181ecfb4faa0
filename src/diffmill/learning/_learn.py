"""From measured parts to the next command."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._arrays import Arrays
from .._job import Job
from ..correction import Correction
from ..process import FrozenStock
from ..sim import Run, Solution, rigid_cut
from ._machine_posterior import MachinePosterior, normal_variance
from ._measurement import (
    AbstractMeasurement,
    MeasuredForces,
    Observables,
    Observed,
    Part,
    wall_normals,
    wall_times,
)
from ._next_command import CommandSearch
from ._parameters import GROUPS, AdaptableMachine, MachinePrior, Rows3
from ._posterior import (
    Linearised,
    Prior,
    Processes,
    SetUp,
    Stacked,
    Unknowns,
    chosen_prior,
    known_prior,
    processes,
)
from ._state import LearningState, OnCheckpoint

# Logarithm of how much more likely parameters and process must make what was seen to
# be taken: below it a model that is right would be spoilt by noise.
LEAST_GAIN = 3.0
# Variance, in units of the priors, that keeps what is known already regular.
_LEAST_VARIANCE = 1e-8
_FIRST_STEPS, _LATER_STEPS = 3, 1
# Groups of parameters that do not change what drives and forces do.
_BESIDES_MACHINE = ("radius", "field")
OnProgress = Callable[[str, float], None]


class ExplainedError(NamedTuple):
    """Errors that a measurement shows beyond some predictions, rms.

    Attributes:
        part: Number of the part, from 1.
        observed: What was seen: "tip", "wall", "arm" or "force".
        beyond_model: Beyond the model [m or N].
        beyond_machine: Beyond the machine that was learnt.
        beyond_process: Beyond this and what no parameter explains; of forces as before.
        noise: The instrument's noise.
    """

    part: int
    observed: Observed
    beyond_model: float
    beyond_machine: float
    beyond_process: float
    noise: float


class LearntValue(NamedTuple):
    """A parameter as parts have shown it.

    Attributes:
        name: Its name.
        value: Value; of stiffness, damping, forces and servos the logarithm of their
            factor.
        error: Standard error.
        size: Standard deviation before.
        unit: Unit of all three; "1" for a logarithm.
    """

    name: str
    value: float
    error: float
    size: float
    unit: str

    @property
    def open_share(self) -> float:
        """Share of the variance before that is left."""
        return (self.error / self.size) ** 2


class LearnedMachine(eqx.Module):
    """Machine as parts that were cut show it.

    Attributes:
        job: The job with the machine as it was learnt, and what no parameter explains
            as the disturbance of its path: `simulate` predicts the next part with it,
            `correct` corrects its program.
        posterior: The parameters, and what none of them explains.
        gain: How much more likely parameters and process make what was measured,
            logarithm; what is less than 3 is not taken.
        explained: What of each measurement is explained.
        columns: Slopes of the walls in the parameters about the last command, as of the
            tip that stands in for them [m], shape (step, 3, parameter).
        machine: The machine as a function of its parameters.
        rigid: Rigid cut of the program.
        part_errors: Contour error of the commands that cut the parts, on the machine as
            it was learnt [m rms].
        correction: The next command, corrected from the best one so far; None if it
            was not asked for.
        Value: A parameter, as `values` tells it.
    """

    job: Job
    posterior: MachinePosterior
    gain: float
    explained: tuple[ExplainedError, ...] = eqx.field(static=True)
    columns: Float[np.ndarray, "step 3 parameter"]
    machine: AdaptableMachine
    rigid: Run
    part_errors: tuple[float, ...] = eqx.field(static=True)
    correction: Correction | None = None

    Value = LearntValue

    @property
    def is_known_better(self) -> bool:
        """True if the parts show what the model does not know."""
        return self.gain >= LEAST_GAIN

    @property
    def commanded(self) -> Rows3:
        """The next command [m], shape (step, 3).

        Raises:
            ValueError: None was asked for.
        """
        if self.correction is None:
            raise ValueError("No command was asked for: `max_steps` was 0.")
        return np.asarray(self.correction.commanded)

    def values(self) -> tuple[LearntValue, ...]:
        """Parameters that may be wrong, as parts have shown them."""
        known, found = self.posterior, []
        error = (known.sizes * np.sqrt(np.diagonal(known.covariance))).tolist()
        for group in self.machine.groups:
            units = self.machine.units(group.name)
            for k, unit in zip(group.index, units, strict=True):
                if known.sizes[k] > 0:
                    size = float(known.sizes[k])
                    value = size * float(known.mean[k])
                    own = LearntValue(known.names[k], value, error[k], size, unit)
                    found.append(own)
        return tuple(found)

    def causes(self) -> dict[str, float]:
        """Error of the last command across the path by cause, where it cuts [m rms]."""
        is_cutting = np.any(np.asarray(self.rigid.force) != 0, axis=1)
        desired, mean = self.posterior.desired, self.posterior.mean
        parts = {
            group.name: self.columns[:, :, group.index] @ mean[group.index]
            for group in self.machine.groups
            if self.machine.is_free[group.index].any()
        }
        parts["process"] = self.posterior.disturbance
        across = lambda rows: normal_variance(rows[:, :, None] * rows[:, None], desired)
        return {
            name: float(np.sqrt(np.mean(across(rows)[is_cutting])))
            for name, rows in parts.items()
        }

    def spread(self) -> Float[np.ndarray, " step"]:
        """Standard deviation of the tip across the path, of what is not known [m].

        Of parameters and of what none of them explains, shape (step,).
        """
        known = self.posterior
        of_machine = np.einsum(
            "kap,pq,kbq->kab", self.columns, known.covariance, self.columns
        )
        of_process = known.uncertainty[:, :, None] ** 2 * np.eye(3)
        return np.sqrt(normal_variance(of_machine + of_process, known.desired))

    def expected_rms(self, run: Solution) -> float:
        """Contour error that is expected of a run of the job, where it cuts [m rms].

        Its own and that of what is not known.

        Args:
            run: A run of `job`.
        """
        error = np.asarray(run.contour_error) ** 2 + self.spread() ** 2
        return float(np.sqrt(np.mean(error[np.asarray(run.is_cutting)])))


def learn(
    job: Job,
    parts: Sequence[Part],
    *,
    prior: MachinePrior | MachinePosterior | None = None,
    max_steps: int = 8,
    known: LearnedMachine | None = None,
    on_progress: OnProgress | None = None,
    on_checkpoint: OnCheckpoint | None = None,
    resume: Arrays | None = None,
) -> LearnedMachine:
    """Learn from parts that were cut, and correct the program for the next one.

    A command that was worse than an earlier one has gone too far: the next one begins
    with the best so far, and goes half as far from it at most.

    Args:
        job: The job; its machine must have a robot.
        parts: Parts of this program, in the order in which they were cut.
        prior: Sizes of what may be wrong, the default's if not given; or what parts of
            another program have shown of the machine.
        max_steps: Steps of Gauss-Newton at most, between turns of the mirror; 0 for no
            next command.
        known: What was learnt from the parts before, to begin there.
        on_progress: Called with a message of the stage, and the share of it that is
            done.
        on_checkpoint: Called with all that is needed to go on, plain arrays by name,
            after every step.
        resume: What it was called with for the same job and parts, to go on from there
            to the same result.

    Returns:
        The machine, and the next command.

    Raises:
        ValueError: There is no part, no robot, or a measurement does not suit the path.
        SimulationFailed: A run fails.

    Differentiability: runs on the host, not traceable.
    """
    tell = on_progress or (lambda message, share: None)
    job = job.with_precision()
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but has none.")
    if not parts:
        raise ValueError("Argument `parts` must have a part, but is empty.")
    tell("the program as the model predicts it", 0.0)
    search = _Search(job, prior or MachinePrior(), tuple(parts))
    x = search.start if known is None else known.posterior.mean
    state = LearningState(0, x, search.set_up)
    if resume is not None:
        state = LearningState.of_arrays(resume)
    keep = on_checkpoint or (lambda arrays: None)
    last = _FIRST_STEPS if known is None else _LATER_STEPS
    x, search.set_up, system = state.parameters, state.set_up, None
    for step in range(state.step, last):
        if step > state.step:
            state = LearningState(step, x, search.set_up)
            keep(state.arrays())
        stage = f"what the machine does beyond its model, step {step + 1} of {last}"
        tell(stage, 0.0)
        system = search.linearised(x, on_share=functools.partial(tell, stage))
        if system.gain < LEAST_GAIN:
            # Drives and forces stay as modelled: all else may still be off.
            tell("what is off besides drives and forces", 0.0)
            x, system = search.besides_machine()
            break
        x = search.step(x, system)
    if system is None:
        raise ValueError("Argument `resume` must be of the same parts, but is not.")
    if system.gain < LEAST_GAIN:
        tell("the parts show nothing that the model does not know", 0.0)
    tell("the parts on the machine as it was learnt", 0.0)
    found = search.outcome(x, system)
    if max_steps < 1:
        return found
    commands = CommandSearch(
        found.job, search.rigid, tuple(search.commands), found.part_errors
    )
    correction = commands.search(max_steps, state, lambda at: keep(at.arrays()), tell)
    return dataclasses.replace(found, correction=correction)


def _identifiable_groups(
    measurements: Sequence[AbstractMeasurement],
) -> tuple[str, ...]:
    """Groups of parameters that some measurements may tell apart.

    Points of walls see one direction each, a few for all that the drives do: what they
    show beyond the cutter's radius is left to the process, which says nothing far from
    them.
    """
    if any(one.sees_motion for one in measurements):
        return GROUPS
    sees_force = any(isinstance(one, MeasuredForces) for one in measurements)
    return (*(("force",) if sees_force else ()), *_BESIDES_MACHINE)


class _Search:
    """Gauss-Newton on the parameters of a machine, the process integrated out.

    Attributes:
        center: Parameters before these parts are seen, shape (parameter,).
        start: Parameters to begin with, shape (parameter,).
        set_up: What the set-ups of the measurements leave open, of one after the other,
            in units of its priors, shape (nuisance,).
    """

    def __init__(
        self,
        job: Job,
        prior: MachinePrior | MachinePosterior,
        parts: tuple[Part, ...],
    ):
        self.job, self.known = job, None
        if isinstance(prior, MachinePosterior):
            self.known, self.machine = prior, prior.machine_for(job)
            self.center = self.start = prior.mean
        else:
            machine = AdaptableMachine.of_job(job, prior)
            seen = [one for part in parts for one in part.measurements]
            self.machine = machine.with_free(_identifiable_groups(seen))
            self.center = np.zeros(self.machine.count)
            self.start = self.machine.start
        base = self.machine.base
        self.commands = [np.asarray(part.commanded) for part in parts]
        self.rigid = rigid_cut(base, FrozenStock())
        self.force_slopes = self.machine.rigid_force_slopes()
        program = jnp.asarray(job.path.positions)
        self.model = Solution.of_command(base, self.rigid, program, FrozenStock())
        found = [
            (k, measured.seen(base, self.model))
            for k, part in enumerate(parts)
            for measured in part.measurements
        ]
        self.part = [k for k, _ in found]
        self.seen = tuple(seen for _, seen in found)
        normals = wall_normals(self.model, self.seen)
        if normals.any():
            self.machine = dataclasses.replace(self.machine, normals=normals)
        self.weights = np.ones(len(found))
        self.free = np.flatnonzero(self.machine.is_free)
        self.set_up = np.zeros(sum(s.nuisance.shape[1] for s in self.seen))
        self._predicted: dict[tuple[bytes, int], Observables] = {}
        self._columns: Observables | None = None

    def predicted(self, x: np.ndarray, part: int) -> Observables:
        """Observables of the run of a part, with some parameters."""
        key = x.tobytes(), part
        if key not in self._predicted:
            adapted, command = self.machine.job_at(x), self.commands[part]
            run = Solution.of_command(
                adapted, self.rigid, jnp.asarray(command), FrozenStock()
            )
            run.raise_unless_successful(adapted)
            arm = np.asarray(run.surface_deviation)
            tip = arm + self.machine.field(x, np.asarray(self.job.path.positions))
            wall = tip + self.machine.wall_columns() @ x
            shift = self.machine.frame_shift(adapted)
            self._predicted[key] = Observables(
                tip, wall, arm - shift, np.asarray(run.force)
            )
        return self._predicted[key]

    def residuals(
        self, x: np.ndarray, set_up: np.ndarray | None = None
    ) -> list[np.ndarray]:
        """Residuals of each measurement beyond machine and set-up [m or N]."""
        set_up = self.set_up if set_up is None else set_up
        found, first = [], 0
        for seen, part in zip(self.seen, self.part, strict=True):
            last = first + seen.nuisance.shape[1]
            known = seen.of(self.predicted(x, part))
            known = known + seen.nuisance @ set_up[first:last]
            found.append(seen.value - known)
            first = last
        return found

    def weigh(self, residuals: list[np.ndarray]) -> Stacked:
        """Observations in which older parts count less by what changed since."""
        for k, (own, seen) in enumerate(zip(residuals, self.seen, strict=True)):
            later = [
                residuals[n]
                for n in range(k + 1, len(residuals))
                if residuals[n].shape == own.shape
                and self.seen[n].observed == seen.observed
            ]
            if later:
                noise = float(np.mean(seen.variance))
                drift = float(np.mean((own - later[-1]) ** 2)) - 2 * noise
                self.weights[k] = noise / (noise + max(0.0, drift))
        return Stacked.of(self.seen, self.weights)

    def nuisance(self) -> np.ndarray:
        """Columns of what the set-ups leave open, of one after the other."""
        from scipy.linalg import block_diag

        blocks = np.asarray(block_diag(*(seen.nuisance for seen in self.seen)))
        return blocks.reshape(sum(len(seen.value) for seen in self.seen), -1)

    def besides_machine(self) -> tuple[np.ndarray, Linearised]:
        """Parameters with a machine as modelled, and the system that they solve.

        Process, field and radius are taken if they are likely enough without another
        machine. Slopes in field and radius do not depend on where they are taken.
        """
        groups = [self.machine.group(name).index for name in _BESIDES_MACHINE]
        self.free = np.intersect1d(self.free, np.concatenate(groups))
        none = self.set_up_alone().found
        self.set_up = none
        system = self.linearised(self.center, self._columns)
        if system.gain >= LEAST_GAIN:
            return self.step(self.center, system), system
        self.set_up = none
        return self.center, system

    def linearised(
        self,
        x: np.ndarray,
        columns: Observables | None = None,
        on_share: Callable[[float], None] | None = None,
    ) -> Linearised:
        """Whitened columns and residuals about some parameters, and their prior.

        Args:
            x: The parameters.
            columns: Slopes, where they are known.
            on_share: Called with the share of the slopes that are known.
        """
        residuals = self.residuals(x)
        stacked = self.weigh(residuals)
        residual = np.concatenate(residuals)
        if columns is None:
            columns = self._columns = self.machine.columns(
                x, self.rigid, self.commands[-1], self.force_slopes, on_share=on_share
            )
        slopes = np.concatenate([seen.of(columns) for seen in self.seen])
        no_bound = np.full(len(self.set_up), -np.inf)
        unknowns = Unknowns(
            np.r_[x[self.free], self.set_up],
            np.r_[self.machine.lower[self.free], no_bound],
            np.concatenate([slopes[:, self.free], self.nuisance()], axis=1),
            self._prior,
        )
        return unknowns.linearised(stacked, residual, self.set_up_alone())

    def set_up_alone(self) -> SetUp:
        """Set-ups that suit the measurements best where the machine is as modelled."""
        residuals = self.residuals(self.center, np.zeros(len(self.set_up)))
        stacked = Stacked.of(self.seen, self.weights)
        return SetUp.fitted(stacked, np.concatenate(residuals), self.nuisance())

    def _prior(self, slopes: np.ndarray, seen: np.ndarray) -> Prior:
        """Prior of the unknowns: of sizes that suit them, or what is known."""
        if self.known is None:
            return chosen_prior(self.machine, self.free, slopes, seen)
        count, more = len(self.free), len(self.set_up)
        covariance = np.eye(count + more)
        own = self.known.covariance[np.ix_(self.free, self.free)]
        covariance[:count, :count] = own + _LEAST_VARIANCE * np.eye(count)
        mean = np.r_[self.center[self.free], np.zeros(more)]
        return known_prior(mean, covariance, slopes, seen)

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
        if system.gain < LEAST_GAIN:
            mean = np.zeros_like(mean)
        count, free = len(self.free), self.free
        covariance = np.diag(self.machine.is_free.astype(float))
        if self.known is not None:
            covariance = self.known.covariance.copy()
        covariance[np.ix_(free, free)] = system.covariance()[:count, :count]
        posterior = MachinePosterior(
            mean=x,
            covariance=covariance,
            sizes=self.machine.sizes,
            names=self.machine.names,
            center=self.machine.center,
            desired=np.asarray(self.job.path.positions, np.float64),
            disturbance=mean,
            uncertainty=deviation,
            normals=self.machine.normals,
        )
        assert self._columns is not None
        job = posterior.job_for(self.job)

        def error(command: Rows3) -> float:
            u = jnp.asarray(command)
            return Solution.of_command(job, self.rigid, u, FrozenStock()).contour.rms

        return LearnedMachine(
            job=job,
            posterior=posterior,
            gain=system.gain,
            explained=self._explained(residuals, mean),
            columns=self._columns.wall,
            machine=self.machine,
            rigid=self.rigid,
            part_errors=tuple(error(u) for u in self.commands),
        )

    def _explained(
        self, residuals: list[np.ndarray], disturbance: Rows3
    ) -> tuple[ExplainedError, ...]:
        """Errors that each measurement shows, and what is left of them."""
        rms = lambda values: float(np.sqrt(np.mean(values**2)))
        before = self.residuals(np.zeros(self.machine.count))
        none = np.zeros_like(disturbance)
        process = Observables(disturbance, disturbance, disturbance, none)
        return tuple(
            ExplainedError(
                part + 1,
                seen.observed,
                rms(first),
                rms(own),
                rms(own - seen.of(process)),
                float(np.sqrt(np.mean(seen.variance))),
            )
            for part, seen, first, own in zip(
                self.part, self.seen, before, residuals, strict=True
            )
        )

    def _disturbance(
        self, stacked: Stacked, found: Processes, residual: np.ndarray
    ) -> tuple[Rows3, Rows3]:
        """Posterior mean and deviation of the process at the wall instants [m]."""
        times = wall_times(self.model)
        mean, variance = np.zeros((len(times), 3)), np.zeros((len(times), 3))
        of_tip = found.process[: found.of_tip], found.chosen[: found.of_tip]
        for process, chosen in zip(*of_tip, strict=True):
            seen = stacked.observations(chosen)
            m, s = process.smoothed(seen, stacked.rows(residual, chosen), times)
            mean, variance = mean + np.asarray(m), variance + np.asarray(s) ** 2
        return mean, np.sqrt(variance)
