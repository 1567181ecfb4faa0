"""Tooth passes: the pose of the tool that makes each point of a wall.

A point of a surface is made by a tooth at the instant at which it looks at the point:
the tool shakes and moves on within a tooth period, so walls in other directions, and
at other heights on a helix, see other poses. The cut of one tooth as it goes around
once is that of a cutter whose tip depends on direction and height. All of these
together are the cut of the tool.

The turn is cut open behind the tool, where earlier teeth have been: whatever a tooth
takes ahead of it is one surface without a step.

Times count in tooth periods from pose 0. The ends of rays remember them in whole ticks.
"""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from ...cutter import AbstractCutter
from ...numerics import Rematerialised, clamp, materialise
from .._pose import Pose
from .interval import CutInterval
from .nearest_interval import gather
from .stock import Rays, Stock

# Iterations between an end and the pose that cuts it. The error that remains is the
# square of (way in a radian / R), in R.
_POSE_ITERATIONS = 2
# Parts of a step in the search for the time of a column.
_COLUMN_PARTS = 8
# Abramowitz and Stegun, Handbook of Mathematical Functions, 1964, 4.4.49: arctan x / x
# for |x| <= 1 to 1e-5.
_ARCTAN = (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351)
_TINY = 1e-30


class PoseTrack(eqx.Module):
    """Poses of a tool at equal steps of time, and the stock that they began with.

    Attributes:
        poses: Pose i stands at the time i / substeps, shape (node, 3); two at least.
        substeps: Steps per tooth period.
        raw: Its ends are those that no pose has cut; None takes them for constants.
    """

    poses: Pose
    substeps: int = eqx.field(static=True)
    raw: Stock | None = None

    def cut_by(self, ticks: Int[Array, "*end"]) -> Pose:
        """Poses that cut some ends, interpolated between two nodes.

        Args:
            ticks: Ticks of the cuts, which the ends remember, shape (...); raw ends,
                with negative times, get pose 0.

        Returns:
            Poses, shape (..., 3).

        **Differentiability**: linear in the poses.
        """
        return jax.tree.map(lambda x: self._between(x, ticks), self.poses)

    def floor_by(
        self,
        ticks: Int[Array, "*end"],
        cutter: AbstractCutter,
        x: Float[Array, "*#end"],
        y: Float[Array, "*#end"],
    ) -> Float[Array, "*end"]:
        """Heights at which the flat end of an upright cutter cut columns.

        Args:
            ticks: Ticks of the cuts, shape (...); see `cut_by`.
            cutter: The cutter.
            x: Place of the columns along x [m], broadcast.
            y: Place along y [m].

        Returns:
            Heights [m], shape (...): those of the tip and of a dish above it.

        **Differentiability**: in the poses and the cutter's sizes.
        """
        if cutter.has_dish:
            tip = self.cut_by(ticks).tip
            # Reverse mode keeps what slopes depend on, and no table of all poses.
            across = Rematerialised.read(tip[..., :2])
            level = jnp.pad(across, [(0, 0)] * (across.ndim - 1) + [(0, 1)])
            return cutter.intersect(2, x, y, level).start + tip[..., 2]
        return self._between(self.poses.tip[:, 2:], ticks)[..., 0]

    def raw_ends(
        self, family: int, at: Int[Array, "*end"], ticks: Int[Array, "*end"]
    ) -> Float[Array, "*end"]:
        """Ends of the raw stock that are still there, zero for others.

        Args:
            family: Axis along which the rays run.
            at: Indices of the ends in memory, shape (...).
            ticks: Ticks of the cuts, which the ends remember, shape (...).

        Returns:
            Ends [m], shape (...).

        **Differentiability**: linear in the raw stock.
        """
        if self.raw is None:
            return jnp.zeros(at.shape, self.poses.tip.dtype)
        table = self.raw.families[family].ends
        slots = table.shape[-1]
        is_raw = (ticks < 0) & (ticks >= -slots)
        place = jnp.where(is_raw, at - at % slots - 1 - ticks, 0)
        return jnp.where(is_raw, gather(table, place), 0)

    def _between(
        self, nodes: Float[Array, "node some"], ticks: Int[Array, "*end"]
    ) -> Float[Array, "*end some"]:
        ticks = jnp.maximum(ticks, 0)
        steps = (ticks % Rays.TICKS) * self.substeps
        node = ticks // Rays.TICKS * self.substeps + steps // Rays.TICKS
        share = (steps % Rays.TICKS).astype(nodes.dtype)[..., None] / Rays.TICKS
        # Two nodes by one index: the transpose adds them into the table at once.
        low = jnp.minimum(node, nodes.shape[0] - 2)
        share = jnp.where(node[..., None] > low[..., None], 1, share)
        both = _pairs(nodes, low)
        return (1 - share) * both[..., 0, :] + share * both[..., 1, :]


