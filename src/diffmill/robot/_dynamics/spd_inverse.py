"""The inverse of a small, positive definite matrix, differentiated as an inverse."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
from jaxtyping import Array, Float

from .._algebra.spatial import sum_rows
from .._model.massless_joints import factor


@jax.custom_jvp
def spd_inverse(
    matrix: Float[Array, "joint joint"],
) -> Float[Array, "joint joint"]:
    """Inverse of a symmetric, positive definite matrix.

    A step that multiplies with it often is cheaper than one that solves. Derivatives
    are two products, not those of a factor and its solutions.

    Args:
        matrix: Such as M + diag(d) [kg m^2], shape (joint, joint).

    Returns:
        The inverse; not a number where the matrix is singular to rounding.
    """
    eye = jnp.eye(matrix.shape[0], dtype=matrix.dtype)
    return jsl.cho_solve((factor(matrix), True), eye)


@spd_inverse.defjvp
def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Array, Array]:
    inverse = spd_inverse(*primals)
    return inverse, -sum_rows(inverse, sum_rows(tangents[0], inverse))
