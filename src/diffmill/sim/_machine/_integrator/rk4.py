"""The explicit integrator, which verifies the default."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ....robot import ArmTerms, Robot
from .base import AbstractIntegrator, ArmState, Dynamics, MotorCommand, state_rate


class RungeKutta4(AbstractIntegrator):
    """The classical explicit rule of order 4, to verify the default by.

    The full equations of motion are evaluated in each of the four stages, so that a
    sub-step costs as much as a whole period of the default. Stable only where no mode
    reaches the angular frequency 2.8 / h.

    Attributes:
        dynamics: Algorithm of the accelerations.

    **Differentiability**: smooth.
    """

    dynamics: Dynamics = eqx.field(static=True, default="crba")

    def steps_to_middle(self, substeps: int) -> int:
        return -(-substeps // 2)

    def begin(self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]) -> None:
        return None

    def step(
        self,
        robot: Robot,
        prepared: None,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        h = step

        def slope(state: ArmState, after: Float[Array, ""]) -> ArmState:
            target = command.position + after * command.rate
            motors = MotorCommand(target, command.rate)
            return state_rate(robot, state, motors, load, self.dynamics)

        def euler(step: Float[Array, ""], rate: ArmState) -> ArmState:
            return jax.tree.map(lambda x, dx: x + step * dx, state, rate)

        first = slope(state, -h / 2)
        second = slope(euler(h / 2, first), jnp.zeros_like(h))
        third = slope(euler(h / 2, second), jnp.zeros_like(h))
        fourth = slope(euler(h, third), h / 2)
        mean = jax.tree.map(
            lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, first, second, third, fourth
        )
        return euler(h, mean)