def _pairs(
    table: Float[Array, "row some"], first: Int[Array, "*at"]
) -> Float[Array, "*at 2 some"]:
    """Rows of a table and those behind them."""
    numbers = jax.lax.GatherDimensionNumbers(
        offset_dims=(first.ndim, first.ndim + 1),
        collapsed_slice_dims=(),
        start_index_map=(0,),
    )
    size = (2, table.shape[1])
    mode = jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return jax.lax.gather(table, first[..., None], numbers, size, mode=mode)


class ToothPass(eqx.Module):
    """Poses of a tool while one tooth goes around once.

    Attributes:
        nodes: Poses at equal steps of time, shape (node, 3); one for a tool that stands
            still.
        first: Steps from pose 0 to node 0, shape ().
        feed_direction: Unit direction of motion along tool x and y, shape (2,).
        passing_node: Node, in parts too, at which the tooth points along the feed, ().
        last: Last node that is known; later the tool is taken to stand there, ().
        substeps: Steps per tooth period.
        teeth: Mask of the teeth that make the pass, of a cutter with run-out, shape
            (tooth,): the one that is outermost cuts; all teeth if None.
    """

    nodes: Pose
    first: Int[Array, ""]
    feed_direction: Float[Array, " 2"]
    passing_node: Float[Array, ""]
    last: Float[Array, ""]
    substeps: int = eqx.field(static=True)
    teeth: Bool[Array, " tooth"] | None = None

    def center(self) -> Pose:
        """Pose at which the tooth points along the feed, shape (3,)."""
        return self.at(clamp(0.0, self.passing_node, self.last))

    def at(self, node: Float[Array, "*end"]) -> Pose:
        """Poses at some nodes, interpolated, shape (..., 3).

        **Differentiability**: kinks at the nodes.
        """
        count = self.nodes.tip.shape[0]
        if count == 1:
            return self.nodes[0]
        low = jnp.clip(jax.lax.stop_gradient(node).astype(jnp.int32), 0, count - 2)
        share = (node - low.astype(node.dtype))[..., None]
        left, right = self.nodes.gather(low), self.nodes.gather(low + 1)
        tip = left.tip + share * (right.tip - left.tip)
        if left.axis is None or right.axis is None:
            return Pose(tip)
        axis = left.axis + share * (right.axis - left.axis)
        return Pose(tip, axis / jnp.linalg.norm(axis, axis=-1, keepdims=True))

    def refined(self, parts: int) -> "ToothPass":
        """Same pass with every step in some parts."""
        count = (self.nodes.tip.shape[0] - 1) * parts + 1
        fine = self.at(jnp.arange(count, dtype=self.passing_node.dtype) / parts)
        first, passing_node, last = (
            parts * value for value in (self.first, self.passing_node, self.last)
        )
        steps = parts * self.substeps
        return ToothPass(
            fine, first, self.feed_direction, passing_node, last, steps, self.teeth
        )

    def offset(
        self, cutter: AbstractCutter, height: Float[Array, "*#end"]
    ) -> Float[Array, "..."] | None:
        """Offset from the radius of the edge that cuts at some heights [m].

        Args:
            cutter: The cutter.
            height: Above the tip [m], shape (...).

        Returns:
            Offset of the tooth that is outermost, broadcast against the heights;
            None for a cutter without run-out.

        **Differentiability**: kinks where another tooth stands out most.
        """
        if not cutter.has_runout:
            return None
        offsets = cutter.edge_offsets(height)
        if self.teeth is not None:
            own = self.teeth.reshape(-1, *(1,) * (offsets.ndim - 1))
            offsets = jnp.where(own, offsets, -cutter.nominal_radius)
        return jnp.max(offsets, axis=0)

    def when(
        self,
        cutter: AbstractCutter,
        x: Float[Array, "*#end"],
        y: Float[Array, "*#end"],
        height: Float[Array, "*#end"] | None,
    ) -> Float[Array, "..."]:
        """Node at which the tooth looks at a place.

        Args:
            cutter: The cutter.
            x: Place from the tip along tool x [m], shape (...).
            y: Along tool y [m], broadcast.
            height: Above the tip [m], broadcast; None for places at the tip.

        Returns:
            Nodes, in whole ticks, shape (...).

        **Differentiability**: taken as a constant: as an end moves, another pose cuts
        it, by (way in a radian / R) of its motion.
        """
        sin, cos = self.feed_direction[0], self.feed_direction[1]
        turn = _turn_between(x * sin + y * cos, x * cos - y * sin)
        if height is not None and cutter.has_helix:
            lead = jnp.tan(jnp.asarray(cutter.helix_angle, turn.dtype))
            turn = turn + height * lead / (cutter.diameter / 2)
        nodes_per_radian = cutter.flute_count * self.substeps / (2 * math.pi)
        node = jax.lax.stop_gradient(self.passing_node + nodes_per_radian * turn)
        node = clamp(0.0, node, self.last)
        # Whole ticks from node 0, such that they are whole from pose 0 too.
        part = self._first_ticks(node.dtype)
        ticks = jnp.round(node * (Rays.TICKS / self.substeps) + part) - part
        return jnp.minimum(ticks * (self.substeps / Rays.TICKS), self.last)

    def ticks(self, node: Float[Array, "*end"]) -> Int[Array, "*end"]:
        """Times of some nodes in ticks, shape (...)."""
        part = node * (Rays.TICKS / self.substeps) + self._first_ticks(node.dtype)
        whole = self.first // self.substeps * Rays.TICKS
        return whole + jnp.round(part).astype(jnp.int32)

    def _first_ticks(self, dtype: DTypeLike) -> Float[Array, ""]:
        """Ticks of node 0 in its tooth period."""
        part = (self.first % self.substeps).astype(dtype)
        return materialise(part * (Rays.TICKS / self.substeps))


