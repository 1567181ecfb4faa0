"""Accelerations of the joints under given torques."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from .._algebra.spatial import sum_rows
from .._model.robot import JointVector, Robot, Wrench, joint_vector, wrench_vector
from .aba import articulated_bodies, check_algorithm
from .mass_inverse import refuse_singular, spd_inverse
from .rnea import inverse_dynamics
from .rnea_derivatives import rnea_derivatives
from .terms import ArmTerms


def forward_dynamics(
    robot: Robot,
    q: JointVector,
    qd: JointVector,
    tau: JointVector,
    wrench: Wrench | None = None,
    *,
    algorithm: str = "crba",
) -> Float[Array, " joint"]:
    """Joint accelerations: M^-1 (tau + J^T F - C - G).

    Gravity is included; springs and dampers of the drives are not. Derivatives do not
    go through the algorithm: M d(qdd) = d(tau) - d(inverse dynamics) at constant qdd.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
        qd: Joint velocities [rad/s or m/s], shape (joint,).
        tau: Torques that act on the joints [N m or N], shape (joint,).
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,); None for none.
        algorithm: "crba": mass matrix by composite bodies and a Cholesky factor;
            "aba": articulated bodies, for robots without mimic joints. The results
            agree to rounding.

    Returns:
        Accelerations [rad/s^2 or m/s^2], shape (joint,).

    Raises:
        ValueError: If the algorithm is unknown or cannot treat the robot, or if M is
            singular because joints move no mass; under `jit` and `vmap` the
            accelerations are not a number instead.
    """
    check_algorithm(robot, algorithm)
    accelerations = _forward_dynamics(
        algorithm,
        robot,
        joint_vector(robot, q, "q"),
        joint_vector(robot, qd, "qd"),
        joint_vector(robot, tau, "tau"),
        wrench_vector(robot, wrench),
    )
    return refuse_singular(robot, accelerations, "forward dynamics")


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solve(
    algorithm: str,
    robot: Robot,
    q: Float[Array, " joint"],
    qd: Float[Array, " joint"],
    tau: Float[Array, " joint"],
    wrench: Float[Array, " 6"],
) -> Float[Array, " joint"]:
    if algorithm == "aba":
        return articulated_bodies(robot, q, qd, tau, wrench)
    terms = ArmTerms.of_state(robot, q, qd)
    load = tau + terms.jacobian.T @ wrench - terms.bias_forces
    return spd_inverse(terms.mass_matrix) @ load


@functools.partial(_solve.defjvp, symbolic_zeros=True)
def _solve_jvp(
    algorithm: str, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Array, Array]:
    qdd = _solve(algorithm, *primals)
    robot, q, qd, _, wrench = primals
    d_robot, d_q, d_qd, d_tau, d_wrench = tangents
    slopes = rnea_derivatives(robot, q, qd, qdd, wrench)
    times = lambda matrix, vector: sum_rows(matrix, vector[:, None])[:, 0]
    # An argument that does not change has a symbolic zero: nothing is computed for it.
    changes = [
        (d_tau, lambda d: d),
        (d_q, lambda d: -times(slopes.position, d)),
        (d_qd, lambda d: -times(slopes.velocity, d)),
        (d_wrench, lambda d: times(slopes.wrench.T, d)),
    ]
    load = jnp.zeros_like(qdd)
    for tangent, change in changes:
        if not _is_zero(tangent):
            load = load + change(tangent)
    if not all(_is_zero(d) for d in jax.tree.leaves(d_robot)):
        load = load - _change_with_robot(primals, qdd, d_robot)
    return qdd, times(spd_inverse(slopes.acceleration), load)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _change_with_robot(primals: tuple[Any, ...], qdd: Array, d_robot: Any) -> Array:
    """Change of the torques of a motion with the robot [N m], shape (joint,)."""
    robot, q, qd, _, wrench = primals

    # The reverse mode computes the motion again: inside a scan that is faster than
    # storing every step's intermediate values.
    @jax.checkpoint
    def needed(robot: Robot) -> Array:
        return inverse_dynamics(robot, q, qd, qdd, wrench)

    full = jax.tree.map(
        lambda d: jnp.zeros(d.shape, d.dtype) if _is_zero(d) else d, d_robot
    )
    return jax.jvp(needed, (robot,), (full,))[1]


_forward_dynamics = jax.jit(_solve, static_argnums=0)
