"""Correcting a job: the baselines, then the best command that derivatives find."""

import dataclasses
import time
from collections.abc import Callable
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
    command_motors,
    joint_motors,
    raise_unless_successful,
    rigid_cut,
    run_motors,
    solve_command,
    with_precision,
)
from ._inverse_drive import inverse_drive
from ._job_method import (
    OPTIMISERS,
    for_the_path,
    job_optimiser,
    preconditioned,
    within_joint_limits,
)
from ._job_pieces import with_rows
from ._joint_limits import check_joints
from ._kept import horizon_of, keeping
from ._least_squares_records import LeastSquaresStep
from ._memory import (
    Arrays,
    OnCheckpoint,
    below,
    pack_method,
    under,
    unpack_method,
)
from ._method import AbstractMethod, Corrected, GivenCommand
from ._mirror import IteratedMirror, Mirror, SampledMirror
from ._parts import path_parts
from ._problem import Motion, Problem
from ._projection import clip_offset
from ._setup import (
    check_limits,
    job_objective,
    job_surface,
    job_weights,
    remaining_error,
)
from ._surface_objective import FinishedSurface, touching_rows

if TYPE_CHECKING:
    import xarray

# Called with a message and the rms contour error so far [m].
OnProgress = Callable[[str, float], None]

CASES = ("uncorrected", "mirror", "mirror_iterated", "inverse_drive", "corrected")


class NothingToCorrect(ValueError):
    """Raise when a program never cuts, so that there is no error to correct."""


class TipPlant(eqx.Module):
    """A job as a plant that is commanded by tip positions [m]."""

    job: Job
    adjoint: AbstractAdjoint

    def __call__(self, command: Float[Array, "step 3"]) -> Motion:
        """Return the motion that follows a command, shape (step, 3)."""
        motors, _ = command_motors(self.job, command)
        ran = run_motors(self.job, motors, self.adjoint)
        return Motion(ran.actual, ran.force)


class JointPlant(eqx.Module):
    """A job as a plant that is commanded by joint positions [rad or m].

    The controller adds the gravity sag, as it does for tip positions.
    """

    job: Job
    adjoint: AbstractAdjoint

    def __call__(self, command: Float[Array, "step joint"]) -> Motion:
        """Return the motion that follows a command, shape (step, joint)."""
        ran = run_motors(self.job, joint_motors(self.job, command), self.adjoint)
        return Motion(ran.actual, ran.force)


class Correction(eqx.Module):
    """A corrected job and what it was compared with.

    Attributes:
        cases: Solution of each case, by name, in the order of `CASES`.
        methods: What each method reported, by name.
        wall_time: Time that each method took, compilation included [s].
        path_part: Part of the path of each row, see `path_parts`, shape (step,).
        surface: The surface as it should be; None where it is not walls and floors.
        chosen: Name of the case whose command is the corrected program.
    """

    cases: dict[str, Solution]
    methods: dict[str, Corrected]
    wall_time: dict[str, float]
    path_part: Int[np.ndarray, " step"]
    surface: FinishedSurface | None
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
        """Return the steps of the optimiser."""
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

    The mirror, the iterated mirror and the inverse drive are always computed; the
    best of them starts the optimiser. For the surface it first brings all rows that
    touch the surface onto the path: of the poses over a point only the deepest leaves
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
    adjoint = Traced()
    rigid = rigid_cut(job, adjoint)
    desired = jnp.asarray(job.path.positions)
    before = solve_command(job, rigid, desired, adjoint)
    if throw:
        raise_unless_successful(before)
    weights = _weights(job, rigid, before)
    surface = job_surface(job, rigid)
    objective = job_objective(job, surface, weights)
    method = job_optimiser(job, objective, surface, adjoint)
    problem = _problem(job, TipPlant(job, adjoint), desired, before, weights)
    remaining = lambda m: remaining_error(objective, problem, m)
    record = _Record(on_progress, on_checkpoint, resume)
    run = record.run
    run("uncorrected", GivenCommand(), problem)
    run("mirror", Mirror(), problem)
    mirror = _mirror(job, problem, before.is_cutting, horizon, adjoint)
    run("mirror_iterated", mirror, problem)
    inverse = _inverse_drive(job, rigid.force, desired)
    tips = clip_offset(desired, inverse.tip, problem.max_offset)
    run("inverse_drive", GivenCommand(tips), problem)
    if job.correction.command == "joint":
        problem = _joint_problem(job, adjoint, desired, before, weights)
        start = inverse.motor_positions
    else:
        start = min(record.methods.values(), key=remaining).command
        method = preconditioned(method, job, desired)
    method = within_joint_limits(method, job, problem)
    if surface is not None and (path_first := for_the_path(method)) is not None:
        rows = touching_rows(surface, np.asarray(desired))
        touching = dataclasses.replace(
            problem, is_cutting=rows.astype(problem.is_cutting.dtype)
        )
        found = record.prepare("path_first", path_first, touching, start=start)
        given = GivenCommand(path_first.begin(problem, start))(problem)
        start = min((found, given), key=remaining).command
    kept = keeping(job, method, adjoint, record.saved, on_checkpoint, resume)
    run("corrected", kept, problem, start=start)
    asked = job.correction.method
    chosen = "corrected" if asked in OPTIMISERS else asked
    methods = record.methods
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
        np.asarray(desired),
        np.asarray(before.is_cutting),
        job.cutter.nominal_radius,
        removed_volume=np.asarray(rigid.removed_volume),
    )
    return Correction(cases, methods, record.wall_time, parts, surface, chosen)


