"""Non-negative linear least squares with groups of rows that may be grossly wrong.

One group is one measurement: the components of the displacement of one pose, or the
damping of one mode. A measurement is right or wrong as a whole, so whole groups are
trusted or named. The start is least trimmed squares (Rousseeuw and Leroy, Robust
Regression and Outlier Detection, 1987): of many fits to few groups each, the one that
suits the better half of all best; it stands even if many are wrong. Every group is
then compared with what the others predict for it, by an F test that allows for their
number, which holds for few groups too.

Rows of a group share what the model leaves out. So a variance is the larger of that of
independent rows and of the jackknife over groups, with residuals e_g, columns A_g and
H_g = A_g (A^T A)^-1 A_g^T:

    sum_g d_g d_g^T (n - 1) / n,  d_g = (A^T A)^-1 A_g^T (1 - H_g)^-1 e_g

Reference: Bell and McCaffrey, Bias reduction in standard errors for linear regression
with multi-stage samples, Survey Methodology 28, 2002.
"""

import itertools
import math
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

# Probability that any right measurement of a table is called wrong.
_FALSE_ALARM = 0.01
# A gross error is at least this share of what was measured or is predicted.
_GROSS = 0.15
# Starts of the trimmed fit, and the number of them that are refined.
_STARTS, _REFINED_STARTS = 300, 8
# Singular values below this share of the largest are zero, after scaling the columns.
_RANK = 1e-9
# Weights of a relative scatter count no group as smaller than this share of the median.
_LEAST_SIZE = 0.1

Columns = Float[np.ndarray, "group row unknown"]
Values = Float[np.ndarray, "group row"]


