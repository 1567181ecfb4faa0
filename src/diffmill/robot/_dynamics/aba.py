"""Forward dynamics by articulated bodies: work that grows with the joints, not cubed.

Featherstone, Rigid Body Dynamics Algorithms, 2008, section 7.3, in the axes of the
links, linear parts first. Joint axes are z, so that a column of the inertia takes the
place of a product. A diagonal may be added to the mass matrix: it adds to the inertia
that a joint feels about its own axis.
"""

from typing import NamedTuple

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
from .._model.robot import Robot
from .link_frames import LinkFrame, base_acceleration, link_frames, tool_origin


class _Inertia(NamedTuple):
    """Force = A v + B w; moment = B^T v + J w, at the link's origin."""

    A: Matrix
    B: Matrix
    J: Matrix


class _Articulated(NamedTuple):
    """Articulated inertia of a joint.

    Attributes:
        U: I s, with the joint's axis s.
        inverse: 1 / (s I s).
        carried: I c without the part of the joint, with the rate of change c of its
            axis; None without a motion.
    """

    U: Vector
    inverse: Array
    carried: Vector | None


class _Motion(NamedTuple):
    """Velocity terms: rates of change c of the joints' axes, and other forces."""

    drift: list[Vector]
    force: list[Vector]


def check_algorithm(robot: Robot, algorithm: str) -> None:
    """Raise if an algorithm is unknown or cannot treat the robot."""
    if algorithm not in ("crba", "aba"):
        raise ValueError(
            f"Argument `algorithm` must be 'crba' or 'aba', but is {algorithm!r}."
        )
    if algorithm == "aba" and robot.has_mimics:
        raise ValueError(
            "Argument `algorithm` must be 'crba' for a robot with mimic joints "
            f"({robot.name!r}), but is 'aba'."
        )


def _axes(robot: Robot) -> list[int]:
    """Index of each body's joint axis in a spatial vector: that of z, or about z."""
    return [2 if slides else 5 for slides in robot.prismatic_mask()]


def _moved(vector: Vector, place: int, by: Array) -> Vector:
    """Vector with one entry increased."""
    return (*vector[:place], vector[place] + by, *vector[place + 1 :])


def _to_link(frame: LinkFrame, motion: Vector) -> Vector:
    """Motion of the parent, at the link's origin in its axes."""
    to_link = transpose(frame.rotation)
    v, w = motion[:3], motion[3:]
    return apply(to_link, add(v, cross(w, frame.position))) + apply(to_link, w)


def _to_parent(frame: LinkFrame, force: Vector) -> Vector:
    """Force on the link, at the parent's origin in its axes."""
    f = apply(frame.rotation, force[:3])
    return f + add(apply(frame.rotation, force[3:]), cross(frame.position, f))


def _inertia_to_parent(frame: LinkFrame, inertia: _Inertia) -> _Inertia:
    """Inertia at the parent's origin in its axes."""
    E, p = frame
    back = transpose(E)
    left = materialise([product(E, block) for block in inertia])
    turn = lambda half: lambda i, j: dot(half[i], E[j])
    A, B, J = materialise(
        (symmetric(turn(left[0])), product(left[1], back), symmetric(turn(left[2])))
    )
    # With the linear motion v' = v - p x w of the link's origin: B' = B - A [p] and
    # J' = J + [p] B - B^T [p] - [p] A [p] = J + [p] B' + ([p] B)^T.
    A_p = transpose(tuple(cross(p, row) for row in A))
    B_new, p_B = materialise(
        (add_matrices(B, transpose(A_p)), tuple(cross(p, c) for c in transpose(B)))
    )
    columns = transpose(B_new)
    J_new = symmetric(lambda i, j: J[i][j] + p_B[i][j] + cross(p, columns[j])[i])
    return _Inertia(A, B_new, J_new)


