"""A machine as a linear system, about one state: an arm on its drives, or modes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ...numerics import CachedJit
from ...robot import ArmTerms, Robot, TipModes
from .._machine._integrator.base import ArmState, MotorCommand, constant_command_rate


class LinearArm(eqx.Module):
    """x' = A x + G F, tip = C x, with the force F on the tool and the tip in `work`.

    Attributes:
        A: Slope of the rate in the state, shape (state, state).
        G: Slope of the rate in the force, shape (state, 3).
        C: Slope of the tip in the state, shape (3, state).
    """

    A: Float[Array, "state state"]
    G: Float[Array, "state 3"]
    C: Float[Array, "3 state"]


@eqx.filter_jit
def linear_modes(modes: TipModes, row_count: int) -> LinearArm:
    """Return modes as a linear system, the same in all rows."""
    omega = 2 * jnp.pi * jnp.asarray(modes.frequencies)
    ratio, shapes = jnp.asarray(modes.damping_ratios), jnp.asarray(modes.shapes)
    eye, none = jnp.eye(omega.size, dtype=omega.dtype), jnp.zeros_like(shapes)
    spring, damper = jnp.diag(omega**2), jnp.diag(2 * ratio * omega)
    A = jnp.block([[jnp.zeros_like(eye), eye], [-spring, -damper]])
    G = jnp.concatenate([none, shapes])
    C = jnp.concatenate([shapes, none]).T
    repeated = lambda x: jnp.broadcast_to(x[None], (row_count, *x.shape))
    return jax.tree.map(repeated, LinearArm(A, G, C))


@CachedJit
def linear_arms(
    robot: Robot,
    T_base_work: Float[Array, "4 4"],
    motors: Float[Array, "row joint"],
    joints: Float[Array, "row joint"],
    rates: Float[Array, "row joint"],
) -> LinearArm:
    """Return the arm about some states.

    Slopes are those of the drives where they are, gaps and friction too; the mass
    matrix is held and the weight follows the joints.

    Args:
        robot: The robot.
        T_base_work: Pose of the workpiece in the robot's base.
        motors: Motor positions theta [rad or m], shape (row, joint).
        joints: Joint positions [rad or m], shape (row, joint).
        rates: Rates of the motors and of the joints [rad/s or m/s], shape (row, joint).

    Returns:
        The systems, with a leading axis of rows.
    """

    def one(
        theta: Float[Array, " joint"],
        q: Float[Array, " joint"],
        v: Float[Array, " joint"],
    ) -> LinearArm:
        state = ArmState(q, v)
        if robot.motors is not None:
            state = ArmState(q, v, theta, v)
        terms = ArmTerms.of_state(robot, q, v)
        J = T_base_work[:3, :3].T @ terms.jacobian[:3]
        flat, unravel = ravel_pytree(state)

        def rate(x: Float[Array, " state"], F: Float[Array, " 3"]) -> Array:
            command = MotorCommand(theta, v)
            found = constant_command_rate(robot, terms, unravel(x), command, J.T @ F)
            return ravel_pytree(found)[0]

        A, G = jax.jacfwd(rate, argnums=(0, 1))(flat, jnp.zeros(3, flat.dtype))
        C = jax.jacfwd(lambda x: J @ unravel(x).q)(flat)
        return LinearArm(A, G, C)

    return jax.vmap(one)(motors, joints, rates)
