"""Correcting a job: the baselines, then the best command that derivatives find."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job, check_job
from ..._types import FloatRows, FloatRows3, readable_signature
from ...optimise import LeastSquaresStep
from ...process import ThroughPoses
from ...settings.correction import GaussNewtonSettings
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
from .._method.optimiser import AbstractOptimiser
from .._segments.receding_horizon import RecedingHorizon
from .._spline.projection import clip_offset
from .case_runner import CaseRecord, OnProgress
from .correction_problem import CorrectionProblem, checked_job
from .joint_limits import JointLimits
from .linear_job import prepare_linear_job
from .method import (
    job_optimiser,
    within_joint_limits,
)
from .objective import check_limits, job_ensemble, job_spline
from .plants import (
    JointPlant,
    SolvedMotion,
    TipPlant,
    job_mirror,
    solved_motion,
    with_smooth_drives,
)
from .segment_rows import SegmentRows

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
        """Solution of the uncorrected program."""
        return self.cases["uncorrected"]

    @property
    def after(self) -> Solution:
        """Solution of the corrected program."""
        return self.cases[self.chosen]

    @property
    def mirror(self) -> Solution:
        """Solution of the one-shot mirror."""
        return self.cases["mirror"]

    @property
    def commanded(self) -> Float[Array, "step 3"]:
        """Corrected tip positions [m], shape (step, 3)."""
        return self.after.commanded

    @property
    def history(self) -> tuple[LeastSquaresStep, ...]:
        """Steps of the chosen method, without those that found its start."""
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
        """All cases on `case`, figures by part of the path, and costs.

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
    start: FloatRows3 | None = None,
    disturbance: FloatRows3 | None = None,
    machines: Sequence[Job] | None = None,
    throw: bool = True,
    on_predicted: Callable[[Solution], None] | None = None,
    on_progress: OnProgress | None = None,
    on_run_progress: Callable[[str, float], None] | None = None,
    on_step_progress: Callable[[str, float], None] | None = None,
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
        start: Tip positions from which the optimiser begins [m], shape (step, 3), such
            as those that cut the last part; no other method then runs. By default the
            best of the commands that the job compares.
        disturbance: What the machine does beyond its model, as it was measured [m],
            shape (step, 3); see `Path.disturbance`, which it takes the place of.
        machines: The program on machines as they may be, such as `drawn_machine` draws:
            the mean square error over them becomes small, or that of the worst, instead
            of that of draws by `[correction.uncertainty]`. The path is then corrected
            as a whole.
        throw: Whether to raise when the uncorrected run does not succeed.
        on_predicted: Called with the solution of the uncorrected program, before any
            method runs.
        on_progress: Called with a message and the rms contour error so far [m].
        on_run_progress: Called as by `simulate`, while the uncorrected program runs.
        on_step_progress: Called with a message and the share of the present step, while
            Gauss-Newton computes one.
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
        InfeasibleLimit: The program itself breaks a limit, or no correction keeps all
            that is asked for; a `ValueError`.
        UnsuitableSettings: Knots, horizon or overlap do not suit the path, or no
            surface is left to correct; a `ValueError`.
        TypeError: Argument `job` is none.
        ValueError: The job has no robot, a command of its own, or a path whose rows
            are not a tooth period apart, the objective is none, machines are given to a
            method that takes one only, or JAX is not set up for its precision.

    Differentiability: runs on the host, not traceable.
    """
    check_job(job)
    job = checked_job(_disturbed(job, disturbance))
    if start is not None:
        start = _checked_start(job, start)
    if job.commanded is not None:
        raise ValueError("Argument `job` must not have a command of its own, but has.")
    check_objective(objective)
    _check_machines(job, machines)
    # A horizon that cannot be is refused before anything runs.
    takes_whole = objective is not None or machines is not None
    segments = SegmentRows.of_job(job, has_own_objective=takes_whole)
    check_limits(job)
    adjoint = ThroughPoses()
    desired = jnp.asarray(job.path.positions)
    is_optimised = "corrected" in compared(job)
    is_linear = job.correction.optimiser.uses_linear_run
    if is_optimised and segments is None and is_linear:
        prepare_linear_job(with_smooth_drives(job))
    # A program beyond a joint's limit is refused before anything runs, too.
    JointLimits(job).check(desired, is_joints=False)
    record = CaseRecord(on_progress, on_checkpoint, resume)
    # The first case is this run: the methods need it before it is recorded.
    with record.timed_preparation():
        job, before = jax.block_until_ready(
            simulate_with_slot_growth(
                job, desired, adjoint, on_run_progress or (lambda message, share: None)
            )
        )
    if throw:
        before.raise_unless_successful(job)
    if on_predicted is not None:
        on_predicted(before)
    task = CorrectionProblem.of(
        job, before, adjoint, objective=objective, is_optimised=is_optimised
    )
    # Settings that do not suit the job are refused before the baselines run.
    method = None
    if is_optimised:
        method = job_optimiser(job, task.objective, task.surface, task.plant)
        if machines is not None:
            ensemble = job_ensemble(job, task.plant, machines)
            method = dataclasses.replace(method, ensemble=ensemble)
        if isinstance(method, GaussNewton):
            method = dataclasses.replace(method, on_step=on_step_progress)
    inverse = None
    if job.robot is not None and start is None:
        # A robot without inertia and damping is one that moves without end slowly.
        is_slow = not job.simulation.mode.vibrates
        kinematics = JobKinematics(job)
        inverse = _inverse_drive(
            kinematics.robot,
            kinematics.joints(desired).positions,
            before.rigid.force,
            math.inf if is_slow else job.tooth_period,
            T_base_work=kinematics.T_base_work,
            is_gravity_compensated=job.simulation.is_gravity_compensated,
        )
    if start is None:
        _run_baselines(task, record, segments, inverse)
        start = _best_start(task, record, inverse)
    else:
        given = GivenCommand(motion=solved_motion(before))
        record.run("uncorrected", given, task.tips)
    if method is not None:
        _run_optimiser(task, record, method, segments, start)
    return _compared_cases(task, record)


def compared(job: Job) -> tuple[str, ...]:
    """Cases of a job's correction, in the order of `CASES`."""
    settings = job.correction
    cases = {"uncorrected", "mirror", "inverse_drive", settings.method.case}
    if settings.compare == "all":
        cases = set(CASES)
    if job.robot is None:
        # The drives of other machines are not known.
        cases -= {"inverse_drive"}
    return tuple(case for case in CASES if case in cases)


