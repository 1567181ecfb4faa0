"""Correcting a job: the baselines, then the best command that derivatives find."""

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows, readable_signature
from ...optimise import LeastSquaresStep
from ...process import ThroughPoses
from ...sim import JobKinematics, Solution, simulate_with_slot_growth
from ...toolpath import ContourStatistics
from ...workpiece import SurfaceError
from .._core.method import AbstractMethod, GivenCommand, MethodResult
from .._core.path_objective import AbstractObjective, check_objective
from .._core.path_segments import PathParts
from .._core.problem import Problem
from .._method.checkpoint import Arrays, OnCheckpoint
from .._method.gauss_newton import GaussNewton
from .._method.input_shaper import shaped_program
from .._method.inverse_drive import InverseDriveCommand, inverse_drive
from .._method.mirror import Mirror
from .._spline.projection import clip_offset
from .._surface.finished_surface import FinishedSurface
from .case_runner import CaseRecord, OnProgress
from .joint_limits import JointLimits
from .linear_job import prepare_linear_job
from .method import (
    OPTIMISERS,
    for_the_path,
    job_optimiser,
    out_of_bounds,
    within_joint_limits,
)
from .objective import (
    check_limits,
    job_objective,
    job_spline,
    job_surface,
    job_weights,
    remaining_error,
)
from .plants import (
    JointPlant,
    SolvedMotion,
    TipPlant,
    job_mirror,
    job_problem,
    joint_problem,
    solved_motion,
)
from .resumable import (
    SegmentRows,
    segment_rows,
    with_segment_checkpoints,
    with_step_checkpoints,
)

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
# Of a program that only passes over its stock.
NEVER_CUTS = (
    "Argument `job` must have a program that cuts its stock, but the rigid tool "
    "removes nothing."
)


class NothingToCorrect(ValueError):
    """Raise when a program never cuts, so that there is no error to correct."""


class Correction(eqx.Module):
    """A corrected job and what it was compared with.

    Attributes:
        cases: Solution of each case, by name, in the order of `CASES`.
        methods: What each method reported, by name; their errors are those of the rows
            that cut.
        wall_time: Time that each method took, compilation included [s]; that of the
            uncorrected case includes the rigid cut.
        path_parts: Part of the path to which each row belongs.
        chosen: Name of the case whose command is the corrected program.
    """

    cases: dict[str, Solution]
    methods: dict[str, MethodResult]
    wall_time: dict[str, float]
    path_parts: PathParts
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
        """Return the steps of the chosen method, without those that found its start."""
        return self.methods[self.chosen].history

    def surfaces(self) -> dict[str, SurfaceError]:
        """Compute the error of the machined surface of each case, by name.

        None where all of the stock was cut away.

        Raises:
            ValueError: The mesh of a surface is too large for the memory, or what is
                left of the stock is thinner than its spacing.
        """
        # All cases have one ideal: what a rigid machine leaves.
        ideal = self.before.rigid.stock
        if not bool(ideal.volume() > 0):
            return {}
        stocks = [solution.stock for solution in self.cases.values()]
        errors = SurfaceError.of_stocks(stocks, ideal, leaves_out_raw=True)
        return dict(zip(self.cases, errors, strict=True))

    def to_dataset(
        self, surfaces: dict[str, SurfaceError] | None = None
    ) -> "xarray.Dataset":
        """Return all cases on `case`, figures by part of the path, and costs.

        Args:
            surfaces: What `surfaces` has computed. If not given it is computed, and
                where it cannot be the attribute `surface_left_out` says why.
        """
        from .dataset import correction_dataset

        return correction_dataset(self, surfaces)


