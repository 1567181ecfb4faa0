"""The figures by which two corrections are compared."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows, FloatSteps
from .problem import Problem


class Measures(eqx.Module):
    """Headline figures of one command.

    Attributes:
        mean: Mean contour error, by the weights of the rows [m].
        rms: Root mean square contour error, by them too [m].
        p95: 95 % of the rows that have a weight have a smaller contour error [m].
        max: Largest contour error of these rows [m].
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

    def with_weights(
        self, weights: FloatSteps, contour: Float[np.ndarray, "step 3"]
    ) -> "Measures":
        """Return the figures with the errors of other weights.

        Args:
            weights: Weight of every row, shape (step,).
            contour: Contour vectors [m], shape (step, 3).

        Returns:
            The figures; infinite where the contour of a row that counts is not finite.
        """
        counts = np.asarray(weights, np.float64) > 0
        weight = np.asarray(weights, np.float64)[counts]
        error = np.linalg.norm(np.asarray(contour, np.float64)[counts], axis=1)
        figures = (np.inf,) * 4
        if np.all(np.isfinite(error)):
            figures = (
                float(np.average(error, weights=weight)),
                float(np.sqrt(np.average(error**2, weights=weight))),
                float(np.percentile(error, 95)),
                float(error.max()),
            )
        names = ("mean", "rms", "p95", "max")
        return dataclasses.replace(self, **dict(zip(names, figures, strict=True)))


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
    acceleration = np.diff(command, 2, axis=0) / problem.time_step**2
    acceleration = np.linalg.norm(acceleration, axis=1)
    offset = np.abs(command - np.asarray(problem.nominal, np.float64))
    if not np.any(np.asarray(problem.is_cutting) > 0):
        raise ValueError("Argument `is_cutting` must mark a row, but marks none.")
    figures = Measures(
        *(np.inf,) * 4,
        max_acceleration=float(acceleration.max()),
        p95_acceleration=float(np.percentile(acceleration, 95)),
        max_offset=float(offset.max()),
    )
    return figures.with_weights(problem.is_cutting, np.asarray(contour))


def rms_contour(
    problem: Problem,
    contour: Float[Array, "step 3"] | Float[np.ndarray, "step 3"],
) -> float:
    """Return the root mean square contour error, by the weights of the rows.

    Args:
        problem: Tells how much each row counts.
        contour: Contour vectors [m], shape (step, 3).

    Returns:
        The error [m]; infinite where a vector is not finite.

    **Differentiability**: runs on the host, not traceable.
    """
    weights = np.asarray(problem.is_cutting, np.float64)
    square = np.sum(np.asarray(contour, np.float64)[weights > 0] ** 2, axis=1)
    mean = float(np.average(square, weights=weights[weights > 0]))
    return float(np.sqrt(mean)) if np.isfinite(mean) else np.inf
