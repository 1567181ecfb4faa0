"""Robust weighted linear least squares over long, serially correlated records.

Weights come from two sources. The scatter of each force of each record, by its median,
makes the forces comparable; a robust loss (Huber, or Tukey's biweight, which forgets
gross errors altogether) gives less to samples that are off. Standard errors are those
of an estimating equation with correlated scores s, A of the unknowns' slopes:

    C = A^-1 M A^-1,  M the largest of these, unknown by unknown:
    independent samples           sum_i s_i s_i^T
    coloured noise                sum_ij k(t_i - t_j) s_i s_j^T
    errors of the model by phase  sum_ij k(p_i - p_j) s_i s_j^T, over all records

with Bartlett weights k over a revolution of the spindle in time (Newey and West,
Econometrica 55, 1987), and over a twentieth and a sixth of the tooth period in the
phase p (clusters by phase: Liang and Zeger, Biometrika 73, 1986). The third one does
not fall with the length of a record: what the model cannot represent comes again with
every tooth. The error of a simulation, known by a coarser one, adds what it changes.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

Loss = Literal["squares", "huber", "tukey"]

# Tuning for 95 % efficiency with normal noise (Huber 1981; Tukey's biweight).
_HUBER, _TUKEY = 1.345, 4.685
# Median absolute deviation over the standard deviation of a normal distribution.
_MAD = 0.6744897501960817
_ITERATIONS = 30
# Eigenvalues of a scaled normal matrix below this share of the largest are zero.
_REGULAR = 1e-11
# Sums over lags need some that are independent.
_BLOCKS = 30
# Phases of a tooth period, and over how many of them the error of a model is alike:
# where a tooth enters, and over a wave of the force.
_PHASES, _ALIKE = 120, (6, 20)


class Rows(eqx.Module):
    """The equations of one record.

    Attributes:
        columns: Force per unknown, shape (row, 3, unknown).
        force: Measured force less what is known [N], shape (row, 3); NaN where it was
            not measured.
        lag: Rows over which scores may be correlated.
        phase: Place of each row in the period with which a model's error repeats, from
            0 to 1, shape (row,); None if it does not repeat.
    """

    columns: Float[np.ndarray, "row 3 unknown"]
    force: Float[np.ndarray, "row 3"]
    lag: int = eqx.field(static=True)
    phase: Float[np.ndarray, " row"] | None = None


class LinearFit(eqx.Module):
    """A robust fit.

    Attributes:
        x: Unknowns, shape (unknown,); 0 where nothing was measured of one.
        weights: Of every row, in 1 / N^2, one array (row, 3) per record.
        spread: Standard deviation of each force of each record [N], (record, 3); 1
            where it was not measured.
        residual: Measured minus fitted [N], one array (row, 3) per record.
    """

    x: Float[np.ndarray, " unknown"]
    weights: list[np.ndarray]
    spread: Float[np.ndarray, "record 3"]
    residual: list[np.ndarray]


def solve(rows: Sequence[Rows], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Weighted least-squares solution.

    Args:
        rows: Equations of each record.
        weights: Of every row, shape (row, 3) each; zero where nothing was measured.

    Returns:
        Unknowns, shape (unknown,); 0 for one that does not appear.
    """
    G, g = normal_equations(rows, weights)
    return solve_normal(G, g)


def normal_equations(
    rows: Sequence[Rows], weights: Sequence[np.ndarray]
) -> tuple[Float[np.ndarray, "unknown unknown"], Float[np.ndarray, " unknown"]]:
    """Normal matrix G and right-hand side g of all records: G x = g.

    Args:
        rows: Equations of each record.
        weights: Of every row, shape (row, 3) each; zero where nothing was measured.
    """
    G, g = 0.0, 0.0
    for one, weight in zip(rows, weights, strict=True):
        flat = one.columns.reshape(-1, one.columns.shape[2])
        weighted = flat * weight.reshape(-1, 1)
        G = G + weighted.T @ flat
        g = g + weighted.T @ np.nan_to_num(one.force).reshape(-1)
    return np.asarray(G), np.asarray(g)


def solve_normal(
    G: Float[np.ndarray, "unknown unknown"], g: Float[np.ndarray, " unknown"]
) -> Float[np.ndarray, " unknown"]:
    """Solution x of G x = g after scaling, shortest where G is singular.

    Args:
        G: Normal matrix, shape (unknown, unknown).
        g: Right-hand side, shape (unknown,).

    Returns:
        x, shape (unknown,).
    """
    return inverse_normal(G)[0] @ g


