"""The bottom edge of a flat cutter that stands along +z and descends.

Its end is ground hollow: from the corner it rises by the dish angle delta toward the
center, an annulus at the radius r by (R - r) tan(delta). So the corner goes first. What
an annulus finds ahead is what the tooth before left there, at the radius r' from where
the tool was then, a descent d higher:

    h = d + (r - r') tan(delta),

less on the leading side, more on the trailing one, as far as the earlier end covered
it: what lies beyond is the side's. And it finds no more than stands there: behind the
corner of a level cut nothing, in a ramp what the tool has descended by since its corner
passed. The material above the end is looked up column by column.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw, edge_contact, held_at_rest, safe_norm, way_of
from ...numerics import clamp, tied
from ...workpiece import PoseTrack, Stock
from .._discretisation import ProcessPlan, Substeps, turning

# Chip over way at which half of an annulus rubs.
RAMP = 5e-3
# Thinner layers count as this thick [m].
_LEAST_LAYER = 1e-7
# Shorter ways count as this long [m].
_STILL = 1e-8


class BottomEngagement(eqx.Module):
    """Engagement of the bottom edges in one tooth period.

    Attributes:
        angle: Immersion angle of the samples [rad], shape (substep, angle, tooth).
        tooth: The tooth of each sample, same shape.
        occupancy: 0 to 1, shape (substep, angle, tooth, annulus).
    """

    angle: Float[Array, "*substep angle tooth"]
    tooth: Int[Array, "*substep angle tooth"]
    occupancy: Float[Array, "*substep angle tooth annulus"]


def bottom_engagement(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    stock: Stock,
    index: Int[Array, ""],
    predicted: Float[Array, "substep 3"],
    before: Float[Array, "substep 3"],
    track: PoseTrack | None,
    part: Substeps | None = None,
) -> BottomEngagement:
    """Return where material stands on the bottom edges.

    What counts is the chip: the stock still holds more, since removal lags behind.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        stock: The workpiece after the removal of this period.
        index: Index of the period, from 1, shape ().
        predicted: Tips in the middle of the sub-steps [m], shape (substep, 3).
        before: Those of the tooth before [m], same shape.
        track: All poses so far, to which the derivative goes; None differentiates
            through the stock.
        part: The sub-steps, if these are not all of the period.

    Returns:
        The engagement.

    Differentiability: continuous; kinks where an annulus crosses a grid line.
    """
    pitch = 2 * math.pi / cutter.flute_count
    place = pitch * jnp.arange(cutter.flute_count, dtype=predicted.dtype)
    turn = turning(plan, cutter, predicted.dtype, part)
    angles = turn[..., None] + place[None, None]
    angle = angles[..., None]
    radius = _radii(plan, cutter, predicted.dtype)[None, None, None]
    tip, old = (x[:, None, None, None] for x in (predicted, before))
    chip, _ = _chip(cutter, radius, angle, tip, old)
    layer = jnp.maximum(chip, _LEAST_LAYER)
    at = [
        (tip[..., 0] + jnp.sin(angle) * radius - stock.origin[0]) / stock.spacing,
        (tip[..., 1] + jnp.cos(angle) * radius - stock.origin[1]) / stock.spacing,
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
        clamp(0.0, v - c.astype(v.dtype), 1.0) for v, c in zip(at, cell, strict=True)
    ]
    dish = jnp.tan(jnp.asarray(cutter.dish_angle, predicted.dtype))
    hollow = (cutter.nominal_radius - radius) * dish
    # How much higher the end is at the middle of an annulus than at its outer side.
    rise = cutter.nominal_radius / plan.bottom * dish / 2
    back, descent = _since_corner(cutter, radius, angle, tip - old)
    total = jnp.zeros_like(share[0])
    for i in (0, 1):
        for j in (0, 1):
            ends = rays.ends[cell[0] + i, cell[1] + j]
            if track is not None:
                poses = rays.poses[cell[0] + i, cell[1] + j]
                tie = jnp.where(poses >= 0, track.height_by(poses), 0)
                ends = tied(jax.lax.stop_gradient(ends), tie)
            low, high = ends[..., 0, :], ends[..., 1, :]
            # Material that begins above the bottom is not on it.
            is_on = (high > low) & (low < tip[..., 2:] + plan.discs.band)
            above = jnp.where(is_on, high - tip[..., 2:], 0).max(axis=-1)
            # What the corner has passed less than the lag ago still stands.
            above = jnp.where(back < plan.lag, jnp.minimum(above, descent), above)
            weight = (share[0] if i else 1 - share[0]) * (
                share[1] if j else 1 - share[1]
            )
            total = total + weight * _covered((above - hollow) / layer, rise / layer)
    tooth = jnp.arange(cutter.flute_count, dtype=jnp.int32) - (index - 1)
    tooth = jnp.mod(tooth, cutter.flute_count)[None, None]
    tooth = jnp.broadcast_to(tooth, angles.shape)
    return BottomEngagement(angles, tooth, total)


def bottom_force(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    cut: BottomEngagement,
) -> Float[Array, "angle 3"]:
    """Return the force of the bottom edges at the angles of one sub-step.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        law: The force law of the bottom edges; F_r pushes along the axis.
        tip: Tip in the middle of the sub-step [m], shape (3,).
        earlier: Tips at the same sub-step of earlier periods, newest first [m],
            shape (tooth, 3).
        cut: The engagement of this sub-step, without its axis.

    Returns:
        Force on the tool in `work` [N], shape (angle, 3).

    Differentiability: kinks where the deciding earlier pose changes.
    """
    angle, weight = cut.angle[..., None], cut.occupancy
    radius = _radii(plan, cutter, tip.dtype)
    width = cutter.nominal_radius / plan.bottom
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    nothing = 2 * cutter.nominal_radius
    chip = jnp.full(weight.shape, nothing, tip.dtype)
    is_first = jnp.zeros(weight.shape, bool)
    for k in range(earlier.shape[0]):
        left, is_under = _chip(cutter, radius[None, None], angle, tip, earlier[k])
        is_first = is_under if k == 0 else is_first
        chip = jnp.where(is_under, jnp.minimum(chip, left), chip)
    feed = safe_norm(earlier[0] - tip)
    chip = jnp.where(is_first, chip, 0)
    touch = edge_contact(chip / way_of(earlier[0] - tip) - RAMP, feed, RAMP)
    touch = held_at_rest(touch, feed)
    h = clamp(0.0, chip, cutter.nominal_radius)
    teeth = jnp.broadcast_to(cut.tooth[..., None], h.shape)
    F_t, F_r, F_a = law.force_per_width(h, touch, teeth)
    share = weight * width
    return jnp.stack(
        [
            jnp.sum(share * (-F_t * cos + F_a * sin), axis=(1, 2)),
            jnp.sum(share * (F_t * sin + F_a * cos), axis=(1, 2)),
            jnp.sum(share * F_r, axis=(1, 2)),
        ],
        axis=-1,
    )


def _chip(
    cutter: AbstractCutter,
    radius: Float[Array, "*#place annulus"],
    angle: Float[Array, "*#place 1"],
    tip: Float[Array, "*#tip 3"],
    old: Float[Array, "*#tip 3"],
) -> tuple[Float[Array, "*place annulus"], Bool[Array, "*place annulus"]]:
    """Return how far an earlier end was above annuli [m], and where it covered them."""
    moved = tip - old
    across = (radius * jnp.sin(angle) + moved[..., 0]) ** 2
    across = across + (radius * jnp.cos(angle) + moved[..., 1]) ** 2
    dish = jnp.tan(jnp.asarray(cutter.dish_angle, radius.dtype))
    inward = radius - jnp.sqrt(across + _LEAST_LAYER**2)
    return inward * dish - moved[..., 2], across < cutter.nominal_radius**2


def _since_corner(
    cutter: AbstractCutter,
    radius: Float[Array, "*#place annulus"],
    angle: Float[Array, "*#place 1"],
    moved: Float[Array, "*#tip 3"],
) -> tuple[Float[Array, "*place annulus"], Float[Array, "*place annulus"]]:
    """Return the way since the corner passed over annuli [m], and its descent [m]."""
    x, y, z = (moved[..., i] for i in range(3))
    way = jnp.sqrt(x**2 + y**2 + _STILL**2)
    ahead = (jnp.sin(angle) * x + jnp.cos(angle) * y) / way
    chord = cutter.nominal_radius**2 - radius**2 * (1 - ahead**2)
    back = jnp.sqrt(jnp.maximum(chord, _STILL**2)) - radius * ahead
    return back, -z * back / way


def _covered(
    height: Float[Array, "*place"], rise: Float[Array, "*place"]
) -> Float[Array, "*place"]:
    """Return which share of an annulus material covers.

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


def _radii(
    plan: ProcessPlan, cutter: AbstractCutter, dtype: jnp.dtype
) -> Float[Array, " annulus"]:
    middles = (jnp.arange(plan.bottom, dtype=dtype) + 0.5) / plan.bottom
    return cutter.nominal_radius * middles
