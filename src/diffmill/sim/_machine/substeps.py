"""The sub-steps of a machine that swings: force of the teeth, then the machine moves.

Each sub-step takes the force F of the teeth that pass in it, at the tip where the
machine will be in the middle of the sub-step, and hands it to the machine. What differs
from machine to machine is how a tooth period is prepared (`AbstractSwinging.span`) and
how the machine moves in it (`AbstractSpan`).
"""

import abc
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..._live_rows import when_live
from ..._types import IntScalar
from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    Substeps,
)
from ...workpiece import Pose
from .machine import AbstractMachine, Period, RunState


class CommandRow(eqx.Module):
    """The command in one tooth period, or in all.

    Attributes:
        start: At its start: motors theta [rad or m], or a pose, shape (*period, axis).
        stop: At its end, same shape.
    """

    start: Float[Array, "*period axis"]
    stop: Float[Array, "*period axis"]


class AbstractSpan(eqx.Module):
    """A machine in one tooth period, in `work`, ready for its sub-steps.

    Attributes:
        pose: At the start.
    """

    pose: eqx.AbstractVar[Pose]

    @abc.abstractmethod
    def middle(self, state: PyTree, time: Float[Array, ""]) -> Float[Array, " 3"]:
        """Return the tip in the middle of a sub-step, before its force is known [m].

        Args:
            state: The machine's, at the start of the sub-step.
            time: Of its middle, from the start of the period [s].
        """

    @abc.abstractmethod
    def step(
        self, state: PyTree, time: Float[Array, ""], load: Float[Array, " load"]
    ) -> PyTree:
        """Return the state at the end of a sub-step.

        Args:
            state: At its start.
            time: Of its middle, from the start of the period [s].
            load: Force on the tool [N], and its moment about the tip [N m] if the
                machine takes that; held over the sub-step.
        """

    @abc.abstractmethod
    def tip(self, state: PyTree) -> Float[Array, " 3"]:
        """Return the tip in a state of the period [m]."""


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


class AbstractSwinging(AbstractCompliant):
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
        if engagement.looks > 1:
            cutting, removed = engagement.advance(
                process, cutting, index - 1, span.pose
            )
            advanced = RunState(cutting, start, state.period_count)
            cut = None
            move = lambda: _run_looks(coupled, advanced, index, times, drift)
        else:
            cutting, cut, removed = process.advance(
                cutting, index, span.pose, predicted, is_live, look
            )
            looked = _Look(predicted, cut)
            move = lambda: _run_substeps(coupled, cutting.recent, looked, start, times)
        rest = jnp.broadcast_to(span.pose.tip[None], predicted.tip.shape)
        none = jnp.zeros((rest.shape[0], self.load_count), rest.dtype)
        still = LoadedSubsteps(predicted.tip, predicted.tip, rest, none)
        end, steps = when_live(is_live, move, (start, still))
        cutting = cutting.ended(
            along(span.pose, steps.tips), along(span.pose, steps.ends)
        )
        period = Period(
            tip=span.pose.tip,
            ends=steps.ends,
            force=jnp.mean(steps.loads[:, :3], axis=0),
            joint_positions=self.joint_positions(start),
            removed=removed,
            has_failed=cutting.has_overflow | cutting.is_beyond,
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

        def substep(state: PyTree, x: tuple[Array, Array]) -> tuple[PyTree, tuple]:
            time, load = x
            middle = span.middle(state, time)
            end = span.step(state, time, load)
            return end, (middle, span.tip(end))

        end, (tips, ends) = jax.lax.scan(substep, state, (times, loads))
        return PeriodMotion(end, span.pose, along(span.pose, tips), ends, None)

    @abc.abstractmethod
    def span(self, process: Process, state: PyTree, row: CommandRow) -> AbstractSpan:
        """Return the machine in a period, from its state and the command of that.

        Args:
            process: The process, of which tooth period and sub-steps count.
            state: The machine's, at the start.
            row: The command.
        """


class _Coupled(eqx.Module):
    """A machine in a period, and the process that pushes it."""

    process: Process
    span: AbstractSpan
    load_count: int = eqx.field(static=True)


class _Look(eqx.Module):
    """A look at the stock: the poses that were expected, and what was found there."""

    predicted: Pose
    found: Engagement


def _run_looks(
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
    looks = engagement.looks
    count = engagement.substeps // looks

    def part(
        carry: tuple[PyTree, Array], x: tuple[Array, Array, Pose]
    ) -> tuple[tuple[PyTree, Array], LoadedSubsteps]:
        state, ahead = carry
        first, times, recent = x
        near = eqx.tree_at(lambda p: p.recent, cutting, recent)
        predicted = along(pose, recent.tip[0] + ahead)
        substeps = Substeps(first, count)
        cut = process.engage(near, index, predicted, substeps)
        look = _Look(predicted, cut)
        end, rows = _run_substeps(coupled, recent, look, state, times)
        # How far the tool is off the period before goes on changing as it did.
        off = rows.tips - recent.tip[0]
        later = jnp.arange(1, count + 1, dtype=off.dtype)[:, None]
        return (end, off[-1:] + later * (off[-1:] - off[-2:-1])), rows

    split = lambda x: x.reshape(looks, count, *x.shape[1:])
    recent = jax.tree.map(
        lambda x: jnp.swapaxes(jax.vmap(split)(x), 0, 1), cutting.recent
    )
    first = count * jnp.arange(looks, dtype=jnp.int32)
    ahead = jnp.broadcast_to(drift, (count, 3))
    xs = (first, split(times), recent)
    (end, _), rows = jax.lax.scan(part, (begun.machine, ahead), xs)
    return end, jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), rows)


def _run_substeps(
    coupled: _Coupled,
    recent: Pose,
    look: _Look,
    start: PyTree,
    times: Float[Array, " substep"],
) -> tuple[PyTree, LoadedSubsteps]:
    """Return the state after sub-steps of a period, and these."""
    mean_load = _mean_wrench if coupled.load_count == 6 else _mean_force
    tool, span = _tool_of(coupled.process), coupled.span

    def substep(
        state: PyTree, x: tuple[Array, Pose, EdgeSamples]
    ) -> tuple[PyTree, tuple[Array, PyTree, Array]]:
        time, earlier, samples = x
        tip = span.middle(state, time)
        pose = Pose(tip, span.pose.axis)
        F = mean_load(tool, samples, pose, earlier, look.found.thinned)
        end = span.step(state, time, F)
        return end, (tip, end, F)

    earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), recent)
    # What the forces come from is computed again rather than kept.
    xs = times, earlier, look.found.samples
    end, (tips, states, loads) = jax.lax.scan(jax.checkpoint(substep), start, xs)
    ends = jax.vmap(span.tip)(states)
    return end, LoadedSubsteps(look.predicted.tip, tips, ends, loads)


def _tool_of(process: Process) -> Process:
    """Return a process without its stock, of which a force knows nothing."""
    return eqx.tree_at(lambda p: p.stock, process, None)


def _mean_force(
    process: Process, samples: EdgeSamples, pose: Pose, earlier: Pose, thinned: Pose
) -> Float[Array, " 3"]:
    """Return the force of a sub-step."""
    return _mean_wrench(process, samples, pose, earlier, thinned)[:3]


def _mean_wrench(
    process: Process, samples: EdgeSamples, pose: Pose, earlier: Pose, thinned: Pose
) -> Float[Array, " 6"]:
    """Return force and moment of a sub-step."""
    found = process.engagement.wrench(process, samples, pose, earlier, thinned)
    return jnp.mean(found, axis=0)


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
