"""The linearly implicit midpoint rule for an arm on its drives."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....robot import (
    ArmTerms,
    Robot,
)
from .base import AbstractIntegrator, ArmState, Dynamics, MotorCommand, servo_torque

# A joint's friction, which depends on whether it stops, is found in so many steps.
_BRAKE_STEPS = 3


class _Linearised(eqx.Module):
    """The terms of a period: bias, A^-1, and M where A changes by the sub-step.

    Attributes:
        implicitness: Share of the sub-step at which forces act: 1/2 for the midpoint
            rule, 1 for backward Euler; may differ by joint.
        terms: Those of the arm; gravity in the bias changes with q.
        inverse: A^-1, or None where A changes by the sub-step.
    """

    implicitness: Float[Array, " joint"] | float
    terms: ArmTerms
    inverse: Float[Array, "joint joint"] | None

    def bias(self, q: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Bias forces C + G near the joints of the terms, G to first order."""
        moved = q - self.terms.joint_positions
        return self.terms.bias_forces + self.terms.gravity_stiffness @ moved


class Midpoint(AbstractIntegrator):
    """The linearly implicit midpoint rule, the default.

        (M + h D / 2 + h^2 K / 4) dv
            = h (K (theta - q - h v / 2) + D (thetad - v) - bias + J^T F)

    Order 2 for constant terms, stable at any sub-step: it neither damps nor excites an
    oscillation, and lowers a frequency f by the share (2 pi f h)^2 / 12. The terms are
    those that `begin` is given; of the bias, gravity follows q to first order.

    Gears with a gap take their slopes where the sub-step begins to act, half of it
    ahead. Motors with a mass are eliminated: their part of the matrix is diagonal.
    Coulomb friction brakes as fast as the joint moves at the end of the sub-step, so
    that it stops a joint and never turns it round; of order 1 where it does. Bristles
    of a joint that sticks are a spring more; where they reach their end on the way,
    their mean push counts.

    Fast joints (a bending tool) go over to backward Euler where a sub-step is too long
    for their mode: they follow the force at once instead of ringing.

    Attributes:
        dynamics: How A^-1 is found: "crba" from the mass matrix, "aba" by articulated
            bodies, which takes no gap and no friction.

    **Differentiability**: smooth; as the drive's options.
    """

    dynamics: Dynamics = eqx.field(static=True, default="crba")

    def steps_to_middle(self, substeps: int) -> int:
        return 1

    def begin(
        self, robot: Robot, terms: ArmTerms, step: Float[Array, ""]
    ) -> _Linearised:
        M = terms.mass_matrix
        w = _implicitness(robot, M, step)
        if robot.backlash is not None or robot.friction is not None:
            if self.dynamics == "aba":
                raise ValueError(
                    'Argument `dynamics` must be "crba" for a robot with backlash or '
                    'friction, whose matrix changes by the sub-step, but is "aba".'
                )
            return _Linearised(w, terms, None)
        K, D = robot.joint_stiffness, robot.joint_damping
        diagonal = _condensed(robot, K, D, w * step).diagonal
        if self.dynamics == "aba":
            q = terms.joint_positions
            inverse = ArmTerms.articulated_inverse(robot, q, diagonal)
            return _Linearised(w, terms, inverse)
        return _Linearised(w, terms, terms.augmented_inverse(diagonal))

    def step(
        self,
        robot: Robot,
        prepared: _Linearised,
        state: ArmState,
        command: MotorCommand,
        load: Float[Array, " joint"],
        step: Float[Array, ""],
    ) -> ArmState:
        # symbols: s from the start of the sub-step to where its forces act
        h, q, v, w = step, state.q, state.v, prepared.implicitness
        s = w * h
        theta, omega = command.position, command.rate
        if state.theta is not None and state.omega is not None:
            theta, omega = state.theta + s * state.omega, state.omega
        gear = robot.gear_torque(theta - q - s * v, omega - v)
        tau = gear.torque - prepared.bias(q + s * v)
        push = h * (tau + load)
        drive = _condensed(robot, gear.stiffness, gear.damping, s)
        pull = jnp.zeros_like(v)
        if robot.motors is not None:
            pull = h * (servo_torque(robot, command, theta, omega) - gear.torque)
            push = push + drive.share * pull
        if prepared.inverse is not None:
            dv = prepared.inverse @ push
        else:
            inverse = lambda d: prepared.terms.augmented_inverse(drive.diagonal + d)
            dv = _braked(robot, inverse, push, state, h, s)
        z = state.bristles
        if z is not None and robot.friction is not None:
            z = robot.friction.moved_bristles(z, h * (v + w * dv))
        q, v = q + h * (v + w * dv), v + dv
        if state.theta is None or state.omega is None:
            return ArmState(q, v, bristles=z)
        domega = drive.weight * pull + drive.share * dv
        theta = state.theta + h * (state.omega + w * domega)
        return ArmState(q, v, theta, state.omega + domega, z)


