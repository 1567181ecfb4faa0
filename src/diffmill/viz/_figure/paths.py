"""Paths of all cases in plan and side view, the deviation magnified."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from .._cases import cutting_of, reference_case, shown_cases, values_of
from .._style import (
    INK,
    LIGHT_GREY,
    case_style,
    legend_above,
    new_figure,
    quiet_axes,
    round_factor,
    scale_ratio,
    spread,
)

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

_FRAME = "#555555"


def plot_paths(
    dataset: "xarray.Dataset", *, magnification: float | None = None
) -> "matplotlib.figure.Figure":
    """Draw the paths of all cases: plan view, two zooms and a side view.

    Args:
        dataset: A result of `simulate` or `correct`.
        magnification: Factor on the deviation in the plan view; by default one of
            1, 2, 5, 10, ... that makes the uncorrected error about 5 % of the part.

    Returns:
        The figure. The factor of every panel stands in its title.
    """
    figure, (plan, *zooms, side) = _panels(dataset)
    factor = magnification or plan_magnification(dataset)
    _draw_plan(plan, dataset, factor, None)
    plan.set_aspect("equal", adjustable="datalim")
    quiet_axes(
        plan,
        x="x [mm]",
        y="y [mm]",
        title=f"plan view, deviation x {factor:g}",
    )
    for axes, name, step in zip(zooms, "AB", zoom_steps(dataset), strict=False):
        _draw_zoom(axes, plan, dataset, step, name)
    legend_above(figure, plan, columns=3)
    _draw_side(side, dataset)
    return figure


def _sides(dataset: "xarray.Dataset") -> Float[np.ndarray, " 2"]:
    """Return how far the desired path reaches in x and y [m]."""
    desired = values_of(dataset, "desired", reference_case(dataset))[:, :2]
    return np.ptp(desired, axis=0)


def _panels(
    dataset: "xarray.Dataset",
) -> "tuple[matplotlib.figure.Figure, list[matplotlib.axes.Axes]]":
    """Return the figure and its panels: plan, zoom A, zoom B, side view."""
    width, height = _sides(dataset)
    if height < 0.7 * width:
        # A wide part: the plan takes the whole width, the zooms stand below it.
        plan_height = 1.0 + 6.0 * max(float(height / width), 0.15)
        rows = [plan_height, 3.3, 1.9]
        figure = new_figure(sum(rows) + 0.6)
        grid = figure.add_gridspec(3, 2, height_ratios=rows)
        cells = [grid[0, :], grid[1, 0], grid[1, 1], grid[2, :]]
    else:
        figure = new_figure(7.4)
        grid = figure.add_gridspec(
            3, 2, width_ratios=[1.75, 1.0], height_ratios=[1.0, 1.0, 0.72]
        )
        cells = [grid[:2, 0], grid[0, 1], grid[1, 1], grid[2, :]]
    return figure, [figure.add_subplot(cell) for cell in cells]


def plan_magnification(dataset: "xarray.Dataset") -> float:
    """Return the factor that makes the reference case's deviation visible.

    Args:
        dataset: The result.

    Returns:
        The largest of 1, 2, 5, 10, ... for which 95 % of the deviations in the
        plane stay below 5 % of the part's smaller side (of a slender part: of 30 %
        of the larger one).
    """
    name = reference_case(dataset)
    cutting = cutting_of(dataset, name)
    deviation = values_of(dataset, "deviation", name)[cutting, :2]
    sides = _sides(dataset)
    size = max(float(sides.min()), 0.3 * float(sides.max()))
    visible = spread(np.linalg.norm(deviation, axis=1))
    return round_factor(0.05 * size / visible) if visible > 0 else 1.0


def zoom_steps(dataset: "xarray.Dataset") -> tuple[int, int]:
    """Return the steps of the two places with the largest plane deviation.

    Args:
        dataset: The result.

    Returns:
        The step of the largest deviation of the reference case while cutting, and
        the largest one at least a quarter of the part away from it.
    """
    name = reference_case(dataset)
    desired = values_of(dataset, "desired", name)[:, :2]
    length = np.linalg.norm(values_of(dataset, "deviation", name)[:, :2], axis=1)
    score = np.where(cutting_of(dataset, name) & np.isfinite(length), length, -1.0)
    first = int(np.argmax(score))
    away = np.linalg.norm(desired - desired[first], axis=1)
    far = away > 0.25 * np.max(np.ptp(desired, axis=0))
    return first, int(np.argmax(np.where(far, score, -1.0)))


def _points_mm(
    dataset: "xarray.Dataset", case: str, factor: float
) -> Float[np.ndarray, "step 3"]:
    """Return the case's path with the deviation times `factor`; gaps in the air."""
    desired = values_of(dataset, "desired", case)
    points = desired + factor * values_of(dataset, "deviation", case)
    points[~cutting_of(dataset, case)] = np.nan
    return points * 1e3


