"""The sub-steps of a machine that swings: force of the teeth, then the machine moves.

Each sub-step takes the force F of the teeth that pass in it, at the tip where the
machine will be in the middle of the sub-step, and hands it to the machine. Machines
differ in how a tooth period is prepared (`AbstractInertialMachine.span`) and in how the
machine moves in it (`AbstractPeriodDynamics` of `span.py`, which takes the sub-steps).
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..._padding import if_valid
from ..._types import IntScalar
from ...process import (
    Engagement,
    Process,
    Substeps,
)
from ...workpiece import Pose
from .machine import AbstractMachine, Period, RunState
from .span import AbstractPeriodDynamics, MachinePeriod, SubstepRow


class CommandRow(eqx.Module):
    """The command in one tooth period, or in all.

    Attributes:
        start: At its start: motors theta [rad or m], or a pose, shape (*period, axis).
        stop: At its end, same shape.
    """

    start: Float[Array, "*period axis"]
    stop: Float[Array, "*period axis"]


class LoadedSubsteps(eqx.Module):
    """Sub-steps of a period.

    Attributes:
        predicted: Tips at which the stock was looked up [m], shape (*substep, 3).
        tips: Tips in their middle [m], same shape.
        ends: Tips at their ends [m], same shape.
        loads: Forces in `work` [N] and, if the machine takes them, their moments about
            the tip [N m], shape (*substep, load).
        found: What was found in the stock; None where it was looked up several times.
    """

    predicted: Float[Array, "*substep 3"]
    tips: Float[Array, "*substep 3"]
    ends: Float[Array, "*substep 3"]
    loads: Float[Array, "*substep load"]
    found: Engagement | None = None


class PeriodMotion(eqx.Module):
    """Motion of a machine in a period whose loads are known.

    Attributes:
        end: The machine's state at the end.
        pose: At the start.
        middles: Poses in the middle of the sub-steps, shape (substep, 3).
        ends: Tips at their ends [m], shape (substep, 3).
        looked: Poses at which the stock is looked up, shape (substep, 3); None where
            they follow from the period before and the tips so far.
    """

    end: PyTree
    pose: Pose
    middles: Pose
    ends: Float[Array, "substep 3"]
    looked: Pose | None


class AbstractCompliant(AbstractMachine):
    """A machine that the loads of the sub-steps deflect."""

    @property
    @abc.abstractmethod
    def load_count(self) -> int:
        """Numbers of a load: 3 for a force, 6 with its moment."""

    def rows(
        self,
        process: Process,
        command: Float[Array, "step axis"],
        row_count: IntScalar | None,
    ) -> CommandRow:
        """Return the command at both ends of every period."""
        del process, row_count
        return CommandRow(command[:-1], command[1:])

    def period(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: CommandRow,
        is_live: Bool[Array, ""] | None,
    ) -> tuple[RunState, Period]:
        """Return the state after one tooth period, and its outputs."""
        return self.follow(process, state, index, row, is_live)[:2]

    @abc.abstractmethod
    def follow(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: CommandRow,
        is_live: Bool[Array, ""] | None = None,
        look: Callable[..., Engagement] | None = None,
    ) -> tuple[RunState, Period, LoadedSubsteps]:
        """Return what `period` does, and the sub-steps.

        Args:
            process: As of `period`.
            state: As of `period`.
            index: As of `period`.
            row: As of `period`.
            is_live: As of `period`.
            look: As of `Process.advance`; where a period looks up the stock several
                times, the engagement's own is taken.
        """

    @abc.abstractmethod
    def motion(
        self,
        process: Process,
        state: PyTree,
        row: CommandRow,
        loads: Float[Array, "substep load"],
    ) -> PeriodMotion:
        """Return the motion in a period, from its loads.

        Args:
            process: The process, of which tooth period and sub-steps count.
            state: The machine's, at the start.
            row: The command.
            loads: Loads of the sub-steps in `work` [N], [N m], shape (substep, load).
        """


class AbstractInertialMachine(AbstractCompliant):
    """A machine with inertia; it takes sub-steps."""

    def follow(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: CommandRow,
        is_live: Bool[Array, ""] | None = None,
        look: Callable[..., Engagement] | None = None,
    ) -> tuple[RunState, Period, LoadedSubsteps]:
        """Return what `period` does, and the sub-steps."""
        cutting, start = state.process, state.machine
        engagement, T = process.engagement, process.tooth_period
        span = self.span(process, start, row)
        coupled = _Coupled(process, span, self.load_count)
        # As in the period before: what the teeth do comes again, and drifts are slow.
        drift = (span.pose.tip - cutting.last_tip)[None]
        predicted = along(span.pose, cutting.recent.tip[0] + drift)
        times = T * process.substep_middles(row.start.dtype)
        if engagement.updates_per_period > 1:
            cutting, removed = engagement.advance(
                process, cutting, index - 1, span.pose
            )
            advanced = RunState(cutting, start, state.period_count)
            cut = None
            move = lambda: _run_updates(coupled, advanced, index, times, drift)
        else:
            cutting, cut, removed = process.advance(
                cutting, index, span.pose, predicted, is_live, look
            )
            looked = _Update(predicted, cut)
            before = _TeethPassed.of(coupled, cutting.recent)
            move = lambda: _run_substeps(coupled, before, looked, start, times)
        rest = jnp.broadcast_to(span.pose.tip[None], predicted.tip.shape)
        none = jnp.zeros((rest.shape[0], self.load_count), rest.dtype)
        still = LoadedSubsteps(predicted.tip, predicted.tip, rest, none)
        end, steps = if_valid(is_live, move, (start, still))
        cutting = cutting.ended(
            along(span.pose, steps.tips), along(span.pose, steps.ends)
        )
        period = Period(
            tip=span.pose.tip,
            ends=steps.ends,
            force=jnp.mean(steps.loads[:, :3], axis=0),
            joint_positions=self.joint_positions(start),
            removed=removed,
            has_failed=cutting.has_overflow | cutting.has_left_window,
        )
        steps = dataclasses.replace(steps, found=cut)
        return RunState(cutting, end, state.period_count), period, steps

    def motion(
        self,
        process: Process,
        state: PyTree,
        row: CommandRow,
        loads: Float[Array, "substep load"],
    ) -> PeriodMotion:
        """Return the motion in a period, from its loads."""
        span = self.span(process, state, row)
        times = process.tooth_period * process.substep_middles(loads.dtype)

        def substep(state: PyTree, row: _TimedLoad) -> tuple[PyTree, _TipsOfSubstep]:
            middle = span.middle(state, row.time)
            end = span.step(state, row.time, row.load)
            return end, _TipsOfSubstep(middle, span.tip(end))

        end, tips = jax.lax.scan(substep, state, _TimedLoad(times, loads))
        middles = along(span.pose, tips.middle)
        return PeriodMotion(end, span.pose, middles, tips.end, None)

    @abc.abstractmethod
    def span(
        self, process: Process, state: PyTree, row: CommandRow
    ) -> AbstractPeriodDynamics:
        """Return the machine in a period, from its state and the command of that.

        Args:
            process: The process, of which tooth period and sub-steps count.
            state: The machine's, at the start.
            row: The command.
        """


class _TimedLoad(NamedTuple):
    """The middle of a sub-step [s], and its load [N], [N m]."""

    time: Float[Array, "*substep"]
    load: Float[Array, "*substep load"]


class _TipsOfSubstep(NamedTuple):
    """The tip in the middle and at the end of a sub-step [m]."""

    middle: Float[Array, "*substep 3"]
    end: Float[Array, "*substep 3"]


class _Coupled(eqx.Module):
    """A machine in a period, and the process that pushes it."""

    process: Process
    span: AbstractPeriodDynamics
    load_count: int = eqx.field(static=True)


class _Update(eqx.Module):
    """A look at the stock: the poses that were expected, and what was found there."""

    predicted: Pose
    found: Engagement


class _TeethPassed(NamedTuple):
    """Where the teeth before passed.

    Attributes:
        earlier: As of `SubstepRow`.
        within: As of `SubstepRow`.
    """

    earlier: Pose
    within: Float[Array, "substep before tooth substep"] | None

    @staticmethod
    def of(coupled: _Coupled, recent: Pose) -> "_TeethPassed":
        """Return where they passed in the sub-steps of a period none of which is run.

        Args:
            coupled: The machine and the process.
            recent: Poses in the periods before, newest first, shape (tooth, substep,
                3).
        """
        process, pose = coupled.process, coupled.span.pose
        still = pose.repeated(recent.tip.shape[1])
        teeth = process.teeth_before(still.tip.dtype)
        within = None if teeth is None else teeth.within
        return _TeethPassed(process.earlier(recent, still), within)

    def part(
        self, first: Int[Array, ""], ways: Float[Array, "substep 3"], count: int
    ) -> "_TeethPassed":
        """Return where they passed in some sub-steps, those before these known.

        Args:
            first: Index of the first one, shape ().
            ways: As of `SubstepRow.passed`, of all sub-steps of the period.
            count: How many they are.
        """
        cut = lambda x, axis: jax.lax.dynamic_slice_in_dim(x, first, count, axis)
        earlier = jax.tree.map(lambda x: cut(x, 0), self.earlier)
        if self.within is None:
            return _TeethPassed(earlier, None)
        within = cut(self.within, 0)
        moved = jnp.einsum("skju,ua->skja", within, ways, precision="highest")
        earlier = Pose(earlier.tip + moved, earlier.axis)
        return _TeethPassed(earlier, cut(within, 3))


class _BeforeUpdate(NamedTuple):
    """The machine before a look.

    Attributes:
        machine: Its state.
        ahead: How far the tool will be from the period before [m].
        ways: As of `SubstepRow.passed`, of all sub-steps of the period; 0 for even
            teeth, which do not look back at them.
    """

    machine: PyTree
    ahead: Float[Array, "look 3"]
    ways: Float[Array, "substep 3"]


class _UpdateRow(NamedTuple):
    """The sub-steps of one look, or of all.

    Attributes:
        first: Number of the first one, shape (*look,).
        times: Their middles [s], shape (*look, substep).
        recent: Poses of the teeth before in them.
    """

    first: Int[Array, "*look"]
    times: Float[Array, "*look substep"]
    recent: Pose


def _run_updates(
    coupled: _Coupled,
    begun: RunState,
    index: Int[Array, ""],
    times: Float[Array, " substep"],
    drift: Float[Array, "1 3"],
) -> tuple[PyTree, LoadedSubsteps]:
    """Return what `_run_substeps` does, the stock looked up several times.

    Where a period is long, a machine swings within it, and the period before does not
    tell where the tool will be in its later sub-steps.
    """
    process, pose = coupled.process, coupled.span.pose
    engagement, cutting = process.engagement, begun.process
    updates_per_period = engagement.updates_per_period
    count = engagement.substeps // updates_per_period

    passed = _TeethPassed.of(coupled, cutting.recent)

    def part(
        before: _BeforeUpdate, row: _UpdateRow
    ) -> tuple[_BeforeUpdate, LoadedSubsteps]:
        recent = row.recent
        near = eqx.tree_at(lambda p: p.recent, cutting, recent)
        predicted = along(pose, recent.tip[0] + before.ahead)
        substeps = Substeps(row.first, count)
        cut = process.engage(near, index, predicted, substeps)
        look = _Update(predicted, cut)
        teeth = passed.part(row.first, before.ways, count)
        end, rows = _run_substeps(coupled, teeth, look, before.machine, row.times)
        ways = before.ways
        if teeth.within is not None:
            way = rows.tips - pose.tip[None]
            ways = jax.lax.dynamic_update_slice_in_dim(ways, way, row.first, 0)
        # How far the tool is off the period before goes on changing as it did.
        off = rows.tips - recent.tip[0]
        later = jnp.arange(1, count + 1, dtype=off.dtype)[:, None]
        ahead = off[-1:] + later * (off[-1:] - off[-2:-1])
        return _BeforeUpdate(end, ahead, ways), rows

    split = lambda x: x.reshape(updates_per_period, count, *x.shape[1:])
    recent = jax.tree.map(
        lambda x: jnp.swapaxes(jax.vmap(split)(x), 0, 1), cutting.recent
    )
    first = count * jnp.arange(updates_per_period, dtype=jnp.int32)
    ahead = jnp.broadcast_to(drift, (count, 3))
    looked = _UpdateRow(first, split(times), recent)
    ways = jnp.zeros_like(cutting.recent.tip[0])
    before = _BeforeUpdate(begun.machine, ahead, ways)
    last, rows = jax.lax.scan(part, before, looked)
    return last.machine, jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), rows)


def _run_substeps(
    coupled: _Coupled,
    before: _TeethPassed,
    look: _Update,
    start: PyTree,
    times: Float[Array, " substep"],
) -> tuple[PyTree, LoadedSubsteps]:
    """Return the state after sub-steps of a period, and these."""
    span = coupled.span
    rows = SubstepRow(times, before.earlier, look.found.samples, before.within)
    pushed = MachinePeriod(
        _tool_of(coupled.process), span, look.found.decimated, coupled.load_count
    )
    end, moved = pushed.run(start, rows)
    ends = jax.vmap(span.tip)(moved.end)
    return end, LoadedSubsteps(look.predicted.tip, moved.tip, ends, moved.load)


def _tool_of(process: Process) -> Process:
    """Return a process without its stock, of which a force knows nothing."""
    return eqx.tree_at(lambda p: p.stock, process, None)


def start_rate(
    command: Float[Array, "step axis"], period: Float[Array, ""]
) -> Float[Array, " axis"]:
    """Return how fast a command moves at the first instant.

    By the parabola through three instants: the mean speed of the first period alone
    would let a machine that starts from rest begin in motion.
    """
    rise = command[1] - command[0]
    if command.shape[0] > 2:
        rise = rise - (command[2] - 2 * command[1] + command[0]) / 2
    return rise / period


def along(pose: Pose, tips: Float[Array, "substep 3"]) -> Pose:
    """Return poses at other tips: within a period the tool does not tilt."""
    if pose.axis is None:
        return Pose(tips)
    return Pose(tips, jnp.broadcast_to(pose.axis[None], tips.shape))
