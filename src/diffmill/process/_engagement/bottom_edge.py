"""The bottom edge of a flat cutter that is upright and descends.

Its end is ground hollow: from the corner it rises by the dish angle delta toward the
center, an annulus at the radius r by (R - r) tan(delta). So the corner goes first. What
an annulus finds ahead is what the tooth before left there, at the radius r' from where
the tool was then, a descent d higher:

    h = d + (r - r') tan(delta),

less on the leading side, more on the trailing one, as far as the earlier end covered
it: what lies beyond is the side's. The way and the descent d are those since the tooth
before met the annulus, as teeth go on trochoids. And it finds no more than stands
there: behind the corner of a level cut nothing, in a ramp what the tool has descended
by since its corner passed. The material above the end is looked up column by column.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import Rematerialised, clamp, with_derivative_of
from ...workpiece import Pose, PoseTrack, Rays
from .._chip import (
    RadialDirection,
    displacement_norm,
    edge_contact,
    freeze_derivative_at_standstill,
    safe_norm,
    travel_share,
)
from .._process import Process, Substeps, rotation_angles
from .._state import ProcessState
from .edge_samples import BottomSamples

# Chip over way at which half of an annulus rubs.
RAMP = 5e-3
# Thinner layers count as this thick [m].
_LEAST_LAYER = 1e-7
# Shorter ways count as this long [m].
_STILL = 1e-8


class BottomEdges(eqx.Module):
    """Bottom edges of a flat cutter that is upright and descends.

    Attributes:
        annuli: Annuli into which the end is cut.
    """

    annuli: int = eqx.field(static=True)

    def engage(
        self,
        process: Process,
        state: ProcessState,
        index: Int[Array, ""],
        predicted: Pose,
        part: Substeps | None = None,
    ) -> BottomSamples:
        """Engagement of the bottom edges.

        What counts is the chip: the stock still holds more, since removal lags behind.
        Arguments as of `AbstractEngagement.engage`.

        Differentiability: continuous; kinks where an annulus crosses a grid line.
        """
        cutter, engagement, stock = process.cutter, process.engagement, state.stock
        # The tips of the tooth before.
        before, now = state.recent.tip[0], predicted.tip
        # Where derivatives go; none goes through the stock.
        track = process.derivative.with_pose_derivatives(state.track, process.stock)
        pitch = 2 * math.pi / cutter.flute_count
        place = pitch * jnp.arange(cutter.flute_count, dtype=now.dtype)
        turn = rotation_angles(process, now.dtype, part)
        angles = turn[..., None] + place[None, None]
        outward = RadialDirection.of(angles)
        e = _by_annulus(outward)
        radius = self._radii(cutter, now.dtype)[None, None, None]
        tip, old = (x[:, None, None, None] for x in (now, before))
        chip, _ = _earlier_end(cutter, radius, e, tip, old, pitch)
        layer = jnp.maximum(chip, _LEAST_LAYER)
        at = [
            (tip[..., 0] + e.sin * radius - stock.origin[0]) / stock.spacing,
            (tip[..., 1] + e.cos * radius - stock.origin[1]) / stock.spacing,
        ]
        rays = stock.families[2]
        cell = [
            jnp.clip(
                jnp.floor(jax.lax.stop_gradient(v)).astype(jnp.int32),
                0,
                rays.ends.shape[a] - 2,
            )
            for a, v in enumerate(at)
        ]
        share = [
            clamp(0.0, v - c.astype(v.dtype), 1.0)
            for v, c in zip(at, cell, strict=True)
        ]
        dish = jnp.tan(jnp.asarray(cutter.dish_angle, now.dtype))
        R = _radius(cutter, now.dtype)
        hollow = (R - radius) * dish
        # How much higher the end is at the middle of an annulus than at its outer side.
        rise = R / self.annuli * dish / 2
        back, descent = _since_corner(cutter, radius, e, tip - old)
        total = jnp.zeros_like(share[0])
        for i in (0, 1):
            for j in (0, 1):
                u, v = cell[0] + i, cell[1] + j
                top = tip[..., 2] + engagement.discs.band
                at, is_on = _highest_below(rays, u, v, jax.lax.stop_gradient(top))
                end, poses = rays.ends_at(at)
                if track is not None:
                    poses = Rematerialised.read(poses)
                    x, y = (
                        stock.origin[a] + stock.spacing * line.astype(now.dtype)
                        for a, line in enumerate((u, v))
                    )
                    frozen = jax.lax.stop_gradient(end)
                    end = with_derivative_of(
                        frozen, _ends_from_poses, track, cutter, at, poses, x, y
                    )
                end = Rematerialised.read(end)
                # Where there is none, the whole end is clear of it.
                above = jnp.where(is_on, end - tip[..., 2], -cutter.nominal_radius)
                # What the corner has passed less than the lag ago still stands.
                above = jnp.where(
                    back < engagement.removal_lag, jnp.minimum(above, descent), above
                )
                weight = (share[0] if i else 1 - share[0]) * (
                    share[1] if j else 1 - share[1]
                )
                total = total + weight * _covered(
                    (above - hollow) / layer, rise / layer
                )
        tooth = jnp.arange(cutter.flute_count, dtype=jnp.int32) - (index - 1)
        tooth = jnp.mod(tooth, cutter.flute_count)[None, None]
        tooth = jnp.broadcast_to(tooth, angles.shape)
        return BottomSamples(outward, tooth, total)

    def wrench(
        self, process: Process, samples: BottomSamples, pose: Pose, earlier: Pose
    ) -> Float[Array, "angle 7"]:
        """Return the loads of the bottom edges at the angles of one sub-step.

        F_r of the law of the bottom pushes along the axis.

        Args:
            process: The process.
            samples: Those of this sub-step, without its axis.
            pose: Pose in the middle of the sub-step, shape (3,).
            earlier: Poses when the teeth before passed, newest first, shape
                (before, 3).

        Returns:
            As `AbstractEngagement.wrench`; their force has no lever along the axis.

        Differentiability: kinks where the deciding earlier pose changes.
        """
        cutter, tip, old = process.cutter, pose.tip, earlier.tip
        e, weight = _by_annulus(samples.outward), samples.occupancy
        radius = self._radii(cutter, tip.dtype)
        width = _radius(cutter, tip.dtype) / self.annuli
        nothing = 2 * cutter.nominal_radius
        chip = jnp.full(weight.shape, nothing, tip.dtype)
        is_first = jnp.zeros(weight.shape, bool)
        pitch = 2 * math.pi / cutter.flute_count
        for k in range(old.shape[0]):
            left, is_under = _earlier_end(
                cutter, radius[None, None], e, tip, old[k], (k + 1) * pitch
            )
            is_first = is_under if k == 0 else is_first
            chip = jnp.where(is_under, jnp.minimum(chip, left), chip)
        feed = safe_norm(old[0] - tip)
        chip = jnp.where(is_first, chip, 0)
        touch = edge_contact(chip / displacement_norm(old[0] - tip) - RAMP, feed, RAMP)
        touch = freeze_derivative_at_standstill(touch, feed)
        h = clamp(0.0, chip, cutter.nominal_radius)
        teeth = jnp.broadcast_to(samples.tooth[..., None], h.shape)
        F_t, F_r, F_a = process.bottom_law.force_per_width(h, touch, teeth)
        share = weight * width
        none = jnp.zeros(weight.shape[0], tip.dtype)
        return jnp.stack(
            [
                jnp.sum(share * (-F_t * e.cos + F_a * e.sin), axis=(1, 2)),
                jnp.sum(share * (F_t * e.sin + F_a * e.cos), axis=(1, 2)),
                jnp.sum(share * F_r, axis=(1, 2)),
                *3 * [none],
                jnp.sum(share * radius[None, None] * F_t, axis=(1, 2)),
            ],
            axis=-1,
        )

    def _radii(
        self, cutter: AbstractCutter, dtype: jnp.dtype
    ) -> Float[Array, " annulus"]:
        middles = (jnp.arange(self.annuli, dtype=dtype) + 0.5) / self.annuli
        return _radius(cutter, dtype) * middles


def _radius(cutter: AbstractCutter, dtype: jnp.dtype) -> Float[Array, ""]:
    """Return the radius of the end [m], which follows the diameter, shape ()."""
    return jnp.asarray(cutter.diameter, dtype) / 2


def _highest_below(
    rays: Rays,
    u: Int[Array, "*place"],
    v: Int[Array, "*place"],
    top: Float[Array, "*#place"],
) -> tuple[Int[Array, "*place"], Bool[Array, "*place"]]:
    """Highest upper ends of columns, of material that begins below a height.

    Returns:
        Where they stand in memory, and whether there are any, of shape (...).
    """
    ends = jax.lax.stop_gradient(rays.ends[u, v])
    low, high = ends[..., 0, :], ends[..., 1, :]
    is_on = (high > low) & (low < top[..., None])
    slot = jnp.argmax(jnp.where(is_on, high, -jnp.inf), axis=-1, keepdims=True)
    upper = rays.places(u, v)[..., 1, :]
    return (
        Rematerialised.read(jnp.take_along_axis(upper, slot, axis=-1)[..., 0]),
        Rematerialised.read(jnp.any(is_on, axis=-1)),
    )


def _ends_from_poses(
    track: PoseTrack,
    cutter: AbstractCutter,
    at: Int[Array, "*place"],
    poses: Int[Array, "*place"],
    x: Float[Array, "*place"],
    y: Float[Array, "*place"],
) -> Float[Array, "*place"]:
    """Return ends of columns that follow from their poses: the cutter's end there."""
    height = track.floor_by(poses, cutter, x, y)
    return jnp.where(poses >= 0, height, track.raw_ends(2, at, poses))


