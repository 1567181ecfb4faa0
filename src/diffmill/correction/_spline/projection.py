"""Bring a command into what the controller can follow: knots and bounds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._types import FloatRows, RealScalarLike
from ...optimise import solve_quadratic_program
from .._limited_quadratic import Bounds, QuadraticNotSolved, feasible_share
from .command_limits import AbstractLimits
from .spline_offsets import SplineOffsets, adjoint_offsets


def project(
    spline: SplineOffsets,
    offset: FloatRows,
    max_offset: RealScalarLike = np.inf,
    *,
    limits: Sequence[AbstractLimits] = (),
) -> Float[np.ndarray, "coefficient axis"]:
    """Return the bounded spline closest to a raw offset in least squares.

    The bound holds for every coefficient, hence for the curve; limits hold exactly.

    Args:
        spline: The basis.
        offset: Offset of a command at every row, shape (step, axis).
        max_offset: Largest magnitude of a coefficient.
        limits: Limits of the command, see `command_limits`.

    Returns:
        Coefficients, shape (coefficient, axis).

    Raises:
        QuadraticNotSolved: The quadratic program could not be solved.

    **Differentiability**: runs on the host, not traceable.
    """
    from scipy import sparse

    offset = np.asarray(offset, np.float64)
    bound = float(max_offset)
    fitted = spline.fit(offset)
    is_within = feasible_share(fitted, limits) >= 1
    if is_within and np.all(np.abs(fitted) <= bound):
        return fitted
    gradient = -adjoint_offsets(spline, offset)
    axes = gradient.shape[1]
    box = np.full(gradient.shape, bound)
    kinds = [Bounds.of_box(-box, box)]
    kinds += [Bounds.hard(limit.lower, limit.upper) for limit in limits]
    found = solve_quadratic_program(
        sparse.kron(_symmetric(spline.normal_band()), sparse.eye_array(axes)),
        gradient.reshape(-1),
        sparse.vstack(
            [sparse.eye_array(box.size), *(limit.flat(axes) for limit in limits)]
        ),
        np.concatenate([kind.lower for kind in kinds]),
        np.concatenate([kind.upper for kind in kinds]),
    )
    if found is None:
        raise QuadraticNotSolved(
            "The command could not be brought within its limits: the quadratic program "
            "has no solution to working precision."
        )
    p = np.clip(found.x.reshape(gradient.shape), -bound, bound)
    values = [limit.apply(p).reshape(-1) for limit in limits]
    room = [kind.share(rows) for kind, rows in zip(kinds[1:], values, strict=True)]
    return min([1.0, *room]) * p


def clip_offset(
    nominal: FloatRows,
    command: FloatRows,
    max_offset: RealScalarLike,
) -> Float[np.ndarray, "step axis"]:
    """Return a command with every offset cut at the bound, row by row.

    Args:
        nominal: The uncorrected command, shape (step, axis).
        command: The command, shape (step, axis).
        max_offset: Largest magnitude of the offset per axis.

    Returns:
        The command, within the bound.

    **Differentiability**: runs on the host, not traceable.
    """
    nominal = np.asarray(nominal, np.float64)
    offset = np.asarray(command, np.float64) - nominal
    return nominal + np.clip(offset, -float(max_offset), float(max_offset))


def _symmetric(band: Float[np.ndarray, "4 coefficient"]) -> Any:
    """Return the symmetric matrix of an upper band, sparse."""
    from scipy import sparse

    count = band.shape[1]
    above = [band[3 - k] for k in range(4)]
    # Both triangles are stored by columns.
    below = [np.roll(band[3 - k], -k) for k in range(1, 4)]
    places = [0, 1, 2, 3, -1, -2, -3]
    return sparse.dia_array((np.stack(above + below), places), shape=(count, count))
