"""Factor and inverse of a mass matrix; where joints move no mass there is none."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._algebra.spatial import sum_rows
from .._model.robot import Robot


def factor(mass_matrix: Float[Array, "joint joint"]) -> Float[Array, "joint joint"]:
    """Cholesky factor of M, not a number where M is singular.

    A joint whose inertia is all shared with others, down to rounding, has no
    acceleration of its own: a factor would exist, by luck of the last digits.
    """
    L = jnp.linalg.cholesky(mass_matrix)
    M_ii = jnp.diagonal(mass_matrix)
    floor = 8 * mass_matrix.shape[0] * jnp.finfo(mass_matrix.dtype).eps
    is_regular = jnp.all(jnp.diagonal(L) ** 2 > floor * M_ii)
    return jnp.where(is_regular, L, jnp.nan)


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

    Args:
        matrix: Such as M + diag(d) [kg m^2], shape (joint, joint).

    Returns:
        The inverse; not a number where the matrix is singular to rounding.
    """
    eye = jnp.eye(matrix.shape[0], dtype=matrix.dtype)
    return jsl.cho_solve((factor(matrix), True), eye)


@spd_inverse.defjvp
def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Array, Array]:
    inverse = spd_inverse(*primals)
    return inverse, -sum_rows(inverse, sum_rows(tangents[0], inverse))
