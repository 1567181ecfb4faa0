"""Chip thickness from the poses that cut before: circle against circles.

A tooth at immersion angle phi cuts outward to the radius R of its own circle and
finds the material down to where an earlier circle, shifted by u, ended:

    h(phi) = R - (u.e + sqrt(R^2 - |u - (u.e) e|^2)),  e = (sin phi, cos phi).

The chip is the least of these over all earlier poses, so it follows regeneration over
several teeth and is zero where the tool left the cut.

The earlier tooth met the ray along e not a whole turn Theta between the teeth ago, but
where it stood at phi + delta, since its axis was shifted across the ray:

    R delta = -u.t,  t = (cos phi, -sin phi),  and u is that of Theta - delta:
    u = u_Theta (1 - delta / Theta) = u_Theta / (1 - u_Theta.t / (R Theta)),

u_Theta the shift when that tooth stood at phi. So teeth go on trochoids, to the third
order of the feed over R. Of a straight cut with N teeth, Theta = 2 pi / N,

    h = f sin(phi) (1 - f N cos(phi) / (2 pi R)) + f^2 cos(phi)^2 / (2 R) + O(f^3).
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._types import RealScalarLike
from ..numerics import clamp, hat_integral, materialise

# Below this motion per tooth an edge counts as standing still [m].
_STANDSTILL = 1e-8
# Below this its direction has no derivative [m].
_AT_REST = 3e-6
# From this share of the way on an edge cuts with its side.
_ASIDE = 0.02
# The turn between two teeth counts as longer or shorter by no more than this share.
_LARGEST_LEAD = 0.5


class RadialDirection(eqx.Module):
    """Directions e = (sin phi, cos phi) in which teeth stand out of the axis.

    Attributes:
        sin: Sine of the immersion angle, any shape.
        cos: Its cosine, same shape.
    """

    sin: Float[Array, "*sample"]
    cos: Float[Array, "*sample"]

    @classmethod
    def of(cls, immersion_angle: Float[Array, "*sample"]) -> "RadialDirection":
        """Return the directions at immersion angles [rad], any shape."""
        # All that is computed of a sample needs them, and would compute them again.
        return materialise(cls(jnp.sin(immersion_angle), jnp.cos(immersion_angle)))


class UnclippedChip(NamedTuple):
    """Chips as the poses before leave them, negative outside of the cut.

    Attributes:
        thickness: [m], any shape.
        per_travel: Thickness over the travel of the tool since the earlier pose that
            left it [-], same shape.
    """

    thickness: Float[Array, "*sample"]
    per_travel: Float[Array, "*sample"]


def circle_chip(
    radius: RealScalarLike,
    offset: Float[Array, " 3"],
    immersion_angle: Float[Array, "*sample"],
    if_missed: RealScalarLike,
    inverse_turn: RealScalarLike = 0.0,
) -> Float[Array, "*sample"]:
    """Chip thickness that one earlier circle leaves along a tooth's radius.

    Args:
        radius: Radius R of both circles [m], shape ().
        offset: Tool center when the earlier tooth was at the same angle, minus the
            present one [m], shape (3,).
        immersion_angle: Angles phi of the tooth [rad], any shape.
        if_missed: Thickness where the radius misses the earlier circle [m].
        inverse_turn: 1 / Theta, of the angle between the two teeth [1/rad], shape ();
            0 for an earlier tool that rested.

    Returns:
        Chip thickness [m], not clipped: negative where the earlier circle reaches
        beyond the present one.

    Differentiability: smooth but where the tool moves by half a radius or more in
    Theta; constant where the circle is missed, no NaN there.
    """
    outward = RadialDirection.of(immersion_angle)
    return chip_along(radius, offset, outward, if_missed, inverse_turn)


def chip_along(
    radius: RealScalarLike,
    offset: Float[Array, " 3"],
    outward: RadialDirection,
    if_missed: RealScalarLike,
    inverse_turn: RealScalarLike = 0.0,
) -> Float[Array, "*sample"]:
    """Chip thickness as of `circle_chip`, along directions that are known.

    Args:
        radius: As of `circle_chip`.
        offset: As of `circle_chip`.
        outward: Directions of the tooth, any shape.
        if_missed: As of `circle_chip`.
        inverse_turn: As of `circle_chip`.

    Returns:
        As of `circle_chip`.

    Differentiability: that of `circle_chip`.
    """
    sin, cos = outward.sin, outward.cos
    along = offset[0] * sin + offset[1] * cos
    sideways = offset[0] * cos - offset[1] * sin
    share = travel_share(sideways / radius, inverse_turn)
    along, sideways = along * share, sideways * share
    square = jnp.asarray(radius) ** 2 - sideways**2
    is_met = square > 0
    root = jnp.sqrt(jnp.where(is_met, square, 1.0))
    return jnp.where(is_met, radius - along - root, if_missed)


def travel_share(
    sideways: Float[Array, "*sample"],
    inverse_turn: RealScalarLike | Float[Array, "*#sample"],
) -> Float[Array, "*sample"]:
    """Share of the travel per tooth that had come since an earlier tooth met the ray.

        1 - delta / Theta = 1 / (1 - u.t / (R Theta))

    # symbols: u offset of the earlier axis, t direction of the cut, R radius, Theta
    angle between the two teeth, delta what the earlier one had turned further

    Args:
        sideways: u.t / R, of the axis when the earlier tooth was at this angle [rad],
            any shape.
        inverse_turn: 1 / Theta [1/rad], broadcast.

    Returns:
        The share [-], any shape, from 2/3 to 2.

    Differentiability: smooth but at both limits, which a tool reaches that moves by
    its radius in a turn.
    """
    return 1 / (1 - clamp(-_LARGEST_LEAD, sideways * inverse_turn, _LARGEST_LEAD))


def layer_share(
    tip_height: Float[Array, ""],
    element_lower: Float[Array, " element"],
    element_height: RealScalarLike,
) -> Float[Array, " element"]:
    """Return the share of each disc that an earlier, higher or lower, pose cut.

    Args:
        tip_height: Earlier tip above the present one along the axis [m], shape ().
        element_lower: Lower face of each disc above the present tip [m],
            shape (element,).
        element_height: Height of a disc [m], shape ().

    Returns:
        0 where the disc lies below the earlier tip, 1 where above, shape (element,).

    Differentiability: kinks at both ends of the ramp.
    """
    share = (element_lower + element_height - tip_height) / element_height
    return clamp(0.0, share, 1.0)


def edge_contact(
    chip_per_way: Float[Array, "*sample"],
    feed_per_tooth: Float[Array, ""],
    angle_step: float | Float[Array, "*#sample"],
) -> Float[Array, "*sample"]:
    """Contact of an edge, a smooth step from 0 to 1 at zero thickness.

    The step is as wide as the chip changes from one sample to the next, centered on
    zero, so that the sum over samples is the length of the edge at any phase of them.

    Args:
        chip_per_way: Unclipped chip thickness over the way from the earlier pose that
            left it, the least over the earlier poses [-], any shape. Of the chip
            alone, an older pose decided outside the cut, and the step began late.
        feed_per_tooth: Motion since the tooth before [m], shape ().
        angle_step: Angle between two samples [rad], times the sine of the angle between
            the edge's normal and the axis; broadcast.

    Returns:
        0 to 1, same shape; 0 for a tool that rests.

    Differentiability: continuously differentiable.
    """
    moving = feed_per_tooth**2 / (feed_per_tooth**2 + _STANDSTILL**2)
    return moving * hat_integral(chip_per_way / angle_step)


def rounded_corner(
    chip: Float[Array, "*sample"],
    slope: Float[Array, "*#sample"],
    angles: int,
) -> Float[Array, "*sample"]:
    """Return by how much the mean chip of a sample exceeds that of its middle [m].

    Where a chip begins or ends within a sample, its middle tells all or nothing: of a
    narrow cut, which is few samples long, some percent of the force. A sample stands
    for the way to both neighbours, weighed by a hat as its contact is.

    Args:
        chip: Unclipped chip thickness in the middle [m], any shape.
        slope: Its change with the angle [m/rad], broadcast.
        angles: Samples per revolution.

    Returns:
        0 from one sample off the end of the chip on, same shape.

    Differentiability: with the clipped chip, twice continuously differentiable.
    """
    width = jnp.maximum(2 * math.pi / angles * jnp.abs(slope), _STANDSTILL)
    return width / 6 * jnp.maximum(1 - jnp.abs(chip) / width, 0) ** 3


def chip_growth(
    ahead: Float[Array, "*sample"], rise: Float[Array, "*sample"], angles: int
) -> Float[Array, "*sample"]:
    """Growth of a chip's thickness to the next sample.

    Args:
        ahead: Motion per tooth along the normal of the edge, the chip but for the bow
            of the surface behind it [m], any shape.
        rise: Its change with the angle [m/rad], same shape.
        angles: Samples per revolution.

    Returns:
        Over the thickness [-], same shape; at most 1 beside the end of a chip.

    Differentiability: continuous, a kink at the greatest growth.
    """
    step = 2 * math.pi / angles
    least = step * jnp.sqrt(ahead**2 + rise**2 + _STANDSTILL**2)
    return step * rise / jnp.maximum(ahead, least)


def sideways_share(
    sideways: Float[Array, "*sample"], way: Float[Array, "*#sample"]
) -> Float[Array, "*sample"]:
    """Displacement of an edge along its normals, as far as it counts.

    The chip of a side that only moves along itself, as in a plunge, is zero all the way
    round: on that edge of the step of `edge_contact` half of it would rub.

    Args:
        sideways: Largest motion along the normals at any angle [m], any shape.
        way: The whole motion [m], broadcast.

    Returns:
        0 for no such motion, 1 from a fiftieth of the way on, same shape.

    Differentiability: continuously differentiable in both, for a way above zero.
    """
    share = sideways / jnp.maximum(way, _STANDSTILL)
    return hat_integral(clamp(0.0, share / _ASIDE, 1.0) * 2 - 1)


def safe_norm(vector: Float[Array, "*sample n"]) -> Float[Array, "*sample"]:
    """Return the Euclidean length, with derivative zero at zero."""
    square = jnp.sum(vector**2, axis=-1)
    is_zero: Bool[Array, "*sample"] = square == 0
    return jnp.where(is_zero, 0, jnp.sqrt(jnp.where(is_zero, 1, square)))


def freeze_derivative_at_standstill(
    value: Float[Array, "*sample"], feed_per_tooth: Float[Array, "*#sample"]
) -> Float[Array, "*sample"]:
    """Values that follow the direction of a motion, constant where the tool rests.

    Where the tool hardly moves, its direction turns by feed^-1 per metre: true over
    nanometres, and of no use over the micrometres by which a path is corrected. There
    the derivative is zero, as that of a jump.

    Args:
        value: What depends on the direction, any shape.
        feed_per_tooth: Motion since the tooth before [m], broadcast.

    Returns:
        The value.

    Differentiability: that of `value` from 3 um per tooth on, zero below.
    """
    is_at_rest = feed_per_tooth < _AT_REST
    return jnp.where(is_at_rest, jax.lax.stop_gradient(value), value)


def displacement_norm(offset: Float[Array, "*sample n"]) -> Float[Array, "*sample"]:
    """Return the way between two poses, at least a little, to divide by [m]."""
    return jnp.maximum(safe_norm(offset), _STANDSTILL)
