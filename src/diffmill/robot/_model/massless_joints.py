"""Joints that move no mass: no dynamics, and no silent answer instead."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .robot import Robot


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
