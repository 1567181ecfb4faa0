"""Problem of a correction: a plant, a path and the bounds."""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows, FloatRows3, RealScalarLike
from ...toolpath import contour_vector

Weights = Float[Array, " step"] | Float[np.ndarray, " step"]


class Motion(eqx.Module):
    """Motion of a plant that follows a command.

    Attributes:
        actual: Tool tip [m], shape (step, 3); of a job, the desired one with the
            deviation at the instant at which the wall is made.
        force: Force on the tool, mean over the step [N], shape (step, 3).
    """

    actual: Float[Array, "step 3"]
    force: Float[Array, "step 3"]


# Maps a command, shape (step, axis), to the motion that follows; traceable. An
# `eqx.Module` is best: its arrays then enter compiled functions as arguments.
Plant = Callable[[Float[Array, "step axis"]], Motion]


class AbstractHostPlant(eqx.Module):
    """A plant that runs a command on the host by a program of its own."""

    @abc.abstractmethod
    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Return the motion that follows a command, shape (step, axis); traceable."""

    @abc.abstractmethod
    def run(self, command: FloatRows) -> Motion:
        """Return the same motion; not traceable."""


class LinearMotion(eqx.Module):
    """A motion and how it changes with the command."""

    motion: eqx.AbstractVar[Motion]

    @abc.abstractmethod
    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Return the changes of the motion, each direction a row of the first axis.

        Args:
            changes: Of the command, shape (step, axis, direction).

        **Differentiability**: linear.
        """


class AbstractLinearPlant(AbstractHostPlant):
    """A plant that knows its linear system, so that no derivative is traced."""

    @abc.abstractmethod
    def linearised(self, command: Float[Array, "step axis"]) -> LinearMotion | None:
        """Return the linear system around a command; None where there is none."""


def _as_leaf(value: RealScalarLike) -> RealScalarLike:
    # A Python number would be static in compiled functions, and a new one compile.
    return value if isinstance(value, jax.Array) else np.asarray(value, np.float64)


class Problem(eqx.Module):
    """A path to correct.

    Attributes:
        plant: The machine with its process, see `Plant`.
        nominal: The uncorrected command: the desired tip positions [m], or joint
            angles [rad], shape (step, axis).
        desired: Where the tool tip should be [m], shape (step, 3).
        is_cutting: Weight of every row in the error: 1 where the tool cuts and 0
            elsewhere, shape (step,).
        time_step: Time between two rows T [s].
        max_offset: Largest offset of the command from `nominal` per axis, in the
            command's unit.
        window: Segments of the desired path to either side of a row among which the
            nearest is sought.
    """

    plant: Callable[..., Any]
    nominal: FloatRows
    desired: FloatRows3
    is_cutting: Weights
    time_step: float = eqx.field(static=True)
    max_offset: RealScalarLike = eqx.field(converter=_as_leaf, default=1e-3)
    window: int = eqx.field(static=True, default=20)

    def __check_init__(self):
        rows = self.nominal.shape[0]
        for name in ("desired", "is_cutting"):
            if getattr(self, name).shape[0] != rows:
                raise ValueError(
                    f"Argument `{name}` must have one row per row of `nominal` "
                    f"({rows}), but has {getattr(self, name).shape[0]}."
                )


@eqx.filter_jit
def contour_of(problem: Problem, motion: Motion) -> Float[Array, "step 3"]:
    """Return the vector from the nearest point of the desired path to the tip.

    Args:
        problem: Tells the desired path.
        motion: The motion.

    Returns:
        Contour vectors [m], shape (step, 3); also where the tool does not cut.

    **Differentiability**: smooth but where the nearest segment changes.
    """
    desired = jnp.asarray(problem.desired, motion.actual.dtype)
    return contour_vector(motion.actual, desired, window=problem.window)


def run(problem: Problem, command: FloatRows) -> tuple[Motion, Float[Array, "step 3"]]:
    """Run the plant once, compiled; return its motion and the contour vectors.

    Args:
        problem: The problem.
        command: The whole command, not its offset, shape (step, axis).

    Returns:
        The motion and the contour vectors [m], shape (step, 3).

    Differentiability: that of the plant; none of an `AbstractHostPlant`.
    """
    if isinstance(problem.plant, AbstractHostPlant):
        motion = problem.plant.run(command)
        return motion, contour_of(problem, motion)
    return _run(problem, command)


@eqx.filter_jit
def _run(problem: Problem, command: FloatRows) -> tuple[Motion, Float[Array, "step 3"]]:
    motion = problem.plant(jnp.asarray(command))
    return motion, contour_of(problem, motion)
