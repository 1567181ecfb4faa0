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
    """Draw how far 10 % more of each parameter moves the tool across the path.

    The derivative of the contour error itself would not do: about a path that a
    correction has all but freed of error the distance has a kink, and its derivative
    changes sign from step to step.

    Args:
        dataset: A result with `sensitivity_contour_vector` [m] on parameter, step and
            axis.

    Returns:
        The figure: one row per parameter, its name with the root mean square over the
        steps that cut.
    """
    maps = dataset["sensitivity_contour_vector"].transpose("parameter", "step", "axis")
    values = 1e6 * _CHANGE * np.linalg.norm(np.asarray(maps, np.float64), axis=2)
    case = reference_case(dataset)
    time = np.asarray(dataset["time"], np.float64)
    cutting = cutting_of(dataset, case)
    rms = np.sqrt(np.mean(values[:, cutting] ** 2, axis=1))
    names = [str(name) for name in dataset["parameter"].values]
    figure = new_figure(1.2 + 0.22 * len(names))
    axes = figure.subplots()
    # A few steps at kinks would darken all others.
    limit = max(float(np.percentile(values[:, cutting], 99)), 1e-12)
    # Pale is no move, grey is no cut.
    axes.set_facecolor("#e4e4e4")
    image = axes.pcolormesh(
        time,
        np.arange(len(names)),
        np.where(cutting[None], values, np.nan),
        cmap="YlGnBu",
        vmin=0.0,
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
    bar = figure.colorbar(image, ax=axes, extend="max")
    label_colourbar(bar, f"move across the path [{MICROMETRE} for +10 %]")
    return figure
