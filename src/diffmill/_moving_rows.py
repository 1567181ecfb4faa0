"""Where a tool moves on, and where it nearly rests, as before an exact stop.

There it cuts chips so thin that what it removes over its way says nothing of the cut, a
bent arm that swings back leaves them, and vibrations grow no further than they are.
"""

import numpy as np
from jaxtyping import Bool, Float

from ._types import FloatRows3

# It nearly stands where it is slower than this share of the feed that most of the cut
# stays below [share, per cent].
_MOVING, _MOST_OF_THE_CUT = 0.1, 90


def step_lengths(tips: FloatRows3) -> Float[np.ndarray, " step"]:
    """Return the way of the tool in the period before each row [m]; 0 before the first.

    Args:
        tips: Tip positions [m], shape (step, 3).
    """
    rows = np.asarray(tips, np.float64)
    return np.linalg.norm(np.diff(rows, axis=0, prepend=rows[:1]), axis=1)


def least_way(way: Float[np.ndarray, " row"]) -> float:
    """Return the least way in a period of a tool that does not nearly stand [m].

    Args:
        way: Ways of the rows that cut [m].
    """
    return _MOVING * float(np.percentile(way, _MOST_OF_THE_CUT))


def is_moving(
    way: Float[np.ndarray, " step"], is_cutting: Bool[np.ndarray, " step"]
) -> Bool[np.ndarray, " step"]:
    """Return at which rows that cut the tool does not nearly stand.

    Args:
        way: Of every row [m].
        is_cutting: Which rows cut.
    """
    cuts = is_cutting & (way > 0)
    return cuts & (way >= least_way(way[cuts])) if cuts.any() else cuts
