"""Memory of a stock that is to be made, before it is."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._dexel.stock import MARGIN
from ._memory import physical_memory, stock_bytes


class StockMemory(NamedTuple):
    """Memory that a stock will take, and how much it may.

    Attributes:
        needed: Its size [byte].
        limit: Half of the physical memory [byte]; infinite where it is not known.
    """

    needed: float
    limit: float

    @property
    def is_too_much(self) -> bool:
        """Whether the stock takes more than it may."""
        return self.needed > self.limit

    @classmethod
    def of_grid(
        cls, counts: tuple[int, ...], slots: Sequence[int], item_size: int
    ) -> "StockMemory":
        """Return the memory for a grid.

        Args:
            counts: Grid lines along x, y and z, three of them.
            slots: Slots of a ray along x, y and z.
            item_size: Size of a floating-point number [byte].
        """
        return cls(stock_bytes(counts, slots, item_size), physical_memory() / 2)

    @classmethod
    def of_block(
        cls,
        extent: Float[np.ndarray, " 3"],
        spacing: float,
        slots: Sequence[int],
        item_size: int,
    ) -> "StockMemory":
        """Return the memory for a block with the margin around it.

        Args:
            extent: Its edges [m], shape (3,).
            spacing: Spacing of the rays [m].
            slots: Slots of a ray along x, y and z.
            item_size: Size of a floating-point number [byte].
        """
        # In floating point: a tiny spacing would overflow whole numbers.
        counts = np.maximum(np.round(extent / spacing), 1) + 2 * MARGIN
        needed = stock_bytes(counts.tolist(), slots, item_size)
        return cls(needed, physical_memory() / 2)