def _draw_plan(
    axes: "matplotlib.axes.Axes",
    dataset: "xarray.Dataset",
    factor: float,
    rows: Bool[np.ndarray, " step"] | None,
    *,
    marker: str = "",
) -> None:
    """Draw desired and actual x, y; outside `rows` nothing."""
    desired = values_of(dataset, "desired", reference_case(dataset)) * 1e3
    keep = np.ones(desired.shape[0], dtype=bool) if rows is None else rows
    desired = np.where(keep[:, None], desired, np.nan)
    cuts = cutting_of(dataset, reference_case(dataset))[:, None]
    axes.plot(*desired[:, :2].T, color=LIGHT_GREY, linewidth=0.7, zorder=1)
    axes.plot(
        *np.where(cuts, desired, np.nan)[:, :2].T,
        color=INK,
        linewidth=0.7,
        linestyle=(0, (4, 2)),
        label="desired",
        zorder=3.5,
    )
    for name in shown_cases(dataset):
        style = case_style(name)
        points = np.where(keep[:, None], _points_mm(dataset, name, factor), np.nan)
        axes.plot(
            points[:, 0],
            points[:, 1],
            color=style.colour,
            linewidth=style.width,
            linestyle=style.line,
            marker=marker,
            markersize=2.5,
            label=style.label,
        )


def _draw_zoom(
    axes: "matplotlib.axes.Axes",
    plan: "matplotlib.axes.Axes",
    dataset: "xarray.Dataset",
    step: int,
    name: str,
) -> None:
    """Draw the surroundings of one step at a scale that shows the deviation."""
    from matplotlib.patches import Rectangle

    reference = reference_case(dataset)
    desired = values_of(dataset, "desired", reference)
    centre = desired[step, :2] * 1e3
    travel = np.linalg.norm(np.diff(desired[:, :2], axis=0), axis=1)
    pitch = float(np.median(travel[travel > 0])) if (travel > 0).any() else 1e-4
    plane = np.nan_to_num(values_of(dataset, "deviation", reference)[step, :2])
    deviation = np.linalg.norm(plane)
    # Wide enough for a few teeth and for the deviation itself.
    half = 1e3 * max(4.0 * float(deviation), 8.0 * pitch)
    factor = round_factor(half * 1e-3 / (3.0 * max(float(deviation), 1e-12)))
    near = np.max(np.abs(desired[:, :2] * 1e3 - centre), axis=1) < 4.0 * half
    _draw_plan(axes, dataset, factor, near, marker=".")
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_aspect("equal", adjustable="box")
    scale = "true scale" if factor == 1.0 else f"deviation x {factor:g}"
    quiet_axes(axes, x="x [mm]", y="y [mm]", title=f"zoom {name}, {scale}")
    for side in axes.spines.values():
        side.set_visible(True)
        side.set_color(_FRAME)
        side.set_linewidth(0.8)
    # The square is the zoom's own where it is not too small to be seen.
    if 2 * half > 0.02 * 1e3 * float(_sides(dataset).max()):
        corner = (float(centre[0]) - half, float(centre[1]) - half)
        plan.add_patch(
            Rectangle(corner, 2 * half, 2 * half, fill=False, color=_FRAME, zorder=4)
        )
    else:
        plan.plot(
            *centre, marker="s", markersize=7, markerfacecolor="none", color=_FRAME
        )
    plan.annotate(
        name,
        (float(centre[0]) + half, float(centre[1]) + half),
        xytext=(3, 2),
        textcoords="offset points",
        fontsize=9,
        color=_FRAME,
        fontweight="bold",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8},
        zorder=5,
    )


def _draw_side(axes: "matplotlib.axes.Axes", dataset: "xarray.Dataset") -> None:
    """Draw the height above the desired floor over x, seen along y."""
    axes.axhline(0.0, color=INK, linewidth=0.7, linestyle=(0, (4, 2)), zorder=3.5)
    for name in shown_cases(dataset):
        style = case_style(name)
        deviation = values_of(dataset, "deviation", name)[:, 2] * 1e6
        deviation[~cutting_of(dataset, name)] = np.nan
        x = values_of(dataset, "desired", name)[:, 0] * 1e3
        axes.plot(x, deviation, color=style.colour, linewidth=style.width, alpha=0.9)
    quiet_axes(axes, x="x [mm]", y=r"z - desired z [$\mathrm{\mu m}$]")
    # The title is part of the layout from which the ratio is read.
    axes.set_title("side view", fontsize=9, loc="left", color=INK)
    ratio = scale_ratio(axes, 1e-3, 1e-6)
    axes.set_title(
        f"side view: height above the desired path, z drawn {ratio} times larger",
        fontsize=9,
        loc="left",
        color=INK,
    )
