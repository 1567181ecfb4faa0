"""Derivatives of the inverse dynamics with respect to the motion, in closed form.

The derivatives of recursive Newton-Euler of Singh, Russell, Wensing, Efficient
Analytical Derivatives of Rigid-Body Dynamics using Spatial Vector Algebra, IEEE
Robotics and Automation Letters 7, 2022, for joints of one degree of freedom.
Everything is in base axes about the tool's origin, linear parts first: the inertias,
momenta and forces of all bodies that a joint carries are then sums.

Of the four blocks of a rigid body's matrix B of Coriolis terms two are zero. With
linear momentum p, angular momentum L and inertia [m, -h x; h x, J],

    2 B = [0, -2 p x; 0, N],   N = w x J - J w x - (v x h x + h x v x) - L x,

so that it adds up over bodies like p and N.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import as_scalar_code, materialise
from .._algebra.scalars import (
    Matrix,
    Vector,
    add,
    add_matrices,
    apply,
    cross,
    dot,
    numbers,
    product,
    scale,
    symmetric,
    transpose,
)
from .._kinematics.forward import jacobian
from .._model.mimic import fold, unfold_positions, unfold_rates
from .._model.robot import Robot
from .crba import mass_matrix
from .link_frames import base_acceleration, link_frames, tool_origin
from .rnea import inverse_dynamics


class RneaDerivatives(eqx.Module):
    """The torques M qdd + C + G - J^T F to first order.

    Attributes:
        acceleration: M, by qdd [kg m^2], shape (joint, joint).
        position: By q [N m/rad], shape (joint, joint).
        velocity: By qd [N m s/rad], shape (joint, joint).
        wrench: J, by -F transposed [m/rad or -], shape (6, joint).
    """

    acceleration: Float[Array, "joint joint"]
    position: Float[Array, "joint joint"]
    velocity: Float[Array, "joint joint"]
    wrench: Float[Array, "6 joint"]


class _Carried(NamedTuple):
    """Composite of bodies: inertia, its Coriolis terms, and force."""

    m: Array
    h: Vector
    J: Matrix
    p: Vector
    N: Matrix
    force: Vector


@jax.custom_jvp
def _derivatives(
    robot: Robot,
    q: Float[Array, " joint"],
    qd: Float[Array, " joint"],
    qdd: Float[Array, " joint"],
    wrench: Float[Array, " 6"],
) -> RneaDerivatives:
    """Derivatives of `inverse_dynamics` by the motion, and by the wrench.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
        qd: Joint velocities [rad/s or m/s], shape (joint,).
        qdd: Joint accelerations [rad/s^2 or m/s^2], shape (joint,).
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,).
    """
    n = robot.body_count
    rows = _of_bodies(
        robot,
        unfold_positions(robot, q),
        unfold_rates(robot, qd),
        unfold_rates(robot, qdd),
        wrench,
    )
    square = lambda k: fold(robot, fold(robot, rows[k * n : (k + 1) * n]).T).T
    J = fold(robot, rows[3 * n :].T).T
    return RneaDerivatives(square(0), square(1), square(2), J)


@_derivatives.defjvp
def _derivatives_jvp(
    primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[RneaDerivatives, RneaDerivatives]:
    # Second derivatives are rare: those of the recursion itself.
    def slopes(
        robot: Robot, q: Array, qd: Array, qdd: Array, wrench: Array
    ) -> RneaDerivatives:
        by_q, by_qd = jax.jacfwd(inverse_dynamics, (1, 2))(robot, q, qd, qdd, wrench)
        return RneaDerivatives(mass_matrix(robot, q), by_q, by_qd, jacobian(robot, q))

    _, change = jax.jvp(slopes, primals, tangents)
    return _derivatives(*primals), change


def _spatial(turn: Vector, motion: Vector) -> Vector:
    """Spatial cross product twist x motion."""
    v, w = turn[:3], turn[3:]
    return add(cross(w, motion[:3]), cross(v, motion[3:])) + cross(w, motion[3:])


def _spatial_force(turn: Vector, force: Vector) -> Vector:
    """Spatial cross product twist x* force."""
    v, w = turn[:3], turn[3:]
    return cross(w, force[:3]) + add(cross(w, force[3:]), cross(v, force[:3]))


def _inertia_times(body: _Carried, motion: Vector) -> Vector:
    """Inertia times a motion: momentum, or force."""
    v, w = motion[:3], motion[3:]
    force = add(scale(body.m, v), cross(w, body.h))
    return force + add(apply(body.J, w), cross(body.h, v))


def _coriolis_times(body: _Carried, motion: Vector) -> Vector:
    """Coriolis matrix 2 B times a motion."""
    w = motion[3:]
    return scale(-2.0 * jnp.ones_like(body.m), cross(body.p, w)) + apply(body.N, w)


def _base_frames(robot: Robot, q: Vector) -> tuple[list[Matrix], list[Vector], Vector]:
    """Axes and origins of the links in the base, and the tool's origin [m]."""
    rotations: list[Matrix] = []
    positions: list[Vector] = []
    for frame, parent in zip(link_frames(robot, q), robot.parents, strict=True):
        R, p = frame
        if parent >= 0:
            turn = rotations[parent]
            p = add(positions[parent], apply(turn, p))
            R, p = materialise((product(turn, R), p))
        rotations.append(R)
        positions.append(p)
    tool = tool_origin(robot)
    if robot.flange_joint >= 0:
        turned = apply(rotations[robot.flange_joint], tool)
        tool = add(positions[robot.flange_joint], turned)
    return rotations, positions, materialise(tool)


