"""Objective of a correction: an error of the tip or of the machined surface."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from .problem import Motion, Problem

# Weight of a row in the air: its error counts as a hundredth of one in the cut.
_IN_AIR = 1e-4


class AbstractObjective(eqx.Module):
    """An error as a vector whose square is a mean square [m^2]."""

    @property
    def starts_from_path(self) -> bool:
        """True if the optimiser shall bring the tip onto the path first.

        For an objective that sees only what is near its end, as a surface does.
        """
        return False

    @abc.abstractmethod
    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Weighted errors of a motion [m], shape (error,).

        Args:
            problem: The problem, whose row weights count.
            motion: Motion of the plant.
            lag_weight: Weight of the deviation that the error itself does not see, so
                that the command does not drift where that gains nothing.

        Returns:
            Errors times the root of their share in the mean [m], shape (error,).
        """

    def for_step(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> "AbstractObjective":
        """Objective of which the model of a step is made, by default self.

        For an objective whose slopes at a motion know nothing of what a step from there
        runs into. Its square is to fall where that of self does; whether it has, a run
        says.

        Args:
            problem: The problem, whose row weights count.
            motion: Motion of the plant where the step begins.
            lag_weight: Weight of the lag, see `errors`.
        """
        del problem, motion, lag_weight
        return self


class PathObjective(AbstractObjective):
    """The distance of the tip to the desired path beyond a tolerance band.

    Zero within the band; outside, the cost is the square of the distance to the band,
    which begins with no slope.

    Attributes:
        tolerance: Half the width of the band [m], at least 0.
    """

    tolerance: RealScalarLike = 0.0

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Contour vectors, shortened by the tolerance, with the lag [m], flat.

        **Differentiability**: that of `Problem.contour`; kink at the border of the
        band.
        """
        contour = problem.contour(motion)
        lag = deviation_of(problem, motion) - contour
        error = deadband(contour, self.tolerance)
        error = error + jnp.asarray(lag_weight, contour.dtype) * lag
        return (error * row_shares(problem, contour.dtype)[:, None]).reshape(-1)

    def for_step(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> AbstractObjective:
        """Objective with the slopes of the whole error.

        Within a tolerance a row has none, so that a step is free to move it out again.
        With those of the whole error the square of the linear model lies nowhere below
        the square itself, and has the same gradient where they meet.
        """
        del lag_weight
        if not np.any(self.tolerance):
            return self
        whole = PathObjective()
        return _DeadbandModel(
            whole, _deadband_part(self, whole, problem.without_plant, motion)
        )


class _DeadbandModel(AbstractObjective):
    """An objective less a part that a step does not change.

    Attributes:
        whole: The objective.
        part: The part of its errors [m], shape (error,).
    """

    whole: AbstractObjective
    part: Float[Array, " error"]

    def errors(
        self, problem: Problem, motion: Motion, lag_weight: RealScalarLike
    ) -> Float[Array, " error"]:
        """Errors of the objective less the part [m], shape (error,)."""
        return self.whole.errors(problem, motion, lag_weight) - self.part


@eqx.filter_jit
def _deadband_part(
    shortened: AbstractObjective,
    whole: AbstractObjective,
    problem: Problem,
    motion: Motion,
) -> Float[Array, " error"]:
    """Part of the whole errors that a deadband takes away [m], shape (error,)."""
    errors = lambda objective: objective.errors(problem, motion, 0.0)
    return errors(whole) - errors(shortened)


def check_objective(objective: object) -> None:
    """Raise a `ValueError` unless it is an objective, or None."""
    if not (objective is None or isinstance(objective, AbstractObjective)):
        raise ValueError(
            "Argument `objective` must be an instance of AbstractObjective, but is "
            f"{objective!r}."
        )


def deadband(
    vector: Float[Array, "row axis"], tolerance: RealScalarLike
) -> Float[Array, "row axis"]:
    """Vectors shortened by a tolerance, zero where they are shorter [m], (row, axis).

    Args:
        vector: Vectors [m], shape (row, axis).
        tolerance: Length to take off [m], at least 0.

    **Differentiability**: kink where the length is the tolerance; its square has
    none. With no tolerance the identity, at zero too.
    """
    tolerance = jnp.asarray(tolerance, vector.dtype)
    square = jnp.sum(vector * vector, axis=1)
    # The root has no derivative at zero: it gets a harmless input there.
    length = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    share = jnp.where(square >= tolerance**2, 1 - tolerance / length, 0.0)
    return vector * share[:, None]


def deviation_of(problem: Problem, motion: Motion) -> Float[Array, "step 3"]:
    """Deviation actual - desired [m], shape (step, 3)."""
    return motion.actual - jnp.asarray(problem.desired, motion.actual.dtype)


def row_shares(problem: Problem, dtype: jnp.dtype) -> Float[Array, " step"]:
    """Roots of the rows' shares in a weighted mean, shape (step,).

    Rows that do not count have a little weight all the same: on the way through the air
    the command would be free to leave the path as far as the bounds.
    """
    weights = jnp.asarray(problem.is_cutting, dtype)
    total = jnp.sum(weights)
    seen = jnp.maximum(weights, jnp.asarray(_IN_AIR, dtype))
    return jnp.sqrt(seen / jnp.where(total > 0, total, 1.0))
