"""Walls that a run makes: deviation and contour error when the teeth pass them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import on_device
from ..._types import FloatRows3, FloatSteps
from ...cutter import AbstractCutter
from ...numerics import CachedJit
from ...process import feed_angles, wall_deviation, wall_shares
from ...toolpath import contour_error
from ...workpiece import Stock
from .path_segments import Segments

# Rows to either side on which the wall of a row depends: those that the contour error
# searches, and a turn of the cutter.
_AROUND = 64


class Walls(eqx.Module):
    """Walls of a run.

    Attributes:
        deviation: As `Solution.surface_deviation`.
        share: As `Solution.wall_share`.
        contour_error: As of `Solution`.
    """

    deviation: FloatRows3
    share: FloatSteps
    contour_error: FloatSteps


class WallRows(eqx.Module):
    """Rows of a run from which its walls follow.

    Attributes:
        desired: Where the tip should be [m], shape (step, 3).
        axes: Tool axes, shape (step, 3); None if upright.
        disturbance: As of `Path`.
        ends: As of `Run`.
        first_row: Row of the path that is the first of these, shape ().
        feed_before: Angle of the feed before it [rad], as of `feed_angles`, shape ().
    """

    desired: FloatRows3
    axes: FloatRows3 | None
    disturbance: FloatRows3 | None
    ends: Float[Array, "step substep 3"] | Float[np.ndarray, "step substep 3"]
    first_row: Int[Array, ""] | int = 0
    feed_before: Float[Array, ""] | None = None

    def walls(self, cutter: AbstractCutter, finished: Stock) -> Walls:
        """Walls of the rows.

        Args:
            cutter: The cutter.
            finished: Stock that the rigid cut leaves.
        """
        desired = jnp.asarray(self.desired)
        share = wall_shares(
            desired,
            self.axes,
            cutter,
            finished,
            first_row=self.first_row,
            feed_before=self.feed_before,
        )
        deviation = wall_deviation(jnp.asarray(self.ends), desired, share)
        if self.disturbance is not None:
            deviation = deviation + jnp.asarray(self.disturbance, deviation.dtype)
        error = contour_error(desired + deviation, desired)
        return Walls(deviation, share, error)

    def long_walls(
        self, cutter: AbstractCutter, finished: Stock, segments: Segments
    ) -> Walls:
        """Walls of all rows of a long path on the host, segment by segment.

        Arguments as of `walls`, and:
            segments: The segments of the path.
        """
        total, dtype = segments.total, np.asarray(self.ends).dtype
        found = Walls(np.zeros((total, 3), dtype), *np.zeros((2, total), dtype))
        feed = on_device(np.zeros((), dtype))
        for segment in segments:
            at = segment.rows(_AROUND, _AROUND)
            cut = lambda x, at=at: np.asarray(x)[at]
            rows = jax.tree.map(cut, (self.desired, self.axes, self.disturbance))
            ends = cut(self.ends)
            # Behind the last row the tool stands.
            ends[_AROUND + total - segment.first :] = self.ends[-1, -1]
            first = on_device(np.asarray(segment.first - _AROUND, np.int32))
            desired, axes, disturbance = jax.tree.map(on_device, rows)
            window = WallRows(desired, axes, disturbance, on_device(ends), first, feed)
            walls, feed = _walls_of(window, cutter, finished)
            own = lambda x: np.asarray(x)[_AROUND:]
            segment.put(found, jax.tree.map(own, walls))
        return found


@CachedJit
def _walls_of(
    rows: WallRows, cutter: AbstractCutter, finished: Stock
) -> tuple[Walls, Float[Array, ""]]:
    """Walls of a segment with rows around it, and the feed before those of the next."""
    feed = feed_angles(jnp.asarray(rows.desired), rows.axes, rows.feed_before)
    return rows.walls(cutter, finished), feed[-2 * _AROUND - 2]
