"""The chip chart h(phi, z) of one tooth, as a map and disc by disc."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...sim import ToothChip
from .._style import GREY, INK, label_colourbar, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.cm
    import matplotlib.figure


class ChipChart(eqx.Module):
    """Chip thickness that one tooth meets, over its angle and along the axis.

    Attributes:
        immersion_angle: Angle phi in the feed frame, clockwise from the left of the
            feed [rad], equally spaced, shape (angle,).
        height: Height of the middle of each disc above the tip [m], shape (element,).
        chip_thickness: Chip thickness h [m], shape (element, angle).
        weight: Fraction of the sample that is in stock, from 0 to 1, shape
            (element, angle).
        entry_angle: Analytic entry angle [rad] to mark, or None.
        exit_angle: Analytic exit angle [rad] to mark, or None.
    """

    immersion_angle: Float[np.ndarray, " angle"]
    height: Float[np.ndarray, " element"]
    chip_thickness: Float[np.ndarray, "element angle"]
    weight: Float[np.ndarray, "element angle"]
    entry_angle: float | None = None
    exit_angle: float | None = None

    @classmethod
    def from_tooth(cls, chip: ToothChip, columns: int) -> "ChipChart":
        """Return the samples of a tooth sorted by angle and height.

        Args:
            chip: The chip that the tooth meets in a revolution.
            columns: Samples per revolution.

        Returns:
            The chip in the feed frame: angle 0 is on the left of the feed, the angle
            grows clockwise. Angles of a helical cutter are true to half a sample.
        """
        slot = np.round(chip.angle / (2 * np.pi) * columns - 0.5).astype(np.int64)
        element = np.broadcast_to(np.arange(chip.height.size), slot.shape)
        at = (element[chip.is_of_tooth], slot[chip.is_of_tooth] % columns)
        chart, share = np.zeros((2, chip.height.size, columns))
        chart[at] = chip.chip_thickness[chip.is_of_tooth]
        share[at] = chip.weight[chip.is_of_tooth]
        # The left of the feed is a quarter turn before it.
        left = chip.feed_angle - np.pi / 2
        turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns - left
        turn = (turn + np.pi / 2) % (2 * np.pi) - np.pi / 2
        order = np.argsort(turn)
        return cls(turn[order], chip.height, chart[:, order], share[:, order])


def plot_chip(chart: ChipChart) -> "matplotlib.figure.Figure":
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
    _mark_angles(chart, (top, bottom))
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


def _mark_angles(
    chart: ChipChart, panels: "tuple[matplotlib.axes.Axes, matplotlib.axes.Axes]"
) -> None:
    """Show the cutting range with some air around it, and the analytic angles."""
    angle_deg = np.rad2deg(chart.immersion_angle)
    cuts = (chart.chip_thickness * chart.weight > 1e-12).any(axis=0)
    low, high = (
        (angle_deg[cuts].min(), angle_deg[cuts].max()) if cuts.any() else (0, 360)
    )
    pad = 0.06 * (high - low) + 1.0
    panels[1].set_xlim(low - pad, high + pad)
    for name, angle in (("entry", chart.entry_angle), ("exit", chart.exit_angle)):
        if angle is None:
            continue
        for axes in panels:
            axes.axvline(np.rad2deg(angle), color=GREY, linewidth=0.9, linestyle=":")
        panels[1].annotate(
            f"{name} {np.rad2deg(angle):.1f} deg",
            (float(np.rad2deg(angle)), 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(-3 if name == "exit" else 3, -3),
            textcoords="offset points",
            rotation=90,
            va="top",
            ha="right" if name == "exit" else "left",
            fontsize=7.5,
            color=INK,
        )