def _link_inertias(robot: Robot) -> tuple[list[Vector], list[_Inertia]]:
    """Mass times centre of each link, and its inertia at its origin."""
    first: list[Vector] = []
    inertias: list[_Inertia] = []
    masses = numbers(robot.link_masses, 1)
    centers = numbers(robot.link_centers, 2)
    about_center = numbers(robot.link_inertias, 3)
    for m, c, I in zip(masses, centers, about_center, strict=True):
        h = scale(m, c)
        h_c, zero = dot(h, c), jnp.zeros_like(m)
        A = tuple(tuple(m if i == j else zero for j in range(3)) for i in range(3))
        B = ((zero, h[2], -h[1]), (-h[2], zero, h[0]), (h[1], -h[0], zero))
        J = symmetric(
            lambda i, j: I[i][j] - h[i] * c[j] + (h_c if i == j else zero)  # noqa: B023
        )
        first.append(h)
        inertias.append(_Inertia(A, B, J))
    return materialise((first, inertias))


def _motion(
    robot: Robot,
    frames: list[LinkFrame],
    first_moments: list[Vector],
    inertias: list[_Inertia],
    qd: Vector,
) -> _Motion:
    """Velocity terms of a motion."""
    zero, axes = jnp.zeros_like(qd[0]), _axes(robot)
    motions, drift, force = [], [], []
    for i, parent in enumerate(robot.parents):
        h, (A, _, J) = first_moments[i], inertias[i]
        at_rest = (zero,) * 6
        V = _to_link(frames[i], motions[parent]) if parent >= 0 else at_rest
        turned = lambda x: (x[1] * qd[i], -x[0] * qd[i], zero)  # noqa: B023
        v, w = V[:3], V[3:]
        c = turned(w) + (zero,) * 3 if axes[i] == 2 else turned(v) + turned(w)
        V, c = materialise((_moved(V, axes[i], qd[i]), c))
        v, w = V[:3], V[3:]
        # symbols: p momentum, L angular momentum about the link's origin
        p, L = materialise(
            (add(scale(A[0][0], v), cross(w, h)), add(apply(J, w), cross(h, v)))
        )
        motions.append(V)
        drift.append(c)
        force.append(materialise(cross(w, p) + add(cross(w, L), cross(v, p))))
    return _Motion(drift, force)


def _articulated(
    robot: Robot,
    frames: list[LinkFrame],
    inertias: list[_Inertia],
    diagonal: Vector | None,
    drift: list[Vector] | None,
) -> list[_Articulated]:
    """Articulated inertias of the joints: a pass from the tips to the base."""
    inertias, articulated = list(inertias), []
    is_prismatic = robot.prismatic_mask()
    floor = 8 * robot.body_count * float(np.finfo(robot.gravity.dtype).eps)
    for i in reversed(range(robot.body_count)):
        A, B, J = inertias[i]
        slides = is_prismatic[i]
        U = A[2] + B[2] if slides else transpose(B)[2] + J[2]
        felt = (A if slides else J)[2][2]
        # Nothing is left of an inertia but rounding: as `factor` of the mass matrix.
        scale_of = dot(
            (jnp.ones_like(felt),) * 3,
            tuple((A if slides else J)[k][k] for k in range(3)),
        )
        if diagonal is not None:
            felt = felt + diagonal[i]
        felt = jnp.where(felt > floor * scale_of, felt, jnp.nan)
        inverse = materialise(1.0 / felt)
        parent, carried = robot.parents[i], None
        if parent >= 0:
            k = materialise(scale(inverse, U))
            f, n = U[:3], U[3:]
            # The joint's own direction carries nothing.
            A, B, J = remaining = materialise(
                _Inertia(
                    symmetric(lambda i, j: A[i][j] - k[i] * f[j]),  # noqa: B023
                    tuple(add(B[i], scale(-k[i], n)) for i in range(3)),
                    symmetric(lambda i, j: J[i][j] - k[i + 3] * n[j]),  # noqa: B023
                )
            )
            if drift is not None:
                v, w = drift[i][:3], drift[i][3:]
                force = add(apply(A, v), apply(B, w))
                carried = materialise(force + add(apply(transpose(B), v), apply(J, w)))
            moved = _inertia_to_parent(frames[i], remaining)
            pairs = zip(inertias[parent], moved, strict=True)
            inertias[parent] = materialise(
                _Inertia(*(add_matrices(a, b) for a, b in pairs))
            )
        articulated.append(_Articulated(U, inverse, carried))
    return articulated[::-1]


