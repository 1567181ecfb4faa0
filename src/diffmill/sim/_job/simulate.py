"""Simulating a job: the rigid cut first, then the robot that cuts."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import (
    Arrays,
    cast_floats,
    first_rows,
    has_values,
    is_traced,
    on_device,
)
from ..._job import Job, check_job
from ..._messages import html_rows
from ..._padding import LONGEST, pad_rows
from ..._result import RESULTS, SimulationFailed
from ..._types import FloatRows, FloatRows3, readable_signature
from ...numerics import CachedJit
from ...process import (
    AbstractAdjoint,
    FrozenStock,
    Process,
    ThroughRays,
    choose_engagement,
)
from ...robot import Controller, Robot
from ...settings.base import builds
from ...settings.simulation import DynamicSettings, QuasistaticSettings
from ...toolpath import ContourStatistics, Path
from ...workpiece import Pose, Stock
from .._machine._integrator.choose import make_integrator
from .._machine.commands import JobKinematics
from .._machine.elastic import ElasticArm
from .._machine.machine import PendingRemoval, Removal, Run
from .._machine.modal import ModalMachine
from .._machine.quasi_static import QuasiStaticArm
from .._machine.rigid import Rigid
from .checkpoint import OnCheckpoint, RunCheckpoint
from .failure import troubles_of
from .long_run import Followed, LongRun
from .segments import SegmentPlan
from .walls import WallRows

if TYPE_CHECKING:
    import pandas
    import xarray

# More intervals than this on a ray are no pocket but a fault of the program.
_MOST_INTERVALS = 128
# Called between the parts of a run with a message and the share done.
OnProgress = Callable[[str, float], None]


class Solution(eqx.Module):
    """Solution of a job; rows are the tooth instants.

    Attributes:
        time: [s], shape (step,).
        desired: Where the tip should be, in `work` [m], shape (step, 3).
        commanded: What the program says, without gravity sag [m], shape (step, 3).
        actual: Where the tip is [m], shape (step, 3).
        force: Mean force on the tool over the period before [N], shape (step, 3).
        force_range: Least and largest force at any angle of that period [N], shape
            (step, 2, 3); its derivative is zero.
        spindle_torque: Mean torque that the spindle needs over that period [N m], shape
            (step,); times the spindle speed it is the power. Its derivative is zero.
        removed_volume: Volume that each pose removes [m^3], shape (step,).
        shank_volume: What of it the shank above the flutes takes [m^3], shape (step,).
        surface_deviation: Actual - desired at the instant, in the period before, at
            which a tooth makes the wall [m], shape (step, 3).
        wall_share: When in that period it does, see `wall_shares`, shape (step,).
        contour_error: Distance to the desired polyline of the tip with that deviation
            [m], shape (step,).
        is_cutting: Whether the rigid tool cuts in the period before, shape (step,).
        motor_positions: What the motors do of their command [rad or m], shape (step,
            joint); None without a robot.
        joint_positions: [rad or m], shape (step, joint); None without a robot.
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        has_failed: Whether a flag was up after each step, shape (step,).
        is_reached: Whether the robot reaches what is commanded, shape (step,); True for
            a rigid machine.
        stock: The stock after the last pose.
        is_engagement_update: Whether the period before had an engagement update, shape
            (step,); None if each has one.
        engagement_force_error: Estimated error of the force by reuse of the engagement
            [N], shape (step,); None if each period has its update.
        rigid: The process alone on the desired path; its stock is as it should be, that
            of a cutter without run-out.
        result: Outcome of the run.
        joint_names: Order of the joints.
        joint_units: "rad" or "m", per joint.
    """

    time: Float[Array, " step"]
    desired: Float[Array, "step 3"]
    commanded: Float[Array, "step 3"]
    actual: Float[Array, "step 3"]
    force: Float[Array, "step 3"]
    force_range: Float[Array, "step 2 3"]
    spindle_torque: Float[Array, " step"]
    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    surface_deviation: Float[Array, "step 3"]
    wall_share: Float[Array, " step"]
    contour_error: Float[Array, " step"]
    is_cutting: Bool[Array, " step"]
    motor_positions: Float[Array, "step joint"] | None
    joint_positions: Float[Array, "step joint"] | None
    initial_overlap_volume: Float[Array, ""]
    has_failed: Bool[Array, " step"]
    is_reached: Bool[Array, " step"]
    stock: Stock
    rigid: Run
    result: RESULTS
    joint_names: tuple[str, ...] = eqx.field(static=True)
    joint_units: tuple[str, ...] = eqx.field(static=True, default=())
    is_engagement_update: Bool[Array, " step"] | None = None
    engagement_force_error: Float[Array, " step"] | None = None

    @staticmethod
    def of_command(
        job: Job,
        rigid: Run,
        commanded: Float[Array, "step 3"],
        adjoint: AbstractAdjoint,
        motors: FloatRows | None = None,
        *,
        plan: SegmentPlan | None = None,
    ) -> "Solution":
        """Return the solution of a command, given the rigid cut of the desired path.

        Args:
            job: The job, in its precision.
            rigid: `rigid_cut(job, ...)`.
            commanded: Tip positions that the program says [m], shape (step, 3).
            adjoint: How to differentiate through the removal.
            motors: Commanded motor positions that override those of the tips [rad or
                m], shape (step, joint).
            plan: How a long path is run in segments.

        Returns:
            The solution.

        Raises:
            ValueError: A command has another shape.

        Differentiability: as `simulate`.
        """
        count, dtype = job.path.step_count, np.dtype(job.simulation.precision)
        commanded = _checked(commanded, "commanded", (count, 3), dtype)
        if motors is not None:
            joints = 3 if job.robot is None else len(job.robot.joint_names)
            motors = _checked(motors, "motors", (count, joints), dtype)
        given = job, rigid, commanded, motors
        needed = _needed(adjoint, given)
        plan = SegmentPlan() if plan is None else plan
        is_long = plan.suits(job.path, given)
        build = MachiningProblem.of if is_long else MachiningProblem.padded
        problem = build(job, needed)
        steps = problem.path.step_count
        tips = on_device(pad_rows(commanded, steps))
        is_reached = on_device(np.ones(steps, bool))
        if motors is not None:
            motors = on_device(pad_rows(motors, steps))
        elif problem.kinematics is not None:
            motors, is_reached = problem.kinematics.motors(tips)
        if is_long:
            long_run = LongRun(problem, plan)
            ran, walls, motors = long_run.follow(rigid.stock, tips, motors)
        else:
            ran, walls, motors = _follow(problem, rigid.stock, tips, motors)
            ran = ran.finished(_remove_pending(problem.process, ran.pending()))
            ran = ran.first(count)
            walls, motors, is_reached = first_rows((walls, motors, is_reached), count)
        walls = jax.tree.map(on_device, walls)
        motors = None if motors is None else on_device(motors)
        # On the host, since a device compiles these for every length.
        xp = jnp if is_traced((ran, rigid, is_reached)) else np
        is_cutting = xp.any(xp.asarray(rigid.force) != 0, axis=1)
        updates = ran.engagement_updates
        has_failed = xp.asarray(ran.has_failed) | xp.asarray(rigid.has_failed)
        are_reached = on_device(xp.asarray(xp.all(xp.asarray(is_reached))))
        result = _outcome(ran.result, rigid.result, are_reached)
        return Solution(
            time=on_device(job.path.time),
            desired=on_device(job.path.positions),
            commanded=commanded,
            actual=job.path.disturbed(ran.actual),
            force=ran.force,
            force_range=ran.force_range,
            spindle_torque=ran.spindle_torque,
            removed_volume=ran.removed_volume,
            shank_volume=ran.shank_volume,
            surface_deviation=walls.deviation,
            wall_share=walls.share,
            contour_error=walls.contour_error,
            is_cutting=on_device(is_cutting),
            motor_positions=motors,
            joint_positions=ran.joint_positions,
            initial_overlap_volume=ran.initial_overlap_volume,
            has_failed=on_device(has_failed),
            is_reached=is_reached,
            stock=ran.stock,
            rigid=rigid,
            result=result,
            joint_names=() if job.robot is None else job.robot.joint_names,
            joint_units=() if job.robot is None else job.robot.joint_units,
            is_engagement_update=(
                None if updates is None else on_device(updates.is_update)
            ),
            engagement_force_error=(
                None if updates is None else on_device(updates.force_error())
            ),
        )

    def raise_unless_successful(self, job: Job | None = None) -> None:
        """Raise `SimulationFailed` with time, place and joint of every trouble.

        Args:
            job: The job, in its precision: with it a pose that is not reached is
                described.

        Raises:
            SimulationFailed: The outcome is not successful.
        """
        if bool(self.result != RESULTS.successful):
            raise SimulationFailed(troubles_of(self, job), self)

    @property
    def deviation(self) -> Float[Array, "step 3"]:
        """Return actual - desired [m], shape (step, 3)."""
        return self.actual - self.desired

    @property
    def contour(self) -> ContourStatistics:
        """Contour error where the rigid tool cuts, on the host: rms, p95 and max [m].

        NaN where nothing is cut.
        """
        return ContourStatistics.of(self.contour_error, self.is_cutting)

    def __repr__(self) -> str:
        """Error, force, volume and outcome, in five lines."""
        read = (self.time, self.contour_error, self.stock.families[0].ends)
        if not has_values(*read) or is_traced(self) or self.time.ndim > 1:
            return f"Solution(rows of {getattr(self.time, 'shape', None)})"
        rows = self.time.shape[-1]
        cut_rows = int(np.sum(np.asarray(self.is_cutting)))
        force = np.linalg.norm(np.asarray(self.force), axis=1)
        cut = "nothing is cut"
        if cut_rows:
            rms, largest = 1e6 * self.contour.rms, 1e6 * self.contour.max
            cut = f"contour error {rms:.2f} um rms, {largest:.2f} um at most"
        outcome = RESULTS[self.result] if self.result != RESULTS.successful else ""
        return (
            f"Solution of {rows} rows in {float(self.time[-1]):.3f} s\n"
            f"  where the tool cuts, {cut_rows} rows: {cut}\n"
            f"  force: {force.max():.1f} N at most, mean over a tooth period\n"
            f"  removed: {1e9 * float(np.sum(self.removed_volume)):.1f} mm^3, "
            f"left: {1e9 * float(self.stock.volume()):.1f} mm^3\n"
            f"  outcome: {outcome or 'successful'}"
        )

    def _repr_html_(self) -> str:
        """The same lines as a table, for notebooks."""
        return html_rows(repr(self))

    def to_dataset(self) -> "xarray.Dataset":
        """Return the rows as an `xarray.Dataset`, units in the attributes."""
        from .dataset import solution_dataset

        return solution_dataset(self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a table with a row per tooth period: `force_x`, `joint_positions_1`.

        Values are in SI; the index is the number of the row.
        """
        from .dataset import solution_table

        return solution_table(self)


