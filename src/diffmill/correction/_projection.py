"""Bring a command into what the controller can follow: knots and bounds."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._types import RealScalarLike
from ._bspline import SplineOffsets, adjoint_offsets
from ._limited_quadratic import feasible_share, solve_limited_quadratic
from ._limits import AbstractLimits
from ._problem import FloatRows


def project(
    spline: SplineOffsets,
    offset: FloatRows,
    max_offset: RealScalarLike = np.inf,
    *,
    limits: Sequence[AbstractLimits] = (),
    rtol: float = 1e-8,
) -> Float[np.ndarray, "coefficient axis"]:
    """Return the bounded spline closest to a raw offset in least squares.

    The bound holds for every coefficient, hence for the curve; limits hold exactly.

    Args:
        spline: The basis.
        offset: Offset of a command at every row, shape (step, axis).
        max_offset: Largest magnitude of a coefficient.
        limits: Limits of the command, see `command_limits`.
        rtol: Accuracy of the bounded problem, relative.

    Returns:
        Coefficients, shape (coefficient, axis).

    **Differentiability**: runs on the host, not traceable.
    """
    offset = np.asarray(offset, np.float64)
    bound = float(max_offset)
    fitted = spline.fit(offset)
    is_within = feasible_share(fitted, limits) >= 1
    if is_within and np.all(np.abs(fitted) <= bound):
        return fitted
    band = spline.normal_band()
    # With limits from zero, which keeps them.
    start = 0 * fitted if limits else np.clip(fitted, -bound, bound)
    gradient = _banded(band, start) - adjoint_offsets(spline, offset)
    solution = solve_limited_quadratic(
        lambda p: _banded(band, p),
        gradient,
        -bound - start,
        bound - start,
        limits,
        rtol=rtol,
        max_products=3000,
    )
    return np.clip(start + solution.p, -bound, bound)


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


def _banded(
    band: Float[np.ndarray, "4 coefficient"],
    x: Float[np.ndarray, "coefficient axis"],
) -> Float[np.ndarray, "coefficient axis"]:
    """Return the symmetric banded matrix, given by its upper band, times x."""
    total = band[3][:, None] * x
    for k in range(1, 4):
        entries = band[3 - k][k:, None]
        total[:-k] += entries * x[k:]
        total[k:] += entries * x[:-k]
    return total
