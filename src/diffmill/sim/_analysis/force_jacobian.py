"""Derivatives of the force of the teeth with respect to present and earlier tips."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw
from ...process import (
    BottomEngagement,
    EdgeSamples,
    Engagement,
    ProcessPlan,
    ProcessState,
    ThroughRays,
    advance_removal,
    compute_engagement,
    end_period,
    ends_of,
    initial_state,
    middles_of,
    substep_wrench,
)
from ...workpiece import Pose, Stock, repeated
from .monodromy import Regeneration


def force_slopes(
    path: Pose,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    bottom_law: AbstractForceLaw | None,
    plan: ProcessPlan,
    rows: Int[np.ndarray, " row"],
) -> list[Regeneration]:
    """Return the slopes of the force in some periods, by replaying the removal.

    Where there is material is held: a vibration changes the chip, not the arc of the
    cut nor its depth.

    Args:
        path: Poses at the tooth instants, shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        law: The force law.
        bottom_law: The law of the bottom edge; derived from `law` if None.
        plan: Sizes of the process, with the chip model "near_far"; a sub-step is the
            piece of a period over which slopes are means.
        rows: The periods before these rows are asked for, from 1, ascending.

    Returns:
        The slopes, for each row.

    Differentiability: none, a host function.
    """
    tool = _Tool(cutter, (law, bottom_law), plan)
    # The path between two instants follows from their neighbours, too.
    padded = jax.tree.map(
        lambda x: jnp.concatenate([2 * x[:1] - x[1:2], x, 2 * x[-1:] - x[-2:-1]]), path
    )
    carry = _begin(tool, stock, path)
    first, found = jnp.ones((), jnp.int32), []
    for row in rows:
        last = jnp.asarray(row, jnp.int32)
        carry, slopes = _replay(tool, carry, padded, first, last)
        found.append(Regeneration(*(np.asarray(x, np.float64) for x in slopes)))
        first = last + 1
    return found


class _Tool(eqx.Module):
    """Process with its discretisation."""

    cutter: AbstractCutter
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None]
    plan: ProcessPlan


@eqx.filter_jit
def _begin(tool: _Tool, stock: Stock, path: Pose) -> tuple[ProcessState, Pose, Pose]:
    """Return the state before the first period, as if the tool had stood still."""
    plan, count = tool.plan, path.tip.shape[0]
    state, _ = initial_state(plan, stock, tool.cutter, path[0], count, ThroughRays())
    still = repeated(path[0], (plan.substeps,))
    return state, still, still


@eqx.filter_jit
def _replay(
    tool: _Tool,
    carry: tuple[ProcessState, Pose, Pose],
    padded: Pose,
    first: Int[Array, ""],
    last: Int[Array, ""],
) -> tuple[tuple[ProcessState, Pose, Pose], tuple[Array, Array]]:
    """Return the state in the last period, its poses, and the slopes there.

    The state to begin with is that of the period before the first, with its poses.
    """
    plan, cutter = tool.plan, tool.cutter

    def period(index: Array, carry: tuple[ProcessState, Pose, Pose]) -> Any:
        state = end_period(*carry)
        near = jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, index - 1, 4), padded
        )
        state, _ = advance_removal(
            plan, cutter, state, index - 1, near[1], ThroughRays()
        )
        return state, middles_of(plan, near)[1], ends_of(plan, near)[1]

    state, poses, ends = jax.lax.fori_loop(first, last + 1, period, carry)
    cut = compute_engagement(plan, cutter, state, last, poses, ThroughRays())
    slopes = _slopes(plan, cutter, tool.laws, poses, state.recent, cut)
    return (state, poses, ends), slopes


def _slopes(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None],
    poses: Pose,
    recent: Pose,
    cut: Engagement,
) -> tuple[Float[Array, "substep 3 3"], Float[Array, "substep tooth 3 3"]]:
    """Return the slopes of all sub-steps of one period."""

    def force(
        tip: Float[Array, " 3"],
        earlier: Float[Array, "tooth 3"],
        axes: tuple[Array | None, Array | None],
        edges: tuple[EdgeSamples, BottomEngagement | None],
    ) -> Float[Array, " 3"]:
        now, before = Pose(tip, axes[0]), Pose(earlier, axes[1])
        found = substep_wrench(plan, cutter, *laws, now, before, cut.thinned, *edges)
        return jnp.mean(found[:, :3], axis=0)

    earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), recent)
    now, before = jax.vmap(jax.jacfwd(force, argnums=(0, 1)))(
        poses.tip,
        earlier.tip,
        (poses.axis, earlier.axis),
        (cut.samples, cut.bottom),
    )
    return now, jnp.swapaxes(before, 1, 2)
