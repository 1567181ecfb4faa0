"""Correcting a job: the baselines, then the best command that derivatives find."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._job import Job
from ..sim import (
    AbstractAdjoint,
    Solution,
    Traced,
    command_joints,
    joint_motors,
    raise_unless_successful,
    run_with_room,
    solve_command,
    with_precision,
)
from ._case_record import CaseRecord, OnProgress
from ._input_shaper import shaped_program
from ._inverse_drive import inverse_drive
from ._job_method import (
    OPTIMISERS,
    for_the_path,
    job_optimiser,
    out_of_bounds,
    preconditioned,
    within_joint_limits,
)
from ._job_problem import TipPlant, job_mirror, job_problem, joint_problem
from ._joint_limits import check_joints
from ._kept import horizon_of, keeping, remembering
from ._least_squares_records import LeastSquaresStep
from ._memory import Arrays, OnCheckpoint
from ._method import Corrected, GivenCommand
from ._mirror import Mirror
from ._parts import path_parts
from ._projection import clip_offset
from ._setup import (
    check_limits,
    job_objective,
    job_surface,
    job_weights,
    remaining_error,
)
from ._surface_objective import touching_rows

if TYPE_CHECKING:
    import xarray

CASES = (
    "uncorrected",
    "mirror",
    "mirror_iterated",
    "input_shaper",
    "inverse_drive",
    "corrected",
)


class NothingToCorrect(ValueError):
    """Raise when a program never cuts, so that there is no error to correct."""


class Correction(eqx.Module):
    """A corrected job and what it was compared with.

    Attributes:
        cases: Solution of each case, by name, in the order of `CASES`.
        methods: What each method reported, by name.
        wall_time: Time that each method took, compilation included [s].
        path_part: Part of the path of each row, see `path_parts`, shape (step,).
        chosen: Name of the case whose command is the corrected program.
    """

    cases: dict[str, Solution]
    methods: dict[str, Corrected]
    wall_time: dict[str, float]
    path_part: Int[np.ndarray, " step"]
    chosen: str = eqx.field(static=True)

    @property
    def before(self) -> Solution:
        """Return the solution of the uncorrected program."""
        return self.cases["uncorrected"]

    @property
    def after(self) -> Solution:
        """Return the solution of the corrected program."""
        return self.cases[self.chosen]

    @property
    def mirror(self) -> Solution:
        """Return the solution of the one-shot mirror."""
        return self.cases["mirror"]

    @property
    def commanded(self) -> Float[Array, "step 3"]:
        """Return the corrected tip positions [m], shape (step, 3)."""
        return self.after.commanded

    @property
    def history(self) -> tuple[LeastSquaresStep, ...]:
        """Return the steps of the optimiser, without those that found its start."""
        return self.methods["corrected"].history

    def to_dataset(self) -> "xarray.Dataset":
        """Return all cases on `case`, figures by part of the path, and costs."""
        from ._dataset import correction_dataset

        return correction_dataset(self)


def correct(
    job: Job,
    *,
    throw: bool = True,
    on_progress: OnProgress | None = None,
    on_checkpoint: OnCheckpoint | None = None,
    resume: Arrays | None = None,
) -> Correction:
    """Predict, correct, and predict again.

    The mirror, the iterated mirror, an input shaper and the inverse drive are always
    computed; the best of them starts the optimiser. For the surface, or within bounds
    of it, a path that is corrected as a whole is first brought onto the desired one
    wherever it touches the surface: of the poses over a point only the deepest leaves
    an error, and one after the other would have to be raised.

    Args:
        job: The job; its machine must be a robot.
        throw: Whether to raise when the uncorrected run does not succeed.
        on_progress: Called with a message and the rms contour error so far [m].
        on_checkpoint: Called with all that is needed to go on, plain arrays by name:
            after every method, every step of Gauss-Newton on a whole path, and every
            segment of a long one.
        resume: What it was called with for the same job, to go on from there to the
            same result.

    Returns:
        The correction with all its cases.

    Raises:
        SimulationFailed: The run of the uncorrected program fails.
        NothingToCorrect: The program never cuts, or all that cuts has no weight; a
            `ValueError`.
        InfeasibleLimit: The program itself breaks a limit, or no correction holds all
            that is asked for; a `ValueError`.
        UnsuitableSettings: Knots, horizon or overlap do not suit the path; a
            `ValueError`.
        ValueError: The job has no robot, or JAX is not set up for its precision.

    Differentiability: runs on the host, not traceable.
    """
    job = with_precision(job)
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    # A horizon that cannot be is refused before anything runs.
    horizon = horizon_of(job)
    check_limits(job)
    # Adam asks for one gradient at a point, the others for many products.
    adjoint = Traced(keeps_slopes=job.correction.method != "adam")
    desired = jnp.asarray(job.path.positions)
    # A program beyond a joint's limit is refused before anything runs, too.
    check_joints(job, desired, is_joints=False)
    job, before = run_with_room(job, desired, adjoint, lambda message, share: None)
    rigid = before.rigid
    if throw:
        raise_unless_successful(before, job)
    weights = _weights(job, rigid, before)
    surface = job_surface(job, rigid)
    objective = job_objective(job, surface, weights)
    method = job_optimiser(job, objective, surface, adjoint)
    plant = TipPlant(job, adjoint, before.wall_share)
    problem = job_problem(job, plant, desired, before, weights)
    remaining = lambda m: remaining_error(objective, problem, m)
    record = CaseRecord(on_progress, on_checkpoint, resume)
    run = record.run
    run("uncorrected", GivenCommand(), problem)
    run("mirror", Mirror(), problem)
    mirror = job_mirror(plant, problem, before.is_cutting, horizon)
    run("mirror_iterated", mirror, problem)
    tips = clip_offset(desired, shaped_program(job, desired), problem.max_offset)
    run("input_shaper", GivenCommand(tips), problem)
    inverse = _inverse_drive(job, rigid.force, desired)
    tips = clip_offset(desired, inverse.tip, problem.max_offset)
    run("inverse_drive", GivenCommand(tips), problem)
    asked = job.correction.method
    if asked not in OPTIMISERS:
        check_joints(job, record.methods[asked].command, is_joints=False)
    if job.correction.command == "joint":
        problem = joint_problem(job, adjoint, desired, before, weights)
        start = inverse.motor_positions
    else:
        start = min(record.methods.values(), key=remaining).command
        method = preconditioned(method, job, desired)
    method = within_joint_limits(method, job, problem)
    path_first = None if horizon else for_the_path(method)
    if surface is not None and path_first is not None:
        rows = touching_rows(surface, np.asarray(desired))
        rows = rows.astype(problem.is_cutting.dtype)
        if job.correction.objective == "path":
            rows = np.maximum(problem.is_cutting, rows)
        touching = dataclasses.replace(problem, is_cutting=rows)
        first = remembering(path_first, "path_first", record)
        found = record.prepare("path_first", first, touching, start=start)
        given = GivenCommand(path_first.begin(problem, start))
        given = record.prepare("given_first", given, problem)
        closest = lambda m: remaining(m) + out_of_bounds(method, m)
        start = min((found, given), key=closest).command
    kept = keeping(job, method, adjoint, record, before.wall_share)
    run("corrected", kept, problem, start=start)
    return _finished(job, rigid, before, record, adjoint)


def _finished(
    job: Job,
    rigid: Any,
    before: Solution,
    record: CaseRecord,
    adjoint: AbstractAdjoint,
) -> Correction:
    """Check the command that is asked for, and simulate every case for the record."""
    asked, methods = job.correction.method, record.methods
    chosen = "corrected" if asked in OPTIMISERS else asked
    are_joints = {
        name: name == "corrected" and job.correction.command == "joint"
        for name in methods
    }
    check_joints(job, methods[chosen].command, is_joints=are_joints[chosen])
    cases = {
        name: _solution(job, rigid, method.command, adjoint, are_joints[name])
        for name, method in methods.items()
    }
    parts = path_parts(
        np.asarray(before.desired),
        np.asarray(before.is_cutting),
        job.cutter.nominal_radius,
        removed_volume=np.asarray(rigid.removed_volume),
    )
    return Correction(cases, methods, record.wall_time, parts, chosen)


def _weights(job: Job, rigid: Any, before: Solution) -> Float[np.ndarray, " step"]:
    """Return how much every row counts; refuse a path of which none does."""
    if not bool(jnp.any(before.is_cutting)):
        raise NothingToCorrect(
            "Argument `job` must have a program that cuts its stock, but the rigid "
            "tool removes nothing."
        )
    try:
        return job_weights(job, rigid, np.asarray(before.is_cutting))
    except ValueError as error:
        raise NothingToCorrect(str(error)) from error


@eqx.filter_jit
def _inverse_drive(
    job: Job, force: Float[Array, "step 3"], desired: Float[Array, "step 3"]
) -> Any:
    joints, _ = command_joints(job, desired)
    return inverse_drive(
        job.robot,  # pyright: ignore[reportArgumentType]
        joints,
        force,
        job.tooth_period,
        T_base_work=job.T_base_work,
        is_gravity_compensated=job.simulation.is_gravity_compensated,
    )


def _solution(
    job: Job, rigid: Any, command: Any, adjoint: AbstractAdjoint, is_joints: bool
) -> Solution:
    command = jnp.asarray(command)
    if not is_joints:
        return solve_command(job, rigid, command, adjoint)
    from ..robot import forward_kinematics

    # The tip positions that belong to commanded joints, for the record.
    T = jnp.asarray(job.T_base_work)
    tips = jax.vmap(lambda q: forward_kinematics(job.robot, q)[:3, 3])(command)  # pyright: ignore[reportArgumentType]
    tips = (tips - T[:3, 3][None]) @ T[:3, :3]
    return solve_command(job, rigid, tips, adjoint, joint_motors(job, command))
