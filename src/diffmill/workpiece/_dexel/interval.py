"""An interval that is cut from each ray, and the pieces that it leaves."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .stock import Rays

# Pieces of a ray shorter than this are dropped and counted as removed [m].
SHORTEST = 1e-9


class RemainingPieces(eqx.Module):
    """Pieces of rays that a cut leaves.

    Attributes:
        ends: Lower and upper ends [m], shape (..., 2, slot).
        cut_by: Ticks at which these ends were cut, same shape.
        is_full: True if a piece found no free slot, shape (...).
    """

    ends: Float[Array, "*ray 2 slot"]
    cut_by: Int[Array, "*ray 2 slot"]
    is_full: Bool[Array, "*ray"]


class CutInterval(eqx.Module):
    """Interval that a tool cuts from each ray.

    Attributes:
        start: Lower end [m], shape (...).
        stop: Upper end [m], same shape.
        is_cut: True if the tool cuts the ray, same shape.
        started: Tick at which the lower end was cut, same shape.
        stopped: Tick at which the upper end was cut, same shape.
    """

    start: Float[Array, "..."]
    stop: Float[Array, "..."]
    is_cut: Bool[Array, "..."]
    started: Int[Array, "..."]
    stopped: Int[Array, "..."]

    @staticmethod
    def none(like: Float[Array, "..."]) -> "CutInterval":
        """Interval of rays that are not cut, as many as there are of some numbers."""
        zero, tick = jnp.zeros_like(like), jnp.zeros(like.shape, jnp.int32)
        return CutInterval(zero, zero, jnp.zeros(like.shape, bool), tick, tick)

    def is_apart(self, other: "CutInterval", gap: Float[Array, ""]) -> Bool[Array, ""]:
        """True if on a ray that both cut more than a gap [m] lies between them."""
        far = (other.start > self.stop + gap) | (other.stop < self.start - gap)
        return jnp.any(self.is_cut & other.is_cut & far)

    def joined(self, other: "CutInterval", is_due: Bool[Array, ""]) -> "CutInterval":
        """Interval from the lower start to the higher stop, gaps included.

        Args:
            other: The other interval.
            is_due: Whether it counts, shape ().
        """
        is_cut = other.is_cut & is_due
        has_start = is_cut & ~(self.is_cut & (self.start <= other.start))
        has_stop = is_cut & ~(self.is_cut & (self.stop >= other.stop))
        return CutInterval(
            jnp.where(has_start, other.start, self.start),
            jnp.where(has_stop, other.stop, self.stop),
            self.is_cut | is_cut,
            jnp.where(has_start, other.started, self.started),
            jnp.where(has_stop, other.stopped, self.stopped),
        )

    def subtract_from(
        self,
        ends: Float[Array, "*ray 2 slot"],
        poses: Int[Array, "*ray 2 slot"],
    ) -> RemainingPieces:
        """Pieces of the rays without the interval.

        Args:
            ends: Lower and upper ends [m], shape (..., 2, slot).
            poses: Ticks at which these ends were cut, shape (..., 2, slot).

        Differentiability: smooth in both ends wherever the order of the ends does not
        change.
        """
        low, high = ends[..., 0, :], ends[..., 1, :]
        start, stop, is_cut = (
            x[..., None] for x in (self.start, self.stop, self.is_cut)
        )
        started, stopped = self.started[..., None], self.stopped[..., None]

        # Each branch computes `is_met` anew: it is cheaper than to hand it over.
        def trim() -> RemainingPieces:
            is_met = is_cut & (high > low) & (start < high) & (stop > low)
            keeps_low = is_met & (low < start - SHORTEST)
            keeps_high = is_met & (high > stop + SHORTEST)
            is_gone = is_met & ~keeps_low & ~keeps_high
            new_low = jnp.where(
                is_gone, Rays.DEAD, jnp.where(is_met & ~keeps_low, stop, low)
            )
            new_high = jnp.where(is_gone, -Rays.DEAD, jnp.where(keeps_low, start, high))
            low_pose = jnp.where(is_met & ~keeps_low, stopped, poses[..., 0, :])
            high_pose = jnp.where(keeps_low, started, poses[..., 1, :])
            is_full = jnp.zeros(low.shape[:-1], bool)
            return RemainingPieces(
                _two(new_low, new_high), _two(low_pose, high_pose), is_full
            )

        def is_split() -> Bool[Array, "*ray slot"]:
            return is_cut & (low < start - SHORTEST) & (high > stop + SHORTEST)

        def split() -> RemainingPieces:
            # The interval to remove lies inside at most one piece: one slot is enough.
            trimmed = trim()
            is_live, splits = high > low, is_split()
            needs = jnp.any(splits, axis=-1, keepdims=True)
            free = jnp.argmin(is_live, axis=-1)[..., None]
            slots = jnp.arange(low.shape[-1]).reshape((1,) * (low.ndim - 1) + (-1,))
            takes = (needs & ~is_live & (slots == free))[..., None, :]
            # A sum, of which reverse mode keeps no more than which piece it was.
            upper_end = jnp.sum(jnp.where(splits, high, 0), axis=-1, keepdims=True)
            least = jnp.iinfo(poses.dtype).min
            upper_pose = jnp.where(splits, poses[..., 1, :], least)
            upper_pose = jnp.max(upper_pose, axis=-1, keepdims=True)
            return RemainingPieces(
                jnp.where(takes, _two(stop, upper_end), trimmed.ends),
                jnp.where(takes, _two(stopped, upper_pose), trimmed.cut_by),
                needs[..., 0] & jnp.all(is_live, axis=-1),
            )

        # Pieces to split are rare along the axis and the search for slots is dear.
        return jax.lax.cond(jnp.any(is_split()), split, trim)


def _two(low: Float[Array, "*n"] | Int[Array, "*n"], high: Array) -> Array:
    return jnp.stack([low, high], axis=-2)
