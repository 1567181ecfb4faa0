"""Offsets over time, as sensor interfaces of robot controllers take them."""

import os
import pathlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..._types import RealScalarLike
from ...toolpath import Path

_HEADER = "time_s,dx_mm,dy_mm,dz_mm"


class OffsetStream(NamedTuple):
    """Offsets to a program in every cycle of its controller, in `work`.

    Attributes:
        time: Since the start of the motion [s], shape (cycle,).
        offsets: Offsets of the tool tip [m], shape (cycle, 3).
    """

    time: Float[np.ndarray, " cycle"]
    offsets: Float[np.ndarray, "cycle 3"]

    @classmethod
    def of_paths(
        cls, programmed: Path, commanded: Path, cycle: RealScalarLike
    ) -> "OffsetStream":
        """Return the stream that makes one path of another.

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
            raise ValueError(
                "Argument `commanded` must have the times of `programmed`."
            )
        offsets = np.asarray(commanded.positions) - np.asarray(programmed.positions)
        count = int(np.ceil((time[-1] - time[0]) / float(cycle) - 1e-9))
        since = float(cycle) * np.arange(count + 1)
        at = np.minimum(time[0] + since, time[-1])
        rows = [np.interp(at, time, offsets[:, axis]) for axis in range(3)]
        return cls(since, np.stack(rows, axis=1))

    @classmethod
    def read(cls, file: str | os.PathLike[str]) -> "OffsetStream":
        """Return a stream from the file that `text` makes.

        Args:
            file: CSV with the header `time_s,dx_mm,dy_mm,dz_mm`.

        Raises:
            ValueError: If it has another header, no rows, or what is no number.
            OSError: If it cannot be read.
        """
        path = pathlib.Path(file)
        header, _, body = path.read_text(encoding="utf-8").partition("\n")
        if header.strip() != _HEADER:
            raise ValueError(f"{path}, line 1: found {header!r}; needed is {_HEADER}")
        try:
            rows = np.loadtxt(body.splitlines(), delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
            raise ValueError(f"{path}: found no rows of four finite numbers")
        return cls(rows[:, 0], rows[:, 1:] * 1e-3)

    @property
    def text(self) -> str:
        """The stream as CSV, a nanometre being its last digit."""
        rows = zip(self.time.tolist(), (self.offsets * 1e3).tolist(), strict=True)
        lines = [f"{t:.9g},{x:.6f},{y:.6f},{z:.6f}" for t, (x, y, z) in rows]
        return "\n".join([_HEADER, *lines]) + "\n"

    @property
    def largest_step(self) -> float:
        """Largest change of an offset in a cycle [m]."""
        steps = np.linalg.norm(np.diff(self.offsets, axis=0), axis=1)
        return float(np.max(steps, initial=0.0))

    def at(self, time: Float[np.ndarray, " row"]) -> Float[np.ndarray, "row 3"]:
        """Offsets of a controller that goes evenly from cycle to cycle [m].

        Args:
            time: Since the start of the motion [s], shape (row,).

        Returns:
            Offsets, shape (row, 3).
        """
        rows = [np.interp(time, self.time, self.offsets[:, axis]) for axis in range(3)]
        return np.stack(rows, axis=1)
