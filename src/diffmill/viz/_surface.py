"""The machined floor: map of its height error, histogram, 3-D view for browsers."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ._style import (
    INK,
    MICROMETRE,
    case_style,
    label_colourbar,
    new_figure,
    quiet_axes,
    spread,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.cm
    import matplotlib.figure

_BROWSER_CELLS = 160  # per side: keeps the report small and turning it smooth


class SurfaceError(eqx.Module):
    """Height of the machined surface above the ideal one, on a grid.

    Attributes:
        x: Grid coordinates in `work` [m], shape (column,).
        y: Grid coordinates in `work` [m], shape (row,).
        error: Signed height error [m], positive where material was left, NaN where
            nothing was to be cut, shape (row, column).
    """

    x: Float[np.ndarray, " column"]
    y: Float[np.ndarray, " row"]
    error: Float[np.ndarray, "row column"]


def plot_surface_error(maps: dict[str, SurfaceError]) -> "matplotlib.figure.Figure":
    """Draw a map of the height error and its histogram, one row per case.

    Args:
        maps: Surface error by case; the maps share one colour scale, that of the
            largest error, and each histogram has its own.

    Returns:
        The figure.
    """
    if not maps:
        raise ValueError("Argument `maps` must hold at least one case, but is empty.")
    first = next(iter(maps.values()))
    aspect = float(np.ptp(first.y) / max(np.ptp(first.x), 1e-12))
    figure = new_figure(min(9.5, 0.5 + len(maps) * max(1.9, 4.1 * aspect)))
    grid = figure.subplots(len(maps), 2, squeeze=False, width_ratios=[1.9, 1.0])
    limit = max(spread(item.error * 1e6, 99.0) for item in maps.values()) or 1.0
    for row, (name, item) in enumerate(maps.items()):
        _draw_map(grid[row, 0], item, limit)
        label = case_style(name).label
        quiet_axes(grid[row, 0], x="x [mm]", y="y [mm]", title=label, has_grid=False)
        _draw_histogram(grid[row, 1], item, case_style(name).colour)
    image = _colours(limit)
    bar = figure.colorbar(image, ax=grid[:, 0], pad=0.02, aspect=30, extend="both")
    label_colourbar(bar, r"height error [$\mathrm{\mu m}$]")
    return figure


def _colours(limit_um: float) -> "matplotlib.cm.ScalarMappable":
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(-limit_um, limit_um), "RdBu_r")


def _draw_map(
    axes: "matplotlib.axes.Axes", item: SurfaceError, limit_um: float
) -> None:
    axes.set_facecolor("#e4e4e4")
    axes.pcolormesh(
        item.x * 1e3,
        item.y * 1e3,
        np.ma.masked_invalid(item.error * 1e6),
        cmap="RdBu_r",
        vmin=-limit_um,
        vmax=limit_um,
        shading="nearest",
        rasterized=True,
    )
    axes.set_aspect("equal")


def _draw_histogram(
    axes: "matplotlib.axes.Axes", item: SurfaceError, colour: str
) -> None:
    """Draw the share of area by error, with its rms and its 95 % limits."""
    error_um = item.error[np.isfinite(item.error)] * 1e6
    quiet_axes(axes, x=r"height error [$\mathrm{\mu m}$]", y="share of area [%]")
    if not error_um.size:
        return
    low, high = np.percentile(error_um, [0.5, 99.5])
    pad = max(0.1 * (high - low), 0.05)
    weights = np.full(error_um.shape, 100.0 / error_um.size)
    axes.hist(
        error_um, bins=40, range=(low - pad, high + pad), weights=weights, color=colour
    )
    axes.axvline(0.0, color=INK, linewidth=0.7)
    bottom, top = np.percentile(error_um, [2.5, 97.5])
    axes.set_title(
        f"rms {np.sqrt(np.mean(error_um**2)):.1f}, mean {np.mean(error_um):.1f},\n"
        rf"95 % in {bottom:.1f} to {top:.1f} $\mathrm{{\mu m}}$",
        fontsize=8,
        loc="left",
        color=INK,
    )


def surface_html(maps: dict[str, SurfaceError]) -> str:
    """Return a block of HTML with the surface to turn around, by plotly.

    plotly.js is part of the block (about 5 MB), so the page needs no network.

    Args:
        maps: Surface error by case; buttons switch between cases.

    Returns:
        A `<div>` with its script; NaN cells are holes.
    """
    import plotly.graph_objects as go

    first = next(iter(maps.values()))
    limit = max(spread(item.error * 1e6, 99.0) for item in maps.values()) or 1.0
    surfaces = [
        _browser_surface(item, limit, name == next(iter(maps)))
        for name, item in maps.items()
    ]
    figure = go.Figure([go.Surface(**surface) for surface in surfaces])
    width_um = max(float(np.ptp(first.x)), 1e-9) * 1e6
    ratio = float(np.ptp(first.y)) * 1e6 / width_um
    # The box is 1.5 wide for the part's width and 0.7 high for 4 limits.
    factor = float(f"{0.7 / (4.0 * limit) / (1.5 / width_um):.2g}")
    figure.update_layout(
        template="plotly_white",
        margin={"l": 0, "r": 0, "t": 30, "b": 0},
        height=520,
        font={"family": "system-ui, sans-serif", "size": 12},
        scene={
            "xaxis": {"title": {"text": "x [mm]"}},
            "yaxis": {"title": {"text": "y [mm]"}},
            "zaxis": {
                "title": {"text": f"error [{MICROMETRE}]"},
                "range": [-2 * limit, 2 * limit],
            },
            "aspectmode": "manual",
            "aspectratio": {"x": 1.5, "y": 1.5 * ratio, "z": 0.7},
            "camera": {
                "eye": {"x": 1.0, "y": -1.7, "z": 1.15},
                "center": {"x": 0.0, "y": 0.0, "z": -0.15},
            },
        },
        annotations=[
            {
                "text": f"height error drawn {factor:g} times larger",
                "x": 0,
                "y": 1.07,
                "xref": "paper",
                "yref": "paper",
                "xanchor": "left",
                "showarrow": False,
            }
        ],
        updatemenus=[_case_buttons(list(maps))] if len(maps) > 1 else [],
    )
    return figure.to_html(
        full_html=False,
        include_plotlyjs=True,
        div_id="surface-3d",
        config={"displaylogo": False, "responsive": True},
    )


def _case_buttons(names: list[str]) -> dict:
    """Return plotly buttons that show one case at a time."""
    buttons = [
        {
            "label": case_style(name).label,
            "method": "restyle",
            "args": [{"visible": [other == name for other in names]}],
        }
        for name in names
    ]
    return {
        "type": "buttons",
        "direction": "right",
        "buttons": buttons,
        "x": 0.0,
        "xanchor": "left",
        "y": 0.98,
        "yanchor": "top",
    }


def _browser_surface(item: SurfaceError, limit_um: float, is_visible: bool) -> dict:
    """Return one plotly surface, thinned and rounded to what a screen can show."""
    rows = slice(None, None, max(1, -(-item.y.shape[0] // _BROWSER_CELLS)))
    columns = slice(None, None, max(1, -(-item.x.shape[0] // _BROWSER_CELLS)))
    return {
        "x": np.round(item.x[columns] * 1e3, 3).astype(np.float32),
        "y": np.round(item.y[rows] * 1e3, 3).astype(np.float32),
        "z": np.round(item.error[rows, columns] * 1e6, 2).astype(np.float32),
        "colorscale": "RdBu",
        "reversescale": True,
        "cmin": -limit_um,
        "cmax": limit_um,
        "visible": is_visible,
        "colorbar": {"title": {"text": MICROMETRE}, "len": 0.7},
    }
