"""Deviation and contour error over time or path length, all cases."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from .._cases import (
    ABSCISSA_LABELS,
    Abscissa,
    abscissa,
    case_names,
    cutting_of,
    reference_case,
    shown_cases,
    values_of,
)
from .._style import case_style, legend_above, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray

_FLOOR_UM = 1e-2  # below this the logarithmic panel shows nothing of interest


def plot_deviation(
    dataset: "xarray.Dataset", *, over: Abscissa = "time"
) -> "matplotlib.figure.Figure":
    """Draw the deviation in x, y, z and the contour error.

    Args:
        dataset: A result of `simulate` or `correct`.
        over: Quantity of the horizontal axis: the time, or the length of the desired
            path.

    Returns:
        The figure: three components, the contour error, and its absolute value on
        a logarithmic scale, on which small errors stay visible beside large ones.
        Grey bands are steps that do not cut, where curves may leave the panel. A case
        that is off by more than twice as much as the uncorrected one appears on the
        logarithmic scale alone. There the error to be expected of a machine that
        scatters is dotted, if it is known.
    """
    figure = new_figure(7.6)
    along = abscissa(dataset, reference_case(dataset), over)
    has_contour = "contour_error" in dataset
    panels = np.atleast_1d(figure.subplots(5 if has_contour else 3, 1, sharex=True))
    for axis, name in enumerate("xyz"):
        for case in shown_cases(dataset):
            values = values_of(dataset, "deviation", case)[:, axis]
            _draw_line(panels[axis], along, case, values * 1e6)
        _scale_to_cut(panels[axis], dataset)
        quiet_axes(panels[axis], y=rf"$\Delta {name}$ [$\mathrm{{\mu m}}$]")
    if has_contour:
        _draw_contour(panels[3], panels[4], dataset, along)
    for axes in panels:
        _shade_air(axes, along, cutting_of(dataset, reference_case(dataset)))
        axes.set_xlim(float(along[0]), float(along[-1]))
        axes.yaxis.set_label_coords(-0.075, 0.5)
    panels[-1].set_xlabel(ABSCISSA_LABELS[over], fontsize=8.5)
    legend_above(figure, panels[-1], columns=6)
    return figure


def _draw_line(
    axes: "matplotlib.axes.Axes",
    along: Float[np.ndarray, " step"],
    case: str,
    values_um: Float[np.ndarray, " step"],
) -> None:
    style = case_style(case)
    axes.plot(
        along,
        values_um,
        color=style.colour,
        linewidth=style.width * 0.8,
        linestyle=style.line,
        label=style.label,
    )


def _scale_to_cut(axes: "matplotlib.axes.Axes", dataset: "xarray.Dataset") -> None:
    """Fit the y axis to what is drawn of the steps that cut.

    Before and after the cut a corrected path may swing several times as far as in it.
    """
    cutting = cutting_of(dataset, reference_case(dataset))
    drawn = [np.asarray(line.get_ydata(), np.float64) for line in axes.lines]
    values = np.concatenate([curve[cutting] for curve in drawn])
    values = values[np.isfinite(values)]
    if values.size and np.ptp(values) > 0:
        low, high = float(values.min()), float(values.max())
        axes.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))


def _draw_contour(
    signed: "matplotlib.axes.Axes",
    absolute: "matplotlib.axes.Axes",
    dataset: "xarray.Dataset",
    along: Float[np.ndarray, " step"],
) -> None:
    """Draw the contour error twice: with its sign, and its size on a log scale."""
    largest, smallest = 10 * _FLOOR_UM, np.inf
    for case in case_names(dataset):
        error_um = values_of(dataset, "contour_error", case) * 1e6
        if case in shown_cases(dataset):
            _draw_line(signed, along, case, error_um)
        size = np.where(cutting_of(dataset, case), np.abs(error_um), np.nan)
        _draw_line(absolute, along, case, np.maximum(size, _FLOOR_UM))
        largest = max(largest, float(np.nanmax(size, initial=0.0)))
        usual = size[np.isfinite(size)]
        low = np.percentile(usual, 2) if usual.size else _FLOOR_UM
        smallest = min(smallest, float(low))
    if "contour_error_expected" in dataset:
        reference = reference_case(dataset)
        expected = np.asarray(dataset["contour_error_expected"], np.float64) * 1e6
        absolute.plot(
            along,
            np.where(cutting_of(dataset, reference), expected, np.nan),
            color="#555555",
            linewidth=1.0,
            linestyle=":",
            label="expected",
        )
    _scale_to_cut(signed, dataset)
    quiet_axes(signed, y=r"contour error [$\mathrm{\mu m}$]")
    absolute.set_yscale("log")
    absolute.set_ylim(max(_FLOOR_UM, 0.5 * smallest), 2.0 * largest)
    absolute.tick_params(which="minor", length=0)
    quiet_axes(absolute, y=r"in the cut, log [$\mathrm{\mu m}$]")


def _shade_air(
    axes: "matplotlib.axes.Axes",
    along: Float[np.ndarray, " step"],
    cutting: Bool[np.ndarray, " step"],
) -> None:
    """Shade the spans in which the tool does not cut."""
    borders = np.flatnonzero(np.diff(np.concatenate([[True], cutting, [True]])))
    for start, stop in borders.reshape(-1, 2):
        axes.axvspan(
            float(along[start]),
            float(along[min(stop, along.shape[0] - 1)]),
            color="#f1f1f1",
            linewidth=0,
            zorder=0,
        )
