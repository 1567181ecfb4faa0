"""Torques by which errors of drives and links act on the joints of a run."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import RealScalarLike
from ...robot import Robot, gravity_forces


def drive_torques(
    at: Callable[[Array], Job],
    zero: Float[Array, " parameter"],
    joints: Float[Array, "step joint"],
    motors: Float[Array, "step joint"],
    time_step: RealScalarLike,
) -> Float[Array, "step joint parameter"]:
    """Slopes of the torques of drives and weight on the joints in parameters.

    A parameter of a drive acts as a torque along the path, which follows from where
    joints and motors are: one linear system of the run carries any number of them.

    Args:
        at: Job on the machine of some parameters, which has a robot; traceable.
        zero: Parameters of the run, shape (parameter,).
        joints: Where the joints are [rad or m], shape (step, joint).
        motors: Where the motors are, behind the controller [rad or m], shape (step,
            joint).
        time_step: Time between two rows [s].

    Returns:
        Slopes [N m or N], shape (step, joint, parameter).

    **Differentiability**: none is meant.
    """
    of = lambda rows: jnp.asarray(jnp.gradient(rows, time_step, axis=0))
    v, rate = of(joints), of(motors)

    def torque(change: Array) -> Float[Array, "step joint"]:
        robot = at(change).robot
        assert robot is not None
        gear = jax.vmap(lambda x, rate: robot.gear_torque(x, rate).torque)
        weight = jax.vmap(lambda q: gravity_forces(robot, q))(joints)
        brake = _friction(robot, joints, v)
        return gear(motors - joints, rate - v) - brake - weight

    return jax.jacfwd(torque)(zero)


def _friction(
    robot: Robot, joints: Float[Array, "step joint"], v: Float[Array, "step joint"]
) -> Float[Array, "step joint"]:
    """Torque of friction along a path [N m or N].

    A joint that sticks keeps the bristles with which it has stopped.
    """
    law = robot.friction
    if law is None or law.presliding is None:
        return jax.vmap(robot.friction_torque)(v)
    first = law.steady_bristles(v[0])
    assert first is not None

    def moved(z: Array, way: Array) -> tuple[Array, Array]:
        z = law.moved_bristles(z, way)
        return z, z

    _, z = jax.lax.scan(moved, first, jnp.diff(joints, axis=0))
    z = jnp.concatenate([first[None], z])
    return law.bristle_stiffness()[None] * z + law.viscous[None] * v
