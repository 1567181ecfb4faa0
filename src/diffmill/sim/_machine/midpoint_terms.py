"""The robot's terms in the middle of what they are held for.

Terms of the start lag behind the arm by half a tooth period, which damps its swinging
and makes the simulation one of first order in the period. Where the arm will be in the
middle is told by half a period of the run's own rule: one implicit step of it also of a
mode that turns often in a period says nothing wild, as the way at the present velocity
would.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...robot import ArmTerms, Robot
from ._integrator.base import AbstractIntegrator, ArmState, MotorCommand


class HoldSpan(eqx.Module):
    """The time for which the robot's terms are held.

    Attributes:
        duration: [s], shape ().
        substeps: Sub-steps in it, short enough for the integrator.
    """

    duration: Float[Array, ""]
    substeps: int = eqx.field(static=True)

    @property
    def substep(self) -> Float[Array, ""]:
        """Length of a sub-step [s], shape ()."""
        return self.duration / self.substeps


def middle_terms(
    robot: Robot,
    integrator: AbstractIntegrator,
    terms: ArmTerms,
    state: ArmState,
    motors: MotorCommand,
    span: HoldSpan,
) -> ArmTerms:
    """Return the terms where the arm will be half a span later, free of load.

    Args:
        robot: The robot.
        integrator: The rule that takes the half span.
        terms: Its terms at the start.
        state: At the start.
        motors: Where the motors should be at the start, and their rate.
        span: What the terms are to be held for.

    Returns:
        The terms; of second order in the span.

    **Differentiability**: as the rule and the drive's options.
    """
    count = integrator.steps_to_middle(span.substeps)
    h, rest = span.duration / 2 / count, jnp.zeros_like(state.v)
    prepared = integrator.begin(robot, terms, h)

    def step(state: ArmState, after: Float[Array, ""]) -> tuple[ArmState, None]:
        command = MotorCommand(motors.position + after * motors.rate, motors.rate)
        return integrator.step(robot, prepared, state, command, rest, h), None

    middles = h * (jnp.arange(count, dtype=h.dtype) + 0.5)
    ahead, _ = jax.lax.scan(step, state, middles)
    return ArmTerms.of_state(robot, ahead.q, ahead.v)
