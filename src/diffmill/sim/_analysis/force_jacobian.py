"""Derivatives of the force of the teeth with respect to present and earlier tips."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import on_device
from ...numerics import CachedJit
from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    ProcessState,
    RemovedVolume,
)
from ...workpiece import Pose
from .monodromy import Regeneration

# Periods whose passes are removed together.
_TOGETHER = 16


def force_slopes(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"], substeps: int
) -> list[list[Regeneration]]:
    """Return the slopes of the force in some periods, by replaying the removal.

    Where the teeth differ they are those of the turn that ends with each period.

    Where there is material is held: a vibration changes the chip, not the arc of the
    cut nor its depth.

    Args:
        process: The process.
        path: Poses at the tooth instants, shape (step, 3).
        rows: The periods before these rows are asked for, from 1, ascending.
        substeps: Pieces of a period over which slopes are means.

    Returns:
        The slopes of the periods that repeat themselves, for each row.

    Differentiability: none, a host function.
    """
    # The path between two instants follows from their neighbours, too.
    longer = lambda x: np.concatenate([2 * x[:1] - x[1:2], x, 2 * x[-1:] - x[-2:-1]])
    padded = jax.tree.map(lambda x: on_device(longer(np.asarray(x))), path)
    carry, first, slopes = _begin(process, path), on_device(np.ones((), np.int32)), {}
    # What is removed is what the run removes; only the slopes take finer pieces.
    engagement = dataclasses.replace(process.engagement, substeps=substeps)
    fine = eqx.tree_at(lambda p: p.engagement, process, engagement)
    cutter, count = process.cutter, process.repeats_after
    # A path shorter than a turn stands for the rest by its first period.
    turns = np.maximum(rows[:, None] + np.arange(1 - count, 1), 1)
    delays = np.arange(1.0, cutter.flute_count + 1)
    if not cutter.has_even_pitch:
        delays = np.asarray(cutter.delays(np.float64)).reshape(-1)
    rows_of_turns = np.unique(turns)
    matters = on_device(_matters(process, np.asarray(path.tip), rows_of_turns))
    for row in rows_of_turns:
        last = on_device(np.asarray(row, np.int32))
        carry = _replay(process, carry, _Passes(padded, matters), first, last)
        if bool(carry.state.has_overflow):
            # A long run has only the pieces at once that the tool can reach.
            counts = [2 * count for count in process.stock.interval_counts]
            stock = process.stock.with_interval_counts(counts)
            wider = eqx.tree_at(lambda p: p.stock, process, stock)
            return force_slopes(wider, path, rows, substeps)
        found = _slopes_at(fine, carry.state, padded, last)
        now, before = (np.asarray(x, np.float64) for x in found)
        before = before.reshape(len(now), -1, 3, 3)
        slopes[row] = Regeneration(now, before, delays)
        first = on_device(np.asarray(row + 1, np.int32))
    return [[slopes[row] for row in turn] for turn in turns]


def _matters(
    process: Process, tips: Float[np.ndarray, "step 3"], rows: Int[np.ndarray, " row"]
) -> Bool[np.ndarray, " step"]:
    """Flags of the poses that may cut what the teeth meet at one of some rows.

    Two upright tools that are farther apart than their diameter touch nothing in
    common; walls are seen from a few rays beside it.
    """
    if not process.engagement.is_upright:
        return np.ones(len(tips), bool)
    reach = 2.2 * float(process.cutter.nominal_radius) + 8 * process.stock.spacing
    from scipy.spatial import KDTree

    near = KDTree(tips[rows, :2])
    return near.query(tips[:, :2], distance_upper_bound=reach)[0] < np.inf


class _Passes(eqx.Module):
    """Passes of a path.

    Attributes:
        padded: The path, with a pose more at either end.
        matters: Which of its poses cut anything that is looked at, shape (step,).
    """

    padded: Pose
    matters: Bool[Array, " step"]


class _Replayed(eqx.Module):
    """The process at a period, with the poses within it."""

    state: ProcessState
    middles: Pose
    ends: Pose


class _Place(NamedTuple):
    """Place of a replay.

    Attributes:
        period: The next one, shape ().
        now: The process before it.
        waiting: Periods that have entered since passes were removed, shape ().
    """

    period: Int[Array, ""]
    now: _Replayed
    waiting: Int[Array, ""]


@CachedJit
def _begin(process: Process, path: Pose) -> _Replayed:
    """Return the state before the first period, as if the tool had rested."""
    state = process.begin(path[0], path.tip.shape[0])
    still = path[0].repeated(process.engagement.substeps)
    return _Replayed(state, still, still)


@CachedJit
def _replay(
    process: Process,
    before: _Replayed,
    passes: _Passes,
    first: Int[Array, ""],
    last: Int[Array, ""],
) -> _Replayed:
    """Process in the last period, after its removal.

    It begins with the period before the first.
    """

    def take_in(state: ProcessState, index: Array, pose: Pose) -> ProcessState:
        if process.removes_together:
            return process.removal.enter(state, index, pose)
        return process.remove(state, index, pose)[0]

    def period(at: _Place) -> _Place:
        state = at.now.state.ended(at.now.middles, at.now.ends)
        near = _near(passes.padded, at.period)
        state = take_in(state, at.period - 1, near[1])
        middles, ends = process.poses_within(near)
        now = _Replayed(state, middles[1], ends[1])
        return _Place(at.period + 1, now, at.waiting + 1)

    def goes_on(at: _Place) -> Array:
        has_room = process.removal.has_room(at.now.state)
        return (at.period <= last) & (at.waiting < _TOGETHER) & has_room

    def block(at: _Place) -> _Place:
        none = jnp.zeros((), jnp.int32)
        # One period at least: a queue that is full is emptied behind it.
        at = jax.lax.while_loop(goes_on, period, period(at._replace(waiting=none)))
        return at._replace(now=_without_passes(process, at.now, passes.matters))

    begun = _Place(first, before, jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(lambda at: at.period <= last, block, begun).now


def _without_passes(
    process: Process, now: _Replayed, matters: Bool[Array, " row"]
) -> _Replayed:
    """Process without the passes that lie behind by the lag."""
    if not process.removes_together:
        return now
    dtype = now.state.last_tip.dtype
    nothing, here = RemovedVolume.nothing(0, dtype), jnp.zeros((), dtype)
    state, _ = process.removal.remove_behind(now.state, nothing, here, matters)
    return dataclasses.replace(now, state=state)


def _near(padded: Pose, period: Int[Array, ""]) -> Pose:
    """Poses at both ends of a period, and those before and behind it."""
    cut = lambda x: jax.lax.dynamic_slice_in_dim(x, period - 1, 4)
    return jax.tree.map(cut, padded)


@CachedJit
def _slopes_at(
    fine: Process, state: ProcessState, padded: Pose, period: Int[Array, ""]
) -> tuple[Float[Array, "substep 3 3"], Float[Array, "substep *before 3 3"]]:
    """Slopes of the force in a period, after its removal, as of `_slopes`.

    Args:
        fine: The process with the sub-steps over which slopes are means.
        state: The state, with sub-steps of its own.
        padded: The path, with a pose more at either end.
        period: Index of the period, shape ().
    """

    def middles(index: Int[Array, ""]) -> Pose:
        inner = fine.poses_within(_near(padded, jnp.maximum(index, 1))).middles[1]
        still = padded[1].repeated(fine.engagement.substeps)
        # Before the path the tool stood still.
        return jax.tree.map(lambda x, y: jnp.where(index < 1, y, x), inner, still)

    teeth = jnp.arange(1, fine.cutter.flute_count + 1, dtype=jnp.int32)
    recent, now = jax.vmap(middles)(period - teeth), middles(period)
    state = eqx.tree_at(lambda s: s.recent, state, recent)
    cut = fine.engagement.engage(fine, state, period, now)
    return _slopes(fine, cut, now, recent)


def _slopes(
    process: Process, cut: Engagement, middles: Pose, recent: Pose
) -> tuple[Float[Array, "substep 3 3"], Float[Array, "substep *before 3 3"]]:
    """Slopes of the force in the sub-steps of a period [N/m], as of `Regeneration`."""

    def slopes(
        samples: EdgeSamples, pose: Pose, earlier: Pose
    ) -> tuple[Float[Array, "3 3"], Float[Array, "3 *before 3"]]:
        def force(
            tip: Float[Array, " 3"], tips: Float[Array, "*before 3"]
        ) -> Float[Array, " 3"]:
            now, before = Pose(tip, pose.axis), Pose(tips, earlier.axis)
            found = process.engagement.wrench(
                process, samples, now, before, cut.decimated
            )
            return jnp.mean(found[:, :3], axis=0)

        # Of uneven teeth there are more poses before than components of a force.
        jacobian = jax.jacfwd if process.cutter.has_even_pitch else jax.jacrev
        return jacobian(force, argnums=(0, 1))(pose.tip, earlier.tip)

    earlier = process.earlier(recent, middles)
    now, before = jax.vmap(slopes)(cut.samples, middles, earlier)
    return now, jnp.moveaxis(before, 1, -2)
