"""A machine moves the tool, the process pushes it back: one run of both.

One `lax.scan` over tooth periods. What the machine is decides what a period does
(`AbstractMachine.period`): a rigid one goes where it is told (`rigid.py`), an arm
without inertia balances the mean force (`quasi_static.py`), an elastic one takes
sub-steps (`elastic.py`).

A run may go on from where another ended. Such a segment numbers its poses afresh: its
track holds the newest of the segments before, as far as removal looks back, then its
own. Ends of rays that earlier segments cut become raw stock to it: they stay where they
are and have no derivative. So what is carried from segment to segment does not grow
with the path, but for the stock itself.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped

from ..._arrays import first_rows
from ..._padding import (
    count_run,
    if_valid,
    last_row,
    live_rows,
    scan_rows,
    whole_parts,
)
from ..._result import RESULTS
from ..._types import IntScalar
from ...numerics import batched_in_turn
from ...process import Engagement, Process, ProcessState, RemovedVolume
from ...workpiece import Pose, PoseTrack, Rays, Stock


class RunState(eqx.Module):
    """All that a run needs to go on.

    Attributes:
        process: The stock, less the poses that wait for removal, and these.
        machine: The machine's own state, a tree.
        period_count: Tooth periods run so far, which give the tooth that is next.
        cut_by: What cut the ends of each family of rays, as `Rays.poses` of the whole
            run, shapes (u, v, 2, slot): the stock of the process forgets what earlier
            segments cut. None where that is not asked for.
    """

    process: ProcessState
    machine: PyTree
    period_count: Int[Array, ""]
    cut_by: tuple[Int[Array, "..."], ...] | None = None


class PeriodRow(NamedTuple):
    """Input of a tooth period, or of several.

    Attributes:
        period: Its index k, from pose k - 1 to pose k, shape (*period,).
        command: The machine's, a tree.
        is_live: Whether the period counts, shape (*period,); None if all do. In one
            that does not the machine rests.
    """

    period: Int[Array, "*period"]
    command: PyTree
    is_live: Bool[Array, "*period"] | None = None


# From the process, its state after the removal of a period, the period and the poses
# predicted in the middle of its sub-steps to the engagement.
Engage: TypeAlias = Callable[[Process, ProcessState, PeriodRow, Pose], Engagement]


def engage_if_valid(
    process: Process, state: ProcessState, row: PeriodRow, predicted: Pose
) -> Engagement:
    """Engagement of a period; where that does not count, zeros that cost nothing."""
    engage = lambda: process.engage(state, row.period, predicted)
    return if_valid(row.is_live, engage)


class StockAccess(NamedTuple):
    """Access of a tooth period to the stock: removal, then the engagement.

    Attributes:
        engage: Returns the engagement of the period.
        remove: Takes in the pose at its start and removes what lies behind by the
            lag; called as `Process.remove`.
    """

    engage: Engage = engage_if_valid
    remove: Callable[..., tuple[ProcessState, RemovedVolume]] = Process.remove


class LoadedSubsteps(eqx.Module):
    """Sub-steps of a period.

    Attributes:
        predicted: Tips assumed, before the force is known, to look up the stock [m],
            shape (*substep, 3).
        tips: Tips in their middle [m], same shape.
        ends: Tips at their ends [m], same shape.
        loads: Forces in `work` [N] and, if the machine takes them, their moments about
            the tip [N m], shape (*substep, load).
        force_range: Least and largest force at any angle in `work` [N], shape
            (*substep, 2, 3).
        spindle_torque: Mean torque that the spindle needs [N m], shape (*substep,).
    """

    predicted: Float[Array, "*substep 3"]
    tips: Float[Array, "*substep 3"]
    ends: Float[Array, "*substep 3"]
    loads: Float[Array, "*substep load"]
    force_range: Float[Array, "*substep 2 3"]
    spindle_torque: Float[Array, "*substep"]

    def whole_range(self) -> Float[Array, "2 3"]:
        """Least and largest force at any angle of the period [N], shape (2, 3)."""
        least, largest = self.force_range[:, 0], self.force_range[:, 1]
        return jnp.stack([jnp.min(least, axis=0), jnp.max(largest, axis=0)])


class Period(eqx.Module):
    """Outputs of one tooth period.

    Attributes:
        tip: Tool tip in `work` at its start [m], shape (3,).
        ends: Tips at the ends of its sub-steps [m], shape (substep, 3).
        force: Mean force on the tool in `work` [N], shape (3,).
        force_range: Least and largest force at any angle sample [N], shape (2, 3).
        spindle_torque: Mean torque that the spindle needs [N m], shape ().
        joint_positions: At its start [rad or m], shape (joint,); None without joints.
        removed: Volumes of the poses removed at its start.
        has_failed: Whether a flag of the process is up.
        samples: Force at every angle [N], shape (sample, 3), if it is asked for.
        substeps: Its sub-steps, of a compliant machine; a run does not record them.
        engagement: The edges in the stock; None where it was looked up several times.
            A run does not record it.
    """

    tip: Float[Array, " 3"]
    ends: Float[Array, "substep 3"]
    force: Float[Array, " 3"]
    force_range: Float[Array, "2 3"]
    spindle_torque: Float[Array, ""]
    joint_positions: Float[Array, " joint"] | None
    removed: RemovedVolume
    has_failed: Bool[Array, ""]
    samples: Float[Array, "sample 3"] | None = None
    substeps: LoadedSubsteps | None = None
    engagement: Engagement | None = None

    def recorded(self) -> "Period":
        """The outputs that a run records."""
        return dataclasses.replace(self, substeps=None, engagement=None)


class TurnChips(eqx.Module):
    """Chips of the teeth and their force in some periods, sample by sample.

    Attributes:
        angle: Of the samples [rad], shape (*period, substep, angle, leading, disc).
        tooth: The tooth that each is of, same shape.
        chip: Chip thickness in the stock [m], shape (*period, substep, angle, leading,
            element).
        weight: Occupancy, same shape.
        force: Force on the tool at every angle in `work` [N], shape (*period, sample,
            3).
    """

    angle: Float[Array, "*period substep angle leading disc"]
    tooth: Int[Array, "*period substep angle leading disc"]
    chip: Float[Array, "*period substep angle leading element"]
    weight: Float[Array, "*period substep angle leading element"]
    force: Float[Array, "*period sample 3"]


class AbstractMachine(eqx.Module):
    """Machine: it moves the tool along a command, compliant or rigid.

        x_k = f(x_{k-1}, theta_{k-1}, theta_k, F_k),   p_k = pose(x_k)

    # symbols: k instant, and the tooth period that ends with it, x state of the
    machine, theta command, p pose of the tool, F loads of the teeth in the period,
    which follow the poses in it and those before
    """

    @abc.abstractmethod
    def begin(self, process: Process, command: PyTree) -> PyTree:
        """Return the machine's state at the first instant.

        Args:
            process: The process.
            command: What it receives, one row per tooth instant.
        """

    @abc.abstractmethod
    def rows(
        self, process: Process, command: PyTree, row_count: IntScalar | None
    ) -> PyTree:
        """Command of every period, a tree with an axis period.

        Args:
            process: The process.
            command: What the machine receives, one row per tooth instant.
            row_count: How many rows count, shape (); None for all.
        """

    @abc.abstractmethod
    def pose(self, process: Process, state: PyTree) -> Pose:
        """Return the tool's pose in `work`."""

    @abc.abstractmethod
    def joint_positions(self, state: PyTree) -> Float[Array, " joint"] | None:
        """Return the joint positions [rad or m], None without joints."""

    def chips(self, state: PyTree) -> TurnChips | None:
        """Chips of the teeth in the periods that are kept, None for none."""
        del state

    @abc.abstractmethod
    def period(
        self,
        process: Process,
        state: RunState,
        row: PeriodRow,
        access: StockAccess = StockAccess(),
    ) -> tuple[RunState, Period]:
        """State after one tooth period, and its outputs.

        Args:
            process: The process.
            state: State at its start.
            row: The period, with its command of `rows`.
            access: How it meets the stock; a machine that looks up the stock several
                times in a period takes the process's own engagement.
        """

    def run(
        self,
        process: Process,
        command: PyTree,
        *,
        row_count: IntScalar | None = None,
    ) -> "Run":
        """Move a machine along a command and cut.

        An arm starts in equilibrium with gravity, moving with its motors.

        Args:
            process: The process.
            command: What the machine receives at the tooth instants: for `Rigid` the
                poses of the tool, shape (step, 3), for an arm its motors' angles theta,
                behind the gear on the joint's side [rad or m], shape (step, joint); 0
                for virtual joints.
            row_count: How many rows count, those behind leave everything as it is;
                shape (). All rows if not given.

        Returns:
            The motion, the forces and the final stock.

        Differentiability: in the command and all leaves of machine and process, in
        forward and reverse mode, except at the kinks of chips and rays. When a tooth
        looks at a place of the stock is a constant, in the pitch too; when it cuts is
        not. Under `ThroughPoses` volumes and the final stock are constants in the
        command.
        """
        ran = self.run_rows(process, command, row_count)
        return ran.finished(ran.pending().finish(process))

    @batched_in_turn
    def run_rows(
        self, process: Process, command: PyTree, row_count: IntScalar | None
    ) -> "Run":
        """Run the rows, without the removals that are pending behind the last of them.

        Arguments and **Differentiability** are those of `run`. What is pending is
        removed alike for all machines, and apart from them it is compiled once.
        """
        rows = self.rows(process, command, row_count)
        step_count = _length(rows) + 1
        last = last_row(step_count, row_count)
        state = begin(self, process, command, step_count)
        first = jnp.ones((), jnp.int32)
        state, periods = _run_periods(self, process, state, first, rows, row_count)
        final = self.pose(process, state.machine)
        actual = _at_instants(periods.tip, final.tip, last)
        joints = self.joint_positions(state.machine)
        # The first period removes nothing but what the tool stood in.
        overlap = jnp.sum(periods.removed.volume[0])
        none_at_first = lambda x: x.at[0].set(0)
        volumes = lambda removed: (removed.volume, removed.by_shank)
        removed = eqx.tree_at(volumes, periods.removed, replace_fn=none_at_first)
        is_finite = jnp.all(jnp.isfinite(actual)) & jnp.all(jnp.isfinite(periods.force))
        samples = periods.samples
        return Run(
            time=process.tooth_period * jnp.arange(step_count, dtype=actual.dtype),
            actual=actual,
            ends=all_ends(periods),
            force=prepend_zeros(periods.force),
            force_range=prepend_zeros(periods.force_range),
            spindle_torque=prepend_zeros(periods.spindle_torque),
            joint_positions=_at_instants(periods.joint_positions, joints, last),
            initial_overlap_volume=overlap,
            removal=PendingRemoval(
                state.process, final, last, removed, periods.has_failed, is_finite
            ),
            instantaneous_force=None if samples is None else prepend_zeros(samples),
            chips=self.chips(state.machine),
        )

    def begin_run(self, process: Process, command: PyTree) -> RunState:
        """Return the state from which the first segment of a run starts.

        Args:
            process: The process.
            command: As for `run_segment`, of which the first three rows count.

        Differentiability: as `run`.
        """
        rows = process.removal.row_count
        state = begin(self, process, command, rows + 1)
        moved = _moved(state.process, state.process.track, rows)
        return RunState(moved, state.machine, state.period_count)

    def run_segment(
        self,
        process: Process,
        command: PyTree,
        state: RunState,
        row_count: IntScalar | None = None,
        *,
        adaptive: Callable[..., PyTree] | None = None,
    ) -> "RunSegment":
        """Run some periods from where an earlier run ended.

        Args:
            process: The process; its stock is the state's.
            command: As for `run`, for a rigid machine a `PathPiece`; row 0 is the last
                row of the segment before.
            state: State at row 0, of `begin_run` or of the segment before.
            row_count: How many rows count, of a segment that may end the run; its
                periods are then whole parts, see `whole_parts`. All if not given.
            adaptive: Runs the periods with one engagement update for several of them
                where the cut is steady, as `run_adaptive`; then without derivative in
                reverse mode. Each period has its update if not given.

        Returns:
            The rows, and the state at the last of them; nothing of the queue is
            removed.

        Raises:
            ValueError: The periods are no whole parts.

        Differentiability: as `run`; the state is differentiable but for the ends of
        rays, and under `ThroughPoses` the segment depends on earlier ones by the
        machine and the poses that wait for removal only.
        """
        # Ends that no pose of the segment cuts are those of the stock that it begins
        # with.
        process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
        rows = self.rows(process, command, row_count)
        count, history = _length(rows), process.removal.row_count
        if row_count is not None and count != whole_parts(count):
            raise ValueError(
                f"Argument `command` must have {whole_parts(count) + 1} rows where "
                f"`row_count` is given, but has {count + 1}."
            )
        started, first = continued(process, state, count)
        # Index of row 0 in the track.
        start, end = first - 1, None
        if row_count is not None:
            end = start + jnp.asarray(row_count, jnp.int32)
        index = first + jnp.arange(count, dtype=jnp.int32)
        standing_rows = process.removal.standing_rows
        ran = count_run(live_rows(index, end), count, standing_rows)
        if adaptive is None:
            ended, periods = _run_periods(self, process, started, first, rows, end)
            updates = None
        else:
            every = PeriodRow(index, rows, live_rows(index, end))
            ended, periods, updates = adaptive(self, process, started, every, ran)
        final = self.pose(process, ended.machine)
        last = last_row(count + 1, row_count)
        joints = self.joint_positions(ended.machine)
        removed = periods.removed
        cut_by = _cut_by(state, ended.process.stock, start)
        kept = _renumbered(ended.process, start - history + ran, history)
        return RunSegment(
            actual=_at_instants(periods.tip, final.tip, last),
            ends=all_ends(periods),
            force=prepend_zeros(periods.force),
            force_range=prepend_zeros(periods.force_range),
            spindle_torque=prepend_zeros(periods.spindle_torque),
            joint_positions=_at_instants(periods.joint_positions, joints, last),
            removed=dataclasses.replace(removed, pose=removed.pose - start),
            has_failed=periods.has_failed,
            standing_count=ran - last,
            engagement_updates=(
                None if updates is None else jax.tree.map(prepend_zeros, updates)
            ),
            state=RunState(kept, ended.machine, state.period_count + ran, cut_by),
        )

    def finish_run(
        self, process: Process, state: RunState, standing_count: Int[Array, ""]
    ) -> "RunEnd":
        """Remove the poses that are pending behind the last segment of a run.

        Args:
            process: The process; its stock is the state's.
            state: State after the last segment.
            standing_count: That of the last segment.

        Differentiability: as `run_segment`.
        """
        process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
        started, first = continued(process, state, 0)
        last = first - 1 - standing_count
        pose = self.pose(process, state.machine)
        ended, removed = process.removal.finish(started.process, last, pose, first)
        stock, cut_by = ended.stock, _cut_by(state, ended.stock, first - 1)
        if cut_by is not None:
            poses = lambda stock: [rays.poses for rays in stock.families]
            stock = eqx.tree_at(poses, stock, list(cut_by))
        return RunEnd(
            stock,
            dataclasses.replace(removed, pose=removed.pose - last),
            ended.has_overflow,
            ended.has_left_window,
        )


