"""Figures of identified joint springs, link errors and modes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Complex, Float

from .._style import GREY, INK, legend_above, new_figure, quiet_axes
from .identified import FITTED, MEASURED, MISFIT

if TYPE_CHECKING:
    import matplotlib.figure


def plot_joint_values(
    names: Sequence[str],
    values: Float[np.ndarray, " joint"],
    errors: Float[np.ndarray, " joint"],
    model: Float[np.ndarray, " joint"],
    *,
    unit: str,
    bound: Float[np.ndarray, " joint"] | None = None,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """Draw fitted values of the joints with two standard errors.

    Args:
        names: Joints.
        values: Fitted, NaN where not identifiable, shape (joint,).
        errors: Standard errors, shape (joint,).
        model: Values of the robot model, shape (joint,).
        unit: Unit of the values.
        bound: Least value with 95 % confidence where none is known, shape (joint,).
        title: Title of the figure.

    Returns:
        The figure.
    """
    figure = new_figure(2.8)
    axes = figure.subplots()
    place = np.arange(len(names))
    good = np.isfinite(model) & (model > 0)
    axes.scatter(
        place[good], model[good], marker="_", s=300, color=GREY, label="robot model"
    )
    known = np.isfinite(values)
    axes.errorbar(
        place[known],
        values[known],
        yerr=2 * np.nan_to_num(errors[known]),
        fmt="o",
        ms=4,
        lw=1.0,
        capsize=3,
        color=FITTED,
        label="fitted, 2 standard errors",
    )
    if bound is not None:
        least = ~known & (bound > 0) & np.isfinite(bound)
        axes.scatter(
            place[least], bound[least], marker="^", s=24, color=MISFIT, label="at least"
        )
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_xticks(place, names)
    shown = np.concatenate([values[known], model[good]])
    if shown.size and (shown > 0).all():
        axes.set_yscale("log")
    for i in place[~known]:
        axes.annotate(
            "not identifiable",
            (i, 0.96),
            xycoords=("data", "axes fraction"),
            ha="center",
            fontsize=7,
            color=INK,
        )
    quiet_axes(axes, y=unit, title=title)
    legend_above(figure, axes)
    return figure


def plot_load_residual(
    rows: Sequence[int],
    measured: Float[np.ndarray, "pose component"],
    residual: Float[np.ndarray, "pose component"],
    outliers: Sequence[int],
) -> "matplotlib.figure.Figure":
    """Draw the size of displacement and residual of every row of a table.

    Args:
        rows: Numbers of the rows.
        measured: Displacement [m], shape (pose, 3 or more).
        residual: Measured minus fitted [m], shape (pose, 3 or more).
        outliers: Places in the table that were left out.

    Returns:
        The figure.
    """
    figure = new_figure(2.6)
    axes = figure.subplots()
    size = 1e6 * np.sqrt(np.nansum(measured[:, :3] ** 2, axis=1))
    error = 1e6 * np.sqrt(np.nansum(residual[:, :3] ** 2, axis=1))
    place = np.arange(len(rows))
    axes.bar(place - 0.2, size, 0.4, color=MEASURED, label="measured")
    bad = np.isin(place, outliers)
    axes.bar(place[~bad] + 0.2, error[~bad], 0.4, color=MISFIT, label="left by the fit")
    if bad.any():
        axes.bar(
            place[bad] + 0.2,
            error[bad],
            0.4,
            color=FITTED,
            label="left, gross error (not fitted)",
        )
    step = max(1, len(rows) // 30)
    axes.set_xticks(place[::step], [str(row) for row in rows][::step])
    quiet_axes(axes, x="row of the table", y="displacement [\u00b5m]")
    legend_above(figure, axes)
    return figure


def plot_pose_errors(
    lengths: Mapping[str, Float[np.ndarray, " pose"]], *, title: str = ""
) -> "matplotlib.figure.Figure":
    """Draw the share of poses whose error is below each length.

    Args:
        lengths: Errors of the poses [m], shape (pose,), by what is left of them.
        title: Title of the figure.

    Returns:
        The figure.
    """
    figure = new_figure(2.8)
    axes = figure.subplots()
    colours = (MEASURED, FITTED, MISFIT)
    for (name, errors), colour in zip(lengths.items(), colours, strict=False):
        share = 100 * np.arange(1, len(errors) + 1) / len(errors)
        axes.plot(1e6 * np.sort(errors), share, color=colour, lw=1.4, label=name)
    axes.set_xscale("log")
    axes.set_ylim(0, 100)
    quiet_axes(axes, x="error [\u00b5m]", y="poses [%]", title=title)
    legend_above(figure, axes)
    return figure


def plot_ring_down(
    time: Float[np.ndarray, " sample"],
    measured: Float[np.ndarray, " sample"],
    fitted: Float[np.ndarray, " sample"],
    *,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """Draw a free vibration, its fit and what that leaves.

    Args:
        time: [s], shape (sample,).
        measured: In any unit, shape (sample,).
        fitted: The same as fitted, shape (sample,).
        title: Title of the figure.

    Returns:
        The figure.
    """
    figure = new_figure(3.6)
    top, low = figure.subplots(2, 1, height_ratios=(2, 1), sharex=True, sharey=True)
    top.plot(time, measured, color=MEASURED, lw=1.6, label="measured")
    top.plot(time, fitted, color=FITTED, lw=0.8, label="fitted")
    low.plot(time, measured - fitted, color=MISFIT, lw=0.7)
    quiet_axes(top, y="signal", title=title)
    quiet_axes(low, x="time [s]", y="measured minus fitted")
    legend_above(figure, top)
    return figure


def plot_frequency_response(
    frequency: Float[np.ndarray, " line"],
    measured: Complex[np.ndarray, " line"],
    fitted_frequency: Float[np.ndarray, " fitted"],
    fitted: Complex[np.ndarray, " fitted"],
    *,
    unit: str,
    modes: Float[np.ndarray, " mode"],
    title: str = "",
) -> "matplotlib.figure.Figure":
    """Draw size and phase of a frequency response, and its fit in the band.

    Args:
        frequency: Of all lines [Hz], shape (line,).
        measured: Response in SI, shape (line,).
        fitted_frequency: Lines of the band [Hz], shape (fitted,).
        fitted: Response as fitted there, shape (fitted,).
        unit: Unit of the response.
        modes: Fitted frequencies [Hz], marked, shape (mode,).
        title: Title of the figure.

    Returns:
        The figure.
    """
    figure = new_figure(4.0)
    top, low = figure.subplots(2, 1, height_ratios=(2, 1), sharex=True)
    inside = np.isin(frequency, fitted_frequency)
    error = np.abs(measured[inside] - fitted)
    top.semilogy(frequency, np.abs(measured), color=MEASURED, lw=1.6, label="measured")
    top.semilogy(fitted_frequency, np.abs(fitted), color=FITTED, lw=0.9, label="fitted")
    top.semilogy(
        fitted_frequency, error, color=MISFIT, lw=0.5, label="size of the difference"
    )
    most, least = float(np.abs(measured).max()), float(np.abs(measured).min())
    top.set_ylim(max(least, 1e-4 * most) / 10, 2 * most)
    degrees = 180 / np.pi
    low.plot(frequency, degrees * np.angle(measured), color=MEASURED, lw=1.6)
    low.plot(fitted_frequency, degrees * np.angle(fitted), color=FITTED, lw=0.9)
    low.set_yticks([-180, -90, 0, 90, 180])
    for axes in (top, low):
        for mode in modes:
            axes.axvline(mode, color="#d9d9d9", lw=0.8, zorder=0)
    quiet_axes(top, y=unit, title=title)
    quiet_axes(low, x="frequency [Hz]", y="phase [deg]")
    legend_above(figure, top)
    return figure
