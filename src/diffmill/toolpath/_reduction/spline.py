"""Few points whose natural cubic spline in time keeps a path within a tolerance.

The spline is fitted to all rows by least squares, so that its points lie beside the
path. Where they stand in time is found in three stages: the error of a cubic grows with
the fourth power of the distance of two points, which tells how dense they have to be
(de Boor, A Practical Guide to Splines, ch. XII); intervals that still miss the
tolerance are halved; points that the tolerance does not need are taken out, every
eighth at a time, since a spline forgets a point after a few others.
"""

import numpy as np
from jaxtyping import Float, Int

_FIRST_STRIDE = 8
_SPREAD_COUNT = 10
# From the spread on which the points have settled, each is finished and the best kept.
_SETTLED_SPREAD = 5
# From spread to spread the density changes by no more than these factors.
_LEAST_DENSITY_CHANGE, _LARGEST_DENSITY_CHANGE = 0.5, 2.0
# So many points apart, one that is taken out changes nothing at the next.
_REMOVAL_STRIDE = 8
_NEIGHBOUR_COUNT = 4

Rows = Float[np.ndarray, "row component"]
Knots = Int[np.ndarray, " _"]


class SplineFit:
    """Splines through points at some of the rows of a path.

    Args:
        time: Times of the rows [s], increasing.
        points: Tip, a point up the tool's axis and, where its rotation counts, one
            along its x [m], shape (row, 6 or 9).
        tolerance: Largest distance of each at the time of every row [m].
        fixed: Rows at which points stand anyhow, increasing.
    """

    def __init__(
        self,
        time: Float[np.ndarray, " row"],
        points: Rows,
        tolerance: float,
        fixed: Knots,
    ):
        self.time, self.points, self.tolerance = time, points, tolerance
        self.fixed = fixed

    def fitted(self, knots: Knots) -> Rows:
        """Return the spline at all rows.

        Args:
            knots: Rows at which the points stand, the first and the last among them.
        """
        from scipy.interpolate import BSpline
        from scipy.sparse import csr_array, vstack
        from scipy.sparse.linalg import spsolve

        at = self.time[knots]
        full = np.concatenate([[at[0]] * 3, at, [at[-1]] * 3])
        basis = BSpline.design_matrix(self.time, full, 3)
        # Without a bend at an end its first and last coefficient follow from the next.
        count = at.size
        head, tail = np.zeros((2, 1, count))
        lead = (full[4] - full[3]) / (full[5] - full[2]) if count > 2 else 1.0
        rear = (full[-4] - full[-5]) / (full[-3] - full[-6]) if count > 2 else 1.0
        head[0, :2] = 1 + lead, -lead
        tail[0, -2:] = -rear, 1 + rear
        inner = csr_array((np.ones(count), (np.arange(count),) * 2))
        basis = csr_array(basis @ vstack([csr_array(head), inner, csr_array(tail)]))
        weights = spsolve((basis.T @ basis).tocsc(), basis.T @ self.points)
        return basis @ np.asarray(weights).reshape(count, -1)

    def fewest_knots(self) -> Knots:
        """Return few rows whose spline keeps the tolerance."""
        count = self.time.size
        knots = np.unique(np.append(np.arange(0, count - 1, _FIRST_STRIDE), count - 1))
        best = np.arange(count)
        for spread in range(_SPREAD_COUNT):
            knots = self._spread(knots)
            if spread >= _SETTLED_SPREAD:
                fewer = self._decimated(self._halved(knots))
                best = fewer if fewer.size < best.size else best
        return best

    def _misses(self, knots: Knots) -> Float[np.ndarray, " row"]:
        """Distance of the spline from every row, as a share of the tolerance."""
        gap = (self.fitted(knots) - self.points).reshape(self.time.size, -1, 3)
        return np.linalg.norm(gap, axis=2).max(axis=1) / self.tolerance

    def _worst(self, knots: Knots) -> Float[np.ndarray, " interval"]:
        """Return the largest miss between two points."""
        miss = self._misses(knots)
        inside = np.maximum.reduceat(miss, knots[:-1])
        return np.maximum(inside, miss[knots[1:]])

    def _spread(self, knots: Knots) -> Knots:
        """Return points that are as dense as the misses ask for."""
        rows = np.diff(knots)
        change = np.clip(
            self._worst(knots) ** 0.25, _LEAST_DENSITY_CHANGE, _LARGEST_DENSITY_CHANGE
        )
        density = np.pad(change / rows, 1, mode="edge")
        density = np.minimum(np.convolve(density, [0.25, 0.5, 0.25], "valid"), 1.0)
        total = np.concatenate([[0.0], np.cumsum(density * rows)])
        ends = np.linspace(0.0, total[-1], int(np.ceil(total[-1])) + 1)
        spread = np.round(np.interp(ends, total, knots)).astype(int)
        return np.union1d(spread, self.fixed)

    def _halved(self, knots: Knots) -> Knots:
        """Return points of which more stand where the tolerance is missed."""
        while True:
            is_bad = self._worst(knots) > 1
            if not is_bad.any():
                return knots
            is_open = np.diff(knots) > 1
            if not (is_bad & is_open).any():
                # Points at all rows here: those beside them hold the spline back.
                is_bad = np.convolve(is_bad, np.ones(3), "same") > 0
                if not (is_bad & is_open).any():
                    return np.arange(self.time.size)
            middle = (knots[:-1] + knots[1:]) // 2
            knots = np.unique(np.concatenate([knots, middle[is_bad]]))

    def _decimated(self, knots: Knots) -> Knots:
        """Return points without those that the tolerance does not need."""
        for phase in range(_REMOVAL_STRIDE):
            out = np.setdiff1d(knots[1 + phase : -1 : _REMOVAL_STRIDE], self.fixed)
            while out.size:
                trial = np.setdiff1d(knots, out)
                bad = np.flatnonzero(self._misses(trial) > 1)
                if not bad.size:
                    knots = trial
                    break
                place = np.searchsorted(trial, out)
                first = trial[np.maximum(place - _NEIGHBOUR_COUNT, 0)]
                last = trial[np.minimum(place + _NEIGHBOUR_COUNT - 1, trial.size - 1)]
                is_to_blame = np.searchsorted(bad, last, side="right") > (
                    np.searchsorted(bad, first)
                )
                if not is_to_blame.any():
                    break
                out = out[~is_to_blame]
        return knots
