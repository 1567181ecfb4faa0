"""State of the process: the stock, and the queue of poses not yet removed from it.

Removal lags behind the tool by a travelled distance of at least sqrt(R d), the
distance at which the freshly cut surface has left the smoothing band; the history
that spans it is a queue of fixed length whose entries are a minimum distance apart,
so that a slow or dwelling tool cannot fill it. Only where the tool turns or stops, so
that what it cuts there no other pose cuts, a pose comes in sooner.
"""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._arrays import is_traced
from ..cutter import AbstractCutter
from ..numerics import Rematerialised
from ..workpiece import (
    Pose,
    PoseTrack,
    RemovalWindow,
    Stock,
    ToothPass,
)
from ._chip import safe_norm
from ._engagement.leading_half import STILL
from ._state import ProcessState, RemovalQueue, RemovedVolume
from ._stock_derivatives import AbstractAdjoint

# Entries of the history along a straight path: the lag is so many least distances.
_ALONG = 48
# Further entries where the tool turns or stops: one that trembles fills these.
_AT_TURNS = 16
QUEUE_LENGTH = _ALONG + _AT_TURNS
# Cosine of the turn, 0.3 rad, from which on a pose comes in: within the least distance
# a path that turns by less bulges by an eighth of this, 1 um for a cutter of 10 mm.
_TURNED = math.cos(0.3)
# After a shorter way no pose comes in [m]: so much of a corner may stay uncut.
_LEAST_WAY = 5e-7
# Earlier circles, as shares of the lag, beyond the exact ones of the last teeth.
_DECIMATED = (0.25, 0.5, 0.75, 1.0)
# Rows of the track that removal looks back on at most: what waits longer is removed.
_HISTORY = 512
# Two poses at most leave the history in a step, so that it shrinks after slow feed.
_REMOVALS = 2


