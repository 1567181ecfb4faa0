"""A column of a file of measurements, as it was read."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class MeasuredChannel(NamedTuple):
    """A column of a file, and the quantity that it was read as.

    Attributes:
        quantity: Name of the quantity, such as "Fx" or "time".
        column: Name of the column in the file.
        unit: Unit or sensitivity that the user or the file states; "" for none.
        si_unit: SI unit of the quantity; "" for a number without a dimension.
        lowest: Smallest number in `si_unit`.
        highest: Largest number in `si_unit`.
    """

    quantity: str
    column: str
    unit: str
    si_unit: str
    lowest: float
    highest: float


class Tare(NamedTuple):
    """Offset and drift of a record by its sections without a cut, in recorded axes.

        offset + drift * (time - instant)

    Attributes:
        instant: Instant of the offset [s].
        offset: Mean force at the instant [N], shape (3,).
        drift: Slope of the force [N/s], shape (3,); zero where one section is known.
        noise: Standard deviation of the force in the sections, about a line over time
            [N], shape (3,).
    """

    instant: float
    offset: Float[np.ndarray, " 3"]
    drift: Float[np.ndarray, " 3"]
    noise: Float[np.ndarray, " 3"]

    def force(
        self, time: Float[np.ndarray, " sample"]
    ) -> Float[np.ndarray, "sample 3"]:
        """Return offset and drift at instants [s] as a force [N]."""
        return self.offset[None] + self.drift[None] * (time - self.instant)[:, None]
