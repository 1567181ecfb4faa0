"""How the force of the teeth changes with where the tip is and where it was."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..workpiece import Pose, Stock
from ._adjoint import Plain
from ._bottom import BottomEngagement
from ._history import ProcessState, end_period, initial_state, remember, remove_due
from ._period import Engagement, look, substep_force
from ._plan import ProcessPlan
from ._process_alone import middles_of


class ForceSlopes(eqx.Module):
    """Derivatives of the mean force of a sub-step, in `work`.

    Attributes:
        now: In the tip in its middle [N/m], shape (step, substep, 3, 3).
        before: In the tips at the same sub-step of earlier periods, newest first
            [N/m], shape (step, substep, tooth, 3, 3).
    """

    now: Float[Array, "step substep 3 3"]
    before: Float[Array, "step substep tooth 3 3"]


@eqx.filter_jit
def force_slopes(
    path: Pose,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    bottom_law: AbstractForceLaw | None,
    plan: ProcessPlan,
    is_wanted: Bool[Array, " step"],
) -> ForceSlopes:
    """Return the slopes along a path, by replaying its removal.

    Where there is material is held: a vibration changes the chip, not the arc of the
    cut nor its depth.

    Args:
        path: Poses at the tooth instants, shape (step, 3).
        stock: The raw workpiece.
        cutter: The cutter.
        law: The force law.
        bottom_law: The law of the bottom edge; derived from `law` if None.
        plan: Sizes of the process, with the chip model "near_far".
        is_wanted: For which rows, the periods before their instants, shape (step,).

    Returns:
        The slopes; 0 in rows that are not wanted.

    Differentiability: not meant for it.
    """
    adjoint, dtype = Plain(), path.tip.dtype
    step_count = path.tip.shape[0]
    state, _ = initial_state(plan, stock, cutter, path[0], step_count, adjoint)
    shapes = (plan.substeps, cutter.flute_count)
    none = (
        jnp.zeros((shapes[0], 3, 3), dtype),
        jnp.zeros((*shapes, 3, 3), dtype),
    )

    def step(
        state: ProcessState, x: tuple[Array, Pose, Pose, Array]
    ) -> tuple[ProcessState, tuple[Array, Array]]:
        index, start, poses, wanted = x
        state = remember(plan, state, index - 1, start)
        state, _ = remove_due(plan, cutter, state, adjoint)

        def slopes(state: ProcessState) -> tuple[Array, Array]:
            cut = look(plan, cutter, state, index, poses, adjoint)
            return _slopes(plan, cutter, (law, bottom_law), poses, state.recent, cut)

        found = jax.lax.cond(wanted, slopes, lambda _: none, state)
        return end_period(state, poses), found

    index = jnp.arange(1, step_count, dtype=jnp.int32)
    xs = (index, path[:-1], middles_of(plan, path), is_wanted[1:])
    _, (now, before) = jax.lax.scan(step, state, xs)
    first = lambda rows: jnp.concatenate([jnp.zeros_like(rows[:1]), rows])
    return ForceSlopes(first(now), first(before))


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
        samples: tuple[Array, Array, Array, BottomEngagement | None],
    ) -> Float[Array, " 3"]:
        now, before = Pose(tip, axes[0]), Pose(earlier, axes[1])
        found = substep_force(plan, cutter, *laws, now, before, cut.thinned, *samples)
        return jnp.mean(found, axis=0)

    earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), recent)
    now, before = jax.vmap(jax.jacfwd(force, argnums=(0, 1)))(
        poses.tip,
        earlier.tip,
        (poses.axis, earlier.axis),
        (cut.angle, cut.tooth, cut.occupancy, cut.bottom),
    )
    return now, jnp.swapaxes(before, 1, 2)
