"""Inverse dynamics by recursive Newton-Euler, and torques of gravity.

Featherstone, Rigid Body Dynamics Algorithms, 2008, section 5.3, with all spatial
quantities about one point: both recursions become sums over ancestors and over
descendants.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.spatial import apply_inertia, cross, sum_rows
from .._kinematics.forward import (
    JointFrames,
    joint_frames,
    link_inertia_rows,
    tool_jacobian,
)
from .._model.mimic import fold, unfold_rates
from .._model.robot import JointVector, Robot, Wrench, joint_vector, wrench_vector


def inverse_dynamics(
    robot: Robot,
    q: JointVector,
    qd: JointVector,
    qdd: JointVector,
    wrench: Wrench | None = None,
) -> Float[Array, " joint"]:
    """Joint torques of a motion: M qdd + C + G - J^T F.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
        qd: Joint velocities [rad/s or m/s], shape (joint,).
        qdd: Joint accelerations [rad/s^2 or m/s^2], shape (joint,).
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,); None for none.

    Returns:
        Torques that act on the joints [N m or N], shape (joint,).
    """
    return _inverse_dynamics(
        robot,
        joint_vector(robot, q, "q"),
        joint_vector(robot, qd, "qd"),
        joint_vector(robot, qdd, "qdd"),
        wrench_vector(robot, wrench),
    )


def gravity_forces(robot: Robot, q: JointVector) -> Float[Array, " joint"]:
    """Torques G(q) that hold the robot against gravity.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).

    Returns:
        Torques [N m or N], shape (joint,).
    """
    return _gravity_forces(robot, joint_vector(robot, q, "q"))


@jax.jit
def _inverse_dynamics(
    robot: Robot,
    q: Float[Array, " joint"],
    qd: Float[Array, " joint"],
    qdd: Float[Array, " joint"],
    wrench: Float[Array, " 6"],
) -> Float[Array, " joint"]:
    frames = joint_frames(robot, q)
    inertias = link_inertia_rows(robot, frames)
    tau = newton_euler(robot, frames, inertias, qd, qdd)
    return tau - sum_rows(tool_jacobian(robot, frames).T, wrench[:, None])[:, 0]


@jax.jit
def _gravity_forces(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, " joint"]:
    frames = joint_frames(robot, q)
    return gravity_torques(robot, frames, link_inertia_rows(robot, frames))


def gravity_torques(
    robot: Robot, frames: JointFrames, inertias: Float[Array, "body 13"]
) -> Float[Array, " joint"]:
    """Torques of gravity G from known frames and link inertias [N m or N]."""
    lift = jnp.broadcast_to(-robot.gravity[None], (robot.body_count, 3))
    force = inertias[:, :1] * lift
    moment = cross(inertias[:, 1:4], lift)
    carried = sum_rows(robot.ancestry().T, jnp.concatenate([force, moment], axis=-1))
    tau = jnp.sum(frames.screws * carried, axis=-1)
    return fold(robot, tau[:, None])[:, 0]


def newton_euler(
    robot: Robot,
    frames: JointFrames,
    inertias: Float[Array, "body 13"],
    qd: Float[Array, " joint"],
    qdd: Float[Array, " joint"] | None = None,
) -> Float[Array, " joint"]:
    """Torques M qdd + C + G from known frames and link inertias; None: no M qdd."""
    # symbols: v, w velocity of a link at the tool's origin and its rate of turning
    moves = robot.ancestry()
    S = frames.screws
    S_qd = S * unfold_rates(robot, qd)[:, None]
    twist = sum_rows(moves, S_qd)
    v, w = twist[:, :3], twist[:, 3:]
    s_v, s_w = S_qd[:, :3], S_qd[:, 3:]
    # A screw fixed in a moving link changes at the rate twist x screw; its own
    # joint's part of the twist drops out of the product.
    own = jnp.concatenate([cross(w, s_v) + cross(v, s_w), cross(w, s_w)], axis=-1)
    if qdd is not None:
        own = own + S * unfold_rates(robot, qdd)[:, None]
    acceleration = sum_rows(moves, own)
    p, L = apply_inertia(inertias, v, w)
    # Gravity is an upward acceleration of the base.
    force, moment = apply_inertia(
        inertias, acceleration[:, :3] - robot.gravity[None], acceleration[:, 3:]
    )
    force = force + cross(w, p)
    moment = moment + cross(w, L) + cross(v, p)
    carried = sum_rows(moves.T, jnp.concatenate([force, moment], axis=-1))
    tau = jnp.sum(S * carried, axis=-1)
    return fold(robot, tau[:, None])[:, 0]
