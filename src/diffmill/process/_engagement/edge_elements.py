"""Any cutter, its axis in any direction: edge elements, and chips along their normals.

Every edge element has its own point, outward normal and width. The chip in front of it
reaches along the inward normal to the surface that earlier teeth swept. That surface
is known by its signed distance, so the chip follows by walking along the normal: each
walk leaves an error smaller by 1 - cos of the angle between the normals of the two
surfaces, some (feed / R)^2.

The k-th tooth before a tooth passed the same angle k pitches earlier, with its own
run-out; where it was then is told by `teeth_before.py` of uneven teeth.

The bottom edge cuts only what the tool descends into; what the side of the same tooth
takes beyond the last circle is the side's.
"""

import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter, EdgeElements
from ...numerics import clamp
from ...workpiece import Discs, Pose, RemovalWindow, occupancy_in_space
from .._chip import (
    RadialDirection,
    UnclippedChip,
    chip_growth,
    displacement_norm,
    edge_contact,
    freeze_derivative_at_standstill,
    rounded_corner,
    safe_norm,
    sideways_share,
    travel_share,
)
from .._process import AbstractEngagement, Process, Substeps, rotation_angles
from .._state import ProcessState, RemovedVolume
from .bottom_edge import RAMP
from .edge_samples import EdgeSamples, Engagement
from .leading_half import (
    STILL,
    LeadingSamples,
    LeadingTeeth,
    half_turn_chip_weight,
    half_turn_contact_weight,
    leading_fade,
)
from .upright import check_updates

# Elements nearer to the axis than this share of the radius count as standing there.
_LEAST_SINE = 0.02
# Elements nearer to the axis turn about it as if they were so far off it [m].
_LEAST_RADIUS = 1e-6


class EdgeDiscretisation(eqx.Module):
    """Edge elements of a cutter in space, counted from the center of its end.

    Attributes:
        bottom: Elements of the flat end.
        corner: Elements of the corner.
        side: Elements of the side.
        side_height: Height of an element of the side [m].
        corner_limit: Angle of the corner up to which they reach [rad].
        keeps_all: Whether all teeth are looked at all the time, since they cut on the
            trailing side too.
    """

    bottom: int = eqx.field(static=True)
    corner: int = eqx.field(static=True)
    side: int = eqx.field(static=True)
    side_height: float
    corner_limit: float
    keeps_all: bool = eqx.field(static=True)

    def elements(self, cutter: AbstractCutter, dtype: jnp.dtype) -> EdgeElements:
        """Return the edge elements of a cutter."""
        return cutter.elements(
            self.bottom,
            self.corner,
            self.side,
            self.side_height,
            dtype,
            corner_limit=self.corner_limit,
        )