def _run_baselines(
    task: CorrectionProblem,
    record: CaseRecord,
    segments: SegmentRows | None,
    inverse: InverseDriveCommand | None,
) -> None:
    """Run the cases that need no optimiser.

    The one that is asked for is refused as soon as its command is known.
    """
    job, problem = task.job, task.tips
    before, desired = solved_motion(task.before), jnp.asarray(problem.desired)
    methods: dict[str, AbstractMethod] = {
        "uncorrected": GivenCommand(motion=before),
        "mirror": Mirror(before=before),
    }
    cases = compared(job)
    if "mirror_iterated" in cases:
        length = None if segments is None else segments.length
        methods["mirror_iterated"] = job_mirror(problem, task.before, length)
    tips = {}
    if "input_shaper" in cases:
        tips["input_shaper"] = shaped_program(job, desired)
    if inverse is not None:
        tips["inverse_drive"] = inverse.tip
    for name, command in tips.items():
        command = clip_offset(desired, command, problem.max_offset)
        methods[name] = GivenCommand(command)
    for name, method in methods.items():
        command = record.run(name, method, problem).command
        if name == job.correction.method.case:
            JointLimits(job).check(command, is_joints=False)


def _run_optimiser(
    task: CorrectionProblem,
    record: CaseRecord,
    method: AbstractOptimiser,
    segments: SegmentRows | None,
    start: FloatRows,
) -> None:
    """Run the optimiser from a start: tips, or joints where these are commanded.

    Raises:
        InfeasibleLimit: The program leaves the joints no room, or no correction holds
            all limits.
    """
    job, problem = task.job, task.tips
    if job.correction.command == "joint":
        problem = task.in_joints()
    else:
        start = _spread(job, start)
    method = within_joint_limits(method, job, problem)
    # A segment begins where the one before it has ended.
    path_first = None if segments else method.towards_path()
    if path_first is not None:
        start = _start_on_path(task, record, method, path_first, problem, start)
    search: AbstractOptimiser | RecedingHorizon = method
    if segments is not None:
        plant = problem.plant
        assert isinstance(plant, TipPlant | JointPlant)
        assert isinstance(method, GaussNewton)
        search = RecedingHorizon(
            plant.pieces, method, horizon=segments.length, overlap=segments.overlap
        )
    record.run("corrected", search, problem, is_search=True, start=start)


def _best_start(
    task: CorrectionProblem, record: CaseRecord, inverse: InverseDriveCommand | None
) -> FloatRows:
    """Best command of the cases so far; the inverse drive's where joints are told."""
    if task.job.correction.command == "joint":
        assert inverse is not None
        return inverse.motor_positions
    return min(record.methods.values(), key=task.remaining_error).command


