"""A job as a problem of correction: its plant, commanded by tips or by joints."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows
from ...process import AbstractAdjoint, StockHeld, wall_deviation, wall_shares
from ...sim import (
    ElasticArm,
    LinearRun,
    Run,
    Solution,
    command_joints,
    command_motors,
    job_machine,
    job_process,
    joint_motors,
    linearise,
    path_axes,
    run_motors,
    solve_command,
)
from .._core.method import AbstractMethod
from .._core.problem import AbstractLinearPlant, LinearMotion, Motion, Problem
from .._method.mirror import IteratedMirror, SampledMirror
from .plant_segments import Steps, wall_motion, with_rows


class SolvedMotion(Motion):
    """The motion of a job, with the solution that it was taken from.

    Attributes as of `Motion`, and:
        solution: The solution.
    """

    solution: Solution


def solved_motion(solution: Solution) -> SolvedMotion:
    """Return the motion of a solution, as its walls show it."""
    actual = solution.desired + solution.surface_deviation
    return SolvedMotion(actual, solution.force, solution)


class TipPlant(AbstractLinearPlant):
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

    def __call__(self, command: Float[Array, "step 3"]) -> Motion:
        """Return the motion that follows a command, shape (step, 3)."""
        motors, _ = command_motors(self.job, command)
        ran = run_motors(self.job, motors, self.adjoint)
        return wall_motion(self.job, ran, self.wall_share)

    def run(self, command: FloatRows) -> Motion:
        """Return the motion; with its solution, if the rigid cut is known."""
        if self.rigid is None:
            return _compiled(self, command)
        command = jnp.asarray(command)
        return solved_motion(solve_command(self.job, self.rigid, command, self.adjoint))

    def linearised(self, command: FloatRows) -> "LinearJob | None":
        """Return the linear system around a command of a dynamic arm."""
        if not has_linear_run(self.job):
            return None
        return _linear_tips(self, jnp.asarray(command))


class JointPlant(AbstractLinearPlant):
    """A job as a plant that is commanded by joint positions [rad or m].

    The controller adds the gravity sag, as it does for tip positions. Attributes as of
    `TipPlant`.
    """

    job: Job
    adjoint: AbstractAdjoint
    wall_share: Steps | None = None
    rigid: Run | None = None

    def __call__(self, command: Float[Array, "step joint"]) -> Motion:
        """Return the motion that follows a command, shape (step, joint)."""
        ran = run_motors(self.job, joint_motors(self.job, command), self.adjoint)
        return wall_motion(self.job, ran, self.wall_share)

    def run(self, command: FloatRows) -> Motion:
        """Return the motion; with its solution, if the rigid cut is known."""
        from ...robot import forward_kinematics

        if self.rigid is None:
            return _compiled(self, command)
        job, command = self.job, jnp.asarray(command)
        # The tips that belong to the joints, for the record.
        T = jnp.asarray(job.T_base_work)
        tips = jax.vmap(lambda q: forward_kinematics(job.robot, q)[:3, 3])(command)  # pyright: ignore[reportArgumentType]
        tips = (tips - T[:3, 3][None]) @ T[:3, :3]
        motors = joint_motors(job, command)
        return solved_motion(solve_command(job, self.rigid, tips, self.adjoint, motors))

    def linearised(self, command: FloatRows) -> "LinearJob | None":
        """Return the linear system around a command of a dynamic arm."""
        if not has_linear_run(self.job):
            return None
        return _linear_joints(self, jnp.asarray(command))


class LinearJob(LinearMotion):
    """The motion of a job and the linear system around it.

    Attributes:
        motion: The motion.
        run: The system, in the motors.
        motors: Slopes of the motors in the command, row by row, shape (step, joint,
            axis).
        wall_share: When in each period its wall is made, shape (step,).
    """

    motion: Motion
    run: LinearRun
    motors: Float[Array, "step joint axis"]
    wall_share: Float[Array, " step"]

    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Return the changes of the motion, each direction a row of the first axis."""
        motors = jnp.einsum("kja,kad->kjd", self.motors, changes)
        found = self.run.move(motors)
        still = jnp.zeros((changes.shape[0], 3), changes.dtype)
        walls = jax.vmap(
            lambda ends: wall_deviation(ends, still, self.wall_share), in_axes=-1
        )
        return Motion(walls(found.ends), jnp.moveaxis(found.force, -1, 0))


