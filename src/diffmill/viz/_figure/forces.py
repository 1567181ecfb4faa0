"""Cutting forces over time: their range grey, the low-passed force black."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows3, FloatSteps
from ...numerics import lowpass
from .._style import GREY, INK, legend_above, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_MOST_BINS = 1500  # more columns than the figure has pixels across one panel


class ForceTrace(eqx.Module):
    """A force over time, equally spaced, as the tool feels it in `work`.

    Attributes:
        time: Time of each sample [s], shape (sample,).
        force: Force on the tool [N], shape (sample, 3).
        tooth_period: Time between two teeth [s], or 0 where it is not known.
        is_tooth_mean: True if each sample is a mean over a tooth period.
        force_range: Least and largest force in each of these periods [N], shape
            (sample, 2, 3); None where it is not known.
        window: Force at every angle of a few of these periods; None where it is not
            known.
    """

    time: Float[np.ndarray, " sample"]
    force: Float[np.ndarray, "sample 3"]
    tooth_period: float = 0.0
    is_tooth_mean: bool = eqx.field(static=True, default=False)
    force_range: Float[np.ndarray, "sample 2 3"] | None = None
    window: "ForceTrace | None" = None

    def __check_init__(self):
        if self.time.shape[0] < 3:
            raise ValueError(
                f"Argument `time` must have at least 3 samples, but has "
                f"{self.time.shape[0]}."
            )
        steps = np.diff(self.time)
        if not np.allclose(steps, steps.mean(), rtol=1e-3, atol=0.0):
            raise ValueError(
                "Argument `time` must be equally spaced, but its steps lie between "
                f"{steps.min():.3g} s and {steps.max():.3g} s."
            )

    @classmethod
    def from_periods(
        cls,
        time: FloatSteps,
        samples: Float[Array, "step sample 3"] | Float[np.ndarray, "step sample 3"],
    ) -> "ForceTrace":
        """Return forces within the tooth periods as one record over time.

        Args:
            time: Tooth instants t_k [s], shape (step,).
            samples: Forces in the middles of equal parts of the period that ends at
                t_k [N], shape (step, sample, 3); row 0 belongs to no period and is
                left out.

        Returns:
            The record.
        """
        at = np.asarray(time, dtype=np.float64)
        force = np.asarray(samples, dtype=np.float64)[1:]
        period = float((at[-1] - at[0]) / (at.shape[0] - 1))
        part = (np.arange(force.shape[1]) + 0.5) / force.shape[1]
        fine = at[:-1, None] + part * period
        return cls(fine.reshape(-1), force.reshape(-1, 3), period)

    @classmethod
    def of_rows(
        cls,
        time: FloatSteps,
        force: FloatRows3,
        force_range: Float[Array, "step 2 3"] | Float[np.ndarray, "step 2 3"],
        *,
        window: "ForceTrace | None" = None,
    ) -> "ForceTrace":
        """Forces of the rows of a run as a record over time.

        Args:
            time: Tooth instants [s], shape (step,).
            force: Mean over the period before each [N], shape (step, 3).
            force_range: Least and largest force in that period [N], shape (step, 2, 3).
            window: Force at every angle of a few of these periods.
        """
        at = np.asarray(time, np.float64)
        mean, extremes = (
            np.nan_to_num(np.asarray(x, np.float64)) for x in (force, force_range)
        )
        period = float((at[-1] - at[0]) / (len(at) - 1))
        return cls(at, mean, period, True, extremes, window)

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return float((self.time.shape[0] - 1) / (self.time[-1] - self.time[0]))


def plot_forces(
    record: ForceTrace,
    *,
    cutoff: float = 100.0,
    order: int = 4,
    zoom_periods: int = 6,
) -> "matplotlib.figure.Figure":
    """Draw F_x, F_y, F_z over time, as computed and after a low-pass.

    Args:
        record: The force.
        cutoff: Cut-off of the low-pass [Hz]. Tooth means without a range are drawn as
            they are, and so are those that carry no more than it would leave.
        order: Order of one of its two passes.
        zoom_periods: Tooth periods in the column on the right.

    Returns:
        The figure: three rows, the whole record left, a few tooth periods right.
    """
    figure = new_figure(5.6)
    has_range = record.force_range is not None
    detail = record.window if record.is_tooth_mean else record
    has_zoom = detail is not None and record.tooth_period > 0
    grid = figure.subplots(
        3,
        2 if has_zoom else 1,
        squeeze=False,
        sharex="col",
        width_ratios=[2.4, 1.0] if has_zoom else [1.0],
    )
    filtered = record.force if has_range else None
    if cutoff < record.sample_rate / 2 and (has_range or not record.is_tooth_mean):
        filtered = lowpass(record.force, record.sample_rate, cutoff, order=order)
    start, stop = _zoom_window(detail or record, zoom_periods)
    for axis, name in enumerate("xyz"):
        _draw_axis(grid[axis, 0], record, filtered, axis)
        quiet_axes(grid[axis, 0], y=f"$F_{name}$ [N]")
        if detail is not None and has_zoom:
            _draw_zoom(grid[axis, 1], detail, axis, start, stop)
            if filtered is not None:
                time_ms = (record.time - start) * 1e3
                inside = np.abs(time_ms) <= 2e3 * (stop - start)
                line = time_ms[inside], filtered[inside, axis]
                grid[axis, 1].plot(*line, color="black", linewidth=1.1)
            grid[axis, 0].axvspan(start, stop, color="#0072B2", alpha=0.3, linewidth=0)
    grid[0, 0].set_title("whole cut", fontsize=9, loc="left", color=INK)
    grid[2, 0].set_xlabel("time [s]", fontsize=8.5, color=INK)
    if has_zoom:
        title = f"{zoom_periods} tooth periods (blue bar)"
        grid[0, 1].set_title(title, fontsize=9, loc="left", color=INK)
        label = f"time after {start:.3f} s [ms]"
        grid[2, 1].set_xlabel(label, fontsize=8.5, color=INK)
    names = {"grey": "instantaneous", "black": "mean over each tooth period"}
    if record.is_tooth_mean and not has_range:
        names["grey"] = "mean over each tooth period"
    if detail is not None and detail.tooth_period > 0:
        count = detail.tooth_period * detail.sample_rate
        names["grey"] += f", {count:.0f} samples per tooth"
    if filtered is not None and filtered is not record.force:
        # Order and phase of a filter belong to its name.
        names["black"] = (
            f"{cutoff:g} Hz low-pass: Butterworth, order {order}, forward and backward "
            "(zero phase)"
        )
    for artist in (*grid[0, 0].lines, *grid[0, 0].collections):
        artist.set_label(names.get(str(artist.get_label()), "_hidden"))
    legend_above(figure, grid[0, 0], columns=2)
    return figure


def _zoom_window(record: ForceTrace, periods: int) -> tuple[float, float]:
    """Return the middle of the cut: where half of the impulse has been given."""
    impulse = np.cumsum(np.linalg.norm(np.nan_to_num(record.force), axis=1))
    half = record.time[int(np.searchsorted(impulse, impulse[-1] / 2))]
    span = periods * record.tooth_period
    start = min(max(half - span / 2, record.time[0]), record.time[-1] - span)
    return float(start), float(start + span)


def _draw_axis(
    axes: "matplotlib.axes.Axes",
    record: ForceTrace,
    filtered: Float[np.ndarray, "sample 3"] | None,
    axis: int,
) -> None:
    values = record.force[:, axis]
    least, largest, times = values, values, record.time
    if record.force_range is not None:
        # Those of a period are drawn from its start.
        least, largest = (record.force_range[:, k, axis] for k in (0, 1))
        times = record.time - record.tooth_period
    is_long = record.time.shape[0] > 2 * _MOST_BINS and not record.is_tooth_mean
    if is_long or record.force_range is not None:
        # More samples than pixels: the band between the extremes is what a line
        # would fill; whole teeth, so that no pattern of bins appears.
        per_tooth = round(record.tooth_period * record.sample_rate)
        size = max(per_tooth, -(-record.time.shape[0] // _MOST_BINS))
        starts = np.arange(0, record.time.shape[0], size)
        axes.fill_between(
            times[starts],
            np.minimum.reduceat(least, starts),
            np.maximum.reduceat(largest, starts),
            step="post",
            color="#bdbdbd",
            linewidth=0.3,
            label="grey",
        )
    else:
        colour = "black" if record.is_tooth_mean else GREY
        axes.plot(record.time, values, color=colour, linewidth=0.8, label="grey")
    if filtered is not None:
        axes.plot(
            record.time, filtered[:, axis], color="black", linewidth=0.9, label="black"
        )
    axes.set_xlim(float(record.time[0]), float(record.time[-1]))


def _draw_zoom(
    axes: "matplotlib.axes.Axes",
    record: ForceTrace,
    axis: int,
    start: float,
    stop: float,
) -> None:
    inside = (record.time >= start) & (record.time <= stop)
    time_ms = (record.time[inside] - start) * 1e3
    axes.plot(
        time_ms,
        record.force[inside, axis],
        color=GREY,
        linewidth=0.9,
        marker="." if time_ms.size < 300 else "",
        markersize=2.5,
    )
    axes.set_xlim(0.0, (stop - start) * 1e3)
    quiet_axes(axes)