def _body(
    robot: Robot, i: int, R: Matrix, offset: Vector, V: Vector, A: Vector
) -> _Carried:
    """Inertia of a body about the tool, and the velocity terms of its motion."""
    m = robot.link_masses[i]
    center = add(offset, apply(R, numbers(robot.link_centers[i], 1)))
    h = scale(m, center)
    turned = product(R, numbers(robot.link_inertias[i], 2))
    h_c, zero = dot(h, center), jnp.zeros_like(m)
    J = symmetric(
        lambda i, j: dot(turned[i], R[j]) - h[i] * center[j] + (h_c if i == j else zero)
    )
    h, J = materialise((h, J))
    none = ((zero,) * 3,) * 3
    body = _Carried(m, h, J, (zero,) * 3, none, (zero,) * 6)
    v, w = V[:3], V[3:]
    momentum = materialise(_inertia_times(body, V))
    L = momentum[3:]
    # symbols: W is w x J, row by row of its transpose
    W = tuple(cross(w, column) for column in J)
    v_h = dot(v, h)
    K = symmetric(
        lambda i, j: (
            W[i][j]
            + W[j][i]
            - h[i] * v[j]
            - v[i] * h[j]
            + (2.0 * v_h if i == j else zero)
        )
    )
    minus_L = ((zero, L[2], -L[1]), (-L[2], zero, L[0]), (L[1], -L[0], zero))
    N = add_matrices(K, minus_L)
    force = add(_inertia_times(body, A), _spatial_force(V, momentum))
    return materialise(_Carried(m, h, J, momentum[:3], N, force))


def _walk(
    robot: Robot, q: Vector, qd: Vector, qdd: Vector
) -> tuple[list[tuple[Vector, Vector, Vector]], list[_Carried]]:
    """Screws of the joints with two rates each, and all bodies, from the base outwards.

    The first and second rate of a screw are those that its parent's motion causes.
    """
    rotations, positions, tool = _base_frames(robot, q)
    zero = jnp.zeros_like(q[0])
    lift = base_acceleration(robot, zero)
    velocities: list[Vector] = []
    accelerations: list[Vector] = []
    joints, bodies, slides = [], [], robot.prismatic_mask()
    for i, parent in enumerate(robot.parents):
        offset = tuple(a - b for a, b in zip(positions[i], tool, strict=True))
        z = tuple(row[2] for row in rotations[i])
        S = z + (zero,) * 3 if slides[i] else cross(offset, z) + z
        offset, S = materialise((offset, S))
        V = velocities[parent] if parent >= 0 else (zero,) * 6
        A = accelerations[parent] if parent >= 0 else lift
        rate = materialise(_spatial(V, S))
        second = materialise(add(_spatial(A, S), _spatial(V, rate)))
        A = add(A, scale(qdd[i], S), scale(qd[i], rate))
        V, A = materialise((add(V, scale(qd[i], S)), A))
        velocities.append(V)
        accelerations.append(A)
        joints.append((S, rate, second))
        bodies.append(_body(robot, i, rotations[i], offset, V, A))
    return joints, bodies


def _carried(robot: Robot, bodies: list[_Carried]) -> list[_Carried]:
    """Sums over all bodies that each joint carries."""
    sums = list(bodies)
    for i in reversed(range(robot.body_count)):
        parent = robot.parents[i]
        if parent >= 0:
            sums[parent] = materialise(jax.tree.map(jnp.add, sums[parent], sums[i]))
    return sums


