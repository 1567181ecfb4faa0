"""Joints that move no mass: no dynamics, and no silent answer instead."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .robot import Robot

# A joint that moves less [kg] is no joint of a machine.
LIGHTEST = 1e-2


def massless_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints that move no mass at all; their row of M is zero.

    Args:
        robot: The robot, with concrete arrays.

    Returns:
        Names of the joints.
    """
    heavy = np.asarray(robot.link_masses) > 0.0
    heavy |= np.asarray(robot.link_inertias).any(axis=(1, 2))
    return _not_moving(robot, heavy)


def light_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints that move next to no mass, massless ones included."""
    masses = np.array(robot.link_masses, float)
    for body in reversed(range(robot.body_count)):
        if robot.parents[body] >= 0:
            masses[robot.parents[body]] += masses[body]
    return _not_moving(robot, masses >= LIGHTEST)


def _not_moving(robot: Robot, heavy: np.ndarray) -> tuple[str, ...]:
    """Return the joints that move no body of a kind, given whether each is of it."""
    heavy = heavy.copy()
    for body in reversed(range(robot.body_count)):
        if robot.parents[body] >= 0:
            heavy[robot.parents[body]] |= heavy[body]
    moves = np.zeros(robot.joint_count, dtype=bool)
    own = 0
    for body, mimic in enumerate(robot.mimics):
        joint = own if mimic is None else mimic[0]
        own += mimic is None
        moves[joint] |= heavy[body]
    return tuple(n for n, m in zip(robot.joint_names, moves, strict=True) if not m)


def factor(mass_matrix: Float[Array, "joint joint"]) -> Float[Array, "joint joint"]:
    """Return the Cholesky factor of M, not a number where M is singular.

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
    names = ", ".join(massless_joints(robot))
    reason = f"the joints {names} move no mass" if names else "at this pose"
    raise ValueError(
        f"The {what} of {robot.name!r} cannot be computed: the mass matrix is singular "
        f"({reason}), or an argument is not a number. Kinematics is not concerned."
    )
