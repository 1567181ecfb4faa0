"""The holder of a tool: a stack of cylinders and cones above its shank."""

import math
from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import _rays

# Least leading coefficient of the quadratic of a ray, which vanishes along the surface
# of a cone, and least cosine between a ray and the axis.
_LEAST_COEFFICIENT = 1e-12


class HolderPart(eqx.Module):
    """A cylinder, or a cone whose point is cut off, around the tool axis.

    Attributes:
        diameter: Diameter at its lower end, toward the tip [m].
        upper_diameter: Diameter at its upper end [m].
        length: Along the tool axis [m].
    """

    diameter: float = eqx.field(static=True)
    upper_diameter: float = eqx.field(static=True)
    length: float = eqx.field(static=True)

    def __check_init__(self):
        """Refuse sizes that are no lengths."""
        for name in ("diameter", "upper_diameter", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(
                    f"Argument `{name}` must be finite and positive, but is {value}."
                )


class ToolHolder(eqx.Module):
    """Holder of the cutter, from its lower face up; it turns, but never cuts.

    Attributes:
        overhang: From the tip of the tool to the lower face of the holder [m].
        parts: Cylinders and cones from the lower face up, at least one.
    """

    overhang: float = eqx.field(static=True)
    parts: tuple[HolderPart, ...]

    @classmethod
    def from_sizes(
        cls,
        overhang: float,
        diameters: Sequence[float],
        lengths: Sequence[float],
        *,
        upper_diameters: Sequence[float] | None = None,
    ) -> "ToolHolder":
        """Holder from the sizes of its parts, from the lower face up.

        Args:
            overhang: From the tip of the tool to the lower face of the holder [m].
            diameters: Of the lower end of each part [m].
            lengths: Of each part along the tool axis [m].
            upper_diameters: Of the upper end of each part [m]; cylinders if not given.

        Raises:
            ValueError: There is no part, a size is not finite and positive, or parts
                have other numbers of sizes.
        """
        uppers = diameters if upper_diameters is None else upper_diameters
        if not len(diameters) == len(lengths) == len(uppers):
            raise ValueError(
                "Arguments `diameters`, `lengths` and `upper_diameters` must have a "
                f"number for each part, but have {len(diameters)}, {len(lengths)} and "
                f"{len(uppers)}."
            )
        sizes = zip(diameters, uppers, lengths, strict=True)
        parts = tuple(HolderPart(*(float(size) for size in part)) for part in sizes)
        return cls(float(overhang), parts)

    def __check_init__(self):
        """Refuse a holder of nothing."""
        if not (math.isfinite(self.overhang) and self.overhang > 0):
            raise ValueError(
                "Argument `overhang` must be finite and positive, but is "
                f"{self.overhang}."
            )
        if not self.parts:
            raise ValueError("Argument `parts` must have at least one part, but has 0.")

    @property
    def length(self) -> float:
        """Length of all parts along the tool axis [m]."""
        return math.fsum(part.length for part in self.parts)

    @property
    def radius(self) -> float:
        """Largest radius of all parts [m]."""
        return max(max(p.diameter, p.upper_diameter) for p in self.parts) / 2

    def feet(self) -> tuple[float, ...]:
        """Height of the lower end of each part above the tip [m]."""
        heights = [self.overhang]
        for part in self.parts[:-1]:
            heights.append(heights[-1] + part.length)
        return tuple(heights)

    def depth_in_pieces(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "*#piece"],
        c: Float[Array, "*#piece"],
        pieces: Float[Array, "2 *#piece"],
        tip: Float[Array, " 3"],
        axis: Float[Array, " 3"],
    ) -> Float[Array, "*piece"]:
        """Depth of the holder in pieces of rays [m].

        The depth of a point is its distance from the side and the lower face of the
        part around it; the upper end counts as open, since the spindle is above it. Of
        a piece the point nearest to the middle of a part counts.

        Args:
            family: Axis along which the rays run: 0 is x, 1 is y, 2 is z.
            b: Coordinate of each ray along axis (family + 1) % 3 [m], shape (...).
            c: Coordinate of each ray along axis (family + 2) % 3 [m], broadcast.
            pieces: Lower and upper ends of material [m], shape (2, ...), broadcast; a
                piece whose ends are reversed is none.
            tip: Tool tip [m], shape (3,).
            axis: Unit tool axis from tip to shank, shape (3,).

        Returns:
            The depth [m], shape (...); zero where the holder is not.

        Differentiability: none intended, as a contact is only detected.
        """
        ray = _rays.make_ray(family, b, c, tip, axis)
        low, high = pieces - tip[family]
        depth = jnp.zeros(jnp.broadcast_shapes(b.shape, c.shape, low.shape), b.dtype)
        for part, foot in zip(self.parts, self.feet(), strict=True):
            start, stop, is_hit = _frustum(ray, part, foot)
            first, last = jnp.maximum(low, start), jnp.minimum(high, stop)
            t = jnp.clip((start + stop) / 2, first, last)
            up = ray.height(t) - foot
            slope = (part.upper_diameter - part.diameter) / 2 / part.length
            rho = jnp.sqrt((ray.slant * (t - ray.middle)) ** 2 + ray.offset**2)
            side = (part.diameter / 2 + slope * up - rho) / math.hypot(1, slope)
            is_in = is_hit & (last > first)
            depth = jnp.maximum(depth, jnp.where(is_in, jnp.minimum(up, side), 0))
        return depth


def _frustum(ray: _rays.Ray, part: HolderPart, foot: float) -> _rays.Chord:
    """Interval of rays within a cone between two heights.

    The square of the distance from the axis is at most that of the radius there,
    a t^2 + 2 b t + c <= 0. Between the two heights the radius is positive, so that this
    holds on one interval.
    """
    k = (part.upper_diameter - part.diameter) / 2 / part.length
    radius = part.diameter / 2 + k * (ray.along - foot)
    rises = k * ray.rise
    a = ray.slant**2 - rises**2
    a = jnp.where(jnp.abs(a) < _LEAST_COEFFICIENT, _LEAST_COEFFICIENT, a)
    b = -(ray.slant**2) * ray.middle - rises * radius
    c = (ray.slant * ray.middle) ** 2 + ray.offset**2 - radius**2
    square = b**2 - a * c
    root = jnp.sqrt(jnp.maximum(square, 0))
    # The root that does not cancel, and the other from the product of both.
    big = -(b + jnp.where(b < 0, -root, root))
    other = c / jnp.where(big == 0, 1, big)
    first, second = big / a, jnp.where(big == 0, 0, other)
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    # In a steep ray's double cone the half counts whose radius is positive.
    is_open = a < 0
    start = jnp.where(is_open, jnp.where(rises > 0, high, ray.low), low)
    stop = jnp.where(is_open, jnp.where(rises > 0, ray.high, low), high)
    is_level = jnp.abs(ray.rise) < _LEAST_COEFFICIENT
    rise = jnp.where(is_level, 1, ray.rise)
    ends = (foot - ray.along) / rise, (foot + part.length - ray.along) / rise
    between = (ray.along > foot) & (ray.along < foot + part.length)
    start = jnp.maximum(start, jnp.where(is_level, ray.low, jnp.minimum(*ends)))
    stop = jnp.minimum(stop, jnp.where(is_level, ray.high, jnp.maximum(*ends)))
    is_met = ((square > 0) | is_open) & (~is_level | between)
    return _rays.Chord(start, stop, is_met & (stop > start))
