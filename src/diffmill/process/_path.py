"""Paths of the tool: poses at the tooth instants, and within the periods between."""

from typing import NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._padding import last_row
from .._types import FloatRows3, IntScalar
from ..cutter import AbstractCutter
from ..workpiece import Pose, Stock

# Steeper descent than this cuts with the bottom.
_DESCENT = 0.01


def within_periods(
    positions: Float[Array, "step 3"], shares: Float[Array, " substep"]
) -> Float[Array, "period substep 3"]:
    """Tips within the periods between given instants.

    Cubic through the two instants, with the slopes of their neighbours (Catmull-Rom):
    a chip is the difference of two such positions, and with straight lines between
    the instants a shaking tool would cut a different chip.

    Args:
        positions: Tip at the tooth instants [m], shape (step, 3).
        shares: Share of the period at which to look, shape (substep,).

    Returns:
        Tips [m], shape (step - 1, substep, 3).

    Differentiability: linear.
    """
    first = 2 * positions[:1] - positions[1:2]
    last = 2 * positions[-1:] - positions[-2:-1]
    padded = jnp.concatenate([first, positions, last])
    p0, p1, p2, p3 = (padded[i : i + positions.shape[0] - 1, None] for i in range(4))
    t = shares[None, :, None]
    # From differences only, so that a tool that stands still stands exactly still.
    rise, start, stop = p2 - p1, 0.5 * (p2 - p0), 0.5 * (p3 - p1)
    bend = 3 * rise - 2 * start - stop + t * (start + stop - 2 * rise)
    return p1 + t * (start + t * bend)


class PosesWithin(NamedTuple):
    """Poses within the periods of a path.

    Attributes:
        middles: In the middle of the sub-steps, shape (period, substep, 3).
        ends: At their ends, same shape; behind the last row that counts the tool is at
            rest.
    """

    middles: Pose
    ends: Pose


def poses_within(
    substeps: int, path: Pose, row_count: IntScalar | None = None
) -> PosesWithin:
    """Return the poses within the periods between given instants.

    Args:
        substeps: Sub-steps per tooth period.
        path: Poses at the tooth instants, shape (step, 3).
        row_count: How many of them count; all if None.
    """
    middles, ends = (
        _between(path, shares(substeps, path.tip.dtype), row_count)
        for shares in (substep_middles, substep_ends)
    )
    if row_count is None:
        return PosesWithin(middles, ends)
    count = path.tip.shape[0]
    is_live = jnp.arange(1, count, dtype=jnp.int32) < row_count
    rest = path[last_row(count, row_count)]
    ends = jax.tree.map(
        lambda x, end: jnp.where(is_live[:, None, None], x, end), ends, rest
    )
    return PosesWithin(middles, ends)


def _between(
    path: Pose, shares: Float[Array, " substep"], row_count: IntScalar | None
) -> Pose:
    if row_count is not None:
        # The curve through the last rows goes on behind them as at the path's end.
        end = last_row(path.tip.shape[0], row_count)
        ahead = lambda rows: rows.at[row_count].set(
            2 * rows[end] - rows[end - 1], mode="drop"
        )
        path = jax.tree.map(ahead, path)
    tip = within_periods(path.tip, shares)
    if path.axis is None:
        return Pose(tip)
    axis = within_periods(path.axis, shares)
    return Pose(tip, axis / jnp.linalg.norm(axis, axis=-1, keepdims=True))


def substep_middles(substeps: int, dtype: jnp.dtype) -> Float[Array, " substep"]:
    """Return the middle of each sub-step as a share of the tooth period."""
    return (jnp.arange(substeps, dtype=dtype) + 0.5) / substeps


def substep_ends(substeps: int, dtype: jnp.dtype) -> Float[Array, " substep"]:
    """Return the end of each sub-step as a share of the tooth period."""
    return (jnp.arange(substeps, dtype=dtype) + 1) / substeps


class Immersion(NamedTuple):
    """Immersion of a path of the tool in the stock.

    Attributes:
        depth: How deep it goes below the top of the stock [m].
        plunges: Whether it descends below the top with its end ahead.
    """

    depth: float
    plunges: bool

    @classmethod
    def of_path(
        cls, positions: FloatRows3, stock: Stock, cutter: AbstractCutter
    ) -> "Immersion":
        """Return the immersion of a path.

        Args:
            positions: Tool tip in `work` [m], shape (step, 3); may be traced.
            stock: The raw workpiece.
            cutter: The cutter.

        Returns:
            The deepest immersion of a path known on the host. What a traced path hides
            is taken at its widest: the height of the stock or of the flutes, whichever
            is less.
        """
        height = stock.families[0].ends.shape[1] * stock.spacing
        if isinstance(positions, jax.core.Tracer):
            return cls(min(cutter.flute_length, height), True)
        deepest = stock.top - float(np.min(np.asarray(positions)[:, 2]))
        depth = min(max(deepest, 0.0) + stock.spacing, height)
        return cls(depth, cls.is_plunging(positions, stock.top))

    @staticmethod
    def is_plunging(positions: FloatRows3, top: float) -> bool:
        """True if a step below the top descends by more than 1 % of its length.

        Args:
            positions: Tool tip in `work` [m], shape (step, 3), on the host.
            top: Upper face of the stock [m].
        """
        rows = np.asarray(positions)
        steps = np.diff(rows, axis=0)
        falls = -steps[:, 2] > _DESCENT * np.linalg.norm(steps, axis=1)
        return bool(np.any(falls & (rows[1:, 2] < top)))
