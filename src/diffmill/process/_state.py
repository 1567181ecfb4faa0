"""State of the process between tooth periods, and what leaves it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..workpiece import Pose, PoseTrack, Stock


class RemovalQueue(eqx.Module):
    """Passes that wait for removal, oldest first, each of one tooth.

    Attributes:
        row: Index k of the pose before which the tooth points along the feed, shape
            (queue,).
        feed_direction: Direction of motion along tool x and y, shape (queue, 2).
        passing_phase: Time at which the tooth points along the feed, in tooth periods
            from pose k - 1, shape (queue,).
        heading: Direction of motion in `work`, that of the last motion where the tool
            rests; zero before the first, shape (queue, 3).
        travel: Distance travelled when the pass came in [m], shape (queue,).
        tooth: The tooth of the pass, shape (queue,); None for a cutter without run-out.
        count: For how many teeth it stands, its own and those before, as `tooth`.
    """

    row: Int[Array, "*queue"]
    feed_direction: Float[Array, "*queue 2"]
    passing_phase: Float[Array, "*queue"]
    heading: Float[Array, "*queue 3"]
    travel: Float[Array, "*queue"]
    tooth: Int[Array, "*queue"] | None = None
    count: Int[Array, "*queue"] | None = None

    def __getitem__(self, item: object) -> "RemovalQueue":
        """Return some of the passes."""
        return jax.tree.map(lambda x: x[item], self)

    def standing_since(self, row: Int[Array, ""]) -> "RemovalQueue":
        """Return a pass that stands for all teeth since that of another row."""
        if self.count is None:
            return self
        return dataclasses.replace(self, count=self.row - row)


class ProcessState(eqx.Module):
    """State of the process between tooth periods.

    Attributes:
        stock: The workpiece, less the poses still in the queue.
        track: Every pose so far, at the ends of the sub-steps.
        last_tip: Tip of the newest at a tooth instant [m], shape (3,).
        recent: Poses in the middle of the sub-steps of the last tooth periods, newest
            first, shape (tooth, substep, 3).
        ends: Poses at the ends of the sub-steps of the last period, which are not in
            the track yet, shape (substep, 3).
        newest: The pass of the newest pose, whether or not it waits.
        passing_phase: Time in the last period at which a tooth pointed along the feed,
            in tooth periods; may be half a period beside it, so that it does not jump,
            shape ().
        queue: What waits for removal.
        queue_count: Number of entries, shape ().
        slots: How many slots of each family of rays hold anything, shape (3,).
        has_overflow: Whether a ray ran out of slots, shape ().
        has_left_window: Whether the tool reached beyond its window, shape ().
    """

    stock: Stock
    track: PoseTrack
    last_tip: Float[Array, " 3"]
    recent: Pose
    ends: Pose
    newest: RemovalQueue
    passing_phase: Float[Array, ""]
    queue: RemovalQueue
    queue_count: Int[Array, ""]
    slots: Int[Array, " 3"]
    has_overflow: Bool[Array, ""]
    has_left_window: Bool[Array, ""]

    @property
    def has_failed(self) -> Bool[Array, ""]:
        """True if a flag is up, shape ()."""
        return self.has_overflow | self.has_left_window

    def ended(self, middles: Pose, ends: Pose) -> "ProcessState":
        """Return the state that keeps the poses of the period just run.

        Args:
            middles: Poses in the middle of its sub-steps, shape (substep, 3).
            ends: Poses at their ends, same shape.
        """
        recent = jax.tree.map(
            lambda new, old: jnp.concatenate([new[None], old[:-1]]),
            middles,
            self.recent,
        )
        return eqx.tree_at(lambda s: (s.recent, s.ends), self, (recent, ends))


class RemovedVolume(eqx.Module):
    """Poses removed in one step, or in several, and what each took [m^3].

    Attributes:
        pose: Their indices, shape (*step, pose).
        volume: All that a pose took [m^3], same shape.
        by_shank: What of it the shank took, above the flutes [m^3], same shape.
    """

    pose: Int[Array, "*step pose"]
    volume: Float[Array, "*step pose"]
    by_shank: Float[Array, "*step pose"]

    @staticmethod
    def nothing(row_count: int, dtype: jnp.dtype) -> "RemovedVolume":
        """Nothing, with room for what the tool stood in and for poses of a track.

        Args:
            row_count: How many poses there are.
            dtype: Floating type.
        """
        pose = jnp.maximum(jnp.arange(-1, row_count, dtype=jnp.int32), 0)
        none = jnp.zeros(row_count + 1, dtype)
        return RemovedVolume(pose, none, none)

    def with_passes(
        self, rows: Int[Array, " queue"], count: Int[Array, ""], cut: "RemovedVolume"
    ) -> "RemovedVolume":
        """The same with what passes took together, each of them as much.

        Args:
            rows: Poses of the passes, the first ones.
            count: How many passes, shape (); 0 where the tool stands at the start.
            cut: What they took.
        """
        number = jnp.arange(rows.size, dtype=jnp.int32)
        nowhere = self.volume.size
        at = jnp.where(number < count, rows + 1, nowhere)
        at = at.at[0].set(jnp.where(count > 0, at[0], 0))

        def add(before: Array, taken: Array) -> Array:
            share = jnp.sum(taken) / jnp.maximum(count, 1).astype(taken.dtype)
            return before.at[at].add(share, mode="drop")

        return RemovedVolume(
            self.pose, add(self.volume, cut.volume), add(self.by_shank, cut.by_shank)
        )
