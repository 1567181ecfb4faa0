"""Figure of the deflection of a joint over its position."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from .._style import legend_above, new_figure, quiet_axes
from .identified import FITTED, MEASURED, MISFIT

if TYPE_CHECKING:
    import matplotlib.figure


@runtime_checkable
class PredictedRecord(Protocol):
    """A record of a joint that others predict."""

    @property
    def name(self) -> str:
        """Name of the record."""
        ...

    @property
    def positions(self) -> Float[np.ndarray, " row"]:
        """Angle of the motor [rad], shape (row,)."""
        ...

    @property
    def measured(self) -> Float[np.ndarray, " row"]:
        """Link less motor [rad], shape (row,)."""
        ...

    @property
    def predicted(self) -> Float[np.ndarray, " row"]:
        """The same by the drive [rad], shape (row,)."""
        ...

    @property
    def repeated(self) -> Float[np.ndarray, " row"]:
        """The same with the error that repeats [rad], shape (row,)."""
        ...


def plot_reversal(
    name: str, records: Sequence[PredictedRecord]
) -> "matplotlib.figure.Figure":
    """Draw link less motor over the position, measured and as others predict it.

    Args:
        name: The joint.
        records: Its records, one below the other.

    Returns:
        The figure.
    """
    figure = new_figure(1.2 + 2.0 * len(records))
    axes = figure.subplots(len(records), 1, squeeze=False, sharex=True)[:, 0]
    for one, ax in zip(records, axes, strict=True):
        angle = np.rad2deg(one.positions)
        for values, color, label in (
            (one.measured, MEASURED, "measured"),
            (one.predicted, MISFIT, "by the drive of the other records"),
            (one.repeated, FITTED, "with what repeats"),
        ):
            ax.plot(angle, 1e6 * values, lw=0.9, color=color, label=label)
        quiet_axes(
            ax,
            x="position [deg]" if ax is axes[-1] else "",
            y="link less motor [\u00b5rad]",
            title=f"{name}, {one.name}",
        )
    legend_above(figure, axes[0])
    return figure
