"""Identifiability of coefficients from measured forces."""

import numpy as np
from jaxtyping import Bool, Float

# A coefficient is known if the force that its standard error makes is below this
# share of the force.
_KNOWN = 0.1


def identifiable(
    covariance: Float[np.ndarray, "6 6"],
    size: Float[np.ndarray, " 6"],
    force: float,
) -> Bool[np.ndarray, " 6"]:
    """Return which coefficients the records fix.

    Judged by the force that a standard error makes, not by the ratio to the
    coefficient: one may well be zero, and known to be.

    Args:
        covariance: Of the coefficients; infinite where nothing is known.
        size: Root mean square force of one unit of each coefficient, shape (6,).
        force: Root mean square of the measured force [N].

    Returns:
        Whether each is fixed, shape (6,).
    """
    errors = np.sqrt(np.diagonal(covariance))
    is_seen = np.isfinite(errors) & (size > 0)
    share = np.where(is_seen, errors, 0.0) * size
    return is_seen & (share <= _KNOWN * force)