class Removal(eqx.Module):
    """Volumes, final stock and outcome of a run, known after its pending removals.

    Attributes as the properties of `Run`.
    """

    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS


class PendingRemoval(eqx.Module):
    """The poses that wait for removal behind the last row of a run.

    Attributes:
        state: The stock, and the queue of the poses.
        final: The tool's last pose, shape (3,).
        last: Index of the last row that counts, shape ().
        removed: Volumes removed in each period.
        has_failed: Whether a flag was up after each period, shape (period,).
        is_finite: Whether all that was computed is finite, shape ().
    """

    state: ProcessState
    final: Pose
    last: Int[Array, ""]
    removed: RemovedVolume
    has_failed: Bool[Array, " period"]
    is_finite: Bool[Array, ""]

    def finish(self, process: Process) -> Removal:
        """Remove all that waits.

        **Differentiability**: that of `AbstractMachine.run`.
        """
        count = self.has_failed.shape[0] + 1
        ended, newest = process.removal.finish(self.state, self.last, self.final, count)

        def by_pose(earlier: Array, newest_volume: Array) -> Array:
            # A step removes other poses than its own.
            volume = jnp.zeros(count, earlier.dtype)
            volume = volume.at[self.removed.pose.reshape(-1)].add(earlier.reshape(-1))
            return volume.at[newest.pose].add(newest_volume)

        failed = jnp.concatenate([jnp.zeros(1, bool), self.has_failed])
        failed = failed.at[self.last].set(failed[self.last] | ended.has_failed)
        result = outcome(ended, self.is_finite)
        return Removal(
            removed_volume=by_pose(self.removed.volume, newest.volume),
            shank_volume=by_pose(self.removed.by_shank, newest.by_shank),
            stock=ended.stock,
            has_failed=failed,
            result=result,
        )


