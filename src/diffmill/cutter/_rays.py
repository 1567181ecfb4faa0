"""Intersections of rays along the axes with an end mill in any pose.

A ray is reduced to numbers of the pair ray and tool axis, which keep their digits
when the two are parallel or cross at a right angle. The solid is convex, so each ray
has one interval. All roots are found on frozen numbers; `EndMill.intersect_pose`
gives them the derivatives of the signed distance.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._profile import Sizes, profile_level

# Distance at which rays are cut off, beyond any workpiece [m].
FAR = 1e3
# Least sine of an angle that is not parallel, least cosine of one that is not a right
# angle: the ray would meet the side, or the plane of the bottom, far beyond `FAR`.
_LEAST_SINE = 1e-12
# Steps of Newton's method for the torus of a bull-nose.
NEWTON_STEPS = 12


class Chord(NamedTuple):
    """Chord of each ray in a convex solid.

    Attributes:
        start: Coordinate at which the ray enters [m].
        stop: Coordinate at which it leaves [m].
        is_hit: True if the ray meets the solid; else start and stop mean nothing.
    """

    start: Float[Array, "..."]
    stop: Float[Array, "..."]
    is_hit: Bool[Array, "..."]


class Ray(eqx.Module):
    """A ray as seen from the tool axis; t is measured from the tip's coordinate.

    Attributes:
        foot: Ray's coordinates from the tip across its direction [m], two arrays.
        tilt: Tool axis along these two coordinates, two arrays.
        rise: Cosine between ray and tool axis.
        slant: Sine between them; 0 if parallel.
        middle: t of the point closest to the tool axis [m].
        offset: Distance of that point from the axis [m].
        along: Height above the tip at t = 0 [m].
        low: t at which the ray is cut off below [m].
        high: t at which the ray is cut off above [m].
    """

    foot: tuple[Float[Array, "..."], Float[Array, "..."]]
    tilt: tuple[Float[Array, "..."], Float[Array, "..."]]
    rise: Float[Array, "..."]
    slant: Float[Array, "..."]
    middle: Float[Array, "..."]
    offset: Float[Array, "..."]
    along: Float[Array, "..."]
    low: Float[Array, "..."]
    high: Float[Array, "..."]

    def height(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Height above the tip along the tool axis [m]."""
        return self.along + t * self.rise

    def level(
        self,
        t: Float[Array, "..."],
        sizes: Sizes,
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Signed distance [m] and its slope along the ray [-]."""
        x = self.slant * (t - self.middle)
        square = x**2 + self.offset**2
        is_off = square > 0
        rho = jnp.where(is_off, jnp.sqrt(jnp.where(is_off, square, 1)), 0)
        value, by_along, by_across = profile_level(self.height(t), rho, sizes)
        spread = self.slant * x / jnp.where(is_off, rho, 1)
        return value, by_along * self.rise + by_across * spread


def make_ray(
    family: Literal[0, 1, 2],
    b: Float[Array, "..."],
    c: Float[Array, "..."],
    tip: Float[Array, "... 3"],
    axis: Float[Array, "... 3"],
) -> Ray:
    """Rays along an axis of `work`, seen from the tool axis; shapes agree."""
    axis_b, axis_c = (family + 1) % 3, (family + 2) % 3
    x, y = b - tip[..., axis_b], c - tip[..., axis_c]
    p, q, rise = axis[..., axis_b], axis[..., axis_c], axis[..., family]
    slant = jnp.sqrt(p**2 + q**2)
    is_slanted = slant > _LEAST_SINE
    s = jnp.where(is_slanted, slant, 1)
    along = x * p + y * q
    crossing = jnp.abs(y * (p / s) - x * (q / s))
    return Ray(
        foot=(x, y),
        tilt=(p, q),
        rise=rise,
        slant=jnp.where(is_slanted, slant, 0),
        middle=jnp.where(is_slanted, along / s * (rise / s), 0),
        offset=jnp.where(is_slanted, crossing, jnp.sqrt(x**2 + y**2)),
        along=along,
        low=-FAR - tip[..., family],
        high=FAR - tip[..., family],
    )


def capped_cylinder(
    ray: Ray, radius: Float[Array, "..."], bottom: Float[Array, "..."]
) -> Chord:
    """Interval within a radius of the axis and above a height on it."""
    square = radius**2 - ray.offset**2
    is_slanted = ray.slant > 0
    s = jnp.where(is_slanted, ray.slant, 1)
    half = jnp.where(is_slanted, jnp.sqrt(jnp.maximum(square, 0)) / s, 2 * FAR)
    is_level = jnp.abs(ray.rise) < _LEAST_SINE
    cross = (bottom - ray.along) / jnp.where(is_level, 1, ray.rise)
    from_below = jnp.where(~is_level & (ray.rise > 0), cross, ray.low)
    to_below = jnp.where(~is_level & (ray.rise < 0), cross, ray.high)
    start = jnp.maximum(jnp.maximum(ray.middle - half, from_below), ray.low)
    stop = jnp.minimum(jnp.minimum(ray.middle + half, to_below), ray.high)
    is_above = ~is_level | (ray.along > bottom)
    return Chord(start, stop, (square > 0) & is_above & (stop > start))


def ball(ray: Ray, radius: Float[Array, ""]) -> Chord:
    """Interval within a ball end: sphere and shank together."""
    (x, y), (p, q) = ray.foot, ray.tilt
    square = radius**2 - (x - radius * p) ** 2 - (y - radius * q) ** 2
    in_ball = square > 0
    center = radius * ray.rise
    half = jnp.sqrt(jnp.maximum(square, 0))
    start, stop, in_shank = capped_cylinder(ray, radius, radius)
    # Where only one is met, its interval counts; the solid is convex.
    first = jnp.where(in_ball, center - half, start)
    last = jnp.where(in_ball, center + half, stop)
    is_both = in_ball & in_shank
    first = jnp.where(is_both, jnp.minimum(first, start), first)
    last = jnp.where(is_both, jnp.maximum(last, stop), last)
    return Chord(first, last, in_ball | in_shank)


def bull(ray: Ray, sizes: Sizes) -> Chord:
    """Interval within a bull-nose.

    Newton's method on the convex signed distance, from both ends of the cylinder
    around the solid: steps from outside never go past a root.
    """
    low, high, is_near = capped_cylinder(
        ray, sizes.radius, jnp.zeros_like(sizes.radius)
    )

    def step(_: int | Array, chord: Chord) -> Chord:
        moved = []
        for t, sign in ((chord.start, 1), (chord.stop, -1)):
            f, slope = ray.level(t, sizes)
            is_outside = (f > 0) & (sign * slope < 0)
            move = jnp.where(is_outside, -f / jnp.where(is_outside, slope, 1), 0)
            # A ray that misses the solid has no root to stop at.
            moved.append(jnp.clip(t + move, low, high))
        return Chord(moved[0], moved[1], chord.is_hit)

    around = Chord(low, high, is_near)
    start, stop, _ = jax.lax.fori_loop(0, NEWTON_STEPS, step, around)
    middle, _ = ray.level((start + stop) / 2, sizes)
    return Chord(start, stop, is_near & (stop > start) & (middle < 0))
