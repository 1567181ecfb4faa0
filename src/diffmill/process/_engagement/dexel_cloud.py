"""The paper's own chip: a cloud of points, discs, extreme angles, two cylinders.

Every pose is removed at once. What the pose at the end of a tooth period takes from the
rays is a cloud of points: the outer volume of the chip. The cloud is cut into discs of
the height dz, and in each disc the extreme points bound the arc from phi_in to phi_out
on which a tooth cuts. Between them the chip is that of two cylinders, the tool now and
one tooth period earlier.

The model is hard: the angles follow single rays, so that forces have a ripple of the
spacing of the rays, and an arc ends at the last ray inside the material, some half
spacing short of its true end. A disc has one arc: where the tool meets material on two
sides of a gap, the gap counts as material. Angles count from the direction of motion,
so that no arc in front of the tool is split at the end of the scale.

Two points go beyond the paper. A disc that is only partly in the material counts with
the part between the lowest and the highest point of the cloud; and what lies under the
tool before is the bottom's to cut and no part of the cloud.
"""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import clamp
from ...workpiece import (
    Discs,
    Pose,
    RemovalWindow,
    RemovedPieces,
    Stock,
)
from .._chip import (
    chip_along,
    displacement_norm,
    edge_contact,
    freeze_derivative_at_standstill,
    safe_norm,
    sideways_share,
)
from .._process import AbstractEngagement, Process, Substeps
from .._removal_history import tracked
from .._state import ProcessState, RemovedVolume
from .edge_samples import EdgeSamples, Engagement
from .upright import immersion_angles, wrench_of_discs

# Overlaps and distances below this share of a spacing, or of the radius, are rounding.
_TINY = 1e-6
# The turn that is straight behind.
_BEHIND = 2.0
# Share of a disc's height in the material that a column must fill to count in it.
_FILLS = 0.5


class Arcs(eqx.Module):
    """The arc of each disc on which teeth meet material.

    Attributes:
        heading: Direction of motion, as an immersion angle [rad], shape ().
        entry: phi_in, from the heading clockwise [rad], shape (element,).
        exit: phi_out, likewise; less than `entry` where a disc meets nothing.
        share: Share of each disc's height that is in the material, shape (element,).
    """

    heading: Float[Array, ""]
    entry: Float[Array, " element"]
    exit: Float[Array, " element"]
    share: Float[Array, " element"]


class _Columns(eqx.Module):
    """Taken columns: turn to each, and its ends above the tip."""

    turn: Float[Array, "x y"]
    low: Float[Array, "x y"]
    high: Float[Array, "x y"]
    is_taken: Bool[Array, "x y"]


class _Rows(eqx.Module):
    """Extreme turns in each row of rays across the tool, and its height."""

    least: Float[Array, " row"]
    most: Float[Array, " row"]
    is_taken: Bool[Array, " row"]
    height: Float[Array, " row"]


