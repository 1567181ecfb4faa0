"""Paths of all cases in plan and side view, the deviation magnified."""

from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...toolpath import contour_vector
from .._cases import (
    ABSCISSA_LABELS,
    abscissa,
    chosen_case,
    cutting_of,
    reference_case,
    shown_cases,
    values_of,
)
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
# Seen from above.
_PLANE = np.array([1.0, 1.0, 0.0])
_SMALLEST = 1e-6  # half side of the smallest zoom [m], for paths without any error


class _PathFromAbove(NamedTuple):
    """Path of a case from above.

    Attributes:
        actual: The path, its z taken out [m], shape (step, 3).
        across: Its way from the desired line [m], shape (step, 3).
    """

    actual: Float[np.ndarray, "step 3"]
    across: Float[np.ndarray, "step 3"]


class Place(eqx.Module):
    """A place of the path that a zoom shows.

    Attributes:
        name: Letter by which the plan view marks it.
        case: Case that is far off there.
        centre: Point of the desired line from which the case is off, x and y [m].
        distance: Distance of the case from the desired line in plan view [m].
        is_worst: True if the case is nowhere farther off.
    """

    name: str = eqx.field(static=True)
    case: str = eqx.field(static=True)
    centre: Float[np.ndarray, " 2"]
    distance: float
    is_worst: bool = eqx.field(static=True, default=True)


def plot_paths(
    dataset: "xarray.Dataset", *, magnification: float | None = None
) -> "matplotlib.figure.Figure":
    """Draw the paths of all cases: plan view, two zooms and a side view.

    Args:
        dataset: A result of `simulate` or `correct`.
        magnification: Factor on the deviation in the plan view; by default one of
            1, 2, 5, 10, ... that makes the uncorrected error about 5 % of the part.

    Returns:
        The figure. Every panel states its magnification in its title; the zooms show
        the two `worst_places`.
    """
    figure, (plan, *zooms, side) = _panels(dataset)
    factor = magnification or plan_magnification(dataset)
    _draw_plan(plan, dataset, factor)
    plan.set_aspect("equal", adjustable="datalim")
    quiet_axes(
        plan,
        x="x [mm]",
        y="y [mm]",
        title="plan view, "
        + (f"distance magnified {factor:g} times" if factor != 1 else "true scale"),
    )
    for axes, place in zip(zooms, worst_places(dataset), strict=True):
        _draw_zoom(axes, plan, dataset, place)
    legend_above(figure, plan, columns=3)
    _draw_side(side, dataset)
    return figure


def _sides(dataset: "xarray.Dataset") -> Float[np.ndarray, " 2"]:
    """Extent of the desired path in x and y [m]."""
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


def worst_places(dataset: "xarray.Dataset") -> tuple[Place, Place]:
    """Return the two places that the zooms show.

    Args:
        dataset: The result.

    Returns:
        A, where the reference case is farthest from the desired line in plan view
        while cutting; and B, where the corrected case is. Without a corrected case
        that is drawn, B is the worst place of the reference case at least a quarter
        of the part away from A.
    """
    reference, chosen = reference_case(dataset), chosen_case(dataset)
    plan = _in_plan(dataset, reference)
    first = _farthest(dataset, "A", reference, plan, None)
    if chosen != reference and chosen in shown_cases(dataset):
        plan = _in_plan(dataset, chosen)
        return first, _farthest(dataset, "B", chosen, plan, None)
    return first, _farthest(dataset, "B", reference, plan, first.centre)


def _farthest(
    dataset: "xarray.Dataset",
    name: str,
    case: str,
    plan: _PathFromAbove,
    apart: Float[np.ndarray, " 2"] | None,
) -> Place:
    """Place where a case is farthest off in `_in_plan`, not near the point `apart`.

    A tool that is late on the line is not off it: the longest deviation would mostly
    be where a correction lets the tool lag.
    """
    desired = values_of(dataset, "desired", case)
    actual, across = plan
    off = np.linalg.norm(across, axis=1)
    is_known = cutting_of(dataset, case) & np.isfinite(off)
    if apart is not None:
        away = np.linalg.norm(desired[:, :2] - apart, axis=1)
        is_known &= away > 0.25 * np.max(_sides(dataset))
    if not is_known.any():
        return Place(name, case, desired[0, :2], 0.0, apart is None)
    step = int(np.argmax(np.where(is_known, off, -1.0)))
    centre = (actual - across)[step, :2]
    return Place(name, case, centre, float(off[step]), apart is None)


