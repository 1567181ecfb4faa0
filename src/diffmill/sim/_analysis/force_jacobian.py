"""Derivatives of the force of the teeth with respect to present and earlier tips."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import on_device
from ...numerics import CachedJit
from ...process import (
    EdgeSamples,
    Engagement,
    Process,
    ProcessState,
)
from ...workpiece import Pose
from .monodromy import Regeneration


def force_slopes(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"]
) -> list[list[Regeneration]]:
    """Return the slopes of the force in some periods, by replaying the removal.

    Where the teeth differ they are those of the turn that ends with each period.

    Where there is material is held: a vibration changes the chip, not the arc of the
    cut nor its depth.

    Args:
        process: The process; a sub-step is the piece of a period over which slopes are
            means.
        path: Poses at the tooth instants, shape (step, 3).
        rows: The periods before these rows are asked for, from 1, ascending.

    Returns:
        The slopes of the periods that repeat themselves, for each row.

    Differentiability: none, a host function.
    """
    # The path between two instants follows from their neighbours, too.
    longer = lambda x: np.concatenate([2 * x[:1] - x[1:2], x, 2 * x[-1:] - x[-2:-1]])
    padded = jax.tree.map(lambda x: on_device(longer(np.asarray(x))), path)
    carry, first, slopes = _begin(process, path), on_device(np.ones((), np.int32)), {}
    cutter, count = process.cutter, process.repeats_after
    # A path shorter than a turn stands for the rest by its first period.
    turns = np.maximum(rows[:, None] + np.arange(1 - count, 1), 1)
    delays = np.arange(1.0, cutter.flute_count + 1)
    if not cutter.has_even_pitch:
        delays = np.asarray(cutter.delays(np.float64)).reshape(-1)
    for row in np.unique(turns):
        last = on_device(np.asarray(row, np.int32))
        carry, found = _replay(process, carry, padded, first, last)
        now, before = (np.asarray(x, np.float64) for x in found)
        before = before.reshape(len(now), -1, 3, 3)
        slopes[row] = Regeneration(now, before, delays)
        first = on_device(np.asarray(row + 1, np.int32))
    return [[slopes[row] for row in turn] for turn in turns]


class _Replayed(eqx.Module):
    """The process at a period, with the poses within it."""

    state: ProcessState
    middles: Pose
    ends: Pose


@CachedJit
def _begin(process: Process, path: Pose) -> _Replayed:
    """Return the state before the first period, as if the tool had stood still."""
    state = process.begin(path[0], path.tip.shape[0])
    still = path[0].repeated(process.engagement.substeps)
    return _Replayed(state, still, still)


@CachedJit
def _replay(
    process: Process,
    before: _Replayed,
    padded: Pose,
    first: Int[Array, ""],
    last: Int[Array, ""],
) -> tuple[_Replayed, tuple[Array, Array]]:
    """Process in the last period, and the slopes there, of `_slopes`.

    It begins with the period before the first.
    """
    engagement = process.engagement

    def period(index: Array, at: _Replayed) -> _Replayed:
        state = at.state.ended(at.middles, at.ends)
        near = jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, index - 1, 4), padded
        )
        state, _ = process.remove(state, index - 1, near[1])
        middles, ends = process.poses_within(near)
        return _Replayed(state, middles[1], ends[1])

    at = jax.lax.fori_loop(first, last + 1, period, before)
    cut = engagement.engage(process, at.state, last, at.middles)
    return at, _slopes(process, cut, at.middles, at.state.recent)


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