class DexelCloud(AbstractEngagement):
    """The paper's own chip, of a flat cutter with even teeth that is upright, along +z.

    Attributes as of `AbstractEngagement`.
    """

    angles: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    discs: Discs
    window: RemovalWindow
    removal_lag: float
    updates_per_period: int = eqx.field(static=True, default=1)
    is_upright: bool = eqx.field(static=True, default=True, init=False)
    samples_whole_period: bool = eqx.field(static=True, default=True, init=False)
    removal_waits: ClassVar[bool] = False

    def __check_init__(self):
        """Refuse several looks: what a cloud tells, it tells once a period."""
        if self.updates_per_period != 1:
            raise ValueError(
                "Argument `updates_per_period` must be 1 for a point cloud, but is "
                f"{self.updates_per_period}."
            )

    def remove(
        self, process: Process, state: ProcessState, index: Int[Array, ""], pose: Pose
    ) -> tuple[ProcessState, RemovedVolume]:
        """Enter a pose in the track and remove it from the stock."""
        indices = index[None]
        # Never a constant, which XLA would fold, and then copy the stock in every step.
        is_due = (pose.tip[2] < state.stock.top)[None]
        cut = self.window.remove_poses(
            state.stock,
            process.cutter,
            process.derivative.removal_poses(pose[None]),
            indices,
            is_due,
            slots=state.slots,
        )
        state = eqx.tree_at(
            lambda s: (
                s.stock,
                s.track,
                s.last_tip,
                s.slots,
                s.has_overflow,
                s.has_left_window,
            ),
            state,
            (
                cut.stock,
                tracked(state, index, pose),
                pose.tip,
                cut.slots,
                state.has_overflow | cut.has_overflow,
                state.has_left_window | cut.has_left_window,
            ),
        )
        return state, RemovedVolume(indices, cut.volume, cut.by_shank)

    def engage(
        self,
        process: Process,
        state: ProcessState,
        index: Int[Array, ""],
        predicted: Pose,
        part: Substeps | None = None,
    ) -> Engagement:
        """Places of the teeth in a period, and the share of each sample that cuts.

        A sample stands for the angles up to half a step beside it, and counts with what
        of them lies between phi_in and phi_out.

        Differentiability: hard. The derivative follows the rays that hold the extreme
        points and knows nothing of the jump when others take over.
        """
        n, start, teeth = self.substeps, state.last_tip, process.cutter.flute_count
        # Straight on from the last middle to the end of the period.
        end = start + (predicted.tip[-1] - start) * (n / (n - 0.5))
        arcs = self.chip_arcs(process, state.stock, start, end)
        angle = immersion_angles(process, end.dtype)
        seen = jnp.mod(angle - arcs.heading + math.pi, 2 * math.pi) - math.pi
        half = math.pi / self.angles
        upper = jnp.minimum(seen + half, arcs.exit[None, None, None])
        lower = jnp.maximum(seen - half, arcs.entry[None, None, None])
        inside = clamp(0.0, (upper - lower) / (2 * half), 1.0)
        weight = inside * arcs.share[None, None, None]
        tooth = jnp.arange(teeth, dtype=jnp.int32) - (index - 1)
        tooth = jnp.mod(tooth, teeth)[None, None, :, None]
        tooth = jnp.broadcast_to(tooth, angle.shape)
        # The cloud judges at the rim alone.
        samples = EdgeSamples.at(angle, tooth, weight, jnp.ones_like(weight))
        return Engagement(samples, Pose(start).repeated(0))

    def chip_arcs(
        self,
        process: Process,
        stock: Stock,
        before: Float[Array, " 3"],
        tip: Float[Array, " 3"],
    ) -> Arcs:
        """Return entry and exit angle of each disc from the cloud of what a pose takes.

        Args:
            process: The process.
            stock: The stock, from which the pose before is removed.
            before: Tool tip one tooth period earlier [m], shape (3,).
            tip: Tool tip now [m], shape (3,).

        Returns:
            The arcs.

        Differentiability: as `engage`; a constant where a disc meets nothing.
        """
        cutter = process.cutter
        motion = jax.lax.stop_gradient(tip - before)
        heading = jnp.arctan2(motion[0], motion[1])
        taken = RemovedPieces.of_pass(stock, cutter, self.window, tip)
        floor = jax.lax.stop_gradient(before[2] - tip[2])
        rows = _rows(taken[0], taken[1], tip, heading, floor)
        columns = _columns(taken[2], cutter, before, tip, heading)
        low, high = _extent(rows, columns, stock.spacing)
        dz = self.discs.height
        bottom = self.discs.centers(tip.dtype) - dz / 2
        share = jnp.minimum(bottom + dz, high) - jnp.maximum(bottom, low)
        share = clamp(0.0, share / dz, 1.0)
        # A row of rays stands for the layer of one spacing around it.
        half = (0.5 - _TINY) * stock.spacing
        above = rows.height[:, None] - bottom[None]
        is_row = rows.is_taken[:, None] & (above > -half) & (above < dz + half)
        filled = jnp.minimum(columns.high[..., None], bottom[None, None] + dz)
        filled = filled - jnp.maximum(columns.low[..., None], bottom[None, None])
        needed = jax.lax.stop_gradient(_FILLS * dz * share)
        is_column = columns.is_taken[..., None] & (filled >= needed[None, None])
        is_column = is_column & (needed > 0)[None, None]
        entry = jnp.minimum(
            jnp.min(rows.least[:, None], axis=0, where=is_row, initial=_BEHIND),
            jnp.min(columns.turn[..., None], (0, 1), where=is_column, initial=_BEHIND),
        )
        exit = jnp.maximum(
            jnp.max(rows.most[:, None], axis=0, where=is_row, initial=-_BEHIND),
            jnp.max(columns.turn[..., None], (0, 1), where=is_column, initial=-_BEHIND),
        )
        return Arcs(heading, _angle_of(entry), _angle_of(exit), share)

    def wrench(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle 7"]:
        """Return the loads of the tool at the angles of one sub-step."""
        chip = self.chip(process, samples, pose, earlier, decimated)
        newest = earlier.tip[0] - pose.tip
        feed, step = safe_norm(newest[:2]), 2 * math.pi / self.angles
        touch = edge_contact(chip / displacement_norm(newest[:2]), feed, step)
        touch = freeze_derivative_at_standstill(
            touch * sideways_share(feed, safe_norm(newest)), feed
        )
        return wrench_of_discs(process, samples, chip, touch)

    def chip(
        self,
        process: Process,
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle leading element"]:
        """Return the unclipped chip of two cylinders [m], now and a period ago."""
        radius = process.cutter.diameter / 2
        return chip_along(radius, earlier.tip[0] - pose.tip, samples.outward, 0.0)

    def element_heights(
        self, cutter: AbstractCutter, dtype: jnp.dtype
    ) -> Float[Array, " element"]:
        """Height of the middle of every disc above the tip [m]."""
        return self.discs.centers(dtype)


def _turn(
    x: Float[Array, "*point"],
    y: Float[Array, "*point"],
    is_point: Bool[Array, "*point"],
    heading: Float[Array, ""],
) -> Float[Array, "*point"]:
    """Angle from the heading to points that are given from the axis.

    From 0 ahead clockwise to 2 behind, and to -2 the other way: it grows with the
    angle, so that it has its extremes at the same points, and needs no arctangent.
    """
    # On the axis there is no angle, nor a derivative.
    is_seen = is_point & (jax.lax.stop_gradient(x**2 + y**2) > 0)
    x, y = jnp.where(is_seen, x, 0.0), jnp.where(is_seen, y, 1.0)
    sin, cos = jnp.sin(heading), jnp.cos(heading)
    across, ahead = x * cos - y * sin, x * sin + y * cos
    turn = 1 - ahead / (jnp.abs(across) + jnp.abs(ahead))
    return jnp.where(across < 0, -turn, turn)


def _angle_of(turn: Float[Array, " element"]) -> Float[Array, " element"]:
    """Return the angle of a turn [rad]."""
    ahead = 1 - jnp.abs(turn)
    across = 1 - jnp.abs(ahead)
    # Straight ahead an absolute value has no slope of its own.
    return jnp.arctan2(jnp.where(turn < 0, -across, across), ahead)


def _rows(
    along_x: RemovedPieces,
    along_y: RemovedPieces,
    tip: Float[Array, " 3"],
    heading: Float[Array, ""],
    floor: Float[Array, ""],
) -> _Rows:
    """Return the extreme turns of the rays across the tool, row by row."""
    height = along_x.c - tip[2]
    # Lower rows were under the tool before: the bottom's to cut.
    is_side = height > floor
    least, most = [], []
    for pieces, is_x in ((along_x, True), (along_y, False)):
        for end in (pieces.low, pieces.high):
            if is_x:
                x, y = end - tip[0], (pieces.b - tip[1])[:, None]
                is_taken = pieces.is_taken
            else:
                x, y = (pieces.c - tip[0])[:, None], end.T - tip[1]
                is_taken = pieces.is_taken.T
            x, y = jnp.broadcast_arrays(x, y)
            turn = _turn(x, y, is_taken, heading)
            least.append(jnp.min(turn, axis=0, where=is_taken, initial=_BEHIND))
            most.append(jnp.max(turn, axis=0, where=is_taken, initial=-_BEHIND))
    is_met = jnp.any(along_x.is_taken, axis=0) | jnp.any(along_y.is_taken, axis=1)
    return _Rows(
        jnp.min(jnp.stack(least), axis=0),
        jnp.max(jnp.stack(most), axis=0),
        is_met & is_side,
        height,
    )


def _columns(
    along_z: RemovedPieces,
    cutter: AbstractCutter,
    before: Float[Array, " 3"],
    tip: Float[Array, " 3"],
    heading: Float[Array, ""],
) -> _Columns:
    """Return the columns that are taken beside the tool before."""
    x, y = jnp.broadcast_arrays(along_z.b[:, None], along_z.c[None, :])
    away = (x - before[0]) ** 2 + (y - before[1]) ** 2
    away = jax.lax.stop_gradient(away)
    is_taken = along_z.is_taken & (away > ((1 - _TINY) * cutter.nominal_radius) ** 2)
    return _Columns(
        _turn(x - tip[0], y - tip[1], is_taken, heading),
        along_z.low - tip[2],
        along_z.high - tip[2],
        is_taken,
    )


def _extent(
    rows: _Rows, columns: _Columns, spacing: float
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the lowest and the highest point of the cloud above the tip [m].

    Columns end at floors exactly. Without one, a row stands for half a spacing more.
    """
    has_column = jnp.any(columns.is_taken)
    room = jnp.where(has_column, 0, 0.5 * spacing)
    low = jnp.minimum(
        jnp.min(columns.low, where=columns.is_taken, initial=jnp.inf),
        jnp.min(rows.height, where=rows.is_taken, initial=jnp.inf) - room,
    )
    high = jnp.maximum(
        jnp.max(columns.high, where=columns.is_taken, initial=-jnp.inf),
        jnp.max(rows.height, where=rows.is_taken, initial=-jnp.inf) + room,
    )
    has_any = has_column | jnp.any(rows.is_taken)
    return jnp.where(has_any, low, 0), jnp.where(has_any, high, 0)