class RemovalHistory(NamedTuple):
    """The poses that wait for removal, and how it lags behind them.

    Attributes:
        cutter: The milling cutter.
        window: Window of rays of a removal.
        removal_lag: Travelled distance by which removal lags [m].
        substeps: Sub-steps per tooth period.
        spacing: Spacing of the rays [m].
        derivative: How to differentiate through the removal.
    """

    cutter: AbstractCutter
    window: RemovalWindow
    removal_lag: float
    substeps: int
    spacing: float
    derivative: AbstractAdjoint

    @property
    def row_count(self) -> int:
        """Rows that removal looks back on at most, in whole turns."""
        flutes = self.cutter.flute_count
        return (-(-_HISTORY // flutes) + 2) * flutes

    @property
    def standing_rows(self) -> int:
        """Rows behind the last pose at which the last passes look."""
        return self._wait() + math.ceil(self._pass_length() / self.substeps) + 1

    @property
    def circle_count(self) -> int:
        """Earlier circles beyond those of the last teeth."""
        return len(_DECIMATED)

    def begin(self, stock: Stock, pose: Pose, pose_count: int) -> ProcessState:
        """Return the state at pose 0, where the tool has removed nothing yet.

        Args:
            stock: The raw workpiece.
            pose: Pose 0, shape (3,).
            pose_count: Number of poses of the whole run.
        """
        cutter, dtype = self.cutter, stock.origin.dtype
        nodes = max((pose_count - 1) * self.substeps + 1, self._pass_length())
        waiting = RemovalQueue(
            row=jnp.zeros(QUEUE_LENGTH, jnp.int32),
            feed_direction=jnp.zeros((QUEUE_LENGTH, 2), dtype).at[:, 1].set(1),
            passing_phase=jnp.zeros(QUEUE_LENGTH, dtype),
            heading=jnp.zeros((QUEUE_LENGTH, 3), dtype),
            travel=jnp.zeros(QUEUE_LENGTH, dtype),
        )
        if cutter.has_runout:
            # What the tool stands in at the start all its teeth cut.
            tooth = jnp.zeros(QUEUE_LENGTH, jnp.int32)
            count = jnp.full_like(tooth, cutter.flute_count)
            waiting = dataclasses.replace(waiting, tooth=tooth, count=count)
        families = tuple(rays.numbered() for rays in stock.families)
        return ProcessState(
            stock=eqx.tree_at(lambda s: s.families, stock, families),
            track=PoseTrack(pose.repeated(nodes), self.substeps),
            last_tip=pose.tip,
            recent=pose.repeated(cutter.flute_count, self.substeps),
            ends=pose.repeated(self.substeps),
            newest=waiting[0],
            passing_phase=jnp.zeros((), dtype),
            queue=waiting,
            queue_count=jnp.ones((), jnp.int32),
            slots=stock.slots_in_use(),
            has_overflow=jnp.zeros((), bool),
            has_left_window=jnp.zeros((), bool),
        )

    def advance(
        self,
        state: ProcessState,
        index: Int[Array, ""],
        pose: Pose,
    ) -> tuple[ProcessState, RemovedVolume]:
        """Enter a pose in the history, and remove up to two passes behind the lag.

        As long as the tool has not moved, what it stands in is removed.

        Args:
            state: State after the period that ends at the pose.
            index: Index k of the pose, shape ().
            pose: Pose k, shape (3,).

        Returns:
            The state and what was removed.
        """
        state = self.enter(state, index, pose)
        return self._remove_lagged(state, index)

    def enter(
        self,
        state: ProcessState,
        index: Int[Array, ""],
        pose: Pose,
    ) -> ProcessState:
        """Enter a period's poses in the track, and its pass in the queue if far on.

        Args:
            state: State after the period that ends at the pose.
            index: Index k of the pose, shape ().
            pose: Pose k, shape (3,).

        Returns:
            The state.
        """
        frozen = jax.lax.stop_gradient
        # Reading the track before it is written would make XLA copy it in every step.
        motion = frozen(pose.tip - state.last_tip)
        track = tracked(state, index, pose)
        newest, passing_phase = self._newest(state, index, frozen(pose), motion)
        count, last = state.queue_count, state.queue[state.queue_count - 1]
        way = newest.travel - last.travel
        gap = self.removal_lag / _ALONG
        behind = newest.travel - state.queue.travel[0]
        has_room = count.astype(way.dtype) < _AT_TURNS + behind / gap
        is_apart = (way >= _LEAST_WAY) & has_room & (count < QUEUE_LENGTH - 1)
        # Only the way on shows that the pose before stood in a corner.
        cosine = jnp.sum(newest.heading * last.heading)
        has_turned = cosine < _TURNED * jnp.sum(last.heading**2)
        is_corner = has_turned & is_apart & (state.newest.row > last.row)
        step = safe_norm(motion)
        way = jnp.where(is_corner, step, way)
        is_due = (way >= gap) | ((step <= STILL) & is_apart & ~is_corner)
        numbers = jnp.stack([count, count + is_corner.astype(jnp.int32)])
        at = jnp.where(jnp.stack([is_corner, is_due]), numbers, QUEUE_LENGTH)
        queue = jax.tree.map(
            lambda queue, *new: queue.at[at].set(jnp.stack(new), mode="drop"),
            state.queue,
            state.newest.standing_since(last.row),
            newest.standing_since(jnp.where(is_corner, state.newest.row, last.row)),
        )
        return eqx.tree_at(
            lambda s: (
                s.track,
                s.last_tip,
                s.newest,
                s.passing_phase,
                s.queue,
                s.queue_count,
            ),
            state,
            (
                track,
                pose.tip,
                newest,
                passing_phase,
                queue,
                numbers[1] + is_due.astype(jnp.int32),
            ),
        )

    def _newest(
        self,
        state: ProcessState,
        index: Int[Array, ""],
        pose: Pose,
        motion: Float[Array, " 3"],
    ) -> tuple[RemovalQueue, Float[Array, ""]]:
        """Pass of the newest pose, and the phase at which an even tooth points ahead.

        Which of the teeth it is follows the direction without a jump, so that where
        the direction trembles no tooth is left out.
        """
        cutter, frame = self.cutter, Pose.frame(pose.direction())
        x, y = jnp.sum(motion * frame[:, 0]), jnp.sum(motion * frame[:, 1])
        along, length = jnp.sqrt(x**2 + y**2), safe_norm(motion)
        is_moving = along > STILL
        scale = jnp.where(is_moving, along, 1.0)
        feed_direction = jnp.where(
            is_moving, jnp.stack([x, y]) / scale, state.newest.feed_direction
        )
        heading = jnp.where(
            length > STILL, motion / jnp.maximum(length, STILL), state.newest.heading
        )
        count = cutter.flute_count
        turn = jnp.arctan2(feed_direction[0], feed_direction[1]) * (
            count / (2 * math.pi)
        )
        phase = turn + jnp.round(state.passing_phase - turn)
        is_beside = (phase < -0.5) | (phase >= 1.5)
        phase = jnp.where(is_beside, phase - jnp.floor(phase), phase)
        tooth = 1 - index - jnp.round(phase - turn).astype(jnp.int32)
        tooth = jnp.mod(tooth, count)
        late = jnp.zeros_like(phase)
        if not cutter.has_even_pitch:
            early = early_teeth(cutter, pose.tip.dtype)
            late = -early[tooth] * (count / (2 * math.pi))
        travel = state.newest.travel + length
        newest = RemovalQueue(index, feed_direction, phase + late, heading, travel)
        if cutter.has_runout:
            one = jnp.ones_like(index)
            newest = dataclasses.replace(newest, tooth=tooth, count=one)
        return newest, phase

    def _remove_lagged(
        self,
        state: ProcessState,
        index: Int[Array, ""],
    ) -> tuple[ProcessState, RemovedVolume]:
        """Remove up to two passes that the tool has left behind by the lag.

        Args:
            state: The state, with the newest pose.
            index: Index of that pose, shape ().

        Returns:
            The state and what was removed.
        """
        oldest = state.queue[:_REMOVALS]
        passes = [self._tooth_pass(state, oldest[i], index) for i in range(_REMOVALS)]
        age = state.newest.travel - oldest.travel
        places = jnp.arange(_REMOVALS, dtype=jnp.int32)
        is_over = index - oldest.row >= self._wait()
        is_full = state.queue_count >= QUEUE_LENGTH
        is_late = (is_full | (index - oldest.row[0] >= _HISTORY)) & (places == 0)
        # The newest stays: what comes in is measured against it.
        is_due = ((age >= self.removal_lag) & is_over) | is_late
        is_due = is_due & (places < state.queue_count - 1)
        tips = [tooth.center().frozen().tip for tooth in passes]
        apart = jnp.max(jnp.abs(tips[1] - tips[0]))
        is_due = is_due.at[1].set(is_due[0] & is_due[1] & (apart <= self.window.slack))
        # Removed here, too, since a removal of its own would take long to compile.
        stands = (state.newest.travel <= 0) & (places == 0)
        cut = self.window.remove_passes(
            state.stock,
            self.cutter,
            passes,
            is_due | stands,
            slots=state.slots,
        )
        count = jnp.sum(is_due, dtype=jnp.int32)
        removed = RemovedVolume(oldest.row, cut.volume, cut.by_shank)
        return _with_cut(state, cut, count), removed

    def has_room(self, state: ProcessState) -> Bool[Array, ""]:
        """True if the poses of another period can wait."""
        return state.queue_count <= QUEUE_LENGTH - 2 * _REMOVALS

    def remove_behind(
        self,
        state: ProcessState,
        removed: RemovedVolume,
        ahead: Float[Array, ""],
        matters: Bool[Array, " row"] | None = None,
    ) -> tuple[ProcessState, RemovedVolume]:
        """Remove all passes that the tool has left behind by the lag, many at once.

        Passes that are near to each other take one interval of each ray together. A
        scallop between two of them, of f^2 / (8 R), goes with them where it is low.

        # symbols: f way of the tool in a tooth period, R radius

        Args:
            state: The state.
            removed: What was removed before, as of `RemovedVolume.nothing`.
            ahead: Way of the tool until the stock is read [m], shape ().
            matters: Which poses of the track cut anything that is read later: the
                others remove nothing. All of them if not given.

        Returns:
            The state, and what is removed by then.

        **Differentiability**: in forward mode.
        """
        index = state.newest.row

        def due(state: ProcessState) -> Int[Array, ""]:
            age = state.newest.travel + ahead - state.queue.travel
            places = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32)
            periods = index - state.queue.row
            is_due = (age >= self.removal_lag) & (periods >= self._wait())
            is_due |= periods >= _HISTORY
            is_due &= places < state.queue_count - 1
            way = state.queue.travel - state.queue.travel[0]
            is_near = way <= self.window.slack
            if matters is not None:
                of_queue = matters[state.queue.row]
                is_due &= of_queue == of_queue[0]
                is_near |= ~of_queue[0]
            is_due &= is_near
            count = jnp.sum(jnp.cumprod(is_due.astype(jnp.int32)), dtype=jnp.int32)
            # Where the shank begins is told by the height of one pass.
            return jnp.minimum(count, 1) if self.window.has_shank else count

        def remove(given):
            state, removed, count, _ = given
            queue = state.queue
            # One that stands is no pass that is over.
            cuts = jnp.maximum(count, 1)
            if matters is not None:
                cuts = jnp.where(matters[queue.row[0]], cuts, 0)
            cut, number = self.window.remove_together(
                state.stock,
                self.cutter,
                lambda k: self._tooth_pass(state, queue[k], index),
                cuts,
                slots=state.slots,
            )
            gone = jnp.where((cuts > 0) & (count > 0), number, count)
            state = _with_cut(state, cut, gone)
            taken = RemovedVolume(queue.row[:1], cut.volume, cut.by_shank)
            removed = removed.with_passes(queue.row, gone, taken)
            count = due(state)
            return state, removed, count, count > 0

        # As long as the tool has not moved, what it stands in is removed.
        stands = state.newest.travel <= 0
        count = due(state)
        given = state, removed, count, stands | (count > 0)
        state, removed, *_ = jax.lax.while_loop(lambda c: c[3], remove, given)
        return state, removed

    def decimated_poses(self, state: ProcessState) -> Pose:
        """Return the newest poses in the queue at given distances behind the tool."""
        rows = self.decimated_rows(state)
        nodes = rows * state.track.substeps
        return Rematerialised.read(state.track.poses.gather(nodes))

    def decimated_rows(self, state: ProcessState) -> Int[Array, " circle"]:
        """Indices of the decimated poses, those at tooth instants."""
        slots = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32)
        age = state.newest.travel - state.queue.travel
        picks = []
        for share in _DECIMATED:
            is_old = (age >= share * self.removal_lag) & (slots < state.queue_count)
            picks.append(jnp.max(jnp.where(is_old, slots, 0)))
        # What a run before this one did long ago stands where the track begins.
        return jnp.maximum(state.queue.row[jnp.stack(picks)], 0)

    def finish(
        self,
        state: ProcessState,
        index: Int[Array, ""],
        pose: Pose,
        pose_count: int | Int[Array, ""],
    ) -> tuple[ProcessState, RemovedVolume]:
        """Remove all that the history still holds, the last pose included.

        Args:
            state: State after the last period.
            index: Index of the last pose, shape ().
            pose: The last pose, shape (3,).
            pose_count: Number of poses of the run, and of periods behind the last pose.

        Returns:
            The state with an empty history, and what was removed.
        """
        cutter, window = self.cutter, self.window
        newest: Int[Array, ""] = jnp.asarray(pose_count - 1, jnp.int32)
        state = self.enter(state, newest, pose)
        slots = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32)
        # After the last pose the tool stands there while its teeth go around.
        rest = jnp.arange(1 + self._wait(), dtype=jnp.int32)

        def standing(later: Int[Array, ""]) -> RemovalQueue:
            row, newest = index + later, state.newest
            each = dataclasses.replace(
                newest, row=row, passing_phase=state.passing_phase
            )
            if newest.tooth is None:
                return each
            tooth = jnp.mod(newest.tooth + newest.row - row, cutter.flute_count)
            return dataclasses.replace(each, tooth=tooth, count=1 + later)

        last = jax.vmap(standing)(rest)
        rows = jax.tree.map(
            lambda queue, new: jnp.concatenate([queue, new]), state.queue, last
        )
        is_due = jnp.concatenate([slots < state.queue_count, jnp.ones(rest.size, bool)])

        def remove(carry, x):
            stock, has_overflow, has_left_window = carry
            row, due = x
            tooth = self._tooth_pass(state, row, newest)
            cut = window.remove_passes(stock, cutter, [tooth], due[None])
            flags = (
                has_overflow | cut.has_overflow,
                has_left_window | cut.has_left_window,
            )
            return (cut.stock, *flags), (cut.volume[0], cut.by_shank[0])

        carry = (state.stock, state.has_overflow, state.has_left_window)
        (stock, full, beyond), (volume, by_shank) = jax.lax.scan(
            remove, carry, (rows, is_due)
        )
        slots_in_use = stock.slots_in_use()
        state = eqx.tree_at(
            lambda s: (
                s.stock,
                s.queue_count,
                s.slots,
                s.has_overflow,
                s.has_left_window,
            ),
            state,
            (stock, jnp.zeros((), jnp.int32), slots_in_use, full, beyond),
        )
        return state, RemovedVolume(jnp.minimum(rows.row, index), volume, by_shank)

    def _tooth_pass(
        self,
        state: ProcessState,
        waiting: RemovalQueue,
        newest: Int[Array, ""],
    ) -> ToothPass:
        """Return a pass in the queue.

        Args:
            state: The state.
            waiting: The pass, as it stands in the queue.
            newest: Index of the newest pose that is known, shape ().
        """
        S, count = self.substeps, self._pass_length()
        table = state.track.poses
        start = (waiting.row - 1) * S
        steps = waiting.passing_phase * S
        ahead = self._lead_turns() * self.cutter.flute_count * S
        first = start + jnp.floor(steps - ahead).astype(jnp.int32)
        first = jnp.clip(first, 0, table.tip.shape[0] - count)
        nodes = jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, first, count), table
        )
        number = lambda value: value.astype(steps.dtype)
        teeth = None
        if waiting.tooth is not None and waiting.count is not None:
            every = jnp.arange(self.cutter.flute_count, dtype=jnp.int32)
            before = jnp.mod(every - waiting.tooth, self.cutter.flute_count)
            teeth = before < waiting.count
        return ToothPass(
            nodes=self.derivative.removal_poses(nodes),
            first=first,
            feed_direction=waiting.feed_direction,
            passing_node=number(start - first) + steps,
            last=number(jnp.clip(newest * S - first, 0, count - 1)),
            substeps=S,
            teeth=teeth,
        )

    def _pass_length(self) -> int:
        """Nodes that one turn of a tooth spans, its helix included."""
        turns = 1 + self._helix_turns()
        return math.ceil(turns * self.cutter.flute_count * self.substeps) + 3

    def _lead_turns(self) -> float | Float[Array, ""]:
        """Return by how many turns a pass begins before its tooth looks forward.

        Higher up the edge of a right-hand helix follows the tip, that of a left-hand
        one is ahead of it: a pass is then as long, but begins earlier. Where the angle
        is traced, shape ().
        """
        angle, turns = self.cutter.helix_angle, self._helix_turns()
        if not self.cutter.has_helix:
            return 0.5
        if is_traced(angle):
            return jnp.where(angle < 0, 0.5 + turns, 0.5)
        return 0.5 + turns if float(angle) < 0 else 0.5

    def _helix_turns(self) -> float:
        """Return by how much the helix turns up to the highest edge in stock, in turns.

        Where the angle or a size is traced this is not known, and taken to be one turn:
        what lies beyond that on a steeper helix is taken to look when the end of that
        turn does.
        """
        cutter, window = self.cutter, self.window
        if not cutter.has_helix:
            return 0.0
        sizes = (window.length, cutter.flute_length, cutter.nominal_radius)
        if is_traced((cutter.helix_angle, sizes)):
            return 1.0
        # Within a trace, arithmetic of arrays that are known would be traced, too.
        length, flute_length, radius = (float(size) for size in sizes)
        height = min(length or window.sizes[2] * self.spacing, flute_length)
        lead = abs(math.tan(float(cutter.helix_angle)))
        return height * lead / (2 * math.pi * radius)

    def _wait(self) -> int:
        """Return after how many periods the tooth of a pass has gone around.

        On a left-hand helix it has earlier; but so many passes behind the last pose
        still look at it, higher up, where the edge is ahead of the tip.
        """
        turns = 0.5 + self._helix_turns()
        # One for the period itself, and a half that the tooth may look forward later.
        return math.ceil(turns * self.cutter.flute_count + 1.5)


