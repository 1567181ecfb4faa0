"""Memory of a stock, before it is made, and its limit."""

import math
import os
from collections.abc import Sequence

import equinox as eqx


class StockMemory(eqx.Module):
    """Memory of a stock, and its limit.

    Attributes:
        needed: Size of the stock [byte].
        limit: Half of the physical memory [byte]; infinite where it is not known.
    """

    needed: float
    limit: float

    @classmethod
    def of_grid(
        cls, counts: Sequence[int | float], slots: Sequence[int], item_size: int
    ) -> "StockMemory":
        """Memory of a stock on a grid.

        Args:
            counts: Grid lines along x, y and z, three of them.
            slots: Slots of a ray along x, y and z.
            item_size: Size of a floating-point number [byte].
        """
        needed = 0.0
        for family, slot_count in enumerate(slots):
            rays = float(counts[(family + 1) % 3]) * float(counts[(family + 2) % 3])
            # Two ends as numbers, and for each the index of the pose that cut it.
            needed += rays * slot_count * 2 * (item_size + 4)
        return cls(needed, _memory_limit())

    @property
    def is_too_much(self) -> bool:
        """True if the stock is larger than the limit."""
        return self.needed > self.limit


def _memory_limit() -> float:
    """Half of the physical memory [byte]; infinite where the system does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")) / 2
    except (AttributeError, ValueError, OSError):
        return math.inf


def check_memory(needed: float, what: str) -> None:
    """Raise if something would take more than half of the physical memory.

    Args:
        needed: Its size [byte].
        what: Its name, which opens the message.

    Raises:
        ValueError: It is too large.
    """
    limit = _memory_limit()
    if needed > limit:
        raise ValueError(
            f"{what} takes {needed / 1e9:.3g} GB; at most half of the physical memory, "
            f"{limit / 1e9:.3g} GB, is allowed: take a larger spacing or a smaller part"
        )