def outcome(ended: "ProcessState | RunEnd", is_finite: Bool[Array, ""]) -> RESULTS:
    """Outcome of a run.

    Args:
        ended: What its flags say at its end.
        is_finite: Whether all that was computed is finite, shape ().
    """
    result = RESULTS.where(
        ended.has_left_window, RESULTS.window_overflow, RESULTS.successful
    )
    result = RESULTS.where(ended.has_overflow, RESULTS.interval_overflow, result)
    return RESULTS.where(is_finite, result, RESULTS.non_finite)


class EngagementUpdates(NamedTuple):
    """Engagement updates in a run, for the tooth period before each instant.

    Attributes:
        is_update: Whether the stock was read, shape (step,).
        miss: Difference of the force found there from that of the engagement that was
            reused until then [N], shape (step,); zero elsewhere.
    """

    is_update: Bool[Array | np.ndarray, " step"]
    miss: Float[Array | np.ndarray, " step"]

    @staticmethod
    def none(count: int, dtype: np.dtype) -> "EngagementUpdates":
        """Room for the updates of a run, on the host."""
        return EngagementUpdates(np.zeros(count, bool), np.zeros(count, dtype))

    def force_error(self) -> Float[np.ndarray, " step"]:
        """Estimated error of the force by reuse of the engagement [N], on the host.

        It grows from update to update up to what the later one finds, shape (step,).
        """
        is_update, miss = np.asarray(self.is_update), np.asarray(self.miss)
        number = np.arange(is_update.size)
        before = np.maximum.accumulate(np.where(is_update, number, 0))
        before = np.concatenate([[0], before[:-1]])
        behind = np.minimum.accumulate(np.where(is_update, number, number[-1])[::-1])
        behind = behind[::-1]
        return miss[behind] * (number - before) / np.maximum(behind - before, 1)


