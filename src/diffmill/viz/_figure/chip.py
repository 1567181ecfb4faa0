"""The chip chart h(phi, z) of one tooth, as a map and disc by disc."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...sim import ToothChip
from .._style import label_colourbar, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.cm
    import matplotlib.figure

# Chips thinner than this share of the thickest one are not shown.
_LEAST = 0.01


def plot_chip(chart: ToothChip) -> "matplotlib.figure.Figure":
    """Draw the chip chart as a colour map above its discs as curves.

    Args:
        chart: The chip of one tooth.

    Returns:
        The figure; white is where the tooth cuts less than a hundredth of the most.
    """
    figure = new_figure(5.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.15])
    angle_deg = np.rad2deg(chart.immersion_angle)
    chip_um = chart.chip_thickness * chart.weight * 1e6
    is_cut = chip_um > _LEAST * max(float(chip_um.max()), 1e-6)
    shown = np.ma.masked_where(~is_cut, chip_um)
    image = top.pcolormesh(
        _edges(angle_deg),
        _edges(chart.height * 1e3),
        shown,
        cmap="viridis",
        vmin=0.0,
        rasterized=True,
    )
    bar = figure.colorbar(image, ax=top, pad=0.01, aspect=12)
    label_colourbar(bar, r"$h$ [$\mathrm{\mu m}$]")
    quiet_axes(
        top,
        y="height above the tip [mm]",
        title=r"chip thickness $h(\varphi, z)$, weighted with the engagement",
    )
    # Discs above the material would only take room.
    cutting = np.flatnonzero(is_cut.any(axis=1))
    count = int(cutting[-1]) + 1 if cutting.size else chart.height.shape[0]
    highest = float(_edges(chart.height * 1e3)[count])
    top.set_ylim(0.0, highest)
    colours = _draw_discs(
        bottom, angle_deg, chart.height[cutting] * 1e3, chip_um[cutting], highest
    )
    bar = figure.colorbar(colours, ax=bottom, pad=0.01, aspect=14)
    label_colourbar(bar, "height of the disc [mm]")
    quiet_axes(
        bottom,
        x=r"immersion angle $\varphi$ from the left of the feed [deg]",
        y=r"$h$ [$\mathrm{\mu m}$]",
        title="the same, one curve per disc",
    )
    cut_deg = angle_deg[is_cut.any(axis=0)]
    low, high = (cut_deg.min(), cut_deg.max()) if cut_deg.size else (0.0, 360.0)
    pad = 0.06 * (high - low) + 1.0
    bottom.set_xlim(float(low - pad), float(high + pad))
    return figure


def _edges(middles: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the cell borders around increasing middles, halfway between them."""
    if middles.shape[0] < 2:
        return np.array([middles[0] - 0.5, middles[0] + 0.5])
    inner = (middles[1:] + middles[:-1]) / 2
    ends = 2 * middles[[0, -1]] - inner[[0, -1]]
    return np.concatenate([ends[:1], inner, ends[1:]])


def _draw_discs(
    axes: "matplotlib.axes.Axes",
    angle_deg: Float[np.ndarray, " angle"],
    height_mm: Float[np.ndarray, " element"],
    chip_um: Float[np.ndarray, "element angle"],
    highest: float,
) -> "matplotlib.cm.ScalarMappable":
    """Draw h(phi) of discs that cut, low ones dark; return the colours for a bar."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    colours = ScalarMappable(Normalize(0.0, highest), "cividis")
    # Discs often coincide: thick lines first, so that every one stays visible.
    widths = np.linspace(3.2, 0.8, max(len(height_mm), 1))
    for height, chip, width in zip(height_mm, chip_um, widths, strict=False):
        axes.plot(angle_deg, chip, color=colours.to_rgba(height), linewidth=width)
    axes.set_ylim(bottom=0.0)
    return colours
