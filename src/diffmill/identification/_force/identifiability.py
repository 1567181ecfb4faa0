"""Identifiability of force coefficients, and experiments that would improve it."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from ...cutting import LinearEdgeLaw

_NAMES = LinearEdgeLaw.NAMES
# A coefficient is known if the force that its standard error makes is below this
# share of the force.
_LARGEST_FORCE_ERROR = 0.1
# Coefficients are confused with each other from this correlation on.
_CONFUSED = 0.9


def identifiable(
    covariance: Float[np.ndarray, "6 6"],
    size: Float[np.ndarray, " 6"],
    force: float,
) -> Bool[np.ndarray, " 6"]:
    """True for coefficients that the records fix, shape (6,).

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
    return is_seen & (share <= _LARGEST_FORCE_ERROR * force)


def relative_uncertainty(
    coefficients: Mapping[str, float],
    standard_errors: Mapping[str, float],
    correlation: Float[np.ndarray, "6 6"],
    columns: Float[np.ndarray, "row 6"],
) -> float:
    """Relative error of all coefficients that makes the force as uncertain.

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
    K = np.array([coefficients[name] for name in _NAMES])
    error = np.array([standard_errors[name] for name in _NAMES])
    known = np.isfinite(K) & np.isfinite(error)
    if not known.any():
        return float("inf")
    error = error[known]
    C = np.nan_to_num(correlation)[np.ix_(known, known)] * error[:, None] * error[None]
    part = columns[:, known]
    own = float(np.sum((part * K[known][None]) ** 2))
    spread = float(np.einsum("ri,ij,rj->", part, C, part))
    return float(np.sqrt(max(spread, 0.0) / own)) if own > 0 else float("inf")


def advise(
    is_fixed: Bool[np.ndarray, " 6"],
    correlation: Float[np.ndarray, "6 6"],
    size: Float[np.ndarray, " 6"],
    is_measured: Bool[np.ndarray, " 3"],
) -> tuple[str, ...]:
    """Experiments that would show the coefficients that these records do not.

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
        name = _NAMES[i]
        others = np.abs(np.nan_to_num(correlation[i]))
        others[i] = 0.0
        j = int(np.argmax(others))
        if size[i] == 0 and i % 3 == 2 and not is_measured[2]:
            what = "no axial force was measured: record it too"
        elif size[i] == 0:
            what = "it makes no force in these cuts: the records have no cut"
        elif not np.isfinite(correlation[i, i]) or others[j] > _CONFUSED:
            pair = f"it cannot be distinguished from {_NAMES[j]}"
            if i % 3 == j % 3 and i != j:
                what = f"{pair}: add cuts at other feeds per tooth"
            else:
                what = f"{pair}: add cuts with another radial depth"
        else:
            what = "the noise is too large: add longer records, or deeper cuts"
        notes.append(f"{name} is not identifiable: {what}.")
    return tuple(notes)
