"""Nearest interval of a ray to a point, by place in memory."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...numerics import materialise
from .._pose import gathered_rows


def gather(table: Array, at: Int[Array, "*end"]) -> Array:
    """Entries of a table at some indices in memory, shape (...).

    **Differentiability**: linear in the table.
    """
    return gathered_rows(table.reshape(-1), at)


def nearest_interval(
    ends: Float[Array, "u v 2 slot"],
    ray: Int[Array, "*ray"],
    x: Float[Array, "*#ray"],
    slots: Int[Array, ""],
) -> tuple[Float[Array, "*ray"], Float[Array, "*ray"], Int[Array, "*ray"]]:
    """Interval of each ray that a coordinate lies in, or is nearest to.

    Args:
        ends: Lower and upper ends [m].
        ray: Index in memory at which the ends of a ray begin, shape (...).
        x: Coordinate along the ray [m], broadcast.
        slots: Number of slots in use: those behind hold nothing, shape ().

    Returns:
        Lower end [m], upper end [m], below the lower one where the ray is empty, and
        slot; all of shape (...).

    **Differentiability**: none; all are constants.
    """
    ends, x = jax.lax.stop_gradient((ends, x))
    count = ends.shape[-1]
    ray = materialise(ray)

    def nearer(m: Int[Array, ""], nearest: tuple[Array, ...]) -> tuple[Array, ...]:
        best, low, high, slot = nearest
        start, stop = gather(ends, ray + m), gather(ends, ray + (m + count))
        inside = jnp.minimum(x - start, stop - x)
        is_nearer = inside > best
        return (
            jnp.maximum(best, inside),
            jnp.where(is_nearer, start, low),
            jnp.where(is_nearer, stop, high),
            jnp.where(is_nearer, m, slot),
        )

    low, high = gather(ends, ray), gather(ends, ray + count)
    first = (jnp.minimum(x - low, high - x), low, high, jnp.zeros(ray.shape, jnp.int32))
    if count > 1:
        # Few of the slots hold anything, and each costs a gather.
        first = jax.lax.fori_loop(jnp.ones((), jnp.int32), slots, nearer, first)
    _, low, high, slot = first
    return low, high, slot