def _table(rows: list[Vector], like: Array) -> Float[Array, "entry body ..."]:
    """Vectors as columns, one per body, also where a batch shares them."""
    full = lambda entries: [jnp.broadcast_to(x, like.shape) for x in entries]
    return jnp.stack([jnp.stack(full(x)) for x in transpose(tuple(rows))])


def _pairs(
    left: Float[Array, "entry body ..."], right: Float[Array, "entry body ..."]
) -> Float[Array, "body body ..."]:
    """Scalar products of every column on the left with every one on the right."""
    return dot(tuple(x[:, None] for x in left), tuple(x[None, :] for x in right))


def _stacked(
    robot: Robot,
    q: Float[Array, "body ..."],
    qd: Float[Array, "body ..."],
    qdd: Float[Array, "body ..."],
    wrench: Float[Array, "6 ..."],
) -> Float[Array, "row body ..."]:
    """M, dtau/dq, dtau/dqd and J of the bodies, one above the other."""
    joints, bodies = _walk(robot, numbers(q, 1), numbers(qd, 1), numbers(qdd, 1))
    columns: list[tuple[Vector, ...]] = []
    for (S, rate, second), body in zip(joints, _carried(robot, bodies), strict=True):
        momentum = materialise(_inertia_times(body, S))
        # symbols: 2 B^T S has an angular part alone
        swirl = add(cross(body.p, S[:3]), cross(body.p, S[:3]))
        swirl = add(swirl, apply(transpose(body.N), S[3:]))
        by_q = add(
            _coriolis_times(body, rate),
            _inertia_times(body, second),
            _spatial_force(S, body.force),
        )
        by_qd = _inertia_times(body, rate)
        by_qd = add(_coriolis_times(body, S), by_qd, by_qd)
        columns.append(materialise((S, rate, second, momentum, swirl, by_q, by_qd)))
    S, rate, second, momentum, swirl, by_q, by_qd = (
        _table(list(rows), q[0]) for rows in zip(*columns, strict=True)
    )
    # Row i, column j: `below` where joint j carries joint i, or is it; `above` where i
    # carries j and is another one.
    shape = (robot.body_count,) * 2 + (1,) * (q.ndim - 1)
    below = _carries(robot).reshape(shape)
    above = (_carries(robot).T & ~np.eye(robot.body_count, dtype=bool)).reshape(shape)
    choose = lambda low, high: jnp.where(below, low, jnp.where(above, high, 0.0))
    M = _pairs(momentum, S)
    P = choose(_pairs(momentum, second) + _pairs(swirl, rate[3:]), _pairs(S, by_q))
    Q = choose(_pairs(momentum, rate + rate) + _pairs(swirl, S[3:]), _pairs(S, by_qd))
    M, P, Q = materialise((choose(M, jnp.swapaxes(M, 0, 1)), P, Q))
    moves = robot.tool_mask().reshape(1, -1, *[1] * (q.ndim - 1))
    J = jnp.where(moves, S, 0.0)
    return jnp.concatenate([M, P - _by_wrench(J, wrench, above), Q, J])


def _carries(robot: Robot) -> np.ndarray:
    """True in row i, column j if body i is carried by the joint of body j, or on it."""
    carries = np.eye(robot.body_count, dtype=bool)
    for i, parent in enumerate(robot.parents):
        if parent >= 0:
            carries[i] |= carries[parent]
    return carries


def _by_wrench(
    J: Float[Array, "6 body ..."], wrench: Float[Array, "6 ..."], above: np.ndarray
) -> Float[Array, "body body ..."]:
    """Slope of J^T F: the wrench keeps its axes, and moves with the tool."""
    v, w = numbers(J[:3], 1), numbers(J[3:], 1)
    # A wrench is the same for all bodies.
    f, n = (
        tuple(x[None] for x in numbers(part, 1)) for part in (wrench[:3], wrench[3:])
    )
    outer = jnp.stack(add(cross(v, f), cross(w, n)))
    inner = jnp.stack(cross(v, f))
    inward = jnp.swapaxes(above, 0, 1)
    return jnp.where(inward, _pairs(outer, J[3:]), _pairs(J[3:], inner))


# Arguments robot, the bodies' q, qd and qdd, wrench; no derivatives of its own.
_of_bodies = as_scalar_code(_stacked)
rnea_derivatives = jax.jit(_derivatives)
