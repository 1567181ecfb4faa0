"""The inverse drive: the motor motion that bends the arm onto the desired path.

Where the process force F(t) of the desired path is known, the equation of motion of an
elastic joint can be solved for the motor, exactly and without iteration:

    tau = M(q) q'' + C(q, q') + G(q) - J^T F,   D delta' + K delta = tau,
    theta = q + delta

With a drive's options it stays exact: friction adds to tau; a gap is crossed behind the
spring, theta = q + s^-1(delta); and a motor with a mass wants of its servo

    D_s epsilon' + K_s epsilon = J_m theta'' + tau,   command = theta + epsilon.

It is one shot: it takes the force from the rigid cut, needs a controller that follows
every row, and knows no bounds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import FloatRows3, RealScalarLike, Transform
from ...robot import (
    Robot,
    forward_kinematics,
    gravity_forces,
    inverse_dynamics,
)


class InverseDriveCommand(eqx.Module):
    """Command of the inverse drive.

    Attributes:
        motor_positions: Joint command theta without the gravity sag, which the
            controller adds [rad], shape (step, joint). 0 for virtual joints, which
            have no motor: as joint angles, their deflection is left as it is.
        tip: The same command as tip positions in `work` [m], shape (step, 3): where
            the tip of the rigid robot would be with all joints at q + delta. Virtual
            joints are included, so that the motors make up for their deflection (and
            for their sag, which no controller adds), to first order. The tool axis is
            left as desired.
        deflection: Command - q of every joint, gravity included [rad],
            shape (step, joint).
    """

    motor_positions: Float[Array, "step joint"]
    tip: Float[Array, "step 3"]
    deflection: Float[Array, "step joint"]


def inverse_drive(
    robot: Robot,
    joint_positions: Float[Array, "step joint"],
    force: FloatRows3,
    time_step: RealScalarLike,
    *,
    T_base_work: Transform | None = None,
    is_gravity_compensated: bool = True,
) -> InverseDriveCommand:
    """Motor motion with which the tool follows the desired path.

    Args:
        robot: The robot with its tool, joint stiffness and damping.
        joint_positions: Desired joint angles q at the instants t_k [rad], at rest at
            both ends, shape (step, joint).
        force: Force on the tool in `work`, row k the mean over (t_(k-1), t_k] [N],
            of the process alone on the desired path, shape (step, 3).
        time_step: Time between two rows T [s]; infinite for springs alone.
        T_base_work: Pose of `work` in `base`; None if they coincide.
        is_gravity_compensated: Whether the controller adds the gravity sag itself.

    Returns:
        The command, as joint angles and as tip positions.

    **Differentiability**: smooth in positions, force, stiffness and damping.
    """
    T = jnp.eye(4) if T_base_work is None else jnp.asarray(T_base_work)
    rotation, origin = T[:3, :3], T[:3, 3]
    velocities = _velocities(joint_positions, time_step)
    accelerations = _accelerations(joint_positions, time_step)
    force_base = _at_instants(jnp.asarray(force)) @ rotation.T
    wrenches = jnp.concatenate([force_base, jnp.zeros_like(force_base)], axis=1)
    tau = jax.vmap(lambda *row: inverse_dynamics(robot, *row))(
        joint_positions, velocities, accelerations, wrenches
    )
    delta = _drive_deflection(robot, joint_positions, velocities, tau, time_step)
    is_motor = robot.motor_mask()[None]
    commanded = joint_positions + delta
    if is_gravity_compensated:
        sag = jax.vmap(lambda q: gravity_forces(robot, q))(joint_positions)
        sag = jax.vmap(robot.gravity_compensation)(sag)
        commanded = commanded - jnp.where(is_motor, sag, 0.0)
    tips = jax.vmap(lambda q: forward_kinematics(robot, q)[:3, 3])(commanded)
    motors = jnp.where(is_motor, commanded, 0.0)
    return InverseDriveCommand(motors, (tips - origin[None]) @ rotation, delta)


def _drive_deflection(
    robot: Robot,
    joint_positions: Float[Array, "step joint"],
    velocities: Float[Array, "step joint"],
    tau: Float[Array, "step joint"],
    time_step: RealScalarLike,
) -> Float[Array, "step joint"]:
    """Command - q of every joint [rad]: gear, gap, motor and servo in series."""
    if robot.friction is not None:
        tau = tau + jax.vmap(robot.friction_torque)(velocities)
    K, D = jnp.asarray(robot.joint_stiffness), jnp.asarray(robot.joint_damping)
    delta = _spring_deflection(tau, K, D, time_step)
    if robot.backlash is not None:
        delta = jax.vmap(lambda y: robot.backlash_deflection(y))(delta)
    if robot.motors is None:
        return delta
    motors = robot.motors
    spin = _accelerations(joint_positions + delta, time_step)
    pull = motors.inertia[None] * spin + tau
    epsilon = _spring_deflection(pull, motors.stiffness, motors.damping, time_step)
    return delta + jnp.where(robot.motor_mask()[None], epsilon, 0.0)


def _velocities(
    positions: Float[Array, "step joint"], time_step: RealScalarLike
) -> Float[Array, "step joint"]:
    """Central differences [rad/s]; before the first and after the last row at rest."""
    T = jnp.asarray(time_step, positions.dtype)
    padded = jnp.pad(positions, ((1, 1), (0, 0)), mode="edge")
    return (padded[2:] - padded[:-2]) / (2 * T)


def _accelerations(
    positions: Float[Array, "step joint"], time_step: RealScalarLike
) -> Float[Array, "step joint"]:
    """Second differences [rad/s^2]; before the first and after the last row at rest."""
    T = jnp.asarray(time_step, positions.dtype)
    padded = jnp.pad(positions, ((1, 1), (0, 0)), mode="edge")
    return (padded[2:] - 2 * padded[1:-1] + padded[:-2]) / T**2


def _at_instants(means: Float[Array, "step axis"]) -> Float[Array, "step axis"]:
    """Values at the instants t_k from means over the steps, shape (step, axis).

        x(t_k) = (m_k + m_(k+1)) / 2

    Central like the differences of the path, which makes the balance of the springs
    right at the instants to second order. A mean taken for the value at t_k would lag
    by half a step; a reconstruction of fourth order gains only a few per cent on the
    plant of the tests.

    Args:
        means: Row k is the mean over (t_(k-1), t_k], shape (step, axis).

    Returns:
        Values at t_k, shape (step, axis).

    **Differentiability**: linear.
    """
    padded = jnp.pad(means, ((0, 1), (0, 0)), mode="edge")
    return (padded[:-1] + padded[1:]) / 2


def _spring_deflection(
    joint_torques: Float[Array, "step joint"],
    joint_stiffness: Float[Array, " joint"],
    joint_damping: Float[Array, " joint"],
    time_step: RealScalarLike,
) -> Float[Array, "step joint"]:
    """Solve D delta' + K delta = tau exactly for a torque linear between the rows.

        delta(T) = E (delta_0 - tau_0 / K + s D / K^2) + tau_1 / K - s D / K^2,
        E = exp(-K T / D),  s = (tau_1 - tau_0) / T

    Args:
        joint_torques: tau at the instants [N m], shape (step, joint).
        joint_stiffness: K, positive [N m/rad], shape (joint,).
        joint_damping: D, at least 0 [N m s/rad], shape (joint,).
        time_step: Time between two rows T [s].

    Returns:
        Deflections delta [rad], in equilibrium at the first row, shape (step, joint).

    **Differentiability**: smooth for D > 0; at D = 0 the limit tau / K.
    """
    # symbols: K stiffness, D damping, T time step, E decay over a step, s slope
    K, D = joint_stiffness, joint_damping
    T = jnp.asarray(time_step, joint_torques.dtype)
    # An undamped or rigid spring, or a step without end, leaves nothing of the
    # deflection before, and no derivative: exp(-inf) would make that NaN.
    has_decay = (D > 0) & jnp.isfinite(K) & jnp.isfinite(T)
    safe = lambda x: jnp.where(has_decay, x, 1)
    E = jnp.where(has_decay, jnp.exp(-safe(K) * safe(T) / safe(D)), 0)

    static = joint_torques / K[None]
    lag = jnp.diff(joint_torques, axis=0) / T * (D / K / K)[None]
    # What a step adds to the decayed deflection.
    added = static[1:] - lag - E[None] * (static[:-1] - lag)

    def advance(
        delta: Float[Array, " joint"], added: Float[Array, " joint"]
    ) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
        delta = E * delta + added
        return delta, delta

    return jnp.concatenate([static[:1], jax.lax.scan(advance, static[0], added)[1]])