def standing(pose: Pose, index: Int[Array, ""]) -> ToothPass:
    """Pass of a tool that rests.

    Args:
        pose: The pose, shape (3,).
        index: Index of the pose, shape ().
    """
    zero = jnp.zeros((), pose.tip.dtype)
    feed_direction = jnp.zeros(2, pose.tip.dtype).at[1].set(1)
    return ToothPass(pose[None], index, feed_direction, zero, zero, 1)


def cut_interval(
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    b: Float[Array, "u v"],
    c: Float[Array, "u v"],
    tooth: ToothPass,
) -> CutInterval:
    """Interval that a tooth cuts from each ray as it goes around once.

    The height of an upright end is that of the tool as the tooth passes over a column;
    the column counts as reached if the tip reaches it, also on a helix.

    Args:
        cutter: The cutter.
        family: Axis along which the rays run.
        b: Coordinate of each ray along axis (family + 1) % 3 [m], shape (u, v).
        c: Coordinate of each ray along axis (family + 2) % 3 [m], same shape.
        tooth: The pass.

    **Differentiability**: that of `AbstractCutter.intersect` and `intersect_pose`.
    """
    center = tooth.center()
    if tooth.nodes.tip.shape[0] == 1:
        start, stop, is_hit = _intersect_teeth(cutter, family, b, c, center, tooth)
        when = jnp.broadcast_to(tooth.ticks(tooth.passing_node), is_hit.shape)
        return CutInterval(start, stop, is_hit, when, when)
    # Computed once, not by every ray.
    center = materialise(center)
    if center.axis is None and family == 2:
        # Columns are many, and interpolation would cost more than everything else.
        fine = tooth.refined(_COLUMN_PARTS)
        fine = materialise(fine)
        node = fine.when(cutter, b - center.tip[0], c - center.tip[1], None)
        # Of another type than what it comes from: XLA's CPU compiler would else store
        # it in the same place, and then computes one by one.
        node = materialise(jnp.maximum(jnp.round(node).astype(jnp.int32), 0))
        near = fine.nodes.gather(node)
        start, stop, is_hit = _intersect_teeth(cutter, family, b, c, near, tooth)
        when = fine.ticks(node.astype(b.dtype))
        return CutInterval(start, stop, is_hit, when, when)
    # Both ends at once, in a leading axis.
    is_stop = jnp.arange(2, dtype=jnp.int32)[:, None, None] > 0
    u, v = (x[None] for x in _lines(cutter, family, b, c, center))
    pose, node = center, tooth.passing_node
    offset = tooth.offset(cutter, jnp.zeros_like(u))
    start, stop, is_hit = _intersect(cutter, family, u, v, pose, offset)
    for _ in range(_POSE_ITERATIONS):
        end = jnp.where(is_stop, stop, start)
        x, y, height = _tool_coordinates(family, u, v, end, is_hit, pose)
        node = tooth.when(cutter, x, y, height)
        pose = materialise(tooth.at(node))
        offset = tooth.offset(cutter, height)
        start, stop, is_hit = _intersect(cutter, family, u, v, pose, offset)
    if u.shape[1:] != b.shape or v.shape[1:] != b.shape:
        start, stop, is_hit = _intersect(cutter, family, b[None], c[None], pose, offset)
    is_hit = is_hit[0] & is_hit[1] & (start[0] < stop[1])
    when = jnp.broadcast_to(tooth.ticks(node), (2, *b.shape))
    return CutInterval(start[0], stop[1], is_hit, when[0], when[1])