def inverse_normal(
    G: Float[np.ndarray, "unknown unknown"],
) -> tuple[Float[np.ndarray, "unknown unknown"], Bool[np.ndarray, " unknown"]]:
    """Inverse of a normal matrix, and the unknowns that it fixes.

    Args:
        G: Normal matrix, symmetric and positive semidefinite, shape
            (unknown, unknown).

    Returns:
        The inverse where G is regular, shape (unknown, unknown); and true for unknowns
        that have no part in its null space, shape (unknown,).
    """
    scale = np.sqrt(np.maximum(np.diagonal(G), 0.0))
    is_seen = scale > 0
    scale = np.where(is_seen, scale, 1.0)
    values, V = np.linalg.eigh(G / scale[:, None] / scale[None])
    keep = values > _REGULAR * max(float(values[-1]), 1e-300)
    inverse = (V * np.where(keep, 1.0 / np.where(keep, values, 1.0), 0.0)[None]) @ V.T
    is_fixed = is_seen & (np.sum(V[:, ~keep] ** 2, axis=1) < 1e-6)
    return inverse / scale[:, None] / scale[None], is_fixed


def fit_rows(rows: Sequence[Rows], loss: Loss = "huber") -> LinearFit:
    """Fit all records together.

    Args:
        rows: Equations of each record.
        loss: "squares", "huber" or "tukey".

    Returns:
        The fit.
    """
    known = [np.isfinite(one.force) for one in rows]
    weights = [k.astype(np.float64) for k in known]
    x = solve(rows, weights)
    # Tukey's loss has several minima: Huber's leads to the right one.
    stages = {"squares": ["squares"], "huber": ["huber"], "tukey": ["huber", "tukey"]}
    fit = weigh(rows, x, "squares")
    for stage in stages[loss]:
        for _ in range(_ITERATIONS):
            fit = weigh(rows, x, stage)
            last, x = x, solve(rows, fit.weights)
            change = np.abs(x - last) <= 1e-5 * np.abs(x) + 1e-300
            if change.all():
                break
    residual = [one.force - one.columns @ x for one in rows]
    return LinearFit(x, fit.weights, fit.spread, residual)


def weigh(
    rows: Sequence[Rows], x: Float[np.ndarray, " unknown"], loss: str
) -> LinearFit:
    """Residuals of the records at some unknowns, and the weights that follow.

    Args:
        rows: Equations of each record.
        x: The unknowns, shape (unknown,).
        loss: "squares", "huber" or "tukey".

    Returns:
        Residuals, spreads and weights at these unknowns.
    """
    residual = [one.force - one.columns @ x for one in rows]
    known = [np.isfinite(one.force) for one in rows]
    spread = np.stack(
        [_spread(r, one.force) for r, one in zip(residual, rows, strict=True)]
    )
    weights = [
        robust_weight(r / s[None], loss) * k / s[None] ** 2
        for r, k, s in zip(residual, known, spread, strict=True)
    ]
    return LinearFit(x, weights, spread, residual)


def robust_weight(r: np.ndarray, loss: str) -> np.ndarray:
    """Weights psi(r) / r of a loss for residuals in standard deviations.

    Args:
        r: Residuals, any shape; NaN gives 0.
        loss: "squares", "huber" or "tukey".

    Returns:
        Weights from 0 to 1, same shape.
    """
    size = np.abs(np.nan_to_num(r, nan=math.inf))
    return _WEIGHTS[loss](size)


def robust_slope(r: np.ndarray, loss: Loss) -> np.ndarray:
    """Slopes psi'(r) of a loss for residuals in standard deviations.

    Args:
        r: Residuals, any shape.
        loss: "squares", "huber" or "tukey".

    Returns:
        Slopes, at most 1, same shape.
    """
    return _SLOPES[loss](np.abs(r)).astype(np.float64)


# psi(r) / r, and psi'(r): how much a sample resists a change of the fit.
_WEIGHTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "squares": lambda r: np.isfinite(r).astype(np.float64),
    "huber": lambda r: _HUBER / np.maximum(r, _HUBER),
    "tukey": lambda r: np.where(
        r < _TUKEY, (1 - np.minimum(r / _TUKEY, 1) ** 2) ** 2, 0.0
    ),
}
_SLOPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "squares": lambda r: np.isfinite(r).astype(np.float64),
    "huber": lambda r: (r <= _HUBER).astype(np.float64),
    "tukey": lambda r: (
        (1 - np.minimum(r / _TUKEY, 1) ** 2) * (1 - 5 * np.minimum(r / _TUKEY, 1) ** 2)
    ),
}


def robust_cost(r: np.ndarray, loss: Loss) -> float:
    """Twice the sum of the loss of residuals in standard deviations.

    Args:
        r: Residuals, any shape; NaN counts as 0.
        loss: "squares" or "huber".

    Returns:
        The sum; that of the squares where all are small.
    """
    size = np.abs(np.nan_to_num(r))
    within = size if loss == "squares" else np.minimum(size, _HUBER)
    return float(np.sum(within * (2 * size - within)))


