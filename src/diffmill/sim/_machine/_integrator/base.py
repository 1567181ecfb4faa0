"""The robot between two sub-steps: its state, its rate, and who takes the step.

All integrators share one interface: `begin` takes the robot's terms in the middle of
a tooth period and prepares what the sub-steps share, `step` makes one sub-step. The
force of the teeth comes in as joint torques that are held over the sub-step: between
two looks at the chip nothing more is known of it.
"""

import abc
from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ....robot import (
    ArmTerms,
    Robot,
    forward_dynamics,
)

# Algorithm of the arm's dynamics: mass matrix, or articulated bodies.
Dynamics: TypeAlias = Literal["crba", "aba"]


class ArmState(eqx.Module):
    """State of the robot between sub-steps.

    Attributes:
        q: Joint positions [rad or m], shape (joint,).
        v: Joint velocities [rad/s or m/s], shape (joint,).
        theta: Positions of motors that have a mass [rad or m], shape (joint,); None
            where they stand as the controller says.
        omega: Their velocities [rad/s or m/s], shape (joint,), or None.
        bristles: z of joints that stick [rad or m], shape (joint,); None for friction
            without any.
    """

    q: Float[Array, " joint"]
    v: Float[Array, " joint"]
    theta: Float[Array, " joint"] | None = None
    omega: Float[Array, " joint"] | None = None
    bristles: Float[Array, " joint"] | None = None

    @classmethod
    def steady(
        cls,
        robot: Robot,
        theta: Float[Array, " joint"],
        v: Float[Array, " joint"],
        torque: Float[Array, " joint"] | None = None,
    ) -> "ArmState":
        """Return the arm moving with its motors, balanced with gravity and motion.

        The springs are much stiffer than gravity, so that three steps reach rounding.

        Args:
            robot: The robot.
            theta: Where the controller wants the motors [rad or m], shape (joint,).
            v: How fast they and the joints move [rad/s or m/s], shape (joint,).
            torque: On the joints [N m or N], shape (joint,); None for none.

        Returns:
            The state; motors with a mass are where their servos hold them.

        **Differentiability**: smooth, but where a gear with a gap carries nothing.
        """
        theta = jnp.asarray(theta, robot.dtype)

        def balance(q: Float[Array, " joint"], _: None) -> tuple[Array, Array]:
            tau = ArmTerms.of_state(robot, q, v).bias_forces
            if robot.friction is not None:
                tau = tau + robot.friction_torque(v)
            if torque is not None:
                tau = tau - torque
            return theta - robot.drive_deflection(tau), tau

        # A loop, since each copy of the arm's terms would be compiled for itself.
        q, torques = jax.lax.scan(balance, theta, length=3)
        z = None if robot.friction is None else robot.friction.steady_bristles(v)
        if robot.motors is None:
            return cls(q, v, bristles=z)
        motors = robot.motor_mask()
        held = theta - robot.servo_deflection(torques[-1])
        return cls(q, v, held, jnp.where(motors, v, 0.0), z)


class MotorCommand(eqx.Module):
    """Command to the motors in one sub-step.

    Attributes:
        position: theta at the instant that the caller states [rad or m], shape
            (joint,).
        rate: Its constant rate [rad/s or m/s], shape (joint,).
    """

    position: Float[Array, " joint"]
    rate: Float[Array, " joint"]


class AbstractIntegrator(eqx.Module):
    """A rule for the sub-steps of the robot."""

    @abc.abstractmethod
    def steps_to_middle(self, substeps: int) -> int:
        """Return in how many steps the rule predicts the middle of a period.

        Args:
            substeps: Sub-steps of the period.

        Returns:
            1 for a rule that is stable at any step.
        """

    @abc.abstractmethod
    def begin(self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]) -> PyTree:
        """Prepare what the sub-steps of one period share.

        Args:
            robot: The robot.
            terms: Its terms in the middle of the period.
            step: Length h of a sub-step [s].

        Returns:
            A tree for `step`.
        """

    @abc.abstractmethod
    def step(
        self,
        robot: Robot,
        prepared: PyTree,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        """Make one sub-step.

        Args:
            robot: The robot.
            prepared: What `begin` has prepared.
            state: At the start of the sub-step.
            command: Where the motors should be.
            load: Joint torques of the cutting force, J^T F [N m or N], (joint,).
            step: Length h of a sub-step [s].

        Returns:
            The state at its end.
        """


def servo_torque(
    robot: Robot,
    command: MotorCommand,
    theta: Float[Array, " joint"],
    omega: Float[Array, " joint"],
) -> Float[Array, " joint"]:
    """Torque of the servos on the motors."""
    motors = robot.motors
    assert motors is not None
    away, rate = command.position - theta, command.rate - omega
    return motors.stiffness * away + motors.damping * rate


def state_rate(
    robot: Robot,
    state: ArmState,
    command: MotorCommand,
    load: Float[Array, " joint"],
    dynamics: Dynamics = "crba",
) -> ArmState:
    """Return the rate of the state by the equations of motion.

        q' = v,   M(q) v' = K (theta - q) + D (thetad - v) - C - G + load

    Args:
        robot: The robot; its drive's options count.
        state: The state.
        command: theta and its rate at this instant.
        load: Joint torques from outside [N m or N], shape (joint,).
        dynamics: Algorithm of the accelerations.

    Returns:
        The rates in the places of what they are rates of.

    **Differentiability**: smooth; as the drive's options.
    """
    drive = _drive(robot, state, command)
    acceleration = forward_dynamics(
        robot, state.q, state.v, drive.push + load, algorithm=dynamics
    )
    return ArmState(state.v, acceleration, state.omega, drive.spin, drive.bristles)


def constant_command_rate(
    robot: Robot,
    terms: ArmTerms,
    state: ArmState,
    command: MotorCommand,
    load: Float[Array, " joint"],
) -> ArmState:
    """Return the rate of the state near the joints of some terms, which are held.

    Arguments as for `state_rate`; of the bias, the weight follows q to first order.

    **Differentiability**: smooth; as the drive's options.
    """
    drive = _drive(robot, state, command)
    moved = state.q - terms.joint_positions
    bias = terms.bias_forces + terms.gravity_stiffness @ moved
    acceleration = terms.augmented_inverse() @ (drive.push + load - bias)
    return ArmState(state.v, acceleration, state.omega, drive.spin, drive.bristles)


class _Drive(eqx.Module):
    """Torque of gears and friction on the joints, and rates of the drives' own state.

    Attributes:
        push: [N m or N], shape (joint,).
        spin: Acceleration of motors with a mass [rad/s^2 or m/s^2], or None.
        bristles: Rate of the bristles [rad/s or m/s], or None.
    """

    push: Float[Array, " joint"]
    spin: Float[Array, " joint"] | None
    bristles: Float[Array, " joint"] | None


def _drive(robot: Robot, state: ArmState, command: MotorCommand) -> _Drive:
    """Drives in a state of the arm."""
    theta, omega = command.position, command.rate
    if robot.motors is not None:
        assert state.theta is not None and state.omega is not None
        theta, omega = state.theta, state.omega
    tau = robot.gear_torque(theta - state.q, omega - state.v).torque
    push, bristles = tau, None
    if robot.friction is not None:
        z, v = state.bristles, state.v
        friction, bristles = robot.friction.torque_and_rate(z, v)
        push = tau - friction
    if robot.motors is None:
        return _Drive(push, None, bristles)
    pull = servo_torque(robot, command, theta, omega) - tau
    spin = jnp.where(robot.motor_mask(), pull / robot.motors.inertia, 0.0)
    return _Drive(push, spin, bristles)
