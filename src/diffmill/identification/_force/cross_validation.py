"""Cross-validation of coefficients on cuts left out of the fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._statistics.robust_regression import Rows, solve
from .force_coefficients import ForceCoefficientFit
from .regression_rows import equations

# More gross errors than this share are none.
_MANY = 0.05


class CrossValidation(NamedTuple):
    """A part of the records, predicted by the rest.

    Attributes:
        record: Index of the record.
        what: Which part, in words.
        time: Instants [s], shape (row,), on the record's clock.
        measured: Force in `work` [N], shape (row, 3); NaN where not measured.
        predicted: The same by coefficients from the rest [N], shape (row, 3).
        error: Root mean square of the difference over that of the measured force,
            without what the fit has found to be gross errors, if that is little.
    """

    record: int
    what: str
    time: Float[np.ndarray, " row"]
    measured: Float[np.ndarray, "row 3"]
    predicted: Float[np.ndarray, "row 3"]
    error: float


def cross_validate(fit: ForceCoefficientFit) -> tuple[CrossValidation, ...]:
    """Predict every record by the others, or the later half of one by the earlier.

    The coefficients are fitted anew to the rest, robustly in as far as samples that
    the fit had given little weight are far off; alignment and lengths stay as fitted.

    Args:
        fit: The fit.

    Returns:
        One part per record.
    """
    rows = [equations(one, ()) for one in fit.records]
    spread = _spread(rows, fit)
    weights = [
        _weights(row, row.force - row.columns @ fit.raw, s)
        for row, s in zip(rows, spread, strict=True)
    ]
    good = [_good(row, weight) for row, weight in zip(rows, weights, strict=True)]
    parts = []
    if len(rows) > 1:
        for i, row in enumerate(rows):
            others = [j for j in range(len(rows)) if j != i]
            K = solve([rows[j] for j in others], [weights[j] for j in others])
            every = np.ones(len(row.force), bool)
            parts.append(_part(fit, i, rows, K, every, good[i], "by the other records"))
        return tuple(parts)
    known = np.flatnonzero(np.isfinite(rows[0].force).any(axis=1))
    first = np.zeros(len(rows[0].force), bool)
    first[: int(np.median(known))] = True
    K = solve(rows, [weights[0] * first[:, None]])
    what = "its later half by its earlier half"
    return (_part(fit, 0, rows, K, ~first, good[0], what),)


def _spread(
    rows: list[Rows], fit: ForceCoefficientFit
) -> list[Float[np.ndarray, " 3"]]:
    """Return the scatter of each force of each record, by its median."""
    found = []
    for row in rows:
        off = np.abs(row.force - row.columns @ fit.raw)
        seen = np.asarray(np.isfinite(off).any(axis=0))
        middle = np.nanmedian(np.where(seen[None], off, 0.0), axis=0) / 0.6745
        found.append(np.where(middle > 0, middle, 1.0))
    return found


def _weights(row: Rows, off: np.ndarray, spread: np.ndarray) -> np.ndarray:
    share = np.nan_to_num(np.abs(off) / spread[None], nan=np.inf)
    return np.where(share < 5.0, 1.0, 0.0) / spread[None] ** 2


def _good(row: Rows, weight: np.ndarray) -> Bool[np.ndarray, "row 3"]:
    """Return what is no gross error; all of it if too much would be one."""
    is_gross = np.isfinite(row.force) & (weight == 0)
    return ~is_gross if is_gross.mean() <= _MANY else np.ones_like(is_gross)


def _part(
    fit: ForceCoefficientFit,
    index: int,
    rows: list[Rows],
    K: Float[np.ndarray, " 6"],
    is_kept: Bool[np.ndarray, " row"],
    is_good: Bool[np.ndarray, "row 3"],
    what: str,
) -> CrossValidation:
    row = rows[index]
    measured, predicted = row.force[is_kept], (row.columns @ K)[is_kept]
    counts = is_good[is_kept]
    off = np.nansum((measured - predicted)[counts] ** 2)
    whole = max(float(np.nansum(measured[counts] ** 2)), 1e-300)
    return CrossValidation(
        index,
        what,
        fit.records[index].time[is_kept],
        measured,
        predicted,
        float(np.sqrt(off / whole)),
    )
