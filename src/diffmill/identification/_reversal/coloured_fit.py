"""Robust linear least squares whose residual is correlated in time.

Huber's loss takes gross errors out. The residual is an autoregressive process, fitted
by Yule and Walker's equations with the order of the least AIC; the covariance is that
of the least-squares estimate under it, the "sandwich" B^-1 X' O X B^-1.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._statistics.robust_regression import robust_slope, robust_weight

# Median absolute deviation over the standard deviation of a normal distribution.
_MAD = 0.6744897501960817
_ITERATIONS = 5
# Terms of an autoregressive process at most.
_LONGEST_MEMORY = 20
# Samples beyond the unknowns that count at least.
_LEAST_FREEDOM = 4.0
# Frequencies at which the density of the noise is looked at [rad/sample].
_BAND = np.linspace(0.0, np.pi, 64)
# Columns that are sums of others to such a share of themselves are dependent.
_DEPENDENT = 1e-9


@dataclasses.dataclass(frozen=True)
class ColouredFit:
    """A fit with the covariance of correlated residuals.

    Attributes:
        x: Unknowns, shape (unknown,).
        covariance: Of the unknowns, shape (unknown, unknown).
        residual: Measured minus fitted, one array (row,) per record.
        rms: Root mean square of the residual, gross errors at their weight.
        independent: Number of independent samples that tell as much.
    """

    x: Float[np.ndarray, " unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    residual: list[np.ndarray]
    rms: float
    independent: float

    @property
    def errors(self) -> Float[np.ndarray, " unknown"]:
        """Standard errors of the unknowns, shape (unknown,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


def fit_coloured(
    columns: Sequence[np.ndarray],
    values: Sequence[np.ndarray],
    precision: Float[np.ndarray, " unknown"],
) -> ColouredFit:
    """Fit all records together.

        (X' W X / (s^2 l) + P) x = X' W y / (s^2 l)

    Args:
        columns: Value per unknown, one array (row, unknown) per record.
        values: Measured, one array (row,) per record.
        precision: P, inverse variances of normal priors around 0, shape (unknown,); 0
            for unknowns of which nothing is known.

    Returns:
        The fit.
    """
    from scipy.signal import lfilter

    # symbols: s standard deviation of the residual, l samples that tell as much as one
    # independent one at the frequency of the most noise, a and e coefficients and
    # innovation of the autoregression
    X, y = np.concatenate(columns), np.concatenate(values)
    ends = np.cumsum([len(one) for one in values])[:-1]
    w, l = np.ones(len(y)), 1.0
    s = max(float(np.std(y)), 1e-300)
    x = np.zeros(X.shape[1])
    a, e, off, size = np.zeros(0), s, y, s
    inverse = np.zeros((len(x), len(x)))
    for _ in range(_ITERATIONS):
        inverse = _inverse((X * w[:, None]).T @ X / (s**2 * l) + np.diag(precision))
        x = inverse @ (X.T @ (w * y)) / (s**2 * l)
        off = y - X @ x
        s = max(float(np.median(np.abs(off))) / _MAD, 1e-12 * float(np.std(y)), 1e-300)
        w = robust_weight(off / s, "huber")
        scores = np.split(w * off, ends)
        a, e = _autoregression(scores)
        size = float(np.sqrt(np.mean((w * off) ** 2)))
        # The unknowns take some of the noise at the lowest frequencies away.
        turn = np.exp(-1j * np.outer(_BAND, np.arange(1, len(a) + 1)))
        peak = 1.0 / np.abs(1.0 - turn @ a).min()
        l = max((e / max(size, 1e-300) * peak) ** 2, 1.0)
    # A sample far off resists a change of the fit less than its weight says.
    firm = X * robust_slope(off / s, "huber")[:, None]
    inverse = _inverse(firm.T @ X / (s**2 * l) + np.diag(precision))
    # Filtered backwards in time, the columns have the scalar products of X' O X.
    meat = np.diag(precision)
    for one in np.split(X, ends):
        filtered = np.asarray(lfilter([e], np.append(1.0, -a), one[::-1], axis=0))
        meat = meat + filtered.T @ filtered / (s**2 * l) ** 2
    independent = len(y) / l
    # Effective unknowns: priors leave less than their number.
    used = float(np.trace(inverse @ ((X * w[:, None]).T @ X))) / (s**2 * l)
    freedom = max(independent - used, _LEAST_FREEDOM)
    return ColouredFit(
        x=x,
        covariance=inverse @ meat @ inverse * (1.0 + used / freedom),
        residual=np.split(off, ends),
        rms=size,
        independent=independent,
    )


def _inverse(G: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Inverse of a normal matrix, columns that depend on others left out."""
    size = np.sqrt(np.maximum(np.diagonal(G), 1e-300))
    scaled = G / size[:, None] / size[None]
    try:
        is_regular = np.diagonal(np.linalg.cholesky(scaled)).min() ** 2 > _DEPENDENT
    except np.linalg.LinAlgError:
        is_regular = False
    if is_regular:
        inverse = np.linalg.inv(scaled)
    else:
        inverse = np.linalg.pinv(scaled, _DEPENDENT, hermitian=True)
    return inverse / size[:, None] / size[None]


def _autoregression(
    residual: Sequence[np.ndarray],
) -> tuple[Float[np.ndarray, " term"], float]:
    """Coefficients of x_k = sum_i a_i x_(k-i) + e_k and the size of e, by Levinson."""
    count = sum(len(one) for one in residual)
    longest = min(_LONGEST_MEMORY, min(len(one) for one in residual) // 4)
    g = np.zeros(longest + 1)
    for one in residual:
        lagged = np.lib.stride_tricks.sliding_window_view(
            np.append(one, np.zeros(longest)), longest + 1
        )
        g += one @ lagged / count
    a, variance = np.zeros(0), float(g[0])
    best, least = (a, float(np.sqrt(variance))), np.inf
    for order in range(1, longest + 1):
        if not variance > 0:
            break
        reflection = (g[order] - a @ g[order - 1 : 0 : -1]) / variance
        a = np.append(a - reflection * a[::-1], reflection)
        variance *= 1.0 - reflection**2
        score = count * np.log(max(variance, 1e-300)) + 2 * order
        if score < least:
            best, least = (a, float(np.sqrt(max(variance, 0.0)))), score
    return best
