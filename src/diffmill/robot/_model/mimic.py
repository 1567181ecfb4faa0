"""Joints that follow another joint: from joint vector to bodies and back.

Every body hangs on one joint of its own, but only the independent joints are counted
in q. With G the matrix of the multipliers, the bodies' joints stand at G q plus the
offsets and move with G qd; forces and screws return by G^T, the mass matrix by
G^T M G. Without a follower all of this is absent from the compiled program.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._algebra.spatial import sum_rows
from .robot import Robot


def unfold_positions(robot: Robot, q: Float[Array, " joint"]) -> Float[Array, " body"]:
    """Positions of the joints of all bodies [rad or m]."""
    if not robot.has_mimics:
        return q
    offsets = np.array([0.0 if m is None else m[2] for m in robot.mimics])
    return unfold_rates(robot, q) + jnp.asarray(offsets, q.dtype)


def unfold_rates(robot: Robot, rates: Float[Array, " joint"]) -> Float[Array, " body"]:
    """Velocities of the joints of all bodies [rad/s or m/s]."""
    if not robot.has_mimics:
        return rates
    leaders, multipliers = _leaders(robot)
    return rates[leaders] * jnp.asarray(multipliers, rates.dtype)


def fold(
    robot: Robot, rows: Float[Array, "body column"]
) -> Float[Array, "joint column"]:
    """G^T times a matrix with one row per body."""
    if not robot.has_mimics:
        return rows
    leaders, multipliers = _leaders(robot)
    G = np.zeros((robot.body_count, robot.joint_count))
    G[np.arange(robot.body_count), leaders] = multipliers
    return sum_rows(jnp.asarray(G.T, rows.dtype), rows)


def _leaders(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Index of the joint that moves each body, and its factor, shape (body,) each."""
    leaders, multipliers, own = [], [], 0
    for mimic in robot.mimics:
        if mimic is None:
            leaders.append(own)
            multipliers.append(1.0)
            own += 1
        else:
            leaders.append(mimic[0])
            multipliers.append(mimic[1])
    return np.array(leaders), np.array(multipliers)
