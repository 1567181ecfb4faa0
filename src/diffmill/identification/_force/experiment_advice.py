"""Advice for measurements that make a coefficient identifiable."""

import numpy as np
from jaxtyping import Bool, Float

from .mean_force import NAMES

# Coefficients are confused with each other from this correlation on.
_CONFUSED = 0.9


def advise(
    is_fixed: Bool[np.ndarray, " 6"],
    correlation: Float[np.ndarray, "6 6"],
    size: Float[np.ndarray, " 6"],
    is_measured: Bool[np.ndarray, " 3"],
) -> tuple[str, ...]:
    """Say which experiment would show what these records do not.

    Args:
        is_fixed: Which coefficients are fixed, shape (6,).
        correlation: Between them, shape (6, 6); NaN where nothing is known.
        size: Root mean square force of one unit of each, shape (6,).
        is_measured: Which of the forces of the work frame were measured, shape (3,).

    Returns:
        Sentences, none if all are fixed.
    """
    notes = []
    for i in np.flatnonzero(~is_fixed):
        name = NAMES[i]
        others = np.abs(np.nan_to_num(correlation[i]))
        others[i] = 0.0
        j = int(np.argmax(others))
        if size[i] == 0 and i % 3 == 2 and not is_measured[2]:
            what = "no axial force was measured: record it too"
        elif size[i] == 0:
            what = "it makes no force in these cuts: the records do not hold a cut"
        elif not np.isfinite(correlation[i, i]) or others[j] > _CONFUSED:
            pair = f"it cannot be told from {NAMES[j]}"
            if i % 3 == j % 3 and i != j:
                what = f"{pair}: add cuts at other feeds per tooth"
            else:
                what = f"{pair}: add cuts with another radial depth"
        else:
            what = "the noise is too large: add longer records, or deeper cuts"
        notes.append(f"{name} is not identifiable: {what}.")
    return tuple(notes)
