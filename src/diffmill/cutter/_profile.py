"""The signed distance of a rotating end mill, and its gradient.

The solid of radius R and corner radius r_c holds the points within r_c of the cylinder
of radius R - r_c that begins at the height r_c on the tool axis and has no upper end:
r_c = 0 leaves the cylinder, r_c = R is a ball end.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# Distance from the axis, or from the edge of the inner cylinder, below which a point
# counts as on it [m]; its square is still a normal number in single precision.
_LEAST_DISTANCE = 1e-15


class Sizes(NamedTuple):
    """Sizes of an end mill.

    Attributes:
        radius: Radius R [m], shape () or that of the places.
        corner_radius: Corner radius r_c [m].
    """

    radius: Float[Array, "..."]
    corner_radius: Float[Array, ""]


class Level(NamedTuple):
    """Signed distance in the half plane of the profile, and its gradient.

    Attributes:
        value: The distance [m].
        by_along: Its derivative by the height.
        by_across: Its derivative by the distance from the axis.
    """

    value: Float[Array, "..."]
    by_along: Float[Array, "..."]
    by_across: Float[Array, "..."]


class AxisPlace(NamedTuple):
    """Cylindrical coordinates of points about the tool axis.

    Attributes:
        along: Height above the tip [m].
        offset: From the axis [m], shape (..., 3).
        rho: Length of the offset [m]; 1 m on the axis, to divide by.
        is_off: True if the point is off the axis.
    """

    along: Float[Array, "..."]
    offset: Float[Array, "... 3"]
    rho: Float[Array, "..."]
    is_off: Bool[Array, "..."]

    @classmethod
    def of(
        cls,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
    ) -> "AxisPlace":
        """Places of points [m]; tip [m] and unit axis are broadcast."""
        points, tip, axis = jnp.broadcast_arrays(points, tip, axis)
        away = points - tip
        along = jnp.sum(away * axis, axis=-1)
        offset = away - along[..., None] * axis
        square = jnp.sum(offset**2, axis=-1)
        is_off = square > _LEAST_DISTANCE**2
        return cls(along, offset, jnp.sqrt(jnp.where(is_off, square, 1)), is_off)

    def level(self, sizes: Sizes) -> Level:
        """Signed distance of the points, and its gradient."""
        return profile_level(self.along, jnp.where(self.is_off, self.rho, 0), sizes)


def profile_level(
    along: Float[Array, "..."], across: Float[Array, "..."], sizes: Sizes
) -> Level:
    """Signed distance in the half plane of the profile, and its gradient.

    Args:
        along: Height above the tip along the axis [m].
        across: Distance from the axis [m].
        sizes: Sizes of the mill.

    Differentiability: kinks inside the solid, where the nearest point changes from
    the side to the bottom, and on the rim of a flat end.
    """
    R, rc = sizes
    side = across - (R - rc)
    below = rc - along
    # Maxima and minima by `where`: at a tie they would share the derivative.
    is_corner = (side > _LEAST_DISTANCE) & (below > _LEAST_DISTANCE)
    is_side = side > below
    x = jnp.where(is_corner, side, 1)
    y = jnp.where(is_corner, below, 1)
    corner = jnp.sqrt(x**2 + y**2)
    level = jnp.where(is_corner, corner, jnp.where(is_side, side, below)) - rc
    by_along = jnp.where(is_corner, -y / corner, jnp.where(is_side, 0, -1))
    by_across = jnp.where(is_corner, x / corner, jnp.where(is_side, 1, 0))
    dtype = level.dtype
    return Level(level, by_along.astype(dtype), by_across.astype(dtype))


def normal(
    points: Float[Array, "*#place 3"],
    tip: Float[Array, "*#place 3"],
    axis: Float[Array, "*#place 3"],
    sizes: Sizes,
) -> Float[Array, "... 3"]:
    """Unit gradient of the signed distance; see `EndMill.normal`."""
    place = AxisPlace.of(points, tip, axis)
    axis = jnp.broadcast_to(axis, place.offset.shape)
    _, by_along, by_across = place.level(sizes)
    # On the axis every direction across it is as good: one that is never parallel.
    is_steep = jnp.abs(axis[..., 2:]) > 0.7
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    nil = jnp.zeros_like(x)
    any_across = jnp.where(
        is_steep, jnp.stack([z, nil, -x], -1), jnp.stack([-y, x, nil], -1)
    )
    size = jnp.sqrt(jnp.sum(any_across**2, axis=-1, keepdims=True))
    own = place.offset / place.rho[..., None]
    outward = jnp.where(place.is_off[..., None], own, any_across / size)
    return by_across[..., None] * outward + by_along[..., None] * axis