class Run(eqx.Module):
    """Solution of a machine that cuts; rows are the tooth instants.

    Attributes:
        time: [s], shape (step,).
        actual: Tool tip in `work` [m], shape (step, 3).
        ends: Tool tip at the ends of the sub-steps of the period before each instant
            [m], shape (step, substep, 3); row 0 is at rest.
        force: Mean force on the tool over the period before each instant, in `work`
            [N], shape (step, 3); zero in row 0.
        force_range: Least and largest force at any angle sample of that period [N],
            shape (step, 2, 3); its derivative is zero.
        spindle_torque: Mean torque that the spindle needs over that period [N m], shape
            (step,); its derivative is zero.
        joint_positions: [rad or m], shape (step, joint); None without joints.
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        removal: Volumes, final stock and outcome, or the poses that still wait.
        instantaneous_force: Force at every angle sample of the period before each row
            [N], if it was asked for; sample j of n is that at the share (j + 1/2) / n
            of the period, shape (step, sample, 3).
        chips: Chips of the teeth in a revolution, if they were asked for.
        engagement_updates: As of `RunSegment`.
    """

    time: Float[Array, " step"]
    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    force_range: Float[Array, "step 2 3"]
    spindle_torque: Float[Array, " step"]
    joint_positions: Float[Array, "step joint"] | None
    initial_overlap_volume: Float[Array, ""]
    removal: Removal | PendingRemoval
    instantaneous_force: Float[Array, "step sample 3"] | None = None
    chips: TurnChips | None = None
    engagement_updates: EngagementUpdates | None = None

    @property
    def removed_volume(self) -> Float[Array, " step"]:
        """Volume that each pose removes [m^3], shape (step,)."""
        return self._finished().removed_volume

    @property
    def shank_volume(self) -> Float[Array, " step"]:
        """Part of it that the shank above the flutes takes [m^3], which no tool can."""
        return self._finished().shank_volume

    @property
    def stock(self) -> Stock:
        """The stock after the last pose."""
        return self._finished().stock

    @property
    def has_failed(self) -> Bool[Array, " step"]:
        """True where a flag was up after a step, shape (step,)."""
        return self._finished().has_failed

    @property
    def result(self) -> RESULTS:
        """Outcome of the run."""
        return self._finished().result

    def _finished(self) -> Removal:
        assert isinstance(self.removal, Removal)
        return self.removal

    def pending(self) -> PendingRemoval:
        """The poses that wait for removal, of a run of `run_rows`."""
        assert isinstance(self.removal, PendingRemoval)
        return self.removal

    def finished(self, removal: Removal) -> "Run":
        """The run after its pending removals."""
        return dataclasses.replace(self, removal=removal)

    def first(self, count: int) -> "Run":
        """The first rows of a finished run; the final stock stays."""
        rows = lambda run: (
            run.time,
            run.actual,
            run.ends,
            run.force,
            run.force_range,
            run.spindle_torque,
            run.joint_positions,
            run.instantaneous_force,
        )
        cut = first_rows(rows(self), count)
        run = eqx.tree_at(rows, self, cut, is_leaf=lambda x: x is None)
        rows = lambda end: (end.removed_volume, end.shank_volume, end.has_failed)
        end = self._finished()
        return run.finished(eqx.tree_at(rows, end, first_rows(rows(end), count)))


