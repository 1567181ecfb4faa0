"""Commanded and actual paths in the air, on one clock."""

from typing import Literal

import numpy as np
from pydantic import Field

from ...identification import ControllerStudy
from ...io import ProgramError, read_path_csv
from ...settings.tables import TomlTable
from ...toolpath import Path
from .context import Context
from .fields import File
from .kind import IdentificationKind

# Usual steps between two rows from which on nobody knows what lies between them.
_GAP = 2.5


class AirPathTable(TomlTable):
    """`[air_path]`."""

    commanded: File = Field(
        description='commanded path as CSV, such as "commanded.csv"'
    )
    actual: File = Field(
        description="recorded path as CSV on the clock of the commanded one, such as "
        '"actual.csv"'
    )
    order: Literal["first", "second"] = Field(
        default="second",
        description="order of the servos; first for those with following error",
    )


def _read(
    name: str, context: Context, *, air_path: AirPathTable | None = None
) -> ControllerStudy | None:
    """Study of both paths at the instants of the record, or None with problems noted.

    Args:
        name: The file that asks for it.
        context: Folder and problems.
        air_path: `[air_path]`.
    """
    if air_path is None:
        return None
    commanded = _path(air_path.commanded, "commanded", context)
    actual = _path(air_path.actual, "actual", context)
    if commanded is None or actual is None:
        return None
    steps = np.diff(actual.time)
    step = float(np.median(steps))
    first = min(commanded.time[0], actual.time[0])
    time = first + step * np.arange(1 + int((actual.time[-1] - first) / step + 1e-6))
    at = lambda path: np.stack(
        [np.interp(time, path.time, x) for x in np.asarray(path.positions).T], axis=1
    )
    # The rows around each instant, one row twice where it falls on it.
    before = np.searchsorted(actual.time, time + 1e-6 * step, side="right") - 1
    after = np.searchsorted(actual.time, time - 1e-6 * step)
    after = np.minimum(after, steps.size)
    is_bridged = actual.time[after] - actual.time[before] > _GAP * step
    is_recorded = (before >= 0) & ~is_bridged
    notes = []
    if np.ptp(steps) > 0.5 * step:
        left_out = (
            f", and {np.count_nonzero(is_bridged)} instants between rows more than "
            f"{_GAP * step * 1e3:.3g} ms apart were left out"
        )
        notes.append(
            f"The record's rows are {steps.min() * 1e3:.3g} to {steps.max() * 1e3:.3g} "
            f"ms apart; they were interpolated every {step * 1e3:.3g} ms"
            f"{left_out if is_bridged.any() else ''}."
        )
    return ControllerStudy(
        name=name,
        time_step=step,
        commanded=at(commanded),
        actual=at(actual),
        is_recorded=np.asarray(is_recorded),
        order=air_path.order,
        notes=tuple(notes),
    )


def _path(name: str, key: str, context: Context) -> Path | None:
    """Path from a file, or None with its faults noted."""
    file = context.file(name, f"[air_path] {key}")
    if file is None:
        return None
    try:
        return read_path_csv(file)
    except ProgramError as error:
        context.problems.extend(
            f"[air_path] {key}: {line}" for line in str(error).splitlines()
        )
        return None


KIND = IdentificationKind(
    "controller", required={"air_path": AirPathTable}, optional={}, read=_read
)
