"""Cross-validation of coefficients on cuts that the fit did not use."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from .._statistics.robust_regression import Rows, solve
from .force_coefficients import ForceCoefficientFit
from .regression_rows import RegisteredRecord, equations

# More gross errors than this share are none.
_MANY = 0.05


@dataclasses.dataclass(frozen=True)
class CrossValidation:
    """A part of the records, predicted by the rest.

    Attributes:
        record: Index of the record.
        what: The part and its predictors, in words.
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

    @property
    def explained(self) -> float:
        """Share of the squared force that is predicted; negative if worse than none."""
        return 1.0 - self.error**2


def cross_validate(fit: ForceCoefficientFit) -> tuple[CrossValidation, ...]:
    """Predict every record by the others, or the later half of one by the earlier.

    The coefficients are fitted anew to the rest, robustly in as far as samples that
    the fit had given little weight are far off; alignment and lengths stay as fitted.

    Args:
        fit: The fit.

    Returns:
        One part per record.
    """
    records = [_weigh(i, one, fit.raw) for i, one in enumerate(fit.records)]
    if len(records) > 1:
        parts = []
        for record in records:
            others = [other for other in records if other is not record]
            K = solve([o.rows for o in others], [o.weight for o in others])
            every = np.ones(len(record.time), bool)
            parts.append(record.predicted(K, every, "by the other records"))
        return tuple(parts)
    (record,) = records
    known = np.flatnonzero(np.isfinite(record.rows.force).any(axis=1))
    first = np.zeros(len(record.time), bool)
    first[: int(np.median(known))] = True
    K = solve([record.rows], [record.weight * first[:, None]])
    return (record.predicted(K, ~first, "its later half by its earlier half"),)


@dataclasses.dataclass(frozen=True)
class _WeightedRecord:
    """Equations of a record, with their weights in a fit and in an error."""

    place: int
    time: Float[np.ndarray, " row"]
    rows: Rows
    weight: Float[np.ndarray, "row 3"]
    is_good: Bool[np.ndarray, "row 3"]

    def predicted(
        self,
        K: Float[np.ndarray, " 6"],
        chosen: Bool[np.ndarray, " row"],
        by: str,
    ) -> CrossValidation:
        """Some rows with the prediction of coefficients from others."""
        measured = self.rows.force[chosen]
        predicted = (self.rows.columns @ K)[chosen]
        counts = self.is_good[chosen]
        off = np.nansum((measured - predicted)[counts] ** 2)
        whole = max(float(np.nansum(measured[counts] ** 2)), 1e-300)
        error = float(np.sqrt(off / whole))
        time = self.time[chosen]
        return CrossValidation(self.place, by, time, measured, predicted, error)


def _weigh(
    place: int, one: RegisteredRecord, K: Float[np.ndarray, " 6"]
) -> _WeightedRecord:
    """Record weighted by its scatter about the fit, gross errors not at all.

    They count in the error of a prediction where too many rows would be gross.
    """
    rows = equations(one, ())
    off = np.abs(rows.force - rows.columns @ K)
    seen = np.asarray(np.isfinite(off).any(axis=0))
    spread = np.nanmedian(np.where(seen[None], off, 0.0), axis=0) / 0.6745
    spread = np.where(spread > 0, spread, 1.0)[None]
    is_far = np.nan_to_num(off / spread, nan=np.inf) >= 5.0
    is_gross = np.isfinite(rows.force) & is_far
    is_good = ~is_gross if is_gross.mean() <= _MANY else np.ones_like(is_gross)
    weight = np.where(is_far, 0.0, 1.0) / spread**2
    return _WeightedRecord(place, one.time, rows, weight, is_good)
