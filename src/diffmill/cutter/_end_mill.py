"""End mills as the solids that they sweep when they rotate."""

import dataclasses
import math
from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from .._arrays import is_traced
from .._types import RealScalarLike
from ..numerics import with_derivative_of
from . import _profile, _rays
from ._abstract import AbstractCutter, EdgeElements

Kind: TypeAlias = Literal["flat", "ball", "bull"]

# Half a chord over the radius, below which a ray only touches the cutter's side: it
# stands within 1 um of it for a cutter of 10 mm. Where the chords of successive teeth
# do not overlap, every tooth would leave an island on such a ray.
_LEAST_HALF_CHORD = 0.02
# Height above the tip below which a ray only touches the bottom [m].
_LEAST_HEIGHT = 1e-9
# Least slope of the signed distance along a ray that its derivatives are divided by.
_LEAST_SLOPE = 1e-3
# Diameter of the largest cutters [m].
_LARGEST = 1.0


class EndMill(AbstractCutter):
    """A flat, ball or bull-nose end mill with a shank of the same radius.

    Made by `flat_end_mill`, `ball_end_mill` and `bull_nose`. The swept solid is that
    of the cutter without its run-out, or, where an offset is given, of an edge that
    stands out by this much across the axis; `runout_offsets` gives it tooth by tooth.

    Attributes:
        diameter: Diameter D [m].
        own_corner_radius: Corner radius of a bull-nose [m]; None for other kinds, where
            `corner_radius` follows from the diameter.
        helix_angle: Helix angle beta at the full radius, of constant lead [rad];
            positive for a right-hand helix.
        pitch_angles: Angle of each tooth from tooth 0 [rad], shape (tooth,).
        runout: Offset of the cutter from the axis of rotation [m].
        runout_angle: Direction of that offset from tooth 0 [rad].
        dish_angle: Angle by which a flat end rises from the corner to the center [rad];
            it acts on an upright cutter's bottom edges, and on the ends of columns.
        kind: "flat", "ball" or "bull".
        flute_count: Number of flutes N_z.
        flute_length: Height of the cutting part above the tip [m].
        nominal_radius: Radius that sizes the windows of rays [m]; it does not
            change when `diameter` is differentiated or traced.
        nominal_corner_radius: Corner radius that sizes the edge elements [m].
        has_helix: True for helical flutes; straight ones share their angles.
        has_dish: True for a flat end that is ground hollow.
        has_runout: True if a run-out is set, or traced.
        has_even_pitch: True if the teeth stand at equal angles; False if traced.
        is_plain: True if the end is flat, the pitch even and no run-out set or traced.
            Such a cutter may be taken through programs without derivatives by
            corner radius, pitch and run-out.
    """

    diameter: RealScalarLike
    own_corner_radius: RealScalarLike | None
    helix_angle: RealScalarLike
    pitch_angles: Float[Array, " tooth"] | Float[np.ndarray, " tooth"]
    runout: RealScalarLike
    runout_angle: RealScalarLike
    dish_angle: RealScalarLike
    kind: Kind = eqx.field(static=True)
    flute_count: int = eqx.field(static=True)
    flute_length: float = eqx.field(static=True)
    nominal_radius: float = eqx.field(static=True)
    nominal_corner_radius: float = eqx.field(static=True)
    has_helix: bool = eqx.field(static=True)
    has_dish: bool = eqx.field(static=True)
    has_runout: bool = eqx.field(static=True)
    has_even_pitch: bool = eqx.field(static=True)
    is_plain: bool = eqx.field(static=True)

    def __check_init__(self):
        """Refuse impossible sizes."""
        for name, value in (
            ("diameter", 2 * self.nominal_radius),
            ("flute_length", self.flute_length),
        ):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(
                    f"Argument `{name}` must be finite and positive, but is {value}."
                )
        R, rc = self.nominal_radius, self.nominal_corner_radius
        # Millimetres in place of metres.
        if 2 * R > _LARGEST:
            raise ValueError(
                f"Argument `diameter` must be in metres, {_LARGEST:g} at most, but is "
                f"{2 * R:g}."
            )
        if self.kind == "bull" and not 0 < rc < R:
            raise ValueError(
                f"Argument `corner_radius` must be above 0 and below the radius, {R}, "
                f"but is {rc}; flat and ball end mills have functions of their own."
            )
        for name, value, limit in (
            ("helix_angle", self.helix_angle, math.pi / 2),
            ("runout", self.runout, R),
            ("runout_angle", self.runout_angle, math.inf),
            ("dish_angle", self.dish_angle, math.pi / 4),
        ):
            # Within a trace, arithmetic of what is known would be traced, too.
            if not is_traced(value) and not abs(float(value)) < limit:
                raise ValueError(
                    f"Argument `{name}` must be finite and below {limit:g} in size, "
                    f"but is {value}."
                )
        self._check_replaced()

    def _check_replaced(self) -> None:
        """Refuse values put in the place of those that the cutter was made for."""
        even = 2 * math.pi / self.flute_count * np.arange(self.flute_count)
        for name, is_left_out, usual in (
            ("helix_angle", not self.has_helix, 0.0),
            ("dish_angle", not self.has_dish, 0.0),
            ("runout", not self.has_runout, 0.0),
            ("pitch_angles", self.has_even_pitch, even),
        ):
            value = getattr(self, name)
            if not is_left_out or is_traced(value):
                continue
            is_alike = np.shape(value) == np.shape(usual)
            if not is_alike or not np.allclose(value, usual, atol=0.0):
                raise ValueError(
                    f"Argument `{name}` must be as the cutter was made, {usual}, but "
                    f"is {value}; make another one, as by `flat_end_mill`."
                )

    def with_sizes_as_leaves(self) -> "EndMill":
        """Cutter with its nominal sizes as leaves."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return _SizedEndMill(**values)

    @property
    def has_corner(self) -> bool:
        """True if the end is rounded."""
        return self.kind != "flat"

    @property
    def corner_radius(self) -> RealScalarLike:
        """Corner radius [m], shape (): 0 for a flat end, the radius for a ball."""
        if self.own_corner_radius is not None:
            return self.own_corner_radius
        return self.diameter / 2 if self.kind == "ball" else 0.0

    def _sizes(
        self, dtype: DTypeLike, offset: Float[Array, "..."] | None = None
    ) -> _profile.Sizes:
        """Sizes in a floating type, with edges that stand out by an offset [m]."""
        radius = jnp.asarray(self.diameter, dtype) / 2
        radius = radius if offset is None else radius + offset
        return _profile.Sizes(radius, jnp.asarray(self.corner_radius, dtype))

    def level(
        self,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
        offset: Float[Array, "*#place"] | None = None,
    ) -> Float[Array, "..."]:
        """Signed distance to the swept solid, negative inside [m].

        With u = (p - tip) . a, rho = |p - tip - u a| and
        q = (rho - (R - r_c), r_c - u), it is |max(q, 0)| + min(max(q), 0) - r_c.
        The solid has no upper end. The distance is convex in the point.

        Args:
            points: Points p [m], shape (..., 3).
            tip: Tool tip [m], shape (..., 3), broadcast against the points.
            axis: Unit tool axis a, from tip to shank, shape (..., 3), broadcast.
            offset: Radial offset of the edge [m], shape (...), broadcast.

        Returns:
            The distance [m], shape (...).

        Differentiability: in all arguments and sizes; kinks inside the solid, where
            the nearest point changes from side to bottom, and on the rim of a flat end;
            finite everywhere, zero across the tool axis on it.
        """
        place = _profile.AxisPlace.of(points, tip, axis)
        return place.level(self._sizes(points.dtype, offset)).value

    def normal(
        self,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
    ) -> Float[Array, "... 3"]:
        """Outward normal: the unit gradient of `level`.

        Args:
            points: Points [m], shape (..., 3).
            tip: Tool tip [m], shape (..., 3), broadcast against the points.
            axis: Unit tool axis, shape (..., 3), broadcast.

        Returns:
            Unit vectors, shape (..., 3); on the tool axis above the bottom any that
            is at a right angle to it.

        Differentiability: as `level`, away from the tool axis and the rim.
        """
        return _profile.normal(points, tip, axis, self._sizes(points.dtype))

    def intersect(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "..."],
        c: Float[Array, "..."],
        tip: Float[Array, "*#ray 3"],
        offset: Float[Array, "*#ray"] | None = None,
    ) -> _rays.Chord:
        """Chords of rays in the upright cutter, whose axis is +z.

        `intersect_pose` is for other axes.

        Args:
            family: Axis along which the rays run: 0 is x, 1 is y, 2 is z.
            b: Coordinate of each ray along axis (family + 1) % 3 [m].
            c: Coordinate of each ray along axis (family + 2) % 3 [m].
            tip: Tool tip [m], shape (..., 3), broadcast against the rays.
            offset: Radial offset of the edge that cuts each ray [m], broadcast.

        Returns:
            Entry and exit along the ray [m]; finite but without meaning where the ray
            is not hit.

        Differentiability: smooth where a ray is hit away from grazing; the square
        root is guarded, so gradients are finite everywhere: slopes of a round end along
        z are cut off at 1000 where it turns into the side.
        """
        out = 0.0 if offset is None else offset
        R = self.diameter / 2 + out
        db = b - tip[..., (family + 1) % 3]
        dc = c - tip[..., (family + 2) % 3]
        if family == 2:
            is_hit = db**2 + dc**2 < R**2
            lower = jnp.broadcast_to(tip[..., 2], is_hit.shape)
            if self.has_corner:
                square = db**2 + dc**2
                if offset is not None:
                    inward = jnp.sqrt(square + _LEAST_HEIGHT**2) - out
                    square = jnp.maximum(inward, 0) ** 2
                lower = lower + self._end_height(square, is_hit)
            elif self.has_dish:
                # No root of zero on the axis, whose derivative is infinite.
                inward = R - jnp.sqrt(db**2 + dc**2 + _LEAST_HEIGHT**2)
                rise = jnp.maximum(inward, 0) * jnp.tan(self.dish_angle)
                lower = lower + jnp.where(is_hit, rise, 0)
            return _rays.Chord(lower, jnp.full_like(lower, _rays.FAR), is_hit)
        across, up = (db, dc) if family == 0 else (dc, db)
        r = self._end_radius(up) + out if self.has_corner else R
        square = r**2 - across**2
        # Walls and floors of real parts lie exactly on rays: without a tolerance,
        # rounding would decide pose by pose and shred such a ray.
        is_hit = (square > (_LEAST_HALF_CHORD * R) ** 2) & (up > _LEAST_HEIGHT)
        half = jnp.sqrt(jnp.where(is_hit, square, 1.0))
        middle = tip[..., family]
        return _rays.Chord(middle - half, middle + half, jnp.asarray(is_hit))

    def _end_height(
        self, square: Float[Array, "..."], is_hit: Bool[Array, "..."]
    ) -> Float[Array, "..."]:
        """Height of the end at a squared distance from the axis [m]."""
        R, rc = self._sizes(square.dtype)
        is_out = is_hit & (square > (R - rc) ** 2)
        x = jnp.sqrt(jnp.where(is_out, square, (R - rc / 2) ** 2)) - (R - rc)
        height = rc - jnp.sqrt(jnp.maximum(rc**2 - x**2, 0))
        # The value is that of the circle to the last column beside the side, where the
        # slope of the circle has no bound.
        return jnp.where(is_out, with_derivative_of(height, _bounded_height, x, rc), 0)

    def _end_radius(self, up: Float[Array, "..."]) -> Float[Array, "..."]:
        """Radius of the end at a height above the tip [m]."""
        R, rc = self._sizes(up.dtype)
        is_in = (up > _LEAST_HEIGHT) & (up < rc)
        z = jnp.where(is_in, up, rc / 2)
        return jnp.where(is_in, R - rc + jnp.sqrt(z * (2 * rc - z)), R)

    def intersect_pose(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "*#ray"],
        c: Float[Array, "*#ray"],
        tip: Float[Array, "*#ray 3"],
        axis: Float[Array, "*#ray 3"],
        offset: Float[Array, "*#ray"] | None = None,
    ) -> _rays.Chord:
        """Chords of rays in the cutter in a pose.

        Exact for flat and ball ends; by Newton's method for a bull-nose and for a ball
        whose edge stands out. A ray that only touches the cutter is not hit, as by
        `intersect`: if half its chord is shorter than 0.02 of the radius, or if it is
        nowhere 1 nm above the bottom.

        Args:
            family: Axis along which the rays run: 0 is x, 1 is y, 2 is z.
            b: Coordinate of each ray along axis (family + 1) % 3 [m], shape (...).
            c: Coordinate of each ray along axis (family + 2) % 3 [m], broadcast.
            tip: Tool tip [m], shape (..., 3), broadcast against the rays.
            axis: Unit tool axis, from tip to shank, shape (..., 3), broadcast.
            offset: Radial offset of the edge that cuts each ray [m], broadcast.

        Returns:
            Entry and exit along the ray [m], cut off at +-1 km, each of shape (...);
            finite but without meaning where the ray is not hit.

        Differentiability: in all arguments and sizes, once (second derivatives lack
            the turning of the normal); slopes are cut off at 1000 where a ray runs
            along the surface, and zero where it is cut off or not hit.
        """
        shape = jnp.broadcast_shapes(b.shape, c.shape, tip.shape[:-1], axis.shape[:-1])
        b, c = jnp.broadcast_to(b, shape), jnp.broadcast_to(c, shape)
        tip, axis = (jnp.broadcast_to(x, (*shape, 3)) for x in (tip, axis))
        if offset is not None:
            offset = jnp.broadcast_to(offset, shape)
        sizes = self._sizes(b.dtype, offset)
        frozen = jax.lax.stop_gradient((b, c, tip, axis))
        fixed = jax.lax.stop_gradient(sizes)
        ray = _rays.make_ray(family, *frozen)
        if not self.has_corner:
            start, stop, is_met = _rays.capped_cylinder(
                ray, fixed.radius, fixed.corner_radius
            )
        elif self.kind == "ball" and offset is None:
            start, stop, is_met = _rays.ball(ray, fixed.radius)
        else:
            start, stop, is_met = _rays.bull(ray, fixed)
        top = jnp.maximum(ray.height(start), ray.height(stop))
        is_long = stop - start > 2 * _LEAST_HALF_CHORD * fixed.radius
        is_hit = is_met & is_long & (top > _LEAST_HEIGHT)
        ends = []
        for t, sign in ((start, -1), (stop, 1)):
            slope = sign * jnp.maximum(sign * ray.level(t, fixed)[1], _LEAST_SLOPE)
            end = jnp.clip(frozen[2][..., family] + t, -_rays.FAR, _rays.FAR)
            place = [end, end, end]
            place[(family + 1) % 3], place[(family + 2) % 3] = b, c
            is_free = is_hit & (t > ray.low) & (t < ray.high)
            slope = jnp.where(is_free, slope, jnp.inf)
            pose = (jnp.stack(place, axis=-1), tip, axis, offset)
            ends.append(with_derivative_of(end, _end_shift, self, *pose, slope))
        return _rays.Chord(ends[0], ends[1], is_hit)

    def wall_slopes(
        self,
        family: Literal[0, 1],
        end: Float[Array, "..."],
        across: Float[Array, "..."],
        tip: Float[Array, "... 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Slopes of a hit point by the tip across the ray, and by the radius.

        A point x on the circle (x - c_x)^2 + (y - c_y)^2 = R^2 of a ray along x moves
        by dx = dc_x + (y - c_y) / (x - c_x) dc_y + R / (x - c_x) dR.

        Args:
            family: 0 for rays along x, 1 for rays along y.
            end: Hit point along the ray [m].
            across: The ray's coordinate along the other of these two axes [m].
            tip: Tool tip that made the hit point [m], shape (..., 3).

        Returns:
            The two slopes, shape (...).

        Raises:
            ValueError: If the end is not flat: its walls also move with the height.
        """
        if self.has_corner:
            raise ValueError(
                f'A cutter of kind "flat" is required here, but found "{self.kind}".'
            )
        along = end - tip[..., family]
        # A grazing ray has no derivative; its slope is cut off, not infinite.
        tiny = 1e-9
        away = jnp.where(along < 0, -tiny, tiny)
        along = jnp.where(jnp.abs(along) < tiny, away, along)
        return (
            (across - tip[..., 1 - family]) / along,
            jnp.asarray(self.diameter / 2 / along),
        )

    def elements(
        self,
        bottom: int,
        corner: int,
        side: int,
        height: RealScalarLike,
        dtype: DTypeLike,
        corner_limit: RealScalarLike = math.pi / 2,
    ) -> EdgeElements:
        """Edge elements of one tooth, from the centre to the shank.

        Args:
            bottom: Number of annuli of equal width on the bottom.
            corner: Number of arcs of equal angle on the corner; of no width on a
                flat end.
            side: Number of pieces of the side, from the height of the corner up.
            height: Height of one piece of the side [m].
            dtype: Type of the numbers.
            corner_limit: Angle kappa between axis and normal at which the arcs end
                [rad], for a corner that is only partly in the material.

        Returns:
            The elements at their midpoints.

        Raises:
            ValueError: If a count is negative or the angle not from 0 to pi / 2.

        Differentiability: smooth in the sizes.
        """
        is_known = not is_traced(corner_limit)
        is_beyond = is_known and not 0 <= float(corner_limit) <= 1.5708
        if min(bottom, corner, side) < 0 or is_beyond:
            raise ValueError(
                "Arguments `bottom`, `corner` and `side` must be at least 0 and "
                "`corner_limit` from 0 to pi / 2, but are "
                f"{bottom}, {corner}, {side} and {corner_limit}."
            )
        # symbols: R radius, r corner radius, kappa angle between axis and normal
        R, r = self._sizes(dtype)

        def middles(count: int) -> Float[Array, " element"]:
            return (jnp.arange(count, dtype=dtype) + 0.5) / max(count, 1)

        zero, one = jnp.zeros(bottom, dtype), jnp.ones(side, dtype)
        kappa = middles(corner) * corner_limit
        arc = corner_limit / max(corner, 1)
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
                    jnp.full(corner, arc, dtype) * r,
                    height * one,
                ]
            ),
            lag=heights * jnp.tan(jnp.asarray(self.helix_angle, dtype)) / R,
            sagitta=jnp.concatenate(
                [zero, jnp.full(corner, r * arc**2 / 24, dtype), 0 * one]
            ),
            bottom_count=bottom,
        )

    def runout_offsets(
        self, lag: Float[Array, "*element"] | float = 0.0
    ) -> Float[Array, "tooth ..."]:
        """Radial offset of the edge of each tooth by the run-out [m].

        The axis of the cutter lies beside that of rotation, so that along a helix the
        edge turns out of the direction of the run-out. Kline and DeVor, The effect of
        runout on cutting geometry and forces in end milling, 1983.

        Args:
            lag: Angle by which the edge lags behind its tip [rad], shape (*element,).

        Returns:
            runout cos(runout_angle - pitch angle + lag) [m], shape (tooth, *element);
            the first order in the run-out over the radius.
        """
        pitch = jnp.asarray(self.pitch_angles)
        angle = jnp.asarray(self.runout_angle, pitch.dtype)
        turned = jnp.add.outer(angle - pitch, jnp.asarray(lag, pitch.dtype))
        return jnp.asarray(self.runout, pitch.dtype) * jnp.cos(turned)


