"""A flat cutter that stands along +z: discs, circles, columns and walls.

The common case, and the fastest: all discs of a tooth share the point on the rim that
is looked up, and the chip of a disc is that of two circles.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...cutter import AbstractCutter
from ...cutting import (
    AbstractForceLaw,
    circle_chip,
    edge_contact,
    held_at_rest,
    layer_share,
    safe_norm,
    way_of,
)
from ...numerics import hold
from ...workpiece import occupancy
from .._discretisation import ProcessPlan, Substeps, turning
from .._removal_history import ProcessState
from .._stock_derivatives import AbstractAdjoint
from .edge_samples import EdgeSamples
from .leading_half import (
    STILL,
    chip_taken_over,
    has_opposite_teeth,
    leading_fade,
    taken_over,
)


def upright_engagement(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    predicted: Float[Array, "substep 3"],
    adjoint: AbstractAdjoint,
    part: Substeps | None = None,
) -> EdgeSamples:
    """Return where the teeth of a period are, and what of their chips is in stock.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        state: State after the removal of this period.
        index: Index of the period, from 1, shape ().
        predicted: Tips in the middle of the sub-steps [m], shape (substep, 3).
        adjoint: How the run is differentiated.
        part: The sub-steps, if these are not all of the period.

    Returns:
        The samples.
    """
    angle, place, fade = _leading_angles(plan, cutter, state, predicted, part)
    # Every period begins with another tooth in the same place.
    tooth = jnp.mod(place - (index - 1), cutter.flute_count)
    radius = cutter.diameter / 2
    sin, cos = jnp.sin(angle) * radius, jnp.cos(angle) * radius
    rim = jnp.stack([sin, cos, jnp.zeros_like(angle)], -1)
    points = (predicted[:, None, None, None] + rim).reshape(-1, angle.shape[3], 3)
    step = 2 * math.pi / plan.angles
    moves = (step * jnp.stack([cos, -sin], -1)).reshape(-1, angle.shape[3], 2)
    newest = state.recent.tip[0] - predicted
    chip = jax.vmap(lambda offset, phi: circle_chip(radius, offset, phi, 0.0))(
        newest, angle
    )
    chips = -jnp.clip(chip, 0, radius)[..., None] / radius * rim[..., :2]
    chips = chips.reshape(moves.shape)
    track = adjoint.tied_to(state.track)
    found = occupancy(
        state.stock, points, moves, chips, plan.discs, cutter, track, state.slots
    )
    shape = (*angle.shape[:3], plan.discs.count)
    occupied, chip_share = (share.reshape(shape) for share in found)
    return EdgeSamples(angle, tooth, fade * occupied, chip_share)


def upright_wrench(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    thinned: Float[Array, "circle 3"],
    samples: EdgeSamples,
) -> Float[Array, "angle 6"]:
    """Return force and moment on the tool at the angles of one sub-step.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        law: The force law.
        tip: Tip in the middle of the sub-step [m], shape (3,).
        earlier: Tips at the same sub-step of earlier periods, newest first [m],
            shape (tooth, 3).
        thinned: Older tips [m], shape (circle, 3).
        samples: The samples of the sub-step, shape (angle, kept, element).

    Returns:
        Force on the tool in `work` [N] and its moment about the tip [N m], shape
        (angle, 6); their mean is that of the sub-step. The moment is that of levers
        along the axis: what turns the tool about it is the spindle's.

    Differentiability: kinks where the deciding earlier circle changes and where a
    chip ends; the edge force changes smoothly there.
    """
    angle = samples.angle
    chip, per_way = upright_chip(plan, cutter, tip, earlier, thinned, angle)
    feed = safe_norm(earlier[0] - tip)
    step = 2 * math.pi / plan.angles
    touch = held_at_rest(edge_contact(per_way, feed, step), feed)
    if has_opposite_teeth(plan, cutter):
        lead = _lead((tip - earlier[0])[None, None, None, :2], angle)
        before = feed / cutter.diameter
        touch = touch * held_at_rest(taken_over(lead, step, before), feed)
        chip = chip * held_at_rest(chip_taken_over(lead, step, before), feed)
    chip, touch = hold((chip, touch))
    h = jnp.clip(chip, 0, cutter.diameter / 2) * samples.chip_share
    teeth = jnp.broadcast_to(samples.tooth, h.shape)
    touch = jnp.broadcast_to(touch, h.shape)
    F_t, F_r, F_a = law.force_per_width(h, touch, teeth)
    lower = plan.discs.centers(tip.dtype) - plan.discs.height / 2
    # The shank above the flutes has no edge.
    width = jnp.clip(cutter.flute_length - lower, 0, plan.discs.height)
    share = samples.occupancy * width[None, None]
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    parts = hold((share * F_t, share * F_r, share * F_a, sin, cos))
    F_t, F_r, F_a, sin, cos = parts
    F_x, F_y = hold((-F_t * cos - F_r * sin, F_t * sin - F_r * cos))
    lever = plan.discs.centers(tip.dtype)[None, None]
    along = [
        jnp.sum(component, axis=(1, 2))
        for component in (F_x, F_y, F_a, -lever * F_y, lever * F_x)
    ]
    along.append(jnp.zeros_like(along[0]))
    return jnp.stack(hold(along), axis=-1)


def upright_chip(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    thinned: Float[Array, "circle 3"],
    angle: Float[Array, "angle kept disc"],
) -> tuple[Float[Array, "angle kept element"], Float[Array, "angle kept element"]]:
    """Return the unclipped chip thickness [m], and over the way of who left it [-]."""
    R = cutter.diameter / 2
    lower = plan.discs.centers(tip.dtype) - plan.discs.height / 2
    newest = earlier[0] - tip
    # The tooth just before cut every layer that this one cuts with its side.
    chip = circle_chip(R, newest, angle, 0.0)
    per_way = chip / way_of(newest)
    nothing = 2 * cutter.nominal_radius
    for old in [*earlier[1:], *thinned]:
        offset = old - tip
        share = layer_share(offset[2], lower, plan.discs.height)[None, None]
        left = circle_chip(R, offset, angle, nothing)
        # The mean over the disc: what lies below an older pose it did not thin.
        chip = chip - share * jnp.maximum(chip - left, 0)
        per_way = per_way - share * jnp.maximum(per_way - left / way_of(offset), 0)
    return chip, per_way


def immersion_angles(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    dtype: jnp.dtype,
    part: Substeps | None = None,
) -> Float[Array, "substep angle kept disc"]:
    """Return the immersion angle of every tooth at every sample of a period [rad].

    Every period begins with a tooth at angle 0 at the tip; a disc higher up lags by
    2 z tan(helix) / D.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        dtype: Floating type.
        part: The sub-steps, if these are not all of the period.

    Returns:
        Angles, shape (substep, angle, tooth, disc); the axis disc has length 1 if the
        flutes are straight.
    """
    pitch = 2 * math.pi / cutter.flute_count
    turn = turning(plan, cutter, dtype, part)[..., None, None]
    tooth = pitch * jnp.arange(cutter.flute_count, dtype=dtype)[None, None, :, None]
    if not cutter.has_helix:
        return turn + tooth
    height = plan.discs.centers(dtype)
    lag = 2 * height * jnp.tan(jnp.asarray(cutter.helix_angle, dtype)) / cutter.diameter
    return turn + tooth - lag[None, None, None]


def _leading_angles(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    predicted: Float[Array, "substep 3"],
    part: Substeps | None,
) -> tuple[
    Float[Array, "substep angle kept disc"],
    Int[Array, "substep angle kept disc"],
    Float[Array, "substep angle kept disc"],
]:
    """Return the angles of the teeth on the leading side, their places and weights."""
    angle = immersion_angles(plan, cutter, predicted.dtype, part)
    kept = (cutter.flute_count + 1) // 2
    if kept == cutter.flute_count:
        return angle, jnp.zeros(angle.shape, jnp.int32), jnp.ones_like(angle)
    motion = (predicted - state.recent.tip[0])[:, None, None, None, :2]
    lead = _lead(motion, angle)
    order = jnp.argsort(jax.lax.stop_gradient(lead), axis=2, descending=True)
    angle, lead = (jnp.take_along_axis(x, order[:, :, :kept], 2) for x in (angle, lead))
    fade = jnp.ones_like(lead)
    if has_opposite_teeth(plan, cutter):
        fade = leading_fade(lead, 2 * math.pi / plan.angles)
        fade = held_at_rest(fade, safe_norm(motion))
    return angle, order[:, :, :kept].astype(jnp.int32), fade


def _lead(
    motion: Float[Array, "*#sample 2"], angle: Float[Array, "*sample"]
) -> Float[Array, "*sample"]:
    """Return the sine of the angle by which a tooth has entered the leading half."""
    motion = motion / jnp.sqrt(jnp.sum(motion**2, -1, keepdims=True) + STILL**2)
    return jnp.sin(angle) * motion[..., 0] + jnp.cos(angle) * motion[..., 1]
