"""The cutting edge as short elements along the profile of an end mill."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .._types import RealScalarLike


class EdgeElements(eqx.Module):
    """Edge elements from the center of the end to the shank, by their middles.

    The outward normal of an element is sin kappa e - cos kappa a, e the radial
    direction at its immersion angle and a the axis.

    Attributes:
        height: Above the tip [m], shape (element,).
        radius: From the axis [m], shape (element,).
        sin_kappa: Shape (element,).
        cos_kappa: Shape (element,).
        width: Length along the profile [m], shape (element,).
        lag: Angle by which the helix holds the element back [rad], shape (element,).
        sagitta: How far the mean of an element lies inward of its middle [m], shape
            (element,).
        bottom_count: The first elements, which lie on the flat end.
    """

    height: Float[Array, " element"]
    radius: Float[Array, " element"]
    sin_kappa: Float[Array, " element"]
    cos_kappa: Float[Array, " element"]
    width: Float[Array, " element"]
    lag: Float[Array, " element"]
    sagitta: Float[Array, " element"]
    bottom_count: int = eqx.field(static=True)


class EdgeProfile(NamedTuple):
    """A flat end, a round corner and a straight side with a helix of constant lead.

    Attributes:
        radius: R [m].
        corner_radius: r [m].
        helix_angle: At R [rad].
        corner_limit: Angle kappa up to which the corner's elements reach [rad].
        element_height: Height of an element of the side [m].
    """

    radius: Float[Array, ""]
    corner_radius: Float[Array, ""]
    helix_angle: Float[Array, ""]
    corner_limit: RealScalarLike
    element_height: RealScalarLike


class ElementCounts(NamedTuple):
    """Number of elements on the flat end, the corner and the side."""

    bottom: int
    corner: int
    side: int


def edge_elements(
    profile: EdgeProfile, counts: ElementCounts, dtype: DTypeLike
) -> EdgeElements:
    """Return the elements of an edge.

    Args:
        profile: The edge.
        counts: How many there are.
        dtype: Floating type.
    """
    R, r, helix, corner_limit, height = profile
    bottom, around, side = counts

    def middles(count: int) -> Array:
        return (jnp.arange(count, dtype=dtype) + 0.5) / max(count, 1)

    zero, one = jnp.zeros(bottom, dtype), jnp.ones(side, dtype)
    kappa = middles(around) * corner_limit
    piece = corner_limit / max(around, 1)
    heights = jnp.concatenate(
        [zero, r * (1 - jnp.cos(kappa)), r + height * side * middles(side)]
    )
    return EdgeElements(
        height=heights,
        radius=jnp.concatenate(
            [(R - r) * middles(bottom), R - r + r * jnp.sin(kappa), R * one]
        ),
        sin_kappa=jnp.concatenate([zero, jnp.sin(kappa), one]),
        cos_kappa=jnp.concatenate(
            [jnp.ones(bottom, dtype), jnp.cos(kappa), jnp.zeros(side, dtype)]
        ),
        width=jnp.concatenate(
            [
                jnp.full(bottom, 1 / max(bottom, 1), dtype) * (R - r),
                jnp.full(around, piece, dtype) * r,
                height * one,
            ]
        ),
        lag=heights * jnp.tan(helix) / R,
        sagitta=jnp.concatenate(
            [zero, jnp.full(around, r * piece**2 / 24, dtype), 0 * one]
        ),
        bottom_count=bottom,
    )