def has_linear_run(job: Job) -> bool:
    """Return whether the linear system of a job's run is known in closed form."""
    settings = job.simulation
    is_known = settings.chip == "near_far" and settings.integrator == "midpoint"
    return settings.mode == "dynamic" and is_known


@eqx.filter_jit
def _linear_tips(plant: TipPlant, command: Float[Array, "step 3"]) -> LinearJob:
    motors, _ = command_motors(plant.job, command)

    def along(axis: Array) -> Array:
        move = jnp.broadcast_to(axis[None], command.shape)
        return jax.jvp(lambda x: command_motors(plant.job, x)[0], (command,), (move,))[
            1
        ]

    # A row of motors follows the same row of tips alone.
    slopes = jax.vmap(along, out_axes=-1)(jnp.eye(3, dtype=command.dtype))
    return _linear_job(plant, motors, slopes)


@eqx.filter_jit
def _linear_joints(plant: JointPlant, command: Float[Array, "step joint"]) -> LinearJob:
    one = lambda row: joint_motors(plant.job, row[None])[0]
    slopes = jax.vmap(jax.jacfwd(one))(command)
    return _linear_job(plant, joint_motors(plant.job, command), slopes)


def _linear_job(
    plant: TipPlant | JointPlant,
    motors: Float[Array, "step joint"],
    slopes: Float[Array, "step joint axis"],
) -> LinearJob:
    job = plant.job
    machine = job_machine(job)
    assert isinstance(machine, ElasticArm)
    ran, run = linearise(machine, job_process(job, StockHeld()), motors)
    desired = jnp.asarray(job.path.positions)
    shares = plant.wall_share
    if shares is None:
        shares = wall_shares(desired, path_axes(job), job.cutter)
    shares = jnp.asarray(shares, desired.dtype)
    motion = wall_motion(job, ran, shares)
    return LinearJob(motion, run, slopes, shares)


@eqx.filter_jit
def _compiled(plant: AbstractLinearPlant, command: FloatRows) -> Motion:
    return plant(jnp.asarray(command))


def job_problem(
    job: Job,
    plant: Any,
    nominal: Float[Array, "step axis"],
    before: Solution,
    weights: Float[np.ndarray, " step"],
) -> Problem:
    """Return the problem of a plant on the path of a job."""
    return Problem(
        plant=plant,
        nominal=np.asarray(nominal),
        desired=np.asarray(before.desired),
        is_cutting=weights.astype(np.asarray(nominal).dtype),
        time_step=float(job.tooth_period),
        max_offset=float(job.correction.max_offset),
    )


def joint_problem(
    job: Job, adjoint: AbstractAdjoint, before: Solution, tips: Problem
) -> Problem:
    """Return the problem in joint positions, bounded like the tip at its far end.

    Args:
        job: The job.
        adjoint: How to differentiate through the removal.
        before: Solution of the uncorrected program.
        tips: The problem in tip positions.
    """
    from ...robot import jacobian

    nominal, _ = command_joints(job, jnp.asarray(tips.desired))
    J = np.asarray(jacobian(job.robot, nominal[0]))[:3]  # pyright: ignore[reportArgumentType]
    lever = np.linalg.norm(J, axis=0).max()
    plant = JointPlant(job, adjoint, before.wall_share, before.rigid)
    weights = np.asarray(tips.is_cutting)
    problem = job_problem(job, plant, nominal, before, weights)
    bound = float(job.correction.max_offset) / lever
    return eqx.tree_at(lambda p: p.max_offset, problem, np.asarray(bound))


def job_mirror(
    problem: Problem, before: Solution, horizon: tuple[int, int] | None
) -> AbstractMethod:
    """Return the iterated mirror; on a long path its grid sees the first that cuts.

    The grid runs some hundred times, which on the whole path would cost more than the
    optimiser.
    """
    if horizon is None:
        return IteratedMirror(before=solved_motion(before))
    plant, is_cutting = problem.plant, before.is_cutting
    assert isinstance(plant, TipPlant)
    first = int(np.flatnonzero(is_cutting)[0])
    rows = slice(min(first + horizon[0], plant.job.path.step_count))
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
    return SampledMirror(sample)
