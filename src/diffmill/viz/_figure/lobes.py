"""Stability lobes: limiting depth over the spindle speed."""

import math
from typing import TYPE_CHECKING

import numpy as np

from .._style import GREY, INK, case_style, legend_above, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray

_COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#56B4E9", "#E69F00")


def plot_lobes(lobes: "xarray.Dataset") -> "matplotlib.figure.Figure":
    """Draw the depth at which vibrations begin to grow over the spindle speed.

    Args:
        lobes: Dataset of `StabilityLobes`.

    Returns:
        The figure: a line for each place, open where no limit was found, what all of
        them allow as an area, and what the program cuts as points.
    """
    figure = new_figure(3.6)
    axes = figure.subplots()
    to_rpm = 30 / math.pi
    speed = to_rpm * np.asarray(lobes["speed"], np.float64)
    own = to_rpm * float(lobes.attrs["own_speed_rad_s"])
    depth = 1e3 * np.asarray(lobes["depth"], np.float64)
    limit = 1e3 * np.asarray(lobes["limit"], np.float64)
    highest = 1e3 * float(lobes.attrs["deepest_m"])
    shown = np.minimum(limit, highest)
    axes.fill_between(
        speed,
        shown.min(axis=0),
        color=case_style("corrected").colour,
        alpha=0.15,
        linewidth=0,
        label="stable at all places",
    )
    tips = 1e3 * np.asarray(lobes["position"], np.float64)
    for k, (x, y, z) in enumerate(tips):
        colour = _COLOURS[k % len(_COLOURS)]
        place = f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        is_found = limit[k] <= highest
        label = f"limit {place}"
        if not is_found.any():
            label = f"no limit up to {highest:.3g} mm {place}"
        line = np.where(is_found, limit[k], np.nan)
        axes.plot(speed, line, color=colour, linewidth=1.2, label=label)
        axes.plot([own], [depth[k]], "o", color=colour, markersize=5, mec=INK, mew=0.6)
    axes.axvline(own, color=GREY, linewidth=0.8, linestyle=":", label="the program")
    axes.set_ylim(0, 1.03 * highest)
    axes.margins(x=0)
    quiet_axes(axes, x="spindle speed [rpm]", y="depth of cut [mm]")
    legend_above(figure, axes, columns=2)
    return figure
