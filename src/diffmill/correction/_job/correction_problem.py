"""A job as a problem of correction, built once from the run of its program."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._job import Job
from ...process import AbstractAdjoint
from ...sim import JobKinematics, Solution
from .._core.method import MethodResult
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Problem
from .._surface.finished_surface import FinishedSurface
from .objective import job_objective, job_surface, job_weights, remaining_error
from .plants import JointPlant, TipPlant

# Of a program that only passes over its stock.
NEVER_CUTS = (
    "Argument `job` must have a program that cuts its stock, but the rigid tool "
    "removes nothing."
)


class NothingToCorrect(ValueError):
    """Raise when a program never cuts, so that there is no error to correct."""


class CorrectionProblem(eqx.Module):
    """A job as a problem of correction.

    Attributes:
        job: The job, in its precision and with the slots that its run needed.
        before: Solution of the uncorrected program.
        surface: The surface as it should be; None where it is not of walls and floors,
            or where nothing asks for it.
        tips: The problem in tip positions; its plant is a `TipPlant`.
        objective: The error that becomes small; of the path where no optimiser runs.
    """

    job: Job
    before: Solution
    surface: FinishedSurface | None
    tips: Problem
    objective: AbstractObjective

    @classmethod
    def of(
        cls,
        job: Job,
        before: Solution,
        adjoint: AbstractAdjoint,
        *,
        objective: AbstractObjective | None = None,
        is_optimised: bool = True,
    ) -> "CorrectionProblem":
        """Problem of a job whose program has been run.

        Args:
            job: The job.
            before: That run.
            adjoint: How to differentiate through the removal.
            objective: The error that is to become small; that of the job if None.
            is_optimised: False where no optimiser runs.

        Raises:
            NothingToCorrect: The program never cuts, or all that cuts has no weight.
            UnsuitableSettings: A surface is asked for where there is none.
        """
        surface = None
        if is_optimised:
            surface = job_surface(job, before.rigid, before.wall_share)
        weights = counting_weights(job, before, surface)
        if not is_optimised:
            objective = PathObjective()
        elif objective is None:
            objective = job_objective(job, surface, weights)
        nominal = np.asarray(job.path.positions)
        tips = Problem(
            plant=TipPlant(job, adjoint, before.wall_share, before.rigid),
            nominal=nominal,
            desired=np.asarray(before.desired),
            is_cutting=weights.astype(nominal.dtype),
            time_step=float(job.tooth_period),
            max_offset=float(job.correction.max_offset),
        )
        return cls(job, before, surface, tips, objective)

    @property
    def plant(self) -> TipPlant:
        """The job as a plant that is commanded by tip positions."""
        plant = self.tips.plant
        assert isinstance(plant, TipPlant)
        return plant

    def in_joints(self) -> Problem:
        """Problem in joint positions, bounded like the tip at its far end."""
        from ...robot import jacobian

        kinematics, tips, plant = JobKinematics(self.job), self.tips, self.plant
        nominal = np.asarray(kinematics.joints(jnp.asarray(tips.desired)).positions)
        motors = list(kinematics.robot.motor_joints)
        J = np.asarray(jacobian(kinematics.robot, jnp.asarray(nominal[0])))[:3, motors]
        lever = np.linalg.norm(J, axis=0).max()
        return Problem(
            plant=JointPlant(plant.job, plant.adjoint, plant.wall_share, plant.rigid),
            nominal=nominal,
            desired=tips.desired,
            is_cutting=np.asarray(tips.is_cutting).astype(nominal.dtype),
            time_step=tips.time_step,
            max_offset=float(self.job.correction.max_offset) / lever,
        )

    def remaining_error(self, outcome: MethodResult) -> float:
        """Root mean square of the error that becomes small, after a method [m]."""
        return remaining_error(self.objective, self.tips, outcome)


def checked_job(job: Job) -> Job:
    """Job in its precision.

    Raises:
        ValueError: Its machine is rigid, or JAX is not set up for its precision.
    """
    job = job.with_precision()
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    return job


def counting_weights(
    job: Job, before: Solution, surface: FinishedSurface | None
) -> Float[np.ndarray, " step"]:
    """Weight of every row in the error, shape (step,).

    Raises:
        NothingToCorrect: No row has one.
    """
    if not np.any(before.is_cutting):
        raise NothingToCorrect(NEVER_CUTS)
    try:
        return job_weights(job, before.rigid, np.asarray(before.is_cutting), surface)
    except ValueError as error:
        raise NothingToCorrect(str(error)) from error