def _lines(
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    b: Float[Array, "u v"],
    c: Float[Array, "u v"],
    center: Pose,
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Coordinates of the rays whose ends determine when all rays are cut.

    Rays above each other see an upright straight side at the same time: one high up
    stands for all.
    """
    if center.axis is not None or cutter.has_helix or cutter.has_corner:
        return b, c
    high = (center.tip[2] + cutter.nominal_radius)[None, None]
    return (b[:, :1], high) if family == 0 else (high, c[:1])


def _intersect(
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    b: Float[Array, "..."],
    c: Float[Array, "..."],
    pose: Pose,
    offset: Float[Array, "..."] | None,
) -> tuple[Float[Array, "..."], Float[Array, "..."], Bool[Array, "..."]]:
    if pose.axis is None:
        return cutter.intersect(family, b, c, pose.tip, offset)
    return cutter.intersect_pose(family, b, c, pose.tip, pose.axis, offset)


def _intersect_teeth(
    cutter: AbstractCutter,
    family: Literal[0, 1, 2],
    b: Float[Array, "u v"],
    c: Float[Array, "u v"],
    pose: Pose,
    tooth: ToothPass,
) -> tuple[Float[Array, "u v"], Float[Array, "u v"], Bool[Array, "u v"]]:
    """Ends that teeth cut in a pose, at any instant at which they look at the rays."""
    offset = tooth.offset(cutter, jnp.zeros_like(b))
    start, stop, is_hit = _intersect(cutter, family, b, c, pose, offset)
    if not (cutter.has_runout and cutter.has_helix):
        return start, stop, is_hit
    # On a helix the edge stands out by another part of the run-out higher up. Columns
    # meet an upright cutter from below alone.
    is_column = pose.axis is None and family == 2
    intersections = []
    for end in (start,) if is_column else (start, stop):
        height = _tool_coordinates(family, b, c, end, is_hit, pose)[2]
        offset = tooth.offset(cutter, height)
        intersections.append(_intersect(cutter, family, b, c, pose, offset))
    (start, _, starts), (_, stop, stops) = intersections[0], intersections[-1]
    return start, stop, starts & stops


def _tool_coordinates(
    family: Literal[0, 1, 2],
    b: Float[Array, "..."],
    c: Float[Array, "..."],
    end: Float[Array, "..."],
    is_hit: Bool[Array, "..."],
    pose: Pose,
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Coordinates of ends along tool x, y and axis from the tip [m].

    Of a ray that is not hit, the place nearest to the tool axis: a tooth that looks
    there may reach it yet.
    """
    tip, f = pose.tip, family
    away_b, away_c = b - tip[..., (f + 1) % 3], c - tip[..., (f + 2) % 3]
    if pose.axis is None:
        along = jnp.where(is_hit, end - tip[..., f], 0)
        # Tool x and y are those of `work`.
        x, y, up = (
            (along, away_b, away_c),
            (away_c, along, away_b),
            (away_b, away_c, along),
        )[f]
        return x, y, up
    axis = pose.axis
    square = 1 - axis[..., f] ** 2
    near = away_b * axis[..., (f + 1) % 3] + away_c * axis[..., (f + 2) % 3]
    is_across = square > 1e-12
    near = near * axis[..., f] / jnp.where(is_across, square, 1)
    near = jnp.where(is_across, near, 0)
    away: list[Array] = [near, near, near]
    away[f] = jnp.where(is_hit, end - tip[..., f], near)
    away[(f + 1) % 3], away[(f + 2) % 3] = away_b, away_c
    place = jnp.stack(jnp.broadcast_arrays(*away), axis=-1)
    frame = Pose.frame(jax.lax.stop_gradient(axis))
    directions = (jnp.broadcast_to(frame[..., i], place.shape) for i in range(3))
    x, y, up = (jnp.sum(place * along, axis=-1) for along in directions)
    return x, y, up


def _turn_between(
    along: Float[Array, "..."], across: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Angle from a direction to a vector [rad], to 2e-5.

    Args:
        along: Part of the vector along the direction, any unit, shape (...).
        across: Part across it, the same unit, shape (...).

    Returns:
        arctan2(across, along) [rad], shape (...), from -pi to pi; finite at zero.

    **Differentiability**: smooth but straight behind and at zero, where it is zero; the
    slope is off by 1e-3 at most.
    """
    x, y = jnp.abs(along), jnp.abs(across)
    greater = jnp.maximum(x, y)
    is_zero = greater < _TINY
    t = jnp.minimum(x, y) / jnp.where(is_zero, 1.0, greater)
    square = t * t
    angle = jnp.zeros_like(t)
    for coefficient in reversed(_ARCTAN):
        angle = angle * square + coefficient
    angle = angle * t
    angle = jnp.where(y > x, math.pi / 2 - angle, angle)
    angle = jnp.where(along < 0, math.pi - angle, angle)
    return jnp.where(is_zero, 0.0, jnp.where(across < 0, -angle, angle))
