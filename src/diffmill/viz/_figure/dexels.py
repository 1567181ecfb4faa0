"""Ends of the cut rays: the floor magnified in z, a wall magnified in x."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...workpiece import Stock
from .._style import (
    GREY,
    INK,
    LIGHT_GREY,
    label_colourbar,
    new_figure,
    quiet_axes,
    round_factor,
    scale_ratio,
    spread,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_POINTS_DRAWN = 40_000
# Where a path is off sideways, a ray may graze a wall that its ideal counterpart never
# meets: the next ideal end on it then lies on another wall, a tool's width away. Errors
# are mostly below the spacing of the rays, so that four spacings tell the two apart; on
# finer rays the median error says how far an end of the same wall may be.
_NEAR_SPACINGS, _FAR_SPACINGS = 4.0, 20.0
_MEDIANS = 5.0


class CutDexels(eqx.Module):
    """Ends of the rays that the cut has shortened, actual and ideal, in `work`.

    The two sets need not pair up: an actual end belongs to the nearest ideal end on
    the same ray, unless that is so far off that it must lie on another surface.

    Attributes:
        floor: Ends of z rays in the final stock [m], shape (point, 3).
        floor_ideal: Ends of z rays after the desired path [m], shape (other, 3).
        wall: Ends of x rays in the final stock [m], shape (wall, 3).
        wall_ideal: Ends of x rays after the desired path [m], shape (wall_other, 3).
        spacing: Distance of neighbouring rays [m].
    """

    floor: Float[np.ndarray, "point 3"]
    floor_ideal: Float[np.ndarray, "other 3"]
    wall: Float[np.ndarray, "wall 3"]
    wall_ideal: Float[np.ndarray, "wall_other 3"]
    spacing: float

    @classmethod
    def from_stocks(cls, stock: Stock, ideal: Stock) -> "CutDexels":
        """Return the ends that the tool has cut: floors of z rays, walls of x rays.

        Args:
            stock: The workpiece after the cut.
            ideal: The workpiece after the same cut on the desired path.

        Returns:
            Upper ends of z rays and both ends of x rays, where a pose made them.
        """
        origins = np.asarray(stock.origin), np.asarray(ideal.origin)
        if stock.grid_shape != ideal.grid_shape or not np.allclose(
            *origins, rtol=0.0, atol=1e-9
        ):
            raise ValueError(
                "Argument `ideal` must have the grid of rays of `stock`, "
                f"{stock.grid_shape}, but has {ideal.grid_shape} or another origin."
            )
        return cls(
            _cut_ends(stock, 2, is_upper_only=True),
            _cut_ends(ideal, 2, is_upper_only=True),
            _cut_ends(stock, 0),
            _cut_ends(ideal, 0),
            stock.spacing,
        )

    def floor_error(self) -> Float[np.ndarray, " point"]:
        """Height of each end of the floor above the ideal one [m], shape (point,).

        NaN where the ray has no ideal end near it.
        """
        return _of_one_surface(
            _ray_errors(self.floor, self.floor_ideal, 2), self.spacing
        )

    def wall_error(self) -> Float[np.ndarray, " wall"]:
        """Distance of each end of the walls from the ideal one along x [m].

        NaN where the ray has no ideal end near it.
        """
        return _of_one_surface(_ray_errors(self.wall, self.wall_ideal, 0), self.spacing)


def _of_one_surface(
    error: Float[np.ndarray, " point"], spacing: float
) -> Float[np.ndarray, " point"]:
    """Return the errors, NaN where the ideal end lies on another surface."""
    limit = np.clip(
        _MEDIANS * spread(error, 50.0),
        _NEAR_SPACINGS * spacing,
        _FAR_SPACINGS * spacing,
    )
    return np.where(np.abs(error) <= limit, error, np.nan)


def _ray_errors(
    points: Float[np.ndarray, "point 3"],
    ideal: Float[np.ndarray, "other 3"],
    axis: int,
) -> Float[np.ndarray, " point"]:
    """Distance of each ray end from the nearest ideal end on its ray [m].

    Args:
        points: Ends in the final stock [m], shape (point, 3).
        ideal: Ends after the desired path [m], shape (other, 3).
        axis: Axis along which the rays run: 0, 1 or 2.

    Returns:
        Signed difference along the axis [m], NaN where the ray has no ideal end,
        shape (point,).
    """
    if not points.shape[0] or not ideal.shape[0]:
        return np.full(points.shape[0], np.nan)
    across = [other for other in range(3) if other != axis]
    # Rays are at least micrometres apart: nanometres name them without doubt.
    keys = np.round(np.concatenate([points, ideal])[:, across] * 1e9).astype(np.int64)
    _, ray = np.unique(keys, axis=0, return_inverse=True)
    ray = ray.reshape(-1)
    both = np.concatenate([points[:, axis], ideal[:, axis]])
    # One sortable number: rays apart by more than any ray is long.
    stride = 4.0 * float(np.ptp(both)) + 1e-3
    order_key = ray * stride + (both - both.min())
    count = points.shape[0]
    order = np.argsort(order_key[count:])
    sorted_key, sorted_ray = order_key[count:][order], ray[count:][order]
    right = np.searchsorted(sorted_key, order_key[:count])
    best = np.full(count, np.nan)
    for side in (right - 1, right):
        index = np.clip(side, 0, sorted_key.shape[0] - 1)
        error = np.where(
            sorted_ray[index] == ray[:count],
            both[:count] - ideal[order[index], axis],
            np.nan,
        )
        is_better = np.isnan(best) | (np.abs(error) < np.abs(best))
        best = np.where(is_better & ~np.isnan(error), error, best)
    return best


def _cut_ends(
    stock: Stock, family: int, *, is_upper_only: bool = False
) -> Float[np.ndarray, "end 3"]:
    """Return the ends of one family that remember a tool pose."""
    ends = stock.ray_ends(family)
    is_counted = ends.is_cut & (ends.signs > 0) if is_upper_only else ends.is_cut
    return ends.points[is_counted]


def plot_cut_dexels(dexels: CutDexels) -> "matplotlib.figure.Figure":
    """Draw the cut ray ends of the floor in perspective and of one wall in profile.

    Args:
        dexels: Cut ends of z rays and of x rays, at least one.

    Returns:
        The figure, with a panel for each of the two that there is; the
        magnifications stand in the titles.
    """
    has_floor, has_wall = (bool(len(ends)) for ends in (dexels.floor, dexels.wall))
    heights = [4.4] * has_floor + [2.0] * has_wall
    figure = new_figure(sum(heights))
    rows = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)
    if has_floor:
        _draw_floor(rows[0, 0], dexels)
    if has_wall:
        _draw_wall(rows[-1, 0].subplots(), dexels)
    return figure


def _draw_floor(figure: "matplotlib.figure.SubFigure", dexels: CutDexels) -> None:
    """Draw the floor seen from the side and above, z magnified, coloured by error."""
    from matplotlib.ticker import MaxNLocator

    axes: Any = figure.add_subplot(projection="3d")
    error = dexels.floor_error()
    drawn = np.flatnonzero(np.isfinite(error))
    drawn = drawn[:: max(1, -(-drawn.size // _POINTS_DRAWN))]
    points, error = dexels.floor[drawn], error[drawn]
    sides = np.ptp(points[:, :2], axis=0) if drawn.size else np.ones(2)
    limit = spread(error, 99.0) or 1e-6
    # Four limits fill the drawn height, which is a quarter of the longer side.
    factor = round_factor(0.25 * float(sides.max()) / (3.0 * limit))
    image = axes.scatter(
        points[:, 0] * 1e3,
        points[:, 1] * 1e3,
        (points[:, 2] - error + factor * error) * 1e3,
        c=error * 1e6,
        cmap="RdBu_r",
        vmin=-limit * 1e6,
        vmax=limit * 1e6,
        s=2.0,
        linewidths=0,
        depthshade=False,
        rasterized=True,
    )
    depth = float(np.ptp(points[:, 2])) if drawn.size else 0.0
    spans = [*(sides * 1e3), max(depth, factor * 3 * limit) * 1e3]
    axes.set_box_aspect([max(span, 1e-3) for span in spans], zoom=1.35)
    axes.view_init(elev=32, azim=-62)
    axes.set_xlabel("x [mm]", fontsize=8.5, color=INK)
    axes.set_ylabel("y [mm]", fontsize=8.5, color=INK)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(LIGHT_GREY)
        axis.line.set_color(GREY)
    axes.grid(False)
    axes.tick_params(labelsize=7.5, pad=0, color=GREY)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    # Heights are magnified about the ideal floor: numbers belong to the colours.
    axes.set_zticks([])
    figure.suptitle(
        f"floor: ends of the z rays, error magnified {factor:g} times in z",
        fontsize=9,
        x=0.01,
        ha="left",
        color=INK,
    )
    bar = figure.colorbar(
        image, ax=axes, location="bottom", pad=0.04, aspect=40, shrink=0.55
    )
    label_colourbar(bar, r"z error [$\mathrm{\mu m}$]")


def _draw_wall(axes: "matplotlib.axes.Axes", dexels: CutDexels) -> None:
    """Draw the wall that has most ray ends: its x error along y."""
    error = dexels.wall_error()
    is_known = np.isfinite(error)
    points, error = dexels.wall[is_known], error[is_known]
    plane_um = np.round((points[:, 0] - error) * 1e6).astype(np.int64)
    planes, counts = np.unique(plane_um, return_counts=True)
    if not planes.size:
        quiet_axes(axes, title="no wall across x was cut")
        return
    wall = plane_um == planes[np.argmax(counts)]
    image = axes.scatter(
        points[wall, 1] * 1e3,
        error[wall] * 1e6,
        c=points[wall, 2] * 1e3,
        cmap="cividis",
        s=5,
        linewidths=0,
        rasterized=True,
    )
    axes.axhline(0.0, color=INK, linewidth=0.7, linestyle=(0, (4, 2)))
    bar = axes.figure.colorbar(image, ax=axes, pad=0.01, aspect=14)
    label_colourbar(bar, "z [mm]")
    title = f"wall at x = {planes[np.argmax(counts)] * 1e-3:.3f} mm"
    quiet_axes(axes, x="y [mm]", y=r"x error [$\mathrm{\mu m}$]", title=title)
    ratio = scale_ratio(axes, 1e-3, 1e-6)
    title += f": ends of the x rays, x magnified {ratio} times"
    axes.set_title(title, fontsize=9, loc="left", color=INK)