class RunSegment(eqx.Module):
    """Solution of one segment of a run.

    Attributes as of `Run`, and:
        removed: Volumes removed in each period; poses are counted from row 0, and those
            of earlier segments are below it.
        has_failed: Whether a flag was up after each period, shape (period,).
        standing_count: Periods run behind the last row that counts, in which the tool
            stands, shape ().
        state: State after them. What still waits for removal is in it.
        engagement_updates: Those of an adaptive run; None if each period has one.
    """

    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    force_range: Float[Array, "step 2 3"]
    spindle_torque: Float[Array, " step"]
    joint_positions: Float[Array, "step joint"] | None
    removed: RemovedVolume
    has_failed: Bool[Array, " period"]
    standing_count: Int[Array, ""]
    state: RunState
    engagement_updates: EngagementUpdates | None = None


class RunEnd(eqx.Module):
    """Stock and outcome of a run in segments, after its pending removals.

    Attributes:
        stock: The final stock.
        removed: Volumes removed at the end; poses are counted from the last row.
        has_overflow: Whether a ray ran out of slots, shape ().
        has_left_window: Whether the tool reached beyond its window, shape ().
    """

    stock: Stock
    removed: RemovedVolume
    has_overflow: Bool[Array, ""]
    has_left_window: Bool[Array, ""]

    @property
    def has_failed(self) -> Bool[Array, ""]:
        """True if a flag is up, shape ()."""
        return self.has_overflow | self.has_left_window


