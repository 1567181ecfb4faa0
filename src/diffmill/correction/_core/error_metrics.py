"""The figures by which two corrections are compared."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows
from .problem import Problem


class Measures(eqx.Module):
    """Headline figures of one command; the errors over the rows that cut.

    Attributes:
        mean: Mean contour error [m].
        rms: Root mean square contour error [m].
        p95: 95 % of the rows have a smaller contour error [m].
        max: Largest contour error [m].
        max_acceleration: Largest acceleration of the command, its vector's length,
            over all rows [unit of the command / s^2].
        p95_acceleration: 95 % of all rows have a smaller one.
        max_offset: Largest offset of the command per axis, over all rows.
    """

    mean: float
    rms: float
    p95: float
    max: float
    max_acceleration: float
    p95_acceleration: float
    max_offset: float


def measure(
    problem: Problem,
    command: FloatRows,
    contour: Float[Array, "step 3"] | Float[np.ndarray, "step 3"],
) -> Measures:
    """Return the headline figures of a command and the error it leaves.

    Args:
        problem: The problem.
        command: The whole command, shape (step, axis).
        contour: Contour vectors [m], shape (step, 3).

    Returns:
        The figures; infinite where the contour is not finite.

    **Differentiability**: runs on the host, not traceable.
    """
    command = np.asarray(command, np.float64)
    weights = np.asarray(problem.is_cutting, np.float64)
    error = np.linalg.norm(np.asarray(contour, np.float64), axis=1)
    acceleration = np.diff(command, 2, axis=0) / problem.time_step**2
    acceleration = np.linalg.norm(acceleration, axis=1)
    offset = np.abs(command - np.asarray(problem.nominal, np.float64))
    if not np.any(weights > 0):
        raise ValueError("Argument `is_cutting` must mark a row, but marks none.")
    cut = error[weights > 0]
    if np.all(np.isfinite(cut)):
        figures = (
            float(np.average(error, weights=weights)),
            rms_contour(problem, contour),
            float(np.percentile(cut, 95)),
            float(cut.max()),
        )
    else:
        figures = (np.inf,) * 4
    return Measures(
        *figures,
        max_acceleration=float(acceleration.max()),
        p95_acceleration=float(np.percentile(acceleration, 95)),
        max_offset=float(offset.max()),
    )


def rms_contour(
    problem: Problem,
    contour: Float[Array, "step 3"] | Float[np.ndarray, "step 3"],
) -> float:
    """Return the root mean square contour error over the rows that cut.

    Args:
        problem: Tells which rows cut.
        contour: Contour vectors [m], shape (step, 3).

    Returns:
        The error [m]; infinite where a vector is not finite.

    **Differentiability**: runs on the host, not traceable.
    """
    weights = np.asarray(problem.is_cutting, np.float64)
    square = np.sum(np.asarray(contour, np.float64)[weights > 0] ** 2, axis=1)
    mean = float(np.average(square, weights=weights[weights > 0]))
    return float(np.sqrt(mean)) if np.isfinite(mean) else np.inf