def _disturbed(job: Job, disturbance: FloatRows3 | None) -> Job:
    """Job with a measured disturbance, if one is given."""
    if disturbance is None:
        return job
    path = dataclasses.replace(job.path, disturbance=np.asarray(disturbance))
    return dataclasses.replace(job, path=path)


def _checked_start(job: Job, start: FloatRows3) -> FloatRows3:
    """Start of the optimiser, in the precision of the job.

    Raises:
        ValueError: It has another shape than the path, joints are commanded, or the job
            asks for no optimiser.
    """
    shape = (job.path.step_count, 3)
    if np.shape(start) != shape:
        raise ValueError(
            f"Argument `start` must have shape {shape}, a row for each of the path's, "
            f"but has {np.shape(start)}."
        )
    if not job.correction.method.is_optimiser or job.correction.command == "joint":
        raise ValueError(
            "Argument `start` must be None unless the job asks for an optimiser that "
            "commands tips."
        )
    return np.asarray(start, np.dtype(job.simulation.precision))


def _check_machines(job: Job, machines: Sequence[Job] | None) -> None:
    """Raise if machines are given that do not run the program, or to another method.

    Raises:
        ValueError: That is so.
    """
    settings = job.correction
    if machines is None:
        return
    if not isinstance(settings.method, GaussNewtonSettings) or (
        settings.command == "joint"
    ):
        raise ValueError(
            'Argument `machines` must be None unless the job asks for "gauss_newton" '
            "that commands tips."
        )
    rows = {one.path.step_count for one in machines}
    if rows != {job.path.step_count}:
        raise ValueError(
            f"Argument `machines` must be jobs with the path of `job`, of "
            f"{job.path.step_count} rows, one at least, but has {sorted(rows)}."
        )


def _start_on_path(
    task: CorrectionProblem,
    record: CaseRecord,
    method: AbstractOptimiser,
    path_first: AbstractOptimiser,
    problem: Problem,
    start: FloatRows,
) -> FloatRows:
    """Start with the rows that touch the surface on the path, if that is closer."""
    assert task.surface is not None
    rows = task.surface.touching_rows(np.asarray(problem.desired))
    rows = rows.astype(problem.is_cutting.dtype)
    if task.job.correction.objective.counts_contact:
        rows = np.maximum(problem.is_cutting, rows)
    touching = dataclasses.replace(problem, is_cutting=rows)
    on_path = record.run(
        "start_on_path",
        path_first,
        touching,
        is_case=False,
        is_search=True,
        start=start,
    )
    given = GivenCommand(path_first.begin(problem, start))
    given = record.run("start_as_given", given, problem, is_case=False)
    closest = lambda m: task.remaining_error(m) + method.excess(m.motion)
    return min((on_path, given), key=closest).command


def _spread(job: Job, start: FloatRows) -> FloatRows:
    """Start with the random offsets that a job asks for."""
    settings = job.correction
    if settings.start_spread == 0.0:
        return start
    spline = job_spline(job)
    stream = np.random.default_rng(settings.start_seed)
    draws = stream.normal(size=(spline.coefficient_count, start.shape[1]))
    offsets = spline.offsets(jnp.asarray(settings.start_spread * draws))
    return np.asarray(start) + np.asarray(offsets, start.dtype)


def _compared_cases(task: CorrectionProblem, record: CaseRecord) -> Correction:
    """Correction with the solutions of all cases, its joints within their limits."""
    job, before, outcomes = task.job, task.before, record.methods
    chosen = job.correction.method.case
    if job.correction.method.is_optimiser:
        are_joints = job.correction.command == "joint"
        JointLimits(job).check(outcomes[chosen].command, is_joints=are_joints)
    cases, methods = {}, {}
    # What a method minimises also counts rows that only pass over the surface.
    cuts = np.asarray(before.is_cutting)
    for name, outcome in outcomes.items():
        motion = outcome.motion
        if not isinstance(motion, SolvedMotion):
            # The outcome is from before an interruption; that of an optimiser, which
            # may command joints, is never stored.
            assert name != "corrected"
            motion = task.plant.run(outcome.command)
            assert isinstance(motion, SolvedMotion)
        cases[name] = motion.solution
        error = np.linalg.norm(outcome.contour, axis=1)
        measures = ContourStatistics.of(error, cuts)
        methods[name] = dataclasses.replace(outcome, measures=measures)
    parts = PathParts.of_path(
        np.asarray(before.desired),
        np.asarray(before.is_cutting),
        job.cutter.nominal_radius,
        removed_volume=np.asarray(before.rigid.removed_volume),
    )
    return Correction(cases, methods, record.wall_time, parts, chosen)


_inverse_drive = eqx.filter_jit(inverse_drive)