@readable_signature
def simulate(
    job: Job,
    *,
    throw: bool = True,
    on_progress: OnProgress | None = None,
    adjoint: AbstractAdjoint | None = None,
    commanded: FloatRows3 | None = None,
    motors: FloatRows | None = None,
    segment_periods: int = LONGEST,
    on_checkpoint: OnCheckpoint | None = None,
    resume: Arrays | None = None,
) -> Solution:
    """Predict forces, deviation and the machined stock of a job.

    Args:
        job: The job.
        throw: Whether to raise when the run does not succeed; not under `jit`, where
            `.result` tells.
        on_progress: Called with a message and the share done: between the rigid and the
            coupled part, and after each segment of a long path.
        adjoint: How to differentiate through the removal; `ThroughRays()` if not given.
            Under `jit` where nothing is differentiated, `FrozenStock()` is faster: ends
            then need not remember what made them.
        commanded: Tip positions that the program commands instead of the desired
            path [m], shape (step, 3); by default those of the job, if it has any.
        motors: Motor positions at the rows instead of those of `commanded`, before the
            controller [rad or m], shape (step, joint).
        segment_periods: Tooth periods of a segment, rounded up to a multiple of 64. A
            longer path is run in segments: what is compiled, and on the device at once,
            then does not grow with the path. A job that is traced runs whole.
        on_checkpoint: Called after each segment with plain arrays by name: those that a
            run needs to go on, beside those of earlier calls that it does not replace,
            as `dict.update` puts them together.
        resume: What it was called with in all for the same job, command and segments,
            to go on from there to the same result.

    Returns:
        The solution.

    Raises:
        SimulationFailed: The outcome is not successful; the message names the time
            and place, and the exception carries the solution.
        TypeError: Argument `job` is none.
        ValueError: The precision asked for is not enabled in JAX, the rows of the path
            are not a tooth period apart, `commanded` or `motors` has another shape, a
            rigid machine is given motors, or `resume` is of other segments.

    Differentiability: in all leaves of the job, as `simulate_process`.
    """
    check_job(job)
    job = job.with_precision()
    adjoint = ThroughRays() if adjoint is None else adjoint
    tell = on_progress or (lambda message, share: None)
    if commanded is None:
        commanded = job.path.positions if job.commanded is None else job.commanded
    job = dataclasses.replace(job, commanded=None)
    shape, dtype = (job.path.step_count, 3), np.dtype(job.simulation.precision)
    commanded = _checked(commanded, "commanded", shape, dtype)
    if motors is not None:
        if job.robot is None:
            raise ValueError("Argument `motors` must be None without a robot.")
        shape = job.path.step_count, job.robot.joint_count
        motors = _checked(motors, "motors", shape, dtype)
    run = simulate_with_slot_growth(
        job,
        commanded,
        adjoint,
        tell,
        motors=motors,
        segment_periods=segment_periods,
        is_adaptive=job.simulation.resolution == "adaptive",
        checkpoint=RunCheckpoint(write=on_checkpoint, resume=resume),
    )
    solution = run.solution
    tell("done", 1.0)
    if throw and not isinstance(solution.actual, jax.core.Tracer):
        solution.raise_unless_successful(job)
    return solution


