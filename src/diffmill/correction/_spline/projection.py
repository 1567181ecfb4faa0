"""Bring a command into what the controller can follow: knots and bounds."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._types import FloatRows, RealScalarLike
from ...optimise import solve_quadratic_program
from .command_limits import LinearLimits, feasible_share
from .spline_offsets import SplineOffsets, adjoint_offsets

# Limits are drawn in by this share of their largest bound: what the solver cannot tell.
# Where a bound is 0 it may be passed by as much.
_TOLERANCE = 1e-7


class QuadraticNotSolved(ArithmeticError):
    """Raise when a quadratic program could not be solved to working precision."""


def project(
    spline: SplineOffsets,
    offset: FloatRows,
    max_offset: RealScalarLike = np.inf,
    *,
    limits: Sequence[LinearLimits] = (),
) -> Float[np.ndarray, "coefficient axis"]:
    """Return the bounded spline closest to a raw offset in least squares.

    The bound holds for every coefficient, hence for the curve; limits hold exactly.

    Args:
        spline: The basis.
        offset: Offset of a command at every row, shape (step, axis).
        max_offset: Largest magnitude of a coefficient.
        limits: Limits of the command, see `LinearLimits.of_command`.

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
    box = np.full(gradient.size, bound)
    hard = [_moved(limit, _TOLERANCE) for limit in limits]
    least = solve_quadratic_program(
        sparse.csr_array(
            sparse.kron(_symmetric(spline.normal_band()), sparse.eye_array(axes))
        ),
        gradient.reshape(-1),
        sparse.csr_array(
            sparse.vstack([sparse.eye_array(box.size), *(x.matrix for x in limits)])
        ),
        np.concatenate([-box.reshape(-1), *(limit.lower for limit in hard)]),
        np.concatenate([box.reshape(-1), *(limit.upper for limit in hard)]),
    )
    if least is None:
        raise QuadraticNotSolved(
            "The command could not be brought within its limits: the quadratic program "
            "has no solution to working precision."
        )
    p = np.clip(least.reshape(gradient.shape), -bound, bound)
    loose = [_moved(limit, -_TOLERANCE) for limit in limits]
    return min(1.0, feasible_share(p, loose)) * p


def _moved(limit: LinearLimits, share: float) -> LinearLimits:
    """Return a limit drawn in by a share of its largest bound, or let out where 0."""
    ends = np.concatenate([limit.lower, limit.upper])
    slack = share * np.max(np.abs(ends[np.isfinite(ends)]), initial=0.0)
    if slack > 0:
        lower, upper = limit.lower + slack, limit.upper - slack
        lower, upper = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
    else:
        lower, upper = np.minimum(limit.lower, slack), np.maximum(limit.upper, -slack)
    return dataclasses.replace(limit, lower=lower, upper=upper)


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