def _by_annulus(outward: RadialDirection) -> RadialDirection:
    """Return directions with an axis for the annuli, of length 1."""
    return jax.tree.map(lambda x: x[..., None], outward)


def _earlier_end(
    cutter: AbstractCutter,
    radius: Float[Array, "*#place annulus"],
    outward: RadialDirection,
    tip: Float[Array, "*#tip 3"],
    old: Float[Array, "*#tip 3"],
    turn: float,
) -> tuple[Float[Array, "*place annulus"], Bool[Array, "*place annulus"]]:
    """Height of an earlier end above annuli [m], and the parts that it covered.

    That of the tooth that was at the same angle `turn` ago [rad], when it met them.
    """
    x, y, z = jnp.moveaxis(tip - old, -1, 0)
    # The offset of the earlier axis points the other way.
    sideways = (outward.sin * y - outward.cos * x) / radius
    share = travel_share(sideways, 1 / turn)
    across = (radius * outward.sin + x * share) ** 2
    across = across + (radius * outward.cos + y * share) ** 2
    dish = jnp.tan(jnp.asarray(cutter.dish_angle, radius.dtype))
    inward = radius - jnp.sqrt(across + _LEAST_LAYER**2)
    is_under = across < _radius(cutter, radius.dtype) ** 2
    return inward * dish - z * share, is_under


