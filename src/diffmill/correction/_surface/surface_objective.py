"""The error of the machined surface as the objective of a correction."""

from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows3, RealScalarLike
from ...settings.correction import SurfaceErrorSettings
from .._core.path_objective import AbstractObjective, deadband, deviation_of, row_shares
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
    wall_weight: RealScalarLike = SurfaceErrorSettings.wall_weight
    floor_weight: RealScalarLike = SurfaceErrorSettings.floor_weight
    tolerance: RealScalarLike = 0.0
    shares: Float[np.ndarray, " point"] | Float[Array, " point"] | None = None

    @property
    def starts_from_path(self) -> bool:
        """True: far from the path no pose is over the points that count."""
        return True

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Errors of the points, and the whole deviation for its lag [m].

        **Differentiability**: that of `FinishedSurface.errors`; kink at the band.
        """
        error = self.surface.errors(motion.actual)
        error = deadband(error[:, None], self.tolerance)[:, 0]
        error = error * jnp.sqrt(self._weights(jnp, error.dtype))
        away = deviation_of(problem, motion) * row_shares(problem, error.dtype)[:, None]
        away = jnp.asarray(lag_weight, error.dtype) * away
        return jnp.concatenate([error, away.reshape(-1)])

    def for_step(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> "AbstractObjective":
        """Objective of moves by which the poses over a point take away its error.

        Of the poses over a point the deepest alone leaves an error. If it alone came
        out in a step, the next one would leave it instead. So those about as deep
        share the error, and each is to move by all of it: no mean of them, which some
        would keep by moving against others. Where one pose decides each point alone
        this is the model of Gauss and Newton; else the gradient is another one.
        """
        actual = np.asarray(motion.actual)
        depth = self.surface.host_depths(actual)
        error = depth.min(axis=1)
        near = np.exp((error[:, None] - depth) / _SHARED_DEPTH)
        # Points with few poses have some of them more than once, side by side.
        poses = np.asarray(self.surface.poses)
        near[:, 1:][poses[:, 1:] == poses[:, :-1]] = 0.0
        share = self._weights(np, depth.dtype) / near.sum(axis=1)
        error = np.sign(error) * np.maximum(np.abs(error) - self.tolerance, 0.0)
        lag = float(lag_weight) * np.asarray(row_shares(problem, actual.dtype))
        away = np.asarray(deviation_of(problem, motion), np.float64)
        curvature = lag[:, None, None] ** 2 * np.eye(3)
        gradient = lag[:, None] ** 2 * away
        # A pair of a point and a pose is linear in the tip of the pose.
        slopes, rows = self.surface.host_slopes(actual), poses.reshape(-1)
        total = lambda pairs: np.bincount(rows, pairs.reshape(-1), len(actual))
        for i in range(3):
            pull = near * share[:, None] * slopes[i]
            gradient[:, i] += total(pull * error[:, None])
            for j in range(3):
                curvature[:, i, j] += total(pull * slopes[j])
        return _PoseObjective.of(curvature, gradient, actual)

    def _weights(self, xp: ModuleType, dtype: Any) -> Any:
        """Shares of the points in the mean square, in NumPy or JAX, (point,)."""
        is_wall = xp.asarray(self.surface.is_wall)
        counts = 1.0 if self.shares is None else self.shares
        share = xp.asarray(counts, dtype) * xp.ones(is_wall.shape, dtype)
        weight = xp.where(is_wall, self.wall_weight, self.floor_weight).astype(dtype)
        of_kind = lambda kind: xp.sum(xp.where(kind, share, xp.zeros_like(share)))
        total = xp.where(is_wall, of_kind(is_wall), of_kind(~is_wall))
        return weight * share / xp.maximum(total, 1e-30)


class _PoseObjective(AbstractObjective):
    """Poses that are to move, in all directions by as much as their errors say.

    Attributes:
        roots: Roots of how much each direction of a tip counts, shape (step, 3, 3).
        error: Errors that the move is to take away [m], in the roots' directions,
            shape (step, 3).
        at: Tips from where they move [m], shape (step, 3).
    """

    roots: Float[np.ndarray, "step 3 3"] | Float[Array, "step 3 3"]
    error: Float[np.ndarray, "step 3"] | Float[Array, "step 3"]
    at: Float[np.ndarray, "step 3"] | Float[Array, "step 3"]

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Errors that a move leaves [m], in the roots' directions, flat.

        **Differentiability**: smooth, linear.
        """
        del problem, lag_weight
        moved = motion.actual - jnp.asarray(self.at)
        change = jnp.einsum("sij,sj->si", jnp.asarray(self.roots), moved)
        return (change + jnp.asarray(self.error)).reshape(-1)

    @classmethod
    def of(
        cls,
        curvature: Float[np.ndarray, "step 3 3"],
        gradient: Float[np.ndarray, "step 3"],
        at: FloatRows3,
    ) -> "_PoseObjective":
        """Objective whose half square has a curvature and a gradient."""
        size, axes = np.linalg.eigh(curvature)
        root = np.sqrt(np.maximum(size, 0.0))
        # No slope at all to rounding: no pull either.
        is_there = root > 1e-6 * root.max(initial=0.0)
        error = np.einsum("sji,sj->si", axes, gradient)
        error = np.where(is_there, error / np.where(is_there, root, 1.0), 0.0)
        roots = np.where(is_there, root, 0.0)[:, :, None] * np.swapaxes(axes, 1, 2)
        dtype = np.asarray(at).dtype
        return cls(roots.astype(dtype), error.astype(dtype), np.asarray(at))
