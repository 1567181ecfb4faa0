"""Measurements that would make a part better: each by what it leaves unknown."""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._job import Job
from .._types import FloatRows3, RealScalarLike
from ..process import FrozenStock
from ..robot import jacobian
from ..sim import JobKinematics, Solution, rigid_cut
from ._gaussian_process import EXPECTED_SIZE, Observations, PathProcess
from ._machine_posterior import MachinePosterior, normal_variance
from ._measurement import Observables, wall_times
from ._parameters import AdaptableMachine

# Length of what no parameter explains, before any of it is seen [s].
_LENGTH = 0.1


class AbstractTrial(eqx.Module):
    """A measurement that could be made."""

    @abc.abstractmethod
    def slopes(
        self, known: MachinePosterior
    ) -> Float[np.ndarray, "observation parameter"]:
        """Slopes of what would be seen in the parameters, over its noise.

        Args:
            known: What is known of the machine.
        """


class TrackedRun(AbstractTrial):
    """A program that is run under a tracker: a trial cut, or a path in the air.

    Attributes:
        job: The job, on the same machine.
        noise: Standard deviation of a coordinate [m].
    """

    job: Job
    noise: RealScalarLike

    def slopes(
        self, known: MachinePosterior
    ) -> Float[np.ndarray, "observation parameter"]:
        """Slopes of the tip, without the correlation of what none of them explains."""
        seen, run = _columns(known, self.job.with_precision())
        columns = seen.tip
        times, rows = wall_times(run), []
        for axis in range(3):
            direction = np.tile(np.eye(3)[axis], (len(times), 1))
            variance = np.full(len(times), float(self.noise) ** 2)
            process = PathProcess(jnp.full(3, _LENGTH), jnp.full(3, EXPECTED_SIZE))
            seen = Observations(times, direction, variance)
            rows.append(process.whiten(seen, jnp.asarray(columns[:, axis])).rows)
        return np.concatenate([np.asarray(one) for one in rows])


class LoadTest(AbstractTrial):
    """Weights that pull at the tip at rest, and a gauge that sees how it yields.

    Attributes:
        job: The job; the arm stands half-way through its path.
        force: Forces, each in a test of its own, along the axes of `work` [N], shape
            (test, 3).
        noise: Standard deviation of a coordinate of the gauge [m].
    """

    job: Job
    force: FloatRows3
    noise: RealScalarLike

    def slopes(
        self, known: MachinePosterior
    ) -> Float[np.ndarray, "observation parameter"]:
        """Slopes of the deflections, which only springs have."""
        job = self.job.with_precision()
        machine, robot = known.machine_for(job), job.robot
        assert robot is not None
        path = np.asarray(job.path.positions)
        joints, _ = JobKinematics(job).joints(jnp.asarray(path))
        q = jnp.asarray(joints)[len(path) // 2]
        R = np.asarray(job.T_base_work)[:3, :3]
        J = R.T @ np.asarray(jacobian(robot, q)[:3])
        bend = np.asarray(self.force) @ J / np.asarray(robot.joint_stiffness)
        group = machine.group("stiffness")
        # Twice as stiff a spring gives half as much.
        each = -np.einsum("aj,fj->faj", J, bend) * known.sizes[group.index]
        found = np.zeros((each.shape[0] * 3, machine.count))
        found[:, group.index] = each.reshape(-1, group.count) / float(self.noise)
        return found


class Advice(NamedTuple):
    """Error that a trial would leave unknown.

    Attributes:
        name: Name of the trial; empty for none.
        spread: Error across the path of the part that parameters which are not known
            leave, where it cuts [m rms].
    """

    name: str
    spread: float


def advise(
    job: Job,
    known: MachinePosterior,
    trials: Mapping[str, AbstractTrial],
    *,
    on_progress: Callable[[str, float], None] | None = None,
) -> tuple[Advice, ...]:
    """Trials in the order of what they leave unknown of a part, the best first.

    Linear in the parameters: gaps and friction count with the slopes that they have at
    a part of their size. What no parameter explains stays unknown after each.

    Args:
        job: The job of the part.
        known: What is known of the machine, such as `MachinePosterior.of_prior`.
        trials: Trials by name.
        on_progress: Called with a message of the stage, and the share of it that is
            done.

    Returns:
        What is left after each; that without any trial stands last.

    Raises:
        ValueError: A job has another machine.
        SimulationFailed: A run fails.

    Differentiability: runs on the host, not traceable.
    """
    tell = on_progress or (lambda message, share: None)
    tell("the part", 0.0)
    job = job.with_precision()
    seen, run = _columns(known, job)
    columns = seen.wall
    free = known.sizes > 0
    own = known.covariance[np.ix_(free, free)]
    is_cutting = np.asarray(run.is_cutting)

    def spread(covariance: np.ndarray) -> float:
        of_tip = np.einsum(
            "kap,pq,kbq->kab", columns[:, :, free], covariance, columns[:, :, free]
        )
        across = normal_variance(of_tip, job.path.positions)[is_cutting]
        return float(np.sqrt(np.mean(across)))

    found = []
    for name, trial in trials.items():
        tell(name, 0.0)
        M = trial.slopes(known)[:, free]
        # Without an inverse of what is known: some of it may be known exactly.
        gain = np.linalg.solve(np.eye(len(own)) + own @ (M.T @ M), own)
        found.append(Advice(name, spread(gain)))
    found.sort(key=lambda one: one.spread)
    return (*found, Advice("", spread(own)))


def usual_trials(job: Job, *, tracker: float, gauge: float) -> dict[str, AbstractTrial]:
    """Trials that any part has: itself, its path in the air, weights at the tip.

    Args:
        job: The job.
        tracker: Standard deviation of a coordinate of a tracker [m].
        gauge: That of a gauge [m].
    """
    positions = np.asarray(job.path.positions) + np.array([0.0, 0.0, _HIGHER])
    path = dataclasses.replace(job.path, positions=jnp.asarray(positions))
    above = dataclasses.replace(job, path=path)
    return {
        "this part under a tracker": TrackedRun(job, tracker),
        "its path in the air under a tracker": TrackedRun(above, tracker),
        f"{_LOAD:g} N along x, y and z": LoadTest(job, _LOAD * np.eye(3), gauge),
    }


# By how much the path in the air is higher [m], and the usual load [N].
_HIGHER, _LOAD = 0.1, 300.0


def _columns(known: MachinePosterior, job: Job) -> tuple[Observables, Solution]:
    """Slopes of a program's run in the parameters, and the run as modelled."""
    machine: AdaptableMachine = known.machine_for(job)
    rigid = rigid_cut(machine.base, FrozenStock())
    command = jnp.asarray(job.path.positions)
    run = Solution.of_command(machine.base, rigid, command, FrozenStock())
    run.raise_unless_successful(machine.base)
    slopes = machine.rigid_force_slopes()
    return machine.columns(known.mean, rigid, command, slopes), run