def _since_corner(
    cutter: AbstractCutter,
    radius: Float[Array, "*#place annulus"],
    outward: RadialDirection,
    moved: Float[Array, "*#tip 3"],
) -> tuple[Float[Array, "*place annulus"], Float[Array, "*place annulus"]]:
    """Return the way since the corner passed over annuli [m], and its descent [m]."""
    x, y, z = (moved[..., i] for i in range(3))
    way = jnp.sqrt(x**2 + y**2 + _STILL**2)
    ahead = (outward.sin * x + outward.cos * y) / way
    chord = _radius(cutter, radius.dtype) ** 2 - radius**2 * (1 - ahead**2)
    back = jnp.sqrt(jnp.maximum(chord, _STILL**2)) - radius * ahead
    return back, -z * back / way


def _covered(
    height: Float[Array, "*place"], rise: Float[Array, "*place"]
) -> Float[Array, "*place"]:
    """Share of an annulus that material covers.

    Args:
        height: Of the material above the middle of the annulus, in chips, any shape.
        rise: Of the annulus from its outer side to its middle, in chips, same shape.

    Returns:
        The mean over the annulus of the height between 0 and 1, same shape.
    """
    rise = jnp.maximum(rise, 1e-3)
    height = clamp(-rise, height, 1 + rise)
    up, down = (_clipped_integral(height + x) for x in (rise, -rise))
    return (up - down) / (2 * rise)


def _clipped_integral(x: Float[Array, "*place"]) -> Float[Array, "*place"]:
    """Return the integral from 0 of what is between 0 and 1."""
    c = clamp(0.0, x, 1.0)
    return c**2 / 2 + jnp.maximum(x - 1, 0)
