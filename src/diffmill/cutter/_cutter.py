"""Milling cutters as the solids that they sweep when they rotate."""

import abc
import math
from typing import Literal

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._types import RealScalarLike

# Longer than any workpiece [m]: the shank leaves no material above the cutter.
_ABOVE_EVERYTHING = 1e3
# Half a chord shorter than this share of the radius is a ray that only touches the
# cutter's side: it stands within 1 um of it for a cutter of 10 mm. Where the chords of
# successive teeth do not overlap, every tooth would leave an island on such a ray.
_GRAZE = 0.02
# A ray less than this above the tip [m] only touches the bottom.
_TOUCH = 1e-9


class AbstractCutter(eqx.Module):
    """What removal, engagement and forces ask of a cutter (tool axis along +z).

    Every member is elementwise in the coordinates of the rays.
    """

    diameter: eqx.AbstractVar[RealScalarLike]
    helix_angle: eqx.AbstractVar[RealScalarLike]
    flute_count: eqx.AbstractVar[int]
    flute_length: eqx.AbstractVar[float]
    nominal_radius: eqx.AbstractVar[float]
    has_helix: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def intersect(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "..."],
        c: Float[Array, "..."],
        tip: Float[Array, " 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."], Bool[Array, "..."]]:
        """Return where rays enter and leave the cutter, and whether they meet it."""

    @abc.abstractmethod
    def wall_slopes(
        self,
        family: Literal[0, 1],
        end: Float[Array, "..."],
        across: Float[Array, "..."],
        tip: Float[Array, "... 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return how a hit point moves with the tip across the ray and the radius."""


class FlatEndMill(AbstractCutter):
    """A cylindrical end mill with a flat end.

    Attributes:
        diameter: Diameter D [m].
        helix_angle: Helix angle beta [rad]; positive for a right-hand helix.
        flute_count: Number of flutes N_z.
        flute_length: Height of the cutting part above the tip [m].
        nominal_radius: Radius that sizes the windows of rays [m]; it does not
            change when `diameter` is differentiated or traced.
        has_helix: Whether the flutes are helical; straight ones share their angles.
    """

    diameter: RealScalarLike
    helix_angle: RealScalarLike
    flute_count: int = eqx.field(static=True)
    flute_length: float = eqx.field(static=True)
    nominal_radius: float = eqx.field(static=True)
    has_helix: bool = eqx.field(static=True)

    def __check_init__(self):
        if self.flute_count < 1:
            raise ValueError(
                f"Argument `teeth` must be at least 1, but is {self.flute_count}."
            )
        for name, value in (
            ("diameter", 2 * self.nominal_radius),
            ("flute_length", self.flute_length),
        ):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(
                    f"Argument `{name}` must be finite and positive, but is {value}."
                )

    def intersect(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "..."],
        c: Float[Array, "..."],
        tip: Float[Array, " 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."], Bool[Array, "..."]]:
        """Return where rays enter and leave the cutter, and whether they meet it.

        Args:
            family: Axis along which the rays run: 0 is x, 1 is y, 2 is z.
            b: Coordinate of each ray along axis (family + 1) % 3 [m].
            c: Coordinate of each ray along axis (family + 2) % 3 [m].
            tip: Tool tip [m], shape (3,).

        Returns:
            Entry and exit along the ray [m], and whether the ray is hit; entry and
            exit are finite but without meaning where it is not.

        Differentiability: smooth where a ray is hit away from grazing; the square
        root is guarded, so gradients are finite everywhere.
        """
        R = self.diameter / 2
        db = b - tip[(family + 1) % 3]
        dc = c - tip[(family + 2) % 3]
        if family == 2:
            is_hit = db**2 + dc**2 < R**2
            lower = jnp.broadcast_to(tip[2], is_hit.shape)
            return lower, jnp.full_like(lower, _ABOVE_EVERYTHING), is_hit
        across, up = (db, dc) if family == 0 else (dc, db)
        square = R**2 - across**2
        # Walls and floors of real parts lie exactly on rays: without a tolerance,
        # rounding would decide pose by pose and shred such a ray.
        is_hit = (square > (_GRAZE * R) ** 2) & (up > _TOUCH)
        half = jnp.sqrt(jnp.where(is_hit, square, 1.0))
        return tip[family] - half, tip[family] + half, jnp.asarray(is_hit)

    def wall_slopes(
        self,
        family: Literal[0, 1],
        end: Float[Array, "..."],
        across: Float[Array, "..."],
        tip: Float[Array, "... 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return how a hit point moves with the tip across the ray and the radius.

        A point x on the circle (x - c_x)^2 + (y - c_y)^2 = R^2 of a ray along x moves
        by dx = dc_x + (y - c_y) / (x - c_x) dc_y + R / (x - c_x) dR.

        Args:
            family: 0 for rays along x, 1 for rays along y.
            end: Hit point along the ray [m].
            across: The ray's coordinate along the other of these two axes [m].
            tip: Tool tip that made the hit point [m], shape (..., 3).

        Returns:
            The two slopes, shape (...).
        """
        along = end - tip[..., family]
        # A grazing ray has no derivative; its slope is cut off, not infinite.
        tiny = 1e-9
        away = jnp.where(along < 0, -tiny, tiny)
        along = jnp.where(jnp.abs(along) < tiny, away, along)
        return (
            (across - tip[..., 1 - family]) / along,
            jnp.asarray(self.diameter / 2 / along),
        )


def flat_end_mill(
    diameter: RealScalarLike,
    teeth: int,
    helix_angle: RealScalarLike = 0.0,
    *,
    flute_length: float | None = None,
    nominal_diameter: float | None = None,
) -> FlatEndMill:
    """Return a flat end mill.

    Args:
        diameter: Diameter [m], shape ().
        teeth: Number of teeth.
        helix_angle: Helix angle [rad], shape ().
        flute_length: Height of the cutting part [m]; three diameters if not given.
        nominal_diameter: Diameter that sizes the windows of rays [m]; needed only
            where `diameter` is a traced value.

    Returns:
        The cutter.

    Raises:
        ValueError: A size is not finite and positive, or there is no tooth.
    """
    nominal = float(diameter if nominal_diameter is None else nominal_diameter)
    return FlatEndMill(
        diameter=diameter,
        helix_angle=helix_angle,
        flute_count=teeth,
        flute_length=3 * nominal if flute_length is None else float(flute_length),
        nominal_radius=nominal / 2,
        has_helix=isinstance(helix_angle, jax.core.Tracer) or bool(helix_angle != 0),
    )
