"""Adaptive engagement updates: several tooth periods of a steady cut share one.

Where a cut is steady the teeth meet the same material period after period. Between two
updates the engagement is reused while the tool moves on with it: the force follows the
chips of the actual path, sub-step after sub-step, so that machine and regeneration are
those of the full run. What is reused are the shares of the edges that are in the stock.

    update in period k + n  ->  |F - F_reused| <= tolerance max |F|: keep the block
                                else return to period k and try n / 2

# symbols: k period before the block, n its length, F force of the update, F_reused that
of the engagement before it

Passes of the teeth behind the lag are removed between two blocks, together. With blocks
of one period it is the full run.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    ProcessState,
    RemovedVolume,
)
from ...workpiece import Pose
from .machine import (
    AbstractMachine,
    EngagementUpdates,
    Period,
    PeriodRow,
    RunState,
    StockAccess,
)
from .rigid import period_wrench

# Difference of the forces at an update that is accepted, as a share of the largest.
_TOLERANCE = 0.01
# Periods of a block at most; its way as a share of the lag of removal, which what a
# block itself has cut must not exceed by much, and of the cutter's radius.
_MOST, _LAGS, _RADII = 32, 1.0, 0.5
# Where hardly any force acts, less than this share of the largest, a block goes a
# quarter of that: what the tool touches in passing must not lie between two updates.
_SLIGHT = 0.05
# A block with a difference below this share of the tolerance is followed by one twice
# as long; one with a difference above this multiple is tried again with a quarter.
_CLOSE, _FAR = 0.35, 6.0


class ReusedEngagement(eqx.Module):
    """Engagement of an update, for later periods.

    Attributes:
        samples: The edges.
        period: The period of the update, shape ().
    """

    samples: EdgeSamples
    period: Int[Array, ""]

    def at(self, process: Process, period: Int[Array, ""]) -> EdgeSamples:
        """The edges in another period, which begins with another tooth.

        Args:
            process: The process.
            period: Its index, shape ().
        """
        count, shift = process.cutter.flute_count, self.period - period
        teeth = lambda s: [s.tooth] + ([] if s.bottom is None else [s.bottom.tooth])
        turned = lambda x: jnp.mod(x + shift, count)
        return eqx.tree_at(teeth, self.samples, replace_fn=turned)


class _Row(NamedTuple):
    """State within a block.

    Attributes:
        done: Periods of the block so far, shape ().
        state: Of the run; stock and track are those of before the block, but for what
            its periods have written into the track.
        found: The engagement of the newest period.
        miss: As of `EngagementUpdates`, of the newest period, shape ().
        force: Size of the force of that period [N], shape ().
        rows: The outputs.
        has_updated: Whether the newest period had an update.
    """

    done: Int[Array, ""]
    state: RunState
    found: EdgeSamples
    miss: Float[Array, ""]
    force: Float[Array, ""]
    rows: Period
    has_updated: Bool[Array, ""]


class _Block(NamedTuple):
    """State between two blocks.

    Attributes:
        done: Periods done, shape ().
        length: Periods of the next block, shape ().
        reused: The engagement of the last update.
        largest: Largest force so far [N], shape ().
        state: Of the run.
        rows: The outputs, as far as they are known.
        updates: The engagement updates, likewise.
        removed: What was removed.
        step: Way of the tool in a period of the last block [m], shape ().
        force: Size of the force at the last update [N], shape ().
    """

    done: Int[Array, ""]
    length: Int[Array, ""]
    reused: ReusedEngagement
    largest: Float[Array, ""]
    state: RunState
    rows: Period
    updates: EngagementUpdates
    removed: RemovedVolume
    step: Float[Array, ""]
    force: Float[Array, ""]


class _AdaptiveRun(eqx.Module):
    """Run of some periods in blocks, with an update in the last period of each.

    Attributes:
        machine: The machine.
        process: The process.
        rows: All periods.
        count: How many periods are run, shape (); those behind have no outputs.
    """

    machine: AbstractMachine
    process: Process
    rows: PeriodRow
    count: Int[Array, ""]

    @property
    def _longest(self) -> float | Float[Array, ""]:
        """Longest way of a block [m]."""
        process = self.process
        radius = process.cutter.nominal_radius
        return jnp.minimum(_LAGS * process.engagement.removal_lag, _RADII * radius)

    def run(self, state: RunState) -> tuple[RunState, Period, EngagementUpdates]:
        """State after the periods, their outputs, and the updates.

        The volumes of the outputs are those of all poses of the track.

        Args:
            state: State before the first.
        """
        is_going = lambda block: block.done < self.count
        block = lambda given: self._block(given)
        ended = jax.lax.while_loop(is_going, block, self._begun(state))
        periods = eqx.tree_at(lambda p: p.removed, ended.rows, ended.removed)
        return ended.state, periods, ended.updates

    def _is_clear(self, tip: Float[Array, " 3"]) -> Bool[Array, ""]:
        """True if the tool is clear of the stock by more than a step."""
        process, stock = self.process, self.process.stock
        if not process.engagement.is_upright:
            return jnp.zeros((), bool)
        R = process.cutter.diameter / 2
        shape = jnp.asarray(stock.grid_shape, tip.dtype)
        upper = stock.origin + stock.spacing * shape
        beside = (tip < stock.origin - 1.5 * R) | (tip > upper + 1.5 * R)
        return jnp.any(beside[:2]) | (tip[2] > stock.top + R / 2)

    def _begun(self, state: RunState) -> _Block:
        """State before the first block, with room for all outputs."""
        count, dtype = self.rows.period.shape[0], state.process.last_tip.dtype
        first = jax.tree.map(lambda x: x[0], self.rows)
        access = StockAccess(remove=_enter)

        def outputs() -> tuple[Period, EdgeSamples]:
            out = self.machine.period(self.process, state, first, access)[1]
            assert out.engagement is not None
            return out.recorded(), out.engagement.samples

        period, found = jax.eval_shape(outputs)
        room = lambda x: jnp.zeros((count, *x.shape), x.dtype)
        zeros = lambda x: jnp.zeros(x.shape, x.dtype)
        track, zero = state.process.track, jnp.zeros((), dtype)
        poses = track.poses.tip.shape[0] // track.substeps + 1
        samples = jax.tree.map(zeros, found)
        return _Block(
            done=jnp.zeros((), jnp.int32),
            length=jnp.ones((), jnp.int32),
            reused=ReusedEngagement(samples, first.period),
            largest=zero,
            state=state,
            rows=jax.tree.map(room, period),
            updates=EngagementUpdates(jnp.zeros(count, bool), jnp.zeros(count, dtype)),
            removed=RemovedVolume.nothing(poses, dtype),
            step=zero,
            force=zero,
        )

    def _block(self, given: _Block) -> _Block:
        """State after another block, or after a shorter one is to be tried."""
        removal, k = self.process.removal, given.done
        before = self.rows.period[0] + k - 1
        length = jnp.minimum(given.length, self.count - k)
        is_slight = given.force < _SLIGHT * given.largest
        longest = jnp.where(is_slight, self._longest / 4, self._longest)
        ahead = jnp.minimum(length.astype(longest.dtype) * given.step, longest)
        cut, removed = removal.remove_behind(given.state.process, given.removed, ahead)
        begun = eqx.tree_at(lambda s: s.process, given.state, cut)
        zero = jnp.zeros_like(given.largest)
        row = _Row(
            done=jnp.zeros((), jnp.int32),
            state=begun,
            found=given.reused.samples,
            miss=zero,
            force=zero,
            rows=given.rows,
            has_updated=jnp.zeros((), bool),
        )
        ran = jax.lax.while_loop(
            lambda each: ~each.has_updated,
            lambda each: self._row(each, given, length, cut.newest.travel + longest),
            row,
        )
        largest = jnp.maximum(given.largest, ran.force)
        miss = ran.miss / jnp.maximum(largest, jnp.finfo(zero.dtype).tiny)
        is_kept = (miss <= _TOLERANCE) | (ran.done == 1)
        pick = lambda new, old: jnp.where(is_kept, new, old)
        # Stock and track stay: nothing is removed within a block, and what it has
        # written into the track is written anew.
        small = jax.tree.map(pick, _without_stock(ran.state), _without_stock(begun))
        way = ran.state.process.newest.travel - cut.newest.travel
        found = ReusedEngagement(ran.found, before + ran.done)
        at = k + ran.done - 1
        put = lambda x, new: x.at[at].set(new)
        new = is_kept, pick(ran.miss, zero)
        updates = EngagementUpdates(*map(put, given.updates, new))
        shorter = jnp.where(miss > _FAR * _TOLERANCE, ran.done // 4, ran.done // 2)
        longer = jnp.where(miss < _CLOSE * _TOLERANCE, 2 * length, length)
        longer = jnp.where(miss > _TOLERANCE, 1, longer)
        return _Block(
            done=jnp.where(is_kept, k + ran.done, k),
            length=jnp.clip(jnp.where(is_kept, longer, shorter), 1, _MOST),
            reused=jax.tree.map(pick, found, given.reused),
            largest=pick(largest, given.largest),
            state=eqx.combine(small, ran.state),
            rows=ran.rows,
            updates=updates,
            removed=removed,
            step=pick(way / ran.done.astype(way.dtype), given.step),
            force=pick(ran.force, given.force),
        )

    def _row(
        self,
        each: _Row,
        given: _Block,
        length: Int[Array, ""],
        farthest: Float[Array, ""],
    ) -> _Row:
        """State after another period of a block.

        Args:
            each: The state.
            given: That before the block.
            length: Periods of the block at most, shape ().
            farthest: Travelled distance at which the block ends [m], shape ().
        """
        process, state, k = self.process, each.state, given.done + each.done
        row = jax.tree.map(lambda x: x[k], self.rows)
        is_far = ~self._is_clear(state.process.last_tip)
        is_far &= state.process.newest.travel >= farthest
        is_last = (each.done + 1 >= length) | is_far
        is_last |= ~process.removal.has_room(state.process)
        reused = given.reused.at(process, row.period)
        updates = is_last if row.is_live is None else is_last & row.is_live

        def engage(
            process: Process, state: ProcessState, row: PeriodRow, predicted: Pose
        ) -> Engagement:
            return jax.lax.cond(
                updates,
                lambda: process.engage(state, row.period, predicted),
                lambda: Engagement(reused, process.removal.decimated_poses(state)),
            )

        access = StockAccess(engage, _enter)
        ended, out = self.machine.period(process, state, row, access)
        cut = out.engagement
        assert cut is not None

        def miss() -> Float[Array, ""]:
            recent = state.process.recent
            kept = eqx.tree_at(lambda e: e.samples, cut, reused)
            wrench = period_wrench(process, kept, ended.process.recent[0], recent)
            off = jnp.mean(wrench[:, :3], axis=0) - out.force
            return jnp.sqrt(jnp.sum(off**2))

        put = lambda x, new: x.at[k].set(new)
        return _Row(
            done=each.done + 1,
            state=ended,
            found=cut.samples,
            miss=jax.lax.cond(updates, miss, lambda: jnp.zeros_like(each.miss)),
            force=jnp.sqrt(jnp.sum(out.force**2)),
            rows=jax.tree.map(put, each.rows, out.recorded()),
            has_updated=is_last,
        )


def run_adaptive(
    machine: AbstractMachine,
    process: Process,
    state: RunState,
    rows: PeriodRow,
    count: Int[Array, ""],
) -> tuple[RunState, Period, EngagementUpdates]:
    """State behind some periods, their outputs, and the updates.

    Args:
        machine: The machine.
        process: The process.
        state: State before the first.
        rows: All periods.
        count: How many of them are run, shape (); those behind have no outputs.

    Returns:
        State, outputs and updates; the volumes are those of all poses of the track.

    Raises:
        ValueError: Teeth are not alike, passes do not wait for their removal, or a
            period has several updates.

    **Differentiability**: in forward mode.
    """
    is_even = process.cutter.has_even_pitch and process.removes_together
    if not is_even or process.engagement.updates_per_period > 1:
        raise ValueError(
            "Argument `process` must have a cutter of even pitch and without run-out, "
            'the chips of "near_far" and one engagement update in a period, which is '
            "then reused."
        )
    return _AdaptiveRun(machine, process, rows, count).run(state)


def _enter(
    process: Process, state: ProcessState, index: Int[Array, ""], pose: Pose
) -> tuple[ProcessState, RemovedVolume]:
    """Take in a pose, and remove nothing."""
    none = jnp.zeros(0, pose.tip.dtype)
    nothing = RemovedVolume(jnp.zeros(0, jnp.int32), none, none)
    return process.removal.enter(state, index, pose), nothing


def _without_stock(state: RunState) -> PyTree:
    """State with None in place of stock and track."""
    large = lambda s: (s.process.stock, s.process.track)
    none = jax.tree.map(lambda _: None, large(state))
    return eqx.tree_at(large, state, none)