def correlation_of(
    C: Float[np.ndarray, "unknown unknown"],
) -> Float[np.ndarray, "unknown unknown"]:
    """Correlation of a covariance; NaN where it is infinite.

    Args:
        C: Covariance, shape (unknown, unknown).

    Returns:
        Correlation, same shape.
    """
    errors = np.sqrt(np.diagonal(C))
    safe = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
    return np.where(np.isfinite(C), C, np.nan) / safe[:, None] / safe[None]


def _spread(residual: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Robust standard deviation of each force [N], shape (3,)."""
    known = np.isfinite(force)
    result = np.zeros(3)
    for axis in np.flatnonzero(known.any(axis=0)):
        rows = known[:, axis]
        middle = float(np.median(np.abs(residual[rows, axis]))) / _MAD
        # Exact records have no scatter: a number far below their size weighs them.
        exact = 1e-9 * float(np.abs(force[rows, axis]).max())
        result[axis] = middle if middle > 0 else exact
    # Of those alone that were measured: a residual in metres is far smaller than 1.
    result = np.maximum(result, 1e-6 * result.max())
    return np.where(known.any(axis=0) & (result > 0), result, 1.0)


def covariance(
    rows: Sequence[Rows],
    fit: LinearFit,
    loss: Loss,
    model_error: Sequence[Float[np.ndarray, "_ 3"]] = (),
) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance of the unknowns; infinite where one is not fixed.

    Args:
        rows: Equations of each record, linearised where they are not linear.
        fit: The fit.
        loss: Its loss.
        model_error: By how much the model may be off in each record [N], shape (row, 3)
            each: a standard deviation, in this shape or its reverse.

    Returns:
        Covariance, shape (unknown, unknown).
    """
    width = rows[0].columns.shape[2]
    bread, coloured, white = np.zeros((3, width, width))
    by_phase, change = np.zeros((_PHASES, width)), np.zeros(width)
    for i, (one, weight, residual, s) in enumerate(
        zip(rows, fit.weights, fit.residual, fit.spread, strict=True)
    ):
        size = np.abs(np.nan_to_num(residual / s[None], nan=math.inf))
        stiff = _SLOPES[loss](size) / s[None] ** 2
        stiff = np.where(np.isfinite(residual), stiff, 0.0)
        flat = one.columns.reshape(-1, width)
        stiff_flat = flat * stiff.reshape(-1, 1)
        bread += stiff_flat.T @ flat
        score = np.einsum("tcu,tc->tu", one.columns, weight * np.nan_to_num(residual))
        white += score.T @ score
        coloured += _bartlett(score, one.lag)
        if one.phase is not None:
            place = np.minimum((one.phase * _PHASES).astype(np.int64), _PHASES - 1)
            np.add.at(by_phase, place, score)
        if model_error:
            change += stiff_flat.T @ model_error[i].reshape(-1)
    inverse, is_fixed = inverse_normal(bread)
    safe = np.where(is_fixed[:, None] & is_fixed[None], inverse, 0.0)
    result, *others = (
        safe @ meat @ safe
        for meat in (coloured, white, *(_around(by_phase, width) for width in _ALIKE))
    )
    own = np.diagonal(result)
    largest = np.max([np.diagonal(one) for one in (result, *others)], axis=0)
    rise = np.sqrt(np.where(own > 0, largest / np.where(own > 0, own, 1.0), 1.0))
    shift = safe @ change
    result = result * rise[:, None] * rise[None] + np.outer(shift, shift)
    largest = largest + shift**2
    result[np.diag_indices(width)] = np.where(is_fixed, largest, np.inf)
    return result


def _around(score: np.ndarray, width: int) -> np.ndarray:
    """Sum of score products with weights 1 - |phase difference| / width, cyclic."""
    count = len(score)
    lags = np.arange(count)
    lags = np.minimum(lags, count - lags)
    # Eigenvalues of the circular weights; that of Bartlett's is nowhere negative.
    power = np.fft.fft(np.maximum(1 - lags / width, 0.0)).real
    turned = np.fft.fft(score, axis=0)
    return np.real((turned.T * power) @ turned.conj()) / count


def _bartlett(score: np.ndarray, lag: int) -> np.ndarray:
    """Sum of score products with weights 1 - |lag difference| / lag.

    Sums over all windows of the length of the lag give these weights at once.
    """
    lag = max(1, min(lag, len(score) // _BLOCKS))
    total = np.concatenate([np.zeros((1, score.shape[1])), np.cumsum(score, axis=0)])
    low = np.clip(np.arange(1 - lag, len(score)), 0, None)
    high = np.clip(np.arange(1, len(score) + lag), None, len(score))
    windows = total[high] - total[low]
    return windows.T @ windows / lag
