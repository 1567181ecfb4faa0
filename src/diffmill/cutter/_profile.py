"""The signed distance of a rotating end mill, and its gradient.

The solid of radius R and corner radius r_c is what lies within r_c of the cylinder of
radius R - r_c that begins at the height r_c on the tool axis and has no upper end:
r_c = 0 leaves the cylinder, r_c = R is a ball end.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# Closer than this to the axis or the edge of the inner cylinder [m] counts as on it;
# its square is still a normal number in single precision.
_ON = 1e-15


def distance(
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    sizes: tuple[Float[Array, ""], Float[Array, ""]],
) -> tuple[Float[Array, "..."], tuple[Float[Array, "..."], Float[Array, "..."]]]:
    """Return the signed distance in the half plane of the profile, and its gradient.

    Args:
        along: Height above the tip along the axis [m].
        across: Distance from the axis [m].
        sizes: Radius R and corner radius r_c [m].

    Returns:
        The distance [m], and its derivatives by height and by distance from the axis.

    Differentiability: kinks inside the solid, where the nearest point changes from
    the side to the bottom, and on the rim of a flat end.
    """
    R, rc = sizes
    side = across - (R - rc)
    below = rc - along
    # Maxima and minima by `where`: at a tie they would share the derivative.
    is_corner = (side > _ON) & (below > _ON)
    is_side = side > below
    x = jnp.where(is_corner, side, 1)
    y = jnp.where(is_corner, below, 1)
    corner = jnp.sqrt(x**2 + y**2)
    level = jnp.where(is_corner, corner, jnp.where(is_side, side, below)) - rc
    by_along = jnp.where(is_corner, -y / corner, jnp.where(is_side, 0, -1))
    by_across = jnp.where(is_corner, x / corner, jnp.where(is_side, 1, 0))
    return level, (by_along.astype(level.dtype), by_across.astype(level.dtype))


def from_axis(
    points: Float[Array, "*#place 3"],
    tip: Float[Array, "*#place 3"],
    axis: Float[Array, "*#place 3"],
) -> tuple[
    Float[Array, "..."], Float[Array, "... 3"], Float[Array, "..."], Bool[Array, "..."]
]:
    """Return height above the tip, offset from the axis, its length, and if it has one.

    On the axis the length is given as 1 m, to divide by.
    """
    points, tip, axis = jnp.broadcast_arrays(points, tip, axis)
    away = points - tip
    along = jnp.sum(away * axis, axis=-1)
    offset = away - along[..., None] * axis
    square = jnp.sum(offset**2, axis=-1)
    is_off = square > _ON**2
    return along, offset, jnp.sqrt(jnp.where(is_off, square, 1)), is_off


def level(
    points: Float[Array, "*#place 3"],
    tip: Float[Array, "*#place 3"],
    axis: Float[Array, "*#place 3"],
    sizes: tuple[Float[Array, ""], Float[Array, ""]],
) -> Float[Array, "..."]:
    """Return the signed distance of points; see `EndMill.level`."""
    along, _, rho, is_off = from_axis(points, tip, axis)
    return distance(along, jnp.where(is_off, rho, 0), sizes)[0]


def normal(
    points: Float[Array, "*#place 3"],
    tip: Float[Array, "*#place 3"],
    axis: Float[Array, "*#place 3"],
    sizes: tuple[Float[Array, ""], Float[Array, ""]],
) -> Float[Array, "... 3"]:
    """Return the unit gradient of the signed distance; see `EndMill.normal`."""
    along, offset, rho, is_off = from_axis(points, tip, axis)
    axis = jnp.broadcast_to(axis, offset.shape)
    _, (by_along, by_across) = distance(along, jnp.where(is_off, rho, 0), sizes)
    # On the axis every direction across it is as good: one that is never parallel.
    is_steep = jnp.abs(axis[..., 2:]) > 0.7
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    nil = jnp.zeros_like(x)
    any_across = jnp.where(
        is_steep, jnp.stack([z, nil, -x], -1), jnp.stack([-y, x, nil], -1)
    )
    size = jnp.sqrt(jnp.sum(any_across**2, axis=-1, keepdims=True))
    outward = jnp.where(is_off[..., None], offset / rho[..., None], any_across / size)
    return by_across[..., None] * outward + by_along[..., None] * axis
