"""The machined surface: map of its error and histogram."""

from typing import TYPE_CHECKING

import jax
import numpy as np

from ...workpiece import SurfaceError
from .._style import (
    INK,
    case_style,
    label_colourbar,
    new_figure,
    quiet_axes,
    spread,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure


# Size of the points of walls, which lie above each other [pt^2].
_WALL_POINT_SIZE = 12.0


def plot_surface_error(errors: dict[str, SurfaceError]) -> "matplotlib.figure.Figure":
    """Draw a map of the surface error and its histogram, one row per case.

    The map is a plan: floors where they are, walls as the lines that they are from
    above, with the largest error over their height.

    Args:
        errors: Surface error by case; the maps share one colour scale, that of the
            largest errors, and each histogram has its own.

    Returns:
        The figure.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if not errors:
        raise ValueError("Argument `errors` must hold at least one case, but is empty.")
    # The end of a ray along a face is a step in it, no error of the face.
    across = lambda item: jax.tree.map(lambda x: x[item.is_across], item)
    errors = {name: across(item) for name, item in errors.items()}
    points = np.concatenate([item.points for item in errors.values()])
    width, depth = np.ptp(points[:, :2], axis=0) if len(points) else (1.0, 1.0)
    aspect = float(depth / max(width, 1e-12))
    figure = new_figure(min(9.5, 0.5 + len(errors) * max(1.9, 4.1 * aspect)))
    grid = figure.subplots(len(errors), 2, squeeze=False, width_ratios=[1.9, 1.0])
    limit = max(spread(item.error * 1e6, 99.0) for item in errors.values()) or 1.0
    x = [item.points[item.family == 2, 0] for item in errors.values()]
    steps = np.diff(np.unique(np.round(np.concatenate(x), 9)))
    spacing = float(steps.min()) if steps.size else 0.0
    # A floor is a plane, not dots: as wide as the rays are apart, on about 3.6 inch.
    size = max(2.0, 1.1 * (3.6 * 72 / max(width, 1e-12) * spacing) ** 2)
    for row, (name, item) in enumerate(errors.items()):
        _draw_map(grid[row, 0], item, limit, size)
        label = case_style(name).label
        quiet_axes(grid[row, 0], x="x [mm]", y="y [mm]", title=label, has_grid=False)
        _draw_histogram(grid[row, 1], item, case_style(name).colour)
    image = ScalarMappable(Normalize(-limit, limit), "RdBu_r")
    bar = figure.colorbar(image, ax=grid[:, 0], pad=0.02, aspect=30, extend="both")
    label_colourbar(bar, r"surface error [$\mathrm{\mu m}$]")
    return figure


def _draw_map(
    axes: "matplotlib.axes.Axes", item: SurfaceError, limit_um: float, size: float
) -> None:
    axes.set_facecolor("#e4e4e4")
    # The larger error above the smaller one, walls above floors.
    order = np.lexsort((np.abs(item.error), ~item.is_floor))
    x, y, _ = item.points[order].T * 1e3
    axes.scatter(
        x,
        y,
        c=item.error[order] * 1e6,
        s=np.where(item.is_floor[order], size, np.minimum(size, _WALL_POINT_SIZE)),
        marker="s",
        linewidths=0,
        cmap="RdBu_r",
        vmin=-limit_um,
        vmax=limit_um,
        rasterized=True,
    )
    axes.set_aspect("equal")


def _draw_histogram(
    axes: "matplotlib.axes.Axes", item: SurfaceError, colour: str
) -> None:
    """Draw the share of area by error, with the rms of walls and floors."""
    error_um = item.error * 1e6
    quiet_axes(axes, x=r"surface error [$\mathrm{\mu m}$]", y="share of area [%]")
    if not error_um.size:
        return
    low, high = np.percentile(error_um, [0.5, 99.5])
    pad = max(0.1 * (high - low), 0.05)
    kinds = {"floors": item.is_floor, "walls": ~item.is_floor}
    axes.hist(
        [error_um[rows] for rows in kinds.values()],
        bins=40,
        range=(low - pad, high + pad),
        weights=[100 * item.area_share[rows] for rows in kinds.values()],
        color=[colour, INK],
        alpha=0.8,
        stacked=True,
        label=list(kinds),
    )
    axes.axvline(0.0, color=INK, linewidth=0.7)
    axes.legend(fontsize=7, frameon=False)
    # The figures of the tables: of the points that the tool cut.
    measures = item.measures()
    figures = {
        "floors": (measures.floor_rms, measures.floor_mean),
        "walls": (measures.wall_rms, measures.wall_mean),
    }
    axes.set_title(
        "\n".join(
            f"{name}: rms {1e6 * rms:.1f}, mean {1e6 * mean:.1f} "
            r"$\mathrm{\mu m}$"
            for name, (rms, mean) in figures.items()
            if np.isfinite(rms)
        ),
        fontsize=8,
        loc="left",
        color=INK,
    )
