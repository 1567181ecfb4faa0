"""Depth of a tool and its holder in the material of rays along z."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...cutter import AbstractCutter, ToolHolder
from ...workpiece import Pose

# A piece shorter than this is rounding [m].
_SHORTEST = 1e-8


class ContactTest(eqx.Module):
    """A solid to look for in the stock.

    Attributes:
        cutter: The cutter that removes.
        inner: A smaller one inside it, that is looked for.
        lift: How far its tip stands above that of the cutter [m].
        holder: The holder, or None.
        touch: Depth below which a contact is none [m].
    """

    cutter: AbstractCutter
    inner: AbstractCutter
    lift: float = eqx.field(static=True)
    holder: ToolHolder | None
    touch: float = eqx.field(static=True)


def tool_depth(
    ends: Float[Array, "x y 2 slot"],
    x: Float[Array, "x y"],
    y: Float[Array, "x y"],
    pose: Pose,
    test: ContactTest,
) -> Float[Array, ""]:
    """Depth of the cutter in material where its inner one meets it."""
    axis = pose.direction()
    interval = test.inner.intersect_pose(2, x, y, pose.tip + test.lift * axis, axis)
    start, stop, is_hit = (v[..., None] for v in interval)
    low = jnp.maximum(ends[:, :, 0], start)
    high = jnp.minimum(ends[:, :, 1], stop)
    is_in = is_hit & (high > low + _SHORTEST)
    # The solid is convex: its distance grows from its ends to somewhere near there.
    z = jnp.where(is_in, jnp.clip((start + stop) / 2, low, high), 0)
    x, y = (jnp.broadcast_to(v[..., None], z.shape) for v in (x, y))
    points = jnp.stack([x, y, z], axis=-1)
    tip, axis = (v[None, None, None] for v in (pose.tip, axis))
    depth = jnp.where(is_in, -test.cutter.level(points, tip, axis), 0)
    return jnp.max(depth)


def holder_depth(
    ends: Float[Array, "x y 2 slot"],
    x: Float[Array, "x y"],
    y: Float[Array, "x y"],
    pose: Pose,
    test: ContactTest,
) -> Float[Array, ""]:
    """Depth of the holder in material."""
    assert test.holder is not None
    pieces = jnp.moveaxis(ends, 2, 0)
    depth = test.holder.depth_in_pieces(
        2, x[..., None], y[..., None], pieces, pose.tip, pose.direction()
    )
    deepest = jnp.max(depth)
    return jnp.where(deepest > test.touch, deepest, 0)