def _checked(
    rows: FloatRows, name: str, shape: tuple[int, ...], dtype: np.dtype
) -> Float[Array, "step axis"]:
    """Return rows of a command on the device, in the precision of the job."""
    if np.shape(rows) != shape:
        raise ValueError(
            f"Argument `{name}` must have shape {shape}, a row for each of the path's, "
            f"but has {np.shape(rows)}."
        )
    return on_device(rows if rows.dtype == dtype else rows.astype(dtype))


# One program, not one for each of its operations.
@jax.jit
def _outcome(ran: RESULTS, rigid: RESULTS, are_reached: Bool[Array, ""]) -> RESULTS:
    """Outcome of a run.

    What a rigid cut that failed says of where the tool cuts would be wrong; what went
    wrong in a cut counts before what is not reached, which `is_reached` tells.
    """
    result = RESULTS.where(ran == RESULTS.successful, rigid, ran)
    only_unreached = (result == RESULTS.successful) & ~are_reached
    return RESULTS.where(only_unreached, RESULTS.unreachable, result)


class SolvedJob(NamedTuple):
    """A job with the slots that it took, and its solution, whatever the outcome."""

    job: Job
    solution: Solution


def simulate_with_slot_growth(
    job: Job,
    commanded: Float[Array, "step 3"],
    adjoint: AbstractAdjoint,
    on_progress: OnProgress,
    *,
    motors: FloatRows | None = None,
    segment_periods: int = LONGEST,
    is_adaptive: bool = False,
    checkpoint: RunCheckpoint = RunCheckpoint(),
) -> SolvedJob:
    """Run a job, and again with more slots while its rays need more intervals.

    Args:
        job: The job, in its precision.
        commanded: Tip positions that the program says [m], shape (step, 3).
        adjoint: How to differentiate through the removal.
        on_progress: Called with a message and the share done.
        motors: As of `simulate`.
        segment_periods: As of `simulate`.
        is_adaptive: As of `SegmentPlan`.
        checkpoint: Where finished segments are kept, under any name.

    Differentiability: as `simulate`; what is traced is run once.
    """
    if not is_traced((job, commanded)):
        _prepare(job, SegmentPlan(segment_periods, is_adaptive=is_adaptive))
    count = job.path.step_count

    def run_with_slots(
        name: str, first: float, last: float, run: Callable[[Job, SegmentPlan], Any]
    ) -> tuple[Job, Any]:
        """Job with as many slots as a run of it takes, and that run."""
        grown, share = job, first

        def on_rows(done: int) -> None:
            nonlocal share
            share = first + (last - first) * done / count
            on_progress(f"{name}: {done} of {count} tooth periods", share)

        def more_slots(counts: Sequence[int]) -> Sequence[int] | None:
            nonlocal grown
            more = _more_intervals(job, counts)
            if more is not None:
                grown = job.with_intervals(more)
                on_progress(f"{name} again: {grown.notes[-1]}", share)
            return more

        on_progress(f"{name}: {count} tooth periods", first)
        kept = checkpoint._replace(run=name)
        plan = SegmentPlan(segment_periods, on_rows, more_slots, kept, is_adaptive)
        while True:
            found = run(grown, plan)
            has_room = is_traced(found.result) or not bool(
                found.result == RESULTS.interval_overflow
            )
            # A path in segments has asked for more itself.
            if has_room or more_slots(grown.stock.interval_counts) is None:
                return grown, found

    job, rigid = run_with_slots(
        "rigid cut", 0.0, 0.4, lambda job, plan: rigid_cut(job, adjoint, plan=plan)
    )
    job, solution = run_with_slots(
        "robot and cut",
        0.4,
        1.0,
        lambda job, plan: Solution.of_command(
            job, rigid, commanded, adjoint, motors, plan=plan
        ),
    )
    return SolvedJob(job, solution)


