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


def plot_chip(chart: ToothChip) -> "matplotlib.figure.Figure":
    """Draw the chip chart as a colour map above its discs as curves.

    Args:
        chart: The chip of one tooth.

    Returns:
        The figure; white is where the tooth does not cut.
    """
    figure = new_figure(5.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.15])
    angle_deg = np.rad2deg(chart.immersion_angle)
    chip_um = chart.chip_thickness * chart.weight * 1e6
    shown = np.ma.masked_where(chip_um <= 1e-6, chip_um)
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
    cutting = np.flatnonzero((chip_um > 1e-6).any(axis=1))
    count = int(cutting[-1]) + 1 if cutting.size else chart.height.shape[0]
    top.set_ylim(0.0, _edges(chart.height * 1e3)[count])
    colours = _draw_discs(
        bottom, angle_deg, chart.height[:count] * 1e3, chip_um[:count]
    )
    bar = figure.colorbar(colours, ax=bottom, pad=0.01, aspect=14)
    label_colourbar(bar, "height of the disc [mm]")
    quiet_axes(
        bottom,
        x=r"immersion angle $\varphi$ from the left of the feed [deg]",
        y=r"$h$ [$\mathrm{\mu m}$]",
        title="the same, one curve per disc",
    )
    low, high = _cutting_range(chart)
    pad = 0.06 * (high - low) + 1.0
    bottom.set_xlim(low - pad, high + pad)
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
) -> "matplotlib.cm.ScalarMappable":
    """Draw h(phi) of every disc, low discs dark; return the colours for a bar."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    edges = _edges(height_mm)
    colours = ScalarMappable(Normalize(edges[0], edges[-1]), "cividis")
    cuts = np.flatnonzero((chip_um > 1e-6).any(axis=1))
    # Discs often coincide: thick lines first, so that every one stays visible.
    widths = np.linspace(3.2, 0.8, max(cuts.size, 1))
    for element, width in zip(cuts, widths, strict=False):
        axes.plot(
            angle_deg,
            chip_um[element],
            color=colours.to_rgba(height_mm[element]),
            linewidth=width,
        )
    axes.set_ylim(bottom=0.0)
    return colours


def _cutting_range(chart: ToothChip) -> tuple[float, float]:
    """Return the first and the last angle at which the tooth cuts [deg]."""
    cuts = (chart.chip_thickness * chart.weight > 1e-12).any(axis=0)
    if not cuts.any():
        return 0.0, 360.0
    angle_deg = np.rad2deg(chart.immersion_angle[cuts])
    return float(angle_deg.min()), float(angle_deg.max())