def continued(
    process: Process, state: RunState, count: int
) -> tuple[RunState, Int[Array, ""]]:
    """Return a state with room for more periods, and the index of the first of them."""
    flutes = process.cutter.flute_count
    # The tooth that is next follows from the index of the period.
    ahead, history = jnp.mod(state.period_count, flutes), process.removal.row_count
    longer = _with_rows(state.process, ahead, count + 1 + flutes)
    started = RunState(longer, state.machine, state.period_count)
    return started, history + ahead + 1


def begin(
    machine: AbstractMachine, process: Process, command: PyTree, pose_count: int
) -> RunState:
    """Return the state at the first instant."""
    own = machine.begin(process, command)
    started = process.begin(machine.pose(process, own), pose_count)
    return RunState(started, own, jnp.zeros((), jnp.int32))


def _run_periods(
    machine: AbstractMachine,
    process: Process,
    state: RunState,
    first: Int[Array, ""],
    commands: PyTree,
    row_count: IntScalar | None = None,
) -> tuple[RunState, Period]:
    """State after all periods, the first of them of some index, and their outputs."""
    index = first + jnp.arange(_length(commands), dtype=jnp.int32)

    def step(
        state: RunState, row: PeriodRow, is_live: Array | None
    ) -> tuple[RunState, Period]:
        state, period = machine.period(process, state, row._replace(is_live=is_live))
        return state, period.recorded()

    # Removal looks at poses behind the last one, where the tool stands.
    return scan_rows(
        step,
        state,
        PeriodRow(index, commands),
        live_rows(index, row_count),
        behind=process.removal.standing_rows,
    )