def _more_intervals(job: Job, counts: Sequence[int]) -> Sequence[int] | None:
    """Twice the slots, for a run of a job whose rays need more than these.

    How many intervals a ray needs at once is known only when the program has been cut:
    a pocket cleared in many passes leaves strips that a ray crosses one by one. Every
    slot costs time and memory in each step, so a job begins with a few.

    Returns:
        Slots along x, y and z; None if the job states their number, under a
        transformation, or if there is no room for more.
    """
    if job.keeps_intervals or is_traced(job):
        return None
    x, y, z = counts
    # A tool that stands upright never splits a ray along z.
    counts = (2 * x, 2 * y, 2 * z if job.simulation.axes else z)
    if max(counts) > _MOST_INTERVALS or job.stock.memory_with(counts).is_too_much:
        return None
    return counts


def job_process(job: Job, derivative: AbstractAdjoint) -> Process:
    """Return the process of a job.

    Args:
        job: The job, in its precision.
        derivative: How to differentiate through the removal.
    """
    settings = job.simulation
    engagement = choose_engagement(
        job.stock,
        job.cutter,
        axial_depth=settings.axial_depth,
        angles=settings.angles,
        substeps=settings.substeps,
        updates_per_period=settings.updates_per_period,
        element_height=settings.element_height,
        axes=np.array(settings.axes) if settings.axes else None,
        is_upright=not settings.axes,
        plunges=settings.plunges,
        has_bottom=settings.has_bottom,
        chip=settings.chip,
    )
    return Process(
        job.stock,
        job.cutter,
        job.law,
        job.spindle_speed,
        engagement,
        bottom_law=job.bottom_law,
        derivative=derivative,
    )


