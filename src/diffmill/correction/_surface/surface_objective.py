"""The error of the machined surface as the objective of a correction."""

from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows3, RealScalarLike
from .._core.path_objective import AbstractObjective, beyond, deviation_of, row_shares
from .._core.problem import Motion, Problem
from .finished_surface import FinishedSurface

# Poses over a point that differ by about as much share its error in the model of a step
# [m]: the size of the errors that a path which was brought onto the desired one leaves.
_SHARED_DEPTH = 1.5e-5


class SurfaceObjective(AbstractObjective):
    """The signed error of the machined surface, walls and floors apart.

    Attributes:
        surface: The surface as it should be.
        wall_weight: Weight of the walls' mean square.
        floor_weight: Weight of the floors' mean square.
        tolerance: Half the width of the band within which no error counts [m].
        shares: How much each point counts among those of its kind, see
            `FinishedSurface.point_shares`, shape (point,); all alike if None.
    """

    surface: FinishedSurface
    wall_weight: RealScalarLike = 1.0
    floor_weight: RealScalarLike = 1.0
    tolerance: RealScalarLike = 0.0
    shares: Float[np.ndarray, " point"] | Float[Array, " point"] | None = None

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Return the errors of the points, and the whole deviation for its lag.

        **Differentiability**: that of `FinishedSurface.errors`; kink at the band.
        """
        error = self.surface.errors(motion.actual)
        error = beyond(error[:, None], self.tolerance)[:, 0]
        error = error * jnp.sqrt(self._weights(jnp, error.dtype))
        return jnp.concatenate([error, _whole_deviation(problem, motion, lag_weight)])

    def for_step(self, problem: Problem, motion: Motion) -> "AbstractObjective":
        """Return what the poses over a point leave if each moves by the point's error.

        Of the poses over a point the deepest alone leaves an error. If it alone came
        out in a step, the next one would leave it instead. So those about as deep
        share the error, and each is to move by all of it: no mean of them, which some
        would keep by moving against others.
        """
        del problem
        actual = np.asarray(motion.actual)
        depth = self.surface.host_depths(actual)
        error = depth.min(axis=1)
        near = np.exp((error[:, None] - depth) / _SHARED_DEPTH)
        share = self._weights(np, depth.dtype) / near.sum(axis=1)
        error = np.sign(error) * np.maximum(np.abs(error) - self.tolerance, 0.0)
        return _PoseObjective.of(self.surface, actual, near * share[:, None], error)

    def _weights(self, xp: ModuleType, dtype: Any) -> Any:
        """Return the shares of the points in the mean square, in NumPy or JAX."""
        is_wall = xp.asarray(self.surface.is_wall)
        counts = 1.0 if self.shares is None else self.shares
        share = xp.asarray(counts, dtype) * xp.ones(is_wall.shape, dtype)
        weight = xp.where(is_wall, self.wall_weight, self.floor_weight).astype(dtype)
        of_kind = lambda kind: xp.sum(xp.where(kind, share, xp.zeros_like(share)))
        total = xp.where(is_wall, of_kind(is_wall), of_kind(~is_wall))
        return weight * share / xp.maximum(total, 1e-30)


class _PoseObjective(AbstractObjective):
    """Poses that are to move by the errors of the points that they leave.

    Attributes:
        roots: Roots of how much each direction of a tip counts, shape (step, 3, 3).
        error: What is to go away by the move [m], in the roots' directions,
            shape (step, 3).
        at: Tips from where they move [m], shape (step, 3).
    """

    roots: Float[np.ndarray, "step 3 3"] | Float[Array, "step 3 3"]
    error: Float[np.ndarray, "step 3"] | Float[Array, "step 3"]
    at: Float[np.ndarray, "step 3"] | Float[Array, "step 3"]

    @classmethod
    def of(
        cls,
        surface: FinishedSurface,
        actual: FloatRows3,
        weights: Float[np.ndarray, "point pose"],
        errors: Float[np.ndarray, " point"],
    ) -> "_PoseObjective":
        """Return the objective of all pairs of a point and a pose in a mean square.

        A pair is linear in the tip of its pose, so that those of a pose are three.

        Args:
            surface: The points and the poses over them.
            actual: Actual tips from where they move [m], shape (step, 3).
            weights: Shares of the pairs in the mean square, shape (point, pose).
            errors: What is to go away at each point [m], shape (point,).
        """
        rows, slopes = (
            np.asarray(surface.poses).reshape(-1),
            surface.host_slopes(actual),
        )
        count = len(actual)
        total = lambda pairs: np.bincount(rows, pairs.reshape(-1), count)
        curvature, gradient = np.zeros((count, 3, 3)), np.zeros((count, 3))
        for i in range(3):
            pull = weights * slopes[i]
            gradient[:, i] = total(pull * errors[:, None])
            for j in range(i + 1):
                curvature[:, i, j] = curvature[:, j, i] = total(pull * slopes[j])
        size, axes = np.linalg.eigh(curvature)
        root = np.sqrt(np.maximum(size, 0.0))
        # No slope at all to rounding: no pull either.
        is_there = root > 1e-6 * root.max()
        left = np.einsum("sji,sj->si", axes, gradient)
        left = np.where(is_there, left / np.where(is_there, root, 1.0), 0.0)
        roots = np.where(is_there, root, 0.0)[:, :, None] * np.swapaxes(axes, 1, 2)
        dtype = actual.dtype
        return cls(roots.astype(dtype), left.astype(dtype), np.asarray(actual))

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Return what is left of the errors after a move, and the whole deviation.

        **Differentiability**: smooth, linear.
        """
        moved = motion.actual - jnp.asarray(self.at)
        error = jnp.einsum("sij,sj->si", jnp.asarray(self.roots), moved)
        error = (error + jnp.asarray(self.error)).reshape(-1)
        return jnp.concatenate([error, _whole_deviation(problem, motion, lag_weight)])


def _whole_deviation(
    problem: Problem, motion: Motion, lag_weight: RealScalarLike
) -> Float[Array, " error"]:
    """Return the weighted deviation, of which the surface sees a part."""
    dtype = motion.actual.dtype
    rest = deviation_of(problem, motion) * row_shares(problem, dtype)[:, None]
    return (jnp.asarray(lag_weight, dtype) * rest).reshape(-1)