def _length(rows: PyTree) -> int:
    return jax.tree.leaves(rows)[0].shape[0]


def _at_instants(
    starts: Float[Array, "period n"] | None,
    final: Float[Array, " n"] | None,
    last: Int[Array, ""],
) -> Any:
    """Values at all instants: at the start of every period, from the last row on final.

    Args:
        starts: One per period, shape (period, n); None without values.
        final: The value that is reached in the end, shape (n,); None likewise.
        last: Index of the last row that counts, shape ().
    """
    if starts is None or final is None:
        return None
    rows = jnp.concatenate([starts, final[None]])
    index = jnp.arange(rows.shape[0], dtype=jnp.int32)
    return jnp.where((index < last)[:, None], rows, final[None])


def all_ends(periods: Period) -> Float[Array, "step substep 3"]:
    """Return the ends of sub-steps with those before the first instant, at rest."""
    rest = jnp.broadcast_to(periods.tip[:1, None], (1, *periods.ends.shape[1:]))
    return jnp.concatenate([rest, periods.ends])


def prepend_zeros(rows: Shaped[Array, "period ..."]) -> Shaped[Array, "step ..."]:
    """Rows with one of zeros in front."""
    return jnp.concatenate([jnp.zeros_like(rows[:1]), rows])


def _cut_by(
    before: RunState, stock: Stock, first: Int[Array, ""]
) -> tuple[Int[Array, "..."], ...] | None:
    """Ticks at which the ends of a stock were cut, as `RunState.cut_by`.

    Args:
        before: The state before these periods.
        stock: The stock after them.
        first: Index in the track of the row of that state, shape ().
    """
    if before.cut_by is None:
        return None
    later = (before.period_count - first) * Rays.TICKS

    def ticks(rays: Rays, earlier: Int[Array, "..."]) -> Int[Array, "..."]:
        # An end that these periods have not cut tells the slot that it was in.
        slot = jnp.clip(-1 - rays.poses, 0, earlier.shape[-1] - 1)
        kept = jnp.take_along_axis(earlier, slot, axis=-1)
        # Teeth stood where the run began before that, too.
        return jnp.where(rays.poses >= 0, jnp.maximum(rays.poses + later, 0), kept)

    pairs = zip(stock.families, before.cut_by, strict=True)
    return tuple(ticks(rays, earlier) for rays, earlier in pairs)


def _with_rows(
    process: ProcessState, ahead: Int[Array, ""], count: int
) -> ProcessState:
    """Return the state with its track moved ahead, and more rows behind it."""
    track = process.track
    more = count * track.substeps
    longer = jax.tree.map(
        lambda x: jnp.concatenate([x, jnp.broadcast_to(x[-1:], (more, 3))]),
        track.poses,
    )
    poses = longer.with_rows(ahead * track.substeps, track.poses)
    return _moved(process, PoseTrack(poses, track.substeps), ahead)


def _renumbered(process: ProcessState, back: Int[Array, ""], last: int) -> ProcessState:
    """Return the state with row `back + last` of its track as row `last`, its end."""
    S = process.track.substeps
    poses = jax.tree.map(
        lambda x: jax.lax.dynamic_slice_in_dim(x, back * S, last * S + 1),
        process.track.poses,
    )
    families = tuple(rays.numbered() for rays in process.stock.families)
    process = eqx.tree_at(lambda s: s.stock.families, process, families)
    return _moved(process, PoseTrack(poses, S), -back)


def _moved(
    process: ProcessState, track: PoseTrack, rows: Int[Array, ""] | int
) -> ProcessState:
    """Return the state with another track, in which its rows stand further on."""
    return eqx.tree_at(
        lambda s: (s.track, s.queue.row, s.newest.row),
        process,
        (track, process.queue.row + rows, process.newest.row + rows),
    )
