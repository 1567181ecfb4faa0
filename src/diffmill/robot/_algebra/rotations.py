"""Rotations: roll-pitch-yaw and back, and the vector between two orientations."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike

# 4 cos^2(angle / 2) below which a rotation counts as half a turn.
_FLOOR = 1e-3
# Angle below which a rotation is taken by its series [rad]; off by less than rounding.
_SMALL_ANGLE = 1e-3


def rpy_matrix(
    roll: RealScalarLike, pitch: RealScalarLike, yaw: RealScalarLike
) -> Float[np.ndarray, "3 3"]:
    """R = Rz(yaw) Ry(pitch) Rx(roll), on the host.

    Args:
        roll: About x [rad].
        pitch: About y [rad].
        yaw: About z [rad].

    Returns:
        Rotation matrix, shape (3, 3).

    **Differentiability**: none; it describes a model and runs before tracing.
    """
    c_r, c_p, c_y = np.cos([float(roll), float(pitch), float(yaw)])
    s_r, s_p, s_y = np.sin([float(roll), float(pitch), float(yaw)])
    return np.array(
        [
            [c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r],
            [s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r],
            [-s_p, c_p * s_r, c_p * c_r],
        ]
    )


def rotation_matrix(vector: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """R of a rotation vector, by Rodrigues' formula.

    Args:
        vector: Axis times angle [rad], shape (3,).

    Returns:
        Rotation matrix, shape (3, 3).

    **Differentiability**: smooth, at zero too.
    """
    square = jnp.sum(vector**2)
    is_small = square < _SMALL_ANGLE**2
    safe = jnp.where(is_small, 1.0, square)
    angle = jnp.sqrt(safe)
    sine = jnp.where(is_small, 1 - square / 6, jnp.sin(angle) / angle)
    cosine = jnp.where(is_small, 0.5 - square / 24, (1 - jnp.cos(angle)) / safe)
    x, y, z = vector
    zero = jnp.zeros_like(x)
    K = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return jnp.eye(3, dtype=K.dtype) + sine * K + cosine * K @ K


def rotation_between(
    target: Float[Array, "3 3"], actual: Float[Array, "3 3"]
) -> Float[Array, " 3"]:
    """Vector 2 sin(angle / 2) axis that turns `actual` into `target`.

    It is the rotation vector to third order, its derivative at 0 is exact, and its
    length is right up to half a turn, where a logarithm is not unique.

    **Differentiability**: smooth below half a turn, where the axis turns round; finite
    everywhere.
    """
    turn = target @ actual.T
    sine = jnp.stack(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    # trace = 1 + 2 cos(angle) = 4 cos^2(angle / 2) - 1; the floor keeps half a turn
    # finite.
    trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
    half_cosine = 0.5 * jnp.sqrt(jnp.maximum(1.0 + trace, _FLOOR))
    # There the sine vanishes, but the symmetric part still has the axis: it holds
    # 2 sin^2(angle / 2) axis axis^T, of which the largest column is taken.
    is_half_turn = 1.0 + trace < _FLOOR
    outer = 0.5 * (turn + turn.T + (1.0 - trace) * jnp.eye(3, dtype=turn.dtype))
    column, size = outer[0], outer[0, 0]
    for i in (1, 2):
        is_larger = outer[i, i] > size
        column = jnp.where(is_larger, outer[i], column)
        size = jnp.where(is_larger, outer[i, i], size)
    size = jnp.where(jnp.sum(column * sine) < 0.0, -1.0, 1.0) * jnp.sqrt(
        jnp.where(is_half_turn, 0.5 * size, 1.0)
    )
    return jnp.where(is_half_turn, column / size, 0.5 * sine / half_cosine)
