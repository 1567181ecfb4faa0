"""The Jacobian of a residual as a picture."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .._style import label_colourbar, new_figure, quiet_axes, spread

if TYPE_CHECKING:
    import matplotlib.figure


def plot_jacobian(
    jacobian: Float[np.ndarray, "error ..."],
) -> "matplotlib.figure.Figure":
    """Draw the derivatives of errors with respect to unknowns.

    Args:
        jacobian: Such as `jax.jacfwd(fit.residual)(fit.start, fit.args)` of
            `correction.residual`, shape (error, ...): further axes are those of the
            unknowns.

    Returns:
        The figure: a row for each error, from first to last, and a column for each
        unknown; blue is negative. The colours end at 99.5 % of the sizes.
    """
    columns = jacobian.reshape(len(jacobian), -1)
    limit = spread(columns, 99.5) or 1.0
    figure = new_figure(4.2)
    axes = figure.subplots()
    image = axes.imshow(
        columns,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        aspect="auto",
        interpolation="nearest",
    )
    quiet_axes(axes, x="unknown", y="error", has_grid=False)
    label_colourbar(figure.colorbar(image, ax=axes, pad=0.01), "derivative")
    return figure