def job_machine(job: Job) -> ElasticArm | QuasiStaticArm | ModalMachine:
    """Return the machine of a job: its modes, or its robot, dynamic or quasi-static.

    Args:
        job: The job, in its precision.

    Raises:
        ValueError: The machine is rigid, or quasi-static modes are asked for.
    """
    settings = job.simulation
    if job.modes is not None:
        if not settings.mode.vibrates:
            raise ValueError('Argument `job` must have mode "dynamic" for its modes.')
        return ModalMachine(job.modes)
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    machine = settings.mode.build(job, job.robot)
    assert isinstance(machine, ElasticArm | QuasiStaticArm)
    return machine


@builds(DynamicSettings)
def _elastic_arm(settings: DynamicSettings, job: Job, robot: Robot) -> ElasticArm:
    rule = make_integrator(job.simulation.integrator, job.simulation.dynamics)
    return ElasticArm(robot, job.T_base_work, rule)


@builds(QuasistaticSettings)
def _quasi_static_arm(
    settings: QuasistaticSettings, job: Job, robot: Robot
) -> QuasiStaticArm:
    return QuasiStaticArm(robot, job.T_base_work)


def rigid_cut(
    job: Job,
    adjoint: AbstractAdjoint,
    *,
    along: Pose | None = None,
    chip_row: int = 0,
    plan: SegmentPlan | None = None,
) -> Run:
    """Return the process alone on the desired path, as a rigid machine cuts it.

    Its stock is what others are held against: run-out cuts it no wider.

    Args:
        job: The job, in its precision.
        adjoint: How to differentiate through the removal.
        along: Poses at the rows of the path instead of those desired, shape (step, 3),
            of which only those are run that it takes for the chips and the force at
            every angle of a revolution.
        chip_row: Row at which that revolution ends.
        plan: How a long path is run in segments: tips are then kept at the tooth
            instants alone.

    **Differentiability**: that of `simulate_process`.
    """
    plan = SegmentPlan() if plan is None else plan
    is_long = plan.suits(job.path, (job, along))
    build = MachiningProblem.of if is_long else MachiningProblem.padded
    problem = build(job, _needed(adjoint, (job, along)))
    count, total = job.path.step_count, problem.path.step_count
    tips = on_device(problem.path.positions)
    if along is not None:
        rows = jax.tree.map(lambda x: on_device(pad_rows(x, total)), along)
        tips, problem = rows.tip, dataclasses.replace(problem, axes=rows.axis)
        # The curve in a period follows from the row behind it, too.
        count = min(count, chip_row + 2)
        if problem.path.row_count is not None:
            path = dataclasses.replace(
                problem.path, row_count=np.asarray(count, np.int32)
            )
            problem = dataclasses.replace(problem, path=path)
    # For what is differentiated no chips are kept.
    row = None if is_traced((job, along)) else on_device(np.asarray(chip_row, np.int32))

    has_two = along is None and job.cutter.has_runout

    def cut_along(problem: MachiningProblem, before: int = 0) -> Run:
        if is_long:
            on_rows = lambda done: plan.on_rows((before + done) // (1 + has_two))
            kept = plan.checkpoint
            if before:
                kept = kept._replace(run=f"{kept.run} of a true cutter")
            own = plan._replace(on_rows=on_rows, checkpoint=kept)
            return LongRun(problem, own).cut(np.asarray(tips)[:count], chip_row)
        cut = _cut_along(problem, tips, row)
        return cut.finished(_remove_pending(problem.process, cut.pending()))

    cut = cut_along(problem)
    if along is None:
        cut = dataclasses.replace(cut, chips=None)
        if has_two:
            # The same cut, of a cutter that runs true.
            runout = lambda p: p.process.cutter.runout
            problem = eqx.tree_at(runout, problem, replace_fn=jnp.zeros_like)
            true = cut_along(problem, count)
            is_good = cut.result == RESULTS.successful
            result = RESULTS.where(is_good, true.result, cut.result)
            nominal = lambda run: (run.removal.stock, run.removal.result)
            cut = eqx.tree_at(nominal, cut, (true.stock, result))
    return cut.first(count)


class MachiningProblem(eqx.Module):
    """A job as compiled programs see it: numbers alone, none of them static.

    What is only in its file, and what others do with its results, is left out.

    Attributes:
        process: The process.
        machine: What moves the tool; None for a rigid machine.
        controller: What its motors do of their command; None if they follow it.
        path: The path.
        axes: Tool axes, shape (step, 3); None if it is upright.
        kinematics: From commanded tips to its motors; None for a rigid machine.
    """

    process: Process
    machine: ElasticArm | QuasiStaticArm | ModalMachine | None
    controller: Controller | None
    path: Path
    axes: Float[Array, "step 3"] | None
    kinematics: JobKinematics | None

    @classmethod
    def of(cls, job: Job, derivative: AbstractAdjoint) -> "MachiningProblem":
        """The problem of a job, sizes taken on the host.

        Args:
            job: The job, in its precision.
            derivative: How to differentiate through the removal.
        """
        process = job_process(job, derivative)
        free = process.cutter.with_sizes_as_leaves()
        process = eqx.tree_at(lambda p: p.cutter, process, free)
        return cls(
            cast_floats(process, jnp.dtype(job.simulation.precision)),
            None if job.is_rigid else job_machine(job),
            job.controller,
            job.path,
            job.tool_axes,
            None if job.is_rigid else JobKinematics(job),
        )

    @classmethod
    def padded(cls, job: Job, derivative: AbstractAdjoint) -> "MachiningProblem":
        """The problem of a job with its path padded to one of few lengths.

        A compiled program serves arrays of one shape: a path that is one row longer
        would be compiled anew. Rows behind the last one are not simulated
        (`diffmill/_padding.py`). A path that is traced stays as it is.

        Arguments as of `of`.
        """
        if not is_traced(job.path.positions):
            job = dataclasses.replace(job, path=job.path.padded())
        return cls.of(job, derivative)

    def run(self, motors: Float[Array, "step joint"]) -> Run:
        """Run the machine for given motor positions.

        Args:
            motors: Commanded motor positions at the tooth instants [rad or m], shape
                (step, joint); for modes the poses of the tool, see `ModalMachine`.

        **Differentiability**: that of `AbstractMachine.run`.
        """
        assert self.machine is not None
        if self.controller is not None:
            motors = self.controller.motors(motors, self.process.tooth_period)
        return self.machine.run(self.process, motors, row_count=self.path.row_count)


@CachedJit
def _cut_along(
    problem: MachiningProblem,
    positions: Float[Array, "step 3"],
    chip_row: Int[Array, ""] | None,
) -> Run:
    """Run of a rigid machine on the given tips, but for its pending removals.

    With the chips of a revolution and its force at every angle, for figures, since
    another program without them would be compiled beside this one.
    """
    path = Pose.along(positions, problem.axes)
    machine = Rigid(chip_row=chip_row)
    return machine.run_rows(problem.process, path, problem.path.row_count)


@CachedJit
def _remove_pending(process: Process, pending: PendingRemoval) -> Removal:
    """The end of a run: the same for every machine."""
    return pending.finish(process)


@CachedJit
def _follow(
    problem: MachiningProblem,
    finished: Stock,
    tips: Float[Array, "step 3"],
    motors: Float[Array, "step joint"] | None,
) -> Followed:
    """Run of a command, but for its pending removals, against what a rigid cut leaves.

    Args:
        problem: The problem.
        finished: Stock that the rigid cut leaves.
        tips: Commanded tips [m], shape (step, 3).
        motors: The motors' positions for them; None for a rigid machine.
    """
    path, process = problem.path, problem.process
    if problem.machine is None:
        # A rigid machine goes where it is told.
        ran, ends = _cut_along(problem, tips, None), tips[:, None]
        ran = dataclasses.replace(ran, chips=None)
    else:
        assert motors is not None
        if problem.controller is not None:
            motors = problem.controller.motors(motors, process.tooth_period)
        ran = problem.machine.run_rows(process, motors, path.row_count)
        ends = ran.ends
    rows = WallRows(path.positions, problem.axes, path.disturbance, ends)
    is_arm = ran.joint_positions is not None
    walls = rows.walls(process.cutter, finished)
    return Followed(ran, walls, motors if is_arm else None)


def _needed(adjoint: AbstractAdjoint, arguments: object) -> AbstractAdjoint:
    """Adjoint of a run: one and the same, if nothing is differentiated.

    So a run that is compiled for one method serves all others.
    """
    return adjoint if is_traced(arguments) else FrozenStock()


def _prepare(job: Job, plan: SegmentPlan) -> None:
    """Compile the run of a command while the rigid cut is compiled and runs."""
    if job.is_rigid or plan.suits(job.path, job):
        return
    problem = MachiningProblem.padded(job, FrozenStock())
    steps, dtype = problem.path.step_count, np.dtype(job.simulation.precision)
    joints = 3 if job.robot is None else len(job.robot.joint_names)
    tips, motors = (on_device(np.zeros((steps, n), dtype)) for n in (3, joints))
    _follow.prepare(problem, problem.process.stock, tips, motors)
