"""One number for how sure fitted coefficients are, for a correction that is robust."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ...cutting import LinearEdgeLaw


def relative_uncertainty(
    coefficients: Mapping[str, float],
    standard_errors: Mapping[str, float],
    correlation: Float[np.ndarray, "6 6"],
    columns: Float[np.ndarray, "row 6"],
) -> float:
    """Return the relative error, equal for all coefficients, that says as much.

    Independent coefficients with this relative standard deviation make the force as
    uncertain (root mean square over the rows) as the correlated ones of the fit.

    Args:
        coefficients: By name [Pa, N/m]; NaN for those not known, which do not count.
        standard_errors: By name, same units.
        correlation: In the order of `LinearEdgeLaw.NAMES`, shape (6, 6).
        columns: Force per coefficient, shape (row, 6).

    Returns:
        The relative error, infinite if nothing is known.
    """
    K = np.array([coefficients[name] for name in LinearEdgeLaw.NAMES])
    error = np.array([standard_errors[name] for name in LinearEdgeLaw.NAMES])
    known = np.isfinite(K) & np.isfinite(error)
    if not known.any():
        return float("inf")
    error = error[known]
    C = np.nan_to_num(correlation)[np.ix_(known, known)] * error[:, None] * error[None]
    part = columns[:, known]
    own = float(np.sum((part * K[known][None]) ** 2))
    spread = float(np.einsum("ri,ij,rj->", part, C, part))
    return float(np.sqrt(max(spread, 0.0) / own)) if own > 0 else float("inf")
