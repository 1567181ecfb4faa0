"""The figures by which two corrections are compared."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows
from ...toolpath import ContourStatistics
from .problem import Problem


class CommandStatistics(eqx.Module):
    """Acceleration and offset of a command, over all of its rows.

    Attributes:
        max_acceleration: Largest acceleration, its vector's length [unit of the
            command / s^2].
        p95_acceleration: 95 % of the rows have a smaller one.
        max_offset: Largest offset from the nominal command per axis.
    """

    max_acceleration: float
    p95_acceleration: float
    max_offset: float

    @classmethod
    def of(cls, problem: Problem, command: FloatRows) -> "CommandStatistics":
        """Statistics of a command of a problem, on the host.

        Args:
            problem: The problem.
            command: The whole command, shape (step, axis).
        """
        command = np.asarray(command, np.float64)
        acceleration = command_acceleration(command, float(problem.time_step))
        offset = np.abs(command - np.asarray(problem.nominal, np.float64))
        return cls(
            max_acceleration=float(acceleration.max()),
            p95_acceleration=float(np.percentile(acceleration, 95)),
            max_offset=float(offset.max()),
        )


def command_acceleration(
    command: FloatRows, time_step: float
) -> Float[np.ndarray, " inner"]:
    """Acceleration of a command at its inner rows, its vector's length.

    Args:
        command: The command, shape (step, axis).
        time_step: Time between two rows [s].
    """
    change = np.diff(np.asarray(command, np.float64), 2, axis=0)
    return np.linalg.norm(change / time_step**2, axis=1)


def contour_statistics(
    problem: Problem,
    contour: Float[Array, "step 3"] | Float[np.ndarray, "step 3"],
) -> ContourStatistics:
    """Statistics of the contour error, by the weights of the problem's rows.

    Args:
        problem: The problem, whose weights count.
        contour: Contour vectors [m], shape (step, 3).

    Returns:
        The statistics; NaN where a vector is not finite.

    **Differentiability**: runs on the host, not traceable.
    """
    length = np.linalg.norm(np.asarray(contour, np.float64), axis=1)
    return ContourStatistics.of(length, problem.is_cutting)
