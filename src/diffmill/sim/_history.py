"""What the process remembers: the stock, and the poses not yet removed from it.

Removal lags behind the tool by a travelled distance of at least sqrt(R d), the
distance at which the freshly cut surface has left the smoothing band; the history
that spans it is a queue of fixed length whose entries are a minimum distance apart,
so that a slow or dwelling tool cannot fill it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..cutter import AbstractCutter
from ..cutting import safe_norm
from ..workpiece import Pose, Stock, remove_poses, repeated
from ._adjoint import AbstractAdjoint
from ._plan import ProcessPlan

# Entries of the history; with the lag this sets the least distance between entries.
QUEUE_LENGTH = 48
# Earlier circles, as shares of the lag, beyond the exact ones of the last teeth.
_THINNED = (0.25, 0.5, 0.75, 1.0)
# Two poses at most leave the history in a step, so that it shrinks after slow feed.
_REMOVALS = 2


class ProcessState(eqx.Module):
    """What the process remembers between tooth periods.

    Attributes:
        stock: The workpiece, less the poses still in the queue.
        poses: Every pose so far, shape (pose, 3); row k is time t_k.
        last_tip: Tip of the newest of them, without derivative [m], shape (3,).
        recent: Poses in the middle of the sub-steps of the last tooth periods, newest
            first, shape (tooth, substep, 3).
        queue: Poses that wait for removal, oldest first, shape (queue,).
        queue_travel: Distance travelled when each entry came in [m], shape (queue,).
        queue_count: Number of entries, shape ().
        travel: Distance travelled so far [m], shape ().
        has_overflow: Whether a ray ran out of slots, shape ().
        is_beyond: Whether the tool reached beyond its window, shape ().
    """

    stock: Stock
    poses: Pose
    last_tip: Float[Array, " 3"]
    recent: Pose
    queue: Int[Array, " queue"]
    queue_travel: Float[Array, " queue"]
    queue_count: Int[Array, ""]
    travel: Float[Array, ""]
    has_overflow: Bool[Array, ""]
    is_beyond: Bool[Array, ""]


class Removed(eqx.Module):
    """Poses removed in one step and what each took [m^3].

    Attributes:
        pose: Their indices, shape (pose,).
        volume: All that a pose took [m^3], shape (pose,).
        by_shank: What of it the shank took, above the flutes [m^3], shape (pose,).
    """

    pose: Int[Array, " pose"]
    volume: Float[Array, " pose"]
    by_shank: Float[Array, " pose"]


def initial_state(
    plan: ProcessPlan,
    stock: Stock,
    cutter: AbstractCutter,
    pose: Pose,
    pose_count: int,
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Float[Array, ""]]:
    """Return the state at pose 0 and the volume of the stock that the tool stands in.

    Args:
        plan: Sizes of the process.
        stock: The raw workpiece.
        cutter: The cutter.
        pose: Pose 0, shape (3,).
        pose_count: Number of poses of the whole run.
        adjoint: How the run is differentiated.

    Returns:
        The state, and the overlap [m^3], shape ().
    """
    dtype = stock.origin.dtype
    zero = jnp.zeros((), jnp.int32)
    cut = remove_poses(
        stock,
        cutter,
        plan.window,
        adjoint.removal_poses(repeated(pose, (1,))),
        zero[None],
        jnp.ones(1, bool),
    )
    state = ProcessState(
        stock=cut.stock,
        poses=repeated(pose, (pose_count,)),
        last_tip=jax.lax.stop_gradient(pose.tip),
        recent=repeated(pose, (cutter.flute_count, plan.substeps)),
        queue=jnp.zeros(QUEUE_LENGTH, jnp.int32),
        queue_travel=jnp.zeros(QUEUE_LENGTH, dtype),
        queue_count=jnp.ones((), jnp.int32),
        travel=jnp.zeros((), dtype),
        has_overflow=cut.has_overflow,
        is_beyond=cut.is_beyond,
    )
    return state, cut.volume[0]


def remember(
    plan: ProcessPlan,
    state: ProcessState,
    index: Int[Array, ""],
    pose: Pose,
) -> ProcessState:
    """Enter a pose in the table, and in the queue if it is far enough from the last."""
    frozen = jax.lax.stop_gradient
    # Reading the table before it is written would make XLA copy it in every step.
    travel = state.travel + safe_norm(frozen(pose.tip - state.last_tip))
    poses = state.poses.with_row(index, pose)
    newest = state.queue_travel[state.queue_count - 1]
    is_far = travel - newest >= plan.lag / QUEUE_LENGTH
    at = jnp.where(is_far, state.queue_count, QUEUE_LENGTH)
    return eqx.tree_at(
        lambda s: (
            s.poses,
            s.last_tip,
            s.queue,
            s.queue_travel,
            s.queue_count,
            s.travel,
        ),
        state,
        (
            poses,
            frozen(pose.tip),
            state.queue.at[at].set(index, mode="drop"),
            state.queue_travel.at[at].set(travel, mode="drop"),
            state.queue_count + is_far.astype(jnp.int32),
            travel,
        ),
    )


def remove_due(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Removed]:
    """Remove up to two poses that the tool has left behind by the lag."""
    indices = state.queue[:_REMOVALS]
    poses = state.poses[indices]
    age = state.travel - state.queue_travel[:_REMOVALS]
    is_full = state.queue_count >= QUEUE_LENGTH
    is_due = (age >= plan.lag) & (
        jnp.arange(_REMOVALS, dtype=jnp.int32) < state.queue_count - 1
    )
    is_due = is_due | (is_full & (jnp.arange(_REMOVALS, dtype=jnp.int32) == 0))
    apart = jnp.max(jnp.abs(jax.lax.stop_gradient(poses.tip[1] - poses.tip[0])))
    is_due = is_due.at[1].set(is_due[0] & is_due[1] & (apart <= plan.window.slack))
    cut = remove_poses(
        state.stock,
        cutter,
        plan.window,
        adjoint.removal_poses(poses),
        indices,
        is_due,
    )
    count = jnp.sum(is_due, dtype=jnp.int32)
    shift = jnp.minimum(
        jnp.arange(QUEUE_LENGTH, dtype=jnp.int32) + count, QUEUE_LENGTH - 1
    )
    state = eqx.tree_at(
        lambda s: (
            s.stock,
            s.queue,
            s.queue_travel,
            s.queue_count,
            s.has_overflow,
            s.is_beyond,
        ),
        state,
        (
            cut.stock,
            state.queue[shift],
            state.queue_travel[shift],
            state.queue_count - count,
            state.has_overflow | cut.has_overflow,
            state.is_beyond | cut.is_beyond,
        ),
    )
    return state, Removed(indices, cut.volume, cut.by_shank)


def thinned_poses(plan: ProcessPlan, state: ProcessState) -> Pose:
    """Return the newest poses in the queue at given distances behind the tool."""
    slots = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32)
    age = state.travel - state.queue_travel
    picks = []
    for share in _THINNED:
        is_old = (age >= share * plan.lag) & (slots < state.queue_count)
        picks.append(jnp.max(jnp.where(is_old, slots, 0)))
    return state.poses[state.queue[jnp.stack(picks)]]


def end_period(state: ProcessState, middles: Pose) -> ProcessState:
    """Keep the poses in the middle of the sub-steps of the period just run."""
    recent = jax.tree.map(
        lambda new, old: jnp.concatenate([new[None], old[:-1]]), middles, state.recent
    )
    return eqx.tree_at(lambda s: s.recent, state, recent)


def flush(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    pose: Pose,
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Removed]:
    """Remove all that the history still holds, the last pose included.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        state: State after the last period.
        index: Index of the last pose, shape ().
        pose: The last pose, shape (3,).
        adjoint: How the run is differentiated.

    Returns:
        The state with an empty history, and what was removed.
    """
    table = state.poses.with_row(index, pose)
    waiting = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32) < state.queue_count
    indices = jnp.concatenate([state.queue, index[None]])
    is_due = jnp.concatenate([waiting, jnp.ones(1, bool)])

    def remove(carry, x):
        stock, has_overflow, is_beyond = carry
        at, due = x
        poses = adjoint.removal_poses(table[at[None]])
        cut = remove_poses(stock, cutter, plan.window, poses, at[None], due[None])
        flags = (has_overflow | cut.has_overflow, is_beyond | cut.is_beyond)
        return (cut.stock, *flags), (cut.volume[0], cut.by_shank[0])

    carry = (state.stock, state.has_overflow, state.is_beyond)
    (stock, full, beyond), taken = jax.lax.scan(remove, carry, (indices, is_due))
    state = eqx.tree_at(
        lambda s: (s.stock, s.poses, s.queue_count, s.has_overflow, s.is_beyond),
        state,
        (stock, table, jnp.zeros((), jnp.int32), full, beyond),
    )
    return state, Removed(indices, *taken)
