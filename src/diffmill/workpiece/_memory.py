"""Memory of a stock, and its limit."""

import math
import os
from collections.abc import Sequence


def stock_bytes(
    counts: Sequence[int | float], interval_counts: Sequence[int], item_size: int
) -> float:
    """Return the memory that a stock will take [byte].

    Args:
        counts: Grid lines along x, y and z, three of them.
        interval_counts: Slots of a ray along x, y and z, three of them.
        item_size: Size of a floating-point number [byte].
    """
    total = 0.0
    for family, slots in enumerate(interval_counts):
        rays = float(counts[(family + 1) % 3]) * float(counts[(family + 2) % 3])
        # Two ends as numbers, and for each the index of the pose that cut it.
        total += rays * slots * 2 * (item_size + 4)
    return total


def physical_memory() -> float:
    """Return the memory of this machine [byte]; infinite where it does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return math.inf


def check_memory(needed: float, what: str) -> None:
    """Raise if something would take more than half of the physical memory.

    Args:
        needed: Its size [byte].
        what: What it is, to open the message.

    Raises:
        ValueError: It is too large.
    """
    limit = physical_memory() / 2
    if needed > limit:
        raise ValueError(
            f"{what} takes {needed / 1e9:.3g} GB; at most half of the physical memory, "
            f"{limit / 1e9:.3g} GB, is allowed: take a larger spacing or a smaller part"
        )