@readable_signature
def correct(
    job: Job,
    *,
    objective: AbstractObjective | None = None,
    throw: bool = True,
    on_predicted: Callable[[Solution], None] | None = None,
    on_progress: OnProgress | None = None,
    on_checkpoint: OnCheckpoint | None = None,
    resume: Arrays | None = None,
) -> Correction:
    """Predict, correct, and predict again.

    The best of the commands that the job compares starts the optimiser, and only a
    method that is asked for or compared runs. For the surface, or within bounds
    of it, a path that is corrected as a whole is first brought onto the desired one
    wherever it touches the surface: of the poses over a point only those about as deep
    as the deepest are known to a step.

    Args:
        job: The job; its machine must not be rigid.
        objective: The error that is to become small, if it is another one than the job
            knows; the path is then corrected as a whole, however long it is.
        throw: Whether to raise when the uncorrected run does not succeed.
        on_predicted: Called with the solution of the uncorrected program, before any
            method runs.
        on_progress: Called with a message and the rms contour error so far [m].
        on_checkpoint: Called with all that is needed to go on, plain arrays by name:
            after every method, every step of Gauss-Newton on a whole path, and every
            segment of a long one.
        resume: What it was called with for the same job and objective, to go on from
            there to the same result.

    Returns:
        The correction with all its cases.

    Raises:
        SimulationFailed: The run of the uncorrected program fails.
        NothingToCorrect: The program never cuts, or all that cuts has no weight; a
            `ValueError`.
        InfeasibleLimit: The program itself breaks a limit, or no correction holds all
            that is asked for; a `ValueError`.
        UnsuitableSettings: Knots, horizon or overlap do not suit the path, or no
            surface is left to correct; a `ValueError`.
        ValueError: The job has no robot or a command of its own, the objective is
            none, or JAX is not set up for its precision.

    Differentiability: runs on the host, not traceable.
    """
    job = job.with_precision()
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    if job.commanded is not None:
        raise ValueError("Argument `job` must not have a command of its own, but has.")
    check_objective(objective)
    # A horizon that cannot be is refused before anything runs.
    segments = segment_rows(job, has_own_objective=objective is not None)
    check_limits(job)
    adjoint = ThroughPoses()
    desired = jnp.asarray(job.path.positions)
    uses_linear = job.correction.method != "adam" and "corrected" in compared(job)
    if uses_linear and segments is None:
        prepare_linear_job(job)
    # A program beyond a joint's limit is refused before anything runs, too.
    JointLimits(job).check(desired, is_joints=False)
    record = CaseRecord(on_progress, on_checkpoint, resume)
    # The first case is this run: the methods need it before it is recorded.
    job, before = record.timed(
        lambda: simulate_with_slot_growth(
            job, desired, adjoint, lambda message, share: None
        )
    )
    rigid = before.rigid
    if throw:
        before.raise_unless_successful(job)
    if on_predicted is not None:
        on_predicted(before)
    is_optimised = "corrected" in compared(job)
    surface = job_surface(job, rigid, before.wall_share) if is_optimised else None
    weights = counting_weights(job, before, surface)
    plant = TipPlant(job, adjoint, before.wall_share, rigid)
    problem = job_problem(job, plant, desired, before, weights)
    task = _Task(job, plant, before, problem, segments, objective)
    # Settings that do not suit the job are refused before the baselines run.
    optimiser = _Optimiser(task, surface) if is_optimised else None
    inverse = None
    if job.robot is not None:
        inverse = _inverse_drive(job, rigid.force, desired)
    _run_baselines(task, record, inverse)
    if optimiser is not None:
        optimiser.run(record, inverse)
    return _finished(task, record)


class _Task(NamedTuple):
    """Task that every case of a correction shares."""

    job: Job
    plant: TipPlant
    before: Solution
    problem: Problem
    segments: SegmentRows | None
    objective: AbstractObjective | None


def compared(job: Job) -> tuple[str, ...]:
    """Return the cases of a job's correction, in the order of `CASES`."""
    settings = job.correction
    asked = "corrected" if settings.method in OPTIMISERS else settings.method
    cases = {"uncorrected", "mirror", "inverse_drive", asked}
    if settings.compare == "all":
        cases = set(CASES)
    if job.robot is None:
        # The drives of other machines are not known.
        cases -= {"inverse_drive"}
    return tuple(case for case in CASES if case in cases)


def _run_baselines(
    task: _Task, record: CaseRecord, inverse: InverseDriveCommand | None
) -> None:
    """Run the cases that need no optimiser.

    The one that is asked for is refused as soon as it is found.
    """
    job, problem = task.job, task.problem
    cases = compared(job)
    known = solved_motion(task.before)

    def run(name: str, method: AbstractMethod) -> None:
        record.run(name, method, problem)
        if name == job.correction.method:
            command = record.methods[name].command
            JointLimits(job).check(command, is_joints=False)

    run("uncorrected", GivenCommand(motion=known))
    run("mirror", Mirror(before=known))
    if "mirror_iterated" in cases:
        segment = None if task.segments is None else task.segments.length
        run("mirror_iterated", job_mirror(problem, task.before, segment))
    desired, bound = jnp.asarray(problem.desired), problem.max_offset
    if "input_shaper" in cases:
        tips = clip_offset(desired, shaped_program(job, desired), bound)
        run("input_shaper", GivenCommand(tips))
    if inverse is not None:
        tips = clip_offset(desired, inverse.tip, bound)
        run("inverse_drive", GivenCommand(tips))


