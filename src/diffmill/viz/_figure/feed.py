"""Error against time over the feed, and the override along the path."""

from typing import TYPE_CHECKING

import numpy as np

from .._style import GREY, INK, MICROMETRE, case_style, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

_TUNED = "#CC79A7"


def plot_feed(
    tradeoff: "xarray.Dataset", tuned: "xarray.Dataset | None" = None
) -> "matplotlib.figure.Figure":
    """Draw the contour error over the cycle time, and the overrides along the path.

    Args:
        tradeoff: Dataset of a `FeedTradeoff`.
        tuned: Dataset of a `TunedFeed` of the same program, or None.

    Returns:
        The figure: one panel, or two with the overrides that were found. Points of
        the program at an even override are labelled with it.
    """
    figure = new_figure(3.2 if tuned is None else 5.8)
    panels = np.atleast_1d(figure.subplots(1 if tuned is None else 2, 1))
    _draw_even(panels[0], tradeoff)
    if tuned is not None:
        _draw_tuned(panels[0], panels[1], tuned)
    panels[0].set_yscale("log")
    quiet_axes(panels[0], x="cycle time [s]", y=f"contour error, rms [{MICROMETRE}]")
    # Most curves span less than a power of ten: ticks between need plain numbers.
    panels[0].tick_params(axis="y", which="both", labelsize=8)
    panels[0].yaxis.set_major_formatter("{x:g}")
    low, high = panels[0].get_ylim()
    if high < 10 * low:
        panels[0].yaxis.set_minor_formatter("{x:g}")
    else:
        panels[0].yaxis.set_minor_formatter("")
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def _draw_even(axes: "matplotlib.axes.Axes", tradeoff: "xarray.Dataset") -> None:
    """Draw the program at even overrides, as it is and corrected."""
    time = np.asarray(tradeoff["cycle_time"], np.float64)
    order = np.argsort(time)
    for name in ("uncorrected", "corrected"):
        error = 1e6 * np.asarray(tradeoff[name], np.float64)
        if not np.isfinite(error).any():
            continue
        style = case_style(name)
        axes.plot(
            time[order],
            error[order],
            color=style.colour,
            linewidth=style.width,
            marker="o",
            markersize=3.5,
            label=f"{style.label}, even override",
        )
        for x, y, value in zip(
            time, error, np.asarray(tradeoff["override"]), strict=True
        ):
            axes.annotate(
                f"{value:g}",
                (float(x), float(y)),
                xytext=(3, 4),
                textcoords="offset points",
                fontsize=7,
                color=style.colour,
            )


def _draw_tuned(
    curve: "matplotlib.axes.Axes",
    along: "matplotlib.axes.Axes",
    tuned: "xarray.Dataset",
) -> None:
    """Draw the tuned points and their overrides; the first is the program."""
    tuned_points = tuned.isel(weight=slice(1, None))
    curve.plot(
        np.asarray(tuned_points["cycle_time"]),
        1e6 * np.asarray(tuned_points["rms"]),
        color=_TUNED,
        linestyle="--",
        marker="s",
        markersize=3.5,
        label="uncorrected, tuned override",
    )
    travel = 1e3 * np.asarray(tuned["travel"])
    count = tuned_points.sizes["weight"]
    for row in range(count):
        point = tuned_points.isel(weight=row)
        along.plot(
            travel,
            np.asarray(point["feed_override"]),
            color=_TUNED,
            alpha=1 - 0.7 * row / max(count, 1),
            label=f"weight of the time {float(point['weight']):g}, "
            f"{float(point['cycle_time']):.1f} s",
        )
    quiet_axes(along, x="travel [mm]", y="override")
    along.legend(fontsize=8, frameon=False)


def plot_fastest_feed(
    tried: "xarray.Dataset", tolerance: float
) -> "matplotlib.figure.Figure":
    """Draw the largest contour error over the overrides that were tried.

    Args:
        tried: Dataset of a `FastestFeed`.
        tolerance: Largest contour error that is allowed [m].

    Returns:
        The figure; overrides that break a limit are crosses, the first of each limit
        with its name.
    """
    figure = new_figure(3.2)
    axes = figure.subplots()
    override, error = (np.asarray(tried[n], np.float64) for n in ("override", "error"))
    broken = [str(name) for name in tried["broken"].values]
    order = np.argsort(override)
    axes.plot(override[order], 1e6 * error[order], color=GREY, linewidth=0.9)
    style = case_style("corrected"), case_style("uncorrected")
    named = set()
    for k in order:
        place, name = (override[k], 1e6 * error[k]), broken[k]
        marker = "x" if name else "o"
        axes.plot(*place, color=style[bool(name)].colour, marker=marker, markersize=4)
        if name and name not in named:
            named.add(name)
            below = {"xytext": (0, -7), "textcoords": "offset points", "va": "top"}
            axes.annotate(name, place, fontsize=7, ha="center", **below)
    axes.axhline(1e6 * tolerance, color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    quiet_axes(axes, x="override", y=f"largest contour error [{MICROMETRE}]")
    return figure
