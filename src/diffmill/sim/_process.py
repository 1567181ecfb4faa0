"""One tooth period of the cutting process: remove, look, and cut.

The step has two halves, because a robot moves within a tooth period:

1. `begin_period` takes the pose at the start of the period into the history, removes
   from the stock the poses that the tool has left behind, and samples where along the
   tooth paths of this period there is material.
2. `substep_force` gives the force of one sub-step for an actual tip position, from
   the chip between it and the tips one or more tooth periods earlier.

Removal lags behind the tool by a travelled distance of at least sqrt(R d), the
distance at which the freshly cut surface has left the smoothing band; the history
that spans it is a queue of fixed length whose entries are a minimum distance apart,
so that a slow or dwelling tool cannot fill it.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..cutter import AbstractCutter
from ..cutting import (
    AbstractForceLaw,
    circle_chip,
    edge_contact,
    layer_share,
    safe_norm,
)
from ..workpiece import (
    Discs,
    RemovalWindow,
    Stock,
    has_material_above,
    occupancy,
    removal_window,
    remove_poses,
)
from ._adjoint import AbstractAdjoint

# Entries of the history; with the lag this sets the least distance between entries.
QUEUE_LENGTH = 48
# Earlier circles, as shares of the lag, beyond the exact ones of the last teeth.
_THINNED = (0.25, 0.5, 0.75, 1.0)
# Cosine of how far outside the leading half a tooth may still cut.
_BEFORE_LEADING = 0.05
# Two poses at most leave the history in a step, so that it shrinks after slow feed.
_REMOVALS = 2


class ProcessPlan(eqx.Module):
    """How finely the process is computed; sizes are static.

    Attributes:
        angles: Samples of the immersion angle per revolution.
        substeps: Sub-steps per tooth period.
        discs: Discs of the cutter.
        window: Window of rays of a removal.
        lag: Travelled distance by which removal lags [m].
    """

    angles: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    discs: Discs
    window: RemovalWindow
    lag: float = eqx.field(static=True)


class ProcessState(eqx.Module):
    """What the process remembers between tooth periods.

    Attributes:
        stock: The workpiece, less the poses still in the queue.
        pose_tips: Tip of every pose so far [m], shape (pose, 3); row k is time t_k.
        last_tip: The newest of them, without derivative [m], shape (3,).
        recent: Tips in the middle of the sub-steps of the last tooth periods, newest
            first [m], shape (tooth, substep, 3).
        queue: Poses that wait for removal, oldest first, shape (queue,).
        queue_travel: Distance travelled when each entry came in [m], shape (queue,).
        queue_count: Number of entries, shape ().
        travel: Distance travelled so far [m], shape ().
        has_overflow: Whether a ray ran out of slots, shape ().
        is_beyond: Whether the tool reached beyond its window, shape ().
    """

    stock: Stock
    pose_tips: Float[Array, "pose 3"]
    last_tip: Float[Array, " 3"]
    recent: Float[Array, "tooth substep 3"]
    queue: Int[Array, " queue"]
    queue_travel: Float[Array, " queue"]
    queue_count: Int[Array, ""]
    travel: Float[Array, ""]
    has_overflow: Bool[Array, ""]
    is_beyond: Bool[Array, ""]


class Engagement(eqx.Module):
    """Where the teeth of one tooth period meet material.

    Attributes:
        angle: Immersion angle of the samples [rad], shape (substep, angle, kept,
            disc); the axis disc has length 1 if the flutes are straight.
        occupancy: 0 to 1, shape (substep, angle, kept, element).
        thinned: Tips of some older poses [m], shape (circle, 3).
    """

    angle: Float[Array, "substep angle kept disc"]
    occupancy: Float[Array, "substep angle kept element"]
    thinned: Float[Array, "circle 3"]


class Removed(eqx.Module):
    """Poses removed in one step and the volume of each [m^3]."""

    pose: Int[Array, " pose"]
    volume: Float[Array, " pose"]


def process_plan(
    stock: Stock,
    cutter: AbstractCutter,
    *,
    axial_depth: float,
    angles: int | None = None,
    substeps: int = 8,
    element_height: float | None = None,
) -> ProcessPlan:
    """Choose the sizes of a process.

    Args:
        stock: The workpiece.
        cutter: The cutter.
        axial_depth: Deepest immersion below the top of the stock [m].
        angles: Samples per revolution; raised to a multiple of teeth x substeps.
            At least 180 if not given.
        substeps: Sub-steps per tooth period.
        element_height: Height of a disc [m]; 3.5 ray spacings if not given.

    Returns:
        The plan.
    """
    unit = cutter.flute_count * substeps
    angles = math.ceil((180 if angles is None else angles) / unit) * unit
    dz = 3.5 * stock.spacing if element_height is None else float(element_height)
    # One more disc than the depth holds: its share rises before it is immersed.
    elements = max(1, math.ceil(axial_depth / dz + 0.5))
    radius = cutter.nominal_radius
    # Samples on the rim farther apart than the rays must not step over a wall.
    band = 0.5 * max(stock.spacing, radius * 2 * math.pi / angles)
    # The sagitta of a fresh surface at this distance is beyond the band.
    lag = 1.25 * math.sqrt(2 * radius * band)
    window = removal_window(stock, cutter, axial_depth, 2 * stock.spacing)
    return ProcessPlan(angles, substeps, Discs(elements, dz, band), window, lag)


def initial_state(
    plan: ProcessPlan,
    stock: Stock,
    cutter: AbstractCutter,
    tip: Float[Array, " 3"],
    pose_count: int,
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Float[Array, ""]]:
    """Return the state at pose 0 and the volume of the stock that the tool stands in.

    Args:
        plan: Sizes of the process.
        stock: The raw workpiece.
        cutter: The cutter.
        tip: Tip of pose 0 [m], shape (3,).
        pose_count: Number of poses of the whole run.
        adjoint: How the run is differentiated.

    Returns:
        The state, and the overlap [m^3], shape ().
    """
    dtype = stock.origin.dtype
    pose_tips = jnp.broadcast_to(tip[None], (pose_count, 3))
    zero = jnp.zeros((), jnp.int32)
    stock, overlap, full, beyond = remove_poses(
        stock,
        cutter,
        plan.window,
        adjoint.removal_tips(tip[None]),
        zero[None],
        jnp.ones(1, bool),
    )
    state = ProcessState(
        stock=stock,
        pose_tips=pose_tips,
        last_tip=jax.lax.stop_gradient(tip),
        recent=jnp.broadcast_to(
            tip[None, None], (cutter.flute_count, plan.substeps, 3)
        ),
        queue=jnp.zeros(QUEUE_LENGTH, jnp.int32),
        queue_travel=jnp.zeros(QUEUE_LENGTH, dtype),
        queue_count=jnp.ones((), jnp.int32),
        travel=jnp.zeros((), dtype),
        has_overflow=full,
        is_beyond=beyond,
    )
    return state, overlap[0]


def begin_period(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    tip: Float[Array, " 3"],
    predicted: Float[Array, "substep 3"],
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Engagement, Removed]:
    """Take in the pose at the start of a period, remove, and look for material.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        state: State after the period before.
        index: Index k of the period, which runs from pose k - 1 to pose k, shape ().
        tip: Tip at the start, pose k - 1 [m], shape (3,).
        predicted: Tips expected in the middle of the sub-steps [m],
            shape (substep, 3).
        adjoint: How the run is differentiated.

    Returns:
        The new state, the engagement of this period, and what was removed.
    """
    state = _remember(plan, state, index - 1, tip)
    state, removed = _remove_due(plan, cutter, state, adjoint)
    angle = _leading_angles(plan, cutter, state, predicted)
    radius = cutter.diameter / 2
    rim = jnp.stack(
        [jnp.sin(angle) * radius, jnp.cos(angle) * radius, jnp.zeros_like(angle)], -1
    )
    points = (predicted[:, None, None, None] + rim).reshape(-1, angle.shape[3], 3)
    table = adjoint.table(state.pose_tips)
    weight = occupancy(state.stock, points, plan.discs, cutter, table)
    weight = weight.reshape(*angle.shape[:3], plan.discs.count)
    thinned = state.pose_tips[_thinned_poses(plan, state)]
    return state, Engagement(angle, weight, thinned), removed


def substep_force(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    thinned: Float[Array, "circle 3"],
    angle: Float[Array, "angle kept disc"],
    weight: Float[Array, "angle kept element"],
) -> Float[Array, "angle 3"]:
    """Return the force on the tool at the angles of one sub-step.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        law: The force law.
        tip: Tip in the middle of the sub-step [m], shape (3,).
        earlier: Tips at the same sub-step of earlier periods, newest first [m],
            shape (tooth, 3).
        thinned: Older tips [m], shape (circle, 3).
        angle: Immersion angles [rad], shape (angle, kept, disc).
        weight: Occupancy at these angles, shape (angle, kept, element).

    Returns:
        Force on the tool in `work` [N], shape (angle, 3); its mean is the force of
        the sub-step.

    Differentiability: kinks where the deciding earlier circle changes and where a
    chip ends; the edge force changes smoothly there.
    """
    chip, feed = chip_thickness(plan, cutter, tip, earlier, thinned, angle)
    touch = edge_contact(chip, feed, 2 * math.pi / plan.angles)
    h = jnp.clip(chip, 0, cutter.diameter / 2)
    F_t, F_r, F_a = law.force_per_width(h, touch, jnp.zeros_like(h, dtype=jnp.int32))
    share = weight * plan.discs.height
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    along = [
        jnp.sum(share * component, axis=(1, 2))
        for component in (-F_t * cos - F_r * sin, F_t * sin - F_r * cos, F_a)
    ]
    return jnp.stack(along, axis=-1)


def chip_thickness(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    thinned: Float[Array, "circle 3"],
    angle: Float[Array, "angle kept disc"],
) -> tuple[Float[Array, "angle kept element"], Float[Array, ""]]:
    """Return the unclipped chip thickness and the feed per tooth, both [m]."""
    R = cutter.diameter / 2
    lower = plan.discs.centers(tip.dtype) - plan.discs.height / 2
    newest = earlier[0] - tip
    # The tooth just before cut every layer that this one cuts with its side.
    chip = circle_chip(R, newest, angle, 0.0)
    nothing = 2 * cutter.nominal_radius
    for old in [*earlier[1:], *thinned]:
        offset = old - tip
        share = layer_share(offset[2], lower, plan.discs.height)[None, None]
        left = circle_chip(R, offset, angle, nothing)
        chip = jnp.minimum(chip, share * left + (1 - share) * nothing)
    return chip, safe_norm(newest)


def end_period(state: ProcessState, middles: Float[Array, "substep 3"]) -> ProcessState:
    """Keep the tips in the middle of the sub-steps of the period just run."""
    recent = jnp.concatenate([middles[None], state.recent[:-1]])
    return eqx.tree_at(lambda s: s.recent, state, recent)


def flush(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    tip: Float[Array, " 3"],
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Removed]:
    """Remove all that the history still holds, the last pose included.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        state: State after the last period.
        index: Index of the last pose, shape ().
        tip: The last pose [m], shape (3,).
        adjoint: How the run is differentiated.

    Returns:
        The state with an empty history, and what was removed.
    """
    pose_tips = jax.lax.dynamic_update_slice(
        state.pose_tips, tip[None], (index, jnp.zeros_like(index))
    )
    waiting = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32) < state.queue_count
    poses = jnp.concatenate([state.queue, index[None]])
    is_due = jnp.concatenate([waiting, jnp.ones(1, bool)])

    def remove(carry, x):
        stock, has_overflow, is_beyond = carry
        pose, due = x
        tips = adjoint.removal_tips(pose_tips[pose][None])
        stock, volume, full, beyond = remove_poses(
            stock, cutter, plan.window, tips, pose[None], due[None]
        )
        return (stock, has_overflow | full, is_beyond | beyond), volume[0]

    carry = (state.stock, state.has_overflow, state.is_beyond)
    (stock, full, beyond), volumes = jax.lax.scan(remove, carry, (poses, is_due))
    state = eqx.tree_at(
        lambda s: (s.stock, s.pose_tips, s.queue_count, s.has_overflow, s.is_beyond),
        state,
        (stock, pose_tips, jnp.zeros((), jnp.int32), full, beyond),
    )
    return state, Removed(poses, volumes)


def immersion_angles(
    plan: ProcessPlan, cutter: AbstractCutter, dtype: jnp.dtype
) -> Float[Array, "substep angle kept disc"]:
    """Return the immersion angle of every tooth at every sample of a period [rad].

    Every period begins with a tooth at angle 0 at the tip; a disc higher up lags by
    2 z tan(helix) / D.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        dtype: Floating type.

    Returns:
        Angles, shape (substep, angle, tooth, disc); the axis disc has length 1 if the
        flutes are straight.
    """
    count = plan.angles // (plan.substeps * cutter.flute_count)
    pitch = 2 * math.pi / cutter.flute_count
    total = plan.substeps * count
    turn = pitch * (jnp.arange(total, dtype=dtype) + 0.5) / total
    turn = turn.reshape(plan.substeps, count, 1, 1)
    tooth = pitch * jnp.arange(cutter.flute_count, dtype=dtype)[None, None, :, None]
    if not cutter.has_helix:
        return turn + tooth
    height = plan.discs.centers(dtype)
    lag = 2 * height * jnp.tan(jnp.asarray(cutter.helix_angle, dtype)) / cutter.diameter
    return turn + tooth - lag[None, None, None]


def _leading_angles(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    predicted: Float[Array, "substep 3"],
) -> Float[Array, "substep angle kept disc"]:
    """Return the angles of the teeth that can cut: those on the leading side.

    The chip of two circles begins a little before the leading half, so a tooth just
    outside it comes first if it meets material there.
    """
    angle = immersion_angles(plan, cutter, predicted.dtype)
    kept = (cutter.flute_count + 1) // 2
    if kept == cutter.flute_count:
        return angle
    frozen = jax.lax.stop_gradient
    motion = frozen(predicted - state.recent[0])
    heading = jnp.arctan2(motion[:, 0], motion[:, 1])[:, None, None, None]
    lead = jnp.cos(frozen(angle) - heading)
    radius = cutter.nominal_radius
    x = frozen(predicted)[:, None, None, None, 0] + radius * jnp.sin(frozen(angle))
    y = frozen(predicted)[:, None, None, None, 1] + radius * jnp.cos(frozen(angle))
    tip = jnp.broadcast_to(frozen(predicted)[:, None, None, None, 2], x.shape)
    meets = (lead > -_BEFORE_LEADING) & has_material_above(state.stock, x, y, tip)
    order = jnp.argsort(jnp.where(meets, lead + 2, lead), axis=2, descending=True)
    return jnp.take_along_axis(angle, order[:, :, :kept], axis=2)


def substep_middles(plan: ProcessPlan, dtype: jnp.dtype) -> Float[Array, " substep"]:
    """Return the middle of each sub-step as a share of the tooth period."""
    return (jnp.arange(plan.substeps, dtype=dtype) + 0.5) / plan.substeps


def _remember(
    plan: ProcessPlan,
    state: ProcessState,
    pose: Int[Array, ""],
    tip: Float[Array, " 3"],
) -> ProcessState:
    """Enter a pose in the table, and in the queue if it is far enough from the last."""
    zero = jnp.zeros_like(pose)
    frozen = jax.lax.stop_gradient
    # Reading the table before it is written would make XLA copy it in every step.
    travel = state.travel + safe_norm(frozen(tip - state.last_tip))
    pose_tips = jax.lax.dynamic_update_slice(state.pose_tips, tip[None], (pose, zero))
    newest = state.queue_travel[state.queue_count - 1]
    is_far = travel - newest >= plan.lag / QUEUE_LENGTH
    at = jnp.where(is_far, state.queue_count, QUEUE_LENGTH)
    return eqx.tree_at(
        lambda s: (
            s.pose_tips,
            s.last_tip,
            s.queue,
            s.queue_travel,
            s.queue_count,
            s.travel,
        ),
        state,
        (
            pose_tips,
            frozen(tip),
            state.queue.at[at].set(pose, mode="drop"),
            state.queue_travel.at[at].set(travel, mode="drop"),
            state.queue_count + is_far.astype(jnp.int32),
            travel,
        ),
    )


def _remove_due(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    adjoint: AbstractAdjoint,
) -> tuple[ProcessState, Removed]:
    """Remove up to two poses that the tool has left behind by the lag."""
    poses = state.queue[:_REMOVALS]
    tips = state.pose_tips[poses]
    age = state.travel - state.queue_travel[:_REMOVALS]
    is_full = state.queue_count >= QUEUE_LENGTH
    is_due = (age >= plan.lag) & (
        jnp.arange(_REMOVALS, dtype=jnp.int32) < state.queue_count - 1
    )
    is_due = is_due | (is_full & (jnp.arange(_REMOVALS, dtype=jnp.int32) == 0))
    apart = jnp.max(jnp.abs(jax.lax.stop_gradient(tips[1] - tips[0])))
    is_due = is_due.at[1].set(is_due[0] & is_due[1] & (apart <= plan.window.slack))
    stock, volume, full, beyond = remove_poses(
        state.stock, cutter, plan.window, adjoint.removal_tips(tips), poses, is_due
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
            stock,
            state.queue[shift],
            state.queue_travel[shift],
            state.queue_count - count,
            state.has_overflow | full,
            state.is_beyond | beyond,
        ),
    )
    return state, Removed(poses, volume)


def _thinned_poses(plan: ProcessPlan, state: ProcessState) -> Int[Array, " circle"]:
    """Return the newest poses in the queue at given distances behind the tool."""
    slots = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32)
    age = state.travel - state.queue_travel
    picks = []
    for share in _THINNED:
        is_old = (age >= share * plan.lag) & (slots < state.queue_count)
        picks.append(jnp.max(jnp.where(is_old, slots, 0)))
    return state.queue[jnp.stack(picks)]
