"""How the robot gets from one sub-step to the next, without knowing what it cuts.

All integrators share one interface: `begin` takes the robot's terms at the start of a
tooth period and prepares what the sub-steps share, `step` makes one sub-step. The force
of the teeth comes in as joint torques that are held over the sub-step: between two
looks at the chip nothing more is known of it.
"""

import abc
from typing import Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..robot import ArmTerms, Robot, arm_terms

IntegratorName: TypeAlias = Literal["midpoint", "rk4"]


class ArmState(eqx.Module):
    """What of the robot evolves.

    Attributes:
        q: Joint positions [rad or m], shape (joint,).
        v: Joint velocities [rad/s or m/s], shape (joint,).
    """

    q: Float[Array, " joint"]
    v: Float[Array, " joint"]


class MotorCommand(eqx.Module):
    """What the controller wants of the motors in one sub-step.

    Attributes:
        position: theta in the middle of the sub-step [rad or m], shape (joint,).
        rate: Its constant rate [rad/s or m/s], shape (joint,).
    """

    position: Float[Array, " joint"]
    rate: Float[Array, " joint"]


class AbstractIntegrator(eqx.Module):
    """A rule for the sub-steps of the robot."""

    @abc.abstractmethod
    def begin(self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]) -> Any:
        """Prepare what the sub-steps of one period share.

        Args:
            robot: The robot.
            terms: Its terms at the start of the period.
            step: Length h of a sub-step [s].

        Returns:
            A tree for `step`.
        """

    @abc.abstractmethod
    def step(
        self,
        robot: Robot,
        begun: Any,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        """Make one sub-step.

        Args:
            robot: The robot.
            begun: What `begin` has prepared.
            state: At the start of the sub-step.
            command: Where the motors should be.
            load: Joint torques of the cutting force, J^T F [N m or N], (joint,).
            step: Length h of a sub-step [s].

        Returns:
            The state at its end.
        """


class _Linearised(eqx.Module):
    """The terms of a period for the midpoint rule: bias, and A^-1 of the module."""

    bias: Float[Array, " joint"]
    inverse: Float[Array, "joint joint"]


class Midpoint(AbstractIntegrator):
    """The linearly implicit midpoint rule, the default.

        (M + h D / 2 + h^2 K / 4) dv
            = h (K (theta - q - h v / 2) + D (thetad - v) - bias + J^T F)

    Order 2 for constant terms, stable at any sub-step: it neither damps nor excites an
    oscillation, and lowers a frequency f by the share (2 pi f h)^2 / 12. The terms are
    those of the start of the period.

    **Differentiability**: smooth.
    """

    def begin(
        self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]
    ) -> _Linearised:
        # symbols: M mass matrix, K stiffness, D damping, h sub-step
        h = step
        M, K, D = terms.mass_matrix, robot.joint_stiffness, robot.joint_damping
        A = M + jnp.diag(h / 2 * D + h**2 / 4 * K)
        # A sub-step costs one product with the inverse; A is small and definite.
        factor = jnp.linalg.cholesky(A)
        eye = jnp.eye(A.shape[0], dtype=A.dtype)
        inverse = jax.scipy.linalg.cho_solve((factor, True), eye)
        return _Linearised(terms.bias_forces, inverse)

    def step(
        self,
        robot: Robot,
        begun: _Linearised,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        h, q, v = step, state.q, state.v
        K, D = robot.joint_stiffness, robot.joint_damping
        stretch = command.position - q - h / 2 * v
        tau = K * stretch + D * (command.rate - v) - begun.bias
        dv = begun.inverse @ (h * (tau + load))
        return ArmState(q + h * (v + dv / 2), v + dv)


class RungeKutta4(AbstractIntegrator):
    """The classical explicit rule of order 4, to verify the default by.

    The full equations of motion are evaluated in each of the four stages, so that a
    sub-step costs as much as a whole period of the default. Stable only where no mode
    reaches the angular frequency 2.8 / h.

    **Differentiability**: smooth.
    """

    def begin(self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]) -> None:
        return None

    def step(
        self,
        robot: Robot,
        begun: None,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        h = step

        def slope(state: ArmState, after: Float[Array, ""]) -> ArmState:
            target = command.position + after * command.rate
            return state_rate(robot, state, MotorCommand(target, command.rate), load)

        def ahead(step: Float[Array, ""], rate: ArmState) -> ArmState:
            return jax.tree.map(lambda x, dx: x + step * dx, state, rate)

        first = slope(state, -h / 2)
        second = slope(ahead(h / 2, first), jnp.zeros_like(h))
        third = slope(ahead(h / 2, second), jnp.zeros_like(h))
        fourth = slope(ahead(h, third), h / 2)
        mean = jax.tree.map(
            lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, first, second, third, fourth
        )
        return ahead(h, mean)


def make_integrator(name: IntegratorName) -> AbstractIntegrator:
    """Return the integrator of a name.

    Args:
        name: "midpoint" or "rk4".

    Returns:
        The integrator.
    """
    return {"midpoint": Midpoint, "rk4": RungeKutta4}[name]()


def state_rate(
    robot: Robot,
    state: ArmState,
    command: MotorCommand,
    load: Float[Array, " joint"],
) -> ArmState:
    """Return the rate of the state by the equations of motion.

        q' = v,   M(q) v' = K (theta - q) + D (thetad - v) - C - G + load

    Args:
        robot: The robot.
        state: The state.
        command: theta and its rate at this instant.
        load: Joint torques from outside [N m or N], shape (joint,).

    Returns:
        q' and v' in the places of q and v.

    **Differentiability**: smooth.
    """
    terms = arm_terms(robot, state.q, state.v)
    K, D = robot.joint_stiffness, robot.joint_damping
    tau = K * (command.position - state.q) + D * (command.rate - state.v)
    factor = jnp.linalg.cholesky(terms.mass_matrix)
    push = tau - terms.bias_forces + load
    return ArmState(state.v, jax.scipy.linalg.cho_solve((factor, True), push))