class EdgeElementsInSpace(AbstractEngagement):
    """Any cutter, its axis in any direction.

    Attributes as of `AbstractEngagement`, and:
        profile: The edge elements on the bottom, the corner and the side.
    """

    angles: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    discs: Discs
    window: RemovalWindow
    removal_lag: float
    profile: EdgeDiscretisation
    is_upright: bool = eqx.field(static=True, default=True)
    updates_per_period: int = eqx.field(static=True, default=1)
    samples_whole_period: bool = eqx.field(static=True, default=False, init=False)

    def __check_init__(self):
        """Refuse looks that do not divide a period."""
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
        """Engagement of the edge elements: places, and shares of the chips in stock."""
        cutter = process.cutter
        elements = self.profile.elements(cutter, predicted.tip.dtype)
        every = _angles(process, elements, index, part)
        angle, outward, tooth, fade = self._leading(
            process, elements, state, predicted, every
        )
        # Walls stand back by the run-out of the teeth that made them.
        offsets = _edge_offsets(cutter, elements)
        own = None if offsets is None else _of_teeth(offsets, tooth)
        place = jax.vmap(lambda p, e, out: _edge(cutter, elements, p, e, out))
        places = place(predicted, outward, own)
        points, normals, along = places
        rim = jnp.cross(along, normals)
        motion = (predicted.tip - state.recent.tip[0])[:, None, None, None]
        ahead = jnp.sum(motion * normals, axis=-1)
        rise = elements.sin_kappa[None, None, None] * jnp.sum(motion * rim, axis=-1)
        growth = chip_growth(ahead, rise, self.angles)
        growth = freeze_derivative_at_standstill(growth, safe_norm(motion))
        # What an edge takes: a chip as thick as it lies beyond the pose before.
        old = state.recent[:, :, None, None, None]
        if offsets is None:
            chip = cutter.level(points, old.tip[0], old[0].direction())
        else:
            left = []
            for k in range(1, cutter.flute_count + 1):
                beyond = cutter.level(points, old.tip[k - 1], old[k - 1].direction())
                earlier = jnp.roll(offsets, -k, axis=0) * elements.sin_kappa[None]
                left.append(beyond - _of_teeth(earlier, tooth))
            chip = functools.reduce(jnp.minimum, left)
        chip = clamp(0.0, chip, cutter.nominal_radius)[..., None] * normals
        cell = jnp.stack(
            [
                elements.width[None, None, None, :, None] * along,
                (2 * math.pi / self.angles)
                * elements.radius[None, None, None, :, None]
                * rim,
                chip,
            ],
            axis=-2,
        )
        found = occupancy_in_space(
            state.stock,
            self._centroids(elements, places).reshape(-1, 3),
            cell.reshape(-1, 3, 3),
            self.discs.band,
            cutter,
            process.derivative.with_pose_derivatives(state.track, process.stock),
            growth=growth.reshape(-1),
            slots=state.slots,
        )
        occupied, chip_share = (share.reshape(angle.shape) for share in found)
        samples = EdgeSamples(angle, outward, tooth, fade * occupied, chip_share)
        return Engagement(samples, process.removal.decimated_poses(state))

    def wrench(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle 7"]:
        """Loads of the tool at the angles of one sub-step.

            F = sum over teeth and elements of o b (-F_t t - F_r n + F_a (t x n))
            M = sum over teeth and elements of l z x F

        # symbols: o occupancy, b width and l height of an element, F_t, F_r, F_a forces
        per width, t direction of the tooth, n outward normal, z tool axis

        Reference: Altintas, Manufacturing Automation, 2012, general end mill.
        """
        e, tooth = samples.outward, samples.tooth
        cutter = process.cutter
        elements = self.profile.elements(cutter, pose.tip.dtype)
        chip, per_travel = self._chip(process, samples, pose, earlier, decimated)
        newest = _newest(earlier)
        feed = safe_norm(newest - pose.tip)
        # From sample to sample, the chip of an element changes by its share of this.
        steps = 2 * math.pi / self.angles * jnp.maximum(elements.sin_kappa, _LEAST_SINE)
        touch = edge_contact(per_travel, feed, steps[None, None])
        frame = Pose.frame(pose.direction())
        x, y, z = frame.T @ (pose.tip - newest)
        sideways = jnp.stack(
            [elements.sin_kappa * x, elements.sin_kappa * y, elements.cos_kappa * z]
        )
        touch = touch * sideways_share(safe_norm(sideways.T), feed)[None, None]
        n = elements.bottom_count
        if cutter.flute_count % 2 == 0 and not self._keeps_all(cutter):
            lead = _lead(elements, pose.tip - newest, frame, e)[..., n:]
            step = 2 * math.pi / self.angles
            before = feed / cutter.diameter
            touch = touch.at[..., n:].multiply(
                half_turn_contact_weight(lead, step, before)
            )
            factor = freeze_derivative_at_standstill(
                half_turn_chip_weight(lead, step, before), feed
            )
            chip = chip.at[..., n:].multiply(factor)
        if n > 0:
            # The bottom of a tool that does not descend must not rub.
            least = per_travel[..., :n] - RAMP
            touch = touch.at[..., :n].set(edge_contact(least, feed, RAMP))
        touch = freeze_derivative_at_standstill(touch, feed)
        h = clamp(0.0, chip, cutter.nominal_radius)
        if cutter.flute_count % 2 or self._keeps_all(cutter):
            slope = elements.sin_kappa[None, None] * (e.cos * x - e.sin * y)
            zero = per_travel[..., n:] * feed
            rounded = rounded_corner(zero, slope[..., n:], self.angles)
            h = h.at[..., n:].add(rounded)
        h = h * samples.chip_share
        parts = []
        if n > 0:
            law = process.bottom_law
            parts.append(
                law.force_per_width(h[..., :n], touch[..., :n], tooth[..., :n])
            )
        if n < h.shape[-1]:
            law = process.side_law
            parts.append(
                law.force_per_width(h[..., n:], touch[..., n:], tooth[..., n:])
            )
        F_t, F_r, F_a = (jnp.concatenate(f, axis=-1) for f in zip(*parts, strict=True))
        width, sin_kappa, cos_kappa = (
            x[None, None]
            for x in (elements.width, elements.sin_kappa, elements.cos_kappa)
        )
        share = samples.occupancy * width
        # In tool axes; t = (cos, -sin, 0), n = (sin k sin, sin k cos, -cos k).
        F_out = -F_r * sin_kappa + F_a * cos_kappa
        F_x, F_y = (
            share * (-F_t * e.cos + F_out * e.sin),
            share * (F_t * e.sin + F_out * e.cos),
        )
        F_z = share * (F_r * cos_kappa + F_a * sin_kappa)
        lever = elements.height[None, None]
        along = [
            jnp.sum(component, axis=(1, 2))
            for component in (F_x, F_y, F_z, -lever * F_y, lever * F_x)
        ]
        force = jnp.stack(along[:3], axis=-1) @ frame.T
        moment = jnp.stack([*along[3:], jnp.zeros_like(F_z[:, 0, 0])], axis=-1)
        moment = moment @ frame.T
        radius = elements.radius[None, None]
        torque = jnp.sum(share * radius * F_t, axis=(1, 2))
        return jnp.concatenate([force, moment, torque[:, None]], axis=-1)

    def chip(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle leading element"]:
        """Unclipped chip thickness of one sub-step [m]."""
        return self._chip(process, samples, pose, earlier, decimated).thickness

    def element_heights(
        self, cutter: AbstractCutter, dtype: jnp.dtype
    ) -> Float[Array, " element"]:
        """Height of the middle of every element above the tip [m]."""
        return self.profile.elements(cutter, dtype).height

    def _keeps_all(self, cutter: AbstractCutter) -> bool:
        """True if all teeth are looked up."""
        is_even = cutter.has_even_pitch and cutter.flute_count > 1
        return self.profile.keeps_all or not is_even

    def _leading(
        self,
        process: Process,
        elements: EdgeElements,
        state: ProcessState,
        predicted: Pose,
        angle: Float[Array, "substep angle tooth element"],
    ) -> LeadingSamples:
        """The samples that can cut.

        Of evenly spaced teeth only half can be on the leading side, where the normal
        points the way that the tool moves, unless it descends.
        """
        cutter = process.cutter
        count = cutter.flute_count
        teeth = jnp.arange(count, dtype=jnp.int32)[None, None, :, None]
        teeth = jnp.broadcast_to(teeth, angle.shape)
        outward = RadialDirection.of(angle)
        if self._keeps_all(cutter):
            return LeadingSamples(angle, outward, teeth, jnp.ones_like(angle))
        motion = predicted.tip - state.recent.tip[0]
        frames = Pose.frame(predicted.direction())
        lead = jax.vmap(lambda m, f, e: _lead(elements, m, f, e))(
            motion, frames, outward
        )
        leading = LeadingTeeth.by_lead(lead)
        angle, outward, lead = jax.tree.map(leading.of, (angle, outward, lead))
        fade = jnp.ones_like(lead)
        if cutter.flute_count % 2 == 0:
            n = elements.bottom_count
            step = 2 * math.pi / self.angles
            fade = fade.at[..., n:].set(leading_fade(lead[..., n:], step))
            fade = freeze_derivative_at_standstill(
                fade, safe_norm(motion)[:, None, None, None]
            )
        return LeadingSamples(angle, outward, leading.place, fade)

    def _centroids(
        self, elements: EdgeElements, places: "_EdgePlaces"
    ) -> Float[Array, "substep angle leading element 3"]:
        """Centroids of the surfaces that elements pass in their samples [m].

        A sample weighs what lies up to one angle step to each side as a hat does, whose
        variance is a sixth; the arc falls inward of its tangent by half of that.
        """
        turn = 2 * math.pi / self.angles
        _, normals, along = places
        sin_kappa, cos_kappa, radius, sagitta = (
            x[None, None, None, :, None]
            for x in (
                elements.sin_kappa,
                elements.cos_kappa,
                elements.radius * turn**2 / 12,
                elements.sagitta,
            )
        )
        radial = sin_kappa * normals + cos_kappa * along
        return places.points - radius * radial - sagitta * normals

    def _chip(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> UnclippedChip:
        cutter, tooth = process.cutter, samples.tooth
        elements = self.profile.elements(cutter, pose.tip.dtype)
        # Here the run-out enters by what it adds to the chip.
        edge = _edge(cutter, elements, pose, samples.outward, None)
        points, normals = edge.points, edge.normals
        n = elements.bottom_count
        offsets = _edge_offsets(cutter, elements)
        nothing = 2 * cutter.nominal_radius
        chip = jnp.full_like(samples.outward.sin, nothing)
        newest = _newest(earlier)
        per_travel = chip / displacement_norm(newest - pose.tip)
        descent = jnp.full_like(chip[..., :n], nothing)
        covered = jnp.zeros(descent.shape, bool)
        turns = jnp.asarray(
            2 * math.pi / cutter.flute_count * cutter.delays(chip.dtype)
        )
        for k in range(1, cutter.flute_count + 1):
            met = functools.partial(
                _where_met, elements, pose, samples, earlier[k - 1], turns[k - 1]
            )
            sides = met(slice(n, None))
            # Teeth stand out by their run-out: what one takes the next does not find.
            left = _walk(cutter, points[..., n:, :], normals[..., n:, :], sides, 2)
            if offsets is not None:
                ahead = offsets - jnp.roll(offsets, -k, axis=0)
                ahead = _of_teeth(ahead * elements.sin_kappa[None], tooth)
                left = left + ahead[..., n:]
            chip = chip.at[..., n:].min(left)
            way = displacement_norm(sides.tip - pose.tip[None, None, None])
            per_travel = per_travel.at[..., n:].min(left / way)
            if n > 0:
                down, is_under = _descent(cutter, points[..., :n, :], met(slice(n)))
                covered = is_under if k == 1 else covered
                descent = jnp.minimum(descent, jnp.where(is_under, down, nothing))
        for i in range(decimated.tip.shape[0]):
            old = decimated[i][None, None, None]
            left = _walk(cutter, points[..., n:, :], normals[..., n:, :], old, 1)
            if offsets is not None:
                # What is older the tooth has left that stands out most.
                ahead = offsets - jnp.max(offsets, axis=0, keepdims=True)
                ahead = _of_teeth(ahead * elements.sin_kappa[None], tooth)
                left = left + ahead[..., n:]
            chip = chip.at[..., n:].min(left)
            per_travel = per_travel.at[..., n:].min(
                left / displacement_norm(old.tip - pose.tip[None, None, None])
            )
        if n > 0:
            descent = jnp.where(covered, descent, 0)
            chip = chip.at[..., :n].set(descent)
            way = displacement_norm(newest - pose.tip)
            per_travel = per_travel.at[..., :n].set(descent / way)
        return UnclippedChip(chip, per_travel)


def _lead(
    elements: EdgeElements,
    motion: Float[Array, " 3"],
    frame: Float[Array, "3 3"],
    outward: RadialDirection,
) -> Float[Array, "angle tooth element"]:
    """Share of the motion along the normals of elements."""
    x, y, z = frame.T @ (motion / jnp.sqrt(jnp.sum(motion**2) + STILL**2))
    sin_kappa, cos_kappa = (
        elements.sin_kappa[None, None],
        elements.cos_kappa[None, None],
    )
    return sin_kappa * (outward.sin * x + outward.cos * y) - cos_kappa * z


def _where_met(
    elements: EdgeElements,
    pose: Pose,
    samples: EdgeSamples,
    passed: Pose,
    turns: Float[Array, " tooth"],
    part: slice,
) -> Pose:
    """Poses when earlier teeth met the normals of a part of the edge.

    Args:
        elements: The edge elements.
        pose: Pose of the tool, shape (3,).
        samples: All samples.
        passed: Poses when they stood at the same angle, shape (3,) or (tooth, 3).
        turns: Angle Theta between them and each tooth [rad], shape (tooth,).
        part: Elements of the part.

    Returns:
        The poses; their tips are of shape (angle, leading, part, 3).
    """
    tooth = samples.tooth[..., part]
    is_even = passed.tip.ndim == 1
    old = passed[None, None, None] if is_even else passed[tooth]
    offset = old.tip - pose.tip[None, None, None]
    # In tool axes; t = (cos, -sin, 0).
    x, y, _ = jnp.moveaxis(offset @ Pose.frame(pose.direction()), -1, 0)
    radius = jnp.maximum(elements.radius[part], _LEAST_RADIUS)[None, None]
    sin, cos = samples.outward.sin[..., part], samples.outward.cos[..., part]
    sideways = (x * cos - y * sin) / radius
    share = travel_share(sideways, 1 / (turns[0] if is_even else turns[tooth]))
    return eqx.tree_at(
        lambda p: p.tip, old, pose.tip[None, None, None] + offset * share[..., None]
    )


def _walk(
    cutter: AbstractCutter,
    points: Float[Array, "angle leading element 3"],
    normals: Float[Array, "angle leading element 3"],
    old: Pose,
    count: int,
) -> Float[Array, "angle leading element"]:
    """Distance of an earlier pose's surface inward of points on the edge."""
    h = cutter.level(points, old.tip, old.direction())
    for _ in range(count - 1):
        h = h + cutter.level(points - h[..., None] * normals, old.tip, old.direction())
    return h


def _descent(
    cutter: AbstractCutter,
    points: Float[Array, "angle leading element 3"],
    old: Pose,
) -> tuple[Float[Array, "angle leading element"], Bool[Array, "angle leading element"]]:
    """Depth of points below an earlier end [m], and flags of those under it."""
    axis = old.direction()
    away = points - old.tip
    up = jnp.sum(away * axis, axis=-1)
    across = jnp.sum(away**2, axis=-1) - up**2
    flat = cutter.nominal_radius - cutter.nominal_corner_radius
    return -up, jax.lax.stop_gradient(across) < flat**2


def _newest(earlier: Pose) -> Float[Array, " 3"]:
    """Tip one tooth period ago, for uneven teeth the mean of theirs."""
    tip = earlier.tip[0]
    if tip.ndim == 1:
        return tip
    # From one of them on: a tool that stands still has been just there.
    return tip[0] + jnp.mean(tip - tip[:1], axis=0)


def _edge_offsets(
    cutter: AbstractCutter, elements: EdgeElements
) -> Float[Array, "tooth element"] | None:
    """Offset of the elements by run-out [m]; that of the bottom is none.

    None for a cutter without run-out.
    """
    if not cutter.has_runout:
        return None
    offsets = cutter.runout_offsets(elements.lag).astype(elements.lag.dtype)
    return offsets.at[:, : elements.bottom_count].set(0)


def _of_teeth(
    values: Float[Array, "tooth element"], tooth: Int[Array, "*sample element"]
) -> Float[Array, "*sample element"]:
    """Values of the tooth and element of each sample."""
    return values[tooth, jnp.arange(values.shape[1], dtype=jnp.int32)]


def _angles(
    process: Process,
    elements: EdgeElements,
    index: Int[Array, ""],
    part: Substeps | None,
) -> Float[Array, "substep angle tooth element"]:
    """Immersion angles phi of all elements of a period [rad]."""
    cutter, dtype = process.cutter, elements.lag.dtype
    # Teeth differ: every period the turn goes on where the one before ended.
    done = jnp.mod(index - 1, cutter.flute_count).astype(dtype)
    turn = (
        rotation_angles(process, dtype, part) + 2 * math.pi / cutter.flute_count * done
    )
    pitch = jnp.asarray(cutter.pitch_angles, dtype)
    place = pitch[:, None] - elements.lag[None]
    return turn[..., None, None] + place[None, None]


class _EdgePlaces(NamedTuple):
    """Pieces of the edge in `work`.

    Attributes:
        points: Their middles [m].
        normals: Outward normals.
        along: Directions along the profile.
    """

    points: Float[Array, "angle leading element 3"]
    normals: Float[Array, "angle leading element 3"]
    along: Float[Array, "angle leading element 3"]


def _edge(
    cutter: AbstractCutter,
    elements: EdgeElements,
    pose: Pose,
    outward: RadialDirection,
    offset: Float[Array, "angle leading element"] | None,
) -> _EdgePlaces:
    """Places and directions of the edge elements.

    Args:
        cutter: The cutter.
        elements: Its edge elements.
        pose: Pose of the tool, shape (3,).
        outward: Directions of the samples.
        offset: How far they stand out by the run-out [m]; None for not at all.
    """
    frame = Pose.frame(pose.direction())
    zero = jnp.zeros_like(outward.sin)
    radial = jnp.stack([outward.sin, outward.cos, zero], axis=-1) @ frame.T
    axis = frame[:, 2]
    axis = axis[None, None, None]
    radius, height, sin_kappa, cos_kappa = (
        x[None, None, :, None]
        for x in (
            elements.radius,
            elements.height,
            elements.sin_kappa,
            elements.cos_kappa,
        )
    )
    if offset is not None:
        radius = radius + offset[..., None]
    points = pose.tip[None, None, None] + radius * radial + height * axis
    return _EdgePlaces(
        points,
        sin_kappa * radial - cos_kappa * axis,
        cos_kappa * radial + sin_kappa * axis,
    )
