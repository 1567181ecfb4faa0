"""Offsets over time, as sensor interfaces of robot controllers take them."""

from typing import NamedTuple

import numpy as np

from ..._types import RealScalarLike
from ...toolpath import Path


class OffsetStream(NamedTuple):
    """A stream of offsets as text.

    Attributes:
        text: CSV with the header `time_s,dx_mm,dy_mm,dz_mm`, in `work`.
        largest_step: Largest change of an offset in a cycle [m].
        largest_offset: Largest offset [m].
    """

    text: str
    largest_step: float
    largest_offset: float


def offset_stream(
    programmed: Path, commanded: Path, cycle: RealScalarLike
) -> OffsetStream:
    """Return what is added to a program in every cycle of its controller.

    The offset of a row holds at its time since the start; between the rows of the
    paths it is linear. It begins and ends with that of the paths.

    Args:
        programmed: The path as the controller travels it without offsets.
        commanded: The corrected path, at the same times.
        cycle: Time between the rows [s], positive.

    Raises:
        ValueError: If the cycle is not positive, or the times differ.
    """
    time = np.asarray(programmed.time, float)
    if not cycle > 0:
        raise ValueError(f"Argument `cycle` must be positive, but is {cycle}.")
    if not np.array_equal(time, np.asarray(commanded.time)):
        raise ValueError("Argument `commanded` must have the times of `programmed`.")
    offsets = np.asarray(commanded.positions) - np.asarray(programmed.positions)
    count = int(np.ceil((time[-1] - time[0]) / float(cycle) - 1e-9))
    at = np.minimum(time[0] + float(cycle) * np.arange(count + 1), time[-1])
    rows = np.stack([np.interp(at, time, offsets[:, i]) for i in range(3)], axis=1)
    lines = ["time_s,dx_mm,dy_mm,dz_mm"]
    for index, (dx, dy, dz) in enumerate(rows * 1e3):
        lines.append(f"{index * float(cycle):.9g},{dx:.6f},{dy:.6f},{dz:.6f}")
    steps = np.linalg.norm(np.diff(rows, axis=0), axis=1)
    return OffsetStream(
        text="\n".join(lines) + "\n",
        largest_step=float(np.max(steps, initial=0.0)),
        largest_offset=float(np.max(np.linalg.norm(rows, axis=1))),
    )
