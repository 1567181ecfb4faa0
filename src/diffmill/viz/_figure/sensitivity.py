"""Map of the sensitivity to each parameter over time."""

from typing import TYPE_CHECKING

import numpy as np

from .._cases import cutting_of, reference_case
from .._style import MICROMETRE, label_colourbar, new_figure, quiet_axes

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray

# Change of a parameter that the colours stand for.
_CHANGE = 0.1


def plot_sensitivity(dataset: "xarray.Dataset") -> "matplotlib.figure.Figure":
    """Draw the change of the contour error for 10 % more of each parameter.

    Args:
        dataset: A result with `sensitivity_contour_error` [m] on parameter and step.

    Returns:
        The figure: one row per parameter, its name with the root mean square over the
        steps that cut.
    """
    found = dataset["sensitivity_contour_error"].transpose("parameter", "step")
    values = 1e6 * _CHANGE * np.asarray(found, np.float64)
    case = reference_case(dataset)
    time = np.asarray(dataset["time"], np.float64)
    cutting = cutting_of(dataset, case)
    rms = np.sqrt(np.mean(values[:, cutting] ** 2, axis=1))
    names = [str(name) for name in dataset["parameter"].values]
    figure = new_figure(1.2 + 0.22 * len(names))
    axes = figure.subplots()
    # A few steps at kinks would bleach all others.
    limit = max(float(np.percentile(np.abs(values[:, cutting]), 99)), 1e-12)
    image = axes.pcolormesh(
        time,
        np.arange(len(names)),
        np.where(cutting[None], values, np.nan),
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        shading="nearest",
        rasterized=True,
    )
    axes.set_yticks(
        np.arange(len(names)),
        [f"{name}  {size:.3g}" for name, size in zip(names, rms, strict=True)],
    )
    axes.invert_yaxis()
    title = f"parameter, rms [{MICROMETRE} for +10 %]"
    quiet_axes(axes, x="time [s]", title=title, has_grid=False)
    label_colourbar(
        figure.colorbar(image, ax=axes), f"contour error [{MICROMETRE} for +10 %]"
    )
    return figure
