"""Wall instants: when a tooth makes the wall in its period, and the tool's tip then.

Rows are the tooth instants, at which a tooth looks along tool +y: a phase of the turn
that has nothing to do with the cut. The wall beside the tool is made by the tooth that
looks at a right angle to the feed. Where the number of teeth is even, and so is their
pitch, teeth look to both sides at once; else the side counts on which the tool leaves
material, the left one if that is both or none. Walls are taken at the tip: on a helix
those higher up are made later.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._types import FloatRows3, IntScalar
from ..cutter import AbstractCutter
from ..workpiece import Pose, Stock
from ._engagement.leading_half import STILL
from ._removal_history import early_teeth

# Shares this near to a tooth instant are the instant.
_ROUNDING = 1e-6
# How far beside the tool, in spacings, a wall must have material.
_BESIDE = 1.5


def wall_shares(
    desired: Float[Array, "step 3"],
    axes: FloatRows3 | None,
    cutter: AbstractCutter,
    finished: Stock | None = None,
    *,
    first_row: IntScalar | int = 0,
    feed_before: Float[Array, ""] | None = None,
) -> Float[Array, " step"]:
    """Return when in the tooth period before each row its wall is made.

    Args:
        desired: The path of the tip [m], shape (step, 3).
        axes: Tool axes, shape (step, 3); None if upright.
        cutter: The cutter.
        finished: The stock after the path, which tells the side of the wall where teeth
            do not look to both at once; the left side if not given.
        first_row: Row of a longer path that is the first of these, shape ().
        feed_before: Angle of the feed before that, as of `feed_angles`.

    Returns:
        Shares of the period, shape (step,), from above 0 to 1; with uneven pitch teeth
        may be early or late by a part of a period.

    **Differentiability**: none, constants.
    """
    path, frames = jax.lax.stop_gradient(desired), _frames(desired, axes)
    feed = feed_angles(path, axes, feed_before)
    rows = first_row + jnp.arange(path.shape[0], dtype=jnp.int32)
    is_right = _is_right(path, frames, feed, cutter, finished)
    wall = feed + jnp.where(is_right, 0.5, -0.5) * math.pi
    turn = wall * (cutter.flute_count / (2 * math.pi))
    share = turn - jnp.ceil(turn - _ROUNDING) + 1
    tooth = turn - share - (rows - 1).astype(path.dtype)
    late = -early_teeth(cutter, path.dtype)[
        jnp.mod(jnp.round(tooth).astype(jnp.int32), cutter.flute_count)
    ]
    share = jnp.clip(share, 0, 1) + late * (cutter.flute_count / (2 * math.pi))
    return jnp.where(rows == 0, 1, share)


def feed_angles(
    desired: Float[Array, "step 3"],
    axes: FloatRows3 | None,
    before: Float[Array, ""] | None = None,
) -> Float[Array, " step"]:
    """Angle of the feed from tool +y towards tool +x in the period before each row.

    Args:
        desired: The path of the tip [m], shape (step, 3).
        axes: Tool axes, shape (step, 3); None if upright.
        before: The angle before the first row [rad], shape (); 0 if not given.

    Returns:
        Angles [rad], shape (step,); where the tool stands, that of its last motion.

    **Differentiability**: none, constants.
    """
    path, frames = jax.lax.stop_gradient(desired), _frames(desired, axes)
    motion = jnp.diff(path, axis=0, prepend=path[:1])
    x, y = (jnp.sum(motion * frames[..., i], axis=-1) for i in (0, 1))
    rows = jnp.arange(path.shape[0], dtype=jnp.int32)
    is_moving = jnp.hypot(x, y) > STILL
    last = jax.lax.cummax(jnp.where(is_moving, rows, -1))
    start = jnp.zeros((), path.dtype) if before is None else before
    return jnp.where(last < 0, start, jnp.arctan2(x, y)[last])


def _frames(
    path: Float[Array, "step 3"], axes: FloatRows3 | None
) -> Float[Array, "step 3 3"]:
    """Frames of a tool, by its axes, shape (step, 3, 3)."""
    up = jnp.zeros(3, path.dtype).at[2].set(1)
    axis = up[None] if axes is None else jnp.asarray(axes)
    return Pose.frame(jnp.broadcast_to(axis, path.shape))


def _is_right(
    path: Float[Array, "step 3"],
    frames: Float[Array, "step 3 3"],
    feed: Float[Array, " step"],
    cutter: AbstractCutter,
    finished: Stock | None,
) -> Bool[Array, " step"]:
    """True where the wall is to the right of the feed."""
    looks_to_both = cutter.flute_count % 2 == 0 and cutter.has_even_pitch
    if finished is None or looks_to_both:
        return jnp.zeros(path.shape[0], bool)

    def has_material(turn: float) -> Bool[Array, " step"]:
        sin, cos = (f(feed + turn)[:, None] for f in (jnp.sin, jnp.cos))
        reach = cutter.nominal_radius + _BESIDE * finished.spacing
        place = path + reach * (sin * frames[..., 0] + cos * frames[..., 1])
        rays, origin = finished.families[2].ends, finished.origin
        at = jnp.round((place[:, :2] - origin[None, :2]) / finished.spacing).astype(
            jnp.int32
        )
        i, j = (jnp.clip(at[:, a], 0, rays.shape[a] - 1) for a in (0, 1))
        height = (place[:, 2] + finished.spacing)[:, None]
        return jnp.any((rays[i, j, 1] > height) & (rays[i, j, 0] < height), axis=-1)

    return has_material(math.pi / 2) & ~has_material(-math.pi / 2)


def wall_deviation(
    ends: Float[Array, "step substep 3"],
    desired: Float[Array, "step 3"],
    shares: Float[Array, " step"],
) -> Float[Array, "step 3"]:
    """Deviation of the tool from its path when it makes the walls.

    Args:
        ends: Tips at the ends of the sub-steps of the period before each row [m], shape
            (step, substep, 3).
        desired: Where they should be at the rows [m], shape (step, 3).
        shares: See `wall_shares`, shape (step,).

    Returns:
        Actual - desired, both at the instants at which the walls are made [m], shape
        (step, 3).

    **Differentiability**: linear in tips and path.
    """
    count, substeps = ends.shape[:2]
    nodes = jnp.concatenate([ends[0, -1:], ends[1:].reshape(-1, 3)])
    time = jnp.arange(-1, count - 1, dtype=shares.dtype) + shares
    return _at(nodes, time * substeps) - _at(desired, time)


def _at(rows: Float[Array, "row 3"], place: Float[Array, " step"]) -> Array:
    """Return rows at whole and broken places, linear between them."""
    place = jnp.clip(place, 0, rows.shape[0] - 1)
    low = jnp.clip(place.astype(jnp.int32), 0, rows.shape[0] - 2)
    share = (place - low.astype(place.dtype))[:, None]
    return (1 - share) * rows[low] + share * rows[low + 1]