class _Optimiser:
    """The case that an optimiser finds, from the best of those before."""

    def __init__(self, task: _Task, surface: FinishedSurface | None):
        job = task.job
        self.task, self.surface = task, surface
        weights = np.asarray(task.problem.is_cutting)
        objective = task.objective
        if objective is None:
            objective = job_objective(job, self.surface, weights)
        self.objective = objective
        self.method = job_optimiser(job, self.objective, self.surface, task.plant)

    def run(self, record: CaseRecord, inverse: InverseDriveCommand | None) -> None:
        """Add the case to those of a record."""
        job, before, problem = self.task.job, self.task.before, self.task.problem
        adjoint = self.task.plant.adjoint
        method = self.method
        if job.correction.command == "joint":
            assert inverse is not None
            problem = joint_problem(job, adjoint, before, problem)
            start = inverse.motor_positions
        else:
            start = min(record.methods.values(), key=self._remaining).command
            start = _spread(job, start)
        method = within_joint_limits(method, job, problem)
        path_first = None if self.task.segments else for_the_path(method)
        if path_first is not None:
            start = self._on_the_path(record, path_first, problem, start)
        plant = problem.plant
        assert isinstance(plant, TipPlant | JointPlant)
        kept = with_segment_checkpoints(
            method, plant.pieces, record, self.task.segments
        )
        record.run("corrected", kept, problem, start=start)

    def _on_the_path(
        self,
        record: CaseRecord,
        path_first: GaussNewton,
        problem: Problem,
        start: FloatRows,
    ) -> FloatRows:
        """Return a start with the rows that touch the surface on the path."""
        assert self.surface is not None
        rows = self.surface.touching_rows(np.asarray(problem.desired))
        rows = rows.astype(problem.is_cutting.dtype)
        if self.task.job.correction.objective == "path":
            rows = np.maximum(problem.is_cutting, rows)
        touching = dataclasses.replace(problem, is_cutting=rows)
        first = with_step_checkpoints(path_first, "start_on_path", record)
        found = record.prepare("start_on_path", first, touching, start=start)
        given = GivenCommand(path_first.begin(problem, start))
        given = record.prepare("start_as_given", given, problem)
        closest = lambda m: self._remaining(m) + out_of_bounds(self.method, m)
        return min((found, given), key=closest).command

    def _remaining(self, found: MethodResult) -> float:
        return remaining_error(self.objective, self.task.problem, found)


def _spread(job: Job, start: FloatRows) -> FloatRows:
    """Return a start with the random offsets that a job asks for."""
    settings = job.correction
    if settings.start_spread == 0.0:
        return start
    spline = job_spline(job)
    stream = np.random.default_rng(settings.start_seed)
    draws = stream.normal(size=(spline.coefficient_count, start.shape[1]))
    offsets = spline.offsets(jnp.asarray(settings.start_spread * draws))
    return np.asarray(start) + np.asarray(offsets, start.dtype)


def _finished(task: _Task, record: CaseRecord) -> Correction:
    """Check what an optimiser found, and collect the solutions of all cases."""
    job, before, methods = task.job, task.before, record.methods
    chosen = job.correction.method
    if chosen in OPTIMISERS:
        chosen = "corrected"
        are_joints = job.correction.command == "joint"
        JointLimits(job).check(methods[chosen].command, is_joints=are_joints)
    cases = {name: _solution(task, name, found) for name, found in methods.items()}
    # What a method minimises also counts rows that only pass over the surface.
    cuts = np.asarray(before.is_cutting)
    methods = {
        name: dataclasses.replace(
            found,
            measures=ContourStatistics.of(np.linalg.norm(found.contour, axis=1), cuts),
        )
        for name, found in methods.items()
    }
    parts = PathParts.of_path(
        np.asarray(before.desired),
        np.asarray(before.is_cutting),
        job.cutter.nominal_radius,
        removed_volume=np.asarray(before.rigid.removed_volume),
    )
    return Correction(cases, methods, record.wall_time, parts, chosen)


def _solution(task: _Task, name: str, found: MethodResult) -> Solution:
    """Return the solution of a case; one that was taken up again has to be run."""
    if isinstance(found.motion, SolvedMotion):
        return found.motion.solution
    job, before = task.job, task.before
    plant: TipPlant | JointPlant = task.plant
    if name == "corrected" and job.correction.command == "joint":
        plant = JointPlant(job, plant.adjoint, before.wall_share, before.rigid)
    motion = plant.run(found.command)
    assert isinstance(motion, SolvedMotion)
    return motion.solution


def counting_weights(
    job: Job, before: Solution, surface: FinishedSurface | None
) -> Float[np.ndarray, " step"]:
    """Return how much every row counts.

    Raises:
        NothingToCorrect: None does.
    """
    if not np.any(before.is_cutting):
        raise NothingToCorrect(NEVER_CUTS)
    try:
        return job_weights(job, before.rigid, np.asarray(before.is_cutting), surface)
    except ValueError as error:
        raise NothingToCorrect(str(error)) from error


def _inverse_drive(
    job: Job, force: Float[Array, "step 3"], desired: Float[Array, "step 3"]
) -> InverseDriveCommand:
    assert job.robot is not None
    # A robot without inertia and damping is one that moves without end slowly.
    is_slow = job.simulation.mode == "quasistatic"
    return _driven(
        job.robot,
        JobKinematics(job).joints(desired).positions,
        force,
        math.inf if is_slow else job.tooth_period,
        T_base_work=job.T_base_work,
        is_gravity_compensated=job.simulation.is_gravity_compensated,
    )


_driven = eqx.filter_jit(inverse_drive)