def _end_shift(
    cutter: AbstractCutter,
    place: Float[Array, "*end 3"],
    tip: Float[Array, "*end 3"],
    axis: Float[Array, "*end 3"],
    offset: Float[Array, "*end"] | None,
    slope: Float[Array, "*end"],
) -> Float[Array, "*end"]:
    """Shift of the ends of chords along their rays [m], -level / slope.

    It is zero, as an end lies on the surface: only its derivative counts.

    Args:
        cutter: The cutter.
        place: End of a chord in `work` [m], shape (..., 3).
        tip: Tool tip [m], shape (..., 3).
        axis: Unit tool axis, shape (..., 3).
        offset: Radial offset of the edge [m], shape (...).
        slope: Slope of the level along the rays [-], shape (...); infinite where the
            end does not move.
    """
    return -cutter.level(place, tip, axis, offset) / slope


def _bounded_height(
    x: Float[Array, "..."], corner_radius: Float[Array, ""]
) -> Float[Array, "..."]:
    """Height of a corner, its slope bounded as that of the ends of chords [m].

    Args:
        x: Distance outward from the center of the corner [m], any shape.
        corner_radius: [m], shape ().
    """
    least = jax.lax.stop_gradient(_LEAST_SLOPE * corner_radius)
    square = corner_radius**2 - x**2
    is_steep = square < least**2
    root = jnp.sqrt(jnp.where(is_steep, 1, square))
    return corner_radius - jnp.where(is_steep, square / (2 * least), root)


class _SizedEndMill(EndMill):
    """An end mill of which the nominal sizes are leaves; else as `EndMill`."""

    flute_length: float
    nominal_radius: float
    nominal_corner_radius: float
