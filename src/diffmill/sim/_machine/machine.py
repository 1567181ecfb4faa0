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
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..._padding import last_row, live_rows, scan_rows
from ..._result import RESULTS
from ..._types import IntScalar
from ...process import (
    Process,
    ProcessState,
    RemovedVolume,
)
from ...workpiece import Pose, PoseTrack, Stock
from .turn_chips import TurnChips


class RunState(eqx.Module):
    """All that a run needs to go on.

    Attributes:
        process: The stock, less the poses that wait for removal, and these.
        machine: The machine's own state, a tree.
        period_count: Tooth periods run so far, which tell the tooth that is next.
    """

    process: ProcessState
    machine: PyTree
    period_count: Int[Array, ""]


class PeriodRow(NamedTuple):
    """What a run is told of a tooth period, or of several.

    Attributes:
        period: Its index, shape (*period,); row 0 has none.
        command: The machine's, a tree.
        is_live: Whether the period counts, shape (*period,); None if all do, or if the
            scan says so beside the row.
    """

    period: Int[Array, "*period"]
    command: PyTree
    is_live: Bool[Array, "*period"] | None = None


class Period(eqx.Module):
    """Outputs of one tooth period.

    Attributes:
        tip: Tool tip in `work` at its start [m], shape (3,).
        ends: Tips at the ends of its sub-steps [m], shape (substep, 3).
        force: Mean force on the tool in `work` [N], shape (3,).
        joint_positions: At its start [rad or m], shape (joint,); None without joints.
        removed: What was removed at its start.
        has_failed: Whether a flag of the process is up.
        samples: Force at every angle [N], shape (sample, 3), if it is asked for.
    """

    tip: Float[Array, " 3"]
    ends: Float[Array, "substep 3"]
    force: Float[Array, " 3"]
    joint_positions: Float[Array, " joint"] | None
    removed: RemovedVolume
    has_failed: Bool[Array, ""]
    samples: Float[Array, "sample 3"] | None = None


