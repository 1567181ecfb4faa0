"""The robot's terms in the middle of what they are held for.

Terms of the start lag behind the arm by half a tooth period, which damps its swinging
and makes the simulation one of first order in the period. Where the arm will be in the
middle is told by one implicit step of half the period: also of a mode that turns often
in a period it says nothing wild, as the way at the present velocity would.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..robot import ArmTerms, Robot, arm_terms
from ._midpoint import Midpoint
from ._stepping import ArmState, MotorCommand


def middle_terms(
    robot: Robot,
    terms: ArmTerms,
    state: ArmState,
    motors: MotorCommand,
    span: Float[Array, ""],
) -> ArmTerms:
    """Return the terms where the arm will be half a span later, free of load.

    Args:
        robot: The robot.
        terms: Its terms at the start.
        state: At the start.
        motors: Where the motors should be at the start, and their rate.
        span: The time that the terms are to be held for [s].

    Returns:
        The terms; of second order in the span.

    **Differentiability**: as `Midpoint`; the matrix and the bias of the half step count
    as constants.
    """
    rule, half = Midpoint(), span / 2
    command = MotorCommand(motors.position + half / 2 * motors.rate, motors.rate)
    # Where the middle is follows the state and the drives; that the half step's own
    # matrix changes with them too is of higher order than the step itself.
    begun = jax.lax.stop_gradient(rule.begin(robot, terms, half))
    ahead = rule.step(robot, begun, state, command, jnp.zeros_like(state.v), half)
    return arm_terms(robot, ahead.q, ahead.v)
