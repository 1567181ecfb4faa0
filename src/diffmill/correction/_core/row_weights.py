"""Weights of the rows of a path: finishing passes count, roughing does not."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..._types import BoolSteps, IntSteps
from ...settings.correction import LineWeight
from ...workpiece import Rays, Stock

# Weight of a row that only passes over the surface: enough that the command does not
# swing into it there, little beside the rows that cut.
_TOUCHING_WEIGHT = 0.1


def row_weights(
    is_cutting: BoolSteps,
    line: IntSteps,
    *,
    sections: Sequence[LineWeight] = (),
    finished: Stock | None = None,
    spread: int = 0,
    is_touching: BoolSteps | None = None,
) -> Float[np.ndarray, " step"]:
    """Weight of every row in the error, shape (step,).

    Args:
        is_cutting: Whether the rigid tool cuts, shape (step,); other rows weigh 0.
        line: Line of the program that caused the row, shape (step,).
        sections: Sections with weights of their own; a later one overrides an earlier
            one.
        finished: The stock after the rigid cut; where given, only rows that leave a
            part of its surface count.
        spread: Rows to either side of one that leaves a part of the surface that
            count too: between two rays the tool may advance by several rows.
        is_touching: Whether a row comes so near to the surface that a deviation would
            spoil it, shape (step,): one that does not cut counts a tenth.

    Returns:
        Weights, shape (step,).

    Raises:
        ValueError: A weight is negative, or no row that cuts has one.

    **Differentiability**: none, a host function.
    """
    is_cutting, line = np.asarray(is_cutting, bool), np.asarray(line)
    touches = np.zeros_like(is_cutting) if is_touching is None else is_touching
    own = np.where(is_cutting, 1.0, _TOUCHING_WEIGHT * np.asarray(touches))
    weights = own.copy()
    for first, last, weight in sections:
        if weight < 0:
            raise ValueError(
                f"Argument `sections` must weigh >= 0, but holds {weight}."
            )
        chosen = (line >= first) & (line <= last)
        weights[chosen] = weight * own[chosen]
    if finished is not None:
        is_finishing = np.zeros(len(weights), bool)
        near = surface_poses(finished)[:, None] + np.arange(-spread, spread + 1)[None]
        is_finishing[np.clip(near, 0, len(weights) - 1)] = True
        weights[is_cutting & ~is_finishing] = 0.0
    if not np.any(weights[is_cutting] > 0):
        cut = line[is_cutting]
        lines = f"{cut.min()} to {cut.max()}" if cut.size else "none"
        raise ValueError(
            "Argument `sections` must leave a row that cuts a weight above 0, but all "
            f"are 0; the rows that cut come from lines {lines}."
        )
    return weights


def surface_poses(stock: Stock) -> Int[np.ndarray, " pose"]:
    """Poses that cut some live end of a stock, ascending, shape (pose,).

    **Differentiability**: none, a host function.
    """
    families = []
    for rays in stock.families:
        ends, poses = np.asarray(rays.ends), np.asarray(rays.poses)
        is_live = (ends[:, :, 1] > ends[:, :, 0])[:, :, None] & (poses >= 0)
        # A tooth cuts in the period that ends at its pose.
        families.append(np.unique(-(-poses[is_live] // Rays.TICKS)))
    return np.unique(np.concatenate(families))