class _Record:
    """Runs methods one after another, keeps what they found, and tells of it."""

    def __init__(
        self,
        on_progress: OnProgress | None,
        on_checkpoint: OnCheckpoint | None,
        resume: Arrays | None,
    ):
        self.methods: dict[str, Corrected] = {}
        self.wall_time: dict[str, float] = {}
        self.saved: dict[str, np.ndarray] = {}
        self._on_progress = on_progress
        self._on_checkpoint = on_checkpoint
        self._resume = resume

    def prepare(
        self, name: str, method: Any, problem: Problem, **options: Any
    ) -> Corrected:
        """Return what a method finds that is no case, only a start."""
        self.run(name, method, problem, **options)
        del self.wall_time[name]
        return self.methods.pop(name)

    def run(self, name: str, method: Any, problem: Problem, **options: Any) -> None:
        """Run a method, or take up what it found before an interruption."""
        start = time.perf_counter()
        kept = unpack_method(below(f"method/{name}", self._resume), problem)
        if kept is not None:
            self.methods[name], self.wall_time[name] = kept
        else:
            found = method(problem, on_progress=self._on_progress, **options)
            self.methods[name] = found
            self.wall_time[name] = time.perf_counter() - start
        if self._on_checkpoint is not None and name != "corrected":
            packed = pack_method(self.methods[name], self.wall_time[name])
            self.saved.update(under(f"method/{name}", packed))
            before = {} if self._resume is None else self._resume
            self._on_checkpoint({**before, **self.saved})
        if self._on_progress is not None:
            self._on_progress(name, self.methods[name].measures.rms)


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


def _mirror(
    job: Job,
    problem: Problem,
    is_cutting: Array,
    horizon: tuple[int, int] | None,
    adjoint: AbstractAdjoint,
) -> AbstractMethod:
    """Return the iterated mirror; on a long path its grid sees the first that cuts.

    The grid runs some hundred times, which on the whole path would cost more than the
    optimiser.
    """
    if horizon is None:
        return IteratedMirror()
    first = int(np.flatnonzero(is_cutting)[0])
    rows = slice(min(first + horizon[0], job.path.step_count))
    # Where none of these rows counts, the filter that suits the arm is found all the
    # same from how they cut.
    weights = problem.is_cutting[rows]
    if not np.any(weights):
        weights = np.asarray(is_cutting)[rows].astype(weights.dtype)
    part = with_rows(job, np.arange(job.path.step_count)[rows])
    sample = dataclasses.replace(
        problem,
        plant=TipPlant(part, adjoint),
        nominal=problem.nominal[rows],
        desired=problem.desired[rows],
        is_cutting=weights,
    )
    return SampledMirror(sample)


def _problem(
    job: Job,
    plant: Any,
    nominal: Float[Array, "step axis"],
    before: Solution,
    weights: Float[np.ndarray, " step"],
) -> Problem:
    return Problem(
        plant=plant,
        nominal=np.asarray(nominal),
        desired=np.asarray(before.desired),
        is_cutting=weights.astype(np.asarray(nominal).dtype),
        time_step=float(job.tooth_period),
        max_offset=float(job.correction.max_offset),
    )


def _joint_problem(
    job: Job,
    adjoint: AbstractAdjoint,
    desired: Float[Array, "step 3"],
    before: Solution,
    weights: Float[np.ndarray, " step"],
) -> Problem:
    """Return the problem in joint positions, bounded like the tip at its far end."""
    from ..robot import jacobian

    nominal, _ = command_joints(job, desired)
    J = np.asarray(jacobian(job.robot, nominal[0]))[:3]  # pyright: ignore[reportArgumentType]
    lever = np.linalg.norm(J, axis=0).max()
    problem = _problem(job, JointPlant(job, adjoint), nominal, before, weights)
    bound = float(job.correction.max_offset) / lever
    return eqx.tree_at(lambda p: p.max_offset, problem, np.asarray(bound))


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