class GroupFit(eqx.Module):
    """A fit to the groups that agree.

    Attributes:
        x: The unknowns, shape (unknown,).
        covariance: Of x without its bounds, shape (unknown, unknown); infinite on the
            diagonal where the rows do not fix an unknown.
        residual: Measured minus fitted, of all groups, shape (group, row).
        is_outlier: Which groups were left out, shape (group,).
        spread: Standard deviation of one row, for groups of weight 1.
        weights: Inverse of the spread of each group relative to others, shape (group,).
        noise: "absolute": all groups scatter alike; "relative": in proportion to what
            is fitted to them.
    """

    x: Float[np.ndarray, " unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    residual: Float[np.ndarray, "group row"]
    is_outlier: Bool[np.ndarray, " group"]
    spread: float
    weights: Float[np.ndarray, " group"]
    noise: str


def nonnegative(
    A: Float[np.ndarray, "row unknown"],
    b: Float[np.ndarray, " row"],
    is_free: Bool[np.ndarray, " unknown"],
) -> Float[np.ndarray, " unknown"]:
    """Solution x that minimises |A x - b|, non-negative unless free.

    Args:
        A: Matrix, shape (row, unknown); not a number in a row means not measured.
        b: Right-hand side, shape (row,), likewise.
        is_free: Which unknowns may be negative, shape (unknown,).

    Returns:
        x, shape (unknown,); one of several solutions where A has no full rank.
    """
    from scipy.optimize import nnls

    is_known = np.isfinite(b)
    A, b = A[is_known], b[is_known]
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    A = A / scale
    # A free unknown is the difference of two that are not negative.
    x, _ = nnls(np.hstack([A, -A[:, is_free]]), b)
    result = x[: A.shape[1]]
    result[is_free] -= x[A.shape[1] :]
    return result / scale


def inverse_information(
    A: Float[np.ndarray, "row unknown"],
) -> tuple[Float[np.ndarray, "unknown unknown"], int]:
    """Inverse (A^T A)^-1 and the rank of A.

    Args:
        A: Matrix, shape (row, unknown).

    Returns:
        The inverse, with infinity on the diagonal of unknowns that A does not fix, and
        the number of independent columns.
    """
    scale = np.linalg.norm(A, axis=0)
    is_seen = scale > 0
    scale = np.where(is_seen, scale, 1.0)
    _, s, Vt = np.linalg.svd(A / scale, full_matrices=True)
    values = np.zeros(A.shape[1])
    values[: s.size] = s
    is_kept = values > _RANK * max(float(values.max(initial=0.0)), 1e-300)
    V = Vt.T
    inverse = (V[:, is_kept] / values[is_kept] ** 2) @ V[:, is_kept].T
    inverse = inverse / scale[:, None] / scale[None]
    lost = np.sum(V[:, ~is_kept] ** 2, axis=1) > 1e-6
    inverse[lost | ~is_seen, :] = 0.0
    inverse[:, lost | ~is_seen] = 0.0
    np.fill_diagonal(
        inverse, np.where(lost | ~is_seen, np.inf, np.diagonal(inverse).copy())
    )
    return inverse, int(is_kept.sum())


def fit_groups(
    columns: Columns,
    values: Values,
    is_free: Bool[np.ndarray, " unknown"] | None = None,
    *,
    noise: str | None = None,
) -> GroupFit:
    """Fit values that are linear in non-negative unknowns; find groups that are wrong.

    Args:
        columns: Change of every value per unknown, shape (group, row, unknown).
        values: What was measured, shape (group, row); not a number where it was not.
        is_free: Which unknowns may be negative, shape (unknown,); none if not given.
        noise: "absolute" or "relative" scatter; the likelier of both if not given.

    Returns:
        The fit.
    """
    free = np.zeros(columns.shape[2], bool) if is_free is None else is_free
    count = values.shape[0]
    plain = _robust(columns, values, free, np.ones(count), "absolute")
    if noise == "absolute" or count < 4:
        return plain
    size = np.linalg.norm(columns @ plain.x, axis=1)
    least = _LEAST_SIZE * float(np.median(size))
    if not least > 0:
        return plain
    weights = float(np.median(size)) / np.maximum(size, least)
    scaled = _robust(columns, values, free, weights, "relative")
    if noise == "relative":
        return scaled
    # The wrong kind of scatter makes right groups look wrong.
    fewer = int(scaled.is_outlier.sum()) - int(plain.is_outlier.sum())
    if fewer != 0:
        return scaled if fewer < 0 else plain
    agreed = ~(plain.is_outlier | scaled.is_outlier)
    better = _log_likelihood(scaled, agreed) > _log_likelihood(plain, agreed)
    return scaled if better else plain


def _log_likelihood(fit: GroupFit, chosen: Bool[np.ndarray, " group"]) -> float:
    """Log likelihood of the residuals of some groups, at the best scale."""
    rows = fit.residual[chosen] * fit.weights[chosen, None]
    is_known = np.isfinite(rows)
    count = int(is_known.sum())
    square = float(np.sum(rows[is_known] ** 2))
    shift = float(np.sum(is_known * np.log(fit.weights[chosen])[:, None]))
    return shift - 0.5 * count * math.log(max(square, 1e-300) / max(count, 1))


def _robust(
    columns: Columns,
    values: Values,
    is_free: Bool[np.ndarray, " unknown"],
    weights: Float[np.ndarray, " group"],
    noise: str,
) -> GroupFit:
    """Fit with given weights of the groups."""
    A = columns * weights[:, None, None]
    b = values * weights[:, None]
    is_right = _not_gross(A, b, is_free, trimmed_start(A, b, is_free))
    for _ in range(10):
        agreed = _agreeing(A, b, is_free, is_right)
        # More than half cannot be wrong: then nothing is known.
        if agreed.sum() < len(b) // 2 or np.array_equal(agreed, is_right):
            break
        is_right = agreed
    estimate = _solve(A[is_right], b[is_right], is_free)
    return GroupFit(
        estimate.x,
        _larger(estimate.covariance, _jackknife(A[is_right], b[is_right], estimate.x)),
        values - columns @ estimate.x,
        ~is_right,
        estimate.spread,
        weights,
        noise,
    )


class _Estimate(NamedTuple):
    """Unknowns, their covariance and the standard deviation of a row."""

    x: Float[np.ndarray, " unknown"]
    covariance: Float[np.ndarray, "unknown unknown"]
    spread: float


def _solve(A: Columns, b: Values, is_free: Bool[np.ndarray, " unknown"]) -> _Estimate:
    """Non-negative least-squares solution of groups."""
    rows, right = A.reshape(-1, A.shape[2]), b.reshape(-1)
    is_known = np.isfinite(right)
    rows, right = rows[is_known], right[is_known]
    x = nonnegative(rows, right, is_free)
    inverse, rank = inverse_information(rows)
    # Unknowns at their bound take no degree of freedom.
    used = min(rank, int(np.sum((x > 0) | is_free)))
    freedom = len(right) - used
    square = float(np.sum((right - rows @ x) ** 2))
    spread = math.sqrt(square / freedom) if freedom > 0 else math.inf
    with np.errstate(invalid="ignore"):
        return _Estimate(x, inverse * spread**2, spread)


def _jackknife(
    A: Columns, b: Values, x: Float[np.ndarray, " unknown"]
) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance of the unknowns by leaving out one group after the other."""
    is_known = np.isfinite(b)
    A = np.where(is_known[..., None], A, 0.0)
    off = np.where(is_known, b - A @ x, 0.0)
    inverse, _ = inverse_information(A.reshape(-1, A.shape[2]))
    inverse = np.where(np.isfinite(inverse), inverse, 0.0)
    leverage = A @ inverse @ np.swapaxes(A, 1, 2)
    away = np.linalg.pinv(np.eye(b.shape[1])[None] - leverage) @ off[..., None]
    change = np.squeeze(inverse @ np.swapaxes(A, 1, 2) @ away, -1)
    return change.T @ change * (len(b) - 1) / len(b)


def _larger(
    C: Float[np.ndarray, "unknown unknown"], other: Float[np.ndarray, "unknown unknown"]
) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance with the larger of two variances, and correlations of the first."""
    own = np.diagonal(C)
    is_known = np.isfinite(own) & (own > 0)
    safe = np.where(is_known, own, 1.0)
    rise = np.sqrt(np.where(is_known, np.maximum(np.diagonal(other) / safe, 1.0), 1.0))
    return C * rise[:, None] * rise[None]


def _group_squares(A: Columns, b: Values, x: Float[np.ndarray, " unknown"]):
    """Mean squared residual of every group, shape (group,)."""
    return np.nanmean((b - A @ x) ** 2, axis=1)


def trimmed_start(
    A: Columns,
    b: Values,
    is_free: Bool[np.ndarray, " unknown"],
    starts: int = _STARTS,
) -> Bool[np.ndarray, " group"]:
    """Half of the groups that agree best with one another.

    Args:
        A: Columns, shape (group, row, unknown).
        b: Values, shape (group, row).
        is_free: Which unknowns may be negative, shape (unknown,).
        starts: How many small subsets are tried at most.

    Returns:
        Which groups are in that half, shape (group,).
    """
    count, height, width = A.shape
    size = min(count, math.ceil(width / height) + 1)
    half = min(count, (count + size + 1) // 2)
    everything = np.ones(count, bool)
    if half == count:
        return everything

    def best_half(groups: np.ndarray) -> tuple[float, np.ndarray]:
        # Groups that agree best with a fit to some, and the sum of their squares.
        rows = A[groups].reshape(-1, width)
        square = _group_squares(A, b, nonnegative(rows, b[groups].reshape(-1), is_free))
        best = np.argsort(square, kind="stable")[:half]
        return float(np.sum(square[best])), best

    if math.comb(count, size) <= starts:
        subsets = [np.array(s) for s in itertools.combinations(range(count), size)]
    else:
        draw = np.random.default_rng(0)
        subsets = [draw.choice(count, size, replace=False) for _ in range(starts)]
    # The fit to all is a start like any other: it wins where nothing is wrong.
    halves = [best_half(groups) for groups in (*subsets, np.arange(count))]
    halves.sort(key=lambda one: one[0])
    least, agreed = halves[0]
    for cost, groups in halves[:_REFINED_STARTS]:
        for _ in range(20):
            lower, groups = best_half(groups)
            if not lower < cost:
                break
            cost = lower
        if cost < least:
            least, agreed = cost, groups
    is_agreed = np.zeros(count, bool)
    is_agreed[agreed] = True
    return is_agreed


def _not_gross(
    A: Columns,
    b: Values,
    is_free: Bool[np.ndarray, " unknown"],
    half: Bool[np.ndarray, " group"],
) -> Bool[np.ndarray, " group"]:
    """True for groups that scatter no more than the median one makes likely."""
    from scipy.stats import chi2

    square = _group_squares(A, b, _solve(A[half], b[half], is_free).x)
    height = b.shape[1]
    spread = float(np.median(square)) * height / chi2.median(height)
    # The better half was chosen because it scatters little: small tables much less.
    freedom = max(1.0, half.sum() - A.shape[2] / height)
    spread *= (1 + 2 / freedom) ** 2
    limit = chi2.isf(_FALSE_ALARM / len(b), height) / height
    return half | (square <= limit * spread)


def _agreeing(
    A: Columns,
    b: Values,
    is_free: Bool[np.ndarray, " unknown"],
    is_right: Bool[np.ndarray, " group"],
) -> Bool[np.ndarray, " group"]:
    """True for groups that agree with the prediction by the other right ones."""
    from scipy.stats import f as f_distribution

    count = len(b)
    agrees = np.ones(count, bool)
    full = _solve(A[is_right], b[is_right], is_free)
    for i in range(count):
        others = is_right.copy()
        others[i] = False
        # With hundreds of groups one more or less changes nothing.
        x, covariance, spread = (
            _solve(A[others], b[others], is_free)
            if is_right[i] and count < 300
            else full
        )
        seen = np.isfinite(b[i])
        freedom = int(np.isfinite(b[others]).sum()) - A.shape[2]
        is_fixed = np.isfinite(np.diagonal(covariance))
        beyond = np.abs(A[i][seen][:, ~is_fixed]).sum() > 0
        if freedom < 1 or beyond or not np.isfinite(spread) or not seen.any():
            # This group alone shows something: nobody can contradict it.
            continue
        rows = A[i][seen][:, is_fixed]
        C = covariance[np.ix_(is_fixed, is_fixed)]
        own = max(spread**2, 1e-28 * float(np.nanmax(b**2)))
        off = b[i][seen] - A[i][seen] @ x
        predicted = rows @ C @ rows.T + own * np.eye(len(rows))
        statistic = float(off @ np.linalg.solve(predicted, off)) / len(rows)
        limit = f_distribution.isf(_FALSE_ALARM / count, len(rows), freedom)
        sizes = np.linalg.norm(b[i][seen]), np.linalg.norm(A[i][seen] @ x)
        is_gross = np.linalg.norm(off) > _GROSS * max(sizes)
        agrees[i] = statistic <= limit or not is_gross
    return agrees
