"""A job as a problem of correction: its plant, commanded by tips or by joints."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows
from ...process import AbstractAdjoint, FrozenStock
from ...robot import Robot
from ...sim import JobKinematics, MachiningProblem, Run, Solution
from .._core.method import AbstractMethod
from .._core.problem import AbstractHostPlant, Motion, Problem
from .._method.ensemble import AbstractUncertainPlant, Parameters
from .._method.mirror import IteratedMirror
from .linear_job import (
    LinearJob,
    Steps,
    linear_job,
    wall_motion,
)
from .plant_segments import JobPieces, with_rows


class SolvedMotion(Motion):
    """Motion of a job with its solution.

    Attributes:
        solution: The solution, from which actual tips and forces are taken.
    """

    solution: Solution


def solved_motion(solution: Solution) -> SolvedMotion:
    """Motion of a solution, at the instants at which its walls are made."""
    actual = solution.desired + solution.surface_deviation
    return SolvedMotion(actual, solution.force, solution)


class TipPlant(AbstractHostPlant):
    """A job as a plant that is commanded by tip positions [m].

    Attributes:
        job: The job.
        adjoint: How to differentiate through the removal.
        wall_share: When in each period its wall is made, `Solution.wall_share`, shape
            (step,); by the path alone if None.
        rigid: `rigid_cut` of the job, to run by the program of `simulate`; None to
            run by one of its own.
    """

    job: Job
    adjoint: AbstractAdjoint
    wall_share: Steps | None = None
    rigid: Run | None = None

    @property
    def pieces(self) -> JobPieces:
        """The plant, piece by piece."""
        return JobPieces(self.job, self.adjoint, self.wall_share)

    def motors(self, command: Float[Array, "step 3"]) -> Float[Array, "step joint"]:
        """Motor positions behind the controller [rad or m], shape (step, joint)."""
        return JobKinematics(self.job).motors(command).positions

    def __call__(self, command: Float[Array, "step 3"]) -> Motion:
        """Motion that follows a command, shape (step, 3)."""
        return _motion(self.job, self.motors(command), self.wall_share, self.adjoint)

    def run(self, command: FloatRows) -> Motion:
        """Motion, with its solution if the rigid cut is known."""
        job, command = self.job, jnp.asarray(command)
        if self.rigid is None:
            return _compiled(job, self.motors(command), self.wall_share)
        return solved_motion(
            Solution.of_command(job, self.rigid, command, self.adjoint)
        )

    def linearised(self, command: FloatRows) -> LinearJob:
        """Linear system around a command."""
        kinematics, command = JobKinematics(self.job), jnp.asarray(command)
        joints, _ = kinematics.joints(command)
        found = linear_job(
            with_smooth_drives(self.job),
            kinematics.motor_positions_from_joints(joints),
            kinematics.motor_slopes(joints, command),
            self.wall_share,
        )
        return _about_sharp_drives(self, found, command)


class ScaledPlant(AbstractUncertainPlant):
    """A job with scaled parameters as a plant that is commanded by tip positions.

    The place of the work is found with the arm itself, which takes away what its weight
    bends it more or less than the model: the sag is that of each member.

    Attributes:
        plant: The plant of the job as it is.
    """

    plant: TipPlant

    def member(self, parameters: Parameters) -> TipPlant:
        """Plant with scaled parameters, see `Job.with_scaled`."""
        log_scale = jnp.asarray(parameters, self.plant.job.path.positions.dtype)
        job = self.plant.job.with_scaled(log_scale)
        return dataclasses.replace(self.plant, job=job)


class MachinePlants(AbstractUncertainPlant):
    """Machines that a job may run on, as plants that are commanded by tip positions.

    Attributes:
        plant: The plant of the job as it is.
        machines: The job on each machine.
    """

    plant: TipPlant
    machines: tuple[Job, ...]

    def member(self, parameters: Parameters) -> TipPlant:
        """Plant on the machine whose number is the parameter."""
        return dataclasses.replace(self.plant, job=self.machines[int(parameters[0])])


class JointPlant(AbstractHostPlant):
    """A job as a plant that is commanded by joint positions [rad or m].

    The controller adds the gravity sag, as it does for tip positions.

    Attributes:
        job: The job.
        adjoint: How to differentiate through the removal.
        wall_share: See `TipPlant`.
        rigid: See `TipPlant`.
    """

    job: Job
    adjoint: AbstractAdjoint
    wall_share: Steps | None = None
    rigid: Run | None = None

    @property
    def pieces(self) -> JobPieces:
        """The plant, piece by piece."""
        return JobPieces(self.job, self.adjoint, self.wall_share, True)

    def motors(self, command: Float[Array, "step joint"]) -> Float[Array, "step joint"]:
        """Motor positions before the controller [rad or m], shape (step, joint)."""
        return JobKinematics(self.job).motor_positions_from_joints(command)

    def __call__(self, command: Float[Array, "step joint"]) -> Motion:
        """Motion that follows a command, shape (step, joint)."""
        return _motion(self.job, self.motors(command), self.wall_share, self.adjoint)

    def run(self, command: FloatRows) -> Motion:
        """Motion, with its solution if the rigid cut is known."""
        from ...robot import forward_kinematics

        job, command = self.job, jnp.asarray(command)
        motors = self.motors(command)
        if self.rigid is None:
            return _compiled(job, motors, self.wall_share)
        # The tips that belong to the joints, for the record.
        known = JobKinematics(job)
        T = jnp.asarray(known.T_base_work)
        tips = jax.vmap(lambda q: forward_kinematics(known.robot, q)[:3, 3])(command)
        tips = (tips - T[:3, 3][None]) @ T[:3, :3]
        return solved_motion(
            Solution.of_command(job, self.rigid, tips, self.adjoint, motors)
        )

    def linearised(self, command: FloatRows) -> LinearJob:
        """Linear system around a command."""
        joints = jnp.asarray(command)
        slopes = JobKinematics(self.job).motor_slopes(joints)
        job = with_smooth_drives(self.job)
        found = linear_job(job, self.motors(joints), slopes, self.wall_share)
        return _about_sharp_drives(self, found, command)


def with_smooth_drives(job: Job) -> Job:
    """Job whose drives have slopes that hold over more than a micrometre.

    Gaps get corners as round as they can be. A joint that sticks has no slope where the
    command has to make it slide: its motor carries it there, without friction or gap.
    """
    robot = job.robot
    if robot is None:
        return job
    if robot.backlash is not None:
        share = 0.0 if _sticks(robot) else 1.0
        robot = robot.with_backlash(share * robot.backlash.gap, corner=1.0)
    if _sticks(robot):
        assert robot.friction is not None
        own = robot.friction
        robot = robot.with_friction(0.0 * own.coulomb, own.viscous, own.speed)
    return dataclasses.replace(job, robot=robot)


def _sticks(robot: Robot) -> bool:
    """True if joints of a robot stick."""
    return robot.friction is not None and robot.friction.presliding is not None


def _about_sharp_drives(
    plant: TipPlant | JointPlant, found: LinearJob, command: FloatRows
) -> LinearJob:
    """System of smooth drives about the motion of a plant with drives as they are."""
    robot = plant.job.robot
    if robot is None or (robot.backlash is None and not _sticks(robot)):
        return found
    motion = plant.run(command)
    return dataclasses.replace(found, motion=Motion(motion.actual, motion.force))


def _motion(
    job: Job,
    motors: Float[Array, "step joint"],
    wall_share: Steps | None,
    adjoint: AbstractAdjoint,
) -> Motion:
    ran = MachiningProblem.of(job, adjoint).run(motors)
    return wall_motion(job, ran.ends, ran.force, wall_share)


@eqx.filter_jit
def _compiled(
    job: Job, motors: Float[Array, "step joint"], wall_share: Steps | None
) -> Motion:
    """Motion alone; all that a derivative would need is left out."""
    return _motion(job, motors, wall_share, FrozenStock())


def job_mirror(
    problem: Problem, before: Solution, segment: int | None
) -> AbstractMethod:
    """Iterated mirror; on a long path its grid sees the first segment that cuts.

    The grid runs some hundred times, which on the whole path would cost more than the
    optimiser.

    Args:
        problem: The problem.
        before: Solution of the uncorrected program.
        segment: Rows of a segment; None where the path is corrected as a whole.
    """
    if segment is None:
        return IteratedMirror(before=solved_motion(before))
    plant, is_cutting = problem.plant, before.is_cutting
    assert isinstance(plant, TipPlant)
    first = int(np.flatnonzero(is_cutting)[0])
    rows = slice(min(first + segment, plant.job.path.step_count))
    # Where none of these rows counts, the filter that suits the arm is found all the
    # same from how they cut.
    weights = problem.is_cutting[rows]
    if not np.any(weights):
        weights = np.asarray(is_cutting)[rows].astype(weights.dtype)
    part = with_rows(plant.job, np.arange(plant.job.path.step_count)[rows])
    shares = None if plant.wall_share is None else plant.wall_share[rows]
    sample = dataclasses.replace(
        problem,
        plant=dataclasses.replace(plant, job=part, wall_share=shares, rigid=None),
        nominal=problem.nominal[rows],
        desired=problem.desired[rows],
        is_cutting=weights,
    )
    return IteratedMirror(sample=sample)
