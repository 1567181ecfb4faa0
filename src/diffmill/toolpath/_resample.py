"""Recorded paths at the tooth instants, and measures of a sampled path."""

import math

import numpy as np

from .._types import BoolSteps, FloatRows3, FloatSteps, IntSteps, RealScalarLike
from ._path import MOST_STEPS, Path, check_steps


def resample(
    time: FloatSteps,
    positions: FloatRows3,
    axes: FloatRows3,
    is_rapid: BoolSteps,
    line: IntSteps,
    tooth_period: RealScalarLike,
    *,
    most_steps: RealScalarLike = MOST_STEPS,
) -> Path:
    """Return a recorded path at the tooth instants.

    Positions follow a monotone cubic (Fritsch and Carlson) in each coordinate: unlike
    straight lines it has no jumps of velocity, which would shake a simulated robot at
    every recorded row, and unlike a spline it never leaves the box between two
    neighbouring rows, so that a corner does not ring. Recorded instants that are
    tooth instants keep their positions.

    Args:
        time: Recorded instants [s], increasing, shape (step,); the first becomes 0.
        positions: Tool tips in `work` [m], shape (step, 3).
        axes: Tool axes in `work`, shape (step, 3); interpolated and normalised.
        is_rapid: Whether the motion to a row is rapid, shape (step,).
        line: Line that caused the motion to a row, shape (step,).
        tooth_period: Time between the returned rows [s].
        most_steps: Largest number of tooth periods.

    Returns:
        The path; its last row is the last recorded one, at or just after its time.

    Raises:
        ValueError: If the time does not increase or is longer than `most_steps`.

    **Differentiability**: none, it runs on the host.
    Reference: Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980.
    """
    from scipy.interpolate import PchipInterpolator

    time, positions, axes = (
        np.asarray(a, dtype=float) for a in (time, positions, axes)
    )
    period = float(tooth_period)
    if not (math.isfinite(period) and period > 0):
        raise ValueError(
            f"Argument `tooth_period` must be positive and finite, but is {period}."
        )
    if time.size < 2 or not np.all(np.diff(time) > 0):
        raise ValueError(
            "Argument `time` must have at least 2 rows and increase, but does not."
        )
    time = time - time[0]
    check_steps(float(time[-1]) / period, float(most_steps))
    count = max(1, math.ceil(time[-1] / period - 1e-6))
    instants = period * np.arange(count + 1)
    inside = np.minimum(instants, time[-1])
    directions = np.stack(
        [np.interp(inside, time, column) for column in axes.T], axis=1
    )
    row = np.searchsorted(time, inside - 1e-6 * period, side="left")
    row = np.minimum(row, time.size - 1)
    return Path(
        time=instants,
        positions=PchipInterpolator(time, positions, axis=0)(inside),
        axes=directions / np.linalg.norm(directions, axis=1, keepdims=True),
        is_rapid=np.asarray(is_rapid)[row],
        line=np.asarray(line, dtype=np.int32)[row],
    )
