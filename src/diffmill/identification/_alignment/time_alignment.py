"""Alignment of a record with its cut in time, by the size of the force alone."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .._cut.cut_model import EngagementColumns, at_times

# Longest series that are compared, and how near two maxima count as one.
_LONGEST = 1 << 20
# Share of the largest simulated force above which the tool counts as cutting.
_CUTTING_SHARE = 0.02


@dataclasses.dataclass(frozen=True)
class TimeAlignment:
    """Alignment of a record with its cut in time.

    Attributes:
        shift: Time of the cut minus time of the record [s].
        quality: Correlation of the sizes of both forces there, up to 1.
        overlap: Share of the simulated cutting that the record covers there.
    """

    shift: float
    quality: float
    overlap: float


def align_in_time(
    engagement: EngagementColumns,
    coefficients: Float[np.ndarray, " 6"],
    time: Float[np.ndarray, " row"],
    force: Float[np.ndarray, "row 3"],
) -> TimeAlignment:
    """Best alignment of a record with its cut.

    The sizes |F| of the measured and of the simulated force are compared at every
    shift, so that axes and signs do not matter. The coefficients need to be right in
    proportion only.

    Args:
        engagement: Force of the cut per coefficient.
        coefficients: Rough values in the order of `NAMES` [Pa, N/m], shape (6,).
        time: Instants of the record [s], ascending, shape (row,).
        force: Record without its offset [N], shape (row, 3); NaN where not known.

    Returns:
        The shift, to a sample of the record.

    Raises:
        ValueError: The simulated tool never cuts, or the record rests at zero.
    """
    modelled = np.linalg.norm(
        engagement.columns @ coefficients + engagement.constant, axis=1
    )
    is_cut = modelled > _CUTTING_SHARE * modelled.max(initial=0.0)
    if not is_cut.any():
        raise ValueError(
            "The simulated tool never cuts: there is nothing to align with."
        )
    span = engagement.start + engagement.spacing * (len(modelled) - 1)
    step = float(np.median(np.diff(time)))
    step = max(step, (float(time[-1] - time[0]) + span) / _LONGEST)
    size = np.linalg.norm(np.nan_to_num(force), axis=1)
    if not size.any():
        raise ValueError("The record is zero throughout: there is nothing to align.")
    grid = np.arange(time[0], time[-1] + step / 2, step)
    # Between two samples far apart nothing was measured, which counts as no force.
    a = np.interp(grid, time, size)
    place = np.searchsorted(time, grid)
    gap = time[np.minimum(place, len(time) - 1)] - time[np.maximum(place - 1, 0)]
    a = np.where(gap > 20 * step, 0.0, a)
    b = at_times(
        modelled, engagement.start, engagement.spacing, np.arange(0.0, span, step)
    )
    width = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    product = np.fft.rfft(a, width) * np.conj(np.fft.rfft(b, width))
    both = np.fft.irfft(product, width)
    lag = int(np.argmax(both))
    best = float(both[lag]) / float(np.linalg.norm(a) * np.linalg.norm(b))
    lag = lag - width if lag >= len(a) else lag
    shift = -float(time[0]) - lag * step
    instants = engagement.start + engagement.spacing * np.flatnonzero(is_cut) - shift
    inside = (instants >= time[0]) & (instants <= time[-1])
    return TimeAlignment(shift, best, float(inside.mean()))