def _implicitness(
    robot: Robot, M: Float[Array, "joint joint"], step: Float[Array, ""]
) -> Float[Array, " joint"] | float:
    """Return 1/2, and more for fast joints whose own mode a step cannot follow.

    With x = (omega h / 2)^2 it is 1/2 + x^2 / (2 + 2 x^2): backward Euler for modes
    that turn often in a step, and off by the fourth order in h for those that do not.
    """
    if not robot.fast_joints:
        return 0.5
    is_fast = np.zeros(robot.joint_count, bool)
    is_fast[list(robot.fast_joints)] = True
    x = step**2 / 4 * robot.joint_stiffness / jnp.diagonal(M)
    # x^2 / (1 + x^2), finite also for a rigid joint.
    share = 1 / (1 + 1 / jnp.maximum(x, jnp.finfo(x.dtype).eps) ** 2)
    return jnp.where(is_fast, 0.5 + share / 2, 0.5)


class _Condensed(eqx.Module):
    """Terms of the drives in the equations of the joints, motors eliminated.

    Attributes:
        diagonal: g - g^2 / A_m, added to the mass matrix; g alone without motors.
        share: g / A_m of a motor's pull comes through the gear.
        weight: 1 / A_m, by which a motor yields to its pull.
    """

    diagonal: Float[Array, " joint"]
    share: Float[Array, " joint"]
    weight: Float[Array, " joint"]


def _condensed(
    robot: Robot,
    stiffness: Float[Array, " joint"],
    damping: Float[Array, " joint"],
    ahead: Float[Array, ""] | Float[Array, " joint"],
) -> _Condensed:
    """Eliminate the motors, whose part of the matrix is diagonal.

    With g = s D + s^2 K of the gear, s = h / 2 the way to the middle of the sub-step,
    and A_m = J_m + g + g_s of the motor, the equations of both sides are

        (M + g) dv - g domega = push,   A_m domega - g dv = pull,

    and so (M + g - g^2 / A_m) dv = push + g / A_m pull.
    """
    # symbols: K stiffness, D damping
    s, K, D, motors = ahead, stiffness, damping, robot.motors
    g = s * D + s**2 * K
    if motors is None:
        none = jnp.zeros_like(g)
        return _Condensed(g, none, none)
    A_m = motors.inertia + g + s * motors.damping + s**2 * motors.stiffness
    weight = jnp.where(robot.motor_mask(), 1 / A_m, 0.0)
    return _Condensed(g - g**2 * weight, g * weight, weight)


def _braked(
    robot: Robot,
    inverse: Callable[[Float[Array, " joint"]], Float[Array, "joint joint"]],
    push: Float[Array, " joint"],
    state: ArmState,
    h: Float[Array, ""],
    ahead: Float[Array, ""] | Float[Array, " joint"],
) -> Float[Array, " joint"]:
    """Return dv with friction: a few times a brake that acts as it would.

    `inverse` returns (A + diag(d))^-1 of the slopes d of the brakes.
    """
    dv = jnp.zeros_like(state.v)
    if robot.friction is None:
        return inverse(dv) @ push
    for _ in range(_BRAKE_STEPS):
        brake = robot.friction.brake(state.bristles, state.v, dv, h, ahead)
        dv = inverse(brake.slope) @ (push - brake.impulse)
    return dv
