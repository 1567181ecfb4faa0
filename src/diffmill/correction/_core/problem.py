"""Problem of a correction: a plant, a path and the bounds."""

import abc
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows, FloatRows3, RealScalarLike
from ...toolpath import contour_vector

Weights = Float[Array, " step"] | Float[np.ndarray, " step"]


class Motion(eqx.Module):
    """Motion of a plant that follows a command, or its changes in some directions.

    Attributes:
        actual: Tool tip [m], shape (*direction, step, 3); of a job, the desired one
            with the deviation at the instant at which the wall is made.
        force: Force on the tool, mean over the step [N], same shape.
    """

    actual: Float[Array, "*direction step 3"]
    force: Float[Array, "*direction step 3"]


# Maps a command, shape (step, axis), to the motion that follows; traceable. An
# `eqx.Module` is best: its arrays then enter compiled functions as arguments.
Plant = Callable[[Float[Array, "step axis"]], Motion]


class AbstractHostPlant(eqx.Module):
    """A plant that runs a command on the host by a program of its own."""

    @abc.abstractmethod
    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Motion that follows a command, shape (step, axis); traceable."""

    @abc.abstractmethod
    def run(self, command: FloatRows) -> Motion:
        """Motion that follows a command, by a compiled program; not traceable."""


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
        is_cutting: Weight of every row in the error, shape (step,): 1 where the tool
            cuts and 0 elsewhere; of a job less where it only passes over the surface.
        time_step: Time between two rows T [s].
        max_offset: Largest offset of the command from `nominal` per axis, in the
            command's unit.
        window: Segments of the desired path to either side of a row among which the
            nearest is sought.
    """

    plant: Callable[..., Motion]
    nominal: FloatRows
    desired: FloatRows3
    is_cutting: Weights
    time_step: RealScalarLike = eqx.field(converter=_as_leaf)
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

    @property
    def without_plant(self) -> "Problem":
        """Problem for figures of a known motion, compiled once for all plants."""
        return dataclasses.replace(self, plant=_no_plant)

    def contour(self, motion: Motion) -> Float[Array, "step 3"]:
        """Vectors from the desired path to the tips [m], each the shortest, (step, 3).

        Also where the tool does not cut.

        Args:
            motion: The motion.

        **Differentiability**: smooth but where the nearest segment changes.
        """
        desired = jnp.asarray(self.desired, motion.actual.dtype)
        return contour_vector(motion.actual, desired, window=self.window)

    def run(self, command: FloatRows) -> Motion:
        """Run the plant once, compiled.

        Args:
            command: The whole command, not its offset, shape (step, axis).

        **Differentiability**: none, a host function.
        """
        return motion_of(self.plant, command)


def motion_of(plant: Plant, command: FloatRows) -> Motion:
    """Motion of a plant that follows a command, by a compiled program.

    Args:
        plant: The plant.
        command: The whole command, not its offset, shape (step, axis).

    **Differentiability**: none, a host function.
    """
    if isinstance(plant, AbstractHostPlant):
        return plant.run(command)
    return _compiled(plant, command)


@eqx.filter_jit
def _compiled(plant: Plant, command: FloatRows) -> Motion:
    return plant(jnp.asarray(command))


def _no_plant(command: Float[Array, "step axis"]) -> Motion:
    raise NotImplementedError("figures of a known motion need no plant")
