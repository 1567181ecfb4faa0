"""Fine forces and one tooth's chip, for the figures."""

import numpy as np
from jaxtyping import Array, Float

from .._types import FloatSteps
from ..sim import ToothChip
from ._figure.chip import ChipChart
from ._figure.forces import ForceRecord


def force_record(
    time: FloatSteps,
    samples: Float[Array, "step sample 3"] | Float[np.ndarray, "step sample 3"],
) -> ForceRecord:
    """Return forces within the tooth periods as one record over time.

    Args:
        time: Tooth instants t_k [s], shape (step,).
        samples: Forces in the middles of equal parts of the period that ends at t_k
            [N], shape (step, sample, 3); row 0 belongs to no period and is left out.

    Returns:
        The record.
    """
    at = np.asarray(time, dtype=np.float64)
    force = np.asarray(samples, dtype=np.float64)[1:]
    period = float((at[-1] - at[0]) / (at.shape[0] - 1))
    part = (np.arange(force.shape[1]) + 0.5) / force.shape[1]
    fine = at[:-1, None] + part * period
    return ForceRecord(fine.reshape(-1), force.reshape(-1, 3), period)


def chip_chart(chip: ToothChip, columns: int) -> ChipChart:
    """Return the samples of a tooth sorted by angle and height.

    Args:
        chip: The chip that the tooth meets in a revolution.
        columns: Samples per revolution.

    Returns:
        The chip in the feed frame: angle 0 is on the left of the feed, the angle
        grows clockwise. Angles of a helical cutter are true to half a sample.
    """
    slot = np.round(chip.angle / (2 * np.pi) * columns - 0.5).astype(np.int64)
    element = np.broadcast_to(np.arange(chip.height.size), slot.shape)
    at = (element[chip.is_of_tooth], slot[chip.is_of_tooth] % columns)
    chart, share = np.zeros((2, chip.height.size, columns))
    chart[at] = chip.chip_thickness[chip.is_of_tooth]
    share[at] = chip.weight[chip.is_of_tooth]
    # The left of the feed is a quarter turn before it.
    left = chip.feed_angle - np.pi / 2
    turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns - left
    turn = (turn + np.pi / 2) % (2 * np.pi) - np.pi / 2
    order = np.argsort(turn)
    return ChipChart(turn[order], chip.height, chart[:, order], share[:, order])
