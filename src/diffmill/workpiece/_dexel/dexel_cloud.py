"""The pieces of rays that an upright tool would take away: a cloud of points.

Of every ray only the two outermost ends of what is taken are kept. Seen from the tool's
axis the direction to a point turns one way along a ray, so that the ends between them
can bound nothing.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...cutter import AbstractCutter
from ...numerics import Rematerialised
from .._pose import Pose
from .interval import SHORTEST
from .removal import RemovalWindow, window_grid
from .stock import Stock


class RemovedPieces(eqx.Module):
    """Pieces that a removal takes from the rays of one family in a window.

    Attributes:
        low: Lowest end that is taken [m], shape (b, c); finite but without meaning
            where nothing is.
        high: Highest end that is taken [m], shape (b, c), with the same limit.
        is_taken: True if the ray loses anything, shape (b, c).
        b: Coordinate of the rays along axis (family + 1) % 3 [m], shape (b,).
        c: Coordinate of the rays along axis (family + 2) % 3 [m], shape (c,).
    """

    low: Float[Array, "b c"]
    high: Float[Array, "b c"]
    is_taken: Bool[Array, "b c"]
    b: Float[Array, " b"]
    c: Float[Array, " c"]

    @staticmethod
    def of_pass(
        stock: Stock,
        cutter: AbstractCutter,
        window: RemovalWindow,
        tip: Float[Array, " 3"],
    ) -> "tuple[RemovedPieces, RemovedPieces, RemovedPieces]":
        """Pieces that the tool would take from the stock, which stays as it is.

        Args:
            stock: The workpiece.
            cutter: The cutter; its axis is +z.
            window: Size of the window, which is around the tip.
            tip: Tool tip in `work` [m], shape (3,).

        Returns:
            Pieces of the rays along x, y and z.

        Differentiability: in the ends of the stock and in the tip, as long as the same
        interval of a ray holds its outermost end.
        """
        grid = window_grid(stock, cutter, window, [Pose(tip).frozen()])

        def of_family(family: Literal[0, 1, 2]) -> RemovedPieces:
            at, bs, cs = grid.of_family(family)
            ends = stock.families[family].ends
            size = (*bs.shape, *ends.shape[2:])
            # Above the stock there is nothing; and behind a condition the window is
            # read once, not again for each of its uses.
            ends = jax.lax.cond(
                tip[2] < stock.top,
                lambda ends: jax.lax.dynamic_slice(ends, at, size),
                lambda ends: jnp.zeros(size, ends.dtype),
                ends,
            )
            ends = Rematerialised.read(ends)
            start, stop, is_hit = cutter.intersect(family, bs, cs, tip)
            low = jnp.maximum(ends[:, :, 0], start[..., None])
            high = jnp.minimum(ends[:, :, 1], stop[..., None])
            is_piece = is_hit[..., None] & (high - low > SHORTEST)
            is_taken = jnp.any(is_piece, axis=-1)
            least = jnp.min(jnp.where(is_piece, low, jnp.inf), axis=-1)
            most = jnp.max(jnp.where(is_piece, high, -jnp.inf), axis=-1)
            least, most = (jnp.where(is_taken, end, 0) for end in (least, most))
            return RemovedPieces(least, most, is_taken, bs[:, 0], cs[0])

        return of_family(0), of_family(1), of_family(2)