def _accelerations(
    robot: Robot,
    frames: list[LinkFrame],
    joints: list[_Articulated],
    tau: Vector,
    motion: _Motion | None,
    base: Vector,
) -> Vector:
    """Accelerations of the joints under torques and forces on the links."""
    zero = jnp.zeros_like(tau[0])
    force = [(zero,) * 6] * robot.body_count if motion is None else list(motion.force)
    axes = _axes(robot)
    u: list[Array] = [zero] * robot.body_count
    for i in reversed(range(robot.body_count)):
        U, inverse, carried = joints[i]
        u[i] = materialise(inverse * (tau[i] - force[i][axes[i]]))
        parent = robot.parents[i]
        if parent >= 0:
            f = add(force[i], scale(u[i], U))
            f = materialise(f if carried is None else add(f, carried))
            force[parent] = materialise(add(force[parent], _to_parent(frames[i], f)))
    accelerations, motions = [], []
    for i, parent in enumerate(robot.parents):
        a = _to_link(frames[i], motions[parent] if parent >= 0 else base)
        a = materialise(a if motion is None else add(a, motion.drift[i]))
        qdd = materialise(u[i] - joints[i].inverse * dot(joints[i].U, a))
        accelerations.append(qdd)
        motions.append(materialise(_moved(a, axes[i], qdd)))
    return tuple(accelerations)


def _add_wrench(
    robot: Robot, frames: list[LinkFrame], force: list[Vector], wrench: Vector
) -> None:
    """Subtract an external wrench at the tool's origin, in base axes, from `force`."""
    joint = robot.flange_joint
    if joint < 0:
        return
    path = [joint]
    while robot.parents[path[-1]] >= 0:
        path.append(robot.parents[path[-1]])
    f, n = wrench[:3], wrench[3:]
    for i in reversed(path):
        back = transpose(frames[i].rotation)
        f, n = materialise((apply(back, f), apply(back, n)))
    n = add(n, cross(tool_origin(robot), f))
    force[joint] = materialise(
        tuple(a - b for a, b in zip(force[joint], f + n, strict=True))
    )


def _aba(
    robot: Robot,
    q: Float[Array, "joint ..."],
    qd: Float[Array, "joint ..."],
    tau: Float[Array, "joint ..."],
    wrench: Float[Array, "6 ..."],
) -> Float[Array, "joint ..."]:
    frames = link_frames(robot, numbers(q, 1))
    first_moments, inertias = _link_inertias(robot)
    motion = _motion(robot, frames, first_moments, inertias, numbers(qd, 1))
    _add_wrench(robot, frames, motion.force, numbers(wrench, 1))
    joints = _articulated(robot, frames, inertias, None, motion.drift)
    base = base_acceleration(robot, q[0])
    qdd = _accelerations(robot, frames, joints, numbers(tau, 1), motion, base)
    return jnp.stack(qdd)


def _inverse(
    robot: Robot,
    q: Float[Array, "joint ..."],
    diagonal: Float[Array, "joint ..."],
) -> Float[Array, "joint joint ..."]:
    # One more axis of the batch, for the unit torques.
    eye = jnp.eye(robot.joint_count, dtype=q.dtype)
    tau = jnp.broadcast_to(
        eye.reshape(*eye.shape, *[1] * (q.ndim - 1)), (*eye.shape, *q.shape[1:])
    )
    frames = link_frames(robot, numbers(q[:, None], 1))
    _, inertias = _link_inertias(robot)
    joints = _articulated(robot, frames, inertias, numbers(diagonal[:, None], 1), None)
    base = (jnp.zeros_like(tau[0]),) * 6
    return jnp.stack(_accelerations(robot, frames, joints, numbers(tau, 1), None, base))


# Arguments robot, q, qd, tau, wrench; no derivatives of its own.
articulated_bodies = as_scalar_code(_aba)
# Arguments robot, q, diagonal that is added to M; no derivatives of its own.
articulated_inverse = as_scalar_code(_inverse)
