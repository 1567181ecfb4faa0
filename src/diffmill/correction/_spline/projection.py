"""Bring a command into what the controller can follow: knots and bounds."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..._types import FloatRows, RealScalarLike
from ...optimise import solve_quadratic_program
from .command_limits import LinearLimits, feasible_share
from .spline_offsets import SplineOffsets, adjoint_offsets, basis_matrix

# Limits are drawn in by this share of their largest bound, the tolerance of the solver.
# Where a bound is 0 it may be passed by as much.
_LIMIT_TOLERANCE = 1e-7


class QuadraticNotSolved(ArithmeticError):
    """Raise when a quadratic program could not be solved to working precision."""


def project(
    spline: SplineOffsets,
    offset: FloatRows,
    max_offset: RealScalarLike = np.inf,
    *,
    limits: Sequence[LinearLimits] = (),
) -> Float[np.ndarray, "coefficient axis"]:
    """Coefficients of the bounded spline closest to a raw offset in least squares.

    The bound holds for every coefficient, hence for the curve; limits hold exactly.

    Args:
        spline: The basis.
        offset: Offset of a command at every row, shape (step, axis).
        max_offset: Largest magnitude of a coefficient.
        limits: Limits of the command, see `LinearLimits.of_command`.

    Returns:
        Coefficients, shape (coefficient, axis), in the command's unit.

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
    hard = [_drawn_in(limit, _LIMIT_TOLERANCE) for limit in limits]
    # The matrix of the squares, B^T B for each axis.
    basis = basis_matrix(spline)
    least = solve_quadratic_program(
        sparse.csr_array(sparse.kron(basis.T @ basis, sparse.eye_array(axes))),
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
    loose = [_drawn_in(limit, -_LIMIT_TOLERANCE) for limit in limits]
    return min(1.0, feasible_share(p, loose)) * p


def _drawn_in(limit: LinearLimits, share: float) -> LinearLimits:
    """Limit drawn in by a share of its largest bound, or let out where it is 0."""
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
    """Command with every offset cut at the bound, row by row, shape (step, axis).

    Args:
        nominal: The uncorrected command, shape (step, axis).
        command: The command, shape (step, axis).
        max_offset: Largest magnitude of the offset per axis.

    **Differentiability**: runs on the host, not traceable.
    """
    nominal = np.asarray(nominal, np.float64)
    offset = np.asarray(command, np.float64) - nominal
    return nominal + np.clip(offset, -float(max_offset), float(max_offset))
