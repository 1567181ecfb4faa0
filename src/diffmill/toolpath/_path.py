"""A tool path as the simulation takes it: one row per tooth period."""

import dataclasses
import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._padding import pad_rows, padded_count
from .._types import (
    BoolSteps,
    FloatRows3,
    FloatSteps,
    IntScalar,
    IntSteps,
    RealScalarLike,
)
from ._turned_axes import LEAST_SUM, stand_upright, turned_axes, turned_tool_x

# Above this a path fills the memory with its own rows, and a typing error in a feed is
# the usual reason.
MOST_STEPS = 1_000_000
# Fraction of a tooth period by which sums of durations may miss a tooth instant.
SAME_INSTANT = 1e-6


class Path(eqx.Module):
    """A tool path in `work`, sampled at the tooth instants t_k = k T.

    Attributes:
        time: Time since the start [s], shape (step,), equally spaced by T.
        positions: Tool tip in `work` [m], shape (step, 3).
        axes: Unit tool axis, tip to shank, in `work`, shape (step, 3).
        is_rapid: Whether the row belongs to a rapid move, shape (step,).
        line: Line of the program that caused the row, from 1; 0 where there is
            none, shape (step,).
        row_count: How many rows count; those behind only fill the arrays up to a
            length that other paths have too. All rows if None.
        tool_x: Unit x of the tool in `work`, across its axis, shape (step, 3); None
            where the program leaves the rotation about the axis open.
        disturbance: What the machine does there beyond its model, as it was measured
            [m], shape (step, 3): a run adds it to its deviation. None if not known.
    """

    time: FloatSteps
    positions: FloatRows3
    axes: FloatRows3
    is_rapid: BoolSteps
    line: IntSteps
    row_count: IntScalar | None = None
    tool_x: FloatRows3 | None = None
    disturbance: FloatRows3 | None = None

    # Faster than any cell moves a cutter [m/s].
    UNUSUAL_SPEED: ClassVar[float] = 5.0

    def __check_init__(self):
        rows = self.positions.shape[0]
        for name in ("time", "axes", "is_rapid", "line", "tool_x", "disturbance"):
            if getattr(self, name) is None:
                continue
            if getattr(self, name).shape[0] != rows:
                raise ValueError(
                    f"Argument `{name}` must have one row per position ({rows}), but "
                    f"has {getattr(self, name).shape[0]}."
                )
        if rows < 2:
            raise ValueError(
                f"Argument `positions` must have at least 2 rows, but has {rows}."
            )

    @classmethod
    def upright(cls, time: FloatSteps, positions: FloatRows3) -> "Path":
        """Return a path with the tool axis along +z of `work` and no rapid moves.

        Args:
            time: Tooth instants [s], shape (step,).
            positions: Tool tip [m], shape (step, 3).
        """
        rows = positions.shape[0]
        return cls(
            time=time,
            positions=positions,
            axes=np.tile(np.array([0.0, 0.0, 1.0]), (rows, 1)),
            is_rapid=np.zeros(rows, dtype=bool),
            line=np.zeros(rows, dtype=np.int32),
        )

    @property
    def is_upright(self) -> bool:
        """True if the tool axis is +z at every row, to 1e-4.

        **Differentiability**: none.
        """
        return stand_upright(np.asarray(self.axes, np.float64))

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings about a recorded path, a sentence each: unusual speeds.

        **Differentiability**: none.
        """
        time, points = np.asarray(self.time), np.asarray(self.positions)
        speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(time)
        row = int(np.argmax(speeds))
        if not speeds[row] > self.UNUSUAL_SPEED:
            return ()
        count = int(np.sum(speeds > self.UNUSUAL_SPEED))
        duration, line = np.diff(time)[row], int(np.asarray(self.line)[row + 1])
        return (
            f"the path moves at {speeds[row]:.3g} m/s before line {line} "
            f"({speeds[row] * duration:.3g} m in {duration:.3g} s), and above "
            f"{self.UNUSUAL_SPEED:g} m/s in {count} row{'s' * (count > 1)}: faster "
            "than a cell moves a cutter",
        )

    def padded(self, row_count: int | None = None) -> "Path":
        """Return the path with rows behind its last one that no simulation runs.

        A compiled program serves paths of one length; one that is padded is returned as
        it is.

        Args:
            row_count: Rows of the padded path; one of few sizes if not given.

        Returns:
            The path; its `row_count` says how many of its rows count.

        Raises:
            ValueError: The path has more rows than asked for.
        """
        if self.row_count is not None:
            return self
        count = self.step_count
        total = padded_count(count) if row_count is None else row_count
        if total < count:
            raise ValueError(
                f"Argument `row_count` must be at least the path's number of rows "
                f"({count}), but is {total}."
            )
        rows = jax.tree.map(lambda x: pad_rows(np.asarray(x), total), self)
        return dataclasses.replace(rows, row_count=np.asarray(count, np.int32))

    def resampled(
        self, tooth_period: RealScalarLike, *, most_steps: RealScalarLike = MOST_STEPS
    ) -> "Path":
        """Return the path at tooth instants, its own times being as recorded.

        Positions follow a monotone cubic (Fritsch and Carlson) in each coordinate:
        unlike straight lines it has no jumps of velocity, which would shake a simulated
        robot at every recorded row, and unlike a spline it never leaves the box between
        two neighbouring rows, so that a corner does not ring. Recorded instants that
        are tooth instants keep their positions.

        Args:
            tooth_period: Time between the returned rows [s].
            most_steps: Largest number of tooth periods.

        Returns:
            The path from time 0; its last row is the last recorded one, at or just
            after its time. Axes turn evenly between recorded ones.

        Raises:
            ValueError: If the time does not increase or is longer than `most_steps`, or
                the tool turns to the opposite axis from one row to the next.

        **Differentiability**: none, it runs on the host.
        Reference: Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980.
        """
        from scipy.interpolate import PchipInterpolator

        recorded = (self.time, self.positions, self.axes)
        time, positions, axes = (np.asarray(a, dtype=float) for a in recorded)
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
        count = max(1, math.ceil(time[-1] / period - SAME_INSTANT))
        instants = period * np.arange(count + 1)
        inside = np.minimum(instants, time[-1])
        is_opposite = np.linalg.norm(axes[1:] + axes[:-1], axis=1) < LEAST_SUM
        if is_opposite.any():
            raise ValueError(
                "The tool must not turn to the opposite axis from one row to the next, "
                f"but does {time[np.argmax(is_opposite)]:.6g} s behind the first."
            )
        before = np.searchsorted(time, inside, side="right") - 1
        before = np.minimum(before, time.size - 2)
        share = (inside - time[before]) / np.diff(time)[before]
        row = np.searchsorted(time, inside - SAME_INSTANT * period, side="left")
        row = np.minimum(row, time.size - 1)
        turned, tool_x = turned_axes(axes[before], axes[before + 1], share), None
        if self.tool_x is not None:
            frames = np.concatenate([axes, np.asarray(self.tool_x, float)], axis=1)
            ends = frames[before], frames[before + 1]
            tool_x = turned_tool_x(*ends, share, turned)
        return Path(
            time=instants,
            positions=PchipInterpolator(time, positions, axis=0)(inside),
            axes=turned,
            is_rapid=np.asarray(self.is_rapid)[row],
            line=np.asarray(self.line, dtype=np.int32)[row],
            tool_x=tool_x,
        )

    def with_standstill(self, count: int) -> "Path":
        """Return the path with rows at rest before and after it.

        Args:
            count: Rows to either side.
        """
        rows = np.arange(-count, self.step_count + count)
        at = np.clip(rows, 0, self.step_count - 1)
        step = self.duration / (self.step_count - 1)
        return Path(
            time=float(self.time[0]) + step * np.arange(rows.size),
            positions=np.asarray(self.positions)[at],
            axes=np.asarray(self.axes)[at],
            is_rapid=np.asarray(self.is_rapid)[at],
            line=np.asarray(self.line)[at],
            tool_x=None if self.tool_x is None else np.asarray(self.tool_x)[at],
        )

    def disturbed(self, deviation: Float[Array, "step 3"]) -> Float[Array, "step 3"]:
        """Deviation with what the machine does beyond its model [m], shape (step, 3).

        Args:
            deviation: Deviation of the model [m], shape (step, 3).

        **Differentiability**: linear.
        """
        if self.disturbance is None:
            return deviation
        return deviation + jnp.asarray(self.disturbance, deviation.dtype)

    @property
    def step_count(self) -> int:
        """Number of rows."""
        return self.positions.shape[0]

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1]) - float(self.time[0])


def check_steps(count: float, most: float) -> None:
    """Refuse a motion of too many tooth periods, or of no end.

    Args:
        count: Duration of the motion in tooth periods.
        most: Largest number.

    Raises:
        ValueError: If there are more.
    """
    if not count <= most:
        raise ValueError(
            f"found a motion of {count:.3g} tooth periods; at most {most:.0f} are "
            "allowed (is a feed or an acceleration too small, or a time too long?)"
        )
