"""Figures of an identification: measured beside fitted values, and their difference."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .._style import GREY, INK, label_colourbar, legend_above, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.figure

MEASURED, FITTED, MISFIT = "#56B4E9", "#D55E00", "#222222"
_MOST_POINTS = 4000


def plot_force_fit(
    time: Float[np.ndarray, " row"],
    measured: Float[np.ndarray, "row 3"],
    fitted: Float[np.ndarray, "row 3"],
    *,
    revolution: float,
    title: str = "",
    turns: float = 4.0,
    what: str = "F",
    unit: str = "N",
) -> "matplotlib.figure.Figure":
    """Draw measured and fitted force and their difference over a few revolutions.

    Or another vector that was measured over time, such as a deviation.

    Args:
        time: Instants [s], shape (row,).
        measured: In `work` [unit of the axes], shape (row, 3); NaN where not measured.
        fitted: Fitted values [unit of the axes], shape (row, 3).
        revolution: Time of a turn of the spindle [s].
        title: Title of the figure.
        turns: Revolutions that are shown, around the largest force.
        what: Letter of the vector.
        unit: Unit of the axes.

    Returns:
        The figure: to the left the few revolutions, to the right all of it thinned.
    """
    figure = new_figure(5.4)
    panels = figure.subplots(3, 2, width_ratios=(2.2, 1.0), sharey="row")
    size = np.nansum(np.where(np.isfinite(measured), measured, 0.0) ** 2, axis=1)
    width = max(1, round(turns * revolution / float(np.median(np.diff(time)))))
    smooth = np.convolve(size, np.ones(min(width, len(size))), mode="same")
    middle = time[int(np.argmax(smooth))]
    middle = np.clip(
        middle,
        time[0] + turns * revolution / 2,
        max(time[-1] - turns * revolution / 2, time[0] + turns * revolution / 2),
    )
    near = np.abs(time - middle) <= turns * revolution / 2
    stride = max(1, len(time) // _MOST_POINTS)
    for axis, (left, right) in enumerate(panels):
        parts = [(left, near, 1e3 * (time - middle), 1), (right, ..., time, stride)]
        for axes, rows, t, step in parts:
            for values, colour, name, thick in (
                (measured[:, axis], MEASURED, "measured", 1.6),
                (fitted[:, axis], FITTED, "fitted", 0.8),
                (measured[:, axis] - fitted[:, axis], MISFIT, "measured minus it", 0.6),
            ):
                shown = values[rows][::step]
                axes.plot(t[rows][::step], shown, color=colour, lw=thick, label=name)
        is_last = axis == 2
        quiet_axes(
            left,
            x="time [ms]" if is_last else "",
            y=f"{what}{'xyz'[axis]} [{unit}]",
            title=title if axis == 0 else "",
        )
        quiet_axes(right, x="time of the cut [s]" if is_last else "")
    legend_above(figure, panels[0, 0])
    return figure


def plot_residual_spectrum(
    frequency: Float[np.ndarray, " line"],
    left: Float[np.ndarray, "line 3"],
    force: Float[np.ndarray, "line 3"],
    *,
    tooth_frequency: float,
    flute_count: int,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """Draw the amplitudes that a fit leaves beside those of the force.

    Args:
        frequency: [Hz], shape (line,).
        left: Amplitudes of the residual [N], shape (line, 3).
        force: Amplitudes of the measured force [N], shape (line, 3).
        tooth_frequency: Tooth-passing frequency [Hz], marked with its multiples.
        flute_count: Number of teeth: the spindle's own frequency is marked, too.
        title: Title of the figure.

    Returns:
        The figure, one row per axis, logarithmic.
    """
    figure = new_figure(4.8)
    panels = figure.subplots(3, 1, sharex=True)
    top = min(float(frequency[-1]), 12 * tooth_frequency)
    shown = frequency <= top
    for axis, axes in enumerate(panels):
        for k in range(1, int(top / tooth_frequency) + 1):
            axes.axvline(k * tooth_frequency, color="#d9d9d9", lw=0.8)
        axes.axvline(tooth_frequency / flute_count, color="#d9d9d9", lw=0.8, ls=":")
        for values, colour, name in (
            (force, MEASURED, "measured"),
            (left, MISFIT, "left by the fit"),
        ):
            level = np.maximum(values[shown, axis], 1e-6)
            axes.semilogy(frequency[shown], level, color=colour, lw=0.6, label=name)
        most = max(float(force[shown, axis].max(initial=0.0)), 1e-3)
        axes.set_ylim(1e-4 * most, 2 * most)
        quiet_axes(
            axes,
            x="frequency [Hz]; lines: spindle (dotted), tooth passing and multiples"
            if axis == 2
            else "",
            y=f"F{'xyz'[axis]} [N]",
            title=title if axis == 0 else "",
        )
    legend_above(figure, panels[0])
    return figure


def plot_correlation(
    names: Sequence[str], correlation: Float[np.ndarray, "name name"]
) -> "matplotlib.figure.Figure":
    """Draw the correlation of fitted values, numbers in the cells.

    Args:
        names: Names of the fitted values.
        correlation: From -1 to 1, NaN where nothing is known, shape (name, name).

    Returns:
        The figure.
    """
    count = len(names)
    figure = new_figure(1.2 + 0.42 * count, width_in=2.4 + 0.55 * count)
    axes = figure.subplots()
    image = axes.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    for i, j in np.ndindex(count, count):
        # Adding 0 after rounding takes the sign off a zero.
        value = np.round(correlation[i, j], 2) + 0.0
        text = f"{value:.2f}" if np.isfinite(value) else "-"
        colour = "white" if np.isfinite(value) and abs(value) > 0.6 else INK
        axes.text(j, i, text, ha="center", va="center", fontsize=7.5, color=colour)
    axes.set_xticks(range(count), names)
    axes.set_yticks(range(count), names)
    quiet_axes(axes, title="correlation of the errors", has_grid=False)
    label_colourbar(figure.colorbar(image, ax=axes, shrink=0.8), "")
    return figure


def plot_prediction(
    measured: Float[np.ndarray, "row axis"],
    predicted: Float[np.ndarray, "row axis"],
    *,
    unit: str,
    scale: float = 1.0,
    what: str = "F",
    title: str = "",
    marked: Sequence[int] = (),
    labels: Sequence[str] | None = None,
) -> "matplotlib.figure.Figure":
    """Draw predicted over measured values of rows that a fit leaves out.

    Args:
        measured: In SI, shape (row, axis), one to three axes.
        predicted: The same, shape (row, axis).
        unit: Unit on the axes.
        scale: Value in `unit` per SI value.
        what: Symbol of the quantity.
        title: Title of the figure.
        marked: Rows that are marked by a ring.
        labels: Names of the marked rows.

    Returns:
        The figure, one panel per axis with the line of equal values.
    """
    figure = new_figure(3.0)
    count = measured.shape[1]
    panels = figure.subplots(1, count, squeeze=False)[0]
    stride = max(1, len(measured) // _MOST_POINTS)
    for axis, axes in enumerate(panels):
        x, y = scale * measured[:, axis], scale * predicted[:, axis]
        good = np.isfinite(x) & np.isfinite(y)
        both = np.concatenate([x[good], y[good]]) if good.any() else np.zeros(1)
        low, high = float(both.min()), float(both.max())
        axes.plot([low, high], [low, high], color=GREY, lw=0.8)
        size = 2.0 if len(x) > 200 else 12.0
        axes.scatter(x[::stride], y[::stride], s=size, color=FITTED, linewidths=0)
        for place, row in enumerate(marked):
            axes.scatter(x[row], y[row], s=60, facecolors="none", edgecolors=INK)
            if labels is not None:
                axes.annotate(labels[place], (x[row], y[row]), fontsize=7, color=INK)
        name = f"{what}{'xyz'[axis]}"
        first = axis == 0
        quiet_axes(
            axes,
            x=f"measured {name} [{unit}]",
            y=f"predicted [{unit}]" if first else "",
        )
    if title:
        figure.suptitle(title, fontsize=9, x=0.01, ha="left", color=INK)
    return figure


def plot_mean_forces(
    feed_per_tooth: Float[np.ndarray, " feed"],
    mean_force: Float[np.ndarray, "feed 3"],
    slope: Float[np.ndarray, " 3"],
    offset: Float[np.ndarray, " 3"],
    *,
    predicted: Float[np.ndarray, "feed 3"] | None = None,
) -> "matplotlib.figure.Figure":
    """Draw mean forces over the feed with their lines, and the residuals.

    Args:
        feed_per_tooth: [m], shape (feed,).
        mean_force: In feed axes [N], shape (feed, 3).
        slope: Of the lines [N/m], shape (3,).
        offset: Of the lines [N], shape (3,).
        predicted: Each mean predicted by the other feeds [N], shape (feed, 3).

    Returns:
        The figure.
    """
    figure = new_figure(4.4)
    panels = figure.subplots(2, 3, height_ratios=(2, 1), sharex=True)
    f = 1e3 * feed_per_tooth
    ends = np.array([0.0, 1.05 * float(f.max())])
    for axis in range(3):
        top, low = panels[:, axis]
        top.plot(ends, 1e-3 * slope[axis] * ends + offset[axis], color=FITTED, lw=1.0)
        line = slope[axis] * feed_per_tooth + offset[axis]
        top.scatter(f, mean_force[:, axis], s=22, color=MEASURED, label="measured")
        if predicted is not None:
            top.scatter(
                f,
                predicted[:, axis],
                s=34,
                facecolors="none",
                edgecolors=INK,
                linewidths=0.8,
                label="predicted by the other feeds",
            )
        low.axhline(0.0, color=GREY, lw=0.8)
        low.vlines(f, 0.0, mean_force[:, axis] - line, color=MISFIT, lw=1.0)
        low.scatter(f, mean_force[:, axis] - line, s=10, color=MISFIT)
        quiet_axes(
            top, y="mean force [N]" if axis == 0 else "", title=f"F{'xyz'[axis]}"
        )
        quiet_axes(
            low,
            x="feed per tooth [mm]",
            y="measured minus line [N]" if axis == 0 else "",
        )
    legend_above(figure, panels[0, 0])
    return figure