class AbstractMachine(eqx.Module):
    """What moves the tool along a command, and how compliant it is."""

    @abc.abstractmethod
    def begin(self, process: Process, command: PyTree) -> PyTree:
        """Return the machine's state at the first instant.

        Args:
            process: The process.
            command: What it is told, one row per tooth instant.
        """

    @abc.abstractmethod
    def rows(
        self, process: Process, command: PyTree, row_count: IntScalar | None
    ) -> PyTree:
        """Return what every period needs of the command, a tree with an axis period.

        Args:
            process: The process.
            command: What the machine is told, one row per tooth instant.
            row_count: How many rows count, shape (); None for all.
        """

    @abc.abstractmethod
    def pose(self, process: Process, state: PyTree) -> Pose:
        """Return the tool's pose in `work`."""

    @abc.abstractmethod
    def joint_positions(self, state: PyTree) -> Float[Array, " joint"] | None:
        """Return the joint positions [rad or m], None without joints."""

    def chips(self, state: PyTree) -> TurnChips | None:
        """Return what the teeth met in the periods that are kept, None for none."""
        del state

    @abc.abstractmethod
    def period(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: PyTree,
        is_live: Bool[Array, ""] | None,
    ) -> tuple[RunState, Period]:
        """Return the state after one tooth period, and its outputs.

        Args:
            process: The process.
            state: State at its start.
            index: Index of the period, from 1, shape ().
            row: What it needs of the command, of `rows`.
            is_live: Whether the period counts; None if all do. Else the machine stands
                still.
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
            command: What the machine is told at the tooth instants: for `Rigid` the
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
        found = self.run_rows(process, command, row_count)
        return found.ended(found.ending.remove(process))

    def run_rows(
        self, process: Process, command: PyTree, row_count: IntScalar | None
    ) -> "RunRows":
        """Run the rows and leave what waits for removal behind the last of them.

        Arguments and **Differentiability** are those of `run`. The removal is the same
        for all machines, and apart from them it is compiled once.
        """
        rows = self.rows(process, command, row_count)
        step_count = _length(rows) + 1
        last = last_row(step_count, row_count)
        state = begin(self, process, command, step_count)
        first = jnp.ones((), jnp.int32)
        state, periods = _run_periods(self, process, state, first, rows, row_count)
        overlap, removed = _without_overlap(periods.removed)
        final = self.pose(process, state.machine)
        instants = _at_instants(self, periods, state, final, last)
        actual = instants.tip
        is_finite = jnp.all(jnp.isfinite(actual)) & jnp.all(jnp.isfinite(periods.force))
        time = process.tooth_period * jnp.arange(step_count, dtype=actual.dtype)
        return RunRows(
            time=time,
            actual=instants.tip,
            ends=all_ends(periods),
            force=with_first(periods.force),
            joint_positions=instants.joint_positions,
            initial_overlap_volume=overlap,
            instantaneous_force=None
            if periods.samples is None
            else with_first(periods.samples),
            chips=self.chips(state.machine),
            ending=Ending(
                state.process,
                final,
                last,
                removed,
                periods.has_failed,
                is_finite,
            ),
        )

    def begin_run(self, process: Process, command: PyTree) -> RunState:
        """Return the state from which the first segment of a run starts.

        Args:
            process: The process.
            command: The first rows of what the machine is told; three count.

        Differentiability: as `run`.
        """
        rows = process.removal.row_count
        state = begin(self, process, command, rows + 1)
        moved = _moved(state.process, state.process.track, rows)
        return RunState(moved, state.machine, state.period_count)

    def run_segment(
        self, process: Process, command: PyTree, state: RunState
    ) -> "RunSegment":
        """Run some periods from where an earlier run ended.

        Args:
            process: The process; its stock is the state's.
            command: As for `run`; row 0 is the last row of the segment before.
            state: State at row 0, of `begin_run` or of the segment before.

        Returns:
            The rows, and the state at the last of them; nothing of the queue is
            removed.

        Differentiability: as `run`; the state is differentiable but for the ends of
        rays, and under `ThroughPoses` the segment depends on earlier ones by the
        machine and the poses that wait for removal only.
        """
        # Ends that no pose of the segment cuts are those of the stock that it begins
        # with.
        process = eqx.tree_at(lambda p: p.stock, process, state.process.stock)
        rows = self.rows(process, command, None)
        count, history = _length(rows), process.removal.row_count
        started, first = continued(process, state, count)
        ended, periods = _run_periods(self, process, started, first, rows)
        final = self.pose(process, ended.machine)
        last = jnp.asarray(count, jnp.int32)
        instants = _at_instants(self, periods, ended, final, last)
        kept = _renumbered(ended.process, first - 1 - history + count, history)
        return RunSegment(
            instants.tip,
            all_ends(periods),
            with_first(periods.force),
            instants.joint_positions,
            RunState(kept, ended.machine, state.period_count + count),
        )


class Run(eqx.Module):
    """Solution of a machine that cuts; rows are the tooth instants.

    Attributes:
        time: [s], shape (step,).
        actual: Tool tip in `work` [m], shape (step, 3).
        ends: Tool tip at the ends of the sub-steps of the period before each instant
            [m], shape (step, substep, 3); row 0 is at rest.
        force: Mean force on the tool over the period before each instant, in `work`
            [N], shape (step, 3); zero in row 0.
        joint_positions: [rad or m], shape (step, joint); None without joints.
        removed_volume: Volume that each pose removes [m^3], shape (step,).
        shank_volume: What of it the shank above the flutes takes [m^3], which no tool
            can: shape (step,).
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        stock: The stock after the last pose.
        has_failed: Whether a flag was up after each step, shape (step,).
        result: Outcome of the run.
        instantaneous_force: Force at every angle sample of the period before each row
            [N], if it was asked for; sample j of n is that at the share (j + 1/2) / n
            of the period, shape (step, sample, 3).
        chips: What the teeth met in a revolution, if it was asked for.
    """

    time: Float[Array, " step"]
    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"] | None
    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    initial_overlap_volume: Float[Array, ""]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS
    instantaneous_force: Float[Array, "step sample 3"] | None
    chips: TurnChips | None = None


# The fields of `Run` with a row per step.
RUN_ROWS = (
    "time",
    "actual",
    "ends",
    "force",
    "joint_positions",
    "removed_volume",
    "shank_volume",
    "has_failed",
    "instantaneous_force",
)


class RunEnd(eqx.Module):
    """What the removal of all that waited behind the last row tells of a run.

    Attributes as of `Run`.
    """

    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS


class Ending(eqx.Module):
    """The process behind the last row of a run.

    Attributes:
        state: The stock, and what waits for removal.
        final: The tool's last pose, shape (3,).
        last: Index of the last row that counts, shape ().
        removed: What was removed in each period.
        has_failed: Whether a flag was up after each period, shape (period,).
        is_finite: Whether all that was computed is finite, shape ().
    """

    state: ProcessState
    final: Pose
    last: Int[Array, ""]
    removed: RemovedVolume
    has_failed: Bool[Array, " period"]
    is_finite: Bool[Array, ""]

    def remove(self, process: Process) -> RunEnd:
        """Remove all that waits.

        **Differentiability**: that of `AbstractMachine.run`.
        """
        count = self.has_failed.shape[0] + 1
        ended, rest = process.removal.finish(self.state, self.last, self.final, count)
        volume, by_shank = _volumes_by_pose(count, self.removed, rest)
        failed = _failed_rows(self.has_failed, ended, self.last)
        outcome = _outcome(ended, self.is_finite)
        return RunEnd(volume, by_shank, ended.stock, failed, outcome)


class RunRows(eqx.Module):
    """A run whose last poses still wait for removal.

    Attributes as of `Run`, and:
        ending: The process behind the last row.
    """

    time: Float[Array, " step"]
    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"] | None
    initial_overlap_volume: Float[Array, ""]
    instantaneous_force: Float[Array, "step sample 3"] | None
    chips: TurnChips | None
    ending: Ending

    def ended(self, end: RunEnd) -> Run:
        """Return the run, with what its ending has told."""
        return Run(
            time=self.time,
            actual=self.actual,
            ends=self.ends,
            force=self.force,
            joint_positions=self.joint_positions,
            removed_volume=end.removed_volume,
            shank_volume=end.shank_volume,
            initial_overlap_volume=self.initial_overlap_volume,
            stock=end.stock,
            has_failed=end.has_failed,
            result=end.result,
            instantaneous_force=self.instantaneous_force,
            chips=self.chips,
        )


class RunSegment(eqx.Module):
    """Solution of one segment of a run.

    Attributes as of `Run`, and:
        state: State at the last row. What still waits for removal is in it.
    """

    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"] | None
    state: RunState


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
    index: Int[Array, ""],
    rows: PyTree,
    row_count: IntScalar | None = None,
) -> tuple[RunState, Period]:
    """Return the state after all periods, from one of some index, and their outputs."""
    indices = index + jnp.arange(_length(rows), dtype=jnp.int32)

    def step(
        state: RunState, row: PeriodRow, is_live: Array | None
    ) -> tuple[RunState, Period]:
        return machine.period(process, state, row.period, row.command, is_live)

    # Removal looks at poses behind the last one, where the tool stands.
    return scan_rows(
        step,
        state,
        PeriodRow(indices, rows),
        live_rows(indices, row_count),
        behind=process.removal.standing_rows,
    )


def _length(rows: PyTree) -> int:
    return jax.tree.leaves(rows)[0].shape[0]


class _Instants(NamedTuple):
    """Tips [m] and joint positions [rad or m] at all instants; a row per step."""

    tip: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"] | None


def _at_instants(
    machine: AbstractMachine,
    periods: Period,
    state: RunState,
    final: Pose,
    last: Int[Array, ""],
) -> _Instants:
    actual = _through(periods.tip, final.tip, last)
    joints = machine.joint_positions(state.machine)
    if joints is None or periods.joint_positions is None:
        return _Instants(actual, None)
    return _Instants(actual, _through(periods.joint_positions, joints, last))


def _through(
    rows: Float[Array, "period n"], final: Float[Array, " n"], last: Int[Array, ""]
) -> Float[Array, "step n"]:
    """Return the rows at the start of every period, and from the last one on the end.

    Args:
        rows: One per period, shape (period, n).
        final: What is reached in the end, shape (n,).
        last: Index of the last row that counts, shape ().
    """
    rows = jnp.concatenate([rows, final[None]])
    index = jnp.arange(rows.shape[0], dtype=jnp.int32)
    return jnp.where((index < last)[:, None], rows, final[None])


def all_ends(periods: Period) -> Float[Array, "step substep 3"]:
    """Return the ends of sub-steps with those before the first instant, at rest."""
    rest = jnp.broadcast_to(periods.tip[:1, None], (1, *periods.ends.shape[1:]))
    return jnp.concatenate([rest, periods.ends])


def with_first(rows: Float[Array, "period ..."]) -> Float[Array, "step ..."]:
    """Return rows with one of zeros in front."""
    return jnp.concatenate([jnp.zeros_like(rows[:1]), rows])


def _without_overlap(removed: RemovedVolume) -> tuple[Float[Array, ""], RemovedVolume]:
    """Return what the tool stood in at first [m^3], and what was removed but for it.

    The first period removes nothing else.

    Args:
        removed: What was removed in each period of a run.
    """
    rest = lambda x: x.at[0].set(0)
    at = lambda removed: (removed.volume, removed.by_shank)
    volumes = (rest(removed.volume), rest(removed.by_shank))
    return jnp.sum(removed.volume[0]), eqx.tree_at(at, removed, volumes)


def _volumes_by_pose(
    step_count: int, removed: RemovedVolume, rest: RemovedVolume
) -> tuple[Float[Array, " step"], Float[Array, " step"]]:
    """Return what each pose took, and its shank, from steps that removed others."""
    both = []
    for taken, last in (
        (removed.volume, rest.volume),
        (removed.by_shank, rest.by_shank),
    ):
        volume = jnp.zeros(step_count, taken.dtype)
        volume = volume.at[removed.pose.reshape(-1)].add(taken.reshape(-1))
        both.append(volume.at[rest.pose].add(last))
    return both[0], both[1]


def _failed_rows(
    failed: Bool[Array, " period"], end: ProcessState, last: Int[Array, ""]
) -> Bool[Array, " step"]:
    """Return whether a flag was up after each step.

    Args:
        failed: Whether one was up after each period, shape (period,).
        end: The state after the last removal.
        last: The last step, to which that belongs.
    """
    rows = jnp.concatenate([jnp.zeros(1, bool), failed])
    return rows.at[last].set(rows[last] | end.has_overflow | end.has_left_window)


def _outcome(state: ProcessState, is_finite: Bool[Array, ""]) -> RESULTS:
    """Return the outcome of a run from the flags in its last state."""
    result = RESULTS.where(
        state.has_left_window, RESULTS.window_overflow, RESULTS.successful
    )
    result = RESULTS.where(state.has_overflow, RESULTS.interval_overflow, result)
    return RESULTS.where(is_finite, result, RESULTS.non_finite)


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