def _with_cut(state: ProcessState, cut: PyTree, count: Int[Array, ""]) -> ProcessState:
    """State with a stock that was cut, and without the oldest passes of its queue.

    Args:
        state: The state.
        cut: Result of a removal by `RemovalWindow`.
        count: How many passes leave the queue, shape ().
    """
    shift = jnp.arange(QUEUE_LENGTH, dtype=jnp.int32) + count
    return eqx.tree_at(
        lambda s: (
            s.stock,
            s.queue,
            s.queue_count,
            s.slots,
            s.has_overflow,
            s.has_left_window,
        ),
        state,
        (
            cut.stock,
            state.queue[jnp.minimum(shift, QUEUE_LENGTH - 1)],
            state.queue_count - count,
            cut.slots,
            state.has_overflow | cut.has_overflow,
            state.has_left_window | cut.has_left_window,
        ),
    )


def tracked(state: ProcessState, index: Int[Array, ""], pose: Pose) -> PoseTrack:
    """Return the track with the poses of the last period, up to pose `index`."""
    substeps = state.track.substeps
    ends = jax.tree.map(
        lambda x, last: jnp.concatenate([x[:-1], last[None]]), state.ends, pose
    )
    first = jnp.maximum((index - 1) * substeps + 1, 0)
    return PoseTrack(state.track.poses.with_rows(first, ends), substeps)


def early_teeth(cutter: AbstractCutter, dtype: DTypeLike) -> Float[Array, " tooth"]:
    """Return by how much each tooth stands ahead of an even one [rad], a constant."""
    count = cutter.flute_count
    pitch = jax.lax.stop_gradient(jnp.asarray(cutter.pitch_angles, dtype))
    even = 2 * math.pi / count * jnp.arange(count, dtype=dtype)
    return jnp.mod(pitch - even + math.pi, 2 * math.pi) - math.pi
