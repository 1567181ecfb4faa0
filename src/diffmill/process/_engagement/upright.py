"""A flat cutter that is upright, along +z: discs, circles, columns and walls.

The common case, and the fastest: all discs of a tooth share the point on the rim that
is looked up, and the chip of a disc is that of two circles.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...cutter import AbstractCutter
from ...numerics import materialise
from ...workpiece import Discs, Pose, RemovalWindow
from .._chip import (
    RadialDirection,
    UnclippedChip,
    chip_along,
    chip_growth,
    displacement_norm,
    edge_contact,
    freeze_derivative_at_standstill,
    layer_share,
    rounded_corner,
    safe_norm,
    sideways_share,
)
from .._process import AbstractEngagement, Process, Substeps, rotation_angles
from .._state import ProcessState, RemovedVolume
from .bottom_edge import BottomEdges
from .edge_samples import EdgeSamples, Engagement
from .leading_half import (
    STILL,
    LeadingSamples,
    LeadingTeeth,
    half_turn_chip_weight,
    half_turn_contact_weight,
    leading_fade,
)


class UprightFlat(AbstractEngagement):
    """A flat cutter with even teeth that is upright, along +z.

    Attributes as of `AbstractEngagement`, and:
        bottom: The bottom edges, None where they do not cut.
    """

    angles: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    discs: Discs
    window: RemovalWindow
    removal_lag: float
    updates_per_period: int = eqx.field(static=True, default=1)
    bottom: BottomEdges | None = None
    is_upright: bool = eqx.field(static=True, default=True, init=False)
    samples_whole_period: bool = eqx.field(static=True, default=False, init=False)

    def __check_init__(self):
        """Refuse updates that do not divide a period."""
        check_updates(self)

    def remove(
        self, process: Process, state: ProcessState, index: Int[Array, ""], pose: Pose
    ) -> tuple[ProcessState, RemovedVolume]:
        """Enter the pose in the history, and remove what lies behind the lag."""
        return process.removal.advance(state, index, pose)

    def engage(
        self,
        process: Process,
        state: ProcessState,
        index: Int[Array, ""],
        predicted: Pose,
        part: Substeps | None = None,
    ) -> Engagement:
        """Engagement of the teeth: places, and shares of their chips in stock."""
        cutter, tips = process.cutter, predicted.tip
        angle, outward, place, fade = _leading_samples(process, state, tips, part)
        # Every period begins with another tooth in the same place.
        tooth = jnp.mod(place - (index - 1), cutter.flute_count)
        radius = cutter.diameter / 2
        sin, cos = outward.sin * radius, outward.cos * radius
        rim = jnp.stack([sin, cos, jnp.zeros_like(angle)], -1)
        step = 2 * math.pi / self.angles
        # A sample stands for the arc to its neighbours, whose mean lies inward.
        mean = (1 - step**2 / 12) * rim
        points = (tips[:, None, None, None] + mean).reshape(-1, angle.shape[3], 3)
        moves = (step * jnp.stack([cos, -sin], -1)).reshape(-1, angle.shape[3], 2)
        newest = state.recent.tip[0] - tips
        x, y = (-newest[:, None, None, None, a] for a in (0, 1))
        growth = chip_growth(
            x * outward.sin + y * outward.cos,
            x * outward.cos - y * outward.sin,
            self.angles,
        )
        growth = freeze_derivative_at_standstill(
            growth, safe_norm(newest)[:, None, None, None]
        )
        chip = jax.vmap(lambda offset, e: chip_along(radius, offset, e, 0.0))(
            newest, outward
        )
        chips = -jnp.clip(chip, 0, radius)[..., None] / radius * rim[..., :2]
        chips = chips.reshape(moves.shape)
        track = process.derivative.with_pose_derivatives(state.track, process.stock)
        found = self.discs.occupancy(
            state.stock,
            points,
            moves,
            chips,
            cutter,
            growth=growth.reshape(moves.shape[:-1]),
            track=track,
            slots=state.slots,
        )
        shape = (*angle.shape[:3], self.discs.count)
        occupied, chip_share = (share.reshape(shape) for share in found)
        samples = EdgeSamples(angle, outward, tooth, fade * occupied, chip_share)
        if self.bottom is not None:
            bottom = self.bottom.engage(process, state, index, predicted, part)
            samples = eqx.tree_at(
                lambda s: s.bottom, samples, bottom, is_leaf=lambda x: x is None
            )
        return Engagement(samples, process.removal.decimated_poses(state))

    def wrench(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle 7"]:
        """Loads of the tool at the angles of one sub-step."""
        cutter, outward = process.cutter, samples.outward
        tip, old = pose.tip, earlier.tip
        chip, per_travel = _chip(process, tip, old, decimated.tip, outward)
        motion = old[0] - tip
        feed = safe_norm(motion[:2])
        step = 2 * math.pi / self.angles
        touch = edge_contact(per_travel, feed, step)
        touch = freeze_derivative_at_standstill(
            touch * sideways_share(feed, safe_norm(motion)), feed
        )
        if cutter.flute_count % 2 == 0:
            lead = _lead((tip - old[0])[None, None, None, :2], outward)
            before = feed / cutter.diameter
            touch = touch * freeze_derivative_at_standstill(
                half_turn_contact_weight(lead, step, before), feed
            )
            chip = chip * freeze_derivative_at_standstill(
                half_turn_chip_weight(lead, step, before), feed
            )
        else:
            slope = outward.cos * motion[0] - outward.sin * motion[1]
            chip = jnp.maximum(chip, 0) + rounded_corner(
                per_travel * feed, slope, self.angles
            )
        wrench = wrench_of_discs(process, samples, chip, touch)
        if self.bottom is None or samples.bottom is None:
            return wrench
        return wrench + self.bottom.wrench(process, samples.bottom, pose, earlier)

    def chip(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle leading element"]:
        """Unclipped chip thickness of one sub-step [m]."""
        e = samples.outward
        return _chip(process, pose.tip, earlier.tip, decimated.tip, e).thickness

    def element_heights(
        self, cutter: AbstractCutter, dtype: jnp.dtype
    ) -> Float[Array, " element"]:
        """Height of the middle of every disc above the tip [m]."""
        return self.discs.centers(dtype)


def check_updates(engagement: AbstractEngagement) -> None:
    """Refuse updates that do not divide the sub-steps of a period."""
    # The next look is foreseen from the last two sub-steps of one.
    is_short = 1 < engagement.updates_per_period == engagement.substeps
    if engagement.substeps % engagement.updates_per_period or is_short:
        raise ValueError(
            "Argument `updates_per_period` must divide the sub-steps of a tooth period "
            f"({engagement.substeps}), into two or more if it is above 1, but is "
            f"{engagement.updates_per_period}."
        )


def wrench_of_discs(
    process: Process,
    samples: EdgeSamples,
    chip: Float[Array, "angle leading element"],
    touch: Float[Array, "angle leading element"],
) -> Float[Array, "angle 7"]:
    """Loads of the tool from the chips of its discs.

        F = sum over teeth and discs of o b (-F_t t - F_r e + F_a z)
        M = sum over teeth and discs of z_d z x F
        T = sum over teeth and discs of o b R F_t

    # symbols: o occupancy, b width of the edge in a disc, z_d height of a disc, F_t,
    F_r, F_a forces per width, R radius, t = (cos, -sin, 0) along and e = (sin, cos, 0)
    outward of the cut at the immersion angle, z tool axis

    Args:
        process: The process.
        samples: The samples of the sub-step, shape (angle, leading, element).
        chip: Unclipped chip thickness [m], shape (angle, leading, element).
        touch: 0 to 1, whether the edge touches the material, same shape.

    Returns:
        As `AbstractEngagement.wrench`.
    """
    cutter, discs, e = process.cutter, process.engagement.discs, samples.outward
    chip, touch = materialise((chip, touch))
    h = jnp.clip(chip, 0, cutter.diameter / 2) * samples.chip_share
    teeth = jnp.broadcast_to(samples.tooth, h.shape)
    touch = jnp.broadcast_to(touch, h.shape)
    F_t, F_r, F_a = process.side_law.force_per_width(h, touch, teeth)
    lower = discs.centers(chip.dtype) - discs.height / 2
    # The shank above the flutes has no edge.
    width = jnp.clip(cutter.flute_length - lower, 0, discs.height)
    share = samples.occupancy * width[None, None]
    # Stacked: every array of so few numbers costs a call.
    F_t, F_r, F_a = materialise(share[None] * jnp.stack([F_t, F_r, F_a]))
    F_x, F_y = -F_t * e.cos - F_r * e.sin, F_t * e.sin - F_r * e.cos
    force = materialise(jnp.sum(jnp.stack([F_x, F_y, F_a]), axis=(2, 3)))
    # Apart from it: most machines take no moment, and then it is not computed.
    lever = discs.centers(chip.dtype)[None, None]
    moment = jnp.sum(jnp.stack([-lever * F_y, lever * F_x]), axis=(2, 3))
    none = jnp.zeros_like(force[:1])
    torque = cutter.diameter / 2 * jnp.sum(F_t, axis=(1, 2))
    return jnp.concatenate([force, moment, none, torque[None]]).T


def _chip(
    process: Process,
    tip: Float[Array, " 3"],
    earlier: Float[Array, "tooth 3"],
    decimated: Float[Array, "circle 3"],
    outward: RadialDirection,
) -> UnclippedChip:
    cutter, discs = process.cutter, process.engagement.discs
    R = cutter.diameter / 2
    lower = discs.centers(tip.dtype) - discs.height / 2
    # All circles at once: one by one, the few numbers of each cost a call each.
    offsets = jnp.concatenate([earlier, decimated]) - tip[None]
    # The tooth just before cut every layer that this one cuts with its side.
    is_older = np.arange(len(offsets)) > 0
    if_missed = jnp.where(
        is_older, jnp.asarray(2 * cutter.nominal_radius, tip.dtype), 0
    )
    # When older circles were swept is not known.
    inverse_turns = np.zeros(len(offsets))
    teeth = np.arange(1, cutter.flute_count + 1)
    inverse_turns[: cutter.flute_count] = cutter.flute_count / (2 * math.pi * teeth)
    left = jax.vmap(chip_along, (None, 0, None, 0, 0))(
        R, offsets, outward, if_missed, jnp.asarray(inverse_turns, tip.dtype)
    )
    shares = jax.vmap(layer_share, (0, None, None))(offsets[:, 2], lower, discs.height)
    left, shares, inverse = materialise(
        (left, shares[:, None, None], 1 / displacement_norm(offsets[:, :2]))
    )
    chip, per_travel = left[0], left[0] * inverse[0]
    for k in range(1, len(offsets)):
        # The mean over the disc: what lies below an older pose it did not thin.
        chip = chip - shares[k] * jnp.maximum(chip - left[k], 0)
        per_travel = per_travel - shares[k] * jnp.maximum(
            per_travel - left[k] * inverse[k], 0
        )
    return UnclippedChip(chip, per_travel)


def immersion_angles(
    process: Process, dtype: jnp.dtype, part: Substeps | None = None
) -> Float[Array, "substep angle leading disc"]:
    """Immersion angle phi of every tooth at every sample of a period [rad].

    Every period begins with a tooth at angle 0 at the tip; a disc higher up lags by
    2 z tan(helix) / D.

    Args:
        process: The process.
        dtype: Floating type.
        part: The sub-steps, if these are not all of the period.

    Returns:
        Angles, shape (substep, angle, tooth, disc); the axis disc has length 1 if the
        flutes are straight.
    """
    cutter = process.cutter
    pitch = 2 * math.pi / cutter.flute_count
    turn = rotation_angles(process, dtype, part)[..., None, None]
    tooth = pitch * jnp.arange(cutter.flute_count, dtype=dtype)[None, None, :, None]
    if not cutter.has_helix:
        return turn + tooth
    height = process.engagement.discs.centers(dtype)
    lag = 2 * height * jnp.tan(jnp.asarray(cutter.helix_angle, dtype)) / cutter.diameter
    return turn + tooth - lag[None, None, None]


def _leading_samples(
    process: Process,
    state: ProcessState,
    predicted: Float[Array, "substep 3"],
    part: Substeps | None,
) -> LeadingSamples:
    cutter = process.cutter
    angle = immersion_angles(process, predicted.dtype, part)
    outward = RadialDirection.of(angle)
    if cutter.flute_count == 1:
        place = jnp.zeros(angle.shape, jnp.int32)
        return LeadingSamples(angle, outward, place, jnp.ones_like(angle))
    motion = (predicted - state.recent.tip[0])[:, None, None, None, :2]
    lead = _lead(motion, outward)
    teeth = LeadingTeeth.by_lead(lead)
    angle, outward, lead = jax.tree.map(teeth.of, (angle, outward, lead))
    fade = jnp.ones_like(lead)
    if cutter.flute_count % 2 == 0:
        fade = leading_fade(lead, 2 * math.pi / process.engagement.angles)
        fade = freeze_derivative_at_standstill(fade, safe_norm(motion))
    return LeadingSamples(angle, outward, teeth.place, fade)


def _lead(
    motion: Float[Array, "*#sample 2"], outward: RadialDirection
) -> Float[Array, "*sample"]:
    """Sine of the angle by which a tooth has entered the leading half."""
    motion = motion / jnp.sqrt(jnp.sum(motion**2, -1, keepdims=True) + STILL**2)
    return outward.sin * motion[..., 0] + outward.cos * motion[..., 1]
