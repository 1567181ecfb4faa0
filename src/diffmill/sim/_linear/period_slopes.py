"""Slopes of one tooth period: of its forces in the poses, and of the arm in its loads.

Forces follow from poses: of the sub-step itself, of the periods before, of the thinned
older circles, and of the pose at which the stock was looked up. A sample of an edge
depends on the pose of its own sub-step alone, so few derivatives of the look-up do for
all samples at once, and the force takes them by its slope in every sample. The stock is
held: how a surface moves with the poses that cut it is left out.

A pose is a row of 3 numbers, the tip, or of 6 where the tool tilts: tip and axis.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from ...process import (
    EdgeSamples,
    Process,
    ProcessState,
)
from ...workpiece import Pose
from .._machine.substeps import AbstractSwinging, CommandRow


class ForceSlopes(eqx.Module):
    """Slopes of the loads on the tool in the sub-steps of one period.

    Attributes:
        now: In the pose of the sub-step, shape (substep, load, pose).
        before: In those of the periods before, newest first, shape (substep, load,
            tooth, pose).
        thinned: In the thinned older poses, shape (substep, load, circle, pose).
        predicted: In the pose at which the stock was looked up, shape (substep, load,
            pose).
        circles: Rows of the thinned poses, shape (circle,).
    """

    now: Float[Array, "substep load pose"]
    before: Float[Array, "substep load tooth pose"]
    thinned: Float[Array, "substep load circle pose"]
    predicted: Float[Array, "substep load pose"]
    circles: Int[Array, " circle"]


class ArmSlopes(eqx.Module):
    """Slopes of the arm over one period, in its inputs one after the other.

    The inputs are the state at the start, the motors at the start and at the end, and
    the loads of the sub-steps.

    Attributes:
        end: Of the state at the end, shape (state, input).
        pose: Of the pose at the start, shape (pose, input).
        middles: Of the tips in the middle of the sub-steps, shape (substep, 3, input).
        ends: Of those at their ends, shape (substep, 3, input).
    """

    end: Float[Array, "state input"]
    pose: Float[Array, "pose input"]
    middles: Float[Array, "substep 3 input"]
    ends: Float[Array, "substep 3 input"]


def as_rows(pose: Pose) -> Float[Array, "*pose component"]:
    """Return poses as rows of numbers."""
    if pose.axis is None:
        return pose.tip
    return jnp.concatenate([pose.tip, pose.axis], axis=-1)


def as_poses(rows: Float[Array, "*pose component"]) -> Pose:
    """Return rows of numbers as poses."""
    if rows.shape[-1] == 3:
        return Pose(rows)
    return Pose(rows[..., :3], rows[..., 3:])


def force_slopes(
    process: Process,
    state: ProcessState,
    index: Int[Array, ""],
    predicted: Pose,
    middles: Pose,
    load_count: int,
) -> ForceSlopes:
    """Return the slopes of a period's loads.

    Args:
        process: The process; its derivative holds the stock.
        state: State after the removal of this period.
        index: Index of the period, from 1, shape ().
        predicted: Poses at which the stock is looked up, shape (substep, 3).
        middles: Poses in the middle of the sub-steps, shape (substep, 3).
        load_count: 3 for forces, 6 with moments about the tip.
    """
    engagement = process.engagement

    def engage(ahead: Array, newest: Array) -> tuple[EdgeSamples, EdgeSamples]:
        recent = jax.tree.map(
            lambda rows, first: rows.at[0].set(first), state.recent, as_poses(newest)
        )
        near = eqx.tree_at(lambda s: s.recent, state, recent)
        cut = engagement.engage(process, near, index, as_poses(ahead))
        return eqx.partition(cut.samples, eqx.is_inexact_array)

    ahead, newest = as_rows(predicted), as_rows(state.recent[0])
    samples, push, fixed = jax.linearize(engage, ahead, newest, has_aux=True)
    # A sample of an edge follows the pose of its own sub-step: one motion of all.
    unit = jnp.eye(ahead.shape[-1], dtype=ahead.dtype)
    moves = jnp.broadcast_to(unit[:, None], (unit.shape[0], *ahead.shape))
    still = jnp.zeros_like(moves)
    # Both together, so that they are compiled once.
    by_either = jax.vmap(push)(
        jnp.concatenate([moves, still]), jnp.concatenate([still, moves])
    )

    def load(
        middle: Array,
        earlier: Array,
        old: Array,
        edges: EdgeSamples,
        known: EdgeSamples,
    ) -> Array:
        poses = as_poses(middle), as_poses(earlier), as_poses(old)
        found = engagement.wrench(process, eqx.combine(edges, known), *poses)
        return jnp.mean(found, axis=0)[:load_count]

    circles = process.removal.thinned_rows(state)
    old = as_rows(state.track.poses[circles * engagement.substeps])
    earlier = jnp.moveaxis(as_rows(state.recent), 0, 1)
    slopes = jax.vmap(jax.jacrev(load, argnums=(0, 1, 2, 3)), (0, 0, None, 0, 0))
    found = slopes(as_rows(middles), earlier, old, samples, fixed)
    now, before, thinned, by_edges = found

    both = zip(jax.tree.leaves(by_edges), jax.tree.leaves(by_either), strict=True)
    products = [jnp.einsum("sl...,ps...->slp", a, b) for a, b in both]
    slopes = sum(products[1:], products[0])
    by_predicted, by_newest = jnp.split(slopes, 2, axis=-1)
    return ForceSlopes(
        now=now,
        before=before.at[:, :, 0].add(by_newest),
        thinned=thinned,
        predicted=by_predicted,
        circles=circles,
    )


def arm_slopes(
    machine: AbstractSwinging,
    process: Process,
    state: Any,
    row: CommandRow,
    loads: Float[Array, "substep load"],
) -> ArmSlopes:
    """Return the slopes of the arm over one period.

    Args:
        machine: The machine.
        process: The process, of which the tooth period and the sub-steps count.
        state: The arm at the start.
        row: Motors at both ends, shape (joint,).
        loads: Loads of the sub-steps in `work` [N], [N m], shape (substep, load).
    """
    flat, unravel = ravel_pytree(state)
    times = process.tooth_period * process.substep_middles(flat.dtype)

    def move(x: Array, start: Array, stop: Array, loads: Array) -> tuple[Array, ...]:
        first = unravel(x)
        span = machine.span(process, first, CommandRow(start, stop))

        def substep(
            state: Any, row: tuple[Array, Array]
        ) -> tuple[Any, tuple[Array, Array]]:
            time, load = row
            middle = span.middle(state, time)
            end = span.step(state, time, load)
            return end, (middle, span.tip(end))

        end, (tips, ends) = jax.lax.scan(substep, first, (times, loads))
        return ravel_pytree(end)[0], as_rows(span.pose), tips, ends

    inputs = flat, row.start, row.stop, loads
    by_start = jax.jacfwd(move, argnums=(0, 1, 2))(*inputs)
    by_loads = jax.jacfwd(move, argnums=3)(*inputs)
    joined = [
        jnp.concatenate([*slopes, by_load.reshape(*by_load.shape[:-2], -1)], axis=-1)
        for slopes, by_load in zip(by_start, by_loads, strict=True)
    ]
    return ArmSlopes(*joined)
