"""Factor and inverse of a mass matrix; where joints move no mass there is none."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .._algebra.spatial import sum_rows
from .._model.robot import Robot


def factor(mass_matrix: Float[Array, "joint joint"]) -> Float[Array, "joint joint"]:
    """Cholesky factor of M, not a number where M is singular.

    A joint whose inertia is all shared with others, down to rounding, has no
    acceleration of its own: a factor would exist, by luck of the last digits.
    """
    L = jnp.linalg.cholesky(mass_matrix)
    is_regular = jnp.all(jnp.diagonal(L) ** 2 > _least_pivots(mass_matrix))
    return jnp.where(is_regular, L, jnp.nan)


def _least_pivots(mass_matrix: Float[Array, "joint joint"]) -> Float[Array, " joint"]:
    """Pivots down to which a matrix is regular."""
    floor = 8 * mass_matrix.shape[0] * jnp.finfo(mass_matrix.dtype).eps
    return floor * jnp.diagonal(mass_matrix)


def refuse_singular(
    robot: Robot, result: Float[Array, "..."], what: str
) -> Float[Array, "..."]:
    """Return a result, or raise if it is not a number because M is singular.

    Under a transformation there are no values to look at: the result stays NaN.

    Raises:
        ValueError: If the result is not a number.
    """
    if isinstance(result, Tracer) or not np.isnan(np.asarray(result)).any():
        return result
    names = ", ".join(robot.massless_joints)
    reason = f"the joints {names} move no mass" if names else "at this pose"
    raise ValueError(
        f"The {what} of {robot.name!r} cannot be computed: the mass matrix is singular "
        f"({reason}), or an argument is not a number. Kinematics is not concerned."
    )


@jax.custom_jvp
def spd_inverse(
    matrix: Float[Array, "joint joint"],
) -> Float[Array, "joint joint"]:
    """Inverse of a symmetric, positive definite matrix.

    A step that multiplies with it often is cheaper than one that solves. Derivatives
    are two products, not those of a factor and its solutions.

    Gauss and Jordan's elimination: its pivots are the squares of Cholesky's diagonal,
    so that none has to be sought. A call of LAPACK within a scan would keep XLA from
    making one kernel of the whole scan.

    Args:
        matrix: Such as M + diag(d) [kg m^2], shape (joint, joint).

    Returns:
        The inverse; not a number where the matrix is singular to rounding.
    """
    count, floor = matrix.shape[0], _least_pivots(matrix)
    rows = jnp.concatenate([matrix, jnp.eye(count, dtype=matrix.dtype)], axis=1)
    index = jnp.arange(count)

    def eliminate(
        k: Int[Array, ""], rows: Float[Array, "joint both"]
    ) -> Float[Array, "joint both"]:
        own = rows[k]
        own = own / jnp.where(own[k] > floor[k], own[k], jnp.nan)
        cleared = rows - rows[:, k][:, None] * own[None]
        return jnp.where((index == k)[:, None], own[None], cleared)

    return jax.lax.fori_loop(0, count, eliminate, rows)[:, count:]


@spd_inverse.defjvp
def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Array, Array]:
    inverse = spd_inverse(*primals)
    return inverse, -sum_rows(inverse, sum_rows(tangents[0], inverse))
