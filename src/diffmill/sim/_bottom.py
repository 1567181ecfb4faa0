"""The bottom edge of a flat cutter that stands along +z and descends.

An annulus of the bottom removes what the tool descended by since the tooth before, as
far as the earlier end covered it: what lies beyond is the side's. The material above
it is looked up column by column. A tool that does not descend does not rub.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw, edge_contact, safe_norm, way_of
from ..numerics import clamp
from ..workpiece import Stock
from ._plan import ProcessPlan, turning

# Slope of descent at which half of the bottom edge rubs.
RAMP = 5e-3
# Thinner layers count as this thick [m].
_LEAST_LAYER = 1e-7


class BottomEngagement(eqx.Module):
    """Where the bottom edges of one tooth period meet material.

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
) -> BottomEngagement:
    """Return where material stands on the bottom edges.

    What counts is the layer that the tool has descended by: the stock still holds more
    above, since removal lags behind.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        stock: The workpiece after the removal of this period.
        index: Index of the period, from 1, shape ().
        predicted: Tips in the middle of the sub-steps [m], shape (substep, 3).
        before: Those of the tooth before [m], same shape.

    Returns:
        The engagement.

    Differentiability: none: a constant.
    """
    pitch = 2 * math.pi / cutter.flute_count
    place = pitch * jnp.arange(cutter.flute_count, dtype=predicted.dtype)
    turn = turning(plan, cutter, predicted.dtype)
    angles = turn[..., None] + place[None, None]
    angle = angles[..., None]
    radius = _radii(plan, cutter, predicted.dtype)[None, None, None]
    tip = jax.lax.stop_gradient(predicted)[:, None, None, None]
    layer = jax.lax.stop_gradient(before - predicted)[:, None, None, None, 2]
    layer = jnp.maximum(layer, _LEAST_LAYER)
    at = [
        (tip[..., 0] + jnp.sin(angle) * radius - stock.origin[0]) / stock.spacing,
        (tip[..., 1] + jnp.cos(angle) * radius - stock.origin[1]) / stock.spacing,
    ]
    rays = stock.families[2].ends
    cell = [
        jnp.clip(jnp.floor(v).astype(jnp.int32), 0, rays.shape[a] - 2)
        for a, v in enumerate(at)
    ]
    share = [
        jnp.clip(v - c.astype(v.dtype), 0, 1) for v, c in zip(at, cell, strict=True)
    ]
    total = jnp.zeros_like(share[0])
    for i in (0, 1):
        for j in (0, 1):
            near = jax.lax.stop_gradient(rays[cell[0] + i, cell[1] + j])
            low, high = near[..., 0, :], near[..., 1, :]
            # Material that begins above the bottom is not on it.
            is_on = (high > low) & (low < tip[..., 2:] + plan.discs.band)
            above = jnp.where(is_on, high - tip[..., 2:], 0).max(axis=-1)
            weight = (share[0] if i else 1 - share[0]) * (
                share[1] if j else 1 - share[1]
            )
            total = total + weight * jnp.clip(above / layer, 0, 1)
    tooth = jnp.arange(cutter.flute_count, dtype=jnp.int32) - (index - 1)
    tooth = jnp.mod(tooth, cutter.flute_count)[None, None]
    tooth = jnp.broadcast_to(tooth, angles.shape)
    return BottomEngagement(angles, tooth, jax.lax.stop_gradient(total))


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

    Differentiability: in the poses through the descent, and in the law.
    """
    angle, weight = cut.angle[..., None], cut.occupancy
    radius = _radii(plan, cutter, tip.dtype)
    width = cutter.nominal_radius / plan.bottom
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    nothing = 2 * cutter.nominal_radius
    chip = jnp.full(weight.shape, nothing, tip.dtype)
    is_first = jnp.zeros(weight.shape, bool)
    for k in range(earlier.shape[0]):
        away = jax.lax.stop_gradient(tip - earlier[k])
        across = (radius[None, None] * sin + away[0]) ** 2
        across = across + (radius[None, None] * cos + away[1]) ** 2
        is_under = across < cutter.nominal_radius**2
        is_first = is_under if k == 0 else is_first
        chip = jnp.where(is_under, jnp.minimum(chip, earlier[k, 2] - tip[2]), chip)
    feed = safe_norm(earlier[0] - tip)
    chip = jnp.where(is_first, chip, 0)
    touch = edge_contact(chip / way_of(earlier[0] - tip) - RAMP, feed, RAMP)
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


def _radii(
    plan: ProcessPlan, cutter: AbstractCutter, dtype: jnp.dtype
) -> Float[Array, " annulus"]:
    middles = (jnp.arange(plan.bottom, dtype=dtype) + 0.5) / plan.bottom
    return cutter.nominal_radius * middles