def _points_mm(
    dataset: "xarray.Dataset", case: str, factor: float
) -> Float[np.ndarray, "step 3"]:
    """Points of a path whose distance from the line is magnified [mm].

    A tool that is late on the line stays on it; gaps in the air.
    """
    points = _plan_path(dataset, case)
    if factor != 1:
        points, across = _in_plan(dataset, case)
        points += (factor - 1) * across
    points[~cutting_of(dataset, case)] = np.nan
    return points * 1e3


def _in_plan(dataset: "xarray.Dataset", case: str) -> _PathFromAbove:
    """Path of a case from above, and its way from the desired line [m]."""
    desired = values_of(dataset, "desired", case) * _PLANE
    actual = _plan_path(dataset, case)
    across = np.asarray(contour_vector(actual, desired), np.float64)
    return _PathFromAbove(actual, across)


def _plan_path(dataset: "xarray.Dataset", case: str) -> Float[np.ndarray, "step 3"]:
    """Path of a case from above [m]: the one that the walls show, where it is known."""
    # The deviation that the contour error counts.
    kind = "surface_deviation" if "surface_deviation" in dataset else "deviation"
    path = values_of(dataset, "desired", case) + values_of(dataset, kind, case)
    return path * _PLANE


def _draw_plan(
    axes: "matplotlib.axes.Axes",
    dataset: "xarray.Dataset",
    factor: float,
    *,
    marker: str = "",
) -> None:
    """Draw desired and actual x, y."""
    desired = values_of(dataset, "desired", reference_case(dataset)) * 1e3
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
        points = _points_mm(dataset, name, factor)
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
    place: Place,
) -> None:
    """Draw the surroundings of a place so near that the distance there shows.

    True to scale: about a corner, where most corrections are at their worst, magnified
    deviations would draw a tool that is late as one that leaves the path.
    """
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator

    centre = place.centre * 1e3
    half = 1e3 * max(4.0 * place.distance, _SMALLEST)
    _draw_plan(axes, dataset, 1.0, marker=".")
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_aspect("equal", adjustable="box")
    off = f"{float(f'{1e6 * place.distance:.3g}'):g}"
    worst = " at its worst" if place.is_worst else ""
    title = (
        f"{place.name}: {case_style(place.case).label}{worst},\n"
        rf"{off} $\mathrm{{\mu m}}$ off in plan, true scale"
    )
    quiet_axes(axes, x="x [mm]", y="y [mm]", title=title)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.ticklabel_format(useOffset=False)
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
    # On opposite sides of the squares, which may lie upon each other.
    sign = 1 if place.name == "A" else -1
    plan.annotate(
        place.name,
        (float(centre[0]) + sign * half, float(centre[1]) + sign * half),
        xytext=(5 * sign, 4 * sign),
        textcoords="offset points",
        horizontalalignment="left" if sign > 0 else "right",
        verticalalignment="bottom" if sign > 0 else "top",
        fontsize=9,
        color=_FRAME,
        fontweight="bold",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8},
        zorder=5,
    )


def _draw_side(axes: "matplotlib.axes.Axes", dataset: "xarray.Dataset") -> None:
    """Draw the height above the desired path over the path length."""
    axes.axhline(0.0, color=INK, linewidth=0.7, linestyle=(0, (4, 2)), zorder=3.5)
    for name in shown_cases(dataset):
        style = case_style(name)
        deviation = values_of(dataset, "deviation", name)[:, 2] * 1e6
        deviation[~cutting_of(dataset, name)] = np.nan
        along = abscissa(dataset, name, "path_length")
        axes.plot(
            along, deviation, color=style.colour, linewidth=style.width, alpha=0.9
        )
    quiet_axes(
        axes, x=ABSCISSA_LABELS["path_length"], y=r"z - desired z [$\mathrm{\mu m}$]"
    )
    # The title is part of the layout from which the ratio is read.
    axes.set_title("side view", fontsize=9, loc="left", color=INK)
    ratio = scale_ratio(axes, 1e-3, 1e-6)
    axes.set_title(
        f"side view: height above the desired path, magnified {ratio} times",
        fontsize=9,
        loc="left",
        color=INK,
    )
