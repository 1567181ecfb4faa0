"""Small vector algebra that XLA fuses: no calls of a matrix library for 3 x 3.

A spatial vector has its linear part first. An inertia about a point is a row of 13
numbers (mass; mass times centre; rotational inertia about the point), because rows
of different bodies about the same point simply add.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Cross product of axis i and axis j.
_AXES_CROSSED = np.cross(np.eye(3)[:, None], np.eye(3)[None])


def cross(
    left: Float[Array, "*batch 3"], right: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3"]:
    """Cross product."""
    # One fused sum: of components each is a call, and its derivative two.
    terms = left[..., :, None] * right[..., None, :]
    shape = (1,) * (terms.ndim - 2) + (3, 3, 3)
    crossed = _AXES_CROSSED.reshape(shape).astype(terms.dtype)
    return jnp.sum(terms[..., None] * crossed, axis=(-3, -2))


def matrix_product(
    left: Float[Array, "*batch a b"], right: Float[Array, "*batch b c"]
) -> Float[Array, "*batch a c"]:
    """Product of small matrices as a fusible sum."""
    return jnp.sum(left[..., :, :, None] * right[..., None, :, :], axis=-2)


def apply_matrix(
    matrix: Float[Array, "*batch a b"], vector: Float[Array, "*batch b"]
) -> Float[Array, "*batch a"]:
    """Product of a small matrix and a vector as a fusible sum."""
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def sum_rows(
    selection: Float[Array, "out row"], rows: Float[Array, "row column"]
) -> Float[Array, "out column"]:
    """Add up selected rows; full precision, as a GPU would round to TF32."""
    return jnp.matmul(selection, rows, precision="highest")


def inertia_rows(
    masses: Float[Array, " joint"],
    centers: Float[Array, "joint 3"],
    inertias: Float[Array, "joint 3 3"],
) -> Float[Array, "joint 13"]:
    """Inertias about the origin from those about the centres of mass.

    Args:
        masses: [kg], shape (joint,).
        centers: Centres of mass [m], shape (joint, 3).
        inertias: About the centres [kg m^2], shape (joint, 3, 3).

    Returns:
        Mass [kg], first moment [kg m], inertia about the origin [kg m^2].
    """
    first = masses[:, None] * centers
    squared = jnp.sum(first * centers, axis=-1)
    about_origin = (
        inertias
        + squared[:, None, None] * jnp.eye(3, dtype=masses.dtype)[None]
        - first[:, :, None] * centers[:, None, :]
    )
    flat = about_origin.reshape(masses.shape[0], 9)
    return jnp.concatenate([masses[:, None], first, flat], axis=-1)


def apply_inertia(
    rows: Float[Array, "joint 13"],
    linear: Float[Array, "joint 3"],
    angular: Float[Array, "joint 3"],
) -> tuple[Float[Array, "joint 3"], Float[Array, "joint 3"]]:
    """Inertia times motion: force and moment, or the two momenta."""
    first = rows[:, 1:4]
    about_origin = rows[:, 4:].reshape(rows.shape[0], 3, 3)
    return (
        rows[:, :1] * linear + cross(angular, first),
        apply_matrix(about_origin, angular) + cross(first, linear),
    )
